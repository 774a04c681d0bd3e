//! The jets of a session, and the force from them.

use super::frame::Jet;
use crate::field::{Field, Touch};
use crate::method::ForceSample;
use crate::num::vec3::Vec3;

/// State of the solver as its heartbeat shows it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Solver {
    /// It works.
    #[default]
    Alive,
    /// No heartbeat for a while: inside the trust of the jets nothing changes, but the time counts.
    Silent,
    /// It has ended or hangs: the force fades out.
    Gone,
}

/// Jets of at most `CONTACTS` contact points, `JETS` for each; its size is fixed.
#[derive(Debug, Clone, PartialEq)]
pub struct JetMemory<const CONTACTS: usize, const JETS: usize = 256> {
    jets: [[Jet; JETS]; CONTACTS],
    solver: Solver,
}

impl<const CONTACTS: usize, const JETS: usize> Default for JetMemory<CONTACTS, JETS> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const CONTACTS: usize, const JETS: usize> JetMemory<CONTACTS, JETS> {
    /// Without jets.
    ///
    /// 64 contacts of 256 jets take 2 MB, as much as the whole stack of a thread: box it in a thread that has
    /// more.
    pub fn new() -> Self {
        Self { jets: [[Jet::default(); JETS]; CONTACTS], solver: Solver::Alive }
    }

    /// Adds a jet. Returns false if it was refused: a number is out of range, or all tables are in use by
    /// the present touch.
    pub fn insert(&mut self, jet: &Jet) -> bool {
        jet.check().is_ok()
    }

    /// States whether the solver is alive, from the next tick on.
    pub fn solver(&mut self, solver: Solver) {
        self.solver = solver;
    }

    /// Number of jets of a contact.
    pub fn jets(&self, _contact: u16) -> usize {
        0
    }

    /// Number of times that the active jet of a touched contact has changed.
    pub fn hand_overs(&self) -> u32 {
        0
    }
}

impl<const CONTACTS: usize, const JETS: usize> Field for JetMemory<CONTACTS, JETS> {
    fn force(&mut self, _touch: &Touch) -> Option<ForceSample> {
        None
    }

    fn energy_j(&self, _space: u16, _displacement_m: Vec3) -> Option<f32> {
        None
    }
}
