//! The ledger: approximations of a blob, with the measured change and saving of each.
//!
//! A line is an approximation that is made, or one that is possible but not made (the linear body, elements
//! of lower order). Approximations of the blob are measured at its held-out positions. Those of the
//! discretisation are measured by solving some of the same positions with the other body, each directly from
//! rest, so that the times are comparable.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Instant;

use nalgebra::Vector3;
use palpate_core::{Method, Organ, Space};
use serde::{Deserialize, Serialize};

use super::displacement::modes_and_digits;
use super::{Compared, Errors, SpaceCertificate, SurfaceDistances, Truth, answered, probes, truths};
use crate::fem::solve::Solver;
use crate::num::parallel::{Pool, ThreadError};
use crate::scene::ResolvedScene;
use crate::space::{Kind, Store, StoreError};

/// All lines of a space.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Ledger {
    /// Number of positions solved with each other body.
    pub positions: usize,
    /// Wall time of these solves, s.
    pub seconds: f64,
    /// The lines.
    pub lines: Vec<Line>,
}

/// One approximation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Line {
    /// What the approximation omits.
    pub what: String,
    /// Whether it is made.
    pub made: bool,
    /// Difference of the force with and without it; `None` if it cannot be measured.
    pub force: Option<Errors>,
    /// Mean difference divided by the mean |h|.
    pub relative: Option<f64>,
    /// Difference of the surface displacements.
    pub surface: Option<SurfaceDistances>,
    /// Unit of the two costs.
    pub unit: String,
    /// Cost with the approximation, and without it.
    pub cost: [f64; 2],
}

impl Line {
    fn by_force(self, compared: &[Compared]) -> Self {
        let size = |c: &Compared| c.truth_n.iter().map(|h| h * h).sum::<f64>().sqrt();
        let (errors, sizes) = (Errors::of(compared), compared.iter().map(size).sum::<f64>());
        let relative = (sizes > 0.0).then(|| errors.mean_n * compared.len() as f64 / sizes);
        Self { force: Some(errors), relative, ..self }
    }

    fn new(what: impl Into<String>, made: bool, unit: &str, cost: [f64; 2]) -> Self {
        Self { what: what.into(), made, force: None, relative: None, surface: None, unit: unit.into(), cost }
    }
}

/// Why there is no ledger.
#[derive(Debug)]
pub enum LedgerError {
    /// The store could not be read.
    Store(StoreError),
    /// The threads could not be started.
    Threads(ThreadError),
}

impl std::fmt::Display for LedgerError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Store(error) => write!(f, "{error}"),
            Self::Threads(error) => write!(f, "{error}"),
        }
    }
}

impl std::error::Error for LedgerError {}

impl From<StoreError> for LedgerError {
    fn from(error: StoreError) -> Self {
        Self::Store(error)
    }
}

impl From<ThreadError> for LedgerError {
    fn from(error: ThreadError) -> Self {
        Self::Threads(error)
    }
}

/// Number of additional solves, and the stop flag.
#[derive(Debug, Clone, Copy)]
pub struct AdditionalSolves<'s> {
    /// Number of positions solved with each other body. With 0, only the approximations of the blob are
    /// measured.
    pub positions: usize,
    /// Number of threads.
    pub threads: usize,
    /// Stop flag.
    pub stop: &'s AtomicBool,
}

/// The ledger of the space of active node number `active`, for the energy method if certified, otherwise for
/// the first certified method. `None` if it was stopped or there are no held-out positions.
pub fn ledger(
    store: &Store,
    active: usize,
    (organ, certificate): (&Organ<'_>, &SpaceCertificate),
    scene: &ResolvedScene,
    effort: AdditionalSolves<'_>,
) -> Result<Option<Ledger>, LedgerError> {
    let begun = Instant::now();
    let Some(space) = organ.spaces.iter().find(|space| *space.active.name == *certificate.active) else {
        return Ok(None);
    };
    let is_certified = |method: Method| certificate.methods.iter().any(|of| of.method == method.name());
    // The default method of `run`.
    let mut methods = [Method::Energy].into_iter().chain(Method::ALL).filter(|&method| space.has(method));
    let Some(method) = methods.find(|&method| is_certified(method)) else { return Ok(None) };
    let mut positions = truths(store, active, space, &store.identity()?.sampling)?;
    positions.retain(|truth| truth.walk.kind == Kind::Uniform && !truth.folded);
    if positions.is_empty() {
        return Ok(None);
    }
    let mut lines = vec![linear(store, active, &positions, certificate)?];
    let some = &positions[..effort.positions.min(positions.len())];
    if !some.is_empty() {
        let own = forces(scene, active, some, effort)?;
        for (what, made, other) in others(scene) {
            let there = forces(&other, active, some, effort)?;
            if effort.stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            lines.push(discretised(what, made, &own, &there));
        }
    }
    let answers: Vec<Compared> =
        answered(space, method, &positions).iter().map(|answer| answer.compared).collect();
    let causes = match &space.displacement() {
        Some(table) => modes_and_digits(store, active, (space, table), organ.surface.node)?,
        None => Default::default(),
    };
    lines.extend(of_the_blob(organ, space, (method, certificate), scene, &answers, causes));
    Ok(Some(Ledger { positions: some.len(), seconds: begun.elapsed().as_secs_f64(), lines }))
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
    let order = if scene.order == 1 {
        ("displacements of second order (tet10)", true, by_order(2))
    } else {
        ("displacements of second order (tet4 instead)", false, by_order(1))
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
    scene: &ResolvedScene,
    active: usize,
    positions: &[Truth],
    effort: AdditionalSolves<'_>,
) -> Result<Solved, ThreadError> {
    let nothing = || vec![None; positions.len()];
    let (Ok(body), Some(node)) = (scene.body(), scene.active.get(active)) else { return Ok(nothing()) };
    let problem = Arc::new(scene.solver.problem(Arc::new(body), node));
    let next = AtomicUsize::new(0);
    let work = || {
        let mut solver = Solver::new(problem.clone());
        let mut found = Vec::new();
        let Ok(rest) = solver.rest() else { return found };
        while !effort.stop.load(Ordering::Relaxed) {
            let place = next.fetch_add(1, Ordering::Relaxed);
            let Some(truth) = positions.get(place) else { break };
            let begun = Instant::now();
            if let Ok(at) = solver.advance(&rest.seed, truth.displacement_m.map(f64::from)) {
                found.push((
                    place,
                    SolvedPosition { force_n: at.jet().force_n, seconds: begun.elapsed().as_secs_f64() },
                ));
            }
        }
        found
    };
    let mut solved = nothing();
    let pool = Pool::new(effort.threads.clamp(1, positions.len()))?;
    for (place, one) in pool.each(work).into_iter().flatten() {
        solved[place] = Some(one);
    }
    Ok(solved)
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
        let reached = probes::share_of_ball(space, |at| {
            let force = space.force(method, at).map_or([0.0; 3], |answer| answer.force_n);
            force.iter().map(|h| h * h).sum::<f32>() <= limit_n * limit_n
        });
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
