//! The plan of a scene: what a caller reads.

use palpate_core::Method;
use serde::Serialize;

use super::error::PlanError;
use super::node::{Choice, NodePlan};
use super::prediction::Prediction;
use super::results::Results;
use super::row::Row;
use super::tables::{Error, VisualModel};
use crate::pipeline::Analysis;
use crate::spec::Tolerance;

/// The predicted cost and error of a scene's possible samplings and discretisations.
#[derive(Debug, Clone)]
pub struct Plan {
    /// The probed active nodes, at most four.
    pub nodes: Vec<PlannedNode>,
    /// Tolerance of the errors: the scene's, or the just-noticeable difference of force.
    pub tolerance: Tolerance,
    /// The choices of sampling, method and discretisation, for all active nodes together.
    pub rows: Vec<Row>,
    /// Index of the recommended row.
    pub recommended: usize,
    /// The reason for it.
    pub why: String,
    /// Intervals for the sampling that the scene specifies.
    pub prediction: Prediction,
    /// Active nodes that the largest force cannot move, and the reason; their spaces are omitted.
    pub too_stiff: Vec<String>,
}

/// What the probes of an active node show.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlannedNode {
    /// Name of the node.
    pub name: String,
    /// Mean stiffness at rest, N/m.
    #[serde(skip)]
    pub stiffness_n_m: f64,
    /// Number of probing solves.
    pub probes: usize,
    /// Number of probes that failed.
    pub failed: usize,
    /// Number of probes that left their branch.
    pub on_another_branch: usize,
    /// Number of probes beyond the force limit.
    pub beyond: usize,
    /// Number of probes that were solved again from another start.
    pub again: usize,
    /// Number of these with a different solution.
    pub again_on_another_branch: usize,
    /// Displacements of the probes, shortest and longest, m.
    pub reach_m: [f64; 2],
    /// Wall seconds of the solve at rest.
    pub rest_s: f64,
    /// Wall seconds of each probe.
    pub far_s: Vec<f64>,
    /// Wall seconds of each lattice step.
    pub near_s: Vec<f64>,
    /// Number of unknowns.
    pub unknowns: usize,
    /// Entries of the matrix.
    pub entries: usize,
    /// Entries of its factor.
    pub factor: usize,
    /// 99th percentile of the error of a linear body, N.
    pub linear_p99_n: f64,
    /// Share of the positions with an error of a linear body within the tolerance.
    pub linear_within: f64,
    /// The displacement planes for display; `None` if no display is needed.
    pub eye: Option<VisualModel>,
    /// Scattered first, then lattices from coarse to fine.
    pub choices: Vec<PlannedSampling>,
}

/// A sampling of one node's space.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlannedSampling {
    /// Spacing, m; `None` if positions are scattered.
    pub spacing_m: Option<f64>,
    /// Number of solved configurations, including rest.
    pub configurations: f64,
    /// Total seconds of the solves on one thread.
    pub solving_s: f64,
    /// Spacing of its tables, m.
    pub table_spacing_m: f64,
    /// Whether the tables were built and not extrapolated from coarser ones.
    pub built: bool,
    /// Every method that has a table.
    pub methods: Vec<PlannedMethod>,
}

/// A method on such a sampling.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlannedMethod {
    /// Name of the method.
    pub method: &'static str,
    /// 99th percentile of the error, N.
    pub p99_n: f64,
    /// Share of the positions with an error within the tolerance.
    pub within: f64,
    /// Time of a query, ns.
    pub nanoseconds: f64,
}

impl Plan {
    /// Plans a scene on `threads` threads. `progress` is called with a phase, its finished steps and their
    /// total, by any of the threads. Takes some seconds.
    pub fn of(
        analysis: &Analysis,
        threads: usize,
        progress: &(dyn Fn(&'static str, usize, usize) + Sync),
    ) -> Result<Self, PlanError> {
        let results = Results::of(analysis, threads, progress)?;
        let prediction = results.prediction(analysis, threads);
        let (rows, recommended, why) = results.rows(analysis, &prediction);
        let named = |node| PlannedNode::of(&analysis.scene.active, node);
        let nodes = results.nodes.iter().map(named).collect();
        let Results { tolerance, too_stiff, .. } = results;
        Ok(Self { nodes, tolerance, rows, recommended, why, prediction, too_stiff })
    }
}

impl PlannedNode {
    fn of(active: &[crate::scene::ActiveNode], node: &NodePlan) -> Self {
        let NodePlan { probed, choices, linear, eye, .. } = node;
        let [unknowns, entries, factor] = probed.size;
        Self {
            name: active[probed.active].name.clone(),
            stiffness_n_m: probed.jets[0].stiffness_n_m.trace() / 3.0,
            probes: probed.far_s.len(),
            failed: probed.failed,
            on_another_branch: probed.lost - probed.failed,
            beyond: probed.beyond,
            again: probed.again,
            again_on_another_branch: probed.elsewhere,
            reach_m: probed.reach_m(),
            rest_s: probed.rest_s,
            far_s: probed.far_s.clone(),
            near_s: probed.near_s.clone(),
            unknowns,
            entries,
            factor,
            linear_p99_n: linear.p99_n,
            linear_within: linear.within,
            eye: *eye,
            choices: choices.iter().map(PlannedSampling::of).collect(),
        }
    }
}

impl PlannedSampling {
    fn of(choice: &Choice) -> Self {
        let of = |&(method, Error { p99_n, within }, nanoseconds): &(Method, Error, f64)| PlannedMethod {
            method: method.name(),
            p99_n,
            within,
            nanoseconds,
        };
        Self {
            spacing_m: choice.spacing_m,
            configurations: choice.configurations,
            solving_s: choice.solving_s,
            table_spacing_m: choice.grid.spacing_m,
            built: choice.built,
            methods: choice.methods.iter().map(of).collect(),
        }
    }
}
