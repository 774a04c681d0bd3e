//! One step of the live solver: choose, continue or land, publish.

use std::collections::VecDeque;
use std::sync::Arc;

use super::choice::{Choice, LostPositions, Task};
use super::error::LiveError;
use super::hand::{Hand, Touch};
use super::memory::{Growth, Known, Limit};
use super::published::{Published, Step, Totals};
use super::skin::Skin;
use super::states::{Start, States};
use super::workers::Workers;
use crate::fem::{Body, Constraints, FailureReason, FollowOptions, Followed, Problem, Seed, SolveFailure};
use crate::num::branch::Excess;
use crate::pack::{PackError, Untabled};
use crate::scene::{ElementOrder, ResolvedScene};
use crate::spec::Sampling;

/// Number of contacts whose problem is kept.
const PROBLEMS: usize = 256;
/// The factor of a fingertip serves for contacts within this distance of where it was made, in radii.
const NEIGHBOUR_RADII: f64 = 1.5;
/// Sweeps of the sensitivities, which cost less than a new factor.
const MAX_SWEEPS: u32 = 8;
/// Jets that wait for the loop during a change of the model, usually.
const OUTBOX: usize = 16;
/// Solves after a change of the model for which its jets may wait: a hand that moves fast is never known.
const MAX_HELD: u32 = 12;
/// Times that a continuation that fails is tried over half of the way.
const HALVINGS: u32 = 2;
/// Weight of the last solve in the mean time of a solve.
const NEWEST_SHARE: f64 = 0.2;
/// How far a tool is expected to press in a scene without a grid, m.
const REACH_M: f64 = 0.05;
/// Mean time of a solve before the first one, s.
const FIRST_SOLVE_S: f64 = 5e-3;

