#!/usr/bin/env python3
"""Makes the mesh of scenes/lump.toml: scenes/lump.msh, half an ellipsoid with a round inclusion under its skin.

    python3 make_lump.py                       make the bundled mesh anew (a size of 8 mm)
    python3 make_lump.py FOLDER 12 9 7 5.5     make FOLDER/lump-12.msh and so on, for the table of ../docs/measurements.md

Needs what make_phantom.py needs (its docstring names the versions and the Debian libraries of gmsh), and gives the same bytes under the
same conditions. The body is 120 x 120 x 48 mm with its flat side at z = 0. The inclusion has a diameter of 16 mm and lies 5 mm under the
skin at LUMP; BESIDE is the mirrored place. Both are vertices of every mesh. A coarse mesh cuts the inclusion to a polyhedron, which is
made as large as the ball, so that a mesh changes how the inclusion is resolved and not how much of it there is.

Groups: "tissue" and "lump" (volumes), "skin" and "base" (surfaces). Gmsh 4.1 ASCII, metres, rounded to the nanometre.

Licence: MIT OR Apache-2.0, as the rest of the project.
"""

import math
import sys
from pathlib import Path

import numpy as np

from phantom import mshfile, volume

HERE = Path(__file__).resolve().parent

HALF_AXES = (0.060, 0.060, 0.048)
RADIUS, COVER = 0.008, 0.005
PLACE_X = 0.022
BUNDLED = 8.0
GROUPS = ((2, 1, "skin", (1,)), (2, 2, "base", (2,)), (3, 3, "tissue", (1,)), (3, 4, "lump", (2,)))


def place(x):
    """The point of the skin above (x, 0), and the outward normal there."""
    a, _, c = HALF_AXES
    z = c * math.sqrt(1 - (x / a) ** 2)
    normal = np.array([x / a**2, 0.0, z / c**2])
    return np.array([x, 0.0, z]), normal / np.linalg.norm(normal)


def centre():
    at, normal = place(PLACE_X)
    return at - (COVER + RADIUS) * normal


def mesh(edge, radius):
    """Nodes, tets of tissue and of the inclusion, and the surface's triangles, of a ball of this radius."""
    import gmsh

    gmsh.initialize(interruptible=False)
    try:
        for option, value in (
            ("General.Terminal", 0), ("General.NumThreads", 1), ("Mesh.RandomSeed", 1), ("Mesh.Algorithm", 6), ("Mesh.Algorithm3D", 1),
            ("Mesh.MeshSizeMin", edge), ("Mesh.MeshSizeMax", edge), ("Mesh.OptimizeThreshold", 0.5),
        ):  # fmt: skip
            gmsh.option.setNumber(option, value)
        occ = gmsh.model.occ
        body = occ.addSphere(0, 0, 0, 1, angle1=0)
        occ.dilate([(3, body)], 0, 0, 0, *HALF_AXES)
        ball = occ.addSphere(*centre(), radius)
        points = [(0, occ.addPoint(*place(x)[0])) for x in (PLACE_X, -PLACE_X)]
        occ.fragment([(3, body)], [(3, ball), *points])
        occ.synchronize()
        gmsh.model.mesh.generate(3)
        for _ in range(3):
            gmsh.model.mesh.optimize("")
            gmsh.model.mesh.optimize("Netgen")
        tags, coordinates, _ = gmsh.model.mesh.getNodes()
        rank = np.full(int(tags.max()) + 1, -1)
        rank[tags.astype(int)] = np.arange(len(tags))
        parts = [rank[gmsh.model.mesh.getElementsByType(4, tag)[1].astype(int)].reshape(-1, 4) for _, tag in gmsh.model.getEntities(3)]
    finally:
        gmsh.finalize()
    x = coordinates.reshape(-1, 3)
    used = np.unique(np.concatenate(parts))
    index = np.full(len(x), -1)
    index[used] = np.arange(len(used))
    x, parts = x[used], sorted((index[part] for part in parts), key=len, reverse=True)
    for tets in parts:
        turned = volume.signed_volumes(x, tets) < 0
        tets[turned] = tets[turned][:, [0, 1, 3, 2]]
    return x, parts


def boundary(tets):
    """The faces that belong to one tet, counter-clockwise from outside."""
    faces = np.concatenate([tets[:, list(face)] for face in ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))])
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[first[count == 1]]


