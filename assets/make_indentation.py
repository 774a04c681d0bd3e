#!/usr/bin/env python3
"""Writes scenes/indentation.csv: GetFEM's forces on the small organ with the noise of a force sensor.

    python3 make_indentation.py

The exact forces are tests/peers/golden/indentation.csv: C10 = 1300 Pa, C01 = 1280 Pa. Noise: independent Gaussian numbers of
10 mN in each component. Units: millimetres and newtons, as a laboratory writes them.
"""

import csv
import pathlib
import random

HERE = pathlib.Path(__file__).resolve().parent
NOISE_N, SEED = 0.010, 1


def main():
    source = random.Random(SEED)
    with open(HERE / "../tests/peers/golden/indentation.csv", encoding="ascii") as table:
        rows = list(csv.DictReader(table))
    lines = ["test,dx_mm,dy_mm,dz_mm,fx_n,fy_n,fz_n"]
    for row in rows:
        place = [f"{1e3 * float(row[key]):.6g}" for key in ("dx_m", "dy_m", "dz_m")]
        force = [f"{float(row[key]) + source.gauss(0.0, NOISE_N):.4f}" for key in ("fx_n", "fy_n", "fz_n")]
        lines.append(",".join([row["test"], *place, *force]))
    (HERE / "scenes/indentation.csv").write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")


if __name__ == "__main__":
    main()
