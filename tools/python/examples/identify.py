"""Constants of an organ from measured forces: a table of an indentation, then the same as arrays.

python identify.py [ASSETS]        the folder assets of a clone
"""

import sys

import numpy as np

import palpate

assets = sys.argv[1] if len(sys.argv) > 1 else "assets"
scene = palpate.Scene(f"{assets}/scenes/indentation.toml")
found = scene.identify(f"{assets}/scenes/indentation.csv", ["c10_pa", "c01_pa"])
for name, constant in found.parameters.items():
    print(f"{name}: {constant.value:.0f} Pa, {constant.low:.0f} to {constant.high:.0f}")
print(f"correlation {found.correlation[0, 1]:.3f}, RMS residual {1e3 * found.rms_residual_n:.1f} mN")

# The fitted scene is a scene: how deep does it take 2 N?
push = found.displacement_m[:20]
path = found.scene.path(push)
force_n = np.linalg.norm(path.force_n, axis=1)
print(f"2 N at {1e3 * np.interp(2.0, force_n, np.linalg.norm(push, axis=1)):.1f} mm")

again = scene.identify({"displacement_m": push, "force_n": path.force_n}, ["c10_pa", "c01_pa"])
assert np.isclose(again.parameters["c10_pa"].value, found.parameters["c10_pa"].value, rtol=1e-6)
