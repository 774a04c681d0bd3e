//! Solves at one position: by continuation, by enclosing the fold that ends it, or by landing.

use super::super::branches::{Fold, Landing, REST, joins};
use super::super::choice::CHECK_S;
use super::super::hand::Hand;
use super::super::published::Step;
use super::super::states::Start;
use super::super::task::{Aim, Task};
use super::super::workers::Made;
use super::LiveSolver;
use crate::fem::{Coupling, DESCENT_STEPS, FollowOptions, Followed, FreeBody, Seed};
use crate::num::jet::EnergyJet;
use crate::num::vector::{distance, norm};
use crate::spec::Tolerance;

/// The factor of a fingertip serves for contacts within this distance of where it was made, in radii.
const NEIGHBOUR_RADII: f64 = 1.5;
/// A continuation is given up early, because half of the way or a landing costs less; a sweep of the sensitivities
/// costs less than a new factor.
pub(super) const OPTIONS: FollowOptions = FollowOptions {
    residual: 1e-3,
    max_frozen_steps: 8,
    max_steps: 10,
    sensitivity: 3e-3,
    max_sweeps: 8,
    worst_sensitivity: 0.3,
    renews: true,
    gives_up: false,
};
/// Most sweeps where no new factor is made.
const MAX_SWEEPS_FROZEN: u32 = 12;
/// Most steps of a continuation where the hand is not.
const MAX_STEPS_AHEAD: u32 = 6;
/// A branch that is not found at the hand within this distance from its last state has ended, m.
const NEAR_M: f64 = 1e-3;
/// Times that a continuation that fails is tried over half of the way.
pub(super) const HALVINGS: u32 = 2;
/// A branch that was met before is known again from its states within this distance, m.
const SAME_BRANCH_M: f64 = 5e-3;
/// A descent ends after this time, s,
const LONGEST_DESCENT_S: f64 = 5.0;
/// and is not begun where it could not make so many steps.
const MIN_DESCENT: u32 = 12;
/// The touch changes its branch this time before the hand is at the fold, s: half the time constant in which the loop
/// fades.
const LEAD_S: f64 = 0.005;

/// What came of a task.
enum Found {
    /// A state on the same branch.
    Joined(Followed),
    /// A state on another one.
    Landed(Followed),
    /// A fold, behind which the body may have landed already.
    Fold,
    /// Nothing.
    Nothing,
}

impl LiveSolver {
    /// Goes over to the branch behind a fold that the hand has passed; whether there is one.
    pub(super) fn passes_fold(&mut self, hand: &Hand) -> bool {
        let Some(touch) = &hand.touch else { return false };
        let soon_m = std::array::from_fn(|axis| touch.control_m[axis] + LEAD_S * hand.velocity_m_s[axis]);
        let within_m = CHECK_S * norm(hand.velocity_m_s);
        for (contact, _) in touch.contacts.into_iter().filter(|(_, weight)| *weight > 0.0) {
            let Some((index, branch)) = self.branches.passed(contact, [touch.control_m, soon_m], within_m)
            else {
                continue;
            };
            let nearest = self.states.nearest(contact, branch, touch.control_m);
            let Some(jet) = nearest.map(|seed| (seed.jet, seed.coupling)) else {
                // Its states were given up for others.
                self.branches.fold(index).landing = Landing::Sought;
                continue;
            };
            self.change_branch(contact, branch);
            self.branches.landed_at(contact, soon_m);
            self.publish(contact, branch, jet, false, Some(0));
            return true;
        }
        false
    }

