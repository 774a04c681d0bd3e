//! `palpate plan`: the cost of a scene, predicted before it is solved.
//!
//! [`probe`] solves some configurations on each active node. [`surrogate`] fits them by a body that is cheap
//! to evaluate. On it the adaptive sampling, the lattice's plan and the packer's fits run as on the real
//! body. [`tables`] measures the results. [`node`] combines them for a node, [`model`] for other
//! discretisations, [`rows`] for the scene. [`draws`] are possible outcomes of the sampling that the scene
//! asks for, [`prediction`] their intervals. [`check`] compares a saved prediction with later results.

mod check;
mod draws;
mod model;
mod node;
mod prediction;
mod probe;
mod row;
mod rows;
pub(crate) mod surrogate;
pub(crate) mod tables;

use std::cell::Cell;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use clap::Args as ClapArgs;
use palpate_core::Method;
use palpate_precompute::mesh::Surface;
use palpate_precompute::num::in_parallel;
use palpate_precompute::pipeline::Analysis;
use palpate_precompute::space::ExpansionError;
use palpate_precompute::spec::{Sampling, Tolerance};
use serde_json::json;

use self::model::{ComparedModel, Model};
use self::node::{NodePlan, mean};
use self::prediction::{Basis, Prediction};
use self::probe::{MAX_SOLVES, Order, Probed, probe};
use self::row::Row;
use crate::analysis::{self, threads};
use crate::cmd::inspect::certificate::significant;
use crate::cmd::precompute;
use crate::failure::Failure;
use crate::files::{FileKind, Files, Replace};
use crate::interrupt::end_when_interrupted;
use crate::output;
use crate::progress::WorkProgress;

/// Maximum number of probed nodes; the others are assumed to equal their mean.
const MAX_NODES: usize = 4;
/// Time limit for the probes of all nodes together, after each node has its minimum number.
const PROBE_TIME: Duration = Duration::from_millis(2400);
/// Cells along the radius of a step whose time is measured, for a scene without a lattice: those of the
/// paper's coarsest grid.
const CELLS_PER_STEP: f64 = 5.0;

