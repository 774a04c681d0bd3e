#!/usr/bin/python3
"""Measures a finite-element code's times for the bodies of the paper's Table 1 and a larger one, on the bundled organ.

    /usr/bin/python3 bodies_bench.py --code getfem|felupe|dolfinx [--cases a,b] [--mesh-dir ../../assets] [--csv FILE]
        [--repetitions N] [--clock cpu] [--one-step]

Seconds are wall time (or CPU time) of the code's own calls, on one thread and one core: assembly of residual and
tangent, and the direct solver's factorisation and back-solve, with its analysis where the code does not keep it.
Newton's loop, copies and the elimination in Python are not counted. Fixed: F1; active: A2, moved inward along
(-0.67, -0.15, -0.73).

The time of an iteration is the median over a step of 1 mm from rest. A configuration at 15 mm is solved from
its neighbour at 5 mm, either in ten increments of 1 mm, or in one step from the tangent predictor u + du/dd
10 mm (a by-product of the neighbour, so not counted). Both end at a residual of 1e-8 of the reaction. The force,
after one more iteration that is not counted, is the tool's on the body at 15 mm.
"""

import argparse
import csv
import importlib
import os
import pathlib
import statistics
import sys

import newton
from newton import Failed, np
from organ_mesh import read_scene

HERE = pathlib.Path(__file__).resolve().parent
# code: module with the class Model(mesh, law, order, fixed, active)
CODES = {"getfem": "getfem_model", "felupe": "felupe_model", "dolfinx": "dolfinx_model"}
# case: (mesh, law, order, repetitions)
CASES = {
    "stvk-p1-small": ("liver-small", "st-venant-kirchhoff", 1, 5),
    "mr-p1p1-small": ("liver-small", "mooney-rivlin", 1, 5),
    "stvk-p1-large": ("liver-large", "st-venant-kirchhoff", 1, 3),
    "mr-p2p1-small": ("liver-small", "mooney-rivlin", 2, 1),
    "mr-p1p1-large": ("liver-large", "mooney-rivlin", 1, 2),
}
# Beyond the paper, only by name.
LARGER = {"mr-p2p1-large": ("liver-large", "mooney-rivlin", 2, 1)}
FIXED, ACTIVE, INWARD = "F1", "A2", np.array([-0.67, -0.15, -0.73])
INWARD = INWARD / np.linalg.norm(INWARD)
STEP_M, NEIGHBOUR_MM, TARGET_MM = 1e-3, 5, 15
TOLERANCE = 1e-8

COLUMNS = (
    "case,equations,assembly_s,solve_s,iteration_s,iterations_1mm,config_10mm_increments_s,config_10mm_onestep_s,"
    "onestep_iterations,fx_n,fy_n,fz_n,status"
).split(",")


def seconds(record):
    return sum(assembly + (solve or 0.0) for assembly, solve in record)


def first_step(model, repetitions):
    """1 mm from rest: (state, iterations, (assembly, solve) of every iteration of every repetition)."""
    record = []
    for _ in range(repetitions):
        state, _, iterations, _ = model.solve_at(STEP_M * INWARD, model.rest, TOLERANCE, record=record)
    return state, iterations, [pair for pair in record if pair[1] is not None]


def increments(model, state, start, end):
    """From `start` to `end` mm in steps of 1 mm: (state, seconds)."""
    record = []
    for step in range(start + 1, end + 1):
        try:
            state, *_ = model.solve_at(step * STEP_M * INWARD, state, TOLERANCE, record=record)
        except Failed as failure:
            raise Failed(f"{step} mm: {failure}") from None
    return state, seconds(record)


def predicted(model, neighbour):
    """The guess at TARGET_MM: x = -K^-1 K_fA d, with the code's tangent at the neighbour."""
    model.residual(neighbour)
    tangent, _ = model.tangent()
    increment = (TARGET_MM - NEIGHBOUR_MM) * STEP_M * INWARD
    predictor, _ = model.solve_linear(tangent, -model.coupling(tangent, increment))
    guess = neighbour.copy()
    guess[model.free] += predictor
    return guess


