#!/usr/bin/python3
"""Writes golden/indentation*.csv: forces of indentation tests as GetFEM computes them, for fitting parameters.

    /usr/bin/python3 golden_indentation.py [--mesh-dir ../../assets] [--out golden] [--only NAME]

Each test is a straight path from rest with equal steps. Force: by the tool ON the body at the active node. No
noise is added. Exits with 1 and one line if a path does not converge to its end or a tet inverts.
"""

import argparse
import pathlib
import sys
import time

from getfem_model import Failed, Model, lame, np, read_scene

HERE = pathlib.Path(__file__).resolve().parent
# Directions of A1 as in golden_forces.py: opposite to its outward normal, and along the surface.
A1_INWARD, A1_ALONG = (0.05, -0.13, -0.99), (1.0, 0.0, 0.0)
# Node 235 of tumour.msh lies on the surface and belongs to the tumour. Its outward normal is (0.29, 0.09, 0.95);
# y is within 6 degrees of the surface.
ABOVE_INWARD, ABOVE_ALONG = (-0.29, -0.09, -0.95), (0.0, 1.0, 0.0)
# Of the tumour, ten times those of the tissue round it (assets/scenes/tumour.toml).
TUMOUR_C10_PA, TUMOUR_C01_PA = 13000.0, 12800.0
TISSUE_C10_PA, TISSUE_C01_PA = 1300.0, 1280.0


def scaled(direction, sign, length_m, points):
    """Displacements of one test, points x 3, m: equal steps along a direction of any length."""
    unit = np.array(direction) / np.linalg.norm(direction)
    return sign * np.outer(np.arange(1, points + 1) * (length_m / points), unit)


ON_A1 = {
    "push": scaled(A1_INWARD, 1, 0.020, 20),
    "pull": scaled(A1_INWARD, -1, 0.020, 20),
    "side": scaled(A1_ALONG, 1, 0.015, 20),
}
ABOVE_TUMOUR = {
    "push": scaled(ABOVE_INWARD, 1, 0.015, 15),
    "side": scaled(ABOVE_ALONG, 1, 0.012, 15),
}


def two_regions(mesh):
    """C10 and C01 of each tet, Pa."""
    c10, c01 = (np.full(len(mesh.tets), value) for value in (TISSUE_C10_PA, TISSUE_C01_PA))
    c10[mesh.regions["tumour"]], c01[mesh.regions["tumour"]] = TUMOUR_C10_PA, TUMOUR_C01_PA
    return {"c10": c10, "c01": c01}


# file: (scene, active node, law, parameters of a mesh, tests); order 1, F1 fixed
TABLES = {
    "indentation": ("liver-small", "A1", "mooney-rivlin", lambda mesh: {"c10": 1300.0, "c01": 1280.0}, ON_A1),
    "indentation_neo_hookean": ("liver-small", "A1", "neo-hookean", lambda mesh: lame(15480.0, 0.45), ON_A1),
    "indentation_two_regions": ("scenes/tumour", "above", "mooney-rivlin", two_regions, ABOVE_TUMOUR),
}


def run(model, displacements):
    """One test from rest: (forces points x 3 / N, largest relative residual, most iterations, least det F)."""
    state, forces, residuals, iterations, jacobians = model.rest, [], [], [], []
    for displacement in displacements:
        state, force, taken, residual = model.solve_at(displacement, state, tolerance=1e-10, final_corrections=2)
        smallest = model.smallest_jacobian(state)
        if smallest <= 0:
            raise Failed(f"inverted tet, J = {smallest:.3f}")
        forces.append(force)
        residuals.append(residual)
        iterations.append(taken)
        jacobians.append(smallest)
    return np.array(forces), max(residuals), max(iterations), min(jacobians)


def main():
    arguments = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    arguments.add_argument("--mesh-dir", default=HERE.parent.parent / "assets")
    arguments.add_argument("--out", default=HERE / "golden", help="folder of the tables")
    arguments.add_argument("--only", choices=TABLES, help="write this table only")
    options = arguments.parse_args()

    for name in [options.only] if options.only else TABLES:
        scene, node, law, parameters, tests = TABLES[name]
        mesh, nodes = read_scene(options.mesh_dir, scene)
        regions = list(mesh.regions.values())
        model = Model(mesh, law, 1, mesh.groups["F1"], nodes[node], parameters(mesh), regions)
        lines = ["test,dx_m,dy_m,dz_m,fx_n,fy_n,fz_n"]
        for test, displacements in tests.items():
            start = time.perf_counter()
            try:
                forces, residual, iterations, smallest = run(model, displacements)
            except Failed as failure:
                sys.exit(f"{name}: {test}: {failure}; shorten this test in TABLES")
            for row in np.hstack([displacements, forces]):
                lines.append(f"{test}," + ",".join(f"{value:.17g}" for value in row))
            print(
                f"{name} {test}: {len(forces)} rows, |f| {np.linalg.norm(forces[-1]):.3f} N at the end, "
                f"at most {iterations} iterations, residual {residual:.0e}, smallest J {smallest:.3f}, "
                f"{time.perf_counter() - start:.1f} s",
                file=sys.stderr,
            )
        text = "\n".join(lines) + "\n"
        (pathlib.Path(options.out) / f"{name}.csv").write_text(text, encoding="ascii", newline="\n")


if __name__ == "__main__":
    main()
