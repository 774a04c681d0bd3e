"""What tests/soak accepts, with figures of a session as palpate prints them."""

import copy
import math
import types
import unittest

from recorded import script

soak = script("soak")

# Eight minutes on two busy cores.
GOOD = {
    "live": {
        "checked": 80, "unsolved": 0, "not_felt_share": 0.862,
        "error_mn": {"mean": 116.8, "p99": 5095.0, "max": 5095.0},
        "trusted": {"checked": 58, "error_mn": {"mean": 4.1, "p99": 60.0, "max": 60.0}, "not_felt_share": 0.983},
        "extrapolated_share": 0.08, "jets": 4000, "solver_busy_share": 0.8,
    },
    "session": {
        "fault": None, "end": "completed", "ticks": 479_900, "real_time": {"scheduler": "granted"},
        "latency": {"lateness_ns": {"p999": 40_000, "max": 300_000}, "missed_deadlines": 100},
        "touch": {"contacts": 100, "not_finite_ticks": 0, "largest_step_n": 1.011},
    },
}
SECONDS = 480
TICKS, NOT_FINITE, STEP = "ticks", "ticks not finite", "largest step of the force"
TRUSTED, NOT_FELT = "checked on trusted jets", "error below what can be felt"
OF_ALL, MEAN_OF_ALL = "where extrapolated, too", "error mean, p99, max there"


def failed(changes=None, seconds=SECONDS, planned_s=SECONDS, busy=0.99, memory=None):
    """Names of the rows that fail, with some of the figures changed: {"live trusted checked": 10}."""
    figures = copy.deepcopy(GOOD)
    for path, value in (changes or {}).items():
        *folders, name = path.split()
        of = figures
        for folder in folders:
            of = of[folder]
        assert name in of, path
        of[name] = value
    rows = soak.judged(figures, memory or soak.Memory(), seconds, busy, planned_s)
    return [name for name, _, _, good in rows if not good]


class Judged(unittest.TestCase):
    def test_a_correct_session_passes(self):
        self.assertEqual(failed(), [])

    def test_one_wrong_figure_fails(self):
        touch = "session touch"
        cases = [
            ({f"{touch} not_finite_ticks": 1}, NOT_FINITE),
            ({f"{touch} largest_step_n": 2.001}, STEP),
            ({f"{touch} contacts": 7}, "contacts"),
            ({"session fault": "solver"}, "fault"),
            ({"session end": "device lost"}, "end"),
            ({"live trusted not_felt_share": 0.9}, NOT_FELT),
            ({"live trusted checked": 47}, TRUSTED),
            ({"live not_felt_share": 0.74}, OF_ALL),
            ({"live error_mn": {"mean": 501.0, "p99": 9e3, "max": 9e3}}, MEAN_OF_ALL),
            ({"session latency missed_deadlines": 4900}, "deadlines missed"),
            ({"live jets": 0}, "jets, solver busy"),
        ]
        for changes, row in cases:
            self.assertEqual(failed(changes), [row], changes)
        self.assertEqual(failed(busy=0.5), ["processors busy"])

    def test_figures_that_json_cannot_hold_fail(self):
        # A number that is not finite is null there.
        none = {"mean": None, "p99": None, "max": None}
        changes = {"session touch not_finite_ticks": 3, "session touch largest_step_n": None, "live error_mn": none}
        self.assertEqual(failed(changes), [NOT_FINITE, STEP, MEAN_OF_ALL])

    def test_a_session_without_a_check_fails(self):
        empty = {"checked": 0, "error_mn": None, "not_felt_share": None}
        changes = {"live checked": 0, "live error_mn": None, "live not_felt_share": None, "live trusted": empty}
        self.assertEqual(failed(changes), [TRUSTED, NOT_FELT, OF_ALL, MEAN_OF_ALL])

    def test_programs_with_known_faults_fail(self):
        # The solver did not send again what the loop had given up.
        changes = {"live checked": 200, "live trusted checked": 79, "live trusted not_felt_share": 0.785}
        self.assertEqual(failed({**changes, "live not_felt_share": 0.435}), [TRUSTED, NOT_FELT, OF_ALL])
        # More than an hour of touch, ended by the user.
        changes = {"live checked": 92, "live trusted checked": 27, "live trusted not_felt_share": 0.704,
                   "live not_felt_share": 0.272, "live error_mn": {"mean": 3881.6, "p99": 10176.2, "max": 10176.2},
                   "session end": "stopped", "session ticks": 4_140_951, "session latency missed_deadlines": 3437}
        self.assertEqual(failed(changes, 4143, 7200), [TRUSTED, NOT_FELT, OF_ALL, MEAN_OF_ALL])

    def test_missing_ticks_fail_however_short_the_run(self):
        for seconds in (15, 120, 7200):
            for share, rows in ((0.9, [TICKS]), (0.98, [TICKS]), (0.995, [])):
                changes = {"session ticks": int(1000 * seconds * share), "session touch contacts": seconds}
                self.assertEqual(failed(changes, seconds, seconds), rows, (seconds, share))

    def test_a_session_that_the_user_ends_has_time_to_start(self):
        stopped = {"session end": "stopped", "session ticks": 13_000, "session latency missed_deadlines": 0}
        self.assertEqual(failed(stopped, 15, 7200), [])
        self.assertEqual(failed({**stopped, "session ticks": 11_700}, 15, 7200), [TICKS])
        # Its own count shows what the time to start would hide.
        missing = {**stopped, "session ticks": 13_400, "session latency missed_deadlines": 1500}
        self.assertEqual(failed(missing, 15, 7200), [TICKS, "deadlines missed"])

    def test_the_length_is_whole_seconds(self):
        self.assertEqual(soak.length_s(types.SimpleNamespace(minutes=0.2583)), 15)