/// Predict the cost of a scene before it is solved.
///
/// The choices of sampling are compared by configurations, seconds, memory, bytes, query time and error.
///
/// A few probing solves on each active node (at most four nodes) measure stiffness, nonlinearity and the time
/// of a solve on this machine. The sampling, the plan and the fits of `precompute` and `pack` then run on a
/// surrogate that interpolates the probes. Errors are against the finite elements of the same model; the
/// column `stiffer` is the additional error of its discretisation.
///
/// For the sampling that the scene asks for, 80 % prediction intervals are given. They include the lattice
/// that takes over a search at branch jumps, with its probability and cost. `--out` saves them, and `--check`
/// later compares them with the solved space.
///
/// Example: palpate plan liver.toml --out plan.json; then, after precompute and pack,
/// palpate plan --check liver.space --prediction plan.json --blob liver.blob
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// Scene file (TOML)
    #[arg(required_unless_present = "check", conflicts_with = "check")]
    scene: Option<PathBuf>,
    /// Save the prediction to this file
    #[arg(long, value_name = "FILE.json", conflicts_with = "check")]
    out: Option<PathBuf>,
    /// Compare a saved prediction with this solved space
    #[arg(long, value_name = "FILE.space")]
    check: Option<PathBuf>,
    /// With --check: the prediction that --out saved
    #[arg(long, value_name = "FILE.json", requires = "check")]
    prediction: Option<PathBuf>,
    /// With --check: the blob of the space, for bytes, error and query time
    #[arg(long, value_name = "FILE.blob", requires = "check")]
    blob: Option<PathBuf>,
    /// Worker threads, of the plan and of the predicted work; one per core if not given
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Print all rows, nodes and intervals
    #[arg(long)]
    verbose: bool,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    replace: Replace,
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    if let Some(space) = &args.check {
        return run_check(args, space);
    }
    let Some(scene) = &args.scene else { return Err(Failure::input("give a scene")) };
    let begun = Instant::now();
    end_when_interrupted()?;
    let threads = threads(args.threads)?;
    let mut files = Files::new(args.replace);
    files.read_scene(scene)?;
    let out = args.out.as_ref().map(|path| files.write("--out", path, FileKind::Json)).transpose()?;
    let bench = analysis::load(scene)?;
    let progress = Mutex::new(WorkProgress::new(&bench.scene.name, "steps"));
    let plan = Plan::of(&bench, threads, &progress);
    drop(progress);
    let plan = plan?;
    let prediction = plan.prediction(&bench, threads);
    let (rows, chosen, why) = plan.rows(&bench, &prediction);
    if let Some(out) = out {
        let text = serde_json::to_string_pretty(&prediction).map_err(Failure::work)?;
        out.put(format!("{text}\n").as_bytes())?;
    }
    let seconds = begun.elapsed().as_secs_f64();
    if args.json {
        let figures = json!({
            "scene": bench.scene.name, "threads": threads, "seconds": seconds, "nodes": plan.figures(&bench),
            "rows": rows, "recommended": rows[chosen], "why": why, "prediction": prediction,
        });
        return output::line(serde_json::to_string_pretty(&figures).map_err(Failure::work)?);
    }
    output::line(format!("Recommended: {}: {why}.\n", rows[chosen].in_words()))?;
    // Of each sampling the default method, unless all are asked for.
    let is_shown =
        |row: &&Row| args.verbose || row.recommended || row.asked || row.method == Method::Energy.name();
    let shown: Vec<Row> = rows.iter().filter(is_shown).cloned().collect();
    output::line(row::table(&shown, threads))?;
    if args.verbose {
        output::line(plan.in_words(&bench))?;
    }
    output::line(prediction.in_words())?;
    output::line(format!(
        "Seconds are on {threads} thread{} of this machine with its present load; ~ marks values extrapolated from coarser or smaller solves. Planned in \
         {seconds:.1} s",
        if threads == 1 { "" } else { "s" }
    ))
}

/// Compares a saved prediction with a solved space.
fn run_check(args: &Args, space: &Path) -> Result<(), Failure> {
    let store = analysis::existing_space(space)?;
    let Some(path) = &args.prediction else {
        return Err(Failure::input(format!(
            "--check {}: needs the prediction that was saved before; save one with `palpate plan SCENE.toml --out FILE.json` \
             and give --prediction FILE.json",
            space.display()
        )));
    };
    let prediction = Prediction::load(path)?;
    check::expect_same_scene(&prediction, path, &store)?;
    let compared = check::compare(&prediction, &store, args.blob.as_deref())?;
    if compared.lines.is_empty() {
        return Err(Failure::input(format!(
            "{}: no active node is finished; run `palpate precompute` to its end and check again",
            store.path().display()
        )));
    }
    if args.json {
        return output::line(serde_json::to_string_pretty(&compared).map_err(Failure::work)?);
    }
    output::line(compared.in_words())
}

/// All results.
struct Plan {
    nodes: Vec<NodePlan>,
    besides: Vec<ComparedModel>,
    tolerance: Tolerance,
    spacing_m: Option<f64>,
    skin: [usize; 2],
    has_pressure: bool,
}

