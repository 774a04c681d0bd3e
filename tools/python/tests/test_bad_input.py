"""Bad input ends in one line that names cause and fix, and interruptions leave nothing half-written."""

import contextlib
import os
import signal
import sqlite3

import numpy as np
import palpate
import pytest
from conftest import ASSETS, GRID, MATERIAL, block, scene_of


@pytest.mark.parametrize(
    ("at_m", "line"),
    [
        (np.zeros((4, 2)), r"displacements_m: shape \(n, 3\) is expected, not \(4, 2\); "),
        (np.zeros(3), r"displacements_m: shape \(n, 3\) is expected, not \(3,\); "),
        (
            np.zeros((2, 3), complex),
            "displacements_m: an array of numbers is expected, not of dtype complex128; ",
        ),
        ([["a", "b", "c"]], "displacements_m: an array of numbers is expected, not of dtype <U1; "),
        ([[1.0, 2.0, 3.0], [1.0]], r"displacements_m: an array of shape \(n, 3\) is expected "),
    ],
)
def test_arrays_of_wrong_shape_or_dtype(organ, scene, at_m, line):
    for call in (organ.force, organ.estimate, scene.path):
        with pytest.raises(palpate.InputError, match=f"^{line}") as caught:
            call(at_m)
        assert isinstance(caught.value, ValueError) and "\n" not in str(caught.value)


def test_memory_for_the_result_must_fit(organ):
    at_m = np.zeros((5, 3))
    for out in (np.zeros((4, 3)), np.zeros((5, 3), np.float32), np.zeros((3, 5)).T, [0.0]):
        with pytest.raises(palpate.InputError, match=r"out: a C-contiguous array \(5, 3\) of the same dtype"):
            organ.force(at_m, out=out)
    with pytest.raises(palpate.InputError, match="memory of its own"):
        organ.force(at_m, out=at_m)


def test_a_path_must_be_finite(scene):
    with pytest.raises(palpate.InputError, match="displacements_m: row 1 is not finite"):
        scene.path([[0.0, 0.0, 0.0], [np.nan, 0.0, 0.0]])
    with pytest.raises(palpate.InputError, match="no active node `A7`; it has A1"):
        scene.path([[0.0, 0.0, 0.0]], active="A7")


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (
            lambda nodes_m, tets: (nodes_m[:, :2], tets),
            r"^nodes_m: shape \(n, 3\) is expected, not \(75, 2\); ",
        ),
        (
            lambda nodes_m, tets: (nodes_m, tets[:, :3]),
            r"^tets: shape \(n, 4\) is expected, not \(192, 3\); ",
        ),
        (
            lambda nodes_m, tets: (nodes_m, tets.astype(float)),
            "^tets: whole numbers are expected, not dtype float64; ",
        ),
        (lambda nodes_m, tets: (nodes_m, tets + 1), "^tets: tet 186 names a node that is not there: "),
        (lambda nodes_m, tets: (nodes_m, tets - 1), "^tets: an index is negative or too large; "),
        (
            lambda nodes_m, tets: (nodes_m, tets[:, [1, 0, 2, 3]]),
            r"^tets: tet 0 .* \(as have 191 others\); swap two",
        ),
        (
            lambda nodes_m, tets: (np.vstack([nodes_m, [[9, 9, 9]]]), tets),
            "^nodes_m: node 75 belongs to no tet; ",
        ),
    ],
)
def test_meshes_that_are_none(change, line):
    with pytest.raises(palpate.InputError, match=line):
        scene_of(*change(*block()))


def test_an_inverted_tet_is_named():
    nodes_m, tets = block()
    tets[37] = tets[37][[0, 1, 3, 2]]
    with pytest.raises(palpate.InputError, match=r"^tets: tet 37 has negative volume \(-1.*; swap any two"):
        scene_of(nodes_m, tets)
    nodes_m, tets = block()
    nodes_m[10, 1] = np.inf
    with pytest.raises(palpate.InputError, match="^nodes_m: row 10 is not finite"):
        scene_of(nodes_m, tets)


def test_groups_must_exist():
    nodes_m, tets = block()
    with pytest.raises(
        palpate.InputError, match='groups: "bottom" has the index 75, and there are 75; use 0 to 74'
    ):
        scene_of(nodes_m, tets, groups={"bottom": [0, 75]})
    with pytest.raises(palpate.InputError, match='no group of nodes named "botom"; did you mean "bottom"'):
        scene_of(nodes_m, tets, fixed="botom")
    with pytest.raises(palpate.InputError, match='did you mean "bottom"'):
        scene_of(nodes_m, tets, fixed={"group": "botton"})


