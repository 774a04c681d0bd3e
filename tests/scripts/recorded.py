"""What the tests of the scripts share: the scripts as modules, and output that libFuzzer has printed."""

import importlib.machinery
import importlib.util
import pathlib
import sys

TESTS = pathlib.Path(__file__).resolve().parents[1]


def script(path):
    """A script of tests/ as a module, without a file of bytecode beside it."""
    sys.dont_write_bytecode = True
    name = path.replace("/", "_")
    loader = importlib.machinery.SourceFileLoader(name, str(TESTS / path))
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader(name, loader))
    loader.exec_module(module)
    return module


# The beginning of every run, before the first execution.
LOADED = """\
WARNING: Failed to find function "__sanitizer_print_stack_trace".
INFO: Running with entropic power schedule (0xFF, 100).
INFO: Seed: 1897152674
INFO: Loaded 1 modules   (691 inline 8-bit counters): 691 [0x55bc3d658548, 0x55bc3d6587fb),
INFO: Loaded 1 PC tables (691 PCs): 691 [0x55bc3d658800,0x55bc3d65b330),
INFO:     4736 files found in jets
INFO: seed corpus: files: 4914 min: 1b max: 4068b total: 7071419b rss: 28Mb
"""

# A run that was killed: its log ends in the middle of a line.
KILLED = LOADED + """\
#4915\tINITED cov: 389 ft: 2229 corp: 720/973Kb exec/s: 0 rss: 29Mb
#31362\tREDUCE cov: 389 ft: 2229 corp: 720/972Kb lim: 4096 exec/s: 31362 rss: 31Mb L: 3313/4050 MS: 1 EraseBytes-
#672250\tNEW    cov: 390 ft: 2234 corp: 725/983Kb lim: 4096 exec/s: 6526 rss: 34Mb L: 2665/3994 MS: 1 CopyPart-
#689603\tRED"""

# A run that ended after its time. The last new input came before the last execution.
DONE = KILLED.removesuffix("#689603\tRED") + """\
#908046\tDONE   cov: 389 ft: 2234 corp: 725/983Kb lim: 4096 exec/s: 3006 rss: 34Mb
###### Recommended dictionary. ######
"\\001\\000" # Uses: 22001
###### End of recommended dictionary. ######
Done 908050 runs in 302 second(s)
stat::number_of_executed_units: 908050
stat::average_exec_per_sec:     3006
stat::peak_rss_mb:              34
"""

# A run that the user ended.
ENDED = KILLED.removesuffix("#689603\tRED") + """\
==4242== libFuzzer: run interrupted; exiting
stat::number_of_executed_units: 672300
"""

PANIC = """\
thread '<unnamed>' panicked at targets/jets.rs:12:5:
assertion failed: read.is_ok()
"""

CRASH = PANIC + """\
==4242== ERROR: libFuzzer: deadly signal
NOTE: libFuzzer has rudimentary signal handlers.
SUMMARY: libFuzzer: deadly signal
MS: 0 ; base unit: 0000000000000000000000000000000000000000
artifact_prefix='crashes/jets-'; Test unit written to crashes/jets-crash-0f
"""
