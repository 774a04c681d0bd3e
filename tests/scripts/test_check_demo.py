"""tools/check-demo against demos that print what the real one prints."""

import pathlib
import subprocess
import tempfile
import unittest

CHECK = pathlib.Path(__file__).resolve().parents[2] / "tools/check-demo"
VERDICT = ("the felt force is within {} mN of {} full finite-element solutions; at {} % of {} positions the error is "
           "below what can be felt")
GOOD, BAD = VERDICT.format("10.8", 60, "100.0", 60), VERDICT.format("432.3", 6, "50.0", 6)
NONE = "the felt force was compared with no full solution"


class CheckDemo(unittest.TestCase):
    def run_with(self, *outputs, code=0):
        """A demo that prints these outputs, one a run; the check's exit code, output, words, and number of runs."""
        with tempfile.TemporaryDirectory() as folder:
            folder = pathlib.Path(folder)
            for run, output in enumerate(outputs, 1):
                (folder / f"{run}.txt").write_text(f"{output}\n\norgan        liver\n")
            demo = f'echo >>"$0/runs"; cat "$0/$(wc -l <"$0/runs").txt"; exit {code}'
            check = subprocess.run([CHECK, "sh", "-c", demo, folder], capture_output=True, text=True)
            return check.returncode, check.stdout, check.stderr, len((folder / "runs").read_text())

    def test_a_correct_force_passes_in_one_run(self):
        code, output, _, runs = self.run_with(GOOD)
        self.assertEqual((code, runs, output), (0, 1, f"{GOOD}\n\norgan        liver\n"))
        self.assertEqual(self.run_with(VERDICT.format("30.0", 60, "90.0", 60))[0], 0)

    def test_a_busy_machine_gets_three_runs(self):
        code, output, words, runs = self.run_with(BAD, BAD, GOOD)
        self.assertEqual((code, runs), (0, 3))
        self.assertIn("run 2 of 3: 50.0 % of 6 positions", words)
        # The output of the good run alone.
        self.assertEqual(output.count("the felt force"), 1)

    def test_a_wrong_force_fails(self):
        code, output, words, runs = self.run_with(BAD, BAD, BAD, GOOD)
        self.assertEqual((code, runs), (1, 3))
        self.assertIn("not correct in any of three runs", words)
        self.assertIn(BAD, output)
        near = VERDICT.format("40.0", 60, "89.9", 60)
        self.assertEqual(self.run_with(near, near, near)[0], 1)

    def test_a_demo_that_fails_or_compares_nothing_is_not_repeated(self):
        code, _, words, runs = self.run_with(GOOD, GOOD, code=3)
        self.assertEqual((code, runs), (1, 1))
        self.assertIn("code 3", words)
        code, _, words, runs = self.run_with(NONE, GOOD)
        self.assertEqual((code, runs), (1, 1))
        self.assertIn("does not say how correct", words)


if __name__ == "__main__":
    unittest.main()
