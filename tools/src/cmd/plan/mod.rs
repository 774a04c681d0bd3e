//! `palpate plan`: the cost of a scene, predicted before it is solved.
//!
//! [`probe`] solves some configurations on each active node. [`surrogate`] fits them by a body that is cheap
//! to evaluate. On it the adaptive sampling, the lattice's plan and the packer's fits run as on the real
//! body. [`tables`] measures the results. [`node`] combines them for a node, [`model`] for other
//! discretisations, [`row`] for the scene. [`check`] compares the predictions with later results.

mod check;
mod model;
mod node;
mod probe;
mod row;
pub(crate) mod surrogate;
pub(crate) mod tables;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::Args as ClapArgs;
use palpate_precompute::mesh::Surface;
use palpate_precompute::num::parallel::in_parallel;
use palpate_precompute::pipeline::Analysis;
use palpate_precompute::space::Store;
use palpate_precompute::spec::{Sampling, Tolerance};
use serde_json::json;

use self::check::Predicted;
use self::model::{Beside, Model};
use self::node::{METHODS, NodePlan, mean};
use self::probe::Order;
pub(crate) use self::probe::norm;
use self::row::{LINEAR, Row};
use crate::analysis::{self, threads};
use crate::cmd::inspect::certificate::significant;
use crate::failure::Failure;
use crate::interrupt::end_when_interrupted;
use crate::output;

/// Maximum number of probed nodes; the others are assumed to equal their mean.
const MOST_NODES: usize = 4;
/// Time limit for the probes of all nodes together, after each node has its minimum number.
const PATIENCE: Duration = Duration::from_millis(2400);
/// Cells along the radius of a step whose time is measured, for a scene without a lattice: those of the
/// paper's coarsest grid.
const CELLS_OF_A_STEP: f64 = 5.0;

/// Predict the cost of a scene before it is solved: configurations, seconds, memory, bytes, query time and
/// error of the reasonable choices.
///
/// A few probing solves on each active node (at most four nodes) measure stiffness, nonlinearity and the time
/// of a solve on this machine. The sampling, the plan and the fits of `precompute` and `pack` then run on a
/// surrogate that interpolates the probes. Errors are against the finite elements of the same model; the
/// column `stiffer` is the additional error of its discretisation.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// Scene file (TOML)
    scene: PathBuf,
    /// Worker threads of the plan and of the predicted work; one per core if not given
    #[arg(long)]
    threads: Option<usize>,
    /// A .space file solved from the scene: show predicted beside measured values
    #[arg(long, value_name = "FILE.space")]
    check: Option<PathBuf>,
    /// The .blob packed from it, for bytes, error and query time
    #[arg(long, value_name = "FILE.blob", requires = "check")]
    blob: Option<PathBuf>,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let begun = Instant::now();
    end_when_interrupted()?;
    let threads = threads(args.threads)?;
    let bench = analysis::load(&args.scene)?;
    let store = args.check.as_ref().map(|path| solved(&bench, path)).transpose()?;
    let plan = Plan::of(&bench, threads)?;
    let (rows, chosen, why) = plan.rows(&bench, threads);
    let compared = match &store {
        Some(store) => {
            let memory_bytes = rows.iter().find(|row| row.asked).map_or(f64::NAN, |row| row.memory_bytes);
            let predicted =
                Predicted { nodes: &plan.nodes, spacing_m: plan.spacing_m, skin: plan.skin, memory_bytes };
            Some(predicted.compare(store, args.blob.as_deref())?)
        }
        None => None,
    };
    let seconds = begun.elapsed().as_secs_f64();
    if args.json {
        let figures = json!({
            "scene": bench.scene.name, "threads": threads, "seconds": seconds, "nodes": plan.figures(&bench),
            "rows": rows, "recommended": rows[chosen], "why": why,
            "check": compared.map(|all| all.iter().map(|c| json!({
                "what": c.what, "predicted": c.predicted, "happened": c.happened, "unit": c.unit,
                "ratio": c.ratio(), "holds": c.holds(),
            })).collect::<Vec<_>>()),
        });
        return output::line(serde_json::to_string_pretty(&figures).map_err(Failure::work)?);
    }
    if let Some(all) = compared {
        return output::line(check::in_words(&all));
    }
    output::line(plan.in_words(&bench))?;
    output::line(row::table(&rows, threads))?;
    output::line(format!("Recommended: {}: {why}.", rows[chosen].in_words()))?;
    output::line(format!(
        "Seconds are on {threads} thread{} of this machine with its present load; ~ marks values extrapolated from coarser or smaller solves. Planned in \
         {seconds:.1} s",
        if threads == 1 { "" } else { "s" }
    ))
}