impl Plan {
    fn of(bench: &Analysis, threads: usize, progress: &Mutex<WorkProgress>) -> Result<Self, Failure> {
        let (scene, sampling) = (&bench.scene, bench.sampling()?);
        let surface = Surface::of(&scene.mesh).seen(&scene.mesh);
        let tolerance =
            sampling.scattered().map_or(Tolerance::IMPERCEPTIBLE, |scattered| scattered.tolerance);
        let orders = orders(bench, &sampling, tolerance, &surface, threads);
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
                precompute::of_scene(bench, ExpansionError::Rest(failure.reason.to_string()))
            })
        });
        let probed = probed.map_err(Failure::work)?.into_iter().collect::<Result<Vec<Probed>, Failure>>()?;
        let bound = scene.visual.then_some(scene.displacement_bound);
        let steps = Steps::new(progress, "sampling and fits on the probes", probed.len());
        let planned = in_parallel(&probed, threads, |probed| {
            let planned = node::plan(probed.clone(), &sampling, bound);
            steps.done(1);
            planned
        });
        let nodes =
            planned.map_err(Failure::work)?.into_iter().collect::<Result<Vec<NodePlan>, Failure>>()?;
        if sampling.scattered().is_some() {
            expect_movable(bench, &nodes)?;
        }
        let has_pressure = bench.body.has_pressure();
        let first = &nodes[0].probed;
        let others = Model::of(scene).others(has_pressure);
        let steps = Steps::new(progress, "other discretisations", others.len());
        let besides = in_parallel(&others, threads, |&other| {
            let beside = model::beside(scene, first.active, other, first);
            steps.done(1);
            beside
        });
        Ok(Self {
            besides: besides.map_err(Failure::work)?.into_iter().flatten().collect(),
            nodes,
            tolerance,
            spacing_m: sampling.lattice().map(|lattice| lattice.grid.spacing_m),
            skin: [surface.nodes.len(), surface.triangles.len()],
            has_pressure,
        })
    }

    /// The intervals for the sampling that the scene specifies.
    fn prediction(&self, bench: &Analysis, threads: usize) -> Prediction {
        let scene = &bench.scene;
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
                self.memory_bytes(bench, threads),
                if is_lattice { |_, _| 0.0 } else { model::loop_bytes },
            ),
            other_bytes: [other(Some(1)), other(Some(1)) - other(None)],
            query_ns: queries.reduce(f64::max),
        })
    }

    fn in_words(&self, bench: &Analysis) -> String {
        let scene = &bench.scene;
        let mut text = format!(
            "{}: {} nodes, {} tets, {}, {} of {} active nodes probed; tolerance {} % of |h| or {} mN\n",
            scene.name,
            scene.mesh.nodes_m.len(),
            scene.mesh.tets.len(),
            bench.body.law_names(),
            self.nodes.len(),
            scene.active.len(),
            significant(100.0 * self.tolerance.relative),
            significant(1e3 * self.tolerance.absolute_n)
        );
        for node in &self.nodes {
            let NodePlan { probed, linear, .. } = node;
            let [near, far] = probed.reach_m();
            text.push_str(&format!(
                "  {}: {:.0} N/m at rest; {} probes reach {:.0} to {:.0} mm ({} beyond f_max, {} failed, {} on another branch; {} of {} on another branch from another start), {:.2} s each; error of a linear body \
                 {:.0} mN (p99)\n",
                scene.active[probed.active].name,
                probed.jets[0].stiffness_n_m.trace() / 3.0,
                probed.far_s.len(),
                1e3 * near,
                1e3 * far,
                probed.beyond,
                probed.failed,
                probed.lost - probed.failed,
                probed.elsewhere,
                probed.again,
                mean(&probed.far_s),
                1e3 * linear.p99_n
            ));
        }
        text
    }

    fn figures(&self, bench: &Analysis) -> serde_json::Value {
        let of = |node: &NodePlan| {
            let NodePlan { probed, choices, linear, eye, .. } = node;
            let choices: Vec<_> = choices
                .iter()
                .map(|c| {
                    let methods: Vec<_> = c
                        .methods
                        .iter()
                        .map(|(m, e, ns)| json!({ "method": m.name(), "p99_n": e.p99_n, "within": e.within, "nanoseconds": ns }))
                        .collect();
                    json!({ "spacing_m": c.spacing_m, "configurations": c.configurations, "solving_s": c.solving_s,
                            "table_spacing_m": c.grid.spacing_m, "built": c.built, "methods": methods })
                })
                .collect();
            json!({
                "name": bench.scene.active[probed.active].name, "probes": probed.far_s.len(), "failed": probed.failed,
                "on_another_branch": probed.lost - probed.failed,
                "beyond": probed.beyond, "again": probed.again, "again_on_another_branch": probed.elsewhere,
                "reach_m": probed.reach_m(), "rest_s": probed.rest_s, "far_s": probed.far_s,
                "near_s": probed.near_s, "unknowns": probed.size[0], "entries": probed.size[1], "factor": probed.size[2],
                "linear_p99_n": linear.p99_n, "linear_within": linear.within, "eye": eye, "choices": choices,
            })
        };
        json!(self.nodes.iter().map(of).collect::<Vec<_>>())
    }
}

