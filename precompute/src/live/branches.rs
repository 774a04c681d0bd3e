//! The branches of equilibria of each contact: which one the touch is on, where it ends, and where the body lands.
//!
//! A branch ends at a fold. A fold that lies ahead of the hand is enclosed between the last control at which the
//! branch was found and the first one at which it was not, and the body is let land there. What it lands on is a
//! branch of its own, which is kept back until the hand passes the fold: a hand that turns back stays on its own.

use super::hand::Touch;
use super::task::{Aim, Task};
use crate::num::branch::Excess;
use crate::num::jet::{EnergyJet, THIRD_INDICES};
use crate::num::vector::{difference, distance, dot, norm, unit};
use crate::spec::Tolerance;

/// Smallest cosine between the direction across a fold and the one in which it was found.
const MIN_COSINE: f64 = 0.3;
/// The branch of the body at rest.
pub(super) const REST: u32 = 0;
/// A fold is enclosed to this width, m;
const WIDTH_M: f64 = 2.5e-4;
/// the body is let land as soon as it is enclosed to this one, m.
const LANDING_WIDTH_M: f64 = 3e-3;
/// A fold ends the branch within this distance from the line across it, m, which grows by the way behind it,
const LATERAL_M: f64 = 8e-3;
/// and as far behind it, m.
const BEHIND_M: f64 = 0.02;
/// A fold that is found nearer than this to another one of the branch is the same one, m.
const SAME_M: f64 = 5e-3;
/// Where the branch was not found need not be tried again within this distance, m.
const CHECKED_M: f64 = 1e-3;
/// A sphere leaves a branch by a jump above both.
const SPHERE_JUMP_N: f64 = 0.3;
const SPHERE_JUMP_SHARE: f64 = 0.5;
/// Number of folds.
const FOLDS: usize = 32;

/// Whether two solutions lie on one smooth branch, so far as it can be felt. Under a sphere that comes to other edges of
/// the skin the derivatives change over a millimetre: there a branch is left only by a large jump.
pub(super) fn joins(before: &EnergyJet, after: &EnergyJet, is_sphere: bool) -> bool {
    // A tool that touches nothing can come to touch anything.
    if before.is_free() || after.is_free() {
        return true;
    }
    let size_n = norm(before.force_n).max(norm(after.force_n));
    let felt_n = Tolerance::IMPERCEPTIBLE.of_size(size_n);
    let limit_n = if is_sphere { SPHERE_JUMP_N.max(SPHERE_JUMP_SHARE * size_n) } else { felt_n };
    !Excess::with_thirds(before, after).exceeds(limit_n)
}

/// What is known of the place where the body lands.
#[derive(Debug, Clone, Copy)]
pub(super) enum Landing {
    Sought,
    Found(u32),
    Nowhere,
}

/// The end of a branch.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fold {
    pub(super) contact: u16,
    pub(super) branch: u32,
    /// The last control of the branch, m.
    pub(super) last_m: [f64; 3],
    /// The first one where it was not found, m.
    pub(super) beyond_m: [f64; 3],
    /// Whether it was not found there from a state that is near enough.
    pub(super) is_sure: bool,
    /// Direction across the fold, of unit length.
    pub(super) across: [f64; 3],
    pub(super) landing: Landing,
}

/// The direction across a fold, from the jet of the last state before it. There h = h_f - c sqrt(s) with the distance
/// s from the fold, so W_ijk ~ n_i n_j n_k s^(-3/2) outgrows what other directions contribute.
fn across(last: &EnergyJet, beyond_m: [f64; 3]) -> [f64; 3] {
    let ahead = unit(difference(beyond_m, last.control_m));
    let mut normal = [0.0; 3];
    for (&[i, j, k], third) in THIRD_INDICES.iter().zip(last.third_n_m2) {
        if i == j {
            normal[k] += third;
        } else if j == k {
            normal[i] += third;
        }
    }
    let cosine = dot(unit(normal), ahead);
    // False without third derivatives.
    if cosine.abs() >= MIN_COSINE { unit(normal).map(|x| x * cosine.signum()) } else { ahead }
}

