//! Factors that a solver gets from elsewhere: made on another thread while it goes on with its old one, or that of
//! the free body.
//!
//! The factor M of the free body serves a contact that has none of its own. With a held node, whose equations have
//! the unit columns E, it becomes that of the body with this node by
//!
//! x = M^-1 r - Y (E' Y)^-1 E' M^-1 r,   Y = M^-1 E,
//!
//! which is zero at the node. A fingertip adds the stiffness of its pad, of low rank, which the steps with a frozen
//! factor and the residual steps make up for.

use std::sync::Arc;

use super::factor::Factor;
use super::{FreeBody, Problem, Seed, Solver};
use crate::fem::boundary::Contact;

/// The memory of one new factor. It goes to the thread that makes it and back.
#[derive(Debug)]
pub struct Renewal {
    problem: Arc<Problem>,
    tangent: Vec<f64>,
    factor: Factor,
    is_made: bool,
}

impl Renewal {
    /// For problems with the numbering of this one.
    pub fn like(problem: &Arc<Problem>) -> Self {
        Self {
            problem: problem.clone(),
            tangent: vec![0.0; problem.pattern.entries()],
            factor: Factor::new(&problem.symbolic, &problem.pattern),
            is_made: false,
        }
    }

    /// Factorises the tangent that [`Solver::lend`] has written.
    pub fn make(&mut self) {
        self.is_made = self.factor.factorise_first(self.problem.matrix(&self.tangent));
    }

    /// Whether [`Renewal::make`] has made the factor of a state that is not known to be unstable.
    pub fn serves(&self) -> bool {
        self.is_made && self.factor.unstable_modes(&self.problem.symbolic).is_none_or(|modes| modes == 0)
    }
}

impl Solver {
    /// Writes the tangent at a state of this contact for a new factor.
    pub fn lend(&mut self, seed: &Seed, renewal: &mut Renewal) {
        self.state.copy_from_slice(&seed.state);
        self.prescribe(&seed.pose);
        self.history.clear();
        self.evaluate(true);
        renewal.problem = self.problem.clone();
        renewal.is_made = false;
        let entries = renewal.tangent.len();
        renewal.tangent.copy_from_slice(&self.assembled.tangent[..entries]);
    }

    /// Goes on with a new factor, and leaves the old one.
    pub fn renew_by(&mut self, renewal: &mut Renewal) {
        std::mem::swap(&mut self.factor, &mut renewal.factor);
        self.history.clear();
    }

    /// Goes on with the factor of the free body; whether it serves.
    pub fn borrow_factor(&mut self, free: &mut FreeBody) -> bool {
        let held = self.problem.contact.as_ref().and_then(Contact::handle);
        let equations = held
            .map(|handle| self.problem.dofs.displacement(handle.centre).map(|equation| equation as usize));
        self.history.clear();
        free.lend_factor(equations, &mut self.factor)
    }
}
