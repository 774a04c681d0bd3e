//! `palpate bench core`: nanoseconds per force query for every method and instruction set, compared with two
//! public crates.

#[cfg(feature = "peers")]
mod peers;
mod tables;
mod timing;

use std::path::PathBuf;

use clap::Args as ClapArgs;
use palpate_core::{Method, Space, Vec3, flags, vec3};
use palpate_host::{Instructions, Interpolator};
use palpate_precompute::certificate::reference_force_n;
use serde::Serialize;

use super::common::{Out, Pinned};
use crate::failure::Failure;
use crate::points::read_points;
use crate::{blob, output};
use tables::Tables;
use timing::{Run, Timing};

/// Measure the time of one force query with every method and vector instruction set.
///
/// The tables are the paper's four grids of a synthetic smooth field, or a blob.
///
/// The positions are uniform in the ball, in random order. The methods run interleaved in small batches, so
/// that other load affects all of them. Medians and minima are shown. `waits` is the median of dependent
/// queries, each of which needs the result of the one before. `off` is the largest difference from the same
/// interpolant in f64. A build with `--features peers` also measures the crates interpn and rbf-interp.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// Numbers of points of the synthetic grids: 514, 1418, 4168, 14146
    #[arg(long, value_name = "N,M", value_delimiter = ',', default_value = "514,1418,4168,14146")]
    grids: Vec<usize>,
    /// A blob to query instead of synthetic tables
    #[arg(long, value_name = "FILE")]
    blob: Option<PathBuf>,
    /// Active node of the blob; the first if not given
    #[arg(long, value_name = "NAME", requires = "blob")]
    active: Option<String>,
    /// Also give the force of every method and peer at these displacements: a table with the columns
    /// x_m,y_m,z_m. JSON only
    #[arg(long, value_name = "FILE.csv", requires = "blob", requires = "json")]
    points: Option<PathBuf>,
    /// Number of interleaved batches of each method
    #[arg(long, value_name = "N", default_value_t = 400)]
    rounds: usize,
    #[command(flatten)]
    pinned: Pinned,
    #[command(flatten)]
    out: Out,
}

/// All figures.
#[derive(Debug, Serialize)]
struct Figures {
    processor: String,
    built_for: &'static str,
    best: &'static str,
    pinned: String,
    rounds: usize,
    rows: Vec<Row>,
}

/// One method with one instruction set, or a peer.
#[derive(Debug, Serialize)]
struct Row {
    grid: usize,
    method: String,
    instructions: &'static str,
    median_ns: f64,
    min_ns: f64,
    /// Median of dependent queries, each of which needs the result of the one before.
    waits_ns: Option<f64>,
    /// Largest |h - h in f64|, N; `None` if the weights are synthetic.
    off_n: Option<f64>,
    /// Bytes of its tables.
    bytes: usize,
    /// Forces at the points of --points, N.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    answers: Vec<Vec3>,
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let out = args.out.ready(args.blob.iter().chain(&args.points).map(PathBuf::as_path))?;
    let points = args.points.as_ref().map(|path| read_points(path, "--points")).transpose()?;
    let points: Vec<Vec3> = points.unwrap_or_default().iter().map(|at| at.map(|x| x as f32)).collect();
    let mut figures = Figures {
        processor: processor(),
        built_for: Instructions::built_for(),
        best: Instructions::best().name(),
        pinned: format!("to {}", args.pinned.pin()),
        rounds: args.rounds.max(1),
        rows: Vec::new(),
    };
    if let Some(path) = &args.blob {
        let file = blob::load(path)?;
        let organ = blob::organ(path, &file)?;
        let named =
            |space: &&Space<'_>| args.active.as_ref().is_none_or(|name| space.active.name == name.as_str());
        let space = organ.spaces.iter().find(named).ok_or_else(|| {
            let names: Vec<&str> = organ.spaces.iter().map(|space| space.active.name.as_str()).collect();
            Failure::input(format!("no such active node in the blob; it has {}", names.join(", ")))
        })?;
        figures.rows = measure(space, true, figures.rounds, &points);
    } else {
        for &grid in &args.grids {
            eprintln!("palpate: {grid} points");
            let tables = Tables::made_up(grid)?;
            figures.rows.extend(measure(&tables.space(), tables.fitted, figures.rounds, &[]));
        }
    }
    out.write(|| output::csv(&figures.rows), &figures, || table(&figures))
}

/// Median time of a query of every method on one space with its fastest instruction set, ns.
pub(in crate::cmd::bench) fn fastest_ns(space: &Space<'_>, rounds: usize) -> Vec<(String, f64)> {
    let rows = measure(space, true, rounds, &[]);
    let mut fastest: Vec<(String, f64)> = Vec::new();
    for row in rows.into_iter().filter(|row| row.instructions != PEER) {
        match fastest.iter_mut().find(|(method, _)| *method == row.method) {
            Some((_, ns)) => *ns = ns.min(row.median_ns),
            None => fastest.push((row.method, row.median_ns)),
        }
    }
    fastest
}

