//! `palpate precompute`: solves the configuration spaces of a scene into a `.space` file.

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use clap::Args as ClapArgs;
use palpate_precompute::adaptive::Verdict;
use palpate_precompute::pipeline::{Analysis, complete_charts};
use palpate_precompute::space::{
    ExpansionError, Progress, Store, TagCounts, Threads, expand, state, with_threads,
};
use serde_json::json;

use super::inspect::scattered;
use crate::analysis::{self, open_space, threads};
use crate::failure::Failure;
use crate::files::{FileKind, Files, Output, Replace};
use crate::interrupt::stop_flag;
use crate::progress::WorkProgress;
use crate::{memory, output};

/// Solve the configuration spaces of a scene into a .space file.
///
/// Every finished configuration is saved within a second. After Ctrl-C or a power loss, run the same command
/// again to continue. The numbers depend neither on the number of threads nor on interruptions. A point that
/// fails from its parent is solved from its other neighbours. Neighbours on apparently different branches are
/// solved again, and the lower energy is kept.
///
/// With a tolerance in the grid instead of a spacing (`cannot_be_felt = true`, `tolerance_n`,
/// `tolerance_relative`) adaptive sampling chooses the positions: each is predicted before it is solved, and
/// solving ends when the predictions hold. Where the predicted errors do not fall, the force has branch
/// jumps, and a lattice replaces it. `palpate plan` predicts both costs.
///
/// With `complete_cells` in the grid (the default) the corners outside the radius of the cells that reach
/// into it are solved too.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// Scene file (TOML), or a .space file to continue, which holds its scene
    pub scene: PathBuf,
    /// The .space file to write or to continue
    #[arg(long, value_name = "FILE.space")]
    out: Option<PathBuf>,
    /// Only this active node; all if not given
    #[arg(long, value_name = "NAME")]
    active: Option<String>,
    /// Worker threads; one per core if not given (palpate-mpi: one per rank)
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    /// Continue a damaged file from its intact part
    ///
    /// The intact part is saved into a new file, and the old one is kept beside it.
    #[arg(long)]
    salvage: bool,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
}

/// Maximum number of nodes whose counts are printed.
const MAX_NODES: usize = 12;

/// The workers.
#[derive(Debug)]
pub(crate) struct Workers {
    /// Number of jobs in progress at once.
    pub workers: usize,
    /// "on 2 threads", for messages.
    pub words: String,
    /// Whether this process does all the work, so that its memory is that of the work.
    alone: bool,
}

impl Workers {
    /// Threads of this process.
    pub(crate) fn threads(threads: usize) -> Self {
        Self { workers: threads, words: format!("on {}", counted(threads, "thread")), alone: true }
    }

    /// Threads of other ranks.
    #[cfg(feature = "mpi")]
    pub(crate) fn ranks(threads: usize, ranks: usize) -> Self {
        let words = format!("on {} of {} and rank 0", counted(threads, "thread"), counted(ranks, "rank"));
        Self { workers: threads, words, alone: false }
    }
}

fn counted(n: usize, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}

impl Args {
    /// The output file, which must not be an input of the scene.
    pub(crate) fn space(&self) -> Result<Output, Failure> {
        let mut files = Files::new(Replace::default());
        let shown = self.scene.display();
        match (&self.out, analysis::is_space(&self.scene)) {
            (None, true) => Ok(files.update_space(&self.scene)),
            (Some(_), true) => {
                Err(Failure::input(format!("{shown}: is continued where it is; leave out --out")))
            }
            (None, false) => Err(Failure::input(format!("{shown}: give --out FILE.space"))),
            (Some(out), false) => {
                files.read_scene(&self.scene)?;
                files.write("--out", out, FileKind::Space)
            }
        }
    }
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let (stop, threads) = (stop_flag()?, threads(args.threads)?);
    let space = args.space()?;
    let bench = analysis::load_for(&args.scene, space.path())?;
    run_with(args, (&bench, &space), &stop, &Workers::threads(threads), |actives, store, stop, progress| {
        let run = |executor: &mut Threads| expand(actives, store, executor, stop, progress);
        with_threads(&bench.context()?, threads, run).map_err(|error| of_scene(&bench, error))
    })
}

/// A failed expansion, with the scene file if the scene is unusable.
pub(crate) fn of_scene(bench: &Analysis, error: ExpansionError) -> Failure {
    match error {
        ExpansionError::Rest(_) => Failure::input(format!("{}: {error}", bench.path.display())),
        error => error.into(),
    }
}

/// Runs the command with `team`; `work` expands the spaces of these active nodes with it. A new file is removed
/// if the scene turns out to be unusable.
pub(crate) fn run_with(
    args: &Args,
    (bench, space): (&Analysis, &Output),
    stop: &AtomicBool,
    team: &Workers,
    work: impl FnOnce(&[usize], &Store, &AtomicBool, &mut dyn FnMut(&Progress)) -> Result<Vec<TagCounts>, Failure>,
) -> Result<(), Failure> {
    let is_new = !space.path().exists();
    let store = open_space(bench, space, args.salvage)?;
    let ended = solve(args, (bench, &store), stop, team, work);
    // While the store is open, no other process uses the file.
    if is_new && matches!(ended, Err(Failure::Input(_))) {
        for suffix in ["", "-wal", "-shm"] {
            let _ = std::fs::remove_file(format!("{}{suffix}", space.path().display()));
        }
    }
    ended
}