/// Opens the store at `path`, which must be that of the scene.
fn solved(bench: &Analysis, path: &Path) -> Result<Store, Failure> {
    let store = Store::open(path)?;
    if !bench.is_of(&store)? {
        return Err(Failure::input(format!(
            "{}: was solved for another scene than {}; give the scene that it was solved for",
            path.display(),
            bench.path.display()
        )));
    }
    Ok(store)
}

/// All results.
struct Plan {
    nodes: Vec<NodePlan>,
    besides: Vec<Beside>,
    tolerance: Tolerance,
    spacing_m: Option<f64>,
    skin: [usize; 2],
    has_pressure: bool,
}

impl Plan {
    fn of(bench: &Analysis, threads: usize) -> Result<Self, Failure> {
        let (scene, sampling) = (&bench.scene, bench.sampling()?);
        let surface = Surface::of(&scene.mesh).seen(&scene.mesh);
        let tolerance =
            sampling.scattered().map_or(Tolerance::CANNOT_BE_FELT, |scattered| scattered.tolerance);
        let positions: Vec<[f64; 3]> =
            scene.active.iter().map(|a| bench.body.rest_position_m(a.node)).collect();
        let chosen = node::spread(&positions, MOST_NODES);
        let share = (threads as f64 / chosen.len() as f64).min(1.0);
        let orders: Vec<Order> = chosen
            .iter()
            .map(|&active| Order {
                active,
                problem: bench.problem(&scene.active[active]),
                wanted: wanted(
                    &sampling,
                    scene.max_force_n,
                    tolerance,
                    (positions[active], surface.normal(scene.active[active].node)),
                ),
                surface: if scene.visual { surface.nodes.clone() } else { Vec::new() },
                step_m: sampling
                    .lattice()
                    .map_or(sampling.radius_m() / CELLS_OF_A_STEP, |l| l.grid.spacing_m),
                patience: PATIENCE.mul_f64(share),
            })
            .collect();
        let bound = scene.visual.then_some(scene.displacement_bound);
        let planned = in_parallel(&orders, threads, |order| node::plan(order, &sampling, bound))
            .map_err(Failure::work)?;
        let nodes = planned.into_iter().collect::<Result<Vec<NodePlan>, Failure>>()?;
        if sampling.scattered().is_some() {
            expect_movable(bench, &nodes)?;
        }
        let has_pressure = bench.body.has_pressure();
        let first = &nodes[0].probed;
        let others = Model::of(scene).others(has_pressure);
        let besides =
            in_parallel(&others, threads, |&other| model::beside(scene, first.active, other, first))
                .map_err(Failure::work)?;
        Ok(Self {
            besides: besides.into_iter().flatten().collect(),
            nodes,
            tolerance,
            spacing_m: sampling.lattice().map(|lattice| lattice.grid.spacing_m),
            skin: [surface.nodes.len(), surface.triangles.len()],
            has_pressure,
        })
    }

