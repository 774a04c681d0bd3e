//! Equilibrium of a body under a frictionless rigid sphere.
//!
//! W(c) = min over u of E(u) with g_k(u, c) >= 0 for every feature k of the deformed skin ([`crate::fem::sphere`]).
//! With the Lagrangian L = E - sum l_k g_k and the contact forces l_k >= 0, l_k g_k = 0, a Newton step solves
//!
//! H du = -E_u + N l,    s = g + N^T du >= 0,   l >= 0,   s . l = 0,      H = E_uu - sum l_k g_uu,   N = g_u
//!
//! by du = du_0 + Y (l - l_old) with du_0 = -H^-1 (E_u - N l_old), Y = H^-1 N: a small complementarity problem with the
//! matrix D = N^T Y. The features are found again at every state. At the solution, over the features with a force,
//!
//! f = dW/dc = sum l_k n_k                                     the force of the sphere on the body
//! B = -sum l_k g_uc,   G = g_c = -n^T,   D dl = N^T H^-1 B - G,   U = du/dc = Y dl - H^-1 B
//! S = -sum l_k g_cc + B^T U - G^T dl
//! W_ijk = E3[U_i, U_j, U_k] - sum l D3g[i, j, k] - sum (dl_i D2g[j, k] + dl_j D2g[i, k] + dl_k D2g[i, j])
//!
//! with D2g and D3g along the total changes (U_i, e_i). W is smooth only while the features with a force stay the
//! same: where they change, f is continuous and S jumps.

mod derivatives;
mod linearised;

use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};

use super::follow::FollowCount;
use super::relax::DESCENT_STEPS;
use super::{Configuration, FailureReason, Problem, Seed, SolveFailure, Solver};
use crate::fem::body::Body;
use crate::fem::boundary::Pose;
use crate::fem::sphere::{CoatedSphere, Feature, Gap, Layer, Skin};

/// A state is an equilibrium if the residual is below this share of the contact force.
const TOLERANCE: f64 = 1e-9;
/// Largest number of iterations of an attempt.
const MAX_ITERATIONS: u32 = 25;
/// Largest number of halvings of the way of the centre.
const MAX_DIVISIONS: u32 = 8;
/// Largest number of moves that free a sphere from the features that it overlaps at rest.
const MAX_MOVES: u32 = 50;

/// Shares of the thickness of the layers of a snap.
const LAYERS: [f64; 4] = [1.0, 0.25, 0.06, 0.015];

/// A feature, its contact force, N, and its foot relative to the centre, m.
#[derive(Debug, Clone, Copy)]
struct Force {
    feature: Feature,
    force_n: f64,
    foot_m: Vector3<f64>,
}

/// A body in equilibrium under the sphere. The pose of the configuration is the place of the centre.
#[derive(Debug, Clone)]
pub struct Pressed {
    /// The equilibrium; its jet is that of W(c).
    pub configuration: Configuration,
    forces: Vec<Force>,
}

impl Pressed {
    /// Number of features with a force.
    pub fn contacts(&self) -> usize {
        self.forces.len()
    }
}

/// Solver of one body and one sphere.
#[derive(Debug)]
pub struct SphereSolver {
    solver: Solver,
    skin: Skin,
    radius_m: f64,
}

impl SphereSolver {
    /// For a problem without a contact.
    ///
    /// # Panics
    ///
    /// If the problem has a contact or multipliers.
    pub fn new(problem: Arc<Problem>, radius_m: f64) -> Self {
        assert!(
            problem.contact.is_none() && problem.dofs.multipliers.is_empty(),
            "the sphere is the contact"
        );
        let skin = Skin::of(&problem.body);
        Self { solver: Solver::new(problem), skin, radius_m }
    }

    /// The body.
    pub fn body(&self) -> &Body {
        &self.solver.problem.body
    }

