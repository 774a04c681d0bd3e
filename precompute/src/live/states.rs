//! The solved states that are kept as starts of the next continuations.

use crate::fem::{Body, Seed};
use crate::num::vector::distance;

/// Number of kept states. Each has four state vectors: 0.3 MB at 10,000 equations.
const KEPT: usize = 32;

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
}

impl States {
    /// Room for states like this one.
    pub(super) fn like(seed: &Seed) -> Self {
        Self { kept: Vec::with_capacity(KEPT), free: vec![seed.clone(); KEPT + 1], uses: 0 }
    }

    /// Takes out the state of a branch of a contact that is nearest to a control, if there is one.
    pub(super) fn take_nearest(&mut self, contact: u16, branch: u32, control_m: [f64; 3]) -> Option<Start> {
        let away = |kept: &Kept| distance(kept.seed.jet.control_m, control_m);
        let is_of = |kept: &Kept| kept.contact == contact && kept.branch == branch;
        let of_branch = self.kept.iter().enumerate().filter(|(_, kept)| is_of(kept));
        let (nearest, _) = of_branch.min_by(|(_, a), (_, b)| away(a).total_cmp(&away(b)))?;
        let Kept { seed, is_guess, .. } = self.kept.swap_remove(nearest);
        Some(Start { seed, is_guess })
    }

    /// The state of a branch of a contact that is nearest to a control.
    pub(super) fn nearest(&self, contact: u16, branch: u32, control_m: [f64; 3]) -> Option<&Seed> {
        let away = |(_, seed): &(u32, &Seed)| distance(seed.jet.control_m, control_m);
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
        self.kept.swap_remove(least.expect("every state is either free or kept")).seed
    }

    /// Keeps a state of a branch.
    pub(super) fn keep(&mut self, contact: u16, branch: u32, Start { seed, is_guess }: Start) {
        self.uses += 1;
        self.kept.push(Kept { contact, branch, seed, used: self.uses, is_guess });
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
}
