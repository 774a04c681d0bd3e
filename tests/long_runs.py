"""What the scripts of long runs share (tests/fuzz/run, tests/soak, tests/kills): places, times, ledgers."""

import csv
import ctypes
import datetime
import os
import pathlib
import re
import signal
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")).resolve()


def commit():
    """The commit of the tree, with a + if tracked files differ from it; "unknown" outside of git."""
    command = ["git", "describe", "--always", "--dirty=+", "--exclude=*"]
    found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    return found.stdout.strip() or "unknown"


def now():
    return datetime.datetime.now().astimezone().isoformat(timespec="seconds")


def in_words(seconds):
    """A time such as 1 h 05 min, 3 min 20 s or 12 s."""
    seconds = int(round(max(seconds, 0)))
    if seconds >= 3600:
        return f"{seconds // 3600} h {seconds % 3600 // 60:02} min"
    return f"{seconds // 60} min {seconds % 60:02} s" if seconds >= 60 else f"{seconds} s"


def duration(text):
    """Seconds of a text such as 90, 90s, 5min or 2h, for argparse."""
    found = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(s|min|h|)", text)
    if not found:
        raise ValueError(text)
    return float(found[1]) * {"": 1, "s": 1, "min": 60, "h": 3600}[found[2]]


def say(line=""):
    print(line, flush=True)


def end_with(message, code=1):
    """Ends the script with one line on standard error."""
    print(message, file=sys.stderr)
    sys.exit(code)


def with_parent():
    """In a child before its program starts: a group of its own, which Ctrl-C at the terminal does not reach, and SIGINT
    when this script ends in any way."""
    os.setpgid(0, 0)
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    ctypes.CDLL(None).prctl(1, signal.SIGINT)


def interrupt_on_term():
    """Ctrl-C and a polite kill raise KeyboardInterrupt, also in the background, where shells let it be ignored."""
    for wanted in (signal.SIGINT, signal.SIGTERM):
        signal.signal(wanted, signal.default_int_handler)


class Ledger:
    """A CSV file with one row for each run."""

    def __init__(self, path, columns):
        self.path, self.columns = path, columns

    def rows(self):
        if not self.path.exists():
            return []
        with self.path.open(newline="") as file:
            rows = list(csv.DictReader(file))
        if rows and list(rows[0]) != self.columns:
            end_with(f"{self.path}: other columns than {','.join(self.columns)}; move the file away", 2)
        return rows

    def append(self, row):
        new = not self.path.exists()
        with self.path.open("a", newline="") as file:
            writer = csv.DictWriter(file, self.columns, lineterminator="\n")
            if new:
                writer.writeheader()
            writer.writerow(row)
            file.flush()
            os.fsync(file.fileno())
