//! The jets of all contacts of a body at rest by one factor: that of the free body.
//!
//! Let K be the tangent of the free body at rest, E the unit columns of the equations of a held node, and
//! Y = K^-1 E. The body under the displacements I of that node has
//!
//! X = Y (E' Y)^-1,   S = (E' Y)^-1,
//!
//! so a contact costs three solves instead of a factorisation. A fingertip adds the stiffness of its pad to K;
//! there the factor serves the steps of the generalised conjugate residuals.

use std::sync::Arc;

use super::factor::{Accuracy, Factor, MAX_STEPS, RIGHT_SIDES, held_stiffness};
use super::follow::{FollowCount, Followed};
use super::{FailureReason, Problem, Seed, SolveFailure, Solver};
use crate::fem::boundary::{Contact, Pose};

/// Accuracy of Y.
const COLUMNS: Accuracy = Accuracy::new(1e-4, 1e-2);
/// Accepted relative residual of X.
const ACCEPTED: f64 = 1e-2;

/// The tangent of a body at rest without a contact, and its factor.
#[derive(Debug)]
pub struct FreeBody {
    solver: Solver,
}

impl FreeBody {
    /// Factorises the tangent of a problem without a contact; `None` if it is singular.
    pub fn new(problem: &Arc<Problem>) -> Option<Self> {
        let mut solver = Solver::new(problem.clone());
        solver.state.copy_from_slice(&problem.body.rest_state);
        solver.evaluate(true);
        let is_regular = solver.factor.factorise_first(problem.matrix(&solver.assembled.tangent));
        is_regular.then_some(Self { solver })
    }

    /// Copies the factor, with these equations held; whether it serves.
    pub(super) fn lend_factor(&mut self, held: Option<[usize; 3]>, to: &mut Factor) -> bool {
        to.copy_from(&self.solver.factor)
            && held.is_none_or(|equations| {
                let (is_accurate, unit_loads) = self.unit_loads(equations);
                is_accurate && to.hold(equations, unit_loads)
            })
    }

    /// Y for these equations; the first value is whether it is accurate.
    fn unit_loads(&mut self, equations: [usize; 3]) -> (bool, &[f64]) {
        let Solver { problem, factor, assembled, right, columns, .. } = &mut self.solver;
        let n = problem.unknowns();
        right.fill(0.0);
        for (axis, equation) in equations.into_iter().enumerate() {
            right[axis * n + equation] = 1.0;
        }
        let residual = factor.solve(problem.matrix(&assembled.tangent), right, columns, COLUMNS);
        (residual <= ACCEPTED, columns)
    }
}

impl Solver {
    /// The body at rest with the contact of this solver, by the factor of the free body, written into `to`.
    ///
    /// # Errors
    ///
    /// [`FailureReason::SingularTangent`] if the factor of the free body does not serve.
    pub fn rest_by(&mut self, free: &mut FreeBody, to: &mut Seed) -> Result<Followed, SolveFailure> {
        let problem = self.problem.clone();
        let pose = Pose::default();
        self.state.copy_from_slice(&problem.body.rest_state);
        self.prescribe(&pose);
        self.history.clear();
        let residual_n = self.evaluate(true);
        self.translation_columns();
        let held = problem.contact.as_ref().and_then(Contact::handle);
        let count = match held {
            Some(handle) => {
                let equations = problem.dofs.displacement(handle.centre).map(|equation| equation as usize);
                let (is_accurate, unit_loads) = free.unit_loads(equations);
                if !is_accurate || !self.hold(unit_loads, equations) {
                    let reason = FailureReason::SingularTangent;
                    return Err(SolveFailure { reason, iterations: 0, residual_n });
                }
                FollowCount::default()
            }
            None => {
                self.columns.fill(0.0);
                let matrix = problem.matrix(&self.assembled.tangent);
                let (columns, goal) = (&mut self.columns, (ACCEPTED, MAX_STEPS));
                let factor = &mut free.solver.factor;
                let (_, sweeps) = factor.refine(matrix, &self.right, columns, goal);
                FollowCount { sweeps, ..FollowCount::default() }
            }
        };
        let matrix = problem.matrix(&self.assembled.tangent);
        let residual = self.factor.measure(matrix, &self.right, &self.columns).worst();
        // The comparison is false for NaN.
        let sensitivity = (residual <= ACCEPTED).then_some(residual);
        self.conclude(&pose, residual_n, sensitivity, count, to)
    }

    /// X = Y (E' Y)^-1 into the columns; whether E' Y is regular.
    fn hold(&mut self, unit_loads: &[f64], equations: [usize; 3]) -> bool {
        let n = self.problem.unknowns();
        let Some(stiffness) = held_stiffness(equations, unit_loads) else { return false };
        for column in 0..RIGHT_SIDES {
            for equation in 0..n {
                let terms = (0..RIGHT_SIDES).map(|k| unit_loads[k * n + equation] * stiffness[(k, column)]);
                self.columns[column * n + equation] = terms.sum();
            }
            // The node itself is no unknown.
            for equation in equations {
                self.columns[column * n + equation] = 0.0;
            }
        }
        true
    }
}
