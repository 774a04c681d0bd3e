//! The live solver: in every step it chooses a position, solves there and publishes the jet.

mod beside;
mod facing;
mod loaded;
mod publishing;
mod renewing;
mod solving;

use std::collections::VecDeque;
use std::sync::Arc;

use palpate_core::{Method, Organ, Space};

use super::branches::{Branches, REST};
use super::choice::{Choice, LostPositions};
use super::error::LiveError;
use super::hand::{Hand, Touch, Way};
use super::memory::{Growth, Known, Limit};
use super::published::{Published, Step, Totals};
use super::renewals::Renewals;
use super::skin::Skin;
use super::states::States;
use super::tabled;
use super::task::{Aim, Task};
use super::times::SolveTimes;
use super::workers::Workers;
use crate::fem::{Body, CoatedSphere, Constraints, Coupling, FreeBody, Posture, Problem, Second, Seed};
use crate::num::jet::EnergyJet;
use crate::num::vector::{difference, norm};
use crate::pack::PackError;
use crate::scene::{ElementOrder, ResolvedScene};
use beside::Alone;

/// Number of contacts whose problem is kept, and that of a large body, where one has about 10 MB.
const PROBLEMS: usize = 256;
const LARGE_PROBLEMS: usize = 24;
/// Jets that wait for the loop during a change of the model, usually.
const OUTBOX: usize = 16;
/// Share of the fixed part in the force of a sphere from which on that is what it presses on.
const MOSTLY: f64 = 0.5;
/// A touch begins before a tool overlaps the body by this, m.
const OVERLAP_M: f64 = 1e-3;
/// Solves after a change of the model for which its jets may wait: a hand that moves fast is never known.
const MAX_HELD: u32 = 12;

/// The solver of one live session.
#[derive(Debug)]
pub struct LiveSolver {
    body: Arc<Body>,
    skin: Skin,
    free: Arc<Problem>,
    problems: Vec<(u16, Arc<Problem>)>,
    workers: Workers,
    /// The body without a contact, whose factor gives the jets at rest; made by the first one, and `None` in it if
    /// its tangent is singular.
    free_body: Option<Option<FreeBody>>,
    states: States,
    known: Vec<Known>,
    growth: Growth,
    lost: LostPositions,
    branches: Branches,
    times: SolveTimes,
    way: Way,
    renewals: Option<Renewals>,
    /// A contact whose kept state has turned out to be unstable.
    doubted: Option<u16>,
    totals: Totals,
    near: Vec<(f64, u16)>,
    /// Jets that were not taken yet.
    outbox: VecDeque<Published>,
    /// Contacts in the order of their last use, the last one at the end.
    recent: VecDeque<u16>,
    /// Contacts whose jets the loop may have given up.
    lost_by_loop: Vec<u16>,
    /// Contacts with jets of a blob that the loop has not got, and whether those near rest are on their way.
    unsent: Vec<(u16, bool)>,
    /// Contacts whose jets have just been put on their way.
    begun: Vec<u16>,
    /// These jets, which wait for the solved ones.
    tabled: VecDeque<Published>,
    /// Number of the model, and the rest state of the first one.
    model: u32,
    first_rest: Vec<f64>,
    /// Whether the jets of a new model wait until the present touch is known, and the solves since the change.
    holds_back: bool,
    held_solves: u32,
    /// The half axis of a capsule, or the displacement of the partner while it feels a force.
    second_m: Option<[f64; 3]>,
    alone: Alone,
}

