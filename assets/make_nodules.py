#!/usr/bin/env python3
"""Makes the mesh of scenes/nodules.toml: scenes/nodules.msh, a block with three equal balls at different depths.

    python3 make_nodules.py

Needs what make_lump.py needs, and gives the same bytes under the same conditions. The block is 130 x 50 x 36 mm, its base at z = 0. The balls
have a radius of 7 mm and lie 3, 7 and 12 mm under the top; the points of the top above their centres are vertices. A mesh cuts a ball to a
polyhedron, which is made as large as the ball.

Groups: "tissue", "nodule-3", "nodule-7", "nodule-12" (volumes), "skin" and "base" (surfaces). Gmsh 4.1 ASCII, metres, rounded to the
nanometre.

Licence: MIT OR Apache-2.0, as the rest of the project.
"""

import math

import numpy as np

from make_lump import HERE, boundary
from phantom import mshfile, volume

SIZE = (0.130, 0.050, 0.036)
RADIUS = 0.007
COVERS = (0.003, 0.007, 0.012)
PLACES_X = (0.025, 0.065, 0.105)
# Edges at the top and at the base.
EDGES = (0.0072, 0.015)
GROUPS = (
    (2, 1, "skin", (1,)), (2, 2, "base", (2,)), (3, 3, "tissue", (1,)),
    *((3, 4 + n, f"nodule-{1e3 * cover:.0f}", (2 + n,)) for n, cover in enumerate(COVERS)),
)  # fmt: skip
TOP = SIZE[2]


def centre(n):
    return np.array([PLACES_X[n], SIZE[1] / 2, TOP - COVERS[n] - RADIUS])


def mesh(radii):
    """Nodes, then the tets of the tissue and of each ball, for balls of these radii."""
    import gmsh

    gmsh.initialize(interruptible=False)
    try:
        for option, value in (
            ("General.Terminal", 0), ("General.NumThreads", 1), ("Mesh.RandomSeed", 1), ("Mesh.Algorithm", 6), ("Mesh.Algorithm3D", 1),
            ("Mesh.MeshSizeExtendFromBoundary", 0), ("Mesh.MeshSizeFromPoints", 0), ("Mesh.OptimizeThreshold", 0.5),
        ):  # fmt: skip
            gmsh.option.setNumber(option, value)
        occ = gmsh.model.occ
        box = occ.addBox(0, 0, 0, *SIZE)
        balls = [occ.addSphere(*centre(n), radius) for n, radius in enumerate(radii)]
        points = [(0, occ.addPoint(x, SIZE[1] / 2, TOP)) for x in PLACES_X]
        occ.fragment([(3, box)], [*((3, ball) for ball in balls), *points])
        occ.synchronize()
        field = gmsh.model.mesh.field.add("MathEval")
        fine, coarse = EDGES
        gmsh.model.mesh.field.setString(field, "F", f"{fine} + {coarse - fine} * (({TOP} - z) / {TOP})^2")
        gmsh.model.mesh.field.setAsBackgroundMesh(field)
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
    x, parts = x[used], [index[part] for part in parts]
    for tets in parts:
        turned = volume.signed_volumes(x, tets) < 0
        tets[turned] = tets[turned][:, [0, 1, 3, 2]]
    tissue = max(range(len(parts)), key=lambda part: len(parts[part]))
    balls = sorted((part for n, part in enumerate(parts) if n != tissue), key=lambda tets: x[tets].mean(axis=(0, 1))[0])
    return x, [parts[tissue], *balls]


def balls_of_full_volume():
    """The mesh whose balls have their volume: by their radii as far as its steps allow, then by scaling their nodes."""
    wanted = 4 / 3 * math.pi * RADIUS**3
    radii, tried = np.full(len(COVERS), RADIUS), []
    for _ in range(6):
        x, parts = mesh(radii)
        shares = np.array([volume.signed_volumes(x, tets).sum() / wanted for tets in parts[1:]])
        tried.append((np.abs(shares - 1).max(), shares, x, parts))
        radii = radii / shares ** (1 / 3)
    _, shares, x, parts = min(tried, key=lambda of: of[0])
    for n, (share, tets) in enumerate(zip(shares, parts[1:], strict=True)):
        own = np.unique(tets)
        x[own] = centre(n) + (x[own] - centre(n)) / share ** (1 / 3)
    return x, parts


def build(path):
    x, parts = balls_of_full_volume()
    x = np.round(x, 9)
    triangles = boundary(np.concatenate(parts))
    on_base = np.all(np.abs(x[triangles][:, :, 2]) < 1e-9, axis=1)
    # Numbered: base, rest of the skin, inside of the tissue, the balls with their surfaces; within each by position.
    kind = np.full(len(x), 2)
    for n, tets in enumerate(parts[1:]):
        kind[tets] = 3 + n
    kind[triangles], kind[triangles[on_base]] = 1, 0
    order = np.lexsort((x[:, 2], x[:, 1], x[:, 0], kind))
    rank = np.argsort(order)
    x, kind, triangles, parts = x[order], kind[order], rank[triangles], [rank[tets] for tets in parts]
    first = lambda rows: rows[np.lexsort(np.sort(rows, axis=1).T[::-1])]
    places = [(2, 2), (2, 1), *((3, 1 + n) for n in range(len(parts)))]
    mshfile.write(
        path,
        x,
        [(dim, entity, np.flatnonzero(kind == k)) for k, (dim, entity) in enumerate(places)],
        [(1, first(triangles[~on_base])), (2, first(triangles[on_base]))],
        [(entity, first(tets)) for entity, tets in enumerate(parts, 1)],
        GROUPS,
    )
    check(path)


def check(path):
    """Every requirement, on the file as written."""
    x, elements = mshfile.read(path)
    names = [name for dim, _, name, _ in GROUPS if dim == 3]
    parts = [elements[3, name] for name in names]
    tets = np.concatenate(parts)
    volumes = volume.signed_volumes(x, tets)
    assert volumes.min() > 0
    assert abs(volumes.sum() / math.prod(SIZE) - 1) < 1e-6, "the block is full"
    for ball in parts[1:]:
        assert abs(volume.signed_volumes(x, ball).sum() / (4 / 3 * math.pi * RADIUS**3) - 1) < 1e-5, "a ball has its volume"
    for place in PLACES_X:
        assert np.linalg.norm(x - [place, SIZE[1] / 2, TOP], axis=1).min() < 2e-9, "the places are vertices"
    skin, base = elements[2, "skin"], elements[2, "base"]
    assert len(boundary(tets)) == len(skin) + len(base)
    angles = volume.dihedral_angles(x[tets]).min(axis=1)
    free = len(np.setdiff1d(np.unique(skin), np.unique(base)))
    print(
        f"{path.name}: {len(x)} nodes, {' + '.join(str(len(part)) for part in parts)} tets, {free} free nodes of the skin, "
        f"smallest dihedral angle {angles.min():.1f} degrees, {path.stat().st_size / 1e3:.0f} kB"
    )


if __name__ == "__main__":
    build(HERE / "scenes" / "nodules.msh")
