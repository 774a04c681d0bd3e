"""What the bodies of every code have in common: liver's parameters, Newton's method, times.

Import this module before numpy: it limits every BLAS to one thread, for comparable times and repeatable digits.
"""

import os

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"

import sys
import time

try:
    import numpy as np
except ImportError as error:
    sys.exit(f"numpy is missing: run tests/peers/install, then use /usr/bin/python3 ({error})")

# Liver, as in the bundled scenes and in the paper.
YOUNG_PA, POISSON = 15480.0, 0.49
LAMBDA_PA = YOUNG_PA * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
MU_PA = YOUNG_PA / (2 * (1 + POISSON))
C10_PA, C01_PA = 1300.0, 1280.0
PARAMETERS_PA = {"lambda": LAMBDA_PA, "mu": MU_PA, "c10": C10_PA, "c01": C01_PA}

_clock = time.perf_counter


def clock():
    """Seconds of the clock of all times: wall time, or CPU time after `use_cpu_time`."""
    return _clock()


def use_cpu_time():
    """Measures CPU time, for a busy machine."""
    global _clock
    _clock = time.process_time


class Failed(Exception):
    """No equilibrium found."""


class NewtonBody:
    """A body whose equilibrium Newton's method finds. The finite-element code is that of the derived class.

    It sets `rest` (the vector of all unknowns at rest), `free` (indices of the unknowns that are solved for),
    `active` (indices of u at the active node), and calls `scale_residual`. It defines

        residual(state) -> (values over all unknowns: N and m3, seconds)
        tangent() -> (matrix over all unknowns at the state of the last residual, seconds)
        solve_linear(tangent, right) -> (solution over the free unknowns, seconds)
        coupling(tangent, direction) -> K_fA direction
        smallest_jacobian(state) -> smallest det F over the quadrature points

    where the seconds are those of the code's own calls, without copies into Python.
    """

    def scale_residual(self, mesh, pressure_unknowns):
        """Residuals of the constraint (m3) are measured as forces: times mu over the body's size, Pa/m."""
        volume = np.abs(np.linalg.det(mesh.nodes[mesh.tets[:, 1:]] - mesh.nodes[mesh.tets[:, :1]])).sum() / 6
        self.weight = np.ones(len(self.rest))
        self.weight[pressure_unknowns] = MU_PA / volume ** (1 / 3)
        self.force_floor_n = 1e-6 * MU_PA * volume ** (2 / 3)

    def norm(self, residual):
        return np.linalg.norm((self.weight * residual)[self.free])

    def solve_at(self, displacement, state, tolerance=1e-8, max_iterations=30, final_corrections=0, record=None):
        """Newton's method at u_A = displacement from the guess `state`.

        Returns (state, force / N, iterations, relative residual).

        Converged at a residual of `tolerance` times the reaction (2-norms). The first step is always taken in
        full. It may raise the residual, which is concentrated in the elements around the active node before.
        Later steps are halved, up to five times, if the residual is a NaN or grows tenfold. After convergence
        up to `final_corrections` more iterations follow while they lower the residual. `record` collects the
        (assembly, solve) seconds of every iteration; a residual alone, as at the end, counts as (assembly,
        None).
        """
        state = state.copy()
        state[self.active] = displacement
        residual, seconds = self.residual(state)
        iterations = 0
        extra = 0
        while True:
            size, force = self.norm(residual), residual[self.active]
            scale = np.linalg.norm(force) + self.force_floor_n
            if not np.isfinite(size) or size > 1e8 * scale:
                raise Failed(f"diverged after {iterations} iterations")
            if size <= tolerance * scale:
                if extra == final_corrections:
                    break
                extra += 1
            elif iterations >= max_iterations:
                raise Failed(f"not converged after {iterations} iterations, residual {size / scale:.1e} of the force")
            matrix, assembly = self.tangent()
            step, solve = self.solve_linear(matrix, -residual[self.free])
            if record is not None:
                record.append((seconds + assembly, solve))
            iterations += 1
            omega, seconds = 1.0, 0.0
            for _ in range(6):
                trial = state.copy()
                trial[self.free] += omega * step
                trial_residual, taken = self.residual(trial)
                seconds += taken
                trial_size = self.norm(trial_residual)
                if np.isfinite(trial_size) and (iterations == 1 or trial_size < 10 * size):
                    break
                omega *= 0.5
            if extra and trial_size >= size:
                break
            state, residual = trial, trial_residual
        if record is not None:
            record.append((seconds, None))
        return state, residual[self.active].copy(), iterations, size / scale
