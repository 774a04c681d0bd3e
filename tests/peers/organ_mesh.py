"""The project's meshes and scenes: Gmsh ASCII 4.1 and 2.2, node tags 1..N in file order. Needs numpy.

GetFEM's own import is not used: it renumbers a group that shares its number with one of another dimension, and
the node numbers must stay those of the file.
"""

import pathlib
import sys
import tomllib

import numpy as np

# Gmsh's numbers of linear elements.
TRIANGLE, TETRAHEDRON = 2, 4
DIMENSIONS = {TRIANGLE: 2, TETRAHEDRON: 3}


# Edges of a tet, in the order of the middle nodes 4 to 9 of VTK.
EDGES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))


def edges(tets):
    """The edges of all tets, as rows of two nodes, and the edges of each tet (n x 6, in the order of EDGES)."""
    pairs = np.sort(tets[:, EDGES], axis=2).reshape(-1, 2)
    unique, number = np.unique(pairs, axis=0, return_inverse=True)
    return unique, number.reshape(-1, len(EDGES))


class Mesh:
    """Nodes (n x 3, m), tets (m x 4, 0-based nodes in file order), node sets of surface groups and indices of
    the tets of volume groups, both by name."""

    def __init__(self, nodes, tets, groups, regions):
        self.nodes, self.tets, self.groups, self.regions = nodes, tets, groups, regions


def read_gmsh(path):
    """Reads a mesh. Exits with one line if the format is another one or the node tags are not 1..N."""
    with open(path, encoding="ascii") as file:
        lines = [line.strip() for line in file]

    def section(name):
        if f"${name}" not in lines:
            return []
        return lines[lines.index(f"${name}") + 1 : lines.index(f"$End{name}")]

    names = {}
    for line in section("PhysicalNames")[1:]:
        dimension, tag, name = line.split(maxsplit=2)
        names[int(dimension), int(tag)] = name.strip('"')

    version = section("MeshFormat")[0].split()[:2]
    if version == ["4.1", "0"]:
        nodes, elements = _read_4(section, names)
    elif version == ["2.2", "0"]:
        nodes, elements = _read_2(section, names)
    else:
        sys.exit(f"{path}: Gmsh {' '.join(version)}; save the mesh as Gmsh 4.1 or 2.2 ASCII")
    if nodes is None:
        sys.exit(f"{path}: node tags are not 1..N; renumber the nodes")

    tets, groups, regions = [], {}, {}
    for kind, group_names, cells in elements:
        if kind == TRIANGLE:
            for name in group_names:
                groups.setdefault(name, set()).update(node for cell in cells for node in cell)
        elif kind == TETRAHEDRON:
            for name in group_names:
                regions.setdefault(name, []).extend(range(len(tets), len(tets) + len(cells)))
            tets += cells
    groups = {name: np.array(sorted(group)) for name, group in groups.items()}
    return Mesh(nodes, np.array(tets), groups, {name: np.array(region) for name, region in regions.items()})


def _read_4(section, names):
    """Gmsh 4.1: (nodes or None, [(kind, names of the groups, elements as rows of 0-based nodes)])."""
    physical = {}  # (dimension, entity) -> names of its groups
    entities = section("Entities")
    if entities:
        counts = [int(word) for word in entities[0].split()]
        row = 1
        for dimension, count in enumerate(counts):
            for line in entities[row : row + count]:
                words = line.split()
                at = 4 if dimension == 0 else 7
                tags = [int(word) for word in words[at + 1 : at + 1 + int(words[at])]]
                physical[dimension, int(words[0])] = [names[dimension, tag] for tag in tags]
            row += count

    body = section("Nodes")
    blocks, count, first, last = (int(word) for word in body[0].split())
    if (first, last) != (1, count):
        return None, []
    nodes = np.empty((count, 3))
    row = 1
    for _ in range(blocks):
        size = int(body[row].split()[3])
        tags = [int(line) - 1 for line in body[row + 1 : row + 1 + size]]
        nodes[tags] = [[float(word) for word in line.split()[:3]] for line in body[row + 1 + size : row + 1 + 2 * size]]
        row += 1 + 2 * size

    elements = []
    body = section("Elements")
    row = 1
    for _ in range(int(body[0].split()[0])):
        dimension, entity, kind, size = (int(word) for word in body[row].split())
        cells = [[int(word) - 1 for word in line.split()[1:]] for line in body[row + 1 : row + 1 + size]]
        row += 1 + size
        elements.append((kind, physical.get((dimension, entity), []), cells))
    return nodes, elements


def _read_2(section, names):
    """Gmsh 2.2, in which an element names its group itself: as `_read_4`."""
    rows = [line.split() for line in section("Nodes")[1:]]
    if [int(row[0]) for row in rows] != list(range(1, len(rows) + 1)):
        return None, []
    nodes = np.array([[float(word) for word in row[1:4]] for row in rows])
    elements = []
    for line in section("Elements")[1:]:
        _, kind, count, *rest = (int(word) for word in line.split())
        name = names.get((DIMENSIONS.get(kind), rest[0])) if count > 0 else None
        elements.append((kind, [name] if name else [], [[tag - 1 for tag in rest[count:]]]))
    return nodes, elements


def read_scene(mesh_dir, name):
    """The bundled organ `name`: (mesh, active nodes by name, of those that are given as a node)."""
    path = pathlib.Path(mesh_dir) / f"{name}.toml"
    with open(path, "rb") as file:
        scene = tomllib.load(file)
    mesh = read_gmsh(path.parent / scene["mesh"]["file"])
    return mesh, {active["name"]: active["node"] for active in scene["active"] if "node" in active}
