//! `palpate bench space`: cost of configuration spaces on this machine.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use clap::Args as ClapArgs;
use palpate_precompute::fem::material::{Lame, Material, MooneyRivlin, StVenantKirchhoff};
use palpate_precompute::pipeline::Run;
use palpate_precompute::spec::{Lattice, Sampling, SpaceGrid};
use serde::Serialize;

use super::common::{Out, assets};
use crate::analysis::{self, open_space, threads};
use crate::failure::Failure;
use crate::files::Output;
use crate::interrupt::stop_flag;
use crate::memory::{forget_peak, peak_mb, shown};
use crate::output;
use crate::progress::WorkProgress;

/// Measure time, memory and iterations of whole configuration spaces (paper, Fig. 7).
///
/// The body is the bundled organ: A1, F1, r_G = 5 cm, cells completed, no force limit.
///
/// Every space is a separate temporary file under --dir. Ctrl-C ends the run without results, because a
/// resumed run would not measure the whole time.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// Folder with liver-small.toml and liver-large.toml
    #[arg(long, value_name = "DIR", default_value = "assets")]
    assets: PathBuf,
    /// Cases as body-law-points: small or large, mr or stvk, and 514, 1418, 4168 or 14146
    #[arg(long, value_name = "A,B", value_delimiter = ',', default_value = "small-mr-514,large-mr-514")]
    cases: Vec<String>,
    /// Numbers of worker threads, one table row each; all cores if not given
    #[arg(long, value_name = "N,M", value_delimiter = ',')]
    threads: Vec<usize>,
    /// Folder for the temporary spaces
    #[arg(long, value_name = "DIR")]
    dir: Option<PathBuf>,
    #[command(flatten)]
    out: Out,
}

/// Figures of one space.
#[derive(Debug, Serialize)]
struct Row {
    case: String,
    threads: usize,
    points: usize,
    solved: usize,
    failed: usize,
    /// Number of attempts, including those from other neighbours.
    tries: usize,
    seconds: f64,
    per_second: f64,
    iterations: f64,
    factorisations: f64,
    /// Share of the workers' time that is spent solving.
    busy: f64,
    branch_jumps: usize,
    peak_mb: Option<u64>,
    store_mb: f64,
}

/// A parsed case.
struct Case {
    scene: &'static str,
    law: Material,
    cells: f64,
}

fn case(name: &str) -> Result<Case, Failure> {
    let unknown = || Failure::input(format!("no case `{name}`; give body-law-points, as in small-mr-514"));
    let [body, law, points] = name.split('-').collect::<Vec<_>>()[..] else { return Err(unknown()) };
    Ok(Case {
        scene: match body {
            "small" => "liver-small",
            "large" => "liver-large",
            _ => return Err(unknown()),
        },
        law: match law {
            "mr" => Material::MooneyRivlin(MooneyRivlin { c10_pa: 1300.0, c01_pa: 1280.0 }),
            "stvk" => Material::StVenantKirchhoff(StVenantKirchhoff {
                lame: Lame::from_young_poisson(15480.0, 0.49),
            }),
            _ => return Err(unknown()),
        },
        cells: match points {
            "514" => 5.0,
            "1418" => 7.0,
            "4168" => 10.0,
            "14146" => 15.0,
            _ => return Err(unknown()),
        },
    })
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let cases = args.cases.iter().map(|name| Ok((name, case(name)?))).collect::<Result<Vec<_>, Failure>>()?;
    let out = args.out.ready(assets(&args.assets).iter().map(PathBuf::as_path))?;
    let crews: Vec<usize> = match &args.threads[..] {
        [] => vec![threads(None)?],
        given => given.iter().map(|&n| threads(Some(n))).collect::<Result<_, _>>()?,
    };
    let dir = match &args.dir {
        Some(dir) => tempfile::tempdir_in(dir),
        None => tempfile::tempdir(),
    }
    .map_err(|error| Failure::input(format!("no temporary folder: {error}; give a folder with --dir")))?;
    let stop = stop_flag()?;
    let mut rows = Vec::new();
    for (name, case) in &cases {
        for &threads in &crews {
            let space = Output::in_scratch(&dir, &format!("{name}-{threads}.space"));
            rows.push(measure(name, case, threads, &args.assets, &space, &stop)?);
            // Spaces of many points need much disk space.
            let _ = std::fs::remove_file(space.path());
        }
    }
    out.write(|| output::csv(&rows), &rows, || table(&rows))
}

