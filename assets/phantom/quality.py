"""What the phantom's meshes must fulfil, checked on the files themselves, and the table of their figures."""

from collections import Counter

import numpy as np

from . import volume

F1_WIDTH_M = 0.022  # F1: the left end, surface nodes less than this from the smallest x
F2_DEPTH_M = 0.016  # F2: the top, surface nodes less than this below the largest y
SMALLEST_DIHEDRAL_DEGREES = 30.0


def inside_sets(x, triangles):
    """Boundary triangles of F1 and of F2: those with all three vertices in the slab. The set is the union of their vertices."""
    left = x[:, 0] < x[:, 0].min() + F1_WIDTH_M
    top = x[:, 1] > x[:, 1].max() - F2_DEPTH_M
    return left[triangles].all(axis=1), top[triangles].all(axis=1)


def vertex_normals(x, triangles):
    """Outward area-weighted normals (zero for vertices inside)."""
    face = np.cross(x[triangles[:, 1]] - x[triangles[:, 0]], x[triangles[:, 2]] - x[triangles[:, 0]])
    sums = np.zeros_like(x)
    for n in range(3):
        np.add.at(sums, triangles[:, n], face)
    return sums / (np.linalg.norm(sums, axis=1, keepdims=True) + 1e-60), face / np.linalg.norm(face, axis=1, keepdims=True)


def boundary(tets):
    """Outward triangles that belong to one tet only."""
    faces = np.concatenate([tets[:, f] for f in ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))])
    count = Counter(map(tuple, np.sort(faces, axis=1).tolist()))
    assert max(count.values()) <= 2, "a face with more than two tets"
    return faces[[count[tuple(sorted(f))] == 1 for f in faces.tolist()]]


def turned(triangles):
    """Triangles as a set, each starting at its smallest vertex: equal if the same triangles with the same orientation."""
    return {tuple(t[t.index(min(t)) :] + t[: t.index(min(t))]) for t in triangles.tolist()}


def euler_characteristic(triangles):
    """V - E + F, after checking that the surface is a closed, oriented, connected manifold."""
    directed = Counter((t[n], t[(n + 1) % 3]) for t in triangles.tolist() for n in range(3))
    assert set(directed.values()) == {1}, "an edge is used twice in one direction"
    assert all((j, i) in directed for i, j in directed), "the surface has an open edge"
    links = {}
    for i, j, k in triangles.tolist():
        for a, b, c in ((i, j, k), (j, k, i), (k, i, j)):
            links.setdefault(a, {})[b] = c
    for link in links.values():
        start = v = next(iter(link))
        for steps in range(1, len(link) + 1):
            v = link[v]
            if v == start:
                break
        assert steps == len(link), "a vertex where two sheets touch"
    seen, todo = set(), [int(triangles[0, 0])]
    while todo:
        v = todo.pop()
        if v not in seen:
            seen.add(v)
            todo += links[v]
    assert seen == set(links), "the surface has more than one part"
    return len(links) - len(directed) // 2 + len(triangles)


