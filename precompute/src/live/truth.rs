//! The force of full solutions along the path of a hand, to compare the felt force with.
//!
//! A body with more than one equilibrium at a position has the one that its history leads to. The truth therefore
//! follows the same path from the same rest, in short steps and to full accuracy. A step that fails, jumps or ends in
//! an unstable state is halved until the fold is enclosed; behind it the body lands from the last stable state. The steps of a
//! large body make no factor, so its stability is determined at a sample of the places.

use std::sync::Arc;

use super::beyond::parted_m;
use super::branches::joins;
use super::hand::Touch;
use super::solver::LiveSolver;
use crate::fem::{DESCENT_STEPS, FollowOptions, Problem, Second, Seed, SolveFailure, Solver};
use crate::num::vector::{cross, difference, distance};
use crate::spec::Tolerance;

/// Longest step of a path, m.
const STEP_M: f64 = 2e-3;
/// Steps of a partner are halved down to this, m.
const LEAST_STEP_M: f64 = 2e-4;
/// A new factor is made if the last one is farther than this, m.
const FACTOR_REACH_M: f64 = 4e-3;
/// Width to which a fold is enclosed, m.
const FOLD_M: f64 = 1e-4;
/// The residual of the state, as a share of the force scale; the sensitivities serve the next guess and the test of a
/// jump.
const OPTIONS: FollowOptions = FollowOptions {
    residual: 1e-7,
    max_frozen_steps: 8,
    max_steps: 30,
    sensitivity: 1e-2,
    max_sweeps: 6,
    worst_sensitivity: 0.3,
    renews: true,
    gives_up: false,
};

/// The true force along a path.
#[derive(Debug)]
pub struct Truth<'l> {
    live: &'l LiveSolver,
    solver: Option<Solver>,
    /// Of each contact of the present touch.
    paths: Vec<Path>,
    landings: u32,
    /// The half axis of a capsule, or the displacement of the partner if it touches the body.
    second_m: Option<[f64; 3]>,
}

#[derive(Debug)]
struct Path {
    contact: u16,
    problem: Arc<Problem>,
    seed: Seed,
    /// Places of the path.
    places: u64,
}

impl<'l> Truth<'l> {
    /// Of the body of a live session.
    pub fn new(live: &'l LiveSolver) -> Self {
        Self { live, solver: None, paths: Vec::new(), landings: 0, second_m: None }
    }

    /// Number of times that the body landed with a jump that is felt.
    pub fn landings(&self) -> u32 {
        self.landings
    }

    /// The tool has left the body: the next touch begins at rest.
    pub fn release(&mut self) {
        self.paths.clear();
    }

    /// From now on a capsule has this half axis, m; or a partner of a sphere at this place touches the body too, m, or none
    /// does.
    pub fn face(&mut self, second_m: Option<[f64; 3]>) {
        let sphere = self.live.skin().sphere().zip(second_m);
        self.second_m = sphere.map(|(sphere, at_m)| match self.live.skin().second() {
            Second::Partner => difference(at_m, sphere.start_m),
            Second::Axis => at_m,
        });
    }

    /// h at the next place of the path, N.
    ///
    /// # Errors
    ///
    /// The failure of a solve that neither continues nor lands.
    pub fn force_n(&mut self, touch: &Touch) -> Result<[f64; 3], SolveFailure> {
        let mut sum = [0.0; 3];
        self.paths
            .retain(|path| touch.contacts.iter().any(|(c, weight)| *c == path.contact && *weight > 0.0));
        for &(contact, weight) in touch.contacts.iter().filter(|(_, weight)| *weight > 0.0) {
            let force_n = self.one(contact, touch.control_m)?;
            sum = std::array::from_fn(|axis| sum[axis] + weight * force_n[axis]);
        }
        Ok(sum)
    }

    /// The moment of the last force about the centre of a capsule, N m; zero of other tools.
    pub fn moment_n_m(&self) -> [f64; 3] {
        let of = |path: &Path| path.seed.coupling.filter(|coupling| coupling.of == Second::Axis);
        let turned = self.paths.last().and_then(of);
        turned.map_or([0.0; 3], |turned| cross(turned.second_m, turned.force_n))
    }