    pub(super) fn solve(&mut self, task: Task) -> Step {
        let contact = task.contact;
        let is_first = self.known[usize::from(contact)].is_empty();
        let moves = self.go_to(contact, is_first);
        let second_m = self.second_m.filter(|_| !is_first);
        self.workers.present().solver.set_second(self.skin.second(), second_m);
        let from = self.start(&task, is_first);
        let branch = if is_first { REST } else { self.branches.of(contact) };
        let factorisations = self.totals.factorisations;
        let is_begun = self.free_body.is_some();
        let mut to = self.states.room();
        let at_rest = if is_first { self.first(&task, &mut to) } else { None };
        let found = match task.aim {
            _ if let Some(found) = at_rest => Found::Joined(found),
            Aim::Landing(index) => self.land_ahead(index, &from, &mut to),
            Aim::Bisection(index) => self.enclose(index, &task, &from, moves, &mut to),
            Aim::Hand | Aim::Renewal | Aim::Ahead => self.reach(&from, &task, moves, &mut to),
        };
        let factors =
            self.totals.factorisations - factorisations + u64::from(self.free_body.is_some() != is_begun);
        self.times.begin(if matches!(found, Found::Joined(_)) { Some(factors) } else { None });
        let is_lost = matches!(found, Found::Nothing) && task.aim.is_at_hand();
        let leads_on = match found {
            Found::Joined(found) => {
                if !from.is_guess && to.jet.control_m != from.seed.jet.control_m {
                    self.growth.measure(&self.known[usize::from(contact)], &to.jet, branch);
                }
                self.publish(contact, branch, (to.jet, to.coupling), true, found.unstable_modes);
                self.states.keep(contact, branch, Start { seed: to, is_guess: false });
                true
            }
            Found::Landed(found) => {
                let landed = self.landed(&task, &from, (to.jet, to.coupling), found);
                self.states.keep(contact, landed, Start { seed: to, is_guess: false });
                true
            }
            Found::Fold | Found::Nothing => {
                self.states.give_back(to);
                false
            }
        };
        // A guess that led nowhere would be tried again, and the body at rest is known.
        if is_first || from.is_guess && !leads_on || from.seed.jet.is_free() {
            self.states.give_back(from.seed);
        } else {
            self.states.keep(contact, branch, from);
        }
        // The choice would take a press again: no fold has been noted that hides it.
        let is_press = task.aim == Aim::Ahead && self.prepares();
        if is_press && !leads_on && !self.branches.hides(contact, task.control_m) {
            self.lost.add(&task);
        }
        if is_lost {
            self.lost.add(&task);
            self.totals.lost += 1;
            return Step::Lost { contact, control_m: task.control_m };
        }
        Step::Solved
    }

    /// The state to start from: the nearest of the contact's branch, or the body at rest.
    fn start(&mut self, task: &Task, is_first: bool) -> Start {
        if !is_first {
            if let Some(start) = self.untouched(task) {
                return start;
            }
            let branch = self.branches.of(task.contact);
            if let Some(start) = self.states.take_nearest(task.contact, branch, task.control_m) {
                return start;
            }
            self.branches.go_to(task.contact, REST);
            if let Some(start) = self.states.take_nearest(task.contact, REST, task.control_m) {
                return start;
            }
        }
        let mut rest = self.states.room();
        rest.become_rest(&self.body, [0.0; 3]);
        if !is_first {
            // Its state was given up: solved again, which also finds its sensitivities.
            let mut to = self.states.room();
            let worker = self.workers.present();
            let found = worker.solver.follow(&rest, [0.0; 3], true, &FollowOptions::default(), &mut to);
            worker.factor = if found.is_ok() { Made::At(task.contact, [0.0; 3]) } else { Made::Unknown };
            if found.is_ok() {
                std::mem::swap(&mut rest, &mut to);
            }
            self.states.give_back(to);
        }
        Start { seed: rest, is_guess: false }
    }

    /// Moves the solver to a contact; whether it needs a new factor.
    fn go_to(&mut self, contact: u16, is_first: bool) -> bool {
        let problem = self.problem(contact);
        if is_first {
            self.workers.rest_at(problem);
            return true;
        }
        self.workers.go_to(contact, problem);
        let radius_m = self.skin.tip().map_or(0.0, |tip| tip.radius_m);
        let worker = self.workers.present();
        let serves = match worker.factor {
            Made::Unknown => false,
            Made::Free => true,
            Made::At(of, _) => self.skin.distance_m(of, contact) <= NEIGHBOUR_RADII * radius_m,
        };
        if serves {
            return false;
        }
        worker.factor = Made::Unknown;
        !self.borrows_factor(contact)
    }

