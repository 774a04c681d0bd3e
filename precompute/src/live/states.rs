//! The solved states that are kept as starts of the next continuations.

use super::beyond::parted_m;
use super::hand::Hand;
use crate::fem::{Body, Seed};
use crate::num::vector::distance;

/// Number of kept states. Each has four state vectors: 0.3 MB at 10,000 equations.
const KEPT: usize = 32;
/// Further ones that are in use: the result of a step, and the body under a partner.
const SPARE: usize = 2;

/// A state of one contact.
#[derive(Debug)]
struct Kept {
    contact: u16,
    branch: u32,
    seed: Seed,
    /// When it was last used; the state used longest ago is replaced.
    used: u64,
    /// Whether it is a guess for a model that has changed.
    is_guess: bool,
}

/// A state to start from.
#[derive(Debug)]
pub(super) struct Start {
    pub(super) seed: Seed,
    /// Whether its jet is not that of the present model.
    pub(super) is_guess: bool,
}

/// The kept states. All memory is taken at the start.
#[derive(Debug)]
pub(super) struct States {
    kept: Vec<Kept>,
    free: Vec<Seed>,
    uses: u64,
    /// The second control now.
    second_m: Option<[f64; 3]>,
}

impl States {
    /// Room for states like this one.
    pub(super) fn like(seed: &Seed) -> Self {
        Self {
            kept: Vec::with_capacity(KEPT),
            free: vec![seed.clone(); KEPT + SPARE],
            uses: 0,
            second_m: None,
        }
    }

    /// Takes out the state of a branch of a contact that is nearest to a control, if there is one.
    pub(super) fn take_nearest(&mut self, contact: u16, branch: u32, control_m: [f64; 3]) -> Option<Start> {
        let away = |kept: &Kept| self.away_m(&kept.seed, control_m);
        let is_of = |kept: &Kept| kept.contact == contact && kept.branch == branch;
        let of_branch = self.kept.iter().enumerate().filter(|(_, kept)| is_of(kept));
        let (nearest, _) = of_branch.min_by(|(_, a), (_, b)| away(a).total_cmp(&away(b)))?;
        let Kept { seed, is_guess, .. } = self.kept.swap_remove(nearest);
        let is_guess = is_guess || parted_m(second_of(&seed), self.second_m) > 0.0;
        Some(Start { seed, is_guess })
    }

    /// The second control is this one now: states of another one are guesses.
    pub(super) fn face(&mut self, second_m: Option<[f64; 3]>) {
        self.second_m = second_m;
    }

    /// Distance of a state from a control with the present second one, m.
    pub(super) fn away_m(&self, seed: &Seed, control_m: [f64; 3]) -> f64 {
        libm::hypot(distance(seed.jet.control_m, control_m), parted_m(second_of(seed), self.second_m))
    }

    /// The state of a branch of a contact that is nearest to a control.
    pub(super) fn nearest(&self, contact: u16, branch: u32, control_m: [f64; 3]) -> Option<&Seed> {
        let away = |(_, seed): &(u32, &Seed)| self.away_m(seed, control_m);
        let of_branch = self.of(contact).filter(|(of, _)| *of == branch);
        of_branch.min_by(|a, b| away(a).total_cmp(&away(b))).map(|(_, seed)| seed)
    }

    /// All states of a contact, with their branches.
    pub(super) fn of(&self, contact: u16) -> impl Iterator<Item = (u32, &Seed)> {
        let is_of = move |kept: &&Kept| kept.contact == contact;
        self.kept.iter().filter(is_of).map(|kept| (kept.branch, &kept.seed))
    }

    /// Room for a new state: its numbers are to be overwritten.
    pub(super) fn room(&mut self) -> Seed {
        if let Some(seed) = self.free.pop() {
            return seed;
        }
        // A contact with few states keeps them: without one its next solve would start at rest.
        let many = |at: usize| {
            let of = self.kept[at].contact;
            self.kept.iter().filter(|kept| kept.contact == of).count()
        };
        let least = (0..self.kept.len()).min_by_key(|&at| (usize::MAX - many(at), self.kept[at].used));
        self.kept.swap_remove(least.expect("all but two states are free or kept")).seed
    }

    /// Keeps a state of a branch.
    pub(super) fn keep(&mut self, contact: u16, branch: u32, Start { seed, is_guess }: Start) {
        self.uses += 1;
        self.kept.push(Kept { contact, branch, seed, used: self.uses, is_guess });
    }

    /// The states of a branch of a contact are of another one.
    pub(super) fn rename(&mut self, contact: u16, branch: u32, to: u32) {
        let is_of = |kept: &&mut Kept| kept.contact == contact && kept.branch == branch;
        self.kept.iter_mut().filter(is_of).for_each(|kept| kept.branch = to);
    }

    /// Gives room back.
    pub(super) fn give_back(&mut self, seed: Seed) {
        self.free.push(seed);
    }

    /// The states become guesses of a body with other materials, forces or fixed nodes, relative to its rest.
    pub(super) fn become_those_of(&mut self, old: &Body, new: &Body) {
        for Kept { seed, is_guess, .. } in &mut self.kept {
            *is_guess = true;
            let rest = new.rest_state.iter().zip(&old.rest_state);
            for (value, (new, old)) in seed.state.iter_mut().zip(rest) {
                *value += new - old;
            }
            let fixed = new.fixed.as_flattened();
            for (at, _) in fixed.iter().enumerate().filter(|(_, fixed)| **fixed) {
                seed.state[at] = new.rest_state[at];
                seed.sensitivity.iter_mut().for_each(|column| column[at] = 0.0);
            }
        }
    }

    /// Displacement of nodes from the rest of the first model, in the state nearest to the hand of the branch that
    /// each contact is on, blended over the contacts of the touch, m. That of the body at rest without a touch, and
    /// for contacts without a kept state.
    pub(super) fn displacements_into(
        &self,
        hand: &Hand,
        (body, first_rest): (&Body, &[f64]),
        branch_of: impl Fn(u16) -> u32,
        nodes: &[u32],
        out: &mut [[f32; 3]],
    ) {
        for (&node, out) in nodes.iter().zip(out.iter_mut()) {
            let at = |axis: usize| 3 * node as usize + axis;
            *out = std::array::from_fn(|axis| (body.rest_state[at(axis)] - first_rest[at(axis)]) as f32);
        }
        let Some(touch) = &hand.touch else { return };
        for &(contact, weight) in touch.contacts.iter().filter(|(_, weight)| *weight > 0.0) {
            let nearest = self.nearest(contact, branch_of(contact), touch.control_m);
            let Some(seed) = nearest else { continue };
            let d: [f64; 3] = std::array::from_fn(|axis| touch.control_m[axis] - seed.jet.control_m[axis]);
            for (&node, out) in nodes.iter().zip(out.iter_mut()) {
                for (axis, value) in out.iter_mut().enumerate() {
                    let at = 3 * node as usize + axis;
                    let slope: f64 = (0..3).map(|k| d[k] * seed.sensitivity[k][at]).sum();
                    *value += (weight * (seed.state[at] - body.rest_state[at] + slope)) as f32;
                }
            }
        }
    }
}

fn second_of(seed: &Seed) -> Option<[f64; 3]> {
    seed.coupling.map(|coupling| coupling.second_m)
}
