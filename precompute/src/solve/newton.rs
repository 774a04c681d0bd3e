//! Newton-Raphson with line search at one prescribed position, ending in the condensed derivatives.

use nalgebra::Matrix3;

use super::{Configuration, Seed, Solver};
use crate::assembly::ActiveCoupling;

/// Convergence control.
#[derive(Debug, Clone, Copy)]
pub struct NewtonOptions {
    /// Iterations at most.
    pub max_iterations: u32,
    /// A state is converged when its residual is below this share of the force scale. One more correction follows,
    /// with the factor that the sensitivities need anyway, so the final residual is about its square.
    pub tolerance: f64,
    /// Halvings of a step that does not lower the residual.
    pub max_halvings: u32,
}

impl Default for NewtonOptions {
    fn default() -> Self {
        Self { max_iterations: 25, tolerance: 1e-8, max_halvings: 5 }
    }
}

/// Why a position could not be solved. Data, not a panic: the configuration space tags it and goes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FailureReason {
    /// Residual or state became infinite or NaN.
    NotFinite,
    /// The residual grew beyond any hope.
    Diverged,
    /// No fraction of the Newton step lowers the residual.
    LineSearch,
    /// The iteration limit was reached.
    MaxIterations,
    /// The tangent could not be solved to working accuracy.
    SingularTangent,
}

impl FailureReason {
    /// Name in stores and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::NotFinite => "not-finite",
            Self::Diverged => "diverged",
            Self::LineSearch => "line-search",
            Self::MaxIterations => "max-iterations",
            Self::SingularTangent => "singular-tangent",
        }
    }
}

/// A failed solve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SolveFailure {
    /// Why.
    pub reason: FailureReason,
    /// Iterations spent.
    pub iterations: u32,
    /// Last residual norm, N.
    pub residual_n: f64,
}

impl std::fmt::Display for SolveFailure {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "no equilibrium found ({} after {} iterations, residual {:.1e} N)",
            self.reason.name(),
            self.iterations,
            self.residual_n
        )
    }
}

impl std::error::Error for SolveFailure {}

/// A residual this many times the first one is hopeless.
const HOPELESS: f64 = 1e8;

impl Solver {
    /// Assembles at `state` and returns the residual norm, N.
    fn evaluate(&mut self, state: &[f64], with_tangent: bool) -> f64 {
        let problem = &*self.problem;
        if with_tangent {
            self.assembled.assemble(&problem.body, &problem.pattern, state);
        } else {
            self.assembled.assemble_residual(&problem.body, state);
        }
        self.assembled.residual_into(&problem.body, &problem.dofs, &mut self.residual);
        norm(&self.residual)
    }

    /// Force against which residuals are measured: the reaction, or a millionth of mu l^2 near rest.
    fn scale_n(&self) -> f64 {
        let h = self.assembled.force_at(self.problem.active_node);
        norm(&h) + 1e-6 * self.problem.body.force_scale_n()
    }

    /// state + omega * step over the unknowns (pressures rescaled to Pa).
    fn moved(&self, state: &[f64], omega: f64) -> Vec<f64> {
        let mut moved = state.to_vec();
        let forces = 3 * self.problem.body.node_count;
        let pressure_scale = self.problem.body.pressure_scale();
        for &(equation, position) in &self.positions {
            let unit = if position < forces { 1.0 } else { pressure_scale };
            moved[position] += omega * unit * self.step[equation];
        }
        moved
    }

    /// K step = -residual, with the tangent just assembled.
    fn newton_step(&mut self) -> bool {
        let problem = &*self.problem;
        for r in &mut self.residual {
            *r = -*r;
        }
        self.factor
            .factorise_and_solve(
                &problem.symbolic,
                &problem.pattern,
                &self.assembled.tangent,
                &self.residual,
                &mut self.step,
            )
            .is_ok()
    }

