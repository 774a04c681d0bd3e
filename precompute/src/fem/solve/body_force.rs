//! The rest state of a body under its body force: equilibrium without a handle.

use std::sync::Arc;

use super::{Problem, SolveFailure, Solver};
use crate::fem::body::Body;
use crate::fem::boundary::Constraints;

/// Maximum number of halvings of the load step before the solution fails.
const MAX_HALVINGS: u32 = 6;

/// Solves the rest state of a body with a body force; returns a body without body force unchanged.
///
/// The load is applied in the largest steps that converge, starting with the whole load. Displacements,
/// energy and reaction of all configurations are relative to the rest state.
pub fn solve_body_force(body: Body) -> Result<Body, SolveFailure> {
    if !body.is_loaded() {
        return Ok(body);
    }
    let body = Arc::new(body);
    let (rest_state, rest_energy_j) = {
        let problem = Problem::with(body.clone(), None, Constraints::Elimination);
        let mut solver = Solver::new(Arc::new(problem));
        // Always new factors, so that the last correction is an exact Newton step.
        solver.newton.frozen_factor = false;
        let (mut done, mut step, mut halvings, mut spent) = (0.0, 1.0f64, 0, 0);
        let mut rest_state = body.rest_state.clone();
        while done < 1.0 {
            solver.assembled.load_factor = (done + step).min(1.0);
            solver.state.copy_from_slice(&rest_state);
            match solver.equilibrate() {
                Ok((residual_n, iterations)) => {
                    // The last correction brings the residual to its rounding floor.
                    solver.final_correction(residual_n);
                    rest_state.copy_from_slice(&solver.state);
                    spent += iterations;
                    done += step;
                    step = (2.0 * step).min(1.0 - done);
                }
                Err(failure) => {
                    spent += failure.iterations;
                    halvings += 1;
                    if halvings > MAX_HALVINGS {
                        return Err(SolveFailure { iterations: spent, ..failure });
                    }
                    step *= 0.5;
                }
            }
        }
        (rest_state, solver.assembled.energy_j)
    };
    let mut body = Arc::into_inner(body).expect("problem and solver were dropped above");
    (body.rest_state, body.rest_energy_j) = (rest_state, rest_energy_j);
    Ok(body)
}
