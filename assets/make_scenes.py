#!/usr/bin/env python3
"""Makes the meshes of scenes/ that are not the bundled organ itself: tumour.msh and strip.msh. Needs numpy.

    python3 make_scenes.py            make them anew

tumour.msh is liver-small.msh with the tets whose centre lies within 19 mm of a point 22 mm below the touched surface in a group of
their own. strip.msh is a strip of 100 x 20 x 10 mm, cut into boxes of six tets each. Gmsh 2.2, metres, nodes in the order of the files.

Licence: MIT OR Apache-2.0, as the rest of the project.
"""

import itertools
from pathlib import Path

import numpy as np

from phantom import mshfile

HERE = Path(__file__).resolve().parent

# The inclusion: before A1's left neighbour region, under the front of the body.
TUMOUR_CENTRE, TUMOUR_RADIUS = np.array([0.004, 0.010, 0.028]), 0.019

STRIP_SIZE, STRIP_CELLS = (0.1, 0.02, 0.01), (15, 3, 2)
# The corners of a box's six tets, all with the diagonal from corner 0 to corner 7; corner n is at (n & 1, n >> 1 & 1, n >> 2).
SIX_TETS = [[0, a, a | b, 7] for a, b in itertools.permutations((1, 2, 4), 2)]


def write(path, x, groups):
    """`groups`: (dimension, name, elements); an element is in one group only."""
    out = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", str(len(groups))]
    out += [f'{dim} {tag} "{name}"' for tag, (dim, name, _) in enumerate(groups, 1)]
    out += ["$EndPhysicalNames", "$Nodes", str(len(x))]
    out += [f"{n} " + " ".join(f"{v:.9g}" for v in p) for n, p in enumerate(x, 1)]
    out += ["$EndNodes", "$Elements", str(sum(len(elements) for *_, elements in groups))]
    number = itertools.count(1)
    for tag, (dim, _, elements) in enumerate(groups, 1):
        kind = {2: 2, 3: 4}[dim]
        out += [f"{next(number)} {kind} 2 {tag} {tag} " + " ".join(str(n + 1) for n in e) for e in elements]
    path.write_text("\n".join([*out, "$EndElements", ""]), newline="\n")
    print(f"{path.name}: {len(x)} nodes, " + ", ".join(f"{name} {len(e)}" for _, name, e in groups))


def oriented(x, tets):
    """Positive volumes."""
    tets = np.array(tets)
    a, b, c, d = (x[tets[:, i]] for i in range(4))
    swap = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) < 0
    tets[swap] = tets[swap][:, [0, 2, 1, 3]]
    return tets


def tumour():
    x, elements = mshfile.read(HERE / "liver-small.msh")
    tets = elements[3, "tissue"]
    inside = np.linalg.norm(x[tets].mean(axis=1) - TUMOUR_CENTRE, axis=1) < TUMOUR_RADIUS
    held = {name: {tuple(sorted(t)) for t in elements[2, name]} for name in ("F1", "F2")}
    free = [t for t in elements[2, "surface"] if not any(tuple(sorted(t)) in h for h in held.values())]
    write(
        HERE / "scenes" / "tumour.msh",
        x,
        [(2, "free", free), (2, "F1", elements[2, "F1"]), (2, "F2", elements[2, "F2"]),
         (3, "tissue", tets[~inside]), (3, "tumour", tets[inside])],
    )


def strip():
    counts = [n + 1 for n in STRIP_CELLS]
    index = lambda i, j, k: (i * counts[1] + j) * counts[2] + k
    x = np.array([[s * n / c for s, n, c in zip(STRIP_SIZE, at, STRIP_CELLS)] for at in itertools.product(*map(range, counts))])
    corner = lambda at, n: index(*(a + (n >> axis & 1) for axis, a in enumerate(at)))
    boxes = itertools.product(*map(range, STRIP_CELLS))
    tets = oriented(x, [[corner(at, n) for n in tet] for at in boxes for tet in SIX_TETS])
    faces = {}
    for tet in tets:
        for face in itertools.combinations(tet, 3):
            faces.setdefault(tuple(sorted(face)), []).append(tet)
    ends = [list(face) for face, owners in faces.items() if len(owners) == 1 and np.all(x[list(face)][:, 0] == 0)]
    write(HERE / "scenes" / "strip.msh", x, [(2, "end", ends), (3, "strip", tets)])


tumour()
strip()
