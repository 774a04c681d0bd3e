"""A block of rubber that is solved in a second."""

import signal
from pathlib import Path

import numpy as np
import palpate
import pytest

# A background job of a shell ignores Ctrl-C.
signal.signal(signal.SIGINT, signal.default_int_handler)

ASSETS = Path(__file__).resolve().parents[3] / "assets"
EDGE_M = 0.01
CELLS = (4, 4, 2)
MATERIAL = {"law": "neo-hookean", "young_pa": 6000.0, "poisson": 0.4}
GRID = {"radius_m": 4e-3, "spacing_m": 2e-3}


def block():
    """Nodes (75, 3) and tets (192, 4) of a block of cubes, each of six tets round its main diagonal."""
    nx, ny, nz = CELLS
    nodes_m = EDGE_M * np.array(
        [(i, j, k) for i in range(nx + 1) for j in range(ny + 1) for k in range(nz + 1)], float
    )
    tets = []
    for low in np.ndindex(*CELLS):
        for order in [(0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (2, 1, 0), (1, 0, 2)]:
            corner, tet = list(low), []
            for axis in [None, *order]:
                if axis is not None:
                    corner[axis] += 1
                tet.append((corner[0] * (ny + 1) + corner[1]) * (nz + 1) + corner[2])
            if order in [(0, 2, 1), (2, 1, 0), (1, 0, 2)]:
                tet[2], tet[3] = tet[3], tet[2]
            tets.append(tet)
    return nodes_m, np.array(tets)


def scene_of(nodes_m, tets, **changes):
    """The block, held at the bottom and touched in the middle of its top."""
    right_m = block()[0]
    bottom = np.flatnonzero(right_m[:, 2] == 0.0)
    middle = int(np.argmin(np.linalg.norm(right_m - 2 * EDGE_M, axis=1)))
    tables = {"material": MATERIAL, "fixed": "bottom", "active": {"A1": middle}, "groups": {"bottom": bottom}}
    tables |= {"grid": GRID, "name": "block"}
    return palpate.Scene.from_arrays(nodes_m, tets, **(tables | changes))


@pytest.fixture(scope="session")
def scene():
    return scene_of(*block())


@pytest.fixture(scope="session")
def files(scene, tmp_path_factory):
    """A folder with block.space and its certified block.blob."""
    folder = tmp_path_factory.mktemp("block")
    scene.precompute(folder / "block.space")
    palpate.pack(folder / "block.space", folder / "block.blob", methods=["energy", "trilinear"], held_out=30)
    return folder


@pytest.fixture(scope="session")
def organ(files):
    return palpate.Organ(files / "block.blob")
