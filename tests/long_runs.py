"""What the scripts of long runs share (tests/fuzz/run, tests/soak, tests/kills): places, times, ledgers.

tests/scripts holds their tests."""

import csv
import ctypes
import datetime
import os
import pathlib
import re
import signal
import subprocess
import sys
import time

ROOT = pathlib.Path(__file__).resolve().parent.parent
TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")).resolve()


# Results of runs, which are in no program: a row that one run adds does not change the program of the next.
RESULTS = ["tests/fuzz/ledger.csv", "tests/soak.csv", "tests/kills.csv"]


def commit(root=ROOT):
    """The commit of the tree, with a + if tracked files other than results differ from it; "unknown" outside of git."""
    git = lambda *words: subprocess.run(["git", *words], cwd=root, capture_output=True, text=True).stdout.strip()
    name = git("describe", "--always", "--exclude=*")
    others = [f":(exclude){file}" for file in RESULTS]
    changed = git("status", "--porcelain", "--untracked-files=no", "--", ".", *others)
    return (name or "unknown") + ("+" if changed else "")


def iso(at):
    """A time in seconds since 1970 as a date."""
    return datetime.datetime.fromtimestamp(at).astimezone().isoformat(timespec="seconds")


def now():
    return iso(time.time())


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


def say_error(line):
    print(line, file=sys.stderr, flush=True)


def end_with(message, code=1):
    """Ends the script with one line on standard error."""
    say_error(message)
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

    def __init__(self, path, columns, numbers=()):
        """`numbers` names the columns that hold numbers. No field may contain a line break."""
        self.path, self.columns, self.numbers = path, columns, numbers
        self.has_warned = False

    def lines(self):
        """The bytes of the complete lines, and the rest: what a power cut has left of the last row."""
        content = self.path.read_bytes() if self.path.exists() else b""
        whole = content.rfind(b"\n") + 1
        return content[:whole], content[whole:]

    def rows(self):
        """All complete rows. A torn last row is left out with a warning; a wrong line elsewhere ends the script."""
        whole, torn = self.lines()
        lines = list(csv.reader(whole.decode(errors="replace").replace("\0", "?").splitlines()))
        if torn and not self.has_warned:
            self.has_warned = True
            at = f"{self.path}:{len(lines) + 1}"
            say_error(f"{at}: warning: a torn row is ignored, and the next row replaces it")
        if lines and lines[0] != self.columns:
            end_with(f"{self.path}: other columns than {','.join(self.columns)}; move the file away", 2)
        return [self.row(number, fields) for number, fields in enumerate(lines[1:], 2)]

    def row(self, number, fields):
        """The row on a line of the file."""
        fault = None
        if len(fields) != len(self.columns):
            fault = f"{len(fields)} fields instead of {len(self.columns)}"
        row = dict(zip(self.columns, fields))
        if not fault:
            fault = next((f"{name} is \"{row[name]}\"" for name in self.numbers if not is_count(row[name])), None)
        if fault:
            end_with(f"{self.path}:{number}: {fault}; correct or delete this line", 2)
        return row

    def append(self, row):
        """Adds a row, in the place of a torn one."""
        whole, torn = self.lines()
        with self.path.open("a", newline="") as file:
            if torn:
                file.truncate(len(whole))
            writer = csv.DictWriter(file, self.columns, lineterminator="\n")
            if not whole:
                writer.writeheader()
            writer.writerow(row)
            file.flush()
            os.fsync(file.fileno())


def is_count(text):
    return re.fullmatch(r"\d+(\.\d+)?", text) is not None
