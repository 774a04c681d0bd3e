//! Starts with a sphere beside the skin: of the body at rest, or as the partner presses it.
//!
//! Between two places of the skin lies the body, and no continuation leads through it. Beside the skin a sphere touches
//! nothing, so the state is that of the body without it. While a partner presses, that is the body under the partner alone:
//! an ordinary state of one sphere at the place of the partner. It is continued where the partner moves and the hand is free, so
//! the first touch beside a partner starts at once. A hand that touches has kept states, and no time for it.

use super::super::published::Step;
use super::super::states::Start;
use super::super::task::{Aim, Task};
use super::super::workers::Made;
use super::LiveSolver;
use super::solving::HALVINGS;
use crate::fem::{Followed, Second, Seed};
use crate::num::vector::distance;

/// A sphere starts beside the skin if that is nearer by this factor than the nearest state.
const NEARER: f64 = 0.5;
/// The number of the solver of the body under the partner alone, which is no contact.
const ALONE: u16 = u16::MAX;
/// The state under the partner serves a touch while the partner is within this distance, m. Then it is followed.
const SERVES_M: f64 = 2e-3;

/// The body under the partner alone.
#[derive(Debug, Default)]
pub(super) struct Alone {
    /// Its state, with the partner as the tool.
    seed: Option<Seed>,
    /// Where it was not found.
    lost_m: Option<[f64; 3]>,
}

impl LiveSolver {
    /// The state with the sphere beside the skin, if that is much nearer to a task than any kept state.
    pub(super) fn untouched(&mut self, task: &Task) -> Option<Start> {
        let nearest = self.states.nearest(task.contact, self.branches.of(task.contact), task.control_m);
        let within_m =
            nearest.map_or(f64::INFINITY, |seed| NEARER * self.states.away_m(seed, task.control_m));
        let Some(partner_m) = self.partner_m() else {
            let seed = self.beside_rest(task.control_m, within_m)?;
            return Some(Start { seed, is_guess: false });
        };
        let alone = self.alone.seed.take()?;
        let gap_m = distance(alone.jet.control_m, partner_m);
        let left_m = (within_m * within_m - gap_m * gap_m).max(0.0).sqrt();
        let seed = if gap_m < SERVES_M { self.beside_rest(task.control_m, left_m) } else { None };
        let start = seed.map(|mut seed| {
            seed.state.copy_from_slice(&alone.state);
            Start { seed, is_guess: gap_m > 0.0 }
        });
        self.alone.seed = Some(alone);
        start
    }

    /// The body at rest with the sphere on the shortest way out of it, if that is nearer to a control than `within_m`.
    fn beside_rest(&mut self, control_m: [f64; 3], within_m: f64) -> Option<Seed> {
        let sphere = self.skin.sphere()?;
        if -sphere.clearance_m(&self.body, control_m) >= within_m {
            return None;
        }
        let beside_m = sphere.beside_m(&self.body, control_m);
        if distance(beside_m, control_m) >= within_m {
            return None;
        }
        let mut seed = self.states.room();
        seed.become_rest(&self.body, beside_m);
        Some(seed)
    }

    fn partner_m(&self) -> Option<[f64; 3]> {
        self.second_m.filter(|_| self.skin.second() == Second::Partner)
    }

    /// Solves the body under the partner alone, or as near to it as the continuation leads. `None` if it is known, or not
    /// found.
    pub(super) fn follow_partner(&mut self) -> Option<Step> {
        let partner_m = self.partner_m()?;
        let is_near = |at_m: [f64; 3]| distance(at_m, partner_m) < SERVES_M;
        let known = self.alone.seed.as_ref().map(|seed| seed.jet.control_m);
        if self.known[0].is_empty() || known.is_some_and(is_near) || self.alone.lost_m.is_some_and(is_near) {
            return None;
        }
        let away_m = known.map_or(f64::INFINITY, |at_m| NEARER * distance(at_m, partner_m));
        let seed = match self.beside_rest(partner_m, away_m) {
            Some(seed) => seed,
            None => self.alone.seed.take()?,
        };
        let from = Start { seed, is_guess: false };
        let mut to = self.states.room();
        let is_found = self.continue_alone(&from, partner_m, &mut to).is_some();
        let (kept, spare) = if is_found { (to, from.seed) } else { (from.seed, to) };
        self.states.give_back(spare);
        if let Some(old) = self.alone.seed.replace(kept) {
            self.states.give_back(old);
        }
        self.alone.lost_m = (!is_found).then_some(partner_m);
        self.times.begin(None);
        Some(Step::Followed)
    }

    /// Continues the body under the partner alone towards a place of it.
    fn continue_alone(&mut self, from: &Start, partner_m: [f64; 3], to: &mut Seed) -> Option<Followed> {
        let problem = self.problem(0);
        self.workers.go_to(ALONE, problem);
        let needs = self.workers.present().factor == Made::Unknown && !self.borrows_factor(ALONE);
        self.workers.present().solver.set_partner(None);
        let start_m = from.seed.jet.control_m;
        let task = Task { contact: ALONE, control_m: partner_m, aim: Aim::Ahead };
        (0..=HALVINGS).find_map(|halvings| {
            let share = 0.5f64.powi(halvings as i32);
            let at_m = std::array::from_fn(|k| start_m[k] + share * (partner_m[k] - start_m[k]));
            self.continued(from, &task, at_m, needs || halvings > 0, to)
        })
    }

    /// Forgets the partner, whose body has changed.
    pub(super) fn forget_partner(&mut self) {
        if let Some(seed) = self.alone.seed.take() {
            self.states.give_back(seed);
        }
        self.alone.lost_m = None;
    }
}
