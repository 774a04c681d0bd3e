//! What a step of the live solver gives.

use palpate_core::{Jet, JetCoupling, JetFlags};

use super::memory::Trust;
use crate::num::SECOND_INDICES;
use crate::num::jet::EnergyJet;
use crate::num::vector::distance;

/// A jet that the loop has not got yet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Published {
    /// The contact.
    pub contact: u16,
    /// The jet, limited and with its trust radius.
    pub trust: Trust,
    /// Whether it lies on the branch of the state that it was continued from. If not, jets that do not agree with
    /// it are removed.
    pub joins: bool,
    /// Whether its factor is new, so that the next flag is known.
    pub is_fresh: bool,
    /// Whether the state is unstable.
    pub is_unstable: bool,
    /// Number of the model: jets of an earlier one no longer count.
    pub model: u32,
}

impl Published {
    /// Distance of its control from another one, m.
    pub fn distance_m(&self, control_m: [f64; 3]) -> f64 {
        distance(self.trust.jet.control_m, control_m)
    }

    /// The jet for the loop, with its number in the session.
    pub fn jet(&self, sequence: u32) -> Jet {
        let EnergyJet { control_m, energy_j, force_n, stiffness_n_m, third_n_m2 } =
            self.trust.root.unwrap_or(self.trust.jet);
        let flags = JetFlags {
            joined: self.joins,
            fresh: self.is_fresh,
            unstable: self.is_unstable,
            flush_before: !self.joins,
            root: self.trust.root.is_some(),
            fixed: self.trust.is_of_fixed_part,
        };
        Jet {
            contact: self.contact,
            sequence,
            flags,
            control_m: control_m.map(|x| x as f32),
            energy_j: energy_j as f32,
            force_n: force_n.map(|x| x as f32),
            stiffness_n_m: SECOND_INDICES.map(|[i, j]| stiffness_n_m[(i, j)] as f32),
            third_n_m2: third_n_m2.map(|x| x as f32),
            trust_m: self.trust.radius_m as f32,
            coupling: self.trust.coupling.map(|coupling| JetCoupling {
                control_m: coupling.second_m.map(|x| x as f32),
                slope_n: coupling.force_n.map(|x| x as f32),
                own_n_m: SECOND_INDICES.map(|[i, j]| coupling.own_n_m[(i, j)] as f32),
                mixed_n_m: std::array::from_fn(|i| {
                    std::array::from_fn(|j| coupling.mixed_n_m[(i, j)] as f32)
                }),
            }),
            model: self.model,
        }
    }
}

/// What a step did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Step {
    /// Everything near the hand is known.
    Idle,
    /// A jet was solved; the solver publishes it at once or with others.
    Solved,
    /// A new factor is being made beside the steps from now on.
    Renewing,
    /// The body under the partner alone was solved: the next touch starts from it.
    Followed,
    /// No equilibrium was found where the hand is.
    Lost {
        /// The contact.
        contact: u16,
        /// The position, m.
        control_m: [f64; 3],
    },
}

/// Work since the start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Totals {
    /// Jets.
    pub jets: u64,
    /// Factorisations.
    pub factorisations: u64,
    /// Jets that were found by a descent.
    pub landings: u64,
    /// Positions where nothing was found.
    pub lost: u64,
}
