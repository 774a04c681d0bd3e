//! Which position to solve next.
//!
//! In this order: the first jet of every contact that is touched, the landing of a fold that the hand has passed, the
//! position of the hand, a fold that it passes soon, the position where it will be when the solve is done, a new factor
//! if it is made beside the steps and the one at hand has become old, the folds on the way, and the first jets of the
//! contacts beside. If all are known and the steps make the factors, an old one is renewed if the hand leaves time for
//! it; then folds are looked for ahead, leaning presses are prepared where a factor takes long, the position after the solve is
//! solved to a finer limit, and last the state near the hand if none is kept there: the picture shows it, and the next
//! positions are continued from it. Prediction farther ahead does not pay without folds: a jet that is trusted for 10
//! to 24 mm covers the path of many solves, and what is known already is worth more.
//!
//! Where a factor takes long, a touch may be over before all is known. Then the contacts with most of the weight come first, and
//! straight presses follow the position after the solve.

use super::beyond::parted_m;
use super::branches::Branches;
use super::hand::{Hand, Touch};
use super::memory::{Growth, Known, Limit};
use super::renewals::Renewals;
use super::skin::Skin;
use super::states::States;
use super::task::{Aim, Task};
use super::times::SolveTimes;
use super::workers::Workers;
use crate::fem::{Body, CoatedSphere};
use crate::num::vector::{cross, distance, norm, unit};

/// The prediction looks ahead by this multiple of the time of a solve,
const AHEAD: f64 = 1.5;
/// but by at most this time, s, because nobody knows a hand longer,
const MAX_AHEAD_S: f64 = 0.3;
/// and by at most this distance, m.
const MAX_AHEAD_M: f64 = 0.02;
/// or this one where a solve takes long: it fails from farther away, and that takes longer.
const LONG_AHEAD_M: f64 = 0.01;
/// The first jets of contacts within this distance of a free tool are solved, m,
pub(super) const HEADING_M: f64 = 0.03;
/// round the place where it will be after this time, s.
const HEADING_S: f64 = 0.1;
/// A contact with a smaller weight is solved as if it had this weight, because weights change while the tool slips.
const MIN_WEIGHT: f64 = 0.2;
/// Where a solve takes long, contacts that together have a smaller weight wait until the others are known: until then the loop
/// takes the force of the others for theirs.
const LIGHT_WEIGHT: f64 = 0.1;
/// A factor is renewed if the tool is farther than this from where it was made, m.
const FACTOR_REACH_M: f64 = 0.012;
/// A state serves the picture up to this distance, m: that of a position that is known by it.
const STATE_REACH_M: f64 = 0.0125;
/// Positions nearer than this to one where nothing was found are not tried again, m.
const LOST_REACH_M: f64 = 1e-3;
/// Folds are looked for where the hand will be after this time, s,
const SEARCH_S: f64 = 0.03;
/// and the time of so many new factors: a fold is then enclosed, and the body has landed, before the hand is there.
const SEARCH_FACTORS: f64 = 25.0;
/// A body is searched if a new factor takes less than this, s, or if it has folded before: without a fold the search
/// is work for nothing.
const CHEAP_S: f64 = 0.01;
/// The branch is followed there unless it has a jet within this distance, m,
const SEARCH_M: f64 = 3e-3;
/// or within the way of the hand in this multiple of the time of a new factor.
const SEARCH_SOLVES: f64 = 4.0;
/// The end of a branch is checked where the hand will be after this time, s.
pub(super) const CHECK_S: f64 = 0.02;
/// Where nobody waits for a factor, a touch is prepared by these presses: depth, and two components aside, m. Straight ones come
/// first, because the leaning ones start from them,
const PRESSES_M: [[f64; 3]; 7] = [
    [0.012, 0.0, 0.0],
    [0.018, 0.0, 0.0],
    [0.024, 0.0, 0.0],
    [0.024, 0.007, 0.0],
    [0.024, -0.007, 0.0],
    [0.024, 0.0, 0.007],
    [0.024, 0.0, -0.007],
];
/// so many of them,
const STRAIGHT: usize = 3;
/// at so many contacts: the corners of a triangle.
const PRESSED: usize = 3;
/// Jets of a sphere are trusted over millimetres only: they are solved where the hand will be after this time, s.
const SPHERE_AHEAD_S: f64 = 0.03;
/// The first touch of a sphere is solved at this depth, m.
const FIRST_DEPTH_M: f64 = 1.5e-3;
/// Number of such positions: above that of all presses, because one that is forgotten is tried again.
const LOST: usize = 64;
const _: () = assert!(LOST > 2 * PRESSED * PRESSES_M.len());