    /// Gives the present solver, at a contact, the factor of the free body where new ones take too long; whether it has it.
    pub(super) fn borrows_factor(&mut self, contact: u16) -> bool {
        let waits = self.waits_for_factors();
        let worker = self.workers.present();
        if waits
            && let Some(Some(free_body)) = &mut self.free_body
            && worker.solver.borrow_factor(free_body)
        {
            let is_held = worker.solver.problem().contact.as_ref().is_some_and(|by| by.handle().is_some());
            worker.factor = if is_held { Made::At(contact, [0.0; 3]) } else { Made::Free };
        }
        worker.factor != Made::Unknown
    }

    /// The contact at rest, by the factor of the free body; `None` if that does not serve.
    fn first(&mut self, task: &Task, to: &mut Seed) -> Option<Followed> {
        if task.aim == Aim::Renewal || task.control_m != [0.0; 3] || self.needs_no_factor() {
            return None;
        }
        let free_body = self.free_body.get_or_insert_with(|| FreeBody::new(&self.free));
        self.workers.present().solver.rest_by(free_body.as_mut()?, to).ok()
    }

    /// Continues to the task's position, over half of the way if that fails. Then the body lands if the hand is
    /// there; else a fold lies ahead.
    fn reach(&mut self, from: &Start, task: &Task, moves: bool, to: &mut Seed) -> Found {
        let (start_m, mut control_m) = (from.seed.jet.control_m, task.control_m);
        let renews = moves || task.aim == Aim::Renewal;
        let mut failed_m = None;
        for halvings in 0..=HALVINGS {
            if let Some(found) = self.continued(from, task, control_m, renews || halvings > 0, to) {
                if let Some(beyond_m) = failed_m.filter(|_| !task.aim.is_at_hand()) {
                    self.note_fold(task.contact, &to.jet, beyond_m);
                }
                return Found::Joined(found);
            }
            failed_m = Some(control_m);
            // Where no factor is made, half of the way is worth less than another look at the hand.
            if control_m == start_m || self.makes_no_factor() && !task.aim.is_at_hand() {
                break;
            }
            if distance(start_m, control_m) < NEAR_M && task.aim.is_at_hand() {
                if self.branches.knows_landing(task.contact, control_m) {
                    self.note_fold(task.contact, &from.seed.jet, control_m);
                    return Found::Fold;
                }
                break;
            }
            control_m = std::array::from_fn(|axis| 0.5 * (start_m[axis] + control_m[axis]));
        }
        if task.aim.is_at_hand() {
            return self.land(from, task, to);
        }
        if let Some(beyond_m) = failed_m.filter(|failed_m| *failed_m != start_m) {
            self.note_fold(task.contact, &from.seed.jet, beyond_m);
        }
        Found::Fold
    }

    /// The state at a control of a contact, if the branch of `from` leads to one that is not known to be unstable.
    pub(super) fn continued(
        &mut self,
        from: &Start,
        task: &Task,
        control_m: [f64; 3],
        renews: bool,
        to: &mut Seed,
    ) -> Option<Followed> {
        let is_sphere = self.skin.sphere().is_some();
        let options = if self.waits_for_factors() {
            FollowOptions { max_sweeps: MAX_SWEEPS_FROZEN, renews: false, ..OPTIONS }
        } else if task.aim.is_at_hand() || is_sphere || self.makes_no_factor() {
            OPTIONS
        } else {
            FollowOptions { max_steps: MAX_STEPS_AHEAD, ..OPTIONS }
        };
        let options = FollowOptions { gives_up: self.makes_no_factor(), ..options };
        let renews = renews && (options.renews || self.workers.present().factor == Made::Unknown);
        let worker = self.workers.present();
        let Ok(found) = worker.solver.follow(&from.seed, control_m, renews, &options, to) else {
            // What the attempt factorised is unknown.
            if options.renews {
                worker.factor = Made::Unknown;
            }
            return None;
        };
        self.count(task.contact, control_m, &found);
        let before = &from.seed.jet;
        let is_same = from.is_guess || control_m == before.control_m || joins(before, &to.jet, is_sphere);
        (is_same && found.unstable_modes.is_none_or(|modes| modes == 0)).then_some(found)
    }

