"""tests/fuzz/run and its ledger, with recorded logs."""

import contextlib
import io
import json
import pathlib
import signal
import subprocess
import tempfile
import time
import types
import unittest

from recorded import CRASH, DONE, ENDED, KILLED, LOADED, PANIC, script

fuzz = script("fuzz/run")
DATE = "2026-11-29T14:44:16+00:00"


class Figures(unittest.TestCase):
    def of(self, log):
        found = fuzz.figures(log)
        return found["executions"], int(found["covered"]), int(found["counters"]), found["crashes"]

    def test_a_log_can_end_anywhere(self):
        self.assertEqual(self.of(""), (0, 0, 0, 0))
        self.assertEqual(self.of(LOADED), (0, 0, 691, 0))
        self.assertEqual(self.of(KILLED), (689603, 390, 691, 0))
        self.assertEqual(self.of(DONE), (908050, 389, 691, 0))
        self.assertEqual(self.of(ENDED), (672300, 390, 691, 0))
        for end in range(0, len(DONE), 7):
            self.assertEqual(self.of(DONE[:end])[3], 0)

    def test_a_crash_is_seen_before_and_after_the_first_count(self):
        self.assertEqual(self.of(LOADED + CRASH), (0, 0, 691, 1))
        self.assertEqual(self.of(LOADED + PANIC), (0, 0, 691, 1))
        self.assertEqual(self.of(DONE + CRASH)[3], 1)