def test_unknown_keys_of_a_dictionary():
    tables = {
        "mesh": {"file": "liver-small.msh"},
        "material": {"law": "neo-hookean", "young": 6000.0, "poisson": 0.4},
        "fixed": {"group": "F1"},
    }
    with pytest.raises(
        palpate.InputError, match=r"<dict>:\d+: unknown key `young`; did you mean `young_pa`\?"
    ):
        palpate.Scene.from_dict(tables, folder=ASSETS)
    with pytest.raises(palpate.InputError, match=r"unknown key `grids`; did you mean `grid`\?"):
        scene_of(*block(), grids=GRID)
    with pytest.raises(
        palpate.InputError, match="<dict>: .*set.* is not JSON serializable; use finite numbers"
    ):
        palpate.Scene.from_dict({"mesh": {1, 2}})


def test_the_line_of_a_file_is_that_of_the_command_line(tmp_path):
    file = tmp_path / "bad.toml"
    file.write_text('[mesh]\nfile = "a.msh"\n[material]\nlaw = "neo-hookean"\nc10 = 1\n')
    with pytest.raises(palpate.InputError, match=rf"^{file}:5: unknown key `c10`; did you mean `c10_pa`\?"):
        palpate.Scene(file)
    with pytest.raises(palpate.InputError, match=r"none.toml: .*; check the path of the scene file$"):
        palpate.Scene(tmp_path / "none.toml")
    with pytest.raises(palpate.InputError, match="bad.toml: "):
        palpate.Organ(file)
    with pytest.raises(
        palpate.InputError, match=r"none.blob: .*; check the name, the folder and its permissions$"
    ):
        palpate.Organ(tmp_path / "none.blob")


def test_a_scene_without_a_grid_has_no_space(tmp_path):
    scene = scene_of(*block(), grid=None)
    with pytest.raises(palpate.InputError, match=r"no \[grid\]; add radius_m and spacing_m"):
        scene.precompute(tmp_path / "a.space")
    with pytest.raises(palpate.InputError, match="threads = 0: give 1 to 1024"):
        scene.precompute(tmp_path / "a.space", threads=0)
    assert list(tmp_path.iterdir()) == []


def stored(space):
    """The solves that a .space file keeps."""
    with contextlib.closing(sqlite3.connect(space)) as file:
        return file.execute("SELECT active, i, j, k, attempt FROM configuration").fetchall()


def test_ctrl_c_keeps_what_is_solved(scene, files, tmp_path):
    space, seen = tmp_path / "block.space", []

    def interrupt(phase, done, total):
        seen.append((phase, done, total))
        if done >= 5:
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        scene.precompute(space, progress=interrupt, threads=1)
    phase, done, total = seen[-1]
    assert phase == "configurations" and 5 <= done < total
    kept = stored(space)
    assert done <= len(kept) < total
    assert scene.precompute(space)["A1"]["unknown"] == 0
    assert set(kept) <= set(stored(space)) and len(stored(space)) > len(kept), "it goes on where it ended"
    palpate.pack(space, tmp_path / "again.blob", held_out=0)
    at_m = np.random.default_rng(2).uniform(-2e-3, 2e-3, (50, 3))
    assert np.array_equal(
        palpate.Organ(tmp_path / "again.blob").force(at_m), palpate.Organ(files / "block.blob").force(at_m)
    )


def test_an_exception_of_the_callback_ends_packing(scene, tmp_path):
    scene.precompute(tmp_path / "block.space")

    def refuse(phase, done, total):
        raise RuntimeError(phase)

    with pytest.raises(RuntimeError, match="held-out positions"):
        palpate.pack(tmp_path / "block.space", tmp_path / "block.blob", held_out=200, progress=refuse)
    assert not [file for file in tmp_path.iterdir() if "blob" in file.name]
    with pytest.raises(palpate.InputError, match='method "cubic": no such method'):
        palpate.pack(tmp_path / "block.space", tmp_path / "block.blob", methods=["cubic"])


def test_an_unfinished_space_is_not_packed(scene, tmp_path):
    with pytest.raises(ValueError, match="enough"):
        scene.precompute(tmp_path / "a.space", progress=raise_enough, threads=1)
    with pytest.raises(palpate.InputError, match="active node A1 is not finished"):
        palpate.pack(tmp_path / "a.space", tmp_path / "a.blob")
    with pytest.raises(palpate.InputError, match="none.space: "):
        palpate.pack(tmp_path / "none.space", tmp_path / "a.blob")


def raise_enough(phase, done, total):
    raise ValueError("enough")


def test_a_signal_ends_a_path(scene):
    def alarm(number, frame):
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, alarm)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.2)
        with pytest.raises(TimeoutError):
            scene.path(np.tile([[0.0, 0.0, -2e-3], [0.0, 1e-3, -3e-3]], (100_000, 1)))
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def test_constants_without_a_meaning_are_refused():
    with pytest.raises(palpate.InputError, match="poisson"):
        scene_of(*block(), material={**MATERIAL, "poisson": 0.7})
