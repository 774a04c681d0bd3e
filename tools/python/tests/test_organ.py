"""The force of a blob, and what it costs."""

import threading
import time

import numpy as np
import palpate
import pytest


def ball(count, radius_m, seed=1):
    """Uniform positions (count, 3) in a ball."""
    random = np.random.default_rng(seed)
    direction = random.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return radius_m * np.cbrt(random.random((count, 1))) * direction


def test_the_force_is_that_of_the_solver_within_the_certificate(scene, organ):
    error = next(of for of in organ.certificate["spaces"][0]["methods"] if of["method"] == "energy")
    assert error["uniform"]["count"] == 30
    at_m = ball(8, 3.5e-3)
    exact_n = np.concatenate([scene.path([0.5 * at, at]).force_n[-1:] for at in at_m])
    difference_n = np.linalg.norm(organ.force(at_m) - exact_n, axis=1)
    assert difference_n.max() < 3.0 * error["uniform"]["max_n"] + 1e-4


def test_the_dtype_and_the_layout_do_not_change_the_force(organ):
    single = ball(1000, 3e-3).astype(np.float32)
    force_n = organ.force(single)
    assert force_n.dtype == np.float32 and force_n.shape == (1000, 3)
    double = organ.force(single.astype(float))
    assert double.dtype == np.float64 and np.array_equal(double, force_n)
    wide = np.zeros((1000, 6), np.float32)
    wide[:, ::2] = single
    assert np.array_equal(organ.force(wide[:, ::2]), force_n)
    assert np.array_equal(organ.force(np.asfortranarray(single)), force_n)
    assert np.array_equal(organ.force(single.tolist()), force_n)
    assert organ.force(np.zeros((0, 3))).shape == (0, 3)
    # Whole numbers are positions too.
    assert not organ.force([[0, 0, 0]]).any()


def test_every_position_has_a_finite_force(organ):
    nowhere = np.array([[np.nan, 0.0, 0.0], [0.0, np.inf, 0.0]])
    assert not organ.force(nowhere).any() and not organ.force(nowhere.astype(np.float32)).any()
    # Beyond the range of float32.
    assert (
        np.isfinite(organ.force([[0.0, 0.0, -1e300]])).all() and organ.force([[0.0, 0.0, -1e300]])[0, 2] < 0.0
    )


def test_out_is_filled_and_returned(organ):
    at_m = ball(100, 3e-3)
    out = np.full_like(at_m, np.nan)
    assert organ.force(at_m, out=out) is out and np.array_equal(out, organ.force(at_m))


def test_other_threads_run_during_a_call(organ):
    at_m = np.tile(ball(100_000, 3e-3).astype(np.float32), (40, 1))
    stamps, stop = [], threading.Event()

    def stamp():
        while not stop.is_set():
            stamps.append(time.perf_counter())
            time.sleep(1e-3)

    thread = threading.Thread(target=stamp)
    thread.start()
    begun = time.perf_counter()
    organ.force(at_m)
    ended = time.perf_counter()
    stop.set()
    thread.join()
    during = sum(begun < at < ended for at in stamps)
    assert during > 10, f"{during} stamps in {ended - begun} s"


def test_the_estimate_has_the_derivatives_of_the_force(organ):
    at_m, step_m = ball(50, 2.5e-3), 1e-5
    of = organ.estimate(at_m)
    assert (
        np.array_equal(of["force_n"], organ.force(at_m.astype(np.float32))) and not of["extrapolated"].any()
    )
    for axis in range(3):
        step = step_m * np.eye(3)[axis]
        slope = (organ.force(at_m + step) - organ.force(at_m - step)) / (2 * step_m)
        assert (
            np.abs(slope - of["stiffness_n_m"][:, :, axis]).max() < 2e-2 * np.abs(of["stiffness_n_m"]).max()
        )
    assert organ.estimate([[9e-3, 0.0, 0.0]])["extrapolated"].all()


def test_active_nodes_have_names_and_numbers(organ):
    at_m = ball(10, 2e-3)
    assert np.array_equal(organ.force(at_m, active="A1"), organ.force(at_m, active=0))
    with pytest.raises(palpate.InputError, match="no active node A2; it has A1"):
        organ.force(at_m, active="A2")
    with pytest.raises(palpate.InputError, match="no active node 1; it has A1"):
        organ.force(at_m, active=1)


def test_methods_are_those_that_were_packed(organ):
    assert organ.methods[0] == "energy" and "trilinear" in organ.methods
    at_m = ball(10, 2e-3)
    assert not np.array_equal(organ.force(at_m, method="trilinear"), organ.force(at_m))
    with pytest.raises(palpate.InputError, match='kernel was not packed; give pack methods=\\["kernel"\\]'):
        organ.force(at_m, method="kernel")
    with pytest.raises(palpate.InputError, match='method "cubic": no such method; choose from trilinear'):
        organ.force(at_m, method="cubic")


def test_the_surface_moves_with_the_active_node(scene, organ):
    assert organ.surface_m.shape[1] == 3 and organ.triangles.max() < len(organ.surface_m)
    moved_m = organ.surface_displacement([0.0, 0.0, -3e-3])
    middle = np.argmin(np.linalg.norm(organ.surface_m - scene.active_m[0], axis=1))
    assert moved_m[middle] == pytest.approx([0.0, 0.0, -3e-3], abs=1e-4)


def test_meshes_of_pyvista(scene, organ):
    pyvista = pytest.importorskip("pyvista")
    grid, surface = scene.mesh(), organ.mesh()
    assert isinstance(grid, pyvista.UnstructuredGrid) and grid.n_cells == len(scene.tets)
    assert grid.volume == pytest.approx(0.04 * 0.04 * 0.02) and grid.point_data["fixed"].sum() == 25
    assert surface.area == pytest.approx(2 * 0.04 * 0.04 + 4 * 0.04 * 0.02, rel=1e-5)


def test_without_pyvista_the_error_names_it(scene, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyvista", None)
    with pytest.raises(ImportError, match="pip install pyvista"):
        scene.mesh()