fn solve(
    args: &Args,
    (bench, store): (&Analysis, &Store),
    stop: &AtomicBool,
    team: &Workers,
    work: impl FnOnce(&[usize], &Store, &AtomicBool, &mut dyn FnMut(&Progress)) -> Result<Vec<TagCounts>, Failure>,
) -> Result<(), Failure> {
    let chosen: Vec<usize> = match &args.active {
        Some(name) => vec![bench.active(Some(name))?.0],
        None => (0..bench.scene.active.len()).collect(),
    };
    let start = Instant::now();
    let points = bench.sampling()?.points();
    let mut progress = WorkProgress::new(&bench.scene.name, "solves");
    let mut solved_now = 0;
    let counts = work(&chosen, store, stop, &mut |p| {
        solved_now = p.solved_now;
        progress.spaces(p);
    });
    let counts = counts?;
    if bench.scene.charts.is_some() {
        progress.phase("the charts with those round them");
    }
    complete_charts(store, team.workers)?;
    progress.finish();
    let seconds = start.elapsed().as_secs_f64();
    let peak_bytes = memory::peak_bytes().filter(|_| team.alone && solved_now > 0);
    if let Some(bytes) = peak_bytes {
        store.note_peak(bytes)?;
    }
    let names: Vec<&str> = chosen.iter().map(|&i| bench.scene.active[i].name.as_str()).collect();
    expect_movable(bench, store, &chosen, &counts)?;
    expect_solved(bench, store, &chosen, &counts)?;
    if args.json {
        let spaces: Vec<_> = names
            .iter()
            .zip(&counts)
            .map(|(name, c)| {
                json!({ "name": name, "points": points, "expandable": c.expandable, "terminating": c.terminating,
                        "failed": c.failed, "unknown": c.unknown })
            })
            .collect();
        let figures = json!({ "space": store.path(), "spaces": spaces, "solved_now": solved_now, "seconds": seconds,
                              "unreachable": bench.scene.unreachable, "threads": team.workers, "peak_bytes": peak_bytes });
        return output::json(&figures);
    }
    let peak = peak_bytes.map_or(String::new(), |bytes| format!(", at most {} MB", bytes / 1_000_000));
    let all: usize = counts.iter().map(TagCounts::solved).sum();
    let out = store.path().display();
    output::line(format!(
        "{out}: {all} configurations, {solved_now} solved now in {seconds:.1} s {}{peak}",
        team.words
    ))?;
    if bench.scene.unreachable.any() {
        output::line(bench.scene.unreachable)?;
    }
    for (number, ((name, counts), active)) in names.iter().zip(&counts).zip(&chosen).enumerate() {
        if number < MAX_NODES {
            output::line(format!("{name}: {}", in_words(counts, points)))?;
        }
        let Some(fit) = state(store, *active)?.fit else { continue };
        let what = match fit.verdict {
            Some(Verdict::Linear) => {
                if number < MAX_NODES {
                    output::line(format!("{name}: {}", scattered::in_words(&fit.linear)))?;
                }
                continue;
            }
            Some(Verdict::Stagnated) => {
                "adaptive sampling stagnated at a branch jump, and a lattice replaced it; `palpate pack` measures its error. Use a smaller \
                 radius_m"
            }
            Some(Verdict::NotReached) => {
                "the predictions are not within the tolerance; `palpate pack` measures the error. Use a smaller radius_m, or a lattice \
                 (`spacing_m`), which shows where branch jumps are"
            }
            _ => continue,
        };
        eprintln!("palpate: warning: {name}: {what}");
    }
    if names.len() > MAX_NODES {
        output::line(format!("and {} more nodes: palpate inspect {out}", names.len() - MAX_NODES))?;
    }
    Ok(())
}

/// Warns of nodes that the device cannot move, which have no space. Fails if there are no other nodes.
fn expect_movable(
    bench: &Analysis,
    store: &Store,
    chosen: &[usize],
    counts: &[TagCounts],
) -> Result<(), Failure> {
    let mut too_stiff = Vec::new();
    for (&active, _) in chosen.iter().zip(counts).filter(|(_, counts)| counts.solved() + counts.failed == 0) {
        let Some(fit) = state(store, active)?.fit else { continue };
        if fit.verdict == Some(Verdict::TooStiff) {
            too_stiff.push(format!("{}: {}", bench.scene.active[active].name, fit.too_stiff_in_words()));
        }
    }
    if let [first, ..] = &too_stiff[..]
        && too_stiff.len() == chosen.len()
    {
        return Err(Failure::input(format!("{}: active node {first}", bench.path.display())));
    }
    for node in too_stiff {
        eprintln!("palpate: warning: {node}; it is omitted");
    }
    Ok(())
}

/// Fails if every solve of every node failed.
fn expect_solved(
    bench: &Analysis,
    store: &Store,
    chosen: &[usize],
    counts: &[TagCounts],
) -> Result<(), Failure> {
    let failed: usize = counts.iter().map(|counts| counts.failed).sum();
    if failed == 0 || counts.iter().any(|counts| counts.solved() > 0) {
        return Ok(());
    }
    let attempts = store.attempts(chosen[0])?;
    let why = attempts.iter().rev().find_map(|attempt| attempt.result.as_ref().err());
    Err(Failure::work(format!(
        "{}: all {failed} solves failed (the last one: {}); check the constants and units of the material, or take a \
         smaller radius_m",
        bench.path.display(),
        why.map_or("unknown", |why| why)
    )))
}

/// Points by tag, as text.
pub(crate) fn in_words(counts: &TagCounts, points: Option<usize>) -> String {
    let (of, behind) = match points {
        Some(points) => (format!(" of {points} points"), format!(", {} not reached", counts.unknown)),
        None => (" configurations of adaptive sampling".into(), String::new()),
    };
    format!(
        "{}{of} solved ({} reachable, {} beyond f_max), {} failed{behind}",
        counts.solved(),
        counts.expandable,
        counts.terminating,
        counts.failed
    )
}
