"""Part `certified`: seconds from a scene to a force whose error is certified by held-out solutions."""

import shutil
import statistics
import time

import records_solver
from records_run import Figure, scene

NODE, ACTIVE = 336, "A2"
# The body of the scene among those of the solver part.
CASE = "mr-p1p1-small"
REPETITIONS = 3
QUANTITY = "time to a certified force"


def ours(run):
    """(seconds, certificate of the only space)"""
    folder = run.out / "work"
    folder.mkdir(exist_ok=True)
    shutil.copy(run.assets / "liver-small.msh", folder)
    path, space, blob = (folder / f"certified.{kind}" for kind in ("toml", "space", "blob"))
    path.write_text(scene(NODE, ACTIVE, "cannot_be_felt = true"), encoding="ascii")
    for old in (space, blob):
        old.unlink(missing_ok=True)
    start = time.perf_counter()
    run.execute([run.palpate, "precompute", path, "--out", space, "--threads", 1])
    certificate = run.ask("pack", space, "--out", blob, "--threads", 1)
    return time.perf_counter() - start, certificate["spaces"][0]


def measure(run, rows):
    rows = [row for row in rows if row.part == "solver" and row.case == CASE]
    rows = rows or records_solver.measure(run, [], [CASE])
    run.say("time to a certified force")
    runs = [ours(run) for _ in range(1 if run.quick else REPETITIONS)]
    seconds, space = statistics.median(taken for taken, _ in runs), runs[0][1]
    solves = space["cost"]["tries"] + space["cost"]["held_out"]
    energy = next(method for method in space["methods"] if method["method"] == "energy")["uniform"]
    note = (
        f"{space['cost']['tries']} solves to interpolate, {space['cost']['held_out']} held out; error mean "
        f"{1e3 * energy['mean_n']:.1f}, p99 {1e3 * energy['p99_n']:.1f}, largest {1e3 * energy['max_n']:.1f} mN; "
        f"below the JND at {energy['below_jnd']} of {energy['count']} positions"
    )
    case = f"{CASE}, adaptive sampling to 50 mm"
    figures = [Figure("certified", case, QUANTITY, "s", "Palpate", seconds, note=note)]
    for row in rows:
        if row.quantity == records_solver.CONFIGURATION and row.ours is not None:
            estimate = solves * row.value * 1e-3
            note = f"an estimate: {solves} configurations of {row.value:.1f} ms"
            beside = (estimate, seconds, "precompute, pack", note)
            figures.append(Figure("certified", case, QUANTITY, "s", row.system, *beside))
    return figures