/// The probing of the selected nodes.
fn orders(
    bench: &Analysis,
    sampling: &Sampling,
    tolerance: Tolerance,
    surface: &Surface,
    threads: usize,
) -> Vec<Order> {
    let scene = &bench.scene;
    let positions: Vec<[f64; 3]> = scene.active.iter().map(|a| bench.body.rest_position_m(a.node)).collect();
    let chosen = node::spread(&positions, MAX_NODES);
    let share = (threads as f64 / chosen.len() as f64).min(1.0);
    let order = |&active: &usize| Order {
        active,
        problem: bench.problem(&scene.active[active]),
        wanted: wanted(
            sampling,
            scene.max_force_n,
            tolerance,
            (positions[active], surface.normal(scene.active[active].node)),
        ),
        surface: if scene.visual { surface.nodes.clone() } else { Vec::new() },
        step_m: sampling.lattice().map_or(sampling.radius_m() / CELLS_PER_STEP, |l| l.grid.spacing_m),
        patience: PROBE_TIME.mul_f64(share),
    };
    chosen.iter().map(order).collect()
}

/// Progress of a phase whose steps several threads take.
struct Steps<'p> {
    progress: &'p Mutex<WorkProgress>,
    phase: &'static str,
    total: usize,
    done: AtomicUsize,
}

impl<'p> Steps<'p> {
    fn new(progress: &'p Mutex<WorkProgress>, phase: &'static str, total: usize) -> Self {
        let steps = Self { progress, phase, total, done: AtomicUsize::new(0) };
        steps.done(0);
        steps
    }

    fn done(&self, steps: usize) {
        let mut progress = self.progress.lock().unwrap_or_else(PoisonError::into_inner);
        let done = self.done.fetch_add(steps, Ordering::Relaxed) + steps;
        progress.steps(self.phase, done.min(self.total), self.total);
    }
}

/// Warns of nodes that the largest force cannot move, which a space of scattered positions omits. Fails if
/// none remains, or if every probe failed.
fn expect_movable(bench: &Analysis, nodes: &[NodePlan]) -> Result<(), Failure> {
    let why = |node: &NodePlan| {
        let why = node.probed.too_stiff.as_ref()?;
        Some(format!(
            "{}: active node {}: {why}",
            bench.path.display(),
            bench.scene.active[node.probed.active].name
        ))
    };
    let too_stiff: Vec<String> = nodes.iter().filter_map(why).collect();
    if let [first, ..] = &too_stiff[..]
        && too_stiff.len() == nodes.len()
    {
        return Err(Failure::input(first));
    }
    for node in too_stiff {
        eprintln!("palpate: warning: {node}; it is omitted");
    }
    let failed: usize = nodes.iter().map(|node| node.probed.failed).sum();
    if failed > 0 && failed == nodes.iter().map(|node| node.probed.far_s.len()).sum::<usize>() {
        return Err(Failure::work(format!(
            "{}: all {failed} probes failed; check the constants and units of the material, or take a smaller radius_m",
            bench.path.display()
        )));
    }
    Ok(())
}

/// The sampling parameters of a node's space.
fn wanted(
    sampling: &Sampling,
    max_force_n: f64,
    tolerance: Tolerance,
    (rest_m, normal): ([f64; 3], Option<[f64; 3]>),
) -> palpate_precompute::spec::Requirements {
    let scattered = sampling.scattered().copied().unwrap_or(palpate_precompute::spec::Scattered {
        radius_m: sampling.radius_m(),
        tolerance,
        only_push: false,
        workspace_m: None,
    });
    // An active node is on the surface. Without a normal, a pushing direction is undefined.
    scattered.wanted(max_force_n, rest_m, normal.unwrap_or_default())
}
