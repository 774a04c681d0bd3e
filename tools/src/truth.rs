//! New finite-element solutions at visited positions, and the errors of each method there.

use std::sync::atomic::AtomicBool;

use palpate_core::{Coverage, Method, Organ};
use palpate_precompute::certificate::{Compared, Errors};
use palpate_precompute::pipeline::{Analysis, PipelineError, Run};
use palpate_precompute::space::Store;
use serde::Serialize;

use crate::failure::Failure;

/// A position the tool visited.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Visit {
    /// Index of the active node and of its space.
    pub active: usize,
    /// Its displacement, m.
    pub displacement_m: [f32; 3],
    /// The reaction that the loop computed, N.
    pub reaction_n: [f32; 3],
}

/// A visit with the finite-element force there.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Checked {
    /// The visit.
    pub visit: Visit,
    /// Finite-element force h, N.
    pub force_n: [f64; 3],
}

/// Errors of one method over all checked visits (paper, Eqs. 13 and 14, and the error vector).
#[derive(Debug, Clone, Serialize)]
pub(crate) struct MethodError {
    /// Name of the method.
    pub method: String,
    /// Mean |error vector|, N.
    pub mean_n: f64,
    /// Largest |error vector|, N.
    pub max_n: f64,
    /// Eq. (13): mean absolute error per component, N.
    pub mean_component_n: f64,
    /// Eq. (14): mean relative error over components of at least 0.5 N.
    pub mean_relative: f64,
    /// Largest relative error over these components.
    pub max_relative: f64,
    /// Share of queries in a cell with complete data of the method.
    pub covered: f64,
}

/// Solves at every visit, on all cores. Visits without a solution are omitted and counted.
pub(crate) fn check(
    bench: &Analysis,
    store: &Store,
    visits: &[Visit],
    threads: usize,
    stop: &AtomicBool,
) -> Result<(Vec<Checked>, usize), Failure> {
    let positions: Vec<(usize, [f64; 3])> =
        visits.iter().map(|visit| (visit.active, visit.displacement_m.map(f64::from))).collect();
    let forces = bench.forces_at(store, &positions, Run { threads, stop }).map_err(|error| match error {
        PipelineError::Interrupted => Failure::work("interrupted while checking the rendered force"),
        error => error.into(),
    })?;
    let pairs = visits.iter().zip(forces);
    let checked: Vec<Checked> =
        pairs.filter_map(|(&visit, force_n)| Some(Checked { visit, force_n: force_n? })).collect();
    let unsolved = visits.len() - checked.len();
    Ok((checked, unsolved))
}

/// Errors of `method` at the checked visits.
pub(crate) fn method_error(organ: &Organ<'_>, method: Method, checked: &[Checked]) -> Option<MethodError> {
    let answers: Option<Vec<([f32; 3], bool)>> = checked
        .iter()
        .map(|c| {
            let found = organ.spaces.get(c.visit.active)?.force(method, c.visit.displacement_m)?;
            Some((found.force_n, found.coverage != Coverage::Extrapolated))
        })
        .collect();
    Some(errors(method.name(), checked, &answers?))
}

/// Errors of the forces that the loop computed during the session.
pub(crate) fn loop_error(checked: &[Checked]) -> MethodError {
    let answers: Vec<_> = checked.iter().map(|c| (c.visit.reaction_n, true)).collect();
    errors("loop", checked, &answers)
}

fn errors(method: &str, checked: &[Checked], answers: &[([f32; 3], bool)]) -> MethodError {
    let compared = checked.iter().zip(answers).map(|(truth, &(found, covered))| Compared {
        truth_n: truth.force_n,
        found_n: found.map(f64::from),
        covered,
    });
    let found = Errors::of(&compared.collect::<Vec<_>>());
    MethodError {
        method: method.into(),
        mean_n: found.mean_n,
        max_n: found.max_n,
        mean_component_n: found.component_mean_n,
        mean_relative: found.relative_mean,
        max_relative: found.relative_max,
        covered: found.covered as f64 / checked.len().max(1) as f64,
    }
}