def check(mesh, active, most_surface_nodes):
    """Asserts every requirement on a mesh read back from its file and returns the figures as (label, text) rows."""
    x, elements = mesh
    tets, triangles = elements[3, "tissue"], elements[2, "surface"]
    fixed = {name: np.unique(elements[2, name]) for name in ("F1", "F2")}
    rows = []
    say = lambda label, text: rows.append((label, str(text)))

    volumes = volume.signed_volumes(x, tets)
    angles = volume.dihedral_angles(x[tets])
    assert np.array_equal(np.unique(tets), np.arange(len(x))), "a node that no tet uses"
    assert volumes.min() > 0.0, "an inverted tet"
    assert turned(boundary(tets)) == turned(triangles), "group surface is not the boundary of the tets"
    on_surface = np.unique(triangles)
    say("nodes", len(x))
    say("tets", len(tets))
    say("surface nodes / triangles", f"{len(on_surface)} / {len(triangles)}")
    assert len(on_surface) <= most_surface_nodes, "too many surface nodes"
    say("interior nodes", len(x) - len(on_surface))
    say("volume", f"{volumes.sum():.6e} m3")
    assert 1.1e-3 < volumes.sum() < 1.3e-3, "the volume is not that of a liver this size"
    say("smallest / mean tet", f"{volumes.min() * 1e9:.0f} / {volumes.mean() * 1e9:.0f} mm3")
    size = np.ptp(x, axis=0)
    say("extent x, y, z", ", ".join(f"{v * 1e3:.1f}" for v in size) + " mm")
    assert abs(size[0] - 0.2) < 1e-6, "the body is not 0.2 m across"
    centre = (x[tets].mean(axis=1) * volumes[:, None]).sum(axis=0) / volumes.sum()
    say("centre of gravity", "(" + ", ".join(f"{v * 1e3:.1f}" for v in centre) + ") mm")

    say("dihedral: smallest, 1st percentile of the tets", f"{angles.min():.1f}, {np.percentile(angles.min(axis=1), 1):.1f} degrees")
    say("dihedral: mean of the tets' smallest, largest", f"{angles.min(axis=1).mean():.1f}, {angles.max():.1f} degrees")
    assert angles.min() > SMALLEST_DIHEDRAL_DEGREES, "a sliver"
    edges = np.unique(np.sort(np.concatenate([tets[:, list(pair[:2])] for pair in volume.EDGES]), axis=1), axis=0)
    length = np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1) * 1e3
    say("edge length: range, mean", f"{length.min():.1f} to {length.max():.1f}, {length.mean():.1f} mm")
    skin = np.unique(np.sort(np.concatenate([triangles[:, pair] for pair in ([0, 1], [1, 2], [2, 0])]), axis=1), axis=0)
    say("edge length on the surface, mean", f"{np.linalg.norm(x[skin[:, 0]] - x[skin[:, 1]], axis=1).mean() * 1e3:.1f} mm")
    say("tets without an interior vertex", int(np.isin(tets, on_surface).all(axis=1).sum()))

    in_f1, in_f2 = inside_sets(x, triangles)
    for name, inside in (("F1", in_f1), ("F2", in_f2)):
        assert turned(triangles[inside]) == turned(elements[2, name]), f"group {name} is not the intended set"
        whole = int(np.isin(tets, fixed[name]).all(axis=1).sum())
        assert whole == 0, f"a tet with all its vertices in {name}"
        say(f"{name}: nodes / triangles / tets with all vertices fixed", f"{len(fixed[name])} / {len(elements[2, name])} / {whole}")
    assert not set(fixed["F1"]) & set(fixed["F2"]), "F1 and F2 touch"
    euler = euler_characteristic(triangles)
    assert euler == 2, "the surface is not a sphere"
    say("Euler characteristic of the surface", euler)

    normals, face = vertex_normals(x, triangles)
    for name, node in active.items():
        assert node in on_surface and not any(node in nodes for nodes in fixed.values()), f"{name} is not a free surface node"
        tilt = np.degrees(np.arccos(np.clip((face[(triangles == node).any(axis=1)] @ normals[node]).min(), -1.0, 1.0)))
        star = (tets == node).any(axis=1)
        inner = np.setdiff1d(tets[star], on_surface).size
        around = angles[star].min()
        assert tilt < 30.0 and around > 33.0 and normals[node, 2] > 0.5, f"{name} has no good neighbourhood on the front"
        assert star.sum() >= 10 and inner >= 3, f"too few tets around {name} to bear a tool"
        away = np.linalg.norm(x[node] - centre) * 1e3, (x[:, 0].max() - x[node, 0]) * 1e3
        say(f"{name}", f"node {node} at (" + ", ".join(f"{v * 1e3:.1f}" for v in x[node]) + ") mm")
        say(f"{name}: normal", "(" + ", ".join(f"{v:.2f}" for v in normals[node]) + ")")
        say(f"{name}: to the centre of gravity, to the tip along x", f"{away[0]:.0f}, {away[1]:.0f} mm")
        say(f"{name}: triangles' largest tilt, tets' smallest dihedral", f"{tilt:.0f}, {around:.0f} degrees")
        say(f"{name}: tets around it, their volume", f"{star.sum()}, {volumes[star].sum() * 1e9:.0f} mm3")
        depth = [np.linalg.norm(x[fixed[f]] - x[node], axis=1).min() * 1e3 for f in ("F1", "F2")]
        say(f"{name}: nearest node of F1, of F2", f"{depth[0]:.0f}, {depth[1]:.0f} mm")
    return rows
