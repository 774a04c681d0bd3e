#!/usr/bin/env python3
"""The mesh table of ../docs/measurements.md: forces of a point, a patch and a pad over the lump and beside it, on several meshes.

    python3 make_lump.py FOLDER 12 9 7 5.5 4
    python3 measure_lump.py PALPATE FOLDER [SIZE ...] [--tools TOOL ...] [--models MODEL ...]

PALPATE is the program. Without SIZE, all of FOLDER/lump-SIZE.msh are measured.

Pushes 5 and 10 mm deep along the inward normal by `palpate path` in steps of 2 mm (the pad to 12 mm). Seconds are those of a processor for a
step of the path after the first one, so without reading the mesh. Needs Python 3.11 only. Prints Markdown.

Licence: MIT OR Apache-2.0, as the rest of the project.
"""

import argparse
import csv
import json
import resource
import subprocess
import sys
from pathlib import Path

# Places (x, z) on the skin and inward normals, of make_lump.py.
PLACES = {"lump": (0.022, (-0.30070053, 0.0, -0.95371861)), "beside": (-0.022, (0.30070053, 0.0, -0.95371861))}
PLACE_Z = 0.0446569144

# Law, order, pair of displacement and pressure.
MODELS = {
    "NH P1": ("neo-hookean", "1", None),
    "NH P2 near tool": ("neo-hookean", '"tool"', None),
    "NH P2": ("neo-hookean", "2", None),
    "MR P1/P1": ("mooney-rivlin", "1", "plain"),
    "MR P1/P1 stabilised": ("mooney-rivlin", "1", "stabilised"),
    "MR P2/P1 near tool": ("mooney-rivlin", '"tool"', "plain"),
    "MR P2/P1": ("mooney-rivlin", "2", "plain"),
}
PAD = '[tool]\nshape = "fingertip"\nradius_m = 0.01\nstiffness_pa_m = 2e6\n'
# Table [tool], the key of the place, and a key of [mesh].
TOOLS = {
    "pad": (PAD, "point", ""),
    "pad, refined": (PAD, "point", 'refine = "tool"\n'),
    "pad, Hertz": (PAD + 'profile = "hertz"\n', "point", ""),
    "point": ("", "nearest", ""),
    "patch": ("", "nearest", ""),
}


def scene(mesh, model, tool):
    law, order, pressure = MODELS[model]
    table, key, refine = TOOLS[tool]
    constants = lambda stiff: (
        f"mu_pa = {1400.0 * stiff}\nlambda_pa = {12600.0 * stiff}" if law == "neo-hookean" else f"c10_pa = {350.0 * stiff}\nc01_pa = {350.0 * stiff}"
    )
    text = f'[mesh]\nfile = "{mesh}"\norder = {order}\n{refine}[fixed]\ngroup = "base"\n'
    for group, stiff in (("tissue", 1), ("lump", 10)):
        text += f'[[material]]\ngroup = "{group}"\nlaw = "{law}"\n{constants(stiff)}\n'
    for name, (x, _) in PLACES.items():
        text += f'[[active]]\nname = "{name}"\n{key} = [{x}, 0.0, {PLACE_Z}]\n'
        text += "patch_radius_m = 0.008\n" if tool == "patch" else ""
    return text + table + (f'[solver]\npressure = "{pressure}"\n' if pressure == "stabilised" else "")


def processor_s():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def path(program, file, active, depths_mm):
    """Rows of the CSV and seconds."""
    controls = file.with_suffix(".controls.csv")
    rows = [",".join(f"{1e-3 * depth * c:.12g}" for c in PLACES[active][1]) for depth in depths_mm]
    controls.write_text("x_m,y_m,z_m\n" + "\n".join(rows) + "\n")
    begun = processor_s()
    done = subprocess.run(
        [program, "path", file, "--active", active, "--controls", controls, "--csv", "-"], capture_output=True, text=True
    )
    seconds = processor_s() - begun
    table = [line for line in done.stdout.splitlines() if "," in line]
    return list(csv.DictReader(table)), seconds, done.stderr


def force_n(row):
    return sum(float(row[key]) ** 2 for key in ("fx_n", "fy_n", "fz_n")) ** 0.5


def measure(program, folder, size, model, tool):
    """Forces by place and depth, seconds of a configuration, most iterations of a step of 2 mm, nodes with a displacement."""
    file = folder / f"measured-{size}.toml"
    file.write_text(scene(f"lump-{size}.msh", model, tool))
    depths = [2, 4, 5, 6, 8, 10] + ([12] if TOOLS[tool][0] else [])
    forces, seconds, most = {}, 0.0, 0
    for active in PLACES:
        rows, whole, errors = path(program, file, active, depths)
        _, first, _ = path(program, file, active, depths[:1])
        solved = {depth: row for depth, row in zip(depths, rows) if row["status"] == "ok"}
        if len(solved) < len(depths):
            print(f"{size} {model} {tool} {active}: {errors.strip().splitlines()[-1:]}", file=sys.stderr)
        seconds += (whole - first) / max(len(rows) - 1, 1) / len(PLACES)
        most = max([most, *(int(row["newton_iterations"]) for row in rows)])
        forces.update({(active, depth): force_n(solved[depth]) for depth in (5, 10) if depth in solved})
    inspected = subprocess.run([program, "inspect", file, "--json"], capture_output=True, text=True, check=True).stdout
    mesh = json.loads(inspected)["mesh"]
    return forces, seconds, most, mesh["nodes"] + (mesh["edges"] if MODELS[model][1] != "1" else 0)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("program")
    parser.add_argument("folder", type=Path)
    parser.add_argument("sizes", nargs="*")
    parser.add_argument("--tools", nargs="+", choices=TOOLS, default=list(TOOLS))
    parser.add_argument("--models", nargs="+", choices=MODELS, default=list(MODELS))
    given = parser.parse_args()
    program, folder, sizes = given.program, given.folder, given.sizes
    if not sizes:
        found = [path.stem.removeprefix("lump-") for path in folder.glob("lump-*.msh")]
        sizes = sorted(found, key=lambda size: -float(size))
    print("| mesh, mm | model | tool | nodes | 5 mm: lump / beside, N | 10 mm: lump / beside, N | s a configuration | Newton, at most |")
    print("|---|---|---|---|---|---|---|---|")
    for size in sizes:
        for model in given.models:
            for tool in given.tools:
                forces, seconds, most, nodes = measure(program, folder, size, model, tool)
                figure = lambda key: f"{forces[key]:.4f}" if key in forces else "-"
                cells = " | ".join(" / ".join(figure((active, depth)) for active in PLACES) for depth in (5, 10))
                print(f"| {size} | {model} | {tool} | {nodes:,} | {cells} | {seconds:.2f} | {most} |", flush=True)


if __name__ == "__main__":
    main()