    /// Stiffness relative to that of quadratic elements, minus 1.
    fn stiffer(&self, stiffness_n_m: f64, order: u8) -> Option<f64> {
        let quadratic = || self.besides.iter().find(|b| b.model.order == 2)?.stiffness_n_m;
        let reference = if order == 2 { Some(self.stiffness_n_m()) } else { quadratic() };
        reference.map(|reference| stiffness_n_m / reference - 1.0)
    }

    /// Mean stiffness at rest of the first node with the scene's model, N/m.
    fn stiffness_n_m(&self) -> f64 {
        self.nodes[0].probed.jets[0].stiffness_n_m.trace() / 3.0
    }

    /// All rows, the recommended row, and the reason for it.
    fn rows(&self, bench: &Analysis, threads: usize) -> (Vec<Row>, usize, String) {
        let (scene, all) = (&bench.scene, bench.scene.active.len() as f64);
        let own = Model::of(scene);
        let of_all = |figure: &dyn Fn(&NodePlan) -> f64| {
            all * mean(&self.nodes.iter().map(figure).collect::<Vec<_>>())
        };
        let size = self.nodes[0].probed.size;
        let tets = scene.mesh.tets.len();
        let memory_bytes = model::memory_bytes(tets, scene.order, size, threads);
        // A replacement lattice has no fit.
        let fitted = |node: &NodePlan| node.choices[0].configurations.min(node.probed.wanted.most as f64);
        let counts: Vec<f64> = self.nodes.iter().map(fitted).collect();
        let fits_bytes = model::loop_bytes(&counts, threads);
        let mut rows = Vec::new();
        for n in 0..self.nodes[0].choices.len() {
            let choice = &self.nodes[0].choices[n];
            for method in METHODS {
                let found = |node: &NodePlan| node.choices[n].of(method.name());
                let figures: Vec<_> = self.nodes.iter().filter_map(found).collect();
                if figures.len() < self.nodes.len() {
                    continue;
                }
                let other = tables::other_bytes(self.skin, scene.active.len(), Some(1)) as f64;
                rows.push(Row {
                    model: own.words(self.has_pressure).into(),
                    spacing_m: choice.spacing_m,
                    method: method.name(),
                    configurations: of_all(&|node| node.choices[n].configurations),
                    solving_s: of_all(&|node| node.choices[n].solving_s),
                    memory_bytes: memory_bytes + if choice.spacing_m.is_some() { 0.0 } else { fits_bytes },
                    blob_bytes: other
                        + of_all(&|node| node.choices[n].bytes(&[method], node.eye.as_ref()) as f64),
                    nanoseconds: figures.iter().map(|(_, ns)| *ns).fold(0.0, f64::max),
                    p99_n: figures.iter().map(|(error, _)| error.p99_n).fold(0.0, f64::max),
                    within: figures.iter().map(|(error, _)| error.within).fold(1.0, f64::min),
                    stiffer: self.stiffer(self.stiffness_n_m(), own.order),
                    asked: choice.spacing_m == self.spacing_m && method == palpate_core::Method::Energy,
                    recommended: false,
                    extrapolated: !choice.built,
                });
            }
        }
        let linear = rows.first().map(|first| Row {
            model: LINEAR.into(),
            configurations: of_all(&|node| node.linear_configurations),
            // One iteration and its derivatives: the solve at rest.
            solving_s: of_all(&|node| node.linear_configurations * node.probed.rest_s),
            p99_n: self.nodes.iter().map(|node| node.linear.p99_n).fold(0.0, f64::max),
            within: self.nodes.iter().map(|node| node.linear.within).fold(1.0, f64::min),
            asked: false,
            ..first.clone()
        });
        rows.extend(
            linear.filter(|row| bench.body.law_names() != "linear" && row.configurations.is_finite()),
        );
        let (chosen, mut why) = row::recommend(&mut rows, self.tolerance_in_words());
        for beside in &self.besides {
            let stiffer = beside.stiffness_n_m.and_then(|s| match beside.model.order {
                2 => Some(0.0),
                order => self.stiffer(s, if own.order == 2 { 2 } else { order }),
            });
            let memory = rows[chosen].memory_bytes
                + threads as f64 * (beside.memory - 1.0) * model::solver_bytes(size);
            let row = rows[chosen].with(beside.model.words(self.has_pressure), beside, stiffer, memory);
            why.push_str(&row.speaks_against(&rows[chosen]));
            rows.push(row);
        }
        let given_up: Vec<&str> = self
            .nodes
            .iter()
            .filter(|node| !node.choices[0].passed)
            .map(|node| scene.active[node.probed.active].name.as_str())
            .collect();
        if !given_up.is_empty() {
            why.push_str(&format!(
                "; adaptive sampling would not reach the tolerance at {}: the counts include the lattice that replaces it",
                given_up.join(", ")
            ));
        }
        let count = |figure: fn(&NodePlan) -> usize| self.nodes.iter().map(figure).sum::<usize>();
        let (lost, probes) = (count(|n| n.probed.lost), count(|n| n.probed.far_s.len() + n.probed.lost));
        let (forked, again) = (count(|n| n.probed.forked), count(|n| n.probed.again));
        let mut signs = Vec::new();
        if lost > 0 {
            signs.push(format!("{lost} of {probes} probes found no solution on their branch"));
        }
        if forked > 0 {
            signs.push(format!(
                "{forked} of {again} probes have another solution when they are solved from another start"
            ));
        }
        if !signs.is_empty() {
            why.push_str(&format!(
                "; BUT {}: the space has branch jumps, a lattice will replace adaptive sampling, and counts and errors cannot be \
                 predicted; a smaller radius_m would help",
                signs.join(", and ")
            ));
        }
        (rows, chosen, why)
    }

