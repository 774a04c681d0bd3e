//! `palpate paper held-out`: solutions that no fit uses, solved into the `.space` file.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use clap::Args as ClapArgs;
use palpate_precompute::held_out::{Draw, HeldOut, HeldOutProgress, Summary};
use palpate_precompute::pipeline::Analysis;
use palpate_precompute::space::{Kind, Store, with_threads};
use serde_json::json;

use crate::analysis::{self, open_space, threads};
use crate::cmd::precompute::Workers;
use crate::failure::Failure;
use crate::files::{FileKind, Files, Output, Replace};
use crate::interrupt::stop_flag;
use crate::output;
use crate::progress::WorkProgress;

/// Solve held-out positions, which measure errors and which no fit uses.
///
/// Three kinds for every active node: regular paths from rest in 26 directions and random paths whose
/// direction turns slowly (both as in the paper), and uniform positions in the ball that can be reached (|h|
/// < f_max), each solved from the nearest corner of its cell. The space must be complete for the last kind.
/// Positions follow from the seed alone; a later run may add paths or positions, and existing ones are kept.
/// A path ends where a step fails or |h| reaches f_max.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// Scene file (TOML)
    pub scene: PathBuf,
    /// The .space file of the scene
    #[arg(long, value_name = "FILE.space")]
    out: PathBuf,
    /// Length of the regular paths, mm; 0 for none; r_G if not given
    #[arg(long, value_name = "MM")]
    regular_mm: Option<f64>,
    /// Random paths per active node
    #[arg(long, value_name = "N", default_value_t = Draw::PAPER.random)]
    random: u32,
    /// Steps of a random path
    #[arg(long, value_name = "N", default_value_t = Draw::PAPER.random_steps)]
    random_steps: u32,
    /// Uniform reachable positions per node
    ///
    /// If all of the 299 are within the tolerance, 99 % of the positions are, with 95 % confidence.
    #[arg(long, value_name = "N", default_value_t = Draw::PAPER.uniform)]
    uniform: u32,
    /// Length of a step, mm; 1, or r_G / 10 below 10 mm, if not given
    #[arg(long, value_name = "MM")]
    step_mm: Option<f64>,
    /// Seed of random paths and uniform positions
    #[arg(long, value_name = "SEED", default_value_t = Draw::PAPER.seed)]
    seed: u64,
    /// Discard the held-out solutions in the file and draw again
    ///
    /// Those of all active nodes.
    #[arg(long, conflicts_with = "active")]
    again: bool,
    /// Only this active node; all if not given
    #[arg(long, value_name = "NAME")]
    active: Option<String>,
    /// Worker threads; one per core if not given (palpate-mpi: one per rank)
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
}

/// Maximum number of nodes whose counts are printed.
const MAX_NODES: usize = 8;

impl Args {
    /// The output file, which must not be an input of the scene.
    pub(crate) fn space(&self) -> Result<Output, Failure> {
        let mut files = Files::new(Replace::default());
        files.read_scene(&self.scene)?;
        files.write("--out", &self.out, FileKind::Space)
    }
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let (stop, threads) = (stop_flag()?, threads(args.threads)?);
    let space = args.space()?;
    let bench = analysis::load_for(&args.scene, space.path())?;
    run_with(args, (&bench, &space), &stop, &Workers::threads(threads), |held_out, store, stop, progress| {
        Ok(with_threads(&bench.context()?, threads, |executor| {
            held_out.run(store, executor, stop, progress)
        })?)
    })
}

