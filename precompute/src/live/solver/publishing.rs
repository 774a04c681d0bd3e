//! What the loop gets of a solved state.

use super::super::published::Published;
use super::super::workers::Made;
use super::LiveSolver;
use super::solving::OPTIONS;
use crate::fem::{Coupling, Pose, Seed};
use crate::num::jet::EnergyJet;
use crate::num::vector::norm;

/// The force of a sphere that begins to touch rises faster than the derivatives there tell: without a root a jet below this
/// force, N, is trusted to this distance, m.
const LIGHT_N: f64 = 0.1;
const LIGHT_TRUST_M: f64 = 5e-4;
/// A jet of a sphere that a partner has freed from the skin is trusted to this distance at least, m.
const BESIDE_PARTNER_M: f64 = 1e-3;

impl LiveSolver {
    /// Energy and force of the partner without the tool, J and N: with the tool beside the body; `None` where that is not found.
    fn alone(&mut self, coupling: Coupling) -> Option<(f64, [f64; 3])> {
        if coupling.force_n == [0.0; 3] {
            return Some((0.0, [0.0; 3]));
        }
        let is_here = |seed: &Seed| seed.coupling.is_some_and(|of| of.partner_m == coupling.partner_m);
        if !self.alone.as_ref().is_some_and(is_here) {
            let from = self.alone.take().unwrap_or_else(|| Seed::at_rest(&self.body));
            let mut to = self.states.room();
            let worker = self.workers.present();
            let mut found = worker.solver.follow(&from, [0.0; 3], false, &OPTIONS, &mut to).is_ok();
            if !found {
                // A partner that pressed before the tool came is far from where it was known.
                worker.factor = Made::Unknown;
                let solved = worker.solver.solve_at(&Pose::default(), &from.state);
                found = solved.map(|solved| to = solved.seed).is_ok();
            }
            self.states.give_back(if found { from } else { std::mem::replace(&mut to, from) });
            self.alone = found.then_some(to);
        }
        let seed = self.alone.as_ref()?;
        Some((seed.jet.energy_j, seed.coupling?.force_n))
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
        let beside = coupling.map(|coupling| {
            let alone = self.alone(coupling);
            jet.energy_j -= alone.map_or(0.0, |(energy_j, _)| energy_j);
            (coupling, alone.map(|(_, force_n)| force_n))
        });
        if jet.is_free() {
            jet.energy_j = 0.0;
        }
        let known = &mut self.known[usize::from(contact)];
        let mut trust = known.trust(jet, beside);
        if let Some(sphere) = self.skin.sphere() {
            if jet.is_free() {
                let clearance_m = sphere.clearance_m(&self.body, jet.control_m);
                // The partner presses the skin away.
                let least_m = if coupling.is_some() { BESIDE_PARTNER_M } else { 0.0 };
                trust.shrink_to(clearance_m.max(least_m));
            } else if trust.root.is_none() && norm(jet.force_n) < LIGHT_N {
                trust.shrink_to(LIGHT_TRUST_M);
            }
        }
        known.add(trust, branch, !joins);
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
