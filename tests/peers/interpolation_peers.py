#!/usr/bin/env python3
"""Forces of public interpolators at given displacements, from the table of samples in a blob, and their times.

    interpolation_peers.py FILE.blob --active A1 --points IN.csv --json OUT.json [--seconds S]

interpn and SciPy, with the samples that Palpate's own methods have: the box of forces for grids, the solved points for
radial basis functions. In double precision, built once, on one thread. Each is timed alone (one call from Python for
each position) and in one call for all positions: medians, for three components of the force.
"""

import argparse
import json
import pathlib
import statistics
import time

# First, because it limits the BLAS of numpy to one thread.
from newton import np

import interpn
from scipy.interpolate import RBFInterpolator, RegularGridInterpolator

from read_blob import SOLVED, Blob

ALONE = 200
LEAST, MOST = 5, 200


def samples(space):
    """(axis of the box, m; forces on it, n x n x n x 3; solved places in cells, forces there)"""
    steps = np.arange(space.side) - space.reach - 1
    box = space.force.reshape(space.side, space.side, space.side, 3)
    solved = np.argwhere((space.flags & SOLVED).reshape(box.shape[:3]) != 0)
    return steps * space.spacing_m, box, steps[solved].astype(float), box[tuple(solved.T)]


def interpn_of(method):
    """An interpolator of interpn, one for each component."""

    def build(axis, box, _centres, _forces):
        dims = [len(axis)] * 3
        starts, steps = np.full(3, axis[0]), np.full(3, axis[1] - axis[0])
        parts = [np.ascontiguousarray(box[..., n]) for n in range(3)]
        if method == "b-spline":
            splines = [interpn.MultiBsplineRegular.new(dims, starts, steps, part) for part in parts]

            def ask_spline(points):
                columns = [np.ascontiguousarray(points[:, n]) for n in range(3)]
                return np.stack([spline.eval(columns) for spline in splines], axis=1)

            return ask_spline
        dims = np.array(dims)
        flat = [part.ravel() for part in parts]

        def ask(points):
            columns = [np.ascontiguousarray(points[:, n]) for n in range(3)]
            answers = np.empty((3, len(points)))
            for part, answer in zip(flat, answers):
                if method == "linear":
                    interpn.raw.interpn_linear_regular_f64(dims, starts, steps, part, columns, answer)
                else:
                    interpn.raw.interpn_cubic_regular_f64(dims, starts, steps, part, False, columns, answer)
            return answers.T

        return ask

    return build


def scipy_grid(method):
    def build(axis, box, _centres, _forces):
        return RegularGridInterpolator((axis, axis, axis), box, method=method)

    return build


def scipy_rbf(kernel):
    def build(axis, _box, centres, forces):
        fit, spacing_m = RBFInterpolator(centres, forces, kernel=kernel), axis[1] - axis[0]
        return lambda points: fit(points / spacing_m)

    return build


# name: (Palpate's method of the same kind, function that builds it)
PEERS = {
    "interpn linear": ("trilinear", interpn_of("linear")),
    "interpn cubic": ("tricubic", interpn_of("cubic")),
    "interpn B-spline": ("tricubic", interpn_of("b-spline")),
    "SciPy grid linear": ("trilinear", scipy_grid("linear")),
    "SciPy grid cubic": ("tricubic", scipy_grid("cubic")),
    "SciPy RBF linear": ("rbf-linear", scipy_rbf("linear")),
    "SciPy RBF cubic": ("rbf-cubic", scipy_rbf("cubic")),
}


def median_s(call, budget_s):
    """Median seconds of a call."""
    begun, times = time.perf_counter(), []
    while len(times) < LEAST or (len(times) < MOST and time.perf_counter() - begun < budget_s):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def measure(build, data, points, budget_s):
    start = time.perf_counter()
    ask = build(*data)
    build_s = time.perf_counter() - start
    answers = ask(points)
    singles = [points[n : n + 1] for n in range(min(ALONE, len(points)))]
    batch_s = median_s(lambda: ask(points), budget_s)
    alone_s = median_s(lambda: [ask(point) for point in singles], budget_s)
    return {
        "build_s": build_s,
        "alone_ns": 1e9 * alone_s / len(singles),
        "batch_ns": 1e9 * batch_s / len(points),
        "answers": answers.tolist(),
    }


def main():
    arguments = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    arguments.add_argument("blob", type=pathlib.Path)
    arguments.add_argument("--active", required=True)
    arguments.add_argument("--points", type=pathlib.Path, required=True)
    arguments.add_argument("--json", type=pathlib.Path, required=True)
    arguments.add_argument("--seconds", type=float, default=1.0, help="at most for each time")
    options = arguments.parse_args()
    blob = Blob(options.blob.read_bytes())
    data = samples(next(space for space in blob.spaces if space.name == options.active))
    # The core takes displacements as f32.
    points = np.loadtxt(options.points, delimiter=",", skiprows=1).astype(np.float32).astype(float)
    rows = []
    for name, (compared, build) in PEERS.items():
        rows.append({"name": name, "compared": compared} | measure(build, data, points, options.seconds))
    options.json.write_text(json.dumps(rows), encoding="ascii")


if __name__ == "__main__":
    main()