    /// Whether a place is inside the body at rest.
    pub fn is_inside(&self, place_m: [f64; 3]) -> bool {
        let body = &self.solver.problem.body;
        let place = Vector3::from(place_m);
        body.element_nodes().any(|nodes| {
            let [a, b, c, d] = [0, 1, 2, 3].map(|k| Vector3::from(body.rest_position_m(nodes[k])));
            let edges = Matrix3::from_columns(&[b - a, c - a, d - a]);
            let weights = edges.try_inverse().map(|inverse| inverse * (place - a));
            weights.is_some_and(|weights| weights.min() > 0.0 && weights.sum() < 1.0)
        })
    }

    /// The body at rest, with the centre of the sphere at a place, or beside it where the sphere touches nothing.
    pub fn rest(&mut self, centre_m: [f64; 3]) -> Result<Pressed, SolveFailure> {
        let rest = Seed::at_rest(&self.solver.problem.body);
        self.solver.state.copy_from_slice(&rest.state);
        let mut centre = Vector3::from(centre_m);
        for _ in 0..MAX_MOVES {
            let gaps = self.gaps(centre);
            let Some(gap) = gaps.iter().min_by(|a, b| a.distance_m.total_cmp(&b.distance_m)) else { break };
            if self.value(gap) >= 0.0 {
                break;
            }
            centre += gap.normal * self.value(gap) * (1.0 + 1e-9);
        }
        self.attempt(&rest, Vec::new(), centre.into())
    }

    /// The equilibrium with the centre at a place, continued from another one. A way that fails is halved. Where it
    /// ends, at a snap from one set of features to another, the rest of the way is gone with the elastic layer, and
    /// the exact contact is solved from there.
    pub fn advance(&mut self, from: &Pressed, centre_m: [f64; 3]) -> Result<Pressed, SolveFailure> {
        let mut here = from.clone();
        let (mut done, mut step, mut divisions) = (0.0_f64, 1.0, 0);
        let start_m = from.configuration.seed.pose.displacement_m;
        let (mut iterations, mut factorisations, mut increments) = (0, 0, 0);
        let mut switched = false;
        while done < 1.0 {
            let share = (done + step).min(1.0);
            let to_m = if share >= 1.0 {
                centre_m
            } else {
                std::array::from_fn(|axis| start_m[axis] + share * (centre_m[axis] - start_m[axis]))
            };
            let found = self.attempt(&here.configuration.seed, here.forces.clone(), to_m);
            iterations += self.solver.iterations;
            factorisations += self.solver.factorisations;
            match found {
                Ok(found) => {
                    here = found;
                    (done, increments) = (share, increments + 1);
                    step *= 2.0;
                }
                Err(failure) if divisions == MAX_DIVISIONS => {
                    let landed = self.snap(&here.configuration.seed, centre_m);
                    here = landed.map_err(|_| SolveFailure { iterations, ..failure })?;
                    iterations += here.configuration.iterations;
                    factorisations += here.configuration.factorisations;
                    (done, increments, switched) = (1.0, increments + 1, true);
                }
                Err(_) => {
                    divisions += 1;
                    step *= 0.5;
                }
            }
        }
        let configuration = &mut here.configuration;
        (configuration.iterations, configuration.factorisations) = (iterations, factorisations);
        (configuration.increments, configuration.switched) = (increments, switched);
        Ok(here)
    }

    /// The equilibrium in which the body comes to rest beyond a snap: with the elastic layer, then with thinner ones,
    /// then without.
    fn snap(&mut self, from: &Seed, centre_m: [f64; 3]) -> Result<Pressed, SolveFailure> {
        let (mut here, mut next) = (from.clone(), from.clone());
        let mut count = FollowCount::default();
        for thinner in LAYERS {
            let Layer { thickness_m, pressure_pa } = Layer::of(self.radius_m);
            let layer = Layer { thickness_m: thickness_m * thinner, pressure_pa };
            let coated = CoatedSphere::new(&self.solver.problem.body, self.radius_m, layer, [0.0; 3]);
            let mut soft = Solver::new(Arc::new(self.solver.problem.at(coated)));
            let rested = soft.relax(&here, centre_m, DESCENT_STEPS, &mut next)?;
            count.steps += rested.count.steps;
            count.factorisations += rested.count.factorisations;
            std::mem::swap(&mut here, &mut next);
        }
        let mut landed = self.attempt(&here, Vec::new(), centre_m)?;
        landed.configuration.iterations += count.steps;
        landed.configuration.factorisations += count.factorisations;
        Ok(landed)
    }

