"""Constants from measured forces."""

import _thread
import threading

import numpy as np
import palpate
import pytest
from conftest import ASSETS

TABLE = ASSETS / "scenes" / "indentation.csv"


@pytest.fixture
def scene() -> palpate.Scene:
    return palpate.Scene(ASSETS / "scenes" / "indentation.toml")


def test_intervals_hold_the_constants_behind_a_table(scene: palpate.Scene) -> None:
    seen: list[tuple[str, int, object]] = []
    found = scene.identify(TABLE, ["c10_pa", "c01_pa"], progress=lambda *at: seen.append(at))
    for name, truth in (("c10_pa", 1300.0), ("c01_pa", 1280.0)):
        constant = found.parameters[name]
        assert constant.low < truth < constant.high
        assert constant.standard_error < 0.02 * truth
    assert found.correlation.shape == (2, 2) and found.correlation[0, 1] < -0.9
    assert found.measured_n.shape == found.model_n.shape == found.displacement_m.shape == (60, 3)
    assert np.isclose(np.sqrt(np.mean((found.model_n - found.measured_n) ** 2)), found.rms_residual_n)
    assert not found.is_misfit and 0.008 < found.rms_residual_n < 0.012
    assert f"c10_pa = {found.parameters['c10_pa'].value!r}"[:16] in found.scene.toml
    assert seen and seen[-1][2] == 60


def test_arrays_are_measurements(scene: palpate.Scene) -> None:
    truth = scene.with_value("material.c10_pa", 1300.0).with_value("material.c01_pa", 1280.0)
    inward = -scene.normals[0]
    push = np.outer(np.linspace(2e-3, 12e-3, 5), inward)
    force = truth.path(push).force_n
    whole = scene.identify({"displacement_m": push, "force_n": force, "test": ["a"] * 5}, ["c10_pa", "c01_pa"])
    assert np.isclose(whole.parameters["c01_pa"].value, 1280.0, rtol=1e-6)
    along = {"depth_m": np.linspace(2e-3, 12e-3, 5), "force_n": force @ inward}
    single = scene.identify(along, ["c10_pa", "c01_pa"], direction=tuple(inward))
    assert single.measured_n.shape == (5, 1)
    assert np.isclose(single.parameters["c10_pa"].value, 1300.0, rtol=1e-4)


def test_what_the_data_cannot_tell_is_a_warning(scene: palpate.Scene, tmp_path) -> None:
    few = tmp_path / "few.csv"
    few.write_text("".join(TABLE.read_text().splitlines(keepends=True)[:4]))
    with pytest.warns(UserWarning, match="hardly tell"):
        found = scene.identify(few, ["c10_pa", "c01_pa"])
    # One of them is negative: only the pair is valid.
    values = [constant.value for constant in found.parameters.values()]
    assert sum(values) > 0.0 and "material" in found.scene.toml
    bounded = scene.identify(TABLE, ["c10_pa", "c01_pa"], bounds={"c10_pa": (None, 9000.0)})
    assert np.isclose(bounded.parameters["c10_pa"].value, 1286.3, rtol=1e-3)


@pytest.mark.parametrize(
    ("data", "free", "options", "words"),
    [
        ({"displacement_m": np.zeros((2, 2)), "force_n": np.zeros((2, 3))}, "c10_pa", {}, "(n, 3) is expected, not (2, 2)"),
        ({"displacement_m": np.zeros((2, 3)), "force_n": np.zeros((3, 3))}, "c10_pa", {}, "differ in length"),
        ({"force_n": np.zeros((3, 3))}, "c10_pa", {}, "one of displacement_m, position_m, depth_m"),
        ({"displacement_m": np.full((2, 3), np.nan), "force_n": np.zeros((2, 3))}, "c10_pa", {}, "<arrays>:2"),
        ({"depth_m": np.ones(3), "force_n": np.ones(3)}, "c10_pa", {}, "needs its direction"),
        (TABLE, "young_pa", {}, "no material has the constant `young_pa`"),
        (TABLE, "c10_pa", {"loss": "cubic"}, 'loss = "cubic"'),
        (TABLE, "c10_pa", {"confidence": 1.0}, "between 0 and 1"),
        (TABLE, "c10_pa", {"bounds": {"c10_pa": (0.0, 10.0)}}, "not within its bounds"),
        ("none.csv", "c10_pa", {}, "none.csv"),
    ],
)
def test_bad_input_is_one_line(scene: palpate.Scene, data, free, options, words) -> None:
    with pytest.raises(palpate.InputError) as error:
        scene.identify(data, [free], **options)
    assert words in str(error.value) and "\n" not in str(error.value)


def test_ctrl_c_ends_a_fit(scene: palpate.Scene) -> None:
    threading.Timer(0.3, _thread.interrupt_main).start()
    with pytest.raises(KeyboardInterrupt):
        scene.identify(TABLE, ["c10_pa", "c01_pa"], threads=1)