    /// Most steps of a descent.
    fn longest_descent(&self) -> u32 {
        // Without a factor in a solve, one says nothing about a descent, which makes one a step.
        let step_s = match self.needs_no_factor() {
            true => self.times.descent_s(self.free.factor_flops()),
            false => self.times.renewed_s(),
        };
        (LONGEST_DESCENT_S / step_s).min(f64::from(DESCENT_STEPS)) as u32
    }

    /// Whether the body needs no factor, and one takes so long that live makes none.
    fn makes_no_factor(&self) -> bool {
        self.needs_no_factor() && self.longest_descent() < MIN_DESCENT
    }

    /// Lands where the hand is.
    fn land(&mut self, from: &Start, task: &Task, to: &mut Seed) -> Found {
        let most = self.longest_descent();
        if most < MIN_DESCENT {
            return Found::Nothing;
        }
        let worker = self.workers.present();
        worker.factor = Made::Unknown;
        let found = worker.solver.relax(&from.seed, task.control_m, most, to);
        self.times
            .descends(found.as_ref().map_or_else(|failure| failure.iterations, |found| found.count.steps));
        let Ok(found) = found else { return Found::Nothing };
        self.count(task.contact, task.control_m, &found);
        let (before, is_sphere) = (&from.seed.jet, self.skin.sphere().is_some());
        let is_other = before.control_m == task.control_m || !joins(before, &to.jet, is_sphere);
        if from.is_guess || !is_other || self.leads_back(to, before) {
            return Found::Joined(found);
        }
        self.totals.landings += 1;
        Found::Landed(found)
    }

    /// Whether the branch of a landing leads back to the state that was left: near a fold the derivatives say little
    /// about the force a little farther on.
    fn leads_back(&mut self, landed: &Seed, before: &EnergyJet) -> bool {
        if landed.jet.control_m == before.control_m {
            return false;
        }
        let mut back = self.states.room();
        let solver = &mut self.workers.present().solver;
        let found = solver.follow(landed, before.control_m, false, &OPTIONS, &mut back);
        let limit_n = Tolerance::IMPERCEPTIBLE.at(before.force_n);
        let is_same = found.is_ok() && distance(back.jet.force_n, before.force_n) < limit_n;
        self.states.give_back(back);
        self.workers.present().factor = Made::Unknown;
        is_same
    }

    /// Lands behind a fold; if nothing is found, or no fold, this is noted.
    fn land_ahead(&mut self, index: usize, from: &Start, to: &mut Seed) -> Found {
        let &mut Fold { contact, beyond_m: control_m, .. } = self.branches.fold(index);
        let found = self.land(from, &Task { contact, control_m, aim: Aim::Landing(index) }, to);
        match found {
            Found::Joined(_) => self.branches.remove(index),
            Found::Nothing => self.branches.fold(index).landing = Landing::Nowhere,
            Found::Landed(_) | Found::Fold => {}
        }
        found
    }

    /// Tries the branch where a fold may be.
    fn enclose(&mut self, index: usize, task: &Task, from: &Start, moves: bool, to: &mut Seed) -> Found {
        let found = self.continued(from, task, task.control_m, moves, to);
        let fold = self.branches.fold(index);
        let Some(found) = found else {
            fold.ends_before(task.control_m, &from.seed.jet);
            return Found::Fold;
        };
        fold.goes_on_to(&to.jet);
        self.unlearn_landing(index, &to.jet);
        Found::Joined(found)
    }

