#!/usr/bin/env python3
"""Makes the bundled organ: liver-small.msh and liver-large.msh, from the formula in phantom/shape.py.

    python3 make_phantom.py                   make both meshes anew, check them, print the table of README.md
    python3 make_phantom.py --check           only check the files that are here (needs numpy, not gmsh's libraries) and print the table
    python3 make_phantom.py --large FOLDER    make finer meshes of the body in FOLDER, each with a scene and a hand, to measure large bodies (a minute)

Needs Python 3.11 or newer and, from PyPI, numpy and gmsh (made with numpy 2.x and gmsh 4.15.2: `pip install gmsh numpy`). On a bare
Debian the gmsh wheel wants these libraries to be there before it can be imported:
    apt-get install libglu1-mesa libgl1 libxrender1 libxcursor1 libxft2 libxinerama1 libxfixes3
Gmsh runs in one thread and every random number is seeded, so the same versions on the same kind of processor write the same bytes.
Another version or processor may round differently and end with another, equally good, mesh: then the node numbers in the scenes
must follow (the script says so).

How: (1) isotropic triangulation of the formula (phantom/surface.py); (2) Gmsh fills it with Delaunay tets, which it optimises;
(3) our own vertex optimisation, in which surface vertices move along the formula (phantom/volume.py); (4) the fixed sets
are chosen by position, nodes are numbered and the file is written (phantom/mshfile.py); (5) the file is read back and every
requirement is asserted on it (phantom/quality.py).

Licence: MIT OR Apache-2.0, as the rest of the project.
"""

import math
import sys
import tomllib
from pathlib import Path

import numpy as np

from phantom import mshfile, quality, shape

HERE = Path(__file__).resolve().parent

# Wanted edge lengths in metres: on the surface, inside, and near the active nodes (found by trial, see README.md).
RECIPES = {
    "liver-small": {"surface": 0.0144, "inside": 0.0144, "touch": 0.020, "most_surface_nodes": 360},
    "liver-large": {"surface": 0.0110, "inside": 0.0071, "touch": 0.017, "most_surface_nodes": 640},
}
# Finer meshes, named by their equations with quadratic displacements and linear pressures.
LARGE = {
    "liver-50k": {"surface": 0.0110, "inside": 0.0068, "touch": 0.014},
    "liver-100k": {"surface": 0.0095, "inside": 0.0053, "touch": 0.012},
}
# The hand on each presses three times from above the skin, at this speed.
LARGE_SPEED_M_S = {"liver-50k": 0.030, "liver-100k": 0.010}
PRESS_ABOVE_M, PRESS_DEPTH_M, PRESS_HELD_S = 0.005, 0.027, 1.0
LARGE_SCENE = """\
# {nodes} vertices, {tets} tetrahedra: about {thousands},000 equations, touched by a fingertip {where}.
name = "{name}"

[mesh]
file = "{mesh}.msh"
order = 2

[material]
law = "mooney-rivlin"
c10_pa = 1300.0
c01_pa = 1280.0

[fixed]
group = "F1"

[tool]
shape = "fingertip"
radius_m = 0.015

{active}
[grid]
radius_m = {radius_m}
cannot_be_felt = true

[device]
max_force_n = 4.0

[needs]
contact = "push"
"""
# Places all over the free skin, at least 20 mm from the fixed part and as far from each other as ten can be.
PLACES = (
    (-0.02170, -0.04248, 0.04841),
    (0.09498, 0.03631, -0.02905),
    (-0.05173, 0.05383, -0.05773),
    (0.00060, 0.05485, 0.02823),
    (-0.05285, -0.03119, -0.03500),
    (0.05217, -0.01999, 0.01612),
    (-0.06852, 0.01838, 0.03060),
    (0.01639, 0.02211, -0.03685),
    (-0.06154, -0.07037, 0.00999),
    (0.05546, 0.03815, 0.01582),
)
TOUCH_REACH = 0.025
SWEEPS = 40

# Points of the formula, as (a, b, c) of phantom/shape.py, where every mesh has a vertex: the two ends of the body, so that it is 0.2 m
# across on every mesh, and the active nodes, so that results on the two meshes are for the same place.
ENDS = ((-1.0, 0.0, 0.0), (1.0, 0.0, 0.0))
ACTIVE = {
    "A1": (-0.21, 0.10, 0.973),  # in the middle of the front, before the centre of gravity
    "A2": (0.82, 0.05, 0.57),  # on the front of the thin lobe, some 18 mm from its tip
}
ACTIVE_POINTS = [tuple(shape.point(shape.unit(np.array(q))).tolist()) for q in ACTIVE.values()]


def edge_length(base, touch):
    """The wanted edge length as a function of the place: `base`, but `touch` at the active nodes.

    The tool acts on a single node, so the tets around it play the part of its footprint. Small or few ones are torn inside out
    long before the force is large; a dozen big ones bear 50 mm in nearly every direction."""
    near = lambda x: sum(math.exp(-((math.dist(x, p) / TOUCH_REACH) ** 2)) for p in ACTIVE_POINTS)
    return lambda x: base + (touch - base) * near(x)