impl LiveSolver {
    /// Builds the body of a scene and solves its rest state.
    ///
    /// # Errors
    ///
    /// [`LiveError`].
    pub fn new(scene: &ResolvedScene) -> Result<Self, LiveError> {
        if scene.order == ElementOrder::NearTool {
            return Err(LiveError::NearTool);
        }
        let body = Arc::new(scene.body().map_err(|error| LiveError::Body(error.to_string()))?);
        let skin = Skin::new(&scene.mesh, &body, &scene.tool)?;
        let free = Arc::new(Problem::with(body.clone(), None, Constraints::Elimination));
        let workers = Workers::new(&Arc::new(free.at(skin.touch(0, &body))));
        // The factor of a large body at rest: a hand does not wait for it.
        if skin.sphere().is_none() {
            free.needs_no_factor();
        }
        let blank = Seed::at_rest(&body);
        let first_rest = body.rest_state.clone();
        Ok(Self {
            states: States::like(&blank),
            known: vec![Known::of_stiffness(skin.stiffness_n_m(&body)); skin.contacts.len()],
            near: Vec::with_capacity(skin.contacts.len()),
            recent: VecDeque::with_capacity(skin.contacts.len() + 1),
            lost_by_loop: Vec::with_capacity(skin.contacts.len()),
            body,
            skin,
            free,
            problems: Vec::with_capacity(PROBLEMS),
            workers,
            free_body: None,
            growth: Growth::first(scene.tool.sphere().is_some()),
            lost: LostPositions::default(),
            branches: Branches::default(),
            times: SolveTimes::default(),
            way: Way::default(),
            renewals: None,
            doubted: None,
            totals: Totals::default(),
            outbox: VecDeque::with_capacity(OUTBOX),
            unsent: Vec::new(),
            begun: Vec::new(),
            tabled: VecDeque::new(),
            model: 0,
            first_rest,
            holds_back: false,
            held_solves: 0,
            second_m: None,
            alone: Alone::default(),
        })
    }

    /// The places that can be touched.
    pub fn skin(&self) -> &Skin {
        &self.skin
    }

    /// The organ of the session as a blob without tables, and the mesh nodes of the vertices of its surface. The
    /// spaces are the contacts.
    ///
    /// # Errors
    ///
    /// [`PackError`].
    pub fn organ(&self, scene: &ResolvedScene) -> Result<(Vec<u8>, Vec<u32>), PackError> {
        self.skin.organ(scene, &self.body)
    }

    /// Takes the tables of a blob of the same model as known. The loop gets their jets when the tool comes near.
    /// Returns the numbers of contacts and of jets; contacts of the blob that are no vertices of the skin are left
    /// out.
    ///
    /// # Errors
    ///
    /// [`LiveError::OtherBlob`], by mesh, tool, law, and by what is solved at one contact: the stiffness at rest, and the
    /// force on the way to the largest one of its tables.
    pub fn begin_with(
        &mut self,
        organ: &Organ<'_>,
        scene: &ResolvedScene,
    ) -> Result<(usize, usize), LiveError> {
        let method = tabled::check(organ, scene, &self.body.law_names())?;
        let (mut contacts, mut count) = (0, 0);
        for space in &organ.spaces {
            let Some(contact) = tabled::contact_of(&self.skin, space) else { continue };
            let (jets, within_m) = tabled::jets(space, method, scene.max_force_n);
            if jets.is_empty() {
                continue;
            }
            if contacts == 0 {
                self.check_tables(contact, space, method, &jets)?;
            }
            let known = &mut self.known[usize::from(contact)];
            for jet in &jets {
                let trust = known.trust(*jet, None);
                known.add(trust, REST, false);
            }
            known.are_tabled(within_m);
            contacts += 1;
            count += jets.len();
            self.unsent.push((contact, false));
        }
        self.tabled.reserve(count);
        Ok((contacts, count))
    }

    /// Solves a contact at rest and where its tables have the largest force, and compares.
    fn check_tables(
        &mut self,
        contact: u16,
        space: &Space<'_>,
        method: Method,
        jets: &[EnergyJet],
    ) -> Result<(), LiveError> {
        let other = |what| Err(LiveError::OtherBlob(what));
        self.solve(Task { contact, control_m: [0.0; 3], aim: Aim::Renewal });
        let solved = self.known[usize::from(contact)].jets().next();
        if !solved.is_some_and(|solved| tabled::is_of_model(&jets[0], solved)) {
            return other("another stiffness");
        }
        let hardest = tabled::hardest(jets).map_or([0.0; 3], |jet| jet.control_m);
        for share in [0.5, 1.0] {
            let control_m = hardest.map(|x| share * x);
            self.solve(Task { contact, control_m, aim: Aim::Ahead });
            let nearest = self.states.nearest(contact, REST, control_m).map(|seed| seed.jet);
            let compared =
                nearest.and_then(|jet| Some((tabled::jet(space, method, jet.control_m)?, jet.force_n)));
            if !compared.is_some_and(|(table, solved_n)| tabled::is_force_of_model(&table, solved_n)) {
                return other("another force");
            }
        }
        Ok(())
    }

    /// From now on new factors that take long are made on a thread of their own, which first calls `begin`: it may
    /// lower its priority. Without this the steps are the same in every run.
    pub fn renew_beside(&mut self, begin: fn()) {
        self.renewals = Some(Renewals::new(&self.free, begin));
    }

