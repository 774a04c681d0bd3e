"""What the parts of `records` share: the run, its programs, and a figure."""

import dataclasses
import json
import os
import pathlib
import subprocess
import sys


class Failure(Exception):
    """The records cannot be made; the message says why."""


@dataclasses.dataclass
class Figure:
    """One figure of one program. `ours` is Palpate's, if the program is another one and the two compare."""

    part: str
    case: str
    quantity: str
    unit: str
    system: str
    value: float
    ours: float | None = None
    against: str = ""  # Palpate's method or command of `ours`
    note: str = ""

    def ratio(self):
        """The peer's figure over Palpate's: above 1 Palpate is ahead. All quantities are better if smaller."""
        return None if self.ours is None else self.value / self.ours


@dataclasses.dataclass
class Run:
    here: pathlib.Path
    assets: pathlib.Path
    out: pathlib.Path
    quick: bool
    palpate: pathlib.Path | None = None
    python: pathlib.Path | None = None

    def __post_init__(self):
        # The last available core: the first handles most interrupts.
        self.core = max(os.sched_getaffinity(0))

    def say(self, what):
        print(f"records: {what}", file=sys.stderr, flush=True)

    def execute(self, command, pinned=True):
        """Runs a program, on one core if pinned, and returns its standard output."""
        pin = (lambda: os.sched_setaffinity(0, {self.core})) if pinned else None
        command = [str(word) for word in command]
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, text=True, preexec_fn=pin, check=False
        )
        if done.returncode != 0:
            last = (done.stderr.strip() or "no message").splitlines()[-1]
            raise Failure(f"{pathlib.Path(command[0]).name} {' '.join(command[1:4])} ...: {last}")
        return done.stdout

    def ask(self, *arguments, pinned=True):
        """The JSON that a command of Palpate prints."""
        return json.loads(self.execute([self.palpate, *arguments, "--json"], pinned))


def scene(node, name, grid):
    """The small organ with one active node, beside its mesh."""
    return f"""name = "records"
[mesh]
file = "liver-small.msh"
[material]
law = "mooney-rivlin"
c10_pa = 1300.0
c01_pa = 1280.0
[fixed]
group = "F1"
[[active]]
name = "{name}"
node = {node}
[grid]
radius_m = 0.05
{grid}
[device]
max_force_n = 8.0
"""
