//! `palpate bench fidelity`: whether a coarser mesh beneath the blind loop pays.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use clap::Args as ClapArgs;
use palpate_precompute::adaptive::{Alone, alone};
use palpate_precompute::fem::solve::Solver;
use palpate_precompute::fit::KernelFit;
use palpate_precompute::pipeline::Analysis;
use palpate_precompute::spec::Wanted;
use serde::Serialize;

use super::sampling::Case;
use crate::analysis;
use crate::cmd::plan::norm;
use crate::cmd::plan::tables::Place;
use crate::failure::Failure;
use crate::output;

/// Whether a coarser mesh beneath the blind loop pays: the same space with and without it, in one run, one thread.
///
/// The mesh is as fine as it was at the active node and grows coarse away from it. Its space is learned first; the loop on the whole mesh then learns
/// by how much the energies differ.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// Scenes whose sampling is driven by the error
    #[arg(required = true)]
    scenes: Vec<PathBuf>,
    /// Edges of the coarser mesh by their distance from the active node
    #[arg(long, value_name = "SHARE", value_delimiter = ',', default_value = "0.3,0.5,0.8")]
    grade: Vec<f64>,
    /// Only these active nodes, by their number in the scene
    #[arg(long, value_name = "N", value_delimiter = ',')]
    active: Vec<usize>,
    /// Fresh positions a node
    #[arg(long, value_name = "N", default_value_t = 100)]
    uniform: usize,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
}

/// One way to a space.
#[derive(Debug, Clone, Serialize)]
struct Way {
    /// Of the coarser mesh; none without one.
    grade: Option<f64>,
    /// Nodes, configurations and seconds of the coarser mesh.
    coarse: Option<(usize, usize, f64)>,
    /// Configurations of the whole mesh, and seconds.
    configurations: usize,
    seconds: f64,
    verdict: String,
    /// Share of the positions within the tolerance.
    within: f64,
}

/// What was found of a node.
#[derive(Debug, Clone, Serialize)]
struct Row {
    scene: String,
    active: String,
    nodes: usize,
    positions: usize,
    ways: Vec<Way>,
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let benches = args.scenes.iter().map(|path| analysis::load(path)).collect::<Result<Vec<_>, _>>()?;
    for bench in &benches {
        for active in 0..bench.scene.active.len() {
            if args.active.is_empty() || args.active.contains(&active) {
                let row = measured(&Case { bench, active }, args)?;
                output::line(if args.json {
                    serde_json::to_string(&row).map_err(Failure::work)?
                } else {
                    row.in_words()
                })?;
            }
        }
    }
    Ok(())
}

fn measured(case: &Case<'_>, args: &Args) -> Result<Row, Failure> {
    let (wanted, scene) = (case.wanted()?, &case.bench.scene);
    let (own, seconds) = timed(case.solver(), wanted, None)?;
    let places = case.truths(&own, &wanted, args.uniform);
    let mut ways = vec![Way::of(&own, seconds, &places, None)];
    for &grade in &args.grade {
        let coarser = Analysis::of_scene(&case.bench.path, scene.coarsened(case.active, grade))?;
        let nodes = coarser.scene.mesh.nodes_m.len();
        let solver = Solver::new(coarser.problem(&coarser.scene.active[0]));
        let (under, under_s) = timed(solver, wanted.of_a_cheaper_body(), None)?;
        let coarse = (nodes, under.solved, under_s);
        let (over, seconds) = timed(case.solver(), wanted, Some(Arc::new(under.search.fit().as_it_is())))?;
        ways.push(Way::of(&over, seconds, &places, Some((grade, coarse))));
    }
    Ok(Row {
        scene: scene.name.clone(),
        active: scene.active[case.active].name.clone(),
        nodes: scene.mesh.nodes_m.len(),
        positions: places.len(),
        ways,
    })
}

fn timed(mut solver: Solver, wanted: Wanted, under: Option<Arc<KernelFit>>) -> Result<(Alone, f64), Failure> {
    let begun = Instant::now();
    let done = alone(&mut solver, wanted, under).map_err(Failure::work)?;
    Ok((done, begun.elapsed().as_secs_f64()))
}

impl Way {
    fn of(done: &Alone, seconds: f64, places: &[Place], coarse: Option<(f64, (usize, usize, f64))>) -> Self {
        let (fit, tolerance) = (done.search.fit(), done.search.wanted().tolerance);
        let error = |place: &Place| {
            let found = fit.force_n(place.at);
            norm(std::array::from_fn(|i| found[i] - place.exact[i]))
        };
        let within = places.iter().filter(|place| error(place) <= tolerance.at(place.exact)).count();
        Self {
            grade: coarse.map(|(grade, _)| grade),
            coarse: coarse.map(|(_, coarse)| coarse),
            configurations: done.solved,
            seconds,
            verdict: format!("{:?}", done.verdict).to_lowercase(),
            within: within as f64 / places.len().max(1) as f64,
        }
    }
}

impl Row {
    fn in_words(&self) -> String {
        let Self { scene, active, nodes, positions, ways } = self;
        let mut text = format!("{scene} {active}: {nodes} nodes, {positions} fresh positions");
        let alone_s = ways[0].seconds;
        for Way { grade, coarse, configurations, seconds, verdict, within } in ways {
            let (under, all_s) = match (grade, coarse) {
                (Some(grade), Some((nodes, solved, s))) => (
                    format!("over {nodes:>4} nodes (grade {grade}): {solved:>3} in {s:>5.2} s, then"),
                    seconds + s,
                ),
                _ => ("alone:".into(), *seconds),
            };
            text += &format!(
                "\n  {under:<48} {configurations:>3} in {seconds:>6.2} s, {verdict}, {:.1} % within; {:.2} of the time alone",
                100.0 * within,
                all_s / alone_s
            );
        }
        text
    }
}