/// Positions where no equilibrium was found, newest last.
#[derive(Debug, Default)]
pub(super) struct LostPositions {
    all: Vec<Lost>,
    /// The second control now.
    second_m: Option<[f64; 3]>,
}

/// A position where no equilibrium was found.
#[derive(Debug)]
struct Lost {
    task: Task,
    second_m: Option<[f64; 3]>,
}

impl LostPositions {
    pub(super) fn add(&mut self, task: &Task) {
        if self.all.len() == LOST {
            self.all.remove(0);
        }
        self.all.push(Lost { task: *task, second_m: self.second_m });
    }

    /// From another branch they may be found.
    pub(super) fn forget(&mut self, contact: u16) {
        self.all.retain(|lost| lost.task.contact != contact);
    }

    /// The second control is this one now: with another one they may be found.
    pub(super) fn face(&mut self, second_m: Option<[f64; 3]>) {
        self.second_m = second_m;
    }

    /// Whether a position was tried in vain. Where the hand is, more is tried than ahead of it.
    pub(super) fn contains(&self, task: &Task) -> bool {
        self.all.iter().any(|Lost { task: lost, second_m }| {
            let away_m = distance(lost.control_m, task.control_m);
            lost.contact == task.contact
                && libm::hypot(away_m, parted_m(*second_m, self.second_m)) < LOST_REACH_M
                && (lost.aim.is_at_hand() || !task.aim.is_at_hand())
        })
    }
}