/// The solver of one live session.
#[derive(Debug)]
pub struct LiveSolver {
    body: Arc<Body>,
    skin: Skin,
    free: Problem,
    problems: Vec<(u16, Arc<Problem>)>,
    workers: Workers,
    states: States,
    known: Vec<Known>,
    growth: Growth,
    lost: LostPositions,
    solve_s: [f64; 2],
    /// Whether the last solve made a factor.
    has_renewed: bool,
    totals: Totals,
    near: Vec<(f64, u16)>,
    /// Jets that were not taken yet.
    outbox: VecDeque<Published>,
    /// Number of the model, and the rest state of the first one.
    model: u32,
    first_rest: Vec<f64>,
    /// Whether the jets of a new model wait until the present touch is known, and the solves since the change.
    holds_back: bool,
    held_solves: u32,
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
        let free = Problem::with(body.clone(), None, Constraints::Elimination);
        let workers = Workers::new(&Arc::new(free.at(skin.touch(0, &body))));
        let blank = Seed::at_rest(&body);
        let first_rest = body.rest_state.clone();
        Ok(Self {
            states: States::like(&blank),
            known: vec![Known::default(); skin.contacts.len()],
            near: Vec::with_capacity(skin.contacts.len()),
            body,
            skin,
            free,
            problems: Vec::with_capacity(PROBLEMS),
            workers,
            growth: Growth::default(),
            lost: LostPositions::default(),
            solve_s: [FIRST_SOLVE_S; 2],
            has_renewed: false,
            totals: Totals::default(),
            outbox: VecDeque::with_capacity(OUTBOX),
            model: 0,
            first_rest,
            holds_back: false,
            held_solves: 0,
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
        let organ = Untabled {
            scene: &scene.name,
            law: &self.body.law_names(),
            max_force_n: scene.max_force_n,
            mesh: &scene.mesh,
            rest_m: self.body.rest_state.as_chunks::<3>().0,
            fixed: &scene.fixed,
            tool: &scene.tool,
            places: &self.skin.contacts,
            triangles: &self.skin.triangles,
            reach_m: scene.grid.as_ref().map_or(REACH_M, Sampling::radius_m),
        };
        organ.pack()
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
        let same_tool = self.skin.tip() == scene.tool.fingertip();
        if !same_tool || body.nodes_m != self.body.nodes_m || body.state_len() != self.body.state_len() {
            return Err(LiveError::OtherBody);
        }
        // From here on nothing fails.
        let mut skin = self.skin.clone();
        skin.free_only(&body);
        let first = skin.first_free().ok_or(LiveError::NothingToTouch)?;
        self.skin = skin;
        self.free = Problem::with(body.clone(), None, Constraints::Elimination);
        self.states.become_those_of(&self.body, &body);
        self.body = body;
        self.problems.clear();
        self.workers = Workers::new(&Arc::new(self.free.at(self.skin.touch(first, &self.body))));
        self.known.fill(Known::default());
        (self.growth, self.lost) = (Growth::default(), LostPositions::default());
        self.outbox.clear();
        self.model += 1;
        (self.holds_back, self.held_solves) = (true, 0);
        Ok(())
    }

    /// Work since the start.
    pub fn totals(&self) -> Totals {
        self.totals
    }

    /// All jets of a contact, as if they were found anew.
    pub fn jets(&self, contact: u16) -> impl Iterator<Item = Published> {
        let known = self.known.get(usize::from(contact)).filter(|_| !self.holds_back);
        let jets = known.map_or(&[][..], Known::jets);
        let model = self.model;
        jets.iter().map(move |&trust| Published {
            contact,
            trust,
            joins: true,
            is_fresh: false,
            is_unstable: false,
            model,
        })
    }

    /// States how long the last step took, s.
    pub fn took(&mut self, seconds: f64) {
        let mean_s = &mut self.solve_s[usize::from(self.has_renewed)];
        *mean_s += NEWEST_SHARE * (seconds - *mean_s);
    }

    /// Solves at one position, if there is one that is worth it.
    pub fn step(&mut self, hand: &Hand) -> Step {
        self.lost.grow_old();
        let Self { skin, known, growth, lost, workers, solve_s, near, .. } = self;
        let choice = Choice { skin, known, growth, lost, workers, solve_s: *solve_s };
        let step = match choice.next(hand, near) {
            Some(task) => self.solve(task),
            None => Step::Idle,
        };
        self.held_solves += u32::from(step != Step::Idle);
        self.holds_back &= self.held_solves < MAX_HELD
            && step != Step::Idle
            && hand.touch.as_ref().is_some_and(|touch| !self.knows(touch));
        step
    }

    /// The next jet for the loop. After a change of the model there is none until the present touch is known.
    pub fn published(&mut self) -> Option<Published> {
        if self.holds_back { None } else { self.outbox.pop_front() }
    }

    /// Whether every contact of a touch is known there, or cannot be.
    fn knows(&self, touch: &Touch) -> bool {
        touch.contacts.iter().filter(|(_, weight)| *weight > 0.0).all(|&(contact, weight)| {
            let known = self.known.get(usize::from(contact));
            !self.skin.is_free(contact)
                || self.lost.contains(contact, touch.control_m, false)
                || self.lost.contains(contact, [0.0; 3], false)
                || known.is_none_or(|known| self.growth.knows(known, touch.control_m, weight, Limit::Unknown))
        })
    }

    fn solve(&mut self, task: Task) -> Step {
        let is_first = self.known[usize::from(task.contact)].is_empty();
        let moves = self.go_to(task.contact);
        let from = self.start(&task, is_first);
        let factorisations = self.totals.factorisations;
        let mut to = self.states.room();
        let found = self.reach(&from.seed, &task, task.renews || moves, &mut to);
        // A failure says nothing about the time of a solve with the factor at hand.
        self.has_renewed = found.is_err() || self.totals.factorisations > factorisations;
        let step = match found {
            Ok((found, landed)) => {
                let published = self.enter(&task, &from, &to, &found, landed, is_first);
                self.outbox.push_back(published);
                self.states.keep(task.contact, Start { seed: to, is_guess: false });
                Step::Solved
            }
            Err(_) => {
                self.states.give_back(to);
                self.lost.add(&task);
                self.totals.lost += 1;
                Step::Lost { contact: task.contact, control_m: task.control_m }
            }
        };
        // A guess that led nowhere would be tried again.
        if is_first || from.is_guess && matches!(step, Step::Lost { .. }) {
            self.states.give_back(from.seed);
        } else {
            self.states.keep(task.contact, from);
        }
        step
    }

    /// The state to start from: the nearest of the contact, or the body at rest.
    fn start(&mut self, task: &Task, is_first: bool) -> Start {
        if !is_first && let Some(start) = self.states.take_nearest(task.contact, task.control_m) {
            return start;
        }
        let mut rest = self.states.room();
        rest.become_rest(&self.body);
        if !is_first {
            // Its state was given up: solved again, which also finds its sensitivities.
            let mut to = self.states.room();
            let worker = self.workers.present();
            let found = worker.solver.follow(&rest, [0.0; 3], true, &FollowOptions::default(), &mut to);
            worker.factor = found.is_ok().then_some((task.contact, [0.0; 3]));
            if found.is_ok() {
                std::mem::swap(&mut rest, &mut to);
            }
            self.states.give_back(to);
        }
        Start { seed: rest, is_guess: false }
    }

    /// Moves the solver to a contact; whether its factor no longer serves.
    fn go_to(&mut self, contact: u16) -> bool {
        let problem = self.problem(contact);
        self.workers.go_to(contact, problem);
        let Some((of, _)) = self.workers.present().factor else { return true };
        let radius_m = self.skin.tip().map_or(0.0, |tip| tip.radius_m);
        self.skin.distance_m(of, contact) > NEIGHBOUR_RADII * radius_m
    }

    /// The problem of a contact.
    pub(super) fn problem_of(&self, contact: u16) -> Arc<Problem> {
        Arc::new(self.free.at(self.skin.touch(contact, &self.body)))
    }

    /// The body at rest.
    pub(super) fn rest_state(&self) -> Seed {
        Seed::at_rest(&self.body)
    }

    fn problem(&mut self, contact: u16) -> Arc<Problem> {
        if let Some(at) = self.problems.iter().position(|(of, _)| *of == contact) {
            return self.problems[at].1.clone();
        }
        let problem = self.problem_of(contact);
        if self.problems.len() == PROBLEMS {
            self.problems.remove(0);
        }
        self.problems.push((contact, problem.clone()));
        problem
    }

    /// Continues to the task's position, over half of the way if that fails, and else lands by a descent. The
    /// second value is whether it landed.
    fn reach(
        &mut self,
        from: &Seed,
        task: &Task,
        renews: bool,
        to: &mut Seed,
    ) -> Result<(Followed, bool), SolveFailure> {
        let options = FollowOptions { max_sweeps: MAX_SWEEPS, ..FollowOptions::default() };
        let mut control_m = task.control_m;
        let start_m = from.jet.control_m;
        for halvings in 0..=HALVINGS {
            let worker = self.workers.present();
            if let Ok(found) = worker.solver.follow(from, control_m, renews || halvings > 0, &options, to) {
                self.count(task.contact, control_m, &found);
                if found.unstable_modes.is_some_and(|modes| modes > 0) && !task.is_ahead {
                    return self.leave(task.contact, control_m, found, to);
                }
                return Ok((found, false));
            }
            // What the attempt factorised is unknown.
            worker.factor = None;
            control_m = std::array::from_fn(|axis| 0.5 * (start_m[axis] + control_m[axis]));
        }
        if task.is_ahead {
            let reason = FailureReason::LineSearch;
            return Err(SolveFailure { reason, iterations: 0, residual_n: f64::NAN });
        }
        let found = self.workers.present().solver.relax(from, task.control_m, false, to)?;
        self.count(task.contact, task.control_m, &found);
        self.totals.landings += 1;
        Ok((found, true))
    }

    /// Where the body goes from an equilibrium that is not stable; that itself if it goes nowhere.
    fn leave(
        &mut self,
        contact: u16,
        control_m: [f64; 3],
        unstable: Followed,
        to: &mut Seed,
    ) -> Result<(Followed, bool), SolveFailure> {
        let mut landed = self.states.room();
        let found = self.workers.present().solver.relax(to, control_m, true, &mut landed);
        if found.is_ok() {
            std::mem::swap(to, &mut landed);
        }
        self.states.give_back(landed);
        let Ok(found) = found else { return Ok((unstable, false)) };
        self.count(contact, control_m, &found);
        self.totals.landings += 1;
        Ok((found, true))
    }

    fn count(&mut self, contact: u16, control_m: [f64; 3], found: &Followed) {
        self.totals.factorisations += u64::from(found.count.factorisations);
        if found.count.factorisations > 0 {
            self.workers.present().factor = Some((contact, control_m));
        }
    }

    /// Enters what was found in the memory.
    fn enter(
        &mut self,
        task: &Task,
        from: &Start,
        to: &Seed,
        found: &Followed,
        landed: bool,
        is_first: bool,
    ) -> Published {
        let known = &mut self.known[usize::from(task.contact)];
        let before = &from.seed.jet;
        let starts = is_first || from.is_guess || to.jet.control_m == before.control_m;
        let joins = starts || !landed && !Excess::with_thirds(before, &to.jet).is_jump();
        if joins && !is_first {
            self.growth.measure(known, &to.jet);
        }
        let trust = known.trust(to.jet);
        known.add(trust, !joins);
        let rest_n_m = known.rest_n_m();
        if !joins {
            self.states.flush(task.contact, &trust, rest_n_m);
        }
        self.totals.jets += 1;
        Published {
            contact: task.contact,
            trust,
            joins,
            is_fresh: found.unstable_modes.is_some(),
            is_unstable: found.unstable_modes.is_some_and(|modes| modes > 0),
            model: self.model,
        }
    }

    /// Displacement of nodes from the rest of the first model, in the state nearest to the hand, blended over the
    /// contacts of the touch, m. That of the body at rest without a touch, and for contacts without a kept state.
    pub fn displacements_into(&self, hand: &Hand, nodes: &[u32], out: &mut [[f32; 3]]) {
        for (&node, out) in nodes.iter().zip(out.iter_mut()) {
            let at = |axis: usize| 3 * node as usize + axis;
            *out = std::array::from_fn(|axis| {
                (self.body.rest_state[at(axis)] - self.first_rest[at(axis)]) as f32
            });
        }
        let Some(touch) = &hand.touch else { return };
        for &(contact, weight) in touch.contacts.iter().filter(|(_, weight)| *weight > 0.0) {
            let Some(seed) = self.states.nearest(contact, touch.control_m) else { continue };
            let d: [f64; 3] = std::array::from_fn(|axis| touch.control_m[axis] - seed.jet.control_m[axis]);
            for (&node, out) in nodes.iter().zip(out.iter_mut()) {
                for (axis, value) in out.iter_mut().enumerate() {
                    let at = 3 * node as usize + axis;
                    let slope: f64 = (0..3).map(|k| d[k] * seed.sensitivity[k][at]).sum();
                    *value += (weight * (seed.state[at] - self.body.rest_state[at] + slope)) as f32;
                }
            }
        }
    }
}
