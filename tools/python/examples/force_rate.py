"""Positions a second of Organ.force on one core, and the same loop in Rust: python force_rate.py FILE.blob

The aims are a million positions a second, and at most 1.10 of the time in Rust for 100,000 positions a call. Other
load on the machine can hide the second one, so only the first is asserted.
"""

import os
import sys
import time

import numpy as np
import palpate

POSITIONS, ROUNDS = 100_000, 60


def main(blob: str) -> None:
    """Interleaves both, so that other load affects both, and compares the fastest rounds."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    organ = palpate.Organ(blob)
    random = np.random.default_rng(1)
    direction = random.normal(size=(POSITIONS, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    radius_m = organ.radius_m[0] * np.cbrt(random.random((POSITIONS, 1)))
    at_m = (radius_m * direction).astype(np.float32)
    out = np.empty_like(at_m)
    wide_m = at_m.astype(float)

    def seconds(call):
        # Once before, so that the arrays are in the cache, as those of the loop in Rust are.
        call()
        begun = time.perf_counter()
        call()
        return time.perf_counter() - begun

    rows = {
        "Rust": lambda: organ._seconds_in_rust(at_m, "energy"),
        "Python, float32, out": lambda: seconds(lambda: organ.force(at_m, method="energy", out=out)),
        "Python, float32": lambda: seconds(lambda: organ.force(at_m, method="energy")),
        "Python, float64": lambda: seconds(lambda: organ.force(wide_m, method="energy")),
    }
    taken = np.array([[row() for row in rows.values()] for _ in range(ROUNDS)]).min(axis=0)
    for name, least in zip(rows, taken):
        rate = 1e-6 * POSITIONS / least
        print(f"{name:22} {rate:6.2f} million positions a second, {least / taken[0]:.3f} of the time in Rust")
    assert POSITIONS / taken[1:].max() > 1e6, "less than a million positions a second"


if __name__ == "__main__":
    main(sys.argv[1])