fn measure(
    name: &str,
    case: &Case,
    threads: usize,
    assets: &Path,
    space: &Output,
    stop: &std::sync::atomic::AtomicBool,
) -> Result<Row, Failure> {
    let mut bench = analysis::load(&assets.join(format!("{}.toml", case.scene)))?;
    for region in &mut bench.scene.materials {
        (region.material, region.bulk_modulus_pa) = (case.law.clone(), None);
    }
    bench.scene.max_force_n = f64::INFINITY;
    if let Some(grid) = &mut bench.scene.grid {
        *grid = Sampling::Lattice(Lattice {
            grid: SpaceGrid::new(0.05 / case.cells, 0.05).map_err(Failure::work)?,
            complete_cells: true,
            increments: None,
        });
    }
    bench.scene.active.retain(|a| a.name == "A1");
    let body = bench.scene.body().map_err(|error| Failure::work(format!("{name}: {error}")))?;
    bench.body = Arc::new(body);
    let bench = Arc::new(bench);
    let store = open_space(&bench, space, false)?;
    forget_peak();
    let mut progress = WorkProgress::new(&format!("{name}, {threads} threads"), "solves");
    let start = Instant::now();
    let counts = bench.solve(&[0], &store, Run { threads, stop }, |p| progress.spaces(p));
    let seconds = start.elapsed().as_secs_f64();
    progress.finish();
    let counts = counts?[0];
    let peak_mb = peak_mb();
    let attempts = store.attempts(0)?;
    let sum =
        |value: fn(&palpate_precompute::space::Record) -> f64| -> f64 { attempts.iter().map(value).sum() };
    let branch_jumps =
        palpate_precompute::space::branch_jumps(&bench.lattice()?.grid, &store.records(0)?).len();
    let points = bench.sampling()?.points().unwrap_or(0);
    drop(store);
    let solved = counts.solved().max(1) as f64;
    Ok(Row {
        case: name.into(),
        threads,
        points,
        solved: counts.solved(),
        failed: counts.failed,
        tries: attempts.len() - 1,
        seconds,
        per_second: solved / seconds,
        iterations: sum(|r| f64::from(r.iterations)) / solved,
        factorisations: sum(|r| f64::from(r.factorisations)) / solved,
        busy: sum(|r| r.seconds) / (seconds * threads as f64),
        branch_jumps,
        peak_mb,
        store_mb: std::fs::metadata(space.path()).map_or(0.0, |m| m.len() as f64 / 1e6),
    })
}

fn table(rows: &[Row]) -> String {
    let mut text = String::from(
        "case             threads  points  solved  failed  tries  seconds  a second  iterations  factors   busy  branch jumps  \
         peak MB  store MB",
    );
    for row in rows {
        text += &format!(
            "\n{:16} {:>7} {:>7} {:>7} {:>7} {:>6} {:>8.1} {:>9.1} {:>11.2} {:>8.2} {:>5.1}% {:>13} {:>8} {:>9.1}",
            row.case,
            row.threads,
            row.points,
            row.solved,
            row.failed,
            row.tries,
            row.seconds,
            row.per_second,
            row.iterations,
            row.factorisations,
            100.0 * row.busy,
            row.branch_jumps,
            shown(row.peak_mb),
            row.store_mb
        );
    }
    text
}
