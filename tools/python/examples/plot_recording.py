"""Force and depth of a recording against time: python plot_recording.py FILE.mcap PICTURE.png"""

import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import palpate


def main(recording_file: str, picture: str) -> None:
    """Draws the force for the hand and the displacement of the touched node."""
    recording = palpate.Recording(recording_file)
    figure, (force, depth) = plt.subplots(2, sharex=True, figsize=(8, 5))
    force.plot(recording.time_s, recording["hand_force_n"], label=["x", "y", "z"])
    force.set_ylabel("force for the hand, N")
    force.legend()
    depth.plot(recording.time_s, 1e3 * np.linalg.norm(recording["displacement_m"], axis=1))
    depth.set_ylabel("displacement, mm")
    depth.set_xlabel("time, s")
    touched = recording["engaged"] >= 0
    figure.suptitle(f"{recording.header['scene']}: {len(touched)} ticks, {touched.mean():.0%} in contact")
    figure.savefig(picture)
    largest_n = np.linalg.norm(recording["hand_force_n"], axis=1).max()
    print(f"{picture}: {recording!r}, largest force {largest_n:.3f} N")


if __name__ == "__main__":
    main(*sys.argv[1:3])