class Memory(unittest.TestCase):
    def rows(self, mb, minutes=120):
        """Rows of a run with this memory, MB, after a share of it; sampled each minute as the soak does."""
        memory = soak.Memory()
        memory.samples["solver"] = [(60.0 * at, mb(at / minutes)) for at in range(1, minutes + 1)]
        return memory, memory.rows(60 * minutes)

    def test_steady_memory_passes_and_growing_memory_fails(self):
        memory, [(name, start, end, slope, grows)] = self.rows(lambda share: 60.0 + 6 * share)
        self.assertEqual((name, grows, round(slope, 3)), ("solver", False, 3.0))
        self.assertTrue(60 < start < end <= 66)
        self.assertEqual(failed(memory=memory, planned_s=7200, seconds=7200, changes={
            "session ticks": 7_199_000, "session touch contacts": 900}), [])
        memory, [(*_, slope, grows)] = self.rows(lambda share: 60.0 + 23.6 * share)
        self.assertEqual((round(slope, 2), grows), (11.8, True))
        self.assertIn("memory of the solver", failed(memory=memory, planned_s=7200, seconds=7200))

    def test_the_first_fifth_does_not_count(self):
        _, [(*_, slope, grows)] = self.rows(lambda share: 60.0 + 500 * min(share, 0.2))
        self.assertEqual((round(slope, 2), grows), (0.0, False))

    def test_a_short_run_has_a_limit_on_the_growth_and_no_slope(self):
        for growth_mb, grows in ((15, False), (40, True)):
            _, [(*_, slope, found)] = self.rows(lambda share: 60.0 + growth_mb * share, 12)
            self.assertEqual((slope, found), (None, grows))

    def test_a_process_without_samples_has_no_row(self):
        self.assertEqual(soak.Memory().rows(7200), [])
        self.assertTrue(math.isclose(soak.slope_mb_h([(0.0, 1.0), (3600.0, 3.0)]), 2.0))


class Recorded(unittest.TestCase):
    def test_a_row_has_all_columns(self):
        options = types.SimpleNamespace(scene=soak.ROOT / "assets/liver-small.toml", seed=1, loops=2)
        row = soak.recorded(GOOD, "commit abc", options, SECONDS, soak.verdict_of(True, False))
        self.assertEqual(sorted(row), sorted(soak.COLUMNS))
        self.assertEqual((row["verdict"], row["trusted_mean_mn"], row["all_max_mn"]), ("pass", 4.1, 5095.0))

    def test_a_soak_that_the_user_ends_is_no_pass(self):
        self.assertEqual([soak.verdict_of(True, True), soak.verdict_of(False, True)], ["interrupted", "fail"])


if __name__ == "__main__":
    unittest.main()
