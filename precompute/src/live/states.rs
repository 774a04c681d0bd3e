//! The solved states that are kept as starts of the next continuations.

use super::memory::Trust;
use crate::fem::{Body, Seed};
use crate::num::vector::distance;

/// Number of kept states. Each has four state vectors: 0.3 MB at 10,000 equations.
const KEPT: usize = 32;

/// A state of one contact.
#[derive(Debug)]
struct Kept {
    contact: u16,
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
}

impl States {
    /// Room for states like this one.
    pub(super) fn like(seed: &Seed) -> Self {
        Self { kept: Vec::with_capacity(KEPT), free: vec![seed.clone(); KEPT + 1], uses: 0 }
    }

    /// Takes out the state of a contact that is nearest to a control, if there is one.
    pub(super) fn take_nearest(&mut self, contact: u16, control_m: [f64; 3]) -> Option<Start> {
        let away = |kept: &Kept| distance(kept.seed.jet.control_m, control_m);
        let of_contact = self.kept.iter().enumerate().filter(|(_, kept)| kept.contact == contact);
        let (nearest, _) = of_contact.min_by(|(_, a), (_, b)| away(a).total_cmp(&away(b)))?;
        let Kept { seed, is_guess, .. } = self.kept.swap_remove(nearest);
        Some(Start { seed, is_guess })
    }

    /// The state of a contact that is nearest to a control.
    pub(super) fn nearest(&self, contact: u16, control_m: [f64; 3]) -> Option<&Seed> {
        let away = |seed: &&Seed| distance(seed.jet.control_m, control_m);
        self.of(contact).min_by(|a, b| away(a).total_cmp(&away(b)))
    }

    /// All states of a contact.
    fn of(&self, contact: u16) -> impl Iterator<Item = &Seed> {
        self.kept.iter().filter(move |kept| kept.contact == contact).map(|kept| &kept.seed)
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
        self.kept.swap_remove(least.expect("every state is either free or kept")).seed
    }

    /// Keeps a state.
    pub(super) fn keep(&mut self, contact: u16, Start { seed, is_guess }: Start) {
        self.uses += 1;
        self.kept.push(Kept { contact, seed, used: self.uses, is_guess });
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

    /// Removes the states that lie on another branch than a jet of their contact.
    pub(super) fn flush(&mut self, contact: u16, trust: &Trust, rest_n_m: f64) {
        let free = &mut self.free;
        let differs = |kept: &mut Kept| {
            kept.contact == contact && (kept.is_guess || !trust.agrees(&Trust::of(kept.seed.jet, rest_n_m)))
        };
        free.extend(self.kept.extract_if(.., differs).map(|kept| kept.seed));
    }
}
