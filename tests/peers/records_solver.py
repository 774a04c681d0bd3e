"""Part `solver`: one Newton iteration and one configuration, by every finite-element code, with the same force."""

import csv
import io
import math
import statistics

from records_run import Failure, Figure

# Each code with its linear solver.
PEERS = {"getfem": "GetFEM, MUMPS", "felupe": "FElupe, PARDISO", "dolfinx": "DOLFINx, MUMPS with MKL"}
CASES = ("stvk-p1-small", "mr-p1p1-small", "stvk-p1-large", "mr-p2p1-small", "mr-p1p1-large", "mr-p2p1-large")
QUICK = ("stvk-p1-small", "mr-p1p1-small")
# Bodies of which an iteration takes tens of milliseconds are measured in one round.
ROUNDS = dict.fromkeys(QUICK, 3)
# Relative; the codes agree to rounding.
MOST_APART = 1e-8
# An iteration of the largest body takes seconds.
REPETITIONS, FEWER = 3, {"mr-p2p1-large": 1}
ITERATION, CONFIGURATION = "Newton iteration", "configuration"


def peer(run, code, case, repetitions):
    pythons = {"getfem": "/usr/bin/python3", "felupe": run.python, "dolfinx": run.here / "dolfinx-python"}
    command = [pythons[code], "-B", run.here / "bodies_bench.py", "--code", code, "--cases", case]
    command += ["--mesh-dir", run.assets, "--one-step", "--repetitions", repetitions]
    row = next(csv.DictReader(io.StringIO(run.execute(command))))
    if row["status"] != "ok":
        raise Failure(f"{PEERS[code]}, {case}: {row['status']}")
    force = [float(row[name]) for name in ("fx_n", "fy_n", "fz_n")]
    return float(row["iteration_s"]), float(row["config_10mm_onestep_s"]), force


def ours(run, case, repetitions):
    command = ["bench", "fem", "--assets", run.assets, "--cases", case, "--repetitions", repetitions]
    row = run.ask(*command)[0]
    if "force_n" not in row:
        raise Failure("this palpate is older than the records: it gives no force")
    return row["profile"]["iteration_s"], row["configuration_with_derivatives_s"], row["force_n"]


def same_force(case, name, force, expected):
    """Relative difference of two forces; fails if it is no rounding."""
    apart = math.dist(force, expected) / math.hypot(*expected)
    if not apart <= MOST_APART:
        raise Failure(f"{case}: the force of {name} is {force} N, Palpate's {expected} N: {apart:.1e} apart")
    return apart


def case_figures(run, case, rounds, repetitions):
    times = {name: ([], []) for name in ("Palpate", *PEERS)}
    apart = dict.fromkeys(PEERS, 0.0)
    for _ in range(rounds):
        run.say(f"solver, {case}")
        *seconds, expected = ours(run, case, repetitions)
        for collected, value in zip(times["Palpate"], seconds):
            collected.append(value)
        for code in PEERS:
            *seconds, force = peer(run, code, case, repetitions)
            apart[code] = max(apart[code], same_force(case, PEERS[code], force, expected))
            for collected, value in zip(times[code], seconds):
                collected.append(value)
    figures = []
    for column, quantity in enumerate((ITERATION, CONFIGURATION)):
        own = 1e3 * statistics.median(times["Palpate"][column])
        figures.append(Figure("solver", case, quantity, "ms", "Palpate", own))
        for code in PEERS:
            value = 1e3 * statistics.median(times[code][column])
            note = f"force {apart[code]:.1e} apart"
            figures.append(Figure("solver", case, quantity, "ms", PEERS[code], value, own, "bench fem", note))
    return figures


def measure(run, _rows, cases=None):
    figures = []
    for case in cases or (QUICK if run.quick else CASES):
        many = ROUNDS.get(case, 1), FEWER.get(case, REPETITIONS)
        rounds, repetitions = (1, 2) if run.quick else many
        figures += case_figures(run, case, rounds, repetitions)
    return figures