class WithLedger(unittest.TestCase):
    """Each test has its own folder of runs, and its own ledger."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)
        names = {"RUNNING": self.folder, "LEDGER": self.ledger()}
        for name, value in names.items():
            self.addCleanup(setattr, fuzz, name, getattr(fuzz, name))
            setattr(fuzz, name, value)

    def ledger(self):
        return fuzz.Ledger(self.folder / "ledger.csv", fuzz.COLUMNS, numbers=fuzz.COLUMNS[3:])

    def left(self, target, log, begun=None):
        """The files of a run whose script was killed."""
        begun = json.dumps({"at": time.time() - 100, "date": DATE, "commit": "1fa4d94c"}) if begun is None else begun
        (self.folder / f"{target}.log").write_text(log)
        (self.folder / f"{target}.json").write_text(begun)

    def rows(self):
        return [(row["target"], int(row["executions"]), int(row["crashes"])) for row in self.ledger().rows()]

    def said(self, call, *words):
        """What a call prints, on both outputs, and its result; or the exit code."""
        out = io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
            try:
                result = call(*words)
            except SystemExit as end:
                result = end.code
        return out.getvalue(), result


class Settle(WithLedger):
    def test_a_killed_run_becomes_one_row(self):
        self.left("jets", KILLED)
        said, code = self.said(fuzz.settle_killed)
        self.assertEqual(code, 0)
        self.assertIn("689,603 executions", said)
        self.assertEqual(self.rows(), [("jets", 689603, 0)])
        self.assertAlmostEqual(float(self.ledger().rows()[0]["cpu_s"]), 100, delta=5)
        self.assertIsNone(fuzz.settle("jets"))
        # The script was killed between the row and the removal of its files.
        self.left("jets", KILLED)
        self.assertEqual(fuzz.settle("jets")["executions"], 689603)
        self.assertEqual(self.rows(), [("jets", 689603, 0)])

    def test_a_crash_before_the_first_execution_is_kept_and_reported(self):
        self.left("jets", LOADED + CRASH)
        said, code = self.said(fuzz.settle_killed)
        self.assertEqual(code, 1)
        self.assertIn("panicked at targets/jets.rs", said)
        self.assertIn("crashes/jets-crash-0f", said)
        self.assertEqual(self.rows(), [("jets", 0, 1)])

    def test_an_end_without_words_is_a_crash_except_by_sigint(self):
        for name, code in (("blob", -signal.SIGKILL), ("link", -signal.SIGINT), ("tick", 72), ("mesh", 0)):
            self.left(name, LOADED)
            fuzz.settle(name, 1.0, code)
        self.assertEqual(self.rows(), [("blob", 0, 1)])

    def test_a_torn_note_of_the_start_loses_no_executions(self):
        self.left("jets", DONE, begun='{"at": 17959')
        fuzz.settle("jets")
        self.assertEqual(self.rows(), [("jets", 908050, 0)])
        self.assertEqual(self.ledger().rows()[0]["commit"], "unknown")


class Rounds(WithLedger):
    def run_with(self, log, code):
        """One round of a target that prints a log and ends; what is said, and the exit code."""
        (self.folder / "log").write_text(log)
        program = self.folder / "jets"
        program.write_text(f"#!/bin/sh\ncat '{self.folder}/log'\nexit {code}\n")
        program.chmod(0o755)
        for name, value in {"BUILT": self.folder, "CRASHES": self.folder / "crashes"}.items():
            self.addCleanup(setattr, fuzz, name, getattr(fuzz, name))
            setattr(fuzz, name, value)
        # A target of which `inputs` makes the folder.
        self.addCleanup(setattr, fuzz, "inputs", fuzz.inputs)
        fuzz.inputs = lambda target: fuzz.empty_folder()
        options = types.SimpleNamespace(until=None, seconds=1, jobs=1)
        return self.said(fuzz.rounds, ["jets"], options, "1fa4d94c")

    def test_a_run_is_counted_with_the_program_that_was_built(self):
        said, code = self.run_with(DONE, 0)
        self.assertEqual((code, self.rows()), (0, [("jets", 908050, 0)]))
        self.assertEqual(self.ledger().rows()[0]["commit"], "1fa4d94c")
        self.assertIn("jets: 908,050 executions", said)

    def test_a_crash_before_the_first_count_ends_the_script(self):
        said, code = self.run_with(LOADED + CRASH, 77)
        self.assertEqual((code, self.rows()), (1, [("jets", 0, 1)]))
        self.assertIn("replay it with", said)

    def test_a_target_that_does_not_run_is_one_line_and_no_row(self):
        said, code = self.run_with("", 0)
        self.assertEqual((code, self.rows()), (1, []))
        self.assertIn("jets did not run; see", said)


class Torn(WithLedger):
    def filled(self):
        """A ledger with two rows; the bytes of its file."""
        for target in ("jets", "link"):
            self.left(target, DONE)
            fuzz.settle(target, 300.0)
        return (self.folder / "ledger.csv").read_bytes()

    def test_a_row_torn_anywhere_is_ignored_and_replaced(self):
        whole = self.filled()
        path, second = self.folder / "ledger.csv", whole[:-1].rfind(b"\n") + 1
        for end in range(second + 1, len(whole)):
            path.write_bytes(whole[:end])
            fuzz.LEDGER = self.ledger()
            said, total = self.said(fuzz.sums)
            self.assertEqual(total, 908050)
            self.assertIn(f"{path}:3: warning: a torn row is ignored", said)
            self.left("link", DONE)
            fuzz.settle("link", 300.0)
            self.assertEqual(path.read_bytes(), whole)
        path.write_bytes(whole + b"\0\0\0\0")
        self.assertEqual(len(self.said(self.rows)[1]), 2)
        path.write_bytes(b"date,comm")
        self.assertEqual(self.said(self.rows)[1], [])
        self.said(self.filled)
        self.assertEqual(path.read_bytes(), whole)

    def test_a_wrong_line_elsewhere_is_one_clear_line(self):
        whole = self.filled()
        path = self.folder / "ledger.csv"
        lines = whole.decode().splitlines()
        wrong = {"5 fields": lines[1].rsplit(",", 4)[0], "12 fields": lines[1][:40] + lines[1],
                 'executions is ""': lines[1].replace("908050", ""), "cpu_s": lines[1].replace(",300,", ",x,"),
                 "1 fields": "<<<<<<< ours"}
        for words, line in wrong.items():
            path.write_text("\n".join([lines[0], line, lines[2], ""]))
            said, code = self.said(fuzz.sums)
            self.assertEqual((said.count("\n"), code), (1, 2), said)
            self.assertIn(f"{path}:2: {words}", said)
            self.assertIn("correct or delete this line", said)
        path.write_text("date,other\n")
        self.assertIn("other columns", self.said(fuzz.sums)[0])


class Sums(WithLedger):
    def test_sums_count_each_run_once_and_name_no_share(self):
        for target, log in (("jets", DONE), ("jets", KILLED), ("link", DONE), ("jets", LOADED + CRASH)):
            date = f"2026-11-29T14:44:{len(self.rows()):02}+00:00"
            self.left(target, log, json.dumps({"at": time.time(), "date": date, "commit": "1fa4d94c"}))
            fuzz.settle(target, 100.0)
        said, total = self.said(fuzz.sums)
        self.assertEqual(total, 2 * 908050 + 689603)
        rows = {line.split()[0]: line.split()[1:] for line in said.splitlines()}
        jets = "3 1,597,653 0.08 5,326 0 390/691 1"
        self.assertEqual((" ".join(rows["jets"]), rows["all"][:2]), (jets, ["4", "2,505,703"]))
        self.assertEqual(rows["mesh"], "0 0 0.00 0 0 0/0 0".split())
        self.assertNotIn("%", said)

    def test_the_committed_ledger_has_no_wrong_line(self):
        committed = fuzz.Ledger(fuzz.FUZZ / "ledger.csv", fuzz.COLUMNS, numbers=fuzz.COLUMNS[3:])
        self.assertGreater(len(committed.rows()), 100)


class Commit(unittest.TestCase):
    def test_only_other_files_than_the_ledger_make_another_program(self):
        commit = fuzz.commit.__globals__["commit"]
        with tempfile.TemporaryDirectory() as folder:
            root = pathlib.Path(folder)
            self.assertEqual(commit(root), "unknown")
            (root / "tests/fuzz").mkdir(parents=True)
            ledger, source = root / "tests/fuzz/ledger.csv", root / "source.rs"
            ledger.write_text("a\n"), source.write_text("a\n")
            user = ["-c", "user.name=test", "-c", "user.email=test@localhost", "-c", "commit.gpgsign=false"]
            for words in (["init", "-q"], ["add", "."], [*user, "commit", "-q", "-m", "test"]):
                subprocess.run(["git", *words], cwd=root, check=True)
            clean = commit(root)
            self.assertRegex(clean, "^[0-9a-f]{7,}$")
            ledger.write_text("b\n")
            self.assertEqual(commit(root), clean)
            source.write_text("b\n")
            self.assertEqual(commit(root), clean + "+")


if __name__ == "__main__":
    unittest.main()
