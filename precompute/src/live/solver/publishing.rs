//! What the loop gets of a solved state.

use super::super::memory::{Known, Trust};
use super::super::published::Published;
use super::LiveSolver;
use crate::fem::{Coupling, Second};
use crate::num::jet::EnergyJet;
use crate::num::vector::norm;

/// The force of a sphere that begins to touch rises faster than the derivatives there tell: without a root a jet below this
/// force, N, is trusted to this distance, m.
const LIGHT_N: f64 = 0.1;
const LIGHT_TRUST_M: f64 = 5e-4;
/// A jet of a sphere that a partner has freed from the skin is trusted to this distance at least, m.
const BESIDE_PARTNER_M: f64 = 1e-3;

impl LiveSolver {
    /// All jets of a contact, as if they were found anew.
    pub fn jets(&self, contact: u16) -> impl Iterator<Item = Published> {
        let known = self.known.get(usize::from(contact)).filter(|_| !self.holds_back);
        known.into_iter().flat_map(move |known| as_new(known, contact, self.model))
    }

    /// Enters a jet in the memory, and in the queue for the loop. If it does not join, jets that contradict it are
    /// removed.
    pub(super) fn publish(
        &mut self,
        contact: u16,
        branch: u32,
        (mut jet, coupling): (EnergyJet, Option<Coupling>),
        joins: bool,
        unstable_modes: Option<u32>,
    ) {
        if jet.is_free() {
            jet.energy_j = 0.0;
        }
        let is_of_fixed_part = self.is_of_fixed_part(&jet, coupling.as_ref());
        let known = &mut self.known[usize::from(contact)];
        let mut trust = Trust { is_of_fixed_part, ..known.trust(jet, coupling) };
        if let Some(sphere) = self.skin.sphere() {
            if jet.is_free() {
                let clearance_m = sphere.clearance_m(&self.body, jet.control_m);
                // The partner presses the skin away.
                let is_beside = coupling.is_some_and(|coupling| coupling.of == Second::Partner);
                let least_m = if is_beside { BESIDE_PARTNER_M } else { 0.0 };
                trust.shrink_to(clearance_m.max(least_m));
            } else if trust.root.is_none() && norm(jet.force_n) < LIGHT_N {
                trust.shrink_to(LIGHT_TRUST_M);
            }
        }
        known.add(trust, branch, !joins);
        self.uses(contact);
        self.give_up_old();
        self.totals.jets += 1;
        self.outbox.push_back(Published {
            contact,
            trust,
            joins,
            is_fresh: unstable_modes.is_some(),
            is_unstable: unstable_modes.is_some_and(|modes| modes > 0),
            model: self.model,
        });
    }
}

/// The jets of a contact, as if they were found anew.
pub(super) fn as_new(known: &Known, contact: u16, model: u32) -> impl Iterator<Item = Published> {
    known.jets().map(move |&trust| Published {
        contact,
        trust,
        joins: true,
        is_fresh: false,
        is_unstable: false,
        model,
    })
}