    fn one(&mut self, contact: u16, control_m: [f64; 3]) -> Result<[f64; 3], SolveFailure> {
        let of = self.live.skin().second();
        let half_m = self.second_m.filter(|_| of == Second::Axis).unwrap_or_default();
        let sphere = self.live.skin().sphere().map(|sphere| sphere.turned(half_m));
        let at = match self.paths.iter().position(|path| path.contact == contact) {
            Some(at) => at,
            None => {
                let seed = self.live.untouched_at(sphere.as_ref(), control_m);
                let problem = self.live.problem_of(contact);
                self.paths.push(Path { contact, problem, seed, places: 0 });
                self.paths.len() - 1
            }
        };
        let Path { problem, seed, places, .. } = &mut self.paths[at];
        let solver = self.solver.get_or_insert_with(|| Solver::new(problem.clone()));
        if !Arc::ptr_eq(solver.problem(), problem) {
            solver.touch(problem.clone());
        }
        let mut to = seed.clone();
        if let Some(sphere) = &sphere {
            let beside = |at_m| sphere.beside_m(self.live.body(), at_m);
            face(solver, seed, (of, self.second_m), &mut to, beside)?;
        }
        solver.set_second(of, self.second_m);
        // The factor may be that of another contact.
        let mut factor_at_m: Option<[f64; 3]> = None;
        // Where the branch was not found, if it ends on the way.
        let mut beyond_m: Option<[f64; 3]> = None;
        while seed.pose.displacement_m != control_m || factor_at_m.is_none() {
            let from_m = seed.pose.displacement_m;
            let towards = |to_m: [f64; 3], share: f64| -> [f64; 3] {
                std::array::from_fn(|k| from_m[k] + share * (to_m[k] - from_m[k]))
            };
            let way_m = distance(from_m, control_m);
            let there_m = match beyond_m {
                Some(beyond_m) => towards(beyond_m, 0.5),
                None if way_m > STEP_M => towards(control_m, STEP_M / way_m),
                None => control_m,
            };
            let renews = factor_at_m.is_none_or(|at_m| distance(at_m, there_m) > FACTOR_REACH_M);
            let found = solver.follow(seed, there_m, renews || beyond_m.is_some(), &OPTIONS, &mut to);
            let goes_on = found.as_ref().is_ok_and(|found| {
                found.unstable_modes.is_none_or(|modes| modes == 0)
                    && (there_m == from_m || joins(&seed.jet, &to.jet, self.live.skin().sphere().is_some()))
            });
            if goes_on {
                if renews || found.is_ok_and(|found| found.count.factorisations > 0) {
                    factor_at_m = Some(there_m);
                }
                std::mem::swap(seed, &mut to);
            } else {
                beyond_m = Some(there_m);
            }
            let Some(end_m) = beyond_m.filter(|end_m| distance(seed.pose.displacement_m, *end_m) < FOLD_M)
            else {
                continue;
            };
            self.landings += u32::from(lands(solver, seed, end_m, &mut to)?);
            (factor_at_m, beyond_m) = (Some(end_m), None);
        }
        // The steps of a large body do not tell whether it is stable.
        *places += 1;
        let checks = problem.is_large() && places.is_multiple_of(problem.solves_a_check());
        if checks && solver.unstable_modes_at(seed).is_some_and(|modes| modes > 0) {
            self.landings += u32::from(lands(solver, seed, control_m, &mut to)?);
        }
        Ok(seed.jet.force_n)
    }
}

/// Brings the body to rest at a control; whether the jump is felt.
fn lands(
    solver: &mut Solver,
    seed: &mut Seed,
    control_m: [f64; 3],
    to: &mut Seed,
) -> Result<bool, SolveFailure> {
    solver.relax(seed, control_m, DESCENT_STEPS, to)?;
    let limit_n = Tolerance::IMPERCEPTIBLE.at(seed.jet.force_n);
    let is_felt = distance(seed.jet.force_n, to.jet.force_n) >= limit_n;
    std::mem::swap(seed, to);
    Ok(is_felt)
}

/// Moves the second control to its next value while the first one stays. A partner comes and goes on the shortest way, which
/// `beside` ends.
fn face(
    solver: &mut Solver,
    seed: &mut Seed,
    (of, second_m): (Second, Option<[f64; 3]>),
    to: &mut Seed,
    beside: impl Fn([f64; 3]) -> [f64; 3],
) -> Result<(), SolveFailure> {
    let before_m = seed.coupling.map(|of| of.second_m);
    // A capsule that touches nothing yet is turned by that.
    if parted_m(before_m, second_m) == 0.0 || of == Second::Axis && before_m.is_none() {
        return Ok(());
    }
    let ends = before_m.or(second_m.map(&beside)).zip(second_m.or(before_m.map(&beside)));
    if let Some((from_m, to_m)) = ends {
        let way_m = distance(from_m, to_m);
        let (mut done_m, mut step_m, mut is_there) = (0.0, STEP_M, false);
        while !is_there {
            let next_m = f64::min(done_m + step_m, way_m);
            let share = next_m / way_m.max(f64::MIN_POSITIVE);
            let at_m = std::array::from_fn(|k| from_m[k] + share * (to_m[k] - from_m[k]));
            solver.set_second(of, Some(at_m));
            match solver.follow(seed, seed.pose.displacement_m, true, &OPTIONS, to) {
                Ok(_) => {
                    std::mem::swap(seed, to);
                    (done_m, is_there) = (next_m, next_m == way_m);
                }
                // The guess does not follow the partner, so the steps are short where it presses hard.
                Err(_) if step_m > LEAST_STEP_M => step_m *= 0.5,
                Err(failure) => return Err(failure),
            }
        }
    }
    if second_m.is_none() {
        solver.set_second(of, None);
        solver.follow(seed, seed.pose.displacement_m, true, &OPTIONS, to)?;
        std::mem::swap(seed, to);
    }
    Ok(())
}