    fn tolerance_in_words(&self) -> &'static str {
        if self.tolerance == Tolerance::CANNOT_BE_FELT { "the JND of force" } else { "the scene's tolerance" }
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
                "  {}: {:.0} N/m at rest; {} probes reach {:.0} to {:.0} mm ({} beyond f_max, {} lost, {} of {} forked), {:.2} s each; error of a linear body \
                 {:.0} mN (p99)\n",
                scene.active[probed.active].name,
                probed.jets[0].stiffness_n_m.trace() / 3.0,
                probed.far_s.len(),
                1e3 * near,
                1e3 * far,
                probed.beyond,
                probed.lost,
                probed.forked,
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
                            "table_spacing_m": c.grid.spacing_m, "built": c.built, "passed": c.passed, "methods": methods })
                })
                .collect();
            json!({
                "name": bench.scene.active[probed.active].name, "probes": probed.far_s.len(), "lost": probed.lost,
                "beyond": probed.beyond, "again": probed.again, "forked": probed.forked, "reach_m": probed.reach_m(), "rest_s": probed.rest_s, "far_s": probed.far_s,
                "near_s": probed.near_s, "unknowns": probed.size[0], "entries": probed.size[1], "factor": probed.size[2],
                "linear_p99_n": linear.p99_n, "linear_within": linear.within, "eye": eye, "choices": choices,
            })
        };
        json!(self.nodes.iter().map(of).collect::<Vec<_>>())
    }
}

/// Warns of nodes that the largest force cannot move, which a space of scattered positions omits. Fails if
/// none remains.
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
    Ok(())
}

/// The sampling parameters of a node's space.
fn wanted(
    sampling: &Sampling,
    max_force_n: f64,
    tolerance: Tolerance,
    (rest_m, normal): ([f64; 3], Option<[f64; 3]>),
) -> palpate_precompute::spec::Wanted {
    let scattered = sampling.scattered().copied().unwrap_or(palpate_precompute::spec::Scattered {
        radius_m: sampling.radius_m(),
        tolerance,
        only_push: false,
        workspace_m: None,
    });
    // An active node is on the surface. Without a normal, a pushing direction is undefined.
    scattered.wanted(max_force_n, rest_m, normal.unwrap_or_default())
}
