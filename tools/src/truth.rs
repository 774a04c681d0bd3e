//! New finite-element solutions at visited positions, and the errors of each method there.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use palpate_core::{ConfigTag, Coverage, Method, Organ};
use palpate_precompute::fem::{Problem, Solver};
use palpate_precompute::num::on_each_thread;
use palpate_precompute::pipeline::Analysis;
use palpate_precompute::space::{Record, Store};
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

/// Components below this value are omitted from relative errors, as in the paper, N.
const RELATIVE_FROM_N: f64 = 0.5;

/// Solves at every visit, on all cores. Visits without a solution are omitted and counted.
pub(crate) fn check(
    bench: &Analysis,
    store: &Store,
    visits: &[Visit],
    threads: usize,
    stop: &AtomicBool,
) -> Result<(Vec<Checked>, usize), Failure> {
    let grid = bench.lattice()?.grid;
    let problems: Vec<Arc<Problem>> = bench.scene.active.iter().map(|a| bench.problem(a)).collect();
    let mut solved: Vec<Vec<Record>> = Vec::new();
    for active in 0..problems.len() {
        let records = store.records(active)?;
        solved.push(records.into_iter().filter(|r| r.tag() == ConfigTag::Expandable).collect());
    }
    let nearest = |visit: &Visit| -> Option<&Record> {
        let cells = visit.displacement_m.map(|x| f64::from(x) / grid.spacing_m);
        let distance = |record: &Record| -> f64 {
            record.index.iter().zip(cells).map(|(n, x)| (f64::from(*n) - x).powi(2)).sum()
        };
        solved[visit.active].iter().min_by(|a, b| distance(a).total_cmp(&distance(b)))
    };
    let (next, path) = (AtomicUsize::new(0), store.path());
    let work = || -> Result<Vec<(usize, [f64; 3])>, Failure> {
        let reader = Store::open(path)?;
        let mut solvers: Vec<Solver> = problems.iter().map(|p| Solver::new(p.clone())).collect();
        let mut results = Vec::new();
        while !stop.load(Ordering::Relaxed) {
            let at = next.fetch_add(1, Ordering::Relaxed);
            let Some(visit) = visits.get(at) else { break };
            let Some(from) = nearest(visit) else { continue };
            let seed = reader.seed(visit.active, from, grid.displacement_m(from.index))?;
            let target = visit.displacement_m.map(f64::from);
            if let Ok(c) = solvers[visit.active].advance(&seed, target) {
                results.push((at, c.jet().force_n));
            }
        }
        Ok(results)
    };
    let found = on_each_thread(threads, work).map_err(Failure::work)?;
    let found = found.into_iter().collect::<Result<Vec<_>, Failure>>()?;
    if stop.load(Ordering::Relaxed) {
        return Err(Failure::work("interrupted while checking the rendered force"));
    }
    let mut found: Vec<(usize, [f64; 3])> = found.into_iter().flatten().collect();
    found.sort_unstable_by_key(|(at, _)| *at);
    let unsolved = visits.len() - found.len();
    let checked = found.into_iter().map(|(at, force_n)| Checked { visit: visits[at], force_n }).collect();
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
    let (mut sum, mut max_n, mut components, mut covered) = (0.0, 0.0f64, 0.0, 0usize);
    let (mut relative, mut max_relative, mut relatives) = (0.0, 0.0f64, 0usize);
    for (truth, (force, own)) in checked.iter().zip(answers) {
        covered += usize::from(*own);
        let mut squared = 0.0;
        for (exact, found) in truth.force_n.iter().zip(force) {
            let error = (exact - f64::from(*found)).abs();
            squared += error * error;
            components += error;
            if exact.abs() >= RELATIVE_FROM_N {
                relative += error / exact.abs();
                max_relative = max_relative.max(error / exact.abs());
                relatives += 1;
            }
        }
        sum += f64::sqrt(squared);
        max_n = max_n.max(squared.sqrt());
    }
    let count = checked.len().max(1) as f64;
    MethodError {
        method: method.into(),
        mean_n: sum / count,
        max_n,
        mean_component_n: components / (3.0 * count),
        mean_relative: relative / relatives.max(1) as f64,
        max_relative,
        covered: covered as f64 / count,
    }
}