impl Fold {
    fn width_m(&self) -> f64 {
        distance(self.last_m, self.beyond_m)
    }

    /// The middle between both ends.
    pub(super) fn middle_m(&self) -> [f64; 3] {
        std::array::from_fn(|axis| 0.5 * (self.last_m[axis] + self.beyond_m[axis]))
    }

    /// Whether a control lies behind the fold.
    fn hides(&self, control_m: [f64; 3]) -> bool {
        let away = difference(control_m, self.middle_m());
        let behind_m = dot(away, self.across);
        let (lateral2, most_m) = (dot(away, away) - behind_m * behind_m, LATERAL_M + behind_m);
        behind_m > 0.0 && behind_m < BEHIND_M && lateral2 < most_m * most_m
    }

    /// The branch of a contact, of which this is a state, was not found at a control.
    pub(super) fn new(contact: u16, branch: u32, last: &EnergyJet, beyond_m: [f64; 3]) -> Self {
        let (last_m, across) = (last.control_m, across(last, beyond_m));
        let is_sure = distance(last_m, beyond_m) <= WIDTH_M;
        Self { contact, branch, last_m, beyond_m, is_sure, across, landing: Landing::Sought }
    }

    /// The branch goes on to this state.
    pub(super) fn goes_on_to(&mut self, last: &EnergyJet) {
        let control_m = last.control_m;
        let is_within = control_m != self.beyond_m && control_m == self.middle_m();
        self.last_m = control_m;
        if !is_within {
            let by = self.across.map(|x| 0.5 * CHECKED_M * x);
            self.beyond_m = std::array::from_fn(|axis| control_m[axis] + by[axis]);
            self.is_sure = false;
        }
        self.across = across(last, self.beyond_m);
    }

    /// The branch was not found at a control from this state.
    pub(super) fn ends_before(&mut self, control_m: [f64; 3], last: &EnergyJet) {
        if control_m != last.control_m {
            let landing = self.landing;
            *self = Self { landing, ..Self::new(self.contact, self.branch, last, control_m) };
        }
    }
}

/// The branch of each contact, and the folds.
#[derive(Debug)]
pub(super) struct Branches {
    /// Contacts that are not on the branch of the body at rest.
    present: Vec<(u16, u32)>,
    newest: u32,
    folds: Vec<Fold>,
}

impl Default for Branches {
    fn default() -> Self {
        Self { present: Vec::with_capacity(4), newest: REST, folds: Vec::with_capacity(FOLDS) }
    }
}

impl Branches {
    /// The branch of a contact.
    pub(super) fn of(&self, contact: u16) -> u32 {
        self.present.iter().find(|(of, _)| *of == contact).map_or(REST, |(_, branch)| *branch)
    }

    /// Whether the body has landed on another branch.
    pub(super) fn have_folded(&self) -> bool {
        self.newest != REST
    }

    /// A branch that was not met before.
    pub(super) fn another(&mut self) -> u32 {
        self.newest += 1;
        self.newest
    }

    /// A contact is on another branch from now on.
    pub(super) fn go_to(&mut self, contact: u16, branch: u32) {
        self.present.retain(|(of, _)| *of != contact);
        if branch != REST {
            self.present.push((contact, branch));
        }
    }

    /// Contacts that are not touched are at rest.
    pub(super) fn release_but(&mut self, touch: Option<&Touch>) {
        let touched = |contact: u16| {
            touch
                .is_some_and(|touch| touch.contacts.iter().any(|&(of, weight)| of == contact && weight > 0.0))
        };
        self.present.retain(|(contact, _)| touched(*contact));
    }

    /// The folds of another model do not count.
    pub(super) fn forget_folds(&mut self) {
        self.folds.clear();
    }

