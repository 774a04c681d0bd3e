//! The ledger of a space: approximations of its blob, with the measured change and saving of each.
//!
//! Approximations of the blob are measured at its held-out positions. Those of the discretisation are
//! measured by solving some of the same positions with the other body, each directly from rest, so that the
//! times are comparable.

use std::sync::atomic::Ordering;
use std::time::Instant;

use nalgebra::Vector3;
use palpate_core::{Method, Organ, Space};

use super::{Analysis, PipelineError, Run};
use crate::certificate::{
    Blends, Compared, Errors, Ledger, Line, SpaceCertificate, SurfaceDistances, Truth, answered,
    modes_and_digits, share_of_part, truths,
};
use crate::fem::solve::Solver;
use crate::num::parallel::in_parallel;
use crate::num::vector::norm;
use crate::scene::{ElementOrder, ResolvedScene};
use crate::space::{Kind, Store, StoreError};

/// The ledger of the space of active node number `active`, for the energy method if certified, otherwise for
/// the first certified method. `positions` of the held-out positions are solved with each altered body; with
/// 0, only the approximations of the blob are measured. `None` if it was stopped or there are no held-out
/// positions.
pub fn ledger(
    analysis: &Analysis,
    store: &Store,
    active: usize,
    (organ, certificate): (&Organ<'_>, &SpaceCertificate),
    positions: usize,
    run: Run<'_>,
) -> Result<Option<Ledger>, PipelineError> {
    let begun = Instant::now();
    let Some(space) = organ.spaces.iter().find(|space| *space.active.name == *certificate.active) else {
        return Ok(None);
    };
    let is_certified = |method: Method| certificate.methods.iter().any(|of| of.method == method.name());
    // The default method of `run`.
    let mut methods = [Method::Energy].into_iter().chain(Method::ALL).filter(|&method| space.has(method));
    let Some(method) = methods.find(|&method| is_certified(method)) else { return Ok(None) };
    let blends = Blends::of(store, organ)?;
    let mut all = truths(store, active, organ, &blends)?;
    all.retain(|truth| truth.walk.kind == Kind::Uniform && !truth.near_branch_jump);
    if all.is_empty() {
        return Ok(None);
    }
    let mut lines = vec![linear(store, active, &all, certificate)?];
    let some = &all[..positions.min(all.len())];
    if !some.is_empty() {
        let own = forces(analysis, active, some, run)?;
        for (what, made, other) in others(&analysis.scene) {
            // A body that cannot be built solves no position.
            let there = match Analysis::of_scene(&analysis.path, other) {
                Ok(other) => forces(&other, active, some, run)?,
                Err(_) => vec![None; some.len()],
            };
            if run.stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            lines.push(discretised(what, made, &own, &there));
        }
    }
    let answers: Vec<Compared> =
        answered(&organ.spaces, method, &all).iter().map(|answer| answer.compared).collect();
    let causes = match &space.displacement() {
        Some(table) => modes_and_digits(store, active, (organ, table), &blends)?,
        None => Default::default(),
    };
    lines.extend(of_the_blob(organ, space, (method, certificate), &analysis.scene, &answers, causes));
    Ok(Some(Ledger { positions: some.len(), seconds: begun.elapsed().as_secs_f64(), lines }))
}

impl Line {
    fn by_force(self, compared: &[Compared]) -> Self {
        let (errors, sizes) = (Errors::of(compared), compared.iter().map(|c| norm(c.truth_n)).sum::<f64>());
        let relative = (sizes > 0.0).then(|| errors.mean_n * compared.len() as f64 / sizes);
        Self { force: Some(errors), relative, ..self }
    }

    fn new(what: impl Into<String>, made: bool, unit: &str, cost: [f64; 2]) -> Self {
        Self { what: what.into(), made, force: None, relative: None, surface: None, unit: unit.into(), cost }
    }
}

/// h = S d with the stiffness S at rest.
fn linear(
    store: &Store,
    active: usize,
    positions: &[Truth],
    certificate: &SpaceCertificate,
) -> Result<Line, StoreError> {
    let rest = store.records(active)?.into_iter().find(|record| record.index == [0; 3]);
    let stiffness = rest.and_then(|rest| Some(rest.equilibrium()?.stiffness_n_m)).unwrap_or_default();
    let compared = positions.iter().map(|truth| Compared {
        truth_n: truth.force_n,
        found_n: (stiffness * Vector3::from(truth.displacement_m.map(f64::from))).into(),
        covered: true,
    });
    let cost = [1.0, certificate.cost.configurations as f64];
    let is_made = certificate.linear.is_some();
    let line = Line::new("nonlinearity (the linear body instead)", is_made, "configurations", cost);
    Ok(line.by_force(&compared.collect::<Vec<_>>()))
}

/// The other bodies: the approximation, whether the scene makes it, and the other body.
fn others(scene: &ResolvedScene) -> Vec<(&'static str, bool, ResolvedScene)> {
    let by_order = |order| ResolvedScene { order, ..scene.clone() };
    let order = if scene.order == ElementOrder::Linear {
        ("displacements of second order (tet10)", true, by_order(ElementOrder::Quadratic))
    } else {
        ("displacements of second order (tet4 instead)", false, by_order(ElementOrder::Linear))
    };
    vec![order, ("seven of eight tets (a mesh refined once)", true, scene.refined())]
}

/// The solution at one position with one body.
#[derive(Debug, Clone, Copy)]
struct SolvedPosition {
    force_n: [f64; 3],
    seconds: f64,
}

/// One entry per position; `None` if it could not be solved.
type Solved = Vec<Option<SolvedPosition>>;

fn forces(
    analysis: &Analysis,
    active: usize,
    positions: &[Truth],
    run: Run<'_>,
) -> Result<Solved, PipelineError> {
    let problem = analysis.problem(&analysis.scene.active[active]);
    let shares: Vec<&[Truth]> = positions.chunks(positions.len().div_ceil(run.threads.max(1))).collect();
    let solve = |share: &&[Truth]| -> Solved {
        let mut solver = Solver::new(problem.clone());
        let Ok(rest) = solver.rest() else { return vec![None; share.len()] };
        let force = |truth: &Truth| {
            if run.stop.load(Ordering::Relaxed) {
                return None;
            }
            let begun = Instant::now();
            let at = solver.advance(&rest.seed, truth.displacement_m.map(f64::from)).ok()?;
            Some(SolvedPosition { force_n: at.jet().force_n, seconds: begun.elapsed().as_secs_f64() })
        };
        share.iter().map(force).collect()
    };
    Ok(in_parallel(&shares, run.threads, solve)?.concat())
}

fn discretised(what: &str, made: bool, own: &Solved, other: &Solved) -> Line {
    let both: Vec<[SolvedPosition; 2]> =
        own.iter().zip(other).filter_map(|(own, other)| Some([(*own)?, (*other)?])).collect();
    // The more accurate body is the reference.
    let (worse, better) = if made { (0, 1) } else { (1, 0) };
    let seconds =
        |of: usize| both.iter().map(|pair| pair[of].seconds).sum::<f64>() / both.len().max(1) as f64;
    let compare = |pair: &[SolvedPosition; 2]| Compared {
        truth_n: pair[better].force_n,
        found_n: pair[worse].force_n,
        covered: true,
    };
    let compared: Vec<Compared> = both.iter().map(compare).collect();
    let cost = [seconds(worse), seconds(better)];
    let what = match own.len() - both.len() {
        0 => what.to_owned(),
        unsolved => format!("{what}; {unsolved} of {} positions not solved by both", own.len()),
    };
    Line::new(what, made, "s a configuration", cost).by_force(&compared)
}

/// Approximations of packing and of the core's evaluation.
fn of_the_blob(
    organ: &Organ<'_>,
    space: &Space<'_>,
    (method, certificate): (Method, &SpaceCertificate),
    scene: &ResolvedScene,
    answers: &[Compared],
    causes: [SurfaceDistances; 2],
) -> Vec<Line> {
    let mut lines = Vec::new();
    if scene.max_force_n.is_finite() {
        let limit_n = scene.max_force_n as f32;
        let reached = share_of_part(
            space,
            |_| true,
            |at| {
                let force = space.force(method, at).map_or([0.0; 3], |answer| answer.force_n);
                force.iter().map(|h| h * h).sum::<f32>() <= limit_n * limit_n
            },
        );
        let what = format!("positions beyond {} N, which the device cannot hold", scene.max_force_n);
        lines.push(Line::new(what, true, "of r_G's ball", [reached, 1.0]));
    }
    let surface = certificate.displacement.as_ref();
    if let Some(of) = certificate.methods.iter().find(|of| of.method == method.name()) {
        let seconds = certificate.cost.seconds / certificate.cost.configurations.max(1) as f64;
        let cost = [1e-9 * of.probe.nanoseconds, seconds];
        let line = Line::new("configurations between those solved", true, "s a force", cost);
        lines.push(Line { surface: surface.map(|surface| surface.uniform), ..line.by_force(answers) });
        // Only a bound is available: the largest difference anywhere.
        let rounding = Errors { max_n: of.probe.rounding_n, ..Errors::default() };
        lines.push(Line {
            force: Some(rounding),
            ..Line::new("half of the digits (f32 in the tick)", true, "bytes a number", [4.0, 8.0])
        });
    }
    let nodes = [organ.surface.node.len(), scene.mesh.nodes_m.len()].map(|count| count as f64);
    lines.push(Line::new("nodes inside the body", true, "nodes moved", nodes));
    match surface {
        Some(surface) => {
            let line = |what: String, unit, cost, by: SurfaceDistances| Line {
                surface: Some(by).filter(|by| by.count > 0),
                ..Line::new(what, true, unit, cost)
            };
            let [left, rounded] = causes;
            let bytes = [surface.bytes, surface.raw_bytes].map(|bytes| bytes as f64);
            lines.push(line(format!("modes beyond {}", surface.modes), "bytes", bytes, left));
            let digits = "digits of their coefficients (int16)".into();
            lines.push(line(digits, "bytes a number", [2.0, 4.0], rounded));
            let eye = "displacements for the eye (a blob of forces alone)";
            lines.push(Line::new(eye, false, "bytes", [0.0, bytes[0]]));
        }
        None => lines.push(Line::new(
            "displacements for the eye (a blob of forces alone)",
            true,
            "nodes moved",
            [0.0, nodes[0]],
        )),
    }
    lines
}
