//! All results on the probed nodes of a scene, and the prediction from them.

use std::cell::Cell;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use palpate_core::Method;

use super::error::PlanError;
use super::model::{self, ComparedModel, Model};
use super::node::{self, NodePlan};
use super::prediction::{Basis, Prediction};
use super::probe::{MAX_SOLVES, Order, Probed, probe};
use super::tables;
use crate::mesh::Surface;
use crate::num::in_parallel;
use crate::pipeline::Analysis;
use crate::scene::ElementOrder;
use crate::space::ExpansionError;
use crate::spec::{Requirements, Sampling, Scattered, Tolerance};

/// Maximum number of probed nodes; the others are assumed to equal their mean.
const MAX_NODES: usize = 4;
/// Time limit for the probes of all nodes together, after each node has its minimum number.
const PROBE_TIME: Duration = Duration::from_millis(2400);
/// Cells along the radius of a step whose time is measured, for a scene without a lattice: those of the
/// paper's coarsest grid.
const CELLS_PER_STEP: f64 = 5.0;

/// Depth at which discretisations are compared, in radii of the tool.
const PUSH: f64 = 0.5;

/// All results.
pub(super) struct Results {
    /// The probed nodes.
    pub nodes: Vec<NodePlan>,
    /// Other discretisations of the first.
    pub besides: Vec<ComparedModel>,
    /// Tolerance of the sampling, or the just-noticeable difference.
    pub tolerance: Tolerance,
    /// Spacing of the lattice that the scene specifies, m.
    pub spacing_m: Option<f64>,
    /// Vertices and triangles of the surface.
    pub skin: [usize; 2],
    /// Whether the scene has quadratic elements.
    pub is_quadratic: bool,
    /// Whether the body has a pressure field.
    pub has_pressure: bool,
    /// The push of a tool with a size at which discretisations are compared, m; `None` for a point.
    pub push_m: Option<[f64; 3]>,
    /// Nodes that the largest force cannot move.
    pub too_stiff: Vec<String>,
}

impl Results {
    /// Probes the nodes of a scene and plans each.
    pub(super) fn of(analysis: &Analysis, threads: usize, progress: Progress<'_>) -> Result<Self, PlanError> {
        let (scene, sampling) = (&analysis.scene, analysis.sampling()?);
        let surface = Surface::of(&scene.mesh).seen(&scene.mesh);
        let tolerance =
            sampling.scattered().map_or(Tolerance::IMPERCEPTIBLE, |scattered| scattered.tolerance);
        let orders = orders(analysis, &sampling, tolerance, &surface, threads);
        let steps = Steps::new(progress, "probing solves", orders.len() * MAX_SOLVES);
        let probed = in_parallel(&orders, threads, |order| {
            let solved = Cell::new(0);
            let probed = probe(order, &|| {
                solved.set(solved.get() + 1);
                steps.done(1);
            });
            // A search may end before the largest number of solves.
            steps.done(MAX_SOLVES - solved.get());
            probed.map_err(|failure| {
                PlanError::Rest(analysis.path.clone(), ExpansionError::Rest(failure.reason.to_string()))
            })
        });
        let probed = probed?.into_iter().collect::<Result<Vec<Probed>, PlanError>>()?;
        let bound = scene.visual.then_some(scene.displacement_bound);
        let steps = Steps::new(progress, "sampling and fits on the probes", probed.len());
        let planned = in_parallel(&probed, threads, |probed| {
            let planned = node::plan(probed.clone(), &sampling, bound);
            steps.done(1);
            planned
        });
        let nodes = planned?.into_iter().collect::<Result<Vec<NodePlan>, PlanError>>()?;
        let too_stiff = match sampling.scattered() {
            Some(_) => too_stiff(analysis, &nodes)?,
            None => Vec::new(),
        };
        let has_pressure = analysis.body.has_pressure();
        let first = &nodes[0].probed;
        let tip = scene.tool.fingertip();
        let others = Model::of(scene).others(has_pressure, tip.is_some());
        let normal = scene.active[first.active].normal(&surface).unwrap_or_default();
        let push_m = tip.map(|tip| normal.map(|x| -PUSH * tip.radius_m * x));
        let steps = Steps::new(progress, "other discretisations", others.len());
        let besides = in_parallel(&others, threads, |&other| {
            let beside = model::beside(scene, first.active, other, first);
            steps.done(1);
            beside
        });
        Ok(Self {
            too_stiff,
            push_m,
            besides: besides?.into_iter().flatten().collect(),
            nodes,
            tolerance,
            spacing_m: sampling.lattice().map(|lattice| lattice.grid.spacing_m),
            skin: [surface.nodes.len(), surface.triangles.len()],
            is_quadratic: scene.order == ElementOrder::Quadratic,
            has_pressure,
        })
    }

