//! `palpate precompute`: solves the configuration spaces of a scene into a `.space` file.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use clap::Args as ClapArgs;
use palpate_precompute::configuration_space::TagCounts;
use serde_json::json;

use crate::failure::Failure;
use crate::output;
use crate::progress::WorkProgress;
use crate::workbench::{Workbench, stop_flag, threads};

/// Solve the configuration spaces of a scene into a .space file.
///
/// Every finished configuration is kept within a second: stop with Ctrl-C (or lose power) and run the same command again to
/// go on. The numbers do not depend on the number of threads nor on interruptions. A point that cannot be solved from its
/// parent is tried from its other neighbours; neighbours that seem to lie on different branches are solved again, and the
/// lower energy is kept.
///
/// With `complete_cells` in the grid (the default) the corners outside the radius of the cells that reach into it are solved too.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// Scene file (TOML)
    scene: PathBuf,
    /// The .space file to write or to go on with
    #[arg(long)]
    out: PathBuf,
    /// Worker threads; one a core if not given
    #[arg(long)]
    threads: Option<usize>,
    /// Only this active node; all if not given
    #[arg(long)]
    active: Option<String>,
    /// The file is damaged: save what is intact into a new one, keep the old one beside it, and go on
    #[arg(long)]
    salvage: bool,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let bench = Arc::new(Workbench::load(&args.scene)?);
    let chosen: Vec<usize> = match &args.active {
        Some(name) => vec![bench.active(Some(name))?.0],
        None => (0..bench.scene.active.len()).collect(),
    };
    let points = bench.expansion(vec![0])?.total();
    let store = bench.store(&args.out, args.salvage)?;
    let (stop, threads) = (stop_flag()?, threads(args.threads));
    let start = Instant::now();
    let mut progress = WorkProgress::new(&bench.scene.name, "points");
    let mut solved_now = 0;
    let counts = bench.expand(chosen.clone(), &store, threads, &stop, |p| {
        solved_now = p.solved_now;
        progress.spaces(p);
    });
    progress.finish();
    let counts = counts?;
    let seconds = start.elapsed().as_secs_f64();
    let names: Vec<&str> = chosen.iter().map(|&i| bench.scene.active[i].name.as_str()).collect();
    if args.json {
        let spaces: Vec<_> = names
            .iter()
            .zip(&counts)
            .map(|(name, c)| {
                json!({ "name": name, "points": points, "expandable": c.expandable, "terminating": c.terminating,
                        "failed": c.failed, "unknown": c.unknown })
            })
            .collect();
        let figures = json!({ "space": args.out, "spaces": spaces, "solved_now": solved_now, "seconds": seconds,
                              "threads": threads });
        return output::line(serde_json::to_string_pretty(&figures).map_err(Failure::work)?);
    }
    for (name, counts) in names.iter().zip(&counts) {
        output::line(format!("{name}: {}", in_words(counts, points)))?;
    }
    output::line(format!(
        "{}: {solved_now} solved now in {seconds:.1} s on {threads} threads",
        args.out.display()
    ))
}

/// Points by tag, for people.
pub(crate) fn in_words(counts: &TagCounts, points: usize) -> String {
    format!(
        "{} of {points} points solved ({} reachable, {} beyond f_max), {} failed, {} not reached",
        counts.solved(),
        counts.expandable,
        counts.terminating,
        counts.failed,
        counts.unknown
    )
}
