//! `palpate bench scheduler`: parallel scaling of the expansion of spaces, and its limit.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use clap::Args as ClapArgs;
use palpate_precompute::mesh::TetMesh;
use palpate_precompute::space::{self, Executor, Store, StoreIdentity};
use palpate_precompute::spec::{DisplacementBound, Lattice, Sampling, SpaceGrid};
use serde::Serialize;

use super::common::Out;
use super::replay::{RankZero, Replay};
use super::simulated::{Costs, Simulated, Solves, nanoseconds};
use crate::failure::Failure;
use crate::output;

/// Simulate the makespan of configuration spaces on 1 to 4,096 workers.
///
/// The real planner and dispatcher run with workers in simulated time.
///
/// With --space the solve times are drawn from that file, and its own expansion is simulated too, with its
/// failures and retries. The time of rank 0 per attempt is measured by a replay: plan, read the parent's
/// state, encode the job, decode the outcome, store it, without the transport. Without --space every solve
/// takes --solve-ms.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// File with the solve times
    #[arg(long, value_name = "FILE.space")]
    space: Option<PathBuf>,
    /// Numbers of points of the grids: 514, 1418, 4168 or 14146; cells are completed
    #[arg(long, value_name = "N,M", value_delimiter = ',', default_value = "514,1418,4168,14146")]
    points: Vec<usize>,
    /// Numbers of workers
    #[arg(
        long,
        value_name = "N,M",
        value_delimiter = ',',
        default_value = "1,2,4,8,16,32,64,128,256,512,1024,2048,4096"
    )]
    workers: Vec<usize>,
    /// Time of a solve without --space, ms
    #[arg(long, value_name = "MS", default_value_t = 50.0)]
    solve_ms: f64,
    /// Time of rank 0 per attempt, us; measured with --space, otherwise 350
    #[arg(long, value_name = "US")]
    rank0_us: Option<f64>,
    /// Time of rank 0 to pass a job to MPI, us
    #[arg(long, value_name = "US", default_value_t = 25.0)]
    send_us: f64,
    /// Latency of a message, us
    #[arg(long, value_name = "US", default_value_t = 200.0)]
    message_us: f64,
    #[command(flatten)]
    out: Out,
}

/// One simulated run.
#[derive(Debug, Serialize)]
struct Row {
    case: String,
    points: usize,
    tries: usize,
    /// Number of levels and rounds with attempts.
    levels: usize,
    workers: usize,
    makespan_s: f64,
    speed_up: f64,
    efficiency: f64,
    /// Lower bound of the makespan: the evenly distributed work, or the longest chain of solves.
    bound_s: f64,
    /// Longest chain of solves, each of which starts from the one before.
    chain_s: f64,
    /// Duration of rounds with a barrier between them: the sum over levels of ceil(attempts / workers) mean
    /// solves.
    barrier_s: f64,
    /// Share of the makespan in which rank 0 is busy.
    rank0_busy: f64,
}

#[derive(Debug, Serialize)]
struct Figures {
    rank0: Option<RankZero>,
    rank0_us: f64,
    send_us: f64,
    message_us: f64,
    mean_solve_s: f64,
    rows: Vec<Row>,
}

/// A space to simulate.
struct Case<'a> {
    name: String,
    grid: SpaceGrid,
    complete_cells: bool,
    actives: Vec<usize>,
    solves: Solves<'a>,
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    if args.workers.contains(&0) {
        return Err(Failure::input("--workers: give at least one worker"));
    }
    let out = args.out.ready(args.space.as_deref())?;
    let dir = tempfile::tempdir().map_err(|error| Failure::work(format!("no temporary folder: {error}")))?;
    let replay = args.space.as_deref().map(Replay::load).transpose()?;
    let rank0 = replay.as_ref().map(|replay| measure(replay, dir.path())).transpose()?;
    let seconds: Vec<f64> = match &replay {
        Some(replay) => replay.seconds(),
        None => vec![args.solve_ms / 1e3],
    };
    if seconds.is_empty() {
        return Err(Failure::input("the file contains no solves"));
    }
    let rank0_us = args.rank0_us.or(rank0.as_ref().map(|r| r.us_per_try)).unwrap_or(350.0);
    let costs = Costs {
        // Rank 0 plans and reads before it sends a job, and stores after it receives an outcome.
        give: nanoseconds((rank0_us / 2.0 + args.send_us) * 1e-6),
        take: nanoseconds(rank0_us / 2.0 * 1e-6),
        message: nanoseconds(args.message_us * 1e-6),
    };
    let pool: Vec<u64> = seconds.iter().map(|&s| nanoseconds(s)).collect();
    let mut cases = Vec::new();
    if let Some(replay) = &replay {
        cases.push(Case {
            name: "as solved".into(),
            grid: replay.grid,
            complete_cells: replay.complete_cells,
            actives: replay.actives.clone(),
            solves: Solves::Known(&replay.records),
        });
    }
    for &points in &args.points {
        cases.push(Case {
            name: points.to_string(),
            grid: grid_of(points)?,
            complete_cells: true,
            actives: vec![0],
            solves: Solves::Drawn(&pool),
        });
    }
    let mut rows = Vec::new();
    for case in &cases {
        for &workers in &args.workers {
            let path = dir.path().join("simulated.space");
            rows.push(simulate(case, workers, costs, &path)?);
            let _ = std::fs::remove_file(&path);
        }
    }
    let figures = Figures {
        rank0,
        rank0_us,
        send_us: args.send_us,
        message_us: args.message_us,
        mean_solve_s: seconds.iter().sum::<f64>() / seconds.len() as f64,
        rows,
    };
    out.write(|| output::csv(&figures.rows), &figures, || table(&figures))
}