    /// Whether a factor is being made beside the steps.
    pub fn is_renewing(&self) -> bool {
        self.renewals.as_ref().is_some_and(Renewals::is_busy)
    }

    /// Number of equations.
    pub fn unknowns(&self) -> usize {
        self.free.unknowns()
    }

    /// Goes on with another model of the same body: other materials, another body force or other fixed nodes. The
    /// states at hand are the start of the new ones, so the touch continues; its jets are published together once
    /// all contacts of the touch are known.
    ///
    /// The places that can be touched stay those of the start. A place that becomes fixed is no longer solved.
    ///
    /// # Errors
    ///
    /// [`LiveError`]; the solver is then as before.
    pub fn change(&mut self, scene: &ResolvedScene) -> Result<(), LiveError> {
        if scene.order == ElementOrder::NearTool {
            return Err(LiveError::NearTool);
        }
        let body = Arc::new(scene.body().map_err(|error| LiveError::Body(error.to_string()))?);
        let same_tool = self.skin.is_touched_by(&scene.tool);
        if !same_tool || body.nodes_m != self.body.nodes_m || body.state_len() != self.body.state_len() {
            return Err(LiveError::OtherBody);
        }
        // From here on nothing fails.
        let mut skin = self.skin.clone();
        skin.free_only(&body);
        let first = skin.first_free().ok_or(LiveError::NothingToTouch)?;
        self.skin = skin;
        self.forget_partner();
        self.free = Arc::new(Problem::with(body.clone(), None, Constraints::Elimination));
        self.states.become_those_of(&self.body, &body);
        self.body = body;
        self.problems.clear();
        self.workers = Workers::new(&Arc::new(self.free.at(self.skin.touch(first, &self.body))));
        self.renewals = self.renewals.take().map(|old| old.for_problem(&self.free));
        (self.free_body, self.doubted) = (None, None);
        self.known.fill(Known::of_stiffness(self.skin.stiffness_n_m(&self.body)));
        (self.growth, self.lost) = (Growth::first(self.skin.sphere().is_some()), LostPositions::default());
        self.branches.forget_folds();
        self.outbox.clear();
        self.recent.clear();
        self.lost_by_loop.clear();
        self.unsent.clear();
        self.tabled.clear();
        self.model += 1;
        (self.holds_back, self.held_solves) = (true, 0);
        Ok(())
    }

    /// Work since the start.
    pub fn totals(&self) -> Totals {
        self.totals
    }

    /// States how long the last step took, s.
    pub fn took(&mut self, seconds: f64) {
        self.times.took(seconds);
        self.way.took(seconds);
    }

    /// Solves at one position, if there is one that is worth it, or goes over to the branch behind a fold that the
    /// hand has passed.
    pub fn step(&mut self, hand: &Hand) -> Step {
        self.times.begin(None);
        self.face(hand);
        self.take_renewal();
        self.send_known(hand);
        self.branches.release_but(hand.touch.as_ref());
        let step = if self.passes_fold(hand) { Step::Solved } else { self.solve_next(hand) };
        self.held_solves += u32::from(step != Step::Idle);
        self.holds_back &= self.held_solves < MAX_HELD
            && step != Step::Idle
            && hand.touch.as_ref().is_some_and(|touch| !self.knows(touch));
        step
    }

    fn solve_next(&mut self, hand: &Hand) -> Step {
        let hand = &self.way.steady(hand);
        // The next touch of a free tool starts from there.
        if hand.touch.is_none()
            && let Some(step) = self.follow_partner()
        {
            return step;
        }
        let (waits, prepares) = (self.waits_for_factors(), self.prepares());
        let Self { skin, body, known, growth, lost, branches, workers, states, times, near, .. } = self;
        let renewals = self.renewals.as_ref().filter(|_| waits);
        let doubted = self.doubted;
        let choice = Choice {
            skin,
            body,
            known,
            growth,
            lost,
            branches,
            workers,
            renewals,
            prepares,
            doubted,
            states,
            times,
        };
        match choice.next(hand, near) {
            Some(task) if task.aim == Aim::Renewal && self.begin_renewal(&task) => Step::Renewing,
            Some(task) => self.solve(task),
            None => Step::Idle,
        }
    }

    /// Whether the loop gets jets of the present model: not before the touch is known after a change.
    pub fn is_ready(&self) -> bool {
        !self.holds_back
    }