/// What the choice depends on.
#[derive(Debug)]
pub(super) struct Choice<'s> {
    pub(super) skin: &'s Skin,
    pub(super) body: &'s Body,
    pub(super) known: &'s [Known],
    pub(super) growth: &'s Growth,
    pub(super) lost: &'s LostPositions,
    pub(super) branches: &'s Branches,
    pub(super) workers: &'s Workers,
    /// `None` if the steps make their factors; else nobody waits for one.
    pub(super) renewals: Option<&'s Renewals>,
    /// Whether presses are solved before the hand is there, and no step renews a factor, because that takes long.
    pub(super) prepares: bool,
    /// A contact whose kept state has turned out to be unstable.
    pub(super) doubted: Option<u16>,
    pub(super) states: &'s States,
    pub(super) times: &'s SolveTimes,
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
        let of_any = |find: &dyn Fn(u16) -> Option<Task>| touched().find_map(|(contact, _)| find(contact));
        let most = 1.0 - LIGHT_WEIGHT;
        let needed = match contacts.map(|(_, weight)| weight) {
            [one, ..] if self.prepares && one >= most => 1,
            [one, two, _] if self.prepares && one + two >= most => 2,
            _ => 3,
        };
        let heavy = || touched().take(needed);
        let here_m = touch.control_m;
        let (frozen_s, renewed_s) = (self.times.frozen_s(), self.times.renewed_s());
        let most_m = if self.prepares { LONG_AHEAD_M } else { MAX_AHEAD_M };
        let after = |seconds: f64| {
            let ahead = hand.velocity_m_s.map(|v| v * seconds);
            let reduced = (most_m / norm(ahead)).min(1.0);
            std::array::from_fn(|axis| here_m[axis] + reduced * ahead[axis])
        };
        let position = |(contact, weight), control_m, limit| {
            let aim = if control_m == here_m { Aim::Hand } else { Aim::Ahead };
            self.position(Task { contact, control_m, aim }, weight, limit)
        };
        let unknown = |control_m, limit| touched().find_map(|at| position(at, control_m, limit));
        let unknown_of_heavy = |control_m| heavy().find_map(|at| position(at, control_m, Limit::Unknown));
        let next_m = after((AHEAD * frozen_s).min(MAX_AHEAD_S));
        let there_m = after(SEARCH_S + SEARCH_FACTORS * renewed_s);
        let soon_m = after(CHECK_S);
        let (straight_m, _) = PRESSES_M.split_at(STRAIGHT);
        heavy()
            .find_map(|(contact, _)| self.first(contact))
            .or_else(|| of_any(&|contact| self.doubt(contact, here_m)))
            .or_else(|| of_any(&|contact| self.branches.overdue(contact, here_m)))
            .or_else(|| unknown_of_heavy(here_m))
            .or_else(|| of_any(&|contact| self.branches.check(contact, soon_m)))
            .or_else(|| unknown_of_heavy(next_m))
            .or_else(|| self.presses(contacts[0].0, straight_m))
            .or_else(|| of_any(&|contact| self.first(contact)))
            .or_else(|| unknown(here_m, Limit::Unknown))
            .or_else(|| unknown(next_m, Limit::Unknown))
            .or_else(|| self.skin.sphere().and_then(|_| unknown(after(SPHERE_AHEAD_S), Limit::Unknown)))
            .or_else(|| of_any(&|contact| self.renewal_beside(contact, here_m)))
            .or_else(|| of_any(&|contact| self.branches.work(contact, there_m)))
            .or_else(|| touched().find_map(|(contact, _)| self.beside(contact, found)))
            .or_else(|| {
                let has_time = || unknown(after(AHEAD * renewed_s), Limit::Unknown).is_none();
                (!self.prepares && has_time()).then(|| self.renewal(contacts[0].0, here_m))?
            })
            .or_else(|| {
                let within_m = SEARCH_M.max(SEARCH_SOLVES * renewed_s * norm(hand.velocity_m_s));
                of_any(&|contact| self.search(contact, there_m, within_m))
            })
            .or_else(|| PRESSES_M.iter().find_map(|&press_m| of_any(&|contact| self.press(contact, press_m))))
            .or_else(|| unknown(next_m, Limit::Rough))
            .or_else(|| self.state(contacts[0].0, here_m))
    }

    /// The branch of a contact is followed ahead of the hand to find its end, unless it is known near there.
    fn search(&self, contact: u16, control_m: [f64; 3], within_m: f64) -> Option<Task> {
        if self.skin.sphere().is_some() {
            return None;
        }
        let known = self.known.get(usize::from(contact))?;
        let may_fold = self.times.renewed_s() < CHEAP_S || self.branches.have_folded();
        let needs = may_fold
            && !known.is_empty()
            && self.skin.is_free(contact)
            && !known.has_near(control_m, self.branches.of(contact), within_m)
            && !self.branches.hides(contact, control_m);
        self.unless_lost(needs, Task { contact, control_m, aim: Aim::Ahead })
    }

    /// A task that is needed, unless it was tried in vain.
    fn unless_lost(&self, is_needed: bool, task: Task) -> Option<Task> {
        (is_needed && !self.lost.contains(&task)).then_some(task)
    }

    /// The first jet of a contact is that at rest.
    fn first(&self, contact: u16) -> Option<Task> {
        let is_new = self.known.get(usize::from(contact))?.is_empty() && self.skin.is_free(contact);
        self.unless_lost(is_new, Task { contact, control_m: [0.0; 3], aim: Aim::Hand })
    }

    fn position(&self, task: Task, weight: f64, limit: Limit) -> Option<Task> {
        let Task { contact, control_m, aim } = task;
        let known = self.known.get(usize::from(contact))?;
        let at = (control_m, self.branches.of(contact));
        let is_hidden = aim == Aim::Ahead && self.branches.hides(contact, control_m);
        let needs =
            !known.is_empty() && !is_hidden && !self.growth.knows(known, at, weight.max(MIN_WEIGHT), limit);
        self.unless_lost(needs, task)
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
        if let Some(sphere) = self.skin.sphere() {
            return self.first(0).or_else(|| self.approach(sphere, hand, there_m));
        }
        self.skin.near(there_m, HEADING_M, found);
        let of_any = |most: usize, find: &dyn Fn(u16) -> Option<Task>| {
            found.iter().take(most).find_map(|&(_, contact)| find(contact))
        };
        let (straight_m, leaning_m) = PRESSES_M.split_at(STRAIGHT);
        of_any(PRESSED, &|contact| self.first(contact).or_else(|| self.presses(contact, straight_m)))
            .or_else(|| of_any(usize::MAX, &|contact| self.first(contact)))
            .or_else(|| of_any(PRESSED, &|contact| self.presses(contact, leaning_m)))
    }

    /// The first touches of a sphere that comes near the skin: where its way leads, and on the shortest way.
    fn approach(&self, sphere: &CoatedSphere, hand: &Hand, there_m: [f64; 3]) -> Option<Task> {
        let on_way =
            || sphere.touched_on_way_m(self.body, hand.hip_m, hand.velocity_m_s, HEADING_M, FIRST_DEPTH_M);
        let nearest = || sphere.first_touch_m(self.body, there_m, HEADING_M, FIRST_DEPTH_M);
        let solved =
            |control_m| self.position(Task { contact: 0, control_m, aim: Aim::Ahead }, 1.0, Limit::Unknown);
        on_way().and_then(solved).or_else(|| nearest().and_then(solved))
    }

    /// The first of these presses that is not known.
    fn presses(&self, contact: u16, all_m: &[[f64; 3]]) -> Option<Task> {
        all_m.iter().find_map(|&press_m| self.press(contact, press_m))
    }

    /// A press into the body, where a solve takes longer than a hand needs for it.
    fn press(&self, contact: u16, [depth_m, one_m, other_m]: [f64; 3]) -> Option<Task> {
        if !self.prepares || self.skin.sphere().is_some() {
            return None;
        }
        let normal = self.skin.contacts.get(usize::from(contact))?.normal;
        let not_along = if normal[0].abs() < 0.7 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
        let one = unit(cross(normal, not_along));
        let other = cross(normal, one);
        let control_m =
            std::array::from_fn(|axis| one_m * one[axis] + other_m * other[axis] - depth_m * normal[axis]);
        self.position(Task { contact, control_m, aim: Aim::Ahead }, 1.0, Limit::Unknown)
    }

    /// The state at the hand, if none is kept near it. Its jet is known, so no branch ends with it.
    fn state(&self, contact: u16, control_m: [f64; 3]) -> Option<Task> {
        let nearest = self.states.nearest(contact, self.branches.of(contact), control_m);
        let is_near = nearest.is_some_and(|seed| distance(seed.jet.control_m, control_m) <= STATE_REACH_M);
        let needs = !is_near && self.skin.is_free(contact);
        self.unless_lost(needs, Task { contact, control_m, aim: Aim::Ahead })
    }

    /// A new factor at the hand if the state near it is unstable: the body lands elsewhere.
    fn doubt(&self, contact: u16, control_m: [f64; 3]) -> Option<Task> {
        let is_tried = self.doubted == Some(contact) && self.skin.is_free(contact);
        is_tried.then_some(Task { contact, control_m, aim: Aim::Renewal })
    }

    /// A new factor of the state nearest to the hand, if that of the contact is farther away.
    fn renewal_beside(&self, contact: u16, control_m: [f64; 3]) -> Option<Task> {
        if self.renewals?.is_busy() {
            return None;
        }
        let seed = self.states.nearest(contact, self.branches.of(contact), control_m)?;
        let from_m = seed.jet.control_m;
        let gains = match self.workers.factor_of(contact) {
            None => true,
            Some(at_m) => {
                distance(at_m, control_m) > FACTOR_REACH_M
                    && distance(from_m, control_m) < 0.5 * distance(at_m, control_m)
            }
        };
        gains.then_some(Task { contact, control_m: from_m, aim: Aim::Renewal })
    }

    /// A new factor at the hand, if the last one is far. The solve also gives a jet.
    fn renewal(&self, contact: u16, control_m: [f64; 3]) -> Option<Task> {
        let is_near = |at_m: [f64; 3]| distance(at_m, control_m) <= FACTOR_REACH_M;
        let renews = !self.workers.factor_of(contact).is_some_and(is_near) && self.skin.is_free(contact);
        self.unless_lost(renews, Task { contact, control_m, aim: Aim::Renewal })
    }
}