fn grid_of(points: usize) -> Result<SpaceGrid, Failure> {
    let cells = match points {
        514 => 5.0,
        1418 => 7.0,
        4168 => 10.0,
        14146 => 15.0,
        _ => {
            return Err(Failure::input(format!(
                "no grid has {points} points; choose from 514, 1418, 4168 and 14146"
            )));
        }
    };
    SpaceGrid::new(0.05 / cells, 0.05).map_err(Failure::input)
}

/// An empty store of an arbitrary body.
fn scratch(path: &Path, grid: &SpaceGrid, complete_cells: bool, actives: usize) -> Result<Store, Failure> {
    let mesh = TetMesh::cuboid([1; 3], 0.1);
    let identity = StoreIdentity {
        scene_name: "scheduler".into(),
        scene: String::new(),
        content_hash: String::new(),
        mesh_hash: mesh.content_hash(),
        law: String::new(),
        max_force_n: f64::INFINITY,
        sampling: Sampling::Lattice(Lattice { grid: *grid, complete_cells, increments: None }),
        normals: Vec::new(),
        visual: false,
        displacement_bound: DisplacementBound::default(),
    };
    let active: Vec<(String, u32)> = (0..actives).map(|i| (format!("A{i}"), 0)).collect();
    Ok(Store::create_or_resume(path, &identity, &mesh, &[], &active)?)
}

fn expand(store: &Store, executor: &mut dyn Executor, actives: &[usize]) -> Result<(), Failure> {
    space::expand(actives, store, executor, &AtomicBool::new(false), |_| ())?;
    Ok(())
}

fn measure(replay: &Replay, dir: &Path) -> Result<RankZero, Failure> {
    let store =
        scratch(&dir.join("replay.space"), &replay.grid, replay.complete_cells, replay.actives.len())?;
    replay.measure(|executor| expand(&store, executor, &replay.actives))
}

fn simulate(case: &Case<'_>, workers: usize, costs: Costs, path: &Path) -> Result<Row, Failure> {
    let store = scratch(path, &case.grid, case.complete_cells, case.actives.len())?;
    let mut executor = Simulated::new(workers, costs, &case.solves, case.grid);
    expand(&store, &mut executor, &case.actives)?;
    let seconds = |ns: u64| ns as f64 * 1e-9;
    let ran = executor.ran();
    let (makespan, work, chain) = (seconds(ran.makespan), seconds(ran.work), seconds(ran.chain));
    let mean = work / ran.tries.max(1) as f64;
    let rounds = ran.levels.values().map(|tries| tries.div_ceil(workers)).sum::<usize>();
    let speed_up = work / makespan;
    Ok(Row {
        case: case.name.clone(),
        points: case.actives.len() * (case.grid.points(case.complete_cells).len() - 1),
        tries: ran.tries,
        levels: ran.levels.len(),
        workers,
        makespan_s: makespan,
        speed_up,
        efficiency: speed_up / workers as f64,
        bound_s: (work / workers as f64).max(chain),
        chain_s: chain,
        barrier_s: rounds as f64 * mean,
        rank0_busy: seconds(ran.rank0_busy) / makespan,
    })
}

fn table(figures: &Figures) -> String {
    let mut text = String::new();
    if let Some(r) = &figures.rank0 {
        text += &format!(
            "rank 0 alone: {:.0} attempts per second ({:.0} us each); a job has {:.0} bytes, an outcome {:.0}\n",
            r.tries_per_second, r.us_per_try, r.job_bytes, r.outcome_bytes
        );
    }
    text += &format!(
        "mean solve {:.1} ms; rank 0 {:.0} us per attempt and {:.0} us per send; latency of a message {:.0} us\n\n",
        1e3 * figures.mean_solve_s,
        figures.rank0_us,
        figures.send_us,
        figures.message_us
    );
    text += "case       points   tries  levels  workers  makespan s  speed-up  efficiency    bound s    chain s  barrier s  rank 0";
    for r in &figures.rows {
        text += &format!(
            "\n{:9} {:>7} {:>7} {:>7} {:>8} {:>11.3} {:>9.1} {:>10.1}% {:>10.3} {:>10.3} {:>10.3} {:>6.1}%",
            r.case,
            r.points,
            r.tries,
            r.levels,
            r.workers,
            r.makespan_s,
            r.speed_up,
            100.0 * r.efficiency,
            r.bound_s,
            r.chain_s,
            r.barrier_s,
            100.0 * r.rank0_busy
        );
    }
    text
}
