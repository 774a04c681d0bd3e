"""Writing and reading the phantom's Gmsh 4.1 ASCII files (only what these files use)."""

import numpy as np

# Discrete entities: every boundary triangle lies in exactly one of the three surfaces.
FREE, F1, F2 = 1, 2, 3
VOLUME = 1
# Physical groups: (dimension, physical tag, name, entities)
GROUPS = ((2, 1, "surface", (FREE, F1, F2)), (2, 2, "F1", (F1,)), (2, 3, "F2", (F2,)), (3, 4, "tissue", (VOLUME,)))


def write(path, x, node_blocks, triangle_blocks, tet_blocks, groups=GROUPS):
    """`node_blocks`: (dimension, entity, nodes); `triangle_blocks`, `tet_blocks`: (entity, elements). Nodes are numbered from 0 here."""
    box = lambda nodes: " ".join(f"{v:.9g}" for v in np.concatenate([x[nodes].min(axis=0), x[nodes].max(axis=0)]))
    physical = lambda dim, entity: [tag for d, tag, _, entities in groups if d == dim and entity in entities]
    out = ["$MeshFormat", "4.1 0 8", "$EndMeshFormat", "$PhysicalNames", str(len(groups))]
    out += [f'{dim} {tag} "{name}"' for dim, tag, name, _ in groups]
    out += ["$EndPhysicalNames", "$Entities", f"0 0 {len(triangle_blocks)} {len(tet_blocks)}"]
    for entity, triangles in triangle_blocks:
        tags = physical(2, entity)
        out.append(f"{entity} {box(np.unique(triangles))} {len(tags)} {' '.join(map(str, tags))} 0")
    bounds = " ".join(str(entity) for entity, _ in triangle_blocks)
    for entity, tets in tet_blocks:
        tags = physical(3, entity)
        out.append(
            f"{entity} {box(np.unique(tets))} {len(tags)} {' '.join(map(str, tags))} {len(triangle_blocks)} {bounds}"
        )
    out += ["$EndEntities", "$Nodes", f"{len(node_blocks)} {len(x)} 1 {len(x)}"]
    for dim, entity, nodes in node_blocks:
        out.append(f"{dim} {entity} 0 {len(nodes)}")
        out += [str(n + 1) for n in nodes]
        out += [" ".join(f"{v:.9g}" for v in x[n]) for n in nodes]
    blocks = [(2, entity, 2, triangles) for entity, triangles in triangle_blocks]
    blocks += [(3, entity, 4, tets) for entity, tets in tet_blocks]
    total = sum(len(elements) for *_, elements in blocks)
    out += ["$EndNodes", "$Elements", f"{len(blocks)} {total} 1 {total}"]
    tag = 1
    for dim, entity, kind, elements in blocks:
        out.append(f"{dim} {entity} {kind} {len(elements)}")
        for corners in elements:
            out.append(f"{tag} " + " ".join(str(v + 1) for v in corners))
            tag += 1
    out += ["$EndElements", ""]
    path.write_text("\n".join(out), newline="\n")


def read(path):
    """Returns positions, {(dimension, group name): elements}; an element is a row of 0-based nodes in file order."""
    lines = iter(path.read_text().split("\n"))
    row = lambda kind=int: [kind(w) for w in next(lines).split()]
    names, groups, x, index, elements = {}, {}, [], {}, {}
    for line in lines:
        if line == "$PhysicalNames":
            for _ in range(row()[0]):
                dim, tag, name = next(lines).split()
                names[int(dim), int(tag)] = name.strip('"')
        elif line == "$Entities":
            points, curves, surfaces, volumes = row()
            assert points == curves == 0, "these files have surfaces and volumes only"
            for dim, count in ((2, surfaces), (3, volumes)):
                for _ in range(count):
                    words = next(lines).split()
                    tags = words[8 : 8 + int(words[7])]
                    groups[dim, int(words[0])] = [names[dim, int(t)] for t in tags]
        elif line == "$Nodes":
            for _ in range(row()[0]):
                count = row()[3]
                for tag in [row()[0] for _ in range(count)]:
                    index[tag] = len(index)
                x += [row(float) for _ in range(count)]
        elif line == "$Elements":
            for _ in range(row()[0]):
                dim, entity, _, count = row()
                block = [[index[t] for t in row()[1:]] for _ in range(count)]
                for name in groups[dim, entity]:
                    elements.setdefault((dim, name), []).extend(block)
    return np.array(x), {key: np.array(block) for key, block in elements.items()}