    /// Adds a fold. One that was known nearby makes room for it; where the body lands there is known then.
    pub(super) fn add(&mut self, mut fold: Fold) {
        let is_same = |old: &Fold| {
            old.contact == fold.contact
                && old.branch == fold.branch
                && distance(old.middle_m(), fold.middle_m()) < SAME_M
        };
        if let Some(index) = self.folds.iter().position(is_same) {
            let old = self.folds.remove(index);
            if let (Landing::Sought, Landing::Found(_)) = (fold.landing, old.landing) {
                fold.landing = old.landing;
            }
        }
        if self.folds.len() == FOLDS {
            self.folds.remove(0);
        }
        self.folds.push(fold);
    }

    pub(super) fn fold(&mut self, index: usize) -> &mut Fold {
        &mut self.folds[index]
    }

    /// It was none.
    pub(super) fn remove(&mut self, index: usize) {
        self.folds.remove(index);
    }

    /// The folds that end the branch of a contact.
    fn ahead(&self, contact: u16) -> impl Iterator<Item = (usize, &Fold)> {
        let branch = self.of(contact);
        self.folds
            .iter()
            .enumerate()
            .filter(move |(_, fold)| fold.contact == contact && fold.branch == branch)
    }

    /// The body has landed on the branch of a contact at this control: it does not end before it.
    pub(super) fn landed_at(&mut self, contact: u16, control_m: [f64; 3]) {
        let branch = self.of(contact);
        let is_wrong =
            |fold: &Fold| fold.contact == contact && fold.branch == branch && fold.hides(control_m);
        self.folds.retain(|fold| !is_wrong(fold));
    }

    /// Whether a control lies behind a fold of a contact's branch.
    pub(super) fn hides(&self, contact: u16, control_m: [f64; 3]) -> bool {
        self.ahead(contact).any(|(_, fold)| fold.hides(control_m))
    }

    /// The fold that the hand passes on the way to a place where it will be at once, with the branch on which the
    /// body lands. It was found within a distance of there.
    pub(super) fn passed(
        &self,
        contact: u16,
        [here_m, next_m]: [[f64; 3]; 2],
        within_m: f64,
    ) -> Option<(usize, u32)> {
        let within_m = within_m.max(CHECKED_M);
        let is_passed = |fold: &Fold| {
            (fold.is_sure && fold.hides(next_m) || fold.hides(here_m))
                && distance(fold.beyond_m, next_m) <= within_m
        };
        let hiding = self.ahead(contact).filter(|(_, fold)| is_passed(fold));
        let mut landed = hiding.filter_map(|(index, fold)| match fold.landing {
            Landing::Found(branch) => Some((index, branch)),
            Landing::Sought | Landing::Nowhere => None,
        });
        landed.next()
    }

    /// The landing of a fold that the hand has passed already.
    pub(super) fn overdue(&self, contact: u16, control_m: [f64; 3]) -> Option<Task> {
        let is_overdue =
            |(_, fold): &(usize, &Fold)| matches!(fold.landing, Landing::Sought) && fold.hides(control_m);
        let (index, fold) = self.ahead(contact).find(is_overdue)?;
        Some(Task { contact, control_m: fold.beyond_m, aim: Aim::Landing(index) })
    }

    /// Whether the branch really ends where the hand will soon be, although the fold was enclosed beside its way or
    /// from afar.
    pub(super) fn check(&self, contact: u16, soon_m: [f64; 3]) -> Option<Task> {
        self.ahead(contact).filter(|(_, fold)| fold.hides(soon_m)).find_map(|(index, fold)| {
            let is_beside = distance(fold.beyond_m, soon_m) > CHECKED_M;
            let is_due = matches!(fold.landing, Landing::Found(_)) && (is_beside || !fold.is_sure);
            let control_m = match (is_beside, fold.width_m() > WIDTH_M) {
                (true, _) => soon_m,
                (false, true) => fold.middle_m(),
                (false, false) => fold.beyond_m,
            };
            is_due.then_some(Task { contact, control_m, aim: Aim::Bisection(index) })
        })
    }

