//! The way of a tool: at an active node or contact point, or as a sphere or capsule.

use std::sync::Arc;

use super::{Analysis, PipelineError};
use crate::error::InputError;
use crate::fem::{
    Body, CoatedSphere, Configuration, Constraints, Pose, Pressed, Problem, SolveFailure, Solver,
    SphereSolver,
};

/// A solver and the last equilibrium of its way.
#[derive(Debug)]
pub enum Loading {
    /// The pose is the displacement of the tool from rest, or the place of the centre of a sphere with its layer.
    Held(Box<Solver>, Box<Configuration>),
    /// The pose is the place of the centre of a sphere in exact contact.
    Sphere(Box<SphereSolver>, Box<Pressed>),
    /// The same of a capsule with its layer, and its half axis in the frame of the grip, m.
    Capsule(Box<Solver>, Box<Configuration>, [f64; 3]),
}

/// An equilibrium of a [`Loading`], for another one of the same kind.
#[derive(Debug, Clone)]
pub enum Equilibrium {
    /// Of a held or elastic contact.
    Held(Box<Configuration>),
    /// Of a sphere in exact contact.
    Sphere(Box<Pressed>),
}

impl Equilibrium {
    /// The configuration.
    pub fn configuration(&self) -> &Configuration {
        match self {
            Self::Held(here) => here,
            Self::Sphere(here) => &here.configuration,
        }
    }
}

impl Loading {
    /// At rest. `active` names the active node, the first one if `None`; a sphere has none. A sphere is at `first_m`,
    /// where its way begins, or beside the body if it would overlap there. `with_layer` solves a sphere with its
    /// elastic layer; a capsule always has it.
    ///
    /// # Errors
    ///
    /// If the body cannot be solved at rest, there is no such active node, or the sphere begins inside the body.
    pub fn begin(
        analysis: &Analysis,
        active: Option<&str>,
        first_m: [f64; 3],
        with_layer: bool,
    ) -> Result<Self, PipelineError> {
        let no_rest = |failure: SolveFailure| {
            let what = format!("the body cannot be solved at rest ({failure})");
            InputError::new(
                &analysis.path,
                what,
                "check the constants and units of the material, and [fixed]",
            )
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
            let what = format!("the sphere begins at {first_m:?}, inside the body");
            return Err(InputError::new(&analysis.path, what, "begin outside (centres in metres)").into());
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
    pub fn here(&self) -> &Configuration {
        match self {
            Self::Held(_, here) | Self::Capsule(_, here, _) => here,
            Self::Sphere(_, here) => &here.configuration,
        }
    }

    /// The body as it is solved, which has quadratic elements near the tool only if the scene asks for that.
    pub(crate) fn body(&self) -> &Body {
        match self {
            Self::Held(solver, _) | Self::Capsule(solver, ..) => &solver.problem().body,
            Self::Sphere(solver, _) => solver.body(),
        }
    }

    /// Number of unstable modes of the last equilibrium; of a large body from a factor that is made for it.
    pub fn unstable_modes(&mut self) -> Option<u32> {
        match self {
            Self::Held(solver, here) if here.unstable_modes.is_none() && solver.problem().is_large() => {
                solver.unstable_modes_at(&here.seed)
            }
            _ => self.here().unstable_modes,
        }
    }

    /// A copy of the last equilibrium.
    pub fn equilibrium(&self) -> Equilibrium {
        match self {
            Self::Held(_, here) | Self::Capsule(_, here, _) => Equilibrium::Held(here.clone()),
            Self::Sphere(_, here) => Equilibrium::Sphere(here.clone()),
        }
    }

    /// Goes on to a pose.
    ///
    /// # Errors
    ///
    /// If no equilibrium is found; the last one stays.
    pub fn advance(&mut self, pose: &Pose) -> Result<(), SolveFailure> {
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

    /// Solves the pose of an equilibrium again, which may be one of the same body with other constants.
    ///
    /// # Errors
    ///
    /// If no equilibrium is found near it.
    ///
    /// # Panics
    ///
    /// If the equilibrium is of another kind of contact.
    pub fn again(&mut self, from: &Equilibrium) -> Result<(), SolveFailure> {
        match (self, from) {
            (Self::Held(solver, here) | Self::Capsule(solver, here, _), Equilibrium::Held(from)) => {
                **here = solver.solve_at(&from.seed.pose, &from.seed.state)?;
            }
            (Self::Sphere(solver, here), Equilibrium::Sphere(from)) => {
                **here = solver.advance(from, from.configuration.seed.pose.displacement_m)?;
            }
            _ => panic!("an equilibrium of another kind of contact"),
        }
        Ok(())
    }
}
