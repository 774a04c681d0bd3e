"""One body by several material laws that agree at small strain: python compare_laws.py ASSETS

The shear modulus is mu = 2 (C10 + C01) = 5160 Pa for all. The compressible laws have Poisson's ratio 0.45.
"""

import sys

import numpy as np
import palpate

MU_PA = 5160.0
YOUNG = {"young_pa": 2 * MU_PA * (1 + 0.45), "poisson": 0.45}
LAWS = {
    "mooney-rivlin": {"c10_pa": 1300.0, "c01_pa": 1280.0},
    "neo-hookean": YOUNG,
    "st-venant-kirchhoff": YOUNG,
}


def main(assets: str) -> None:
    """Prints the force of each law at each depth, and checks that they agree where the strain is small."""
    depths_m = np.array([1e-4, 2e-3, 4e-3, 6e-3])
    forces_n = {}
    for law, constants in LAWS.items():
        scene = palpate.Scene.from_dict(
            {
                "name": law,
                "mesh": {"file": "liver-small.msh"},
                "material": {"law": law, **constants},
                "fixed": {"group": "F1"},
                "active": {"name": "A1", "node": 199, "patch_radius_m": 0.015},
            },
            folder=assets,
        )
        path = scene.path(-depths_m[:, None] * scene.normals[0])
        assert path.failure is None, path.failure
        forces_n[law] = -path.force_n @ scene.normals[0]
    print("depth mm " + "".join(f"{law:>22}" for law in forces_n))
    for row, depth_m in enumerate(depths_m):
        print(f"{1e3 * depth_m:8.1f} " + "".join(f"{of[row]:20.4f} N" for of in forces_n.values()))
    compressible = [forces_n[law][0] for law in ("neo-hookean", "st-venant-kirchhoff")]
    assert np.isclose(*compressible, rtol=0.02), compressible
    assert all(np.all(np.diff(of) > 0) for of in forces_n.values()), "a deeper press needs more force"


if __name__ == "__main__":
    main(sys.argv[1])