    fn attempt(
        &mut self,
        from: &Seed,
        forces: Vec<Force>,
        centre_m: [f64; 3],
    ) -> Result<Pressed, SolveFailure> {
        let pose = Pose::translation(centre_m);
        let mut state = std::mem::take(&mut self.solver.state);
        super::incremental_loading::predict(from, &pose, &mut state);
        self.solver.problem.body.let_follow(&mut state);
        self.solver.state = state;
        (self.solver.iterations, self.solver.factorisations) = (0, 0);
        self.equilibrate(forces, Vector3::from(centre_m))
    }

    /// Newton steps until the residual and the gaps are below their tolerances.
    fn equilibrate(&mut self, mut forces: Vec<Force>, centre: Vector3<f64>) -> Result<Pressed, SolveFailure> {
        let mut sets: [Vec<Feature>; 2] = Default::default();
        loop {
            self.solver.evaluate(true);
            let mut gaps = self.gaps(centre);
            let is_free = self.keep_movable(&mut gaps);
            forces = carried(&forces, &gaps);
            let residual_n = self.subtract_forces(&gaps, &forces);
            let iterations = self.solver.iterations;
            let failed = |reason| SolveFailure { reason, iterations, residual_n };
            if !residual_n.is_finite() {
                return Err(failed(FailureReason::NotFinite));
            }
            if !is_free {
                return Err(failed(FailureReason::FixedPart));
            }
            let scale_n = self.solver.scale_n() + forces.iter().map(|force| force.force_n).sum::<f64>();
            if residual_n <= TOLERANCE * scale_n && self.are_closed(&gaps, &forces) {
                return self.condense(centre, &gaps, forces, residual_n);
            }
            if iterations == MAX_ITERATIONS {
                return Err(failed(FailureReason::MaxIterations));
            }
            self.solver.iterations += 1;
            let singular = |_| failed(FailureReason::SingularTangent);
            let contact = self.linearise(gaps, &forces).map_err(singular)?;
            let found = self.contact_forces(&contact, &forces);
            let found = found.ok_or(failed(FailureReason::SingularTangent))?;
            // A set that comes back after another one alternates between a face and an edge.
            let set: Vec<Feature> = contact
                .gaps
                .iter()
                .zip(&found)
                .filter(|(_, l)| **l > 0.0)
                .map(|(gap, _)| gap.feature)
                .collect();
            let alternates = iterations > 2 && set == sets[0] && set != sets[1];
            sets.swap(0, 1);
            sets[1] = set;
            if !self.step(if alternates { 0.5 } else { 1.0 }) {
                return Err(failed(FailureReason::NotFinite));
            }
            forces = with_forces(&contact.gaps, &found);
        }
    }
}

/// The forces on these gaps: that of a feature that has left goes to the gap with the nearest foot.
fn carried(forces: &[Force], gaps: &[Gap]) -> Vec<Force> {
    let mut found = with_forces(gaps, &vec![0.0; gaps.len()]);
    for old in forces.iter().filter(|force| force.force_n > 0.0) {
        let away = |new: &Force| (new.feature != old.feature, (new.foot_m - old.foot_m).norm());
        let nearest = found.iter_mut().min_by(|a, b| away(a).partial_cmp(&away(b)).expect("feet are finite"));
        if let Some(nearest) = nearest {
            nearest.force_n += old.force_n;
        }
    }
    found
}

fn with_forces(gaps: &[Gap], forces_n: &[f64]) -> Vec<Force> {
    let force = |(gap, &force_n): (&Gap, &f64)| Force { feature: gap.feature, force_n, foot_m: gap.foot() };
    gaps.iter().zip(forces_n).map(force).collect()
}
