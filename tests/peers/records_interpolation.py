"""Part `interpolation`: force errors against finite-element truths and times, from the same table of samples."""

import csv
import json
import shutil

from records_run import Failure, Figure, scene

NODE, ACTIVE = 199, "A1"
METHODS = "trilinear,tricubic,hybrid,rbf-linear,rbf-cubic,hermite,energy"
# Lattice points of the tables, and number of truths.
GRIDS, TRUTHS = (514, 1418), 600
QUICK_GRIDS, QUICK_TRUTHS = (514,), 100
ERRORS = ("mean error", "p99 error", "largest error")
ALONE, BATCH = "query alone", "query of a batch"


def table(run, grid, truths):
    """Solves one table and its truths: (blob, file of the positions, truths as rows of three, N)."""
    folder = run.out / "work"
    folder.mkdir(exist_ok=True)
    shutil.copy(run.assets / "liver-small.msh", folder)
    path, space, blob = (folder / f"lattice-{grid}.{kind}" for kind in ("toml", "space", "blob"))
    path.write_text(scene(NODE, ACTIVE, f"points = {grid}"), encoding="ascii")
    for old in (space, blob):
        old.unlink(missing_ok=True)
    run.execute([run.palpate, "precompute", path, "--out", space], pinned=False)
    pack = ["pack", space, "--out", blob, "--uniform", truths, "--method", METHODS]
    run.execute([run.palpate, *pack], pinned=False)
    solved = folder / f"truths-{grid}.csv"
    run.execute([run.palpate, "inspect", space, "--held-out", solved, "--force"], pinned=False)
    with open(solved, encoding="ascii") as file:
        rows = [row for row in csv.DictReader(file) if row["kind"] == "uniform" and not row["failure"]]
    # Those beyond f_max are not felt.
    rows = [row for row in rows if row["tag"] == "expandable"]
    positions = folder / f"positions-{grid}.csv"
    lines = [",".join(row[name] for name in ("x_m", "y_m", "z_m")) for row in rows]
    positions.write_text("\n".join(["x_m,y_m,z_m", *lines]) + "\n", encoding="ascii")
    return blob, positions, [[float(row[name]) for name in ("fx_n", "fy_n", "fz_n")] for row in rows]


def errors(answers, truths):
    """Mean, 99th percentile and largest length of the error vector, mN."""
    if len(answers) != len(truths):
        raise Failure(f"{len(answers)} answers for {len(truths)} positions")
    lengths = sorted(
        1e3 * sum((a - b) ** 2 for a, b in zip(answer, truth)) ** 0.5 for answer, truth in zip(answers, truths)
    )
    return sum(lengths) / len(lengths), lengths[int(0.99 * (len(lengths) - 1))], lengths[-1]


def systems(run, blob, positions):
    """(name, Palpate's method of the same kind or None, answers, ns alone, ns in a batch or None) of every system."""
    rounds = 100 if run.quick else 400
    core = run.ask("bench", "core", "--blob", blob, "--points", positions, "--rounds", rounds, "--cpu", run.core)
    fastest = {}
    for row in core["rows"]:
        known = fastest.get(row["method"])
        if known is None or row["median_ns"] < known["median_ns"]:
            fastest[row["method"]] = row
    if not any(row["instructions"] == "peer" for row in fastest.values()):
        raise Failure("this palpate has no crates to compare with: build it with --features peers")
    for name, row in fastest.items():
        is_peer = row["instructions"] == "peer"
        label, compared = (name.replace(" ", " crate ", 1), name.split()[-1]) if is_peer else (name, None)
        # The core answers a batch one query after the other. The crates' figure counts once.
        yield label, compared, row["answers"], row["median_ns"], None if is_peer else row["median_ns"]
    out = run.out / "work" / "peers.json"
    command = [run.python, "-B", run.here / "interpolation_peers.py", blob, "--active", ACTIVE]
    run.execute([*command, "--points", positions, "--json", out, "--seconds", 0.3 if run.quick else 1.5])
    for row in json.loads(out.read_text(encoding="ascii")):
        yield row["name"], row["compared"], row["answers"], row["alone_ns"], row["batch_ns"]


def measure(run, _rows):
    figures = []
    for grid in QUICK_GRIDS if run.quick else GRIDS:
        run.say(f"interpolation, {grid} points")
        blob, positions, truths = table(run, grid, QUICK_TRUTHS if run.quick else TRUTHS)
        own = {}
        for name, compared, answers, alone_ns, batch_ns in systems(run, blob, positions):
            values = dict(zip(ERRORS, errors(answers, truths))) | {ALONE: alone_ns}
            values |= {} if batch_ns is None else {BATCH: batch_ns}
            if compared is None:
                own[name] = values
            system = f"Palpate {name}" if compared is None else name
            for quantity, value in values.items():
                unit = "mN" if quantity in ERRORS else "ns"
                ours = own[compared][quantity] if compared else None
                figures.append(
                    Figure("interpolation", f"{grid} points", quantity, unit, system, value, ours, compared or "")
                )
    return figures
