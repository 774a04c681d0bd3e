"""Controllers and live solvers in virtual time, and recordings."""

import numpy as np
import palpate
import pytest
from conftest import ASSETS


def press(organ, depth_m, ticks=500, **settings):
    """The controller and its last command after a press, from 1 mm above the skin."""
    controller = palpate.Controller(organ, ramp_s=0.05, **settings)
    controller.arm()
    for tick in range(ticks):
        height_m = 1e-3 - (1e-3 + depth_m) * min(1.0, tick / (0.8 * ticks))
        command = controller.tick(1000 * tick, organ.active_m[0] + height_m * organ.normals[0])
    return controller, command


def test_a_press_has_the_force_of_the_organ(organ):
    controller, command = press(organ, 3e-3)
    assert (command.phase, command.engaged, command.coverage, command.fault) == ("active", 0, "cell", None)
    force_n = organ.force(command.displacement_m[None])[0]
    assert command.reaction_n == pytest.approx(force_n, rel=1e-4)
    assert command.hand_force_n == pytest.approx(-force_n, rel=1e-4) and command.ramp == 1.0
    controller.disarm()
    assert controller.phase == "disarmed" and not controller.tick(500_000, None).hand_force_n.any()


def test_settings_limit_the_force(organ):
    _, command = press(organ, 3e-3, max_force_n=0.05)
    assert np.linalg.norm(command.hand_force_n) == pytest.approx(0.05, rel=1e-4) and command.clamped
    with pytest.raises(palpate.InputError, match="unknown setting `ramp`; use one of: max_force_n"):
        palpate.Controller(organ, ramp=0.1)
    with pytest.raises(palpate.InputError, match="max_force_n is out of range"):
        palpate.Controller(organ, max_force_n=-1.0)


def test_a_fault_is_latched_until_reset(organ):
    controller, _ = press(organ, 1e-3)
    command = controller.tick(500_000, [0.0, np.nan, 0.0])
    assert (command.phase, command.fault) == ("safe-zero", "not-finite") and not command.hand_force_n.any()
    assert not controller.arm()
    controller.reset()
    assert controller.arm() and controller.phase == "active"
    with pytest.raises(palpate.InputError, match=r"position_m: three numbers are expected, not \[0.0, 1.0\]"):
        controller.tick(501_000, [0.0, 1.0])


def test_a_recording_has_the_ticks_of_the_controller(organ, tmp_path):
    file, forces_n = tmp_path / "touch.mcap", []
    with palpate.Controller(organ, record=file, ramp_s=0.0) as controller:
        for tick in range(1500):
            if tick == 10:
                controller.arm()
            height_m = 1e-3 - 2e-6 * tick
            command = controller.tick(1000 * tick, organ.active_m[0] + height_m * organ.normals[0])
            forces_n.append(command.hand_force_n)
    recording = palpate.Recording(file)
    assert np.array_equal(recording["hand_force_n"], np.array(forces_n, np.float32))
    assert recording["phase"][9] == "disarmed" and (recording["phase"][10:] == "active").all()
    assert recording["coverage"][0] == "" and recording["coverage"][-1] == "cell"
    assert (recording["device"] == "homed").all() and recording["arm"].nonzero()[0].tolist() == [10]
    assert np.array_equal(recording["shares_weight"][-1], [1.0, 0.0, 0.0])
    assert (recording["fault"] == "").all() and recording["engaged"][-1] == 0
    assert recording.time_s[-1] == pytest.approx(1.499) and not recording.is_cut and recording.lost == 0
    assert recording.header["scene"] == "block" and recording.header["active"] == "A1"
    assert {len(column) for column in recording.values()} == {1500}
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(file.read_bytes()[:-200_000])
    part = palpate.Recording(cut)
    assert part.is_cut and 0 < len(part["tick"]) < 1500
    assert np.array_equal(part["hip_m"], recording["hip_m"][: len(part["tick"])])


def test_what_is_no_recording_is_refused(files):
    with pytest.raises(palpate.InputError, match="block.blob: not a recording of Palpate"):
        palpate.Recording(files / "block.blob")


def test_a_live_touch_has_the_force_of_the_solver():
    scene = palpate.Scene(ASSETS / "liver-small.toml")
    live = palpate.Live(scene, ramp_s=0.05)
    for tick in range(700):
        height_m = 1e-3 - 5e-3 * min(1.0, tick / 500)
        command = live.tick(1000 * tick, scene.active_m[0] + height_m * scene.normals[0])
        live.step(seconds=4e-3) if tick % 4 == 0 else None
    assert live.solve() < 100 and live.totals["lost"] == 0
    for tick in range(700, 1000):
        command = live.tick(1000 * tick, scene.active_m[0] - 4e-3 * scene.normals[0])
    assert live.waiting == 0 and command.phase == "active"
    # A vertex of the skin is held like an active node.
    exact_n = scene.path([0.5 * command.displacement_m, command.displacement_m], active="A1").force_n[-1]
    assert command.reaction_n == pytest.approx(exact_n, abs=0.01)
    moved_m = live.displacements()
    assert moved_m.shape == scene.nodes_m.shape and not moved_m[scene.fixed].any()
    before_n = np.linalg.norm(command.reaction_n)
    live.change(scene.with_value("material.c10_pa", 2600.0))
    live.solve()
    for tick in range(1000, 1400):
        command = live.tick(1000 * tick, scene.active_m[0] - 4e-3 * scene.normals[0])
    assert np.linalg.norm(command.reaction_n) > 1.2 * before_n
