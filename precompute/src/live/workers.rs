//! The solvers of the contacts that were solved last, each with the factor that it has made.
//!
//! A touch alternates between three contacts. With a solver for each, every one of them keeps its factor. Contacts at
//! rest have a solver of their own, because they need no factor.

use std::sync::Arc;

use crate::fem::{Problem, Solver};

/// Number of solvers: the corners of a triangle, and the contact that the tool slips to.
const WORKERS: usize = 4;

/// The factor of a solver.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Made {
    /// There is none, or nobody knows of which state.
    Unknown,
    /// That of the free body.
    Free,
    /// Of a contact with the tool at this control.
    At(u16, [f64; 3]),
}

/// A solver, the contact it is at, and its factor.
#[derive(Debug)]
pub(super) struct Worker {
    pub(super) solver: Solver,
    contact: Option<u16>,
    pub(super) factor: Made,
    used: u64,
}

/// The solvers of a session.
#[derive(Debug)]
pub(super) struct Workers {
    all: Vec<Worker>,
    /// The present one.
    at: usize,
    uses: u64,
}

impl Workers {
    /// Solvers for contacts with the numbering of this problem.
    pub(super) fn new(problem: &Arc<Problem>) -> Self {
        let worker = |_| Worker {
            solver: Solver::new(problem.clone()),
            contact: None,
            factor: Made::Unknown,
            used: 0,
        };
        Self { all: (0..=WORKERS).map(worker).collect(), at: 0, uses: 0 }
    }

    /// The present solver.
    pub(super) fn present(&mut self) -> &mut Worker {
        &mut self.all[self.at]
    }

    /// Goes to a contact at rest with the solver for these.
    pub(super) fn rest_at(&mut self, problem: Arc<Problem>) {
        self.at = WORKERS;
        let worker = &mut self.all[WORKERS];
        worker.solver.touch(problem);
        worker.factor = Made::Unknown;
    }

    /// Goes to a contact: to its solver, or with the one that was used longest ago.
    pub(super) fn go_to(&mut self, contact: u16, problem: Arc<Problem>) {
        let own = self.all.iter().position(|worker| worker.contact == Some(contact));
        let oldest = || (0..WORKERS).min_by_key(|&at| self.all[at].used);
        self.at = own.or_else(oldest).expect("there are solvers");
        self.uses += 1;
        let worker = &mut self.all[self.at];
        worker.used = self.uses;
        if own.is_none() {
            worker.solver.touch(problem);
            worker.contact = Some(contact);
        }
    }

    /// The next solve at a contact makes a new factor.
    pub(super) fn forget_factor(&mut self, contact: u16) {
        let own = self.all.iter_mut().filter(|worker| worker.contact == Some(contact));
        own.for_each(|worker| worker.factor = Made::Unknown);
    }

    /// Where the factor of a contact was made, if it has one of its own.
    pub(super) fn factor_of(&self, contact: u16) -> Option<[f64; 3]> {
        match self.all.iter().find(|worker| worker.contact == Some(contact))?.factor {
            Made::At(of, control_m) if of == contact => Some(control_m),
            _ => None,
        }
    }

    /// The solver of a contact, if it has one.
    pub(super) fn of(&mut self, contact: u16) -> Option<&mut Worker> {
        self.all.iter_mut().find(|worker| worker.contact == Some(contact))
    }
}
