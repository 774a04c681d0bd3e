//! `palpate precompute`: solves the configuration spaces of a scene into a `.space` file.

use std::path::PathBuf;
use std::time::Instant;

use clap::Args as ClapArgs;

use crate::failure::Failure;
use crate::output;
use crate::progress::SpaceProgress;
use crate::workbench::{Workbench, stop_flag, threads};

/// Solve the configuration spaces of a scene into a .space file.
///
/// Every finished configuration is kept at once: stop with Ctrl-C (or lose power) and run the same command again to
/// go on. The numbers do not depend on the number of threads nor on interruptions.
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
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let bench = Workbench::load(&args.scene)?;
    let chosen: Vec<usize> = match &args.active {
        Some(name) => vec![bench.active(Some(name))?.0],
        None => (0..bench.scene.active.len()).collect(),
    };
    let store = bench.store(&args.out)?;
    let stop = stop_flag()?;
    for index in chosen {
        let expansion = bench.expansion(index, threads(args.threads))?;
        let name = &bench.scene.active[index].name;
        let start = Instant::now();
        let mut progress = SpaceProgress::new(name, expansion.total());
        let mut solved_now = 0;
        let counts = expansion.run(&store, &stop, |p| {
            solved_now = p.solved_now;
            progress.update(p);
        });
        progress.finish();
        let counts = counts?;
        output::line(format!(
            "{name}: {} of {} points solved ({} reachable, {} beyond f_max), {} failed, {} not reached; {} solved now \
             in {:.1} s on {} threads",
            counts.solved(),
            expansion.total(),
            counts.expandable,
            counts.terminating,
            counts.failed,
            counts.unknown,
            solved_now,
            start.elapsed().as_secs_f64(),
            expansion.threads
        ))?;
    }
    output::line(format!("{}", args.out.display()))?;
    Ok(())
}
