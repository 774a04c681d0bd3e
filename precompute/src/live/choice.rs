//! Which position to solve next.
//!
//! In this order: the first jet of every contact that is touched, the position of the hand, the position where it
//! will be when the solve is done, and the first jets of the contacts it heads for. If all are known, the factor is
//! renewed once it has become old and the hand leaves time for it; then the second position is solved to a finer
//! limit. Prediction farther ahead does not pay: a jet that is trusted for 10 to 24 mm covers the path of many
//! solves, and what is known already is worth more.

use super::hand::{Hand, Touch};
use super::memory::{Growth, Known, Limit};
use super::skin::Skin;
use super::workers::Workers;
use crate::num::vector::{distance, norm};

/// The prediction looks ahead by this multiple of the time of a solve,
const AHEAD: f64 = 1.5;
/// but by at most this distance, m.
const MAX_AHEAD_M: f64 = 0.02;
/// The first jets of contacts within this distance of a free tool are solved, m,
const HEADING_M: f64 = 0.03;
/// round the place where it will be after this time, s.
const HEADING_S: f64 = 0.1;
/// A contact with a smaller weight is solved as if it had this weight, because weights change while the tool slips.
const MIN_WEIGHT: f64 = 0.2;
/// A factor is renewed if the tool is farther than this from where it was made, m.
const FACTOR_REACH_M: f64 = 0.012;
/// Positions nearer than this to one where nothing was found are not tried again, m.
const LOST_REACH_M: f64 = 1e-3;
/// Steps after which one is tried again: about a second of idling.
const FORGOTTEN: u32 = 3_000;
/// Number of such positions.
const LOST: usize = 16;

/// What to solve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Task {
    pub(super) contact: u16,
    pub(super) control_m: [f64; 3],
    /// Whether a new factor is the reason.
    pub(super) renews: bool,
    /// Whether the hand is not there yet. A fold that lies ahead must not end the branch that the hand is on.
    pub(super) is_ahead: bool,
}

/// Positions where no equilibrium was found, newest last, and whether the hand was not there yet.
#[derive(Debug, Default)]
pub(super) struct LostPositions(Vec<Lost>);

#[derive(Debug)]
struct Lost {
    contact: u16,
    control_m: [f64; 3],
    was_ahead: bool,
    /// Steps since then.
    age: u32,
}

impl LostPositions {
    pub(super) fn add(&mut self, task: &Task) {
        if self.0.len() == LOST {
            self.0.remove(0);
        }
        let &Task { contact, control_m, is_ahead: was_ahead, .. } = task;
        self.0.push(Lost { contact, control_m, was_ahead, age: 0 });
    }

    /// One more step was made: what was tried long ago may be tried again, from other states.
    pub(super) fn grow_old(&mut self) {
        self.0.iter_mut().for_each(|lost| lost.age += 1);
        self.0.retain(|lost| lost.age < FORGOTTEN);
    }

    /// Whether a position was tried in vain; where the hand is, only tries for the hand count.
    pub(super) fn contains(&self, contact: u16, control_m: [f64; 3], is_ahead: bool) -> bool {
        self.0.iter().any(|lost| {
            lost.contact == contact
                && (is_ahead || !lost.was_ahead)
                && distance(lost.control_m, control_m) < LOST_REACH_M
        })
    }
}

/// What the choice depends on.
#[derive(Debug)]
pub(super) struct Choice<'s> {
    pub(super) skin: &'s Skin,
    pub(super) known: &'s [Known],
    pub(super) growth: &'s Growth,
    pub(super) lost: &'s LostPositions,
    pub(super) workers: &'s Workers,
    /// Mean time of a solve with the factor at hand, and with a new one, s.
    pub(super) solve_s: [f64; 2],
}