def ball_of_full_volume(edge):
    """The mesh whose inclusion has the volume of the ball: by its radius as far as meshes of it allow, then by scaling its nodes."""
    wanted = 4 / 3 * math.pi * RADIUS**3
    radius, tried = RADIUS, []
    for _ in range(6):
        x, parts = mesh(edge, radius)
        share = volume.signed_volumes(x, parts[1]).sum() / wanted
        tried.append((abs(share - 1), share, x, parts))
        radius /= share ** (1 / 3)
    _, share, x, parts = min(tried, key=lambda of: of[0])
    own = np.unique(parts[1])
    x[own] = centre() + (x[own] - centre()) / share ** (1 / 3)
    return x, parts


def build(path, edge):
    x, parts = ball_of_full_volume(edge)
    x = np.round(x, 9)
    triangles = boundary(np.concatenate(parts))
    on_base = np.all(np.abs(x[triangles][:, :, 2]) < 1e-9, axis=1)
    # Numbered: base, rest of the skin, inside of the tissue, inclusion with its surface; within each by position.
    kind = np.full(len(x), 2)
    kind[parts[1]] = 3
    kind[triangles], kind[triangles[on_base]] = 1, 0
    order = np.lexsort((x[:, 2], x[:, 1], x[:, 0], kind))
    rank = np.argsort(order)
    x, kind, triangles, parts = x[order], kind[order], rank[triangles], [rank[tets] for tets in parts]
    first = lambda rows: rows[np.lexsort(np.sort(rows, axis=1).T[::-1])]
    mshfile.write(
        path,
        x,
        [(dim, entity, np.flatnonzero(kind == k)) for k, (dim, entity) in enumerate(((2, 2), (2, 1), (3, 1), (3, 2)))],
        [(1, first(triangles[~on_base])), (2, first(triangles[on_base]))],
        [(entity, first(tets)) for entity, tets in enumerate(parts, 1)],
        GROUPS,
    )
    check(path, edge)


def check(path, edge):
    """Every requirement, on the file as written."""
    x, elements = mshfile.read(path)
    tissue, lump = elements[3, "tissue"], elements[3, "lump"]
    tets = np.concatenate([tissue, lump])
    volumes = volume.signed_volumes(x, tets)
    ball = volume.signed_volumes(x, lump).sum()
    body = 2 / 3 * math.pi * math.prod(HALF_AXES)
    assert volumes.min() > 0
    assert 0.9 < volumes.sum() / body < 1.0, "the body has the ellipsoid's volume, but for its flat triangles"
    assert abs(ball / (4 / 3 * math.pi * RADIUS**3) - 1) < 1e-5, "the inclusion has the ball's volume"
    for at in (PLACE_X, -PLACE_X):
        assert np.linalg.norm(x - place(at)[0], axis=1).min() < 2e-9, "the places are vertices"
    skin, base = elements[2, "skin"], elements[2, "base"]
    assert len(boundary(tets)) == len(skin) + len(base)
    assert np.all(x[base][:, :, 2] == 0) and np.all(x[skin][:, :, 2].max(axis=1) > 0)
    ends = np.unique(np.sort(np.concatenate([tets[:, list(pair)] for pair in ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))]), axis=1), axis=0)
    lengths = np.linalg.norm(x[ends[:, 0]] - x[ends[:, 1]], axis=1)
    angles = volume.dihedral_angles(x[tets]).min(axis=1)
    near = [lengths[np.linalg.norm(x[ends].mean(axis=1) - place(at)[0], axis=1) < 0.02].mean() for at in (PLACE_X, -PLACE_X)]
    print(
        f"{path.name}: {len(x)} nodes, {len(tissue)} + {len(lump)} tets, mean edge {1e3 * lengths.mean():.2f} mm, "
        f"near the places {1e3 * near[0]:.2f} and {1e3 * near[1]:.2f} mm, smallest dihedral angle {angles.min():.1f} degrees, "
        f"inclusion {1e6 * ball:.3f} ml, {path.stat().st_size / 1e3:.0f} kB"
    )


def main():
    folder, *edges = sys.argv[1:] or [None]
    if folder is None:
        build(HERE / "scenes" / "lump.msh", 1e-3 * BUNDLED)
    for edge in edges:
        Path(folder).mkdir(parents=True, exist_ok=True)
        build(Path(folder) / f"lump-{edge}.msh", 1e-3 * float(edge))


if __name__ == "__main__":
    main()