    /// Equilibrium with the active node at `displacement_m`, from the guess `state`.
    ///
    /// The first full step is always taken: prescribing the displacement puts the whole residual into the active
    /// node's elements, and spreading it over the body raises the norm legitimately. From then on a step is halved
    /// until the residual falls.
    ///
    /// At convergence, with K the tangent over the unknowns and K_fA its columns at the active node,
    /// X = -K^-1 K_fA (du/dd and dp/dd),   S = K_AA + K_Af X (symmetric).
    pub fn solve_at(
        &mut self,
        displacement_m: [f64; 3],
        mut state: Vec<f64>,
    ) -> Result<Configuration, SolveFailure> {
        let active = 3 * self.problem.active_node as usize;
        state[active..active + 3].copy_from_slice(&displacement_m);
        let mut iterations = 0;
        let mut residual_n = self.evaluate(&state, true);
        let first = residual_n.max(self.scale_n());
        loop {
            if !residual_n.is_finite() {
                return Err(failure(FailureReason::NotFinite, iterations, residual_n));
            }
            if residual_n > HOPELESS * first {
                return Err(failure(FailureReason::Diverged, iterations, residual_n));
            }
            let converged = residual_n <= self.newton.tolerance * self.scale_n();
            if !converged && iterations >= self.newton.max_iterations {
                return Err(failure(FailureReason::MaxIterations, iterations, residual_n));
            }
            if converged {
                return self.finish(displacement_m, state, residual_n, iterations);
            }
            if !self.newton_step() {
                return Err(failure(FailureReason::SingularTangent, iterations, residual_n));
            }
            iterations += 1;
            let mut omega = 1.0;
            let mut next = self.moved(&state, omega);
            let mut next_residual = self.evaluate(&next, true);
            if iterations > 1 {
                let mut halvings = 0;
                // A step into a NaN is halved too.
                while next_residual.is_nan() || next_residual >= residual_n {
                    if halvings == self.newton.max_halvings {
                        return Err(failure(FailureReason::LineSearch, iterations, residual_n));
                    }
                    halvings += 1;
                    omega *= 0.5;
                    next = self.moved(&state, omega);
                    next_residual = self.evaluate(&next, false);
                }
                if halvings > 0 {
                    next_residual = self.evaluate(&next, true);
                }
            }
            state = next;
            residual_n = next_residual;
        }
    }

    /// Sensitivities, last correction and condensed quantities; the tangent of the converged state is assembled.
    fn finish(
        &mut self,
        displacement_m: [f64; 3],
        mut state: Vec<f64>,
        mut residual_n: f64,
        iterations: u32,
    ) -> Result<Configuration, SolveFailure> {
        let problem = self.problem.clone();
        let (body, n) = (&problem.body, problem.unknowns());
        let coupling = ActiveCoupling::assemble(body, &problem.pattern, problem.active_node, &state);
        let right: Vec<f64> = coupling.free.iter().flatten().map(|k| -k).collect();
        let (pattern, tangent) = (&problem.pattern, &self.assembled.tangent);
        let solved =
            self.factor.factorise_and_solve(&problem.symbolic, pattern, tangent, &right, &mut self.columns);
        if solved.is_err() {
            return Err(failure(FailureReason::SingularTangent, iterations, residual_n));
        }
        let mut stiffness = coupling.own;
        let mut sensitivity = [(); 3].map(|()| vec![0.0; body.state_len()]);
        let forces = 3 * body.node_count;
        let pressure_scale = body.pressure_scale();
        for (j, state_column) in sensitivity.iter_mut().enumerate() {
            let x = &self.columns[j * n..(j + 1) * n];
            for (i, row) in coupling.free.iter().enumerate() {
                stiffness[(i, j)] += dot(row, x);
            }
            for &(equation, position) in &self.positions {
                let unit = if position < forces { 1.0 } else { pressure_scale };
                state_column[position] = unit * x[equation];
            }
            state_column[3 * problem.active_node as usize + j] = 1.0;
        }
        // Rounding leaves S unsymmetric in its last digits; it is symmetric by construction.
        let stiffness_n_m: Matrix3<f64> = 0.5 * (stiffness + stiffness.transpose());
        for r in &mut self.residual {
            *r = -*r;
        }
        self.factor.correct(&problem.symbolic, &self.residual, &mut self.step);
        let corrected = self.moved(&state, 1.0);
        let corrected_n = self.evaluate(&corrected, false);
        if corrected_n <= residual_n {
            (state, residual_n) = (corrected, corrected_n);
        } else {
            // At the rounding floor already.
            self.evaluate(&state, false);
        }
        let force_n = self.assembled.force_at(problem.active_node);
        if !(self.assembled.energy_j.is_finite() && stiffness_n_m.iter().all(|s| s.is_finite())) {
            return Err(failure(FailureReason::NotFinite, iterations, residual_n));
        }
        Ok(Configuration {
            seed: Seed { displacement_m, state, sensitivity },
            energy_j: self.assembled.energy_j,
            force_n,
            stiffness_n_m,
            residual_n,
            min_jacobian: self.assembled.min_jacobian,
            inverted: self.assembled.inverted,
            volume_m3: self.assembled.volume_m3,
            iterations,
            increments: 1,
        })
    }
}

fn failure(reason: FailureReason, iterations: u32, residual_n: f64) -> SolveFailure {
    SolveFailure { reason, iterations, residual_n }
}

fn norm(v: &[f64]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}
