#!/usr/bin/env python3
"""Ripple of a slide at constant depth over the bundled organ, for the table of ../docs/measurements.md.

    python3 measure_ripple.py PALPATE [FOLDER]

PALPATE is the program; FOLDER is for its scenes (default: the current one). The pad presses 6 mm deep at 49 places of a line along x, with
the same stiffness k A for every radius. Ripple: root mean square of the force about a polynomial of degree 6 in x, over the mean force. Needs
Python 3.11 only. Prints Markdown.

Licence: MIT OR Apache-2.0, as the rest of the project.
"""

import subprocess
import sys
from pathlib import Path

PLACES, FIRST_M, LAST_M = 49, -0.055, 0.035
DEPTH_MM, DEGREE = 6, 6
# Mean edge of the organ's skin on the line, m.
EDGE_M = 0.0149
ORDERS = {"P1/P1": "1", "P2/P1 near tool": '"tool"', "P2/P1": "2"}
RADII_M = (0.0149, 0.018, 0.022)


def scene(order, radius_m):
    mesh = Path(__file__).resolve().parent / "liver-small.msh"
    text = f'[mesh]\nfile = "{mesh}"\norder = {order}\n[material]\nlaw = "mooney-rivlin"\nc10_pa = 1300.0\nc01_pa = 1280.0\n'
    text += f'[fixed]\ngroup = "F1"\n[tool]\nshape = "fingertip"\nradius_m = {radius_m}\nstiffness_pa_m = {5e6 * (0.01 / radius_m) ** 2}\n'
    for n in range(PLACES):
        x_m = FIRST_M + (LAST_M - FIRST_M) * n / (PLACES - 1)
        text += f'[[active]]\nname = "p{n}"\npoint = [{x_m:.6f}, 0.0089, 0.0547]\n'
    return text


def force_n(program, file, place):
    command = [program, "path", file, "--active", place, "--direction=0,0,-1", "--step-mm", str(DEPTH_MM), "--steps", "1", "--csv", "-"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    row = [line for line in done.stdout.splitlines() if "," in line][-1].split(",")
    return sum(float(value) ** 2 for value in row[4:7]) ** 0.5


def ripple(forces):
    """Residual of the best polynomial, by polynomials that are orthogonal on the places."""
    dot = lambda a, b: sum(x * y for x, y in zip(a, b))
    left, basis = list(forces), []
    for degree in range(DEGREE + 1):
        column = [(2.0 * n / (PLACES - 1) - 1.0) ** degree for n in range(PLACES)]
        for _ in range(2):
            for other in basis:
                share = dot(column, other) / dot(other, other)
                column = [x - share * y for x, y in zip(column, other)]
        basis.append(column)
        share = dot(left, column) / dot(column, column)
        left = [x - share * y for x, y in zip(left, column)]
    return (dot(left, left) / PLACES) ** 0.5 / (sum(forces) / PLACES)


def main():
    program, folder = sys.argv[1], Path(sys.argv[2] if len(sys.argv) > 2 else ".")
    print("| ripple, % | " + " | ".join(f"a = {radius_m / EDGE_M:.1f} h" for radius_m in RADII_M) + " |")
    print("|---" * (len(RADII_M) + 1) + "|")
    for name, order in ORDERS.items():
        cells = []
        for radius_m in RADII_M:
            file = folder / "ripple.toml"
            file.write_text(scene(order, radius_m))
            cells.append(f"{100.0 * ripple([force_n(program, file, f'p{n}') for n in range(PLACES)]):.2f}")
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