/// Runs the command with `team`; `work` solves the held-out solutions with it.
pub(crate) fn run_with(
    args: &Args,
    (bench, space): (&Analysis, &Output),
    stop: &AtomicBool,
    team: &Workers,
    work: impl FnOnce(&HeldOut, &Store, &AtomicBool, &mut dyn FnMut(&HeldOutProgress)) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let draw = draw(args, bench.sampling()?.radius_m())?;
    let chosen: Vec<usize> = match &args.active {
        Some(name) => vec![bench.active(Some(name))?.0],
        None => (0..bench.scene.active.len()).collect(),
    };
    if args.uniform > 0 && !args.out.exists() {
        return Err(Failure::input(format!(
            "{}: does not exist; uniform positions start from the solved space: run `palpate precompute` first, or --uniform 0",
            args.out.display()
        )));
    }
    let store = open_space(bench, space, false)?;
    if args.again {
        store.forget_held_out()?;
    }
    let start = Instant::now();
    let mut progress = WorkProgress::new(&bench.scene.name, "paths and positions");
    let mut last = HeldOutProgress::default();
    let solved = work(&bench.held_out(&chosen, draw.clone())?, &store, stop, &mut |p| {
        last = *p;
        progress.held_out(p);
    });
    progress.finish();
    solved.map_err(|failure| after(args.again, failure))?;
    let seconds = start.elapsed().as_secs_f64();
    let mut all = Vec::new();
    for &active in &chosen {
        all.push((bench.scene.active[active].name.as_str(), Summary::of(&store, active)?));
    }
    if args.json {
        let actives: Vec<_> = all
            .iter()
            .map(|(name, kinds)| {
                let kinds: BTreeMap<&str, &Summary> = kinds.iter().map(|(k, s)| (k.name(), s)).collect();
                json!({ "name": name, "kinds": kinds })
            })
            .collect();
        let figures = json!({ "space": args.out, "draw": draw.identity(), "actives": actives,
                              "positions_now": last.positions_now, "seconds": seconds, "threads": team.workers });
        return output::json(&figures);
    }
    output::line(format!(
        "{}: {} positions solved now in {seconds:.1} s {} ({})",
        args.out.display(),
        last.positions_now,
        team.words,
        draw.identity()
    ))?;
    for (number, (name, kinds)) in all.iter().enumerate() {
        let uniform = kinds.get(&Kind::Uniform).map_or(0, |sum| sum.whole);
        if uniform < draw.uniform {
            eprintln!(
                "palpate: warning: {name}: only {uniform} of {} uniform positions were found within f_max, in a thousand draws \
                 for each: almost none of the grid's ball is reachable",
                draw.uniform
            );
        }
        if number < MAX_NODES {
            output::line(in_words(&format!("{name}:"), kinds))?;
        }
    }
    if all.len() > MAX_NODES {
        let (more, out) = (all.len() - MAX_NODES, args.out.display());
        output::line(format!("and {more} more nodes: palpate inspect {out} --verbose"))?;
    }
    Ok(())
}

/// Adds a warning to a failure if `--again` has deleted the held-out solutions of the file: the same command
/// would also delete the new ones.
pub(crate) fn after(again: bool, failure: Failure) -> Failure {
    if again { failure.with("; omit --again, which would delete them") } else { failure }
}

fn draw(args: &Args, radius_m: f64) -> Result<Draw, Failure> {
    let positive = |flag: &str, mm: f64| -> Result<f64, Failure> {
        if mm > 0.0 && mm.is_finite() {
            return Ok(1e-3 * mm);
        }
        Err(Failure::input(format!("{flag} {mm}: give a positive number of millimetres")))
    };
    let regular_m = match args.regular_mm {
        Some(0.0) => None,
        Some(mm) => Some(positive("--regular-mm", mm)?),
        None => Some(radius_m),
    };
    let step_m = args.step_mm.map(|mm| positive("--step-mm", mm)).transpose()?;
    let draw = Draw {
        seed: args.seed,
        step_m: step_m.unwrap_or_else(|| Draw::default_step_m(radius_m)),
        regular_m,
        random: args.random,
        random_steps: args.random_steps.max(1),
        uniform: args.uniform,
    };
    draw.check(radius_m).map_err(Failure::input)?;
    Ok(draw)
}

/// Counts of one active node as text, one line each after `label`.
pub(crate) fn in_words(label: &str, kinds: &BTreeMap<Kind, Summary>) -> String {
    let mut lines = Vec::new();
    for (kind, s) in kinds {
        let reasons: Vec<String> = s.failed.iter().map(|(reason, n)| format!("{n} {reason}")).collect();
        let reasons = if reasons.is_empty() { String::new() } else { format!(" ({})", reasons.join(", ")) };
        let (what, whole) =
            if *kind == Kind::Uniform { ("positions", "within f_max") } else { ("paths", "whole") };
        lines.push(format!(
            "{label} {:7} {} {what}: {} {whole}, {} ended at f_max, {} failed{reasons}; {} solved, |h| up to {:.2} N, {} with \
             inverted elements, {} unstable, {} branch jumps",
            kind.name(),
            s.walks,
            s.whole,
            s.at_force_limit,
            s.failures(),
            s.positions,
            s.largest_n,
            s.inverted,
            s.unstable,
            s.switched
        ));
    }
    lines.join("\n")
}