    /// The descent behind a fold may have ended on the branch that was left: Newton's method did not find it there, and
    /// it goes on. It is known by the force that this state of the branch predicts.
    fn unlearn_landing(&mut self, index: usize, jet: &EnergyJet) {
        let &mut Fold { contact, branch, landing, .. } = self.branches.fold(index);
        let Landing::Found(other) = landing else { return };
        let Some(landed) = self.states.nearest(contact, other, jet.control_m).map(|seed| seed.jet) else {
            return;
        };
        let limit_n = Tolerance::IMPERCEPTIBLE.at(landed.force_n);
        let is_same = distance(landed.control_m, jet.control_m) < SAME_BRANCH_M
            && distance(jet.taylor_force_n(landed.control_m), landed.force_n) < limit_n;
        if is_same {
            self.states.rename(contact, other, branch);
            let fold = self.branches.fold(index);
            fold.landing = Landing::Sought;
            fold.goes_on_to(&landed);
        }
    }

    /// The present branch of a contact was not found at a control from this state.
    fn note_fold(&mut self, contact: u16, last: &EnergyJet, beyond_m: [f64; 3]) {
        // A sphere that comes to other edges of the skin is not found from far away, though no branch ends there.
        if self.skin.sphere().is_some() || self.longest_descent() < MIN_DESCENT {
            self.lost.add(&Task { contact, control_m: beyond_m, aim: Aim::Ahead });
            return;
        }
        self.branches.add(Fold::new(contact, self.branches.of(contact), last, beyond_m));
    }

    /// Enters the jet of a landing: a fold that lies ahead keeps it back, else the touch changes its branch. Returns
    /// the branch.
    fn landed(
        &mut self,
        task: &Task,
        from: &Start,
        jet: (EnergyJet, Option<Coupling>),
        found: Followed,
    ) -> u32 {
        let contact = task.contact;
        let left = self.branches.of(contact);
        let branch = self.met_before(contact, left, &jet.0).unwrap_or_else(|| self.branches.another());
        let landing = Landing::Found(branch);
        if let Aim::Landing(index) = task.aim {
            // The factor at hand is that of the other branch.
            self.workers.forget_factor(contact);
            self.branches.fold(index).landing = landing;
            return branch;
        }
        if from.seed.jet.control_m != task.control_m {
            let fold = Fold::new(contact, left, &from.seed.jet, task.control_m);
            self.branches.add(Fold { landing, ..fold });
        }
        self.change_branch(contact, branch);
        self.branches.landed_at(contact, task.control_m);
        self.publish(contact, branch, jet, false, found.unstable_modes);
        branch
    }

    /// The branch of which a kept state predicts this jet.
    fn met_before(&self, contact: u16, left: u32, jet: &EnergyJet) -> Option<u32> {
        let limit_n = Tolerance::IMPERCEPTIBLE.at(jet.force_n);
        let predicts = |(branch, seed): &(u32, &Seed)| {
            *branch != left
                && distance(seed.jet.control_m, jet.control_m) < SAME_BRANCH_M
                && distance(seed.jet.taylor_force_n(jet.control_m), jet.force_n) < limit_n
        };
        self.states.of(contact).find(predicts).map(|(branch, _)| branch)
    }

    fn change_branch(&mut self, contact: u16, branch: u32) {
        self.branches.go_to(contact, branch);
        self.workers.forget_factor(contact);
        self.lost.forget(contact);
    }

    fn count(&mut self, contact: u16, control_m: [f64; 3], found: &Followed) {
        self.totals.factorisations += u64::from(found.count.factorisations);
        if found.count.factorisations > 0 {
            self.workers.present().factor = Made::At(contact, control_m);
        }
    }
}
