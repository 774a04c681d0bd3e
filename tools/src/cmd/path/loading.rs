//! The way of a tool: at an active node or contact point, or as a sphere or capsule.

use std::path::Path;

use palpate_precompute::fem::{
    CoatedSphere, Configuration, Constraints, Pose, Pressed, Problem, SolveFailure, Solver, SphereSolver,
};
use palpate_precompute::pipeline::Analysis;
use std::sync::Arc;

use crate::failure::Failure;

/// A solver and the last equilibrium.
pub(super) enum Loading {
    /// The pose is the displacement of the tool from rest, or the place of the centre of a sphere with its layer.
    Held(Box<Solver>, Box<Configuration>),
    /// The pose is the place of the centre.
    Sphere(Box<SphereSolver>, Box<Pressed>),
    /// The same of a capsule with its layer, and how its half axis in the frame of the grip, m, is turned.
    Capsule(Box<Solver>, Box<Configuration>, [f64; 3]),
}

impl Loading {
    /// At rest. A sphere is where its way begins, or beside the body if it would overlap there.
    pub(super) fn begin(
        analysis: &Analysis,
        active: Option<&str>,
        scene: &Path,
        first_m: [f64; 3],
        with_layer: bool,
    ) -> Result<Self, Failure> {
        let no_rest = |failure: SolveFailure| {
            Failure::input(format!("{}: the body cannot be solved at rest: {failure}", scene.display()))
        };
        let Some(sphere) = analysis.scene.tool.sphere() else {
            let (_, active) = analysis.active(active)?;
            let mut solver = Solver::new(analysis.problem(active));
            let rest = solver.rest().map_err(no_rest)?;
            return Ok(Self::Held(Box::new(solver), Box::new(rest)));
        };
        let problem = Arc::new(Problem::with(analysis.body.clone(), None, Constraints::Elimination));
        let mut solver = SphereSolver::new(problem.clone(), sphere.radius_m);
        if solver.is_inside(first_m) {
            return Err(Failure::input(format!(
                "--controls: the sphere begins at {first_m:?}, inside the body; begin outside (centres in metres)"
            )));
        }
        let half_axis_m = analysis.scene.tool.half_axis_m();
        if with_layer || half_axis_m.is_some() {
            let coated = CoatedSphere::new(&analysis.body, sphere.radius_m, sphere.layer, [0.0; 3]);
            let mut solver = Solver::new(Arc::new(problem.at(coated)));
            solver.set_half_axis(half_axis_m);
            let first = Pose::translation(first_m);
            let rest = solver.solve_at(&first, &analysis.body.rest_state).map_err(no_rest)?;
            return Ok(match half_axis_m {
                Some(half_axis_m) => Self::Capsule(Box::new(solver), Box::new(rest), half_axis_m),
                None => Self::Held(Box::new(solver), Box::new(rest)),
            });
        }
        let rest = solver.rest(first_m).map_err(no_rest)?;
        Ok(Self::Sphere(Box::new(solver), Box::new(rest)))
    }

    /// The last equilibrium.
    pub(super) fn here(&self) -> &Configuration {
        match self {
            Self::Held(_, here) | Self::Capsule(_, here, _) => here,
            Self::Sphere(_, here) => &here.configuration,
        }
    }

    /// Goes on to a pose.
    pub(super) fn advance(&mut self, pose: &Pose) -> Result<(), SolveFailure> {
        match self {
            Self::Held(solver, here) => **here = solver.advance_to(&here.seed, pose)?,
            Self::Sphere(solver, here) => **here = solver.advance(here, pose.displacement_m)?,
            Self::Capsule(solver, here, half_axis_m) => {
                solver.set_half_axis(Some(pose.turned(*half_axis_m)));
                **here = solver.advance_to(&here.seed, &Pose::translation(pose.displacement_m))?;
            }
        }
        Ok(())
    }
}
