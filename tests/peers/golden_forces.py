#!/usr/bin/python3
"""Writes golden/forces.csv: reaction forces and energies of the bundled organ as GetFEM computes them.

    /usr/bin/python3 golden_forces.py [--mesh-dir ../../assets] [--csv golden/forces.csv]

Straight paths in steps of 1 mm. A path ends, with a note on stderr, where Newton's method fails or a tet
inverts. The definitions of force and energy are in getfem_model.py.
"""

import argparse
import datetime
import pathlib
import subprocess
import sys

from getfem_model import LAWS, Failed, Model, np, read_scene

HERE = pathlib.Path(__file__).resolve().parent
STEP_M = 1e-3
# Opposite to the outward normals of assets/README.md: A1's is (-0.05, 0.13, 0.99), A2's (0.67, 0.15, 0.73).
INWARD = {"A1": (0.05, -0.13, -0.99), "A2": (-0.67, -0.15, -0.73)}
TANGENT = {"A1": (1.0, 0.0, 0.0), "A2": (0.0, 1.0, 0.0)}
# Steps (mm) that are written to the table.
SHORT = (1, 2, 3, 4, 5)
MEDIUM = (1, 2, 3, 4, 6, 8, 10, 12)
LONG = MEDIUM + (16, 20, 25)


def cases():
    """(mesh, law, order, fixed, active node, name of the direction, steps)"""
    for law in LAWS:
        steps = {"linear": (1, 12), "mooney-rivlin": LONG}.get(law, MEDIUM)
        for node in ("A1", "A2"):
            for direction in ("inward", "tangent"):
                yield "liver-small", law, 1, "F1", node, direction, steps
    yield "liver-small", "mooney-rivlin", 1, "F2", "A1", "inward", SHORT
    yield "liver-small", "st-venant-kirchhoff", 2, "F1", "A1", "inward", SHORT
    yield "liver-small", "mooney-rivlin", 2, "F1", "A1", "inward", SHORT
    yield "liver-large", "mooney-rivlin", 1, "F1", "A2", "inward", SHORT


def version():
    """Debian's version of GetFEM, or 'unknown': GetFEM's interface does not report its own version."""
    query = subprocess.run(["dpkg-query", "-W", "-f", "${Version}", "python3-getfem"], capture_output=True, text=True)
    return query.stdout or "unknown"


def main():
    arguments = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    arguments.add_argument("--mesh-dir", default=HERE.parent.parent / "assets")
    arguments.add_argument("--csv", default=HERE / "golden" / "forces.csv")
    options = arguments.parse_args()

    lines = [
        f"# GetFEM {version()} (Debian), {datetime.date.today()}, by: python3 tests/peers/golden_forces.py",
        "case,mesh,law,order,fixed,active_node,dx_m,dy_m,dz_m,fx_n,fy_n,fz_n,energy_j",
    ]
    scenes, worst = {}, 0.0
    for mesh_name, law, order, fixed, node, direction, steps in cases():
        if mesh_name not in scenes:
            scenes[mesh_name] = read_scene(options.mesh_dir, mesh_name)
        mesh, nodes = scenes[mesh_name]
        case = f"{mesh_name}-{law}-p{order}-{fixed}-{node}-{direction}".lower()
        model = Model(mesh, law, order, mesh.groups[fixed], nodes[node])
        unit = np.array({"inward": INWARD, "tangent": TANGENT}[direction][node])
        unit /= np.linalg.norm(unit)
        state, written = model.rest, 0
        for step in range(1, max(steps) + 1):
            displacement = step * STEP_M * unit
            try:
                state, force, iterations, residual = model.solve_at(displacement, state, tolerance=1e-10, final_corrections=2)
                smallest = model.smallest_jacobian(state)
                if smallest <= 0 and law != "linear":
                    raise Failed(f"inverted tet, J = {smallest:.3f}")
            except Failed as failure:
                print(f"{case}: ends before {step} mm: {failure}", file=sys.stderr)
                break
            worst = max(worst, residual)
            if step in steps:
                place = ",".join(repr(float(x)) for x in displacement)
                values = ",".join(f"{x:.17g}" for x in (*force, model.energy(state)))
                lines.append(f"{case},{mesh_name},{law},{order},{fixed},{nodes[node]},{place},{values}")
                written += 1
        print(
            f"{case}: {written} rows, last {iterations} iterations, residual {residual:.0e}, smallest J {smallest:.3f}",
            file=sys.stderr,
            flush=True,
        )
    pathlib.Path(options.csv).write_text("\n".join(lines) + "\n", encoding="ascii")
    print(f"{len(lines) - 2} rows, largest residual {worst:.1e} of the reaction", file=sys.stderr)


if __name__ == "__main__":
    main()
