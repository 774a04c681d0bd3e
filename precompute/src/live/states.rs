//! The solved states that are kept as starts of the next continuations.

use super::memory::Trust;
use crate::fem::Seed;
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
    pub(super) fn take_nearest(&mut self, contact: u16, control_m: [f64; 3]) -> Option<Seed> {
        let away = |kept: &Kept| distance(kept.seed.jet.control_m, control_m);
        let of_contact = self.kept.iter().enumerate().filter(|(_, kept)| kept.contact == contact);
        let (nearest, _) = of_contact.min_by(|(_, a), (_, b)| away(a).total_cmp(&away(b)))?;
        Some(self.kept.swap_remove(nearest).seed)
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
        let oldest = (0..self.kept.len()).min_by_key(|&at| self.kept[at].used);
        self.kept.swap_remove(oldest.expect("every state is either free or kept")).seed
    }

    /// Keeps a state.
    pub(super) fn keep(&mut self, contact: u16, seed: Seed) {
        self.uses += 1;
        self.kept.push(Kept { contact, seed, used: self.uses });
    }

    /// Gives room back.
    pub(super) fn give_back(&mut self, seed: Seed) {
        self.free.push(seed);
    }

    /// Removes the states that lie on another branch than a jet of their contact.
    pub(super) fn flush(&mut self, contact: u16, trust: &Trust) {
        let free = &mut self.free;
        let differs = |kept: &mut Kept| kept.contact == contact && !trust.agrees(&kept.seed.jet);
        free.extend(self.kept.extract_if(.., differs).map(|kept| kept.seed));
    }
}