    /// Whether it is known where the body lands near a control.
    pub(super) fn knows_landing(&self, contact: u16, control_m: [f64; 3]) -> bool {
        self.ahead(contact).any(|(_, fold)| {
            matches!(fold.landing, Landing::Found(_)) && distance(fold.middle_m(), control_m) < SAME_M
        })
    }

    /// What is to be done for a fold that the hand may pass on its way: enclose it, or land there.
    pub(super) fn work(&self, contact: u16, there_m: [f64; 3]) -> Option<Task> {
        self.ahead(contact).filter(|(_, fold)| fold.hides(there_m)).find_map(|(index, fold)| {
            let width_m = fold.width_m();
            let lands = matches!(fold.landing, Landing::Sought) && width_m <= LANDING_WIDTH_M;
            let (control_m, aim) = if lands {
                (fold.beyond_m, Aim::Landing(index))
            } else {
                (fold.middle_m(), Aim::Bisection(index))
            };
            (lands || width_m > WIDTH_M).then_some(Task { contact, control_m, aim })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NORMAL: [f64; 3] = [0.6, 0.0, 0.8];

    /// A state before a fold across the normal.
    fn last(control_m: [f64; 3]) -> EnergyJet {
        let mut numbers = [0.0; 20];
        for (number, [i, j, k]) in numbers[10..].iter_mut().zip(THIRD_INDICES) {
            *number = -1e5 * NORMAL[i] * NORMAL[j] * NORMAL[k];
        }
        EnergyJet::from_numbers(control_m, &numbers)
    }

    #[test]
    fn a_fold_lies_across_the_third_derivatives() {
        // Found on a way that is askew.
        let mut fold = Fold::new(0, REST, &last([0.0; 3]), [0.0, 1e-4, 2e-4]);
        assert!(distance(fold.across, NORMAL) < 1e-12 && fold.is_sure, "{fold:?}");
        let at = |r_m: f64| NORMAL.map(|n| r_m * n);
        assert!(fold.hides(at(1e-3)) && !fold.hides(at(-1e-3)) && !fold.hides(at(0.03)));
        assert!(!fold.hides([0.0, 0.02, 1e-3]), "too far aside");
        fold.goes_on_to(&last(at(2e-3)));
        assert!(!fold.hides(at(2e-3)) && fold.hides(at(3e-3)) && !fold.is_sure, "it recedes");
        fold.ends_before(at(4e-3), &last(at(2e-3)));
        assert!(!fold.is_sure && !fold.hides(at(2.9e-3)) && fold.hides(at(3.1e-3)), "{fold:?}");
    }

    #[test]
    fn a_touch_changes_its_branch_where_it_passes_the_fold() {
        let at = |r_m: f64| NORMAL.map(|n| r_m * n);
        let mut branches = Branches::default();
        branches.add(Fold::new(3, REST, &last([0.0; 3]), at(2e-3)));
        let Some(Task { aim: Aim::Landing(index), .. }) = branches.work(3, at(5e-3)) else {
            panic!("it is to land: {branches:?}")
        };
        assert!(branches.passed(3, [at(2e-3), at(2e-3)], 0.0).is_none(), "not landed yet");
        let branch = branches.another();
        branches.fold(index).landing = Landing::Found(branch);
        let passed =
            |branches: &Branches, here, next| branches.passed(3, [at(here), at(next)], 0.0).is_some();
        assert!(!passed(&branches, 0.5e-3, 1.5e-3), "the end is not sure");
        assert!(passed(&branches, 1.5e-3, 2e-3) && !passed(&branches, 6e-3, 6.5e-3));
        branches.fold(index).ends_before(at(1.2e-3), &last(at(1e-3)));
        assert!(passed(&branches, 0.5e-3, 1.2e-3) && !passed(&branches, 0.5e-3, 1e-3), "sure");
        branches.go_to(3, branch);
        assert!(!branches.hides(3, at(5e-3)), "the other branch goes on");
        branches.release_but(None);
        assert!(branches.of(3) == REST && branches.hides(3, at(5e-3)), "at rest again");
    }
}
