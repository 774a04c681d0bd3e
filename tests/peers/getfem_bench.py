#!/usr/bin/python3
"""Measures GetFEM's times for the five bodies of the paper's Table 1, on the bundled organ, with one thread.

    /usr/bin/python3 getfem_bench.py [--cases a,b] [--mesh-dir ../../assets] [--csv FILE] [--repetitions N]
        [--clock cpu]

`bodies_bench.py --code getfem` under the name that `palpate bench fem --peer` is given. GetFEM keeps no analysis of
MUMPS, so its solve has analysis, factorisation and back-solve.
"""

from bodies_bench import main

if __name__ == "__main__":
    main("getfem", __doc__)
