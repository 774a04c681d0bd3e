//! Storage forms of the first body's fitted energy: bytes, time and error.

use palpate_precompute::held_out::Draw;
use palpate_precompute::space::Store;

use super::plan::{Family, Plan};
use super::solve::solved;
use super::steps::Steps;
use crate::cmd::bench::forms::{FormRow, measure};
use crate::failure::Failure;

/// Number of interleaved batches of queries.
const ROUNDS: usize = 100;

/// Number of steps of [`measured`].
pub(super) const STEPS: usize = 3;

/// Samples the body to the just-noticeable difference, and measures every form; empty if there is only rest
/// to fit.
pub(super) fn measured(plan: &Plan, family: &Family, steps: &mut Steps) -> Result<Vec<FormRow>, Failure> {
    let case = family.sampled_within_tolerance()?;
    let draw = Draw { regular_m: None, random: 0, ..plan.draw(family.radius_m()) };
    let path = solved(plan, &case, &draw, None, steps)?;
    steps.next(&format!("{}: forms of the fitted energy", case.name))?;
    measure(&Store::open(&path)?, None, ROUNDS)
}
