"""Scenes of files, dictionaries and arrays, and their paths."""

import json

import numpy as np
import palpate
import pytest
from conftest import ASSETS, MATERIAL, block, scene_of


def test_arrays_are_kept_as_given(scene):
    nodes_m, tets = block()
    assert np.array_equal(scene.nodes_m, nodes_m) and np.array_equal(scene.tets, tets)
    assert np.array_equal(scene.fixed, scene.groups["bottom"]) and len(scene.fixed) == 25
    assert scene.active == ["A1"] and np.allclose(scene.active_m, [[0.02, 0.02, 0.02]])
    assert np.allclose(scene.normals, [[0.0, 0.0, 1.0]])


def test_a_dictionary_is_the_scene_of_the_file():
    file = palpate.Scene(ASSETS / "liver-small.toml")
    tables = {
        "name": "liver-small",
        "mesh": {"file": "liver-small.msh"},
        "material": {"law": "mooney-rivlin", "c10_pa": np.float64(1300.0), "c01_pa": 1280.0},
        "fixed": {"nodes": file.fixed},
        "active": [{"name": name, "nearest": at} for name, at in zip(file.active, file.active_m)],
    }
    given = palpate.Scene.from_dict(tables, folder=ASSETS)
    down_m = [-2e-3 * file.normals[0]]
    assert np.array_equal(given.nodes_m, file.nodes_m) and np.array_equal(given.fixed, file.fixed)
    assert np.array_equal(given.path(down_m).force_n, file.path(down_m).force_n)


def test_the_force_of_a_path_is_the_gradient_of_its_energy(scene):
    at_m, step_m = np.array([1e-3, 0.5e-3, -3e-3]), 1e-6
    around = [at_m + sign * step_m * axis for axis in np.eye(3) for sign in (1, -1)]
    path = scene.path([0.5 * at_m, at_m, *around], keep_nodes=True)
    assert path.failure is None and path.stiffness_n_m.shape == (8, 3, 3)
    energy_j = path.energy_j[2:].reshape(3, 2)
    assert np.allclose((energy_j[:, 0] - energy_j[:, 1]) / (2 * step_m), path.force_n[1], rtol=1e-5)
    forces_n = path.force_n[2:].reshape(3, 2, 3)
    assert np.allclose((forces_n[:, 0] - forces_n[:, 1]) / (2 * step_m), path.stiffness_n_m[1], rtol=1e-4)
    middle = np.flatnonzero(np.all(np.isclose(scene.nodes_m, scene.active_m[0]), axis=1))[0]
    assert np.allclose(path.node_displacements_m[1, middle], at_m)
    assert not path.node_displacements_m[:, scene.fixed].any()


def test_regions_have_their_materials():
    nodes_m, tets = block()
    stiff = np.flatnonzero(nodes_m[tets].mean(axis=1)[:, 2] < 0.01)
    soft = np.setdiff1d(np.arange(len(tets)), stiff)
    regions = {"stiff": stiff, "soft": soft}
    of = lambda young_pa: [
        {**MATERIAL, "group": "soft"},
        {**MATERIAL, "young_pa": young_pa, "group": "stiff"},
    ]
    down_m = [[0.0, 0.0, -2e-3]]
    same = scene_of(nodes_m, tets, regions=regions, material=of(6000.0)).path(down_m).force_n
    assert np.allclose(same, scene_of(nodes_m, tets).path(down_m).force_n, rtol=1e-9)
    two = scene_of(nodes_m, tets, regions=regions, material=of(60000.0))
    assert two.path(down_m).force_n[0, 2] < 1.2 * same[0, 2] < 0.0
    assert two.with_value("material.stiff.young_pa", 6000.0).path(down_m).force_n == pytest.approx(same)


def test_a_path_that_fails_keeps_its_steps(scene):
    path = scene.path([[0.0, 0.0, -1e-3], [0.0, 0.0, -0.5]])
    assert path.force_n.shape == (1, 3) and path.displacements_m.shape == (1, 3)
    assert path.failure.startswith("step 1 of 2: ")


def test_warnings_are_those_of_python():
    with pytest.warns(UserWarning, match="the tool is smaller than its elements"):
        palpate.Scene(ASSETS / "scenes" / "palpation.toml")


def test_the_toml_of_a_scene_is_a_scene(scene):
    assert "young_pa = 6000.0" in scene.toml
    assert json.dumps(scene.name) in repr(scene).replace("'", '"')
