//! The own answers: those of every interpolation method, and of the live solver in simulated time.

use nalgebra::Vector3;
use palpate_core::{Method, Organ};

use super::answers::Forces;
use super::organs::Ready;
use super::questions::{Questions, Way};
use crate::cmd::bench::live::simulation::felt_forces;
use crate::failure::Failure;

/// Name of the column of the live solver.
pub(super) const LIVE: &str = "live";

/// Forces of a method of a blob whose first space is that of the touched place.
pub(super) fn of_method(organ: &Organ<'_>, method: Method, questions: &Questions) -> Forces {
    Forces::of_field(questions, |d| {
        let found = organ.spaces.first()?.force(method, d.map(|x| x as f32))?;
        Some(found.force_n.map(f64::from))
    })
}

/// Forces of every method that the blob has, with their names. A method that it lacks has no answer, so that all
/// organs have the same columns.
pub(super) fn of_methods(ready: &Ready) -> Result<Vec<(String, Forces)>, Failure> {
    let organ = ready.organ()?;
    let of = |method: Method| (method.name().to_owned(), of_method(&organ, method, &ready.questions));
    Ok(Method::ALL.into_iter().map(of).collect())
}

/// Forces of the live solver along ways, in simulated time: a tick is a millisecond, and a solve takes as long as
/// it takes on this CPU.
pub(super) fn live_along(
    ready: &Ready,
    ways: &[Way],
    mut done: impl FnMut(usize) -> Result<(), Failure>,
) -> Result<Vec<Vec<Option<[f64; 3]>>>, Failure> {
    let mut forces = Vec::new();
    for (number, way) in ways.iter().enumerate() {
        done(number)?;
        // Each way begins with a solver that has seen nothing.
        let (mut solver, contact) = ready.live()?;
        let control_m: Vec<Vector3<f64>> = way.displacement_m.iter().map(|d| Vector3::from(*d)).collect();
        let felt = felt_forces(&mut solver, contact, &control_m, 1.0);
        forces.push(felt.into_iter().map(|force| Some(force.into())).collect());
    }
    Ok(forces)
}
