//! Spaces and held-out solutions of the cases, in files that a second run continues.

use std::path::{Path, PathBuf};

use palpate_precompute::held_out::Draw;
use palpate_precompute::pipeline::Run;
use palpate_precompute::space::Store;

use super::plan::{Case, Plan};
use crate::failure::Failure;
use crate::progress::WorkProgress;
use crate::steps::Steps;

/// Solves the space of a case and its held-out solutions. Paths start from rest on every grid. The paths that
/// `sibling`, a space of the same body, contains are copied, so that every grid is queried at the same
/// positions.
pub(super) fn solved(
    plan: &Plan,
    case: &Case,
    draw: &Draw,
    sibling: Option<&Path>,
    steps: &mut Steps,
) -> Result<PathBuf, Failure> {
    let space = plan.work.file(&format!("{}.space", case.name));
    steps.next(&format!("{}: configuration space", case.name))?;
    let store = case.bench.store(space.path())?;
    let mut progress = WorkProgress::new(&case.name, "solves");
    let expanded = case.bench.solve(&[0], &store, plan.run(steps), |state| progress.spaces(state));
    progress.finish();
    expanded?;
    steps.next(&format!("{}: held-out truth", case.name))?;
    if let Some(sibling) = sibling {
        store.copy_paths(&Store::open(sibling)?, 0, (&draw.identity(), draw.regular_m))?;
    }
    let held_out = case.bench.held_out(&[0], draw.clone())?;
    let mut progress = WorkProgress::new(&case.name, "paths and positions");
    let solved =
        case.bench.solve_held_out(&held_out, &store, plan.run(steps), |state| progress.held_out(state));
    progress.finish();
    solved?;
    Ok(space.path().to_path_buf())
}

impl Plan {
    pub(super) fn run<'s>(&self, steps: &'s Steps) -> Run<'s> {
        Run { threads: self.threads, stop: &steps.stop }
    }
}