impl Choice<'_> {
    /// The next task, or `None` if everything near is known. `found` is scratch memory.
    pub(super) fn next(&self, hand: &Hand, found: &mut Vec<(f64, u16)>) -> Option<Task> {
        match &hand.touch {
            Some(touch) => self.touching(hand, touch, found),
            None => self.heading(hand, found),
        }
    }

    fn touching(&self, hand: &Hand, touch: &Touch, found: &mut Vec<(f64, u16)>) -> Option<Task> {
        let mut contacts = touch.contacts;
        contacts.sort_by(|(_, a), (_, b)| b.total_cmp(a));
        let touched = || contacts.into_iter().filter(|(_, weight)| *weight > 0.0);
        let first = touched().find_map(|(contact, _)| self.first(contact));
        let [frozen_s, renewed_s] = self.solve_s;
        let after = |seconds: f64| {
            let ahead = hand.velocity_m_s.map(|v| v * AHEAD * seconds);
            let reduced = (MAX_AHEAD_M / norm(ahead)).min(1.0);
            std::array::from_fn(|axis| touch.control_m[axis] + reduced * ahead[axis])
        };
        let unknown = |control_m, limit| {
            let is_ahead = control_m != touch.control_m;
            touched().find_map(|(contact, weight)| {
                let task = Task { contact, control_m, renews: false, is_ahead };
                self.position(task, weight, limit)
            })
        };
        first
            .or_else(|| unknown(touch.control_m, Limit::Unknown))
            .or_else(|| unknown(after(frozen_s), Limit::Unknown))
            .or_else(|| touched().find_map(|(contact, _)| self.beside(contact, found)))
            .or_else(|| {
                let has_time = unknown(after(renewed_s), Limit::Unknown).is_none();
                has_time.then(|| self.renewal(contacts[0].0, touch.control_m))?
            })
            .or_else(|| unknown(after(frozen_s), Limit::Rough))
    }

    /// The first jet of a contact is that at rest.
    fn first(&self, contact: u16) -> Option<Task> {
        let rest = [0.0; 3];
        let is_new = self.known.get(usize::from(contact))?.is_empty()
            && self.skin.is_free(contact)
            && !self.lost.contains(contact, rest, false);
        is_new.then_some(Task { contact, control_m: rest, renews: false, is_ahead: false })
    }

    fn position(&self, task: Task, weight: f64, limit: Limit) -> Option<Task> {
        let Task { contact, control_m, is_ahead, .. } = task;
        let known = self.known.get(usize::from(contact))?;
        let needs = !known.is_empty()
            && !self.growth.knows(known, control_m, weight.max(MIN_WEIGHT), limit)
            && !self.lost.contains(contact, control_m, is_ahead);
        needs.then_some(task)
    }

    /// The nearest contact without a jet that shares a triangle with this one.
    fn beside(&self, contact: u16, found: &mut Vec<(f64, u16)>) -> Option<Task> {
        found.clear();
        found.extend(self.skin.around(contact).iter().map(|&by| (self.skin.distance_m(contact, by), by)));
        found.sort_unstable_by(|(a, _), (b, _)| a.total_cmp(b));
        found.iter().find_map(|&(_, by)| self.first(by))
    }

    /// Of the contacts near the place where a free tool will be, the nearest one without a jet.
    fn heading(&self, hand: &Hand, found: &mut Vec<(f64, u16)>) -> Option<Task> {
        let travel = hand.velocity_m_s.map(|v| v * HEADING_S);
        let reduced = (HEADING_M / norm(travel)).min(1.0);
        let there_m = std::array::from_fn(|axis| hand.hip_m[axis] + reduced * travel[axis]);
        self.skin.near(there_m, HEADING_M, found);
        found.iter().find_map(|&(_, contact)| self.first(contact))
    }

    /// A new factor at the hand, if the last one is far. The solve also gives a jet.
    fn renewal(&self, contact: u16, control_m: [f64; 3]) -> Option<Task> {
        let is_near = |at_m: [f64; 3]| distance(at_m, control_m) <= FACTOR_REACH_M;
        let renews = !self.workers.factor_of(contact).is_some_and(is_near)
            && self.skin.is_free(contact)
            && !self.lost.contains(contact, control_m, false);
        renews.then_some(Task { contact, control_m, renews, is_ahead: false })
    }
}