    /// The next jet for the loop. After a change of the model there is none until the present touch is known.
    pub fn published(&mut self) -> Option<Published> {
        if self.holds_back { None } else { self.outbox.pop_front().or_else(|| self.tabled.pop_front()) }
    }

    /// Whether every contact of a touch is known there, or cannot be.
    fn knows(&self, touch: &Touch) -> bool {
        let is_lost = |contact, control_m| self.lost.contains(&Task { contact, control_m, aim: Aim::Hand });
        touch.contacts.iter().filter(|(_, weight)| *weight > 0.0).all(|&(contact, weight)| {
            let known = self.known.get(usize::from(contact));
            !self.skin.is_free(contact)
                || is_lost(contact, touch.control_m)
                || is_lost(contact, [0.0; 3])
                || known.is_none_or(|known| {
                    let at = (touch.control_m, self.branches.of(contact));
                    self.growth.knows(known, at, weight, Limit::Unknown)
                })
        })
    }

    /// Whether most of the force of a sphere is that of the fixed part, in the state nearest to the hand.
    pub fn presses_fixed_part(&self, hand: &Hand) -> bool {
        let touch = hand.touch.as_ref().filter(|_| self.skin.sphere().is_some());
        let nearest = touch.and_then(|touch| self.states.nearest(0, self.branches.of(0), touch.control_m));
        nearest.is_some_and(|seed| self.is_of_fixed_part(&seed.jet, seed.coupling.as_ref()))
    }

    /// Whether most of a force is that of the fixed part.
    pub(super) fn is_of_fixed_part(&self, jet: &EnergyJet, coupling: Option<&Coupling>) -> bool {
        let axis = coupling.filter(|coupling| coupling.of == Second::Axis);
        let half_m = axis.map_or([0.0; 3], |axis| axis.second_m);
        let posture = Posture { displacement_m: jet.control_m, half_m };
        let wall_n = self.skin.sphere().map_or(0.0, |sphere| sphere.wall_n(&self.body, &posture));
        wall_n > MOSTLY * norm(jet.force_n)
    }

    /// Whether a sphere or capsule overlaps the body at rest, and its touch has not begun.
    pub fn overlaps_unfelt(&self, hand: &Hand) -> bool {
        let is_free = hand.touch.is_none() && hand.partner.is_none();
        let Some(sphere) = self.skin.sphere().filter(|_| is_free) else { return false };
        let control_m = difference(hand.hip_m, self.skin.contacts[0].rest_m);
        let sphere = sphere.turned(hand.axis.map_or([0.0; 3], |axis| axis.half_m));
        sphere.clearance_m(&self.body, control_m) < -OVERLAP_M
    }

    /// The problem of a contact.
    pub(super) fn problem_of(&self, contact: u16) -> Arc<Problem> {
        Arc::new(self.free.at(self.skin.touch(contact, &self.body)))
    }

    pub(super) fn body(&self) -> &Body {
        &self.body
    }

    /// The body at rest, with a sphere where it touches nothing on the shortest way from this control.
    pub(super) fn untouched_at(&self, sphere: Option<&CoatedSphere>, control_m: [f64; 3]) -> Seed {
        let mut seed = Seed::at_rest(&self.body);
        if let Some(sphere) = sphere {
            seed.become_rest(&self.body, sphere.beside_m(&self.body, control_m));
        }
        seed
    }

    fn problem(&mut self, contact: u16) -> Arc<Problem> {
        if let Some(at) = self.problems.iter().position(|(of, _)| *of == contact) {
            return self.problems[at].1.clone();
        }
        let problem = self.problem_of(contact);
        let most = if self.free.is_large() { LARGE_PROBLEMS } else { PROBLEMS };
        if self.problems.len() >= most {
            self.problems.remove(0);
        }
        self.problems.push((contact, problem.clone()));
        problem
    }

    /// Displacement of nodes from the rest of the first model, in the state nearest to the hand, blended over the
    /// contacts of the touch, m. That of the body at rest without a touch, and for contacts without a kept state.
    pub fn displacements_into(&self, hand: &Hand, nodes: &[u32], out: &mut [[f32; 3]]) {
        let branch_of = |contact| self.branches.of(contact);
        self.states.displacements_into(hand, (&self.body, &self.first_rest), branch_of, nodes, out);
    }
}

#[cfg(test)]
mod tests;