def build(file, recipe):
    from phantom import surface, volume

    pins = [shape.unit(np.array(q)) for q in (*ENDS, *ACTIVE.values())]
    q, triangles, pinned = surface.triangulate(edge_length(recipe["surface"], recipe["touch"]), pins)
    x, tets = volume.fill(shape.point(q), triangles, edge_length(recipe["inside"], recipe["touch"]))
    x, q = volume.optimise(x, q, tets, pinned, SWEEPS)
    x = np.round(x, 9)  # to the nanometre: what the file says is what was checked

    # Number the nodes F1, F2, rest of the surface, inside: each is one block of the file; within a block they keep their order in x.
    in_f1, in_f2 = quality.inside_sets(x, triangles)
    kind = np.full(len(x), 3)
    kind[: len(q)] = 2
    kind[triangles[in_f1]], kind[triangles[in_f2]] = 0, 1
    order = np.lexsort((x[:, 2], x[:, 1], x[:, 0], kind))
    rank = np.argsort(order)
    x, kind, triangles, tets = x[order], kind[order], rank[triangles], rank[tets]
    first = lambda rows: rows[np.lexsort(np.sort(rows, axis=1).T[::-1])]
    surfaces = ((mshfile.F1, in_f1), (mshfile.F2, in_f2), (mshfile.FREE, ~(in_f1 | in_f2)))
    mshfile.write(
        file,
        x,
        [(dim, entity, np.flatnonzero(kind == k)) for k, (dim, entity) in enumerate(((2, 2), (2, 3), (2, 1), (3, 1)))],
        [(entity, first(triangles[inside])) for entity, inside in surfaces],
        [(mshfile.VOLUME, first(tets))],
    )


def active_nodes(x):
    """The numbers of the nodes at the points ACTIVE."""
    found = {}
    for name, q in ACTIVE.items():
        distance = np.linalg.norm(x - shape.point(shape.unit(np.array(q))), axis=1)
        found[name] = int(distance.argmin())
        assert distance.min() < 2e-9, f"no node at {name}"
    return found


def check_with_gmsh(name, mesh):
    """Gmsh itself reads the file and sees the same nodes in the same groups."""
    import gmsh

    x, elements = mesh
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(HERE / f"{name}.msh"))
        tags, coordinates, _ = gmsh.model.mesh.getNodes()
        assert np.array_equal(coordinates.reshape(-1, 3)[np.argsort(tags)], x)
        for dim, tag in gmsh.model.getPhysicalGroups():
            nodes, _ = gmsh.model.mesh.getNodesForPhysicalGroup(dim, tag)
            group = gmsh.model.getPhysicalName(dim, tag)
            assert np.array_equal(np.unique(nodes) - 1, np.unique(elements[dim, group])), f"Gmsh reads group {group} otherwise"
    finally:
        gmsh.finalize()


def make_large(folder):
    folder.mkdir(parents=True, exist_ok=True)
    for name, recipe in LARGE.items():
        file = folder / f"{name}.msh"
        build(file, recipe)
        x, elements = mshfile.read(file)
        tets = len(elements[3, "tissue"])
        middle = f'[[active]]\nname = "A1"\nnode = {active_nodes(x)["A1"]}\n'
        places = "\n".join(f'[[active]]\nname = "P{n}"\npoint = {list(at)}\n' for n, at in enumerate(PLACES, 1))
        scenes = (
            (name, middle, "in the middle of the front", 0.025),
            (f"{name}-places", places, "at ten places", 0.008),
        )
        for scene, active, where, radius_m in scenes:
            text = LARGE_SCENE.format(
                name=scene, mesh=name, thousands=name[6:-1], nodes=len(x), tets=tets, active=active, where=where, radius_m=radius_m
            )
            (folder / f"{scene}.toml").write_text(text)
            print(f"{folder / scene}.toml: {len(x)} vertices, {tets} tets")
        triangles = elements[2, "surface"]
        node = active_nodes(x)["A1"]
        (folder / f"{name}-press.csv").write_text(presses(x[node], quality.vertex_normals(x, triangles)[0][node], LARGE_SPEED_M_S[name]))


def presses(at, outward, speed_m_s):
    """A hand for `palpate live --device sim:FILE`."""
    above, below = at + PRESS_ABOVE_M * outward, at - PRESS_DEPTH_M * outward
    moving_s = (PRESS_ABOVE_M + PRESS_DEPTH_M) / speed_m_s
    rows, now = ["t_s,x_m,y_m,z_m"], 0.0
    for place, lasts_s in [(above, PRESS_HELD_S), (above, moving_s), (below, PRESS_HELD_S), (below, moving_s)] * 3 + [(above, 0.0)]:
        rows.append(",".join(f"{value:.6f}" for value in (now, *place)))
        now += lasts_s
    return "\n".join(rows) + "\n"


def main():
    if "--large" in sys.argv[1:]:
        at = sys.argv.index("--large") + 1
        if at == len(sys.argv):
            sys.exit("make_phantom.py: --large needs a folder")
        return make_large(Path(sys.argv[at]))
    only_check = "--check" in sys.argv[1:]
    columns = []
    for name, recipe in RECIPES.items():
        if not only_check:
            build(HERE / f"{name}.msh", recipe)
        mesh = mshfile.read(HERE / f"{name}.msh")
        if not only_check:
            check_with_gmsh(name, mesh)
        active = active_nodes(mesh[0])
        scene = HERE / f"{name}.toml"
        if scene.exists():
            said = {a["name"]: a["node"] for a in tomllib.loads(scene.read_text())["active"]}
            if said != active:
                print(f"{scene.name}: the active nodes must be {active}, the scene says {said}", file=sys.stderr)
                sys.exit(1)
        columns.append(quality.check(mesh, active, recipe["most_surface_nodes"]))
    print("| | " + " | ".join(RECIPES) + " |\n|---|" + "---|" * len(RECIPES))
    for cells in zip(*columns):
        print(f"| {cells[0][0]} | " + " | ".join(text for _, text in cells) + " |")


if __name__ == "__main__":
    main()