    /// The intervals for the sampling that the scene specifies.
    pub(super) fn prediction(&self, analysis: &Analysis, threads: usize) -> Prediction {
        let scene = &analysis.scene;
        let energy = |node: &NodePlan| {
            let choice = node.choices.iter().find(|choice| choice.spacing_m == self.spacing_m)?;
            choice.of(Method::Energy.name())
        };
        let probed = self.nodes.iter().map(|node| {
            let name = scene.active[node.probed.active].name.as_str();
            (name, &node.outlook, energy(node).map(|(error, _)| error.p99_n))
        });
        let other = |certificates| tables::other_bytes(self.skin, scene.active.len(), certificates) as f64;
        let queries = self.nodes.iter().filter_map(|node| energy(node).map(|(_, ns)| ns));
        let is_lattice = self.spacing_m.is_some();
        Prediction::of(&Basis {
            scene: (&scene.name, scene.content_hash().to_string()),
            threads,
            probed: probed.collect(),
            nodes: scene.active.len(),
            memory_bytes: (
                self.memory_bytes(analysis, threads),
                if is_lattice { |_, _| 0.0 } else { model::loop_bytes },
            ),
            other_bytes: [other(Some(1)), other(Some(1)) - other(None)],
            query_ns: queries.reduce(f64::max),
        })
    }
}

/// The probing of the selected nodes.
fn orders(
    analysis: &Analysis,
    sampling: &Sampling,
    tolerance: Tolerance,
    surface: &Surface,
    threads: usize,
) -> Vec<Order> {
    let scene = &analysis.scene;
    let positions: Vec<[f64; 3]> = scene.active.iter().map(|a| a.rest_position_m(&analysis.body)).collect();
    let chosen = node::spread(&positions, MAX_NODES);
    let share = (threads as f64 / chosen.len() as f64).min(1.0);
    let order = |&active: &usize| Order {
        active,
        problem: analysis.problem(&scene.active[active]),
        wanted: wanted(
            sampling,
            scene.max_force_n,
            tolerance,
            (positions[active], scene.active[active].normal(surface)),
        ),
        surface: if scene.visual { surface.nodes.clone() } else { Vec::new() },
        step_m: sampling.lattice().map_or(sampling.radius_m() / CELLS_PER_STEP, |l| l.grid.spacing_m),
        patience: PROBE_TIME.mul_f64(share),
    };
    chosen.iter().map(order).collect()
}

/// Called with a phase, its finished steps and their total.
pub(super) type Progress<'p> = &'p (dyn Fn(&'static str, usize, usize) + Sync);

/// Progress of a phase whose steps several threads take.
struct Steps<'p> {
    progress: Progress<'p>,
    phase: &'static str,
    total: usize,
    done: AtomicUsize,
}

impl<'p> Steps<'p> {
    fn new(progress: Progress<'p>, phase: &'static str, total: usize) -> Self {
        let steps = Self { progress, phase, total, done: AtomicUsize::new(0) };
        steps.done(0);
        steps
    }

    fn done(&self, steps: usize) {
        let done = self.done.fetch_add(steps, Ordering::Relaxed) + steps;
        (self.progress)(self.phase, done.min(self.total), self.total);
    }
}

/// Descriptions of the nodes that the largest force cannot move, which a space of scattered positions omits.
/// Fails if no other node remains, or if every probe failed.
fn too_stiff(analysis: &Analysis, nodes: &[NodePlan]) -> Result<Vec<String>, PlanError> {
    let path = &analysis.path;
    let why = |node: &NodePlan| {
        let why = node.probed.too_stiff.as_ref()?;
        Some(format!("active node {}: {why}", analysis.scene.active[node.probed.active].name))
    };
    let too_stiff: Vec<String> = nodes.iter().filter_map(why).collect();
    if let [first, ..] = &too_stiff[..]
        && too_stiff.len() == nodes.len()
    {
        return Err(PlanError::TooStiff(path.clone(), first.clone()));
    }
    let failed: usize = nodes.iter().map(|node| node.probed.failed).sum();
    if failed > 0 && failed == nodes.iter().map(|node| node.probed.far_s.len()).sum::<usize>() {
        return Err(PlanError::ProbesFailed(path.clone(), failed));
    }
    Ok(too_stiff)
}

/// The sampling parameters of a node's space.
fn wanted(
    sampling: &Sampling,
    max_force_n: f64,
    tolerance: Tolerance,
    (rest_m, normal): ([f64; 3], Option<[f64; 3]>),
) -> Requirements {
    let scattered = sampling.scattered().copied().unwrap_or(Scattered {
        radius_m: sampling.radius_m(),
        tolerance,
        only_push: false,
        workspace_m: None,
    });
    // An active node is on the surface. Without a normal, a pushing direction is undefined.
    scattered.wanted(max_force_n, rest_m, normal.unwrap_or_default())
}