def one_step(model, guess):
    """To TARGET_MM at once: (state, iterations, seconds)."""
    record = []
    target = TARGET_MM * STEP_M * INWARD
    state, _, iterations, _ = model.solve_at(target, guess, TOLERANCE, record=record)
    return state, iterations, seconds(record)


def measure(model_of, case, mesh_dir, repetitions=None, with_increments=True):
    mesh_name, law, order, default = {**CASES, **LARGER}[case]
    repetitions = repetitions or default
    mesh, nodes = read_scene(mesh_dir, mesh_name)
    model = model_of(mesh, law, order, mesh.groups[FIXED], nodes[ACTIVE])
    row = {"case": case, "equations": len(model.free)}
    status = []
    try:
        state, row["iterations_1mm"], pairs = first_step(model, repetitions)
        row["assembly_s"] = statistics.median(assembly for assembly, _ in pairs)
        row["solve_s"] = statistics.median(solve for _, solve in pairs)
        row["iteration_s"] = statistics.median(assembly + solve for assembly, solve in pairs)
        neighbour, _ = increments(model, state, 1, NEIGHBOUR_MM)
    except Failed as failure:
        return row | {"status": f"failed: {failure}"}
    guess = predicted(model, neighbour)

    ends = []
    try:
        if with_increments:
            runs = [increments(model, neighbour, NEIGHBOUR_MM, TARGET_MM) for _ in range(repetitions)]
            row["config_10mm_increments_s"] = statistics.median(taken for _, taken in runs)
            ends.append(runs[0][0])
    except Failed as failure:
        status.append(f"increments failed: {failure}")
    try:
        runs = [one_step(model, guess) for _ in range(repetitions)]
        row["onestep_iterations"] = runs[0][1]
        row["config_10mm_onestep_s"] = statistics.median(taken for _, _, taken in runs)
        ends.append(runs[0][0])
        _, force, *_ = model.solve_at(TARGET_MM * STEP_M * INWARD, runs[0][0], TOLERANCE, final_corrections=1)
        row |= dict(zip(("fx_n", "fy_n", "fz_n"), force))
    except Failed as failure:
        status.append(f"one step failed: {failure}")
    if len(ends) == 2 and np.abs(ends[0] - ends[1])[model.u].max() > 1e-8:
        status.append("increments and one step end in different states")
    if any(model.smallest_jacobian(end) <= 0 for end in ends):
        status.append("a tet is inverted")
    return row | {"status": "; ".join(status) or "ok"}


def main(code=None, description=__doc__):
    arguments = argparse.ArgumentParser(description=description.split("\n")[0])
    if code is None:
        arguments.add_argument("--code", choices=CODES, required=True, help="finite-element code")
    arguments.add_argument("--cases", default=",".join(CASES), help="some of " + ",".join([*CASES, *LARGER]))
    arguments.add_argument("--mesh-dir", type=pathlib.Path, default=HERE.parent.parent / "assets")
    arguments.add_argument("--csv", help="file to write; standard output without it")
    arguments.add_argument("--repetitions", type=int, help="of every measurement, instead of 1 to 5 by size")
    arguments.add_argument("--clock", choices=("wall", "cpu"), default="wall", help="cpu: for a busy machine")
    arguments.add_argument("--one-step", action="store_true", help="without the increments of 1 mm")
    options = arguments.parse_args()
    if options.clock == "cpu":
        newton.use_cpu_time()
    names = options.cases.split(",")
    for name in names:
        if name not in CASES and name not in LARGER:
            arguments.error(f"unknown case {name!r}; known: {', '.join([*CASES, *LARGER])}")
    if not options.mesh_dir.is_dir():
        arguments.error(f"folder not found: {options.mesh_dir}")
    model_of = importlib.import_module(CODES[code or options.code]).Model
    # One core, the last available one, because the first handles most interrupts.
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})

    with open(options.csv, "w", encoding="utf-8") if options.csv else sys.stdout as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        for name in names:
            row = measure(model_of, name, options.mesh_dir, options.repetitions, not options.one_step)
            force = ("fx_n", "fy_n", "fz_n")
            digits = {key: ".17g" if key in force else ".6g" for key in row}
            text = {key: f"{x:{digits[key]}}" if isinstance(x, float) else x for key, x in row.items()}
            writer.writerow(text)
            file.flush()


if __name__ == "__main__":
    main()