/// Measures every method on one space, and evaluates it at `points`. `fitted`: whether the RBF weights cancel
/// like those of a real fit.
fn measure(space: &Space<'_>, fitted: bool, rounds: usize, points: &[Vec3]) -> Vec<Row> {
    let grid = space.planes().flags.iter().filter(|bits| **bits & flags::SOLVED != 0).count() - 1;
    let queries = timing::queries(space.lattice().radius_m());
    let methods = || Method::ALL.into_iter().filter(|method| space.has(*method));
    #[cfg(feature = "peers")]
    let peers = peers::Peers::of(space, grid);
    let mut runs: Vec<Run<'_>> = Vec::new();
    for method in methods() {
        for interpolator in
            Instructions::ALL.into_iter().filter_map(|i| Interpolator::with_instructions(i, method))
        {
            runs.push(Run::ours(space, interpolator));
        }
    }
    #[cfg(feature = "peers")]
    peers.add_to(&mut runs);
    let timings = timing::interleave(&mut runs, &queries, rounds);
    let row = |(run, timing): (&mut Run<'_>, Timing)| {
        let radial = matches!(run.compared, Method::RbfLinear | Method::RbfCubic);
        let off_n = (fitted || !radial).then(|| largest_difference(space, run, &queries));
        Row {
            grid,
            method: run.name.clone(),
            instructions: run.instructions,
            median_ns: timing.median_ns,
            min_ns: timing.min_ns,
            waits_ns: timing.waits_ns,
            off_n,
            bytes: run.bytes,
            answers: points.iter().map(|point| run.ask(point)).collect(),
        }
    };
    runs.iter_mut().zip(timings).map(row).collect()
}

/// Largest |h - h in f64|, N.
fn largest_difference(space: &Space<'_>, run: &mut Run<'_>, queries: &[Vec3]) -> f64 {
    const COMPARED: usize = 4_000;
    let difference = |query: &Vec3| -> f64 {
        let (found, want) = (run.ask(query), reference_force_n(space, run.compared, *query));
        let squared = |want: [f64; 3]| -> f64 {
            found.iter().zip(want).map(|(found, want)| (f64::from(*found) - want).powi(2)).sum()
        };
        want.map_or(f64::NAN, |want| squared(want).sqrt())
    };
    queries.iter().take(COMPARED).map(difference).fold(0.0, f64::max)
}

/// Bytes of the tables of a method.
fn bytes(space: &Space<'_>, method: Method) -> usize {
    let slots = space.lattice().slots();
    let planes = space.planes();
    let force = slots * size_of::<Vec3>();
    let hermite = planes.hermite.map_or(0, |nodes| size_of_val(nodes.row) + size_of_val(nodes.nodes));
    match method {
        Method::Trilinear | Method::Tricubic => force,
        Method::Hybrid => force + slots,
        Method::RbfLinear => planes.rbf_linear.map_or(0, |rbf| 6 * 4 * rbf.centres[0].len()),
        Method::RbfCubic => planes.rbf_cubic.map_or(0, |rbf| 6 * 8 * rbf.centres[0].len()),
        Method::Hermite => hermite,
        Method::Energy => hermite + slots,
        Method::Kernel => planes.kernel.map_or(0, |kernel| {
            size_of_val(kernel.scalars) + size_of_val(kernel.blocks) + size_of_val(kernel.reach)
        }),
    }
}

/// The model name of the processor.
fn processor() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = info.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    model.map_or_else(|| std::env::consts::ARCH.into(), |(_, name)| name.trim().into())
}

fn table(figures: &Figures) -> String {
    let Figures { processor, built_for, best, pinned, rounds, rows } = figures;
    let mut text = format!(
        "processor  {processor}\nbuilt for  {built_for}; the widest here is {best}\npinned     {pinned}\nbatches    {rounds} each\n\n\
         grid   method               on             median      min    waits ns    off mN      bytes"
    );
    for row in rows {
        text += &format!(
            "\n{:<6} {:<20} {:<12} {:>8.1} {:>8.1} {:>11} {:>9} {:>10}",
            row.grid,
            row.method,
            row.instructions,
            row.median_ns,
            row.min_ns,
            row.waits_ns.map_or_else(|| "-".into(), |ns| format!("{ns:.1}")),
            row.off_n.map_or_else(|| "-".into(), |off_n| format!("{:.4}", off_n * 1e3)),
            row.bytes
        );
    }
    text + &ratios(rows)
}

/// Ratios of a peer's time to that of the method with the same interpolant, for the baseline and the best
/// instruction set.
fn ratios(rows: &[Row]) -> String {
    let mut text = String::new();
    for peer in rows.iter().filter(|row| row.instructions == PEER) {
        let ours = || rows.iter().filter(|row| row.grid == peer.grid && row.instructions != PEER);
        let same = || ours().filter(|row| Some(row.method.as_str()) == peer.method.split(' ').next_back());
        let times: Vec<String> = same()
            .map(|row| format!("{:.1} ({})", peer.median_ns / row.median_ns, row.instructions))
            .collect();
        text +=
            &format!("\n{}: {} takes {} times as long as Palpate", peer.grid, peer.method, times.join(", "));
    }
    if text.is_empty() { text } else { format!("\n{text}") }
}

/// Entry of a peer in the column of the instruction sets.
const PEER: &str = "peer";

impl<'r> Run<'r> {
    fn ours(space: &'r Space<'_>, interpolator: Interpolator) -> Self {
        let method = interpolator.method();
        let ask =
            move |query: &Vec3| interpolator.force(space, query).map_or(vec3::ZERO, |answer| answer.force_n);
        Self::new(method.name().into(), interpolator.instructions().name(), method, bytes(space, method), ask)
    }
}
