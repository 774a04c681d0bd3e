//! Parallel scaling of the expansion of spaces, and its limit: `cargo bench -p palpate-precompute --bench scheduler`.
//! The results are in docs/measurements.md. The time of rank 0 per attempt is that of the bench `rank0`.

mod lattice;
mod simulated;
mod solved;

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use clap::Parser;
use palpate_precompute::mesh::TetMesh;
use palpate_precompute::space::{self, Store, StoreIdentity};
use palpate_precompute::spec::SpaceGrid;
use simulated::{Costs, Durations, Simulated, Solves, nanoseconds};
use solved::SolvedSpace;

/// Simulate the makespan of configuration spaces on 1 to 4,096 workers.
///
/// The real planner and dispatcher run with workers in simulated time.
///
/// With --space its own expansion is simulated, on a lattice or adaptive, with its failures and retries, and the
/// solve times of the grids are drawn from it. With --times all solve times are drawn from that file, which need
/// not be finished. Without either every solve takes --solve-ms.
#[derive(Debug, Parser)]
struct Args {
    /// File whose expansion is simulated
    #[arg(long, value_name = "FILE.space")]
    space: Option<PathBuf>,
    /// File with the solve times
    #[arg(long, value_name = "FILE.space")]
    times: Option<PathBuf>,
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
    /// Time of rank 0 per attempt, us
    #[arg(long, value_name = "US", default_value_t = 350.0)]
    rank0_us: f64,
    /// Time of rank 0 to pass a job to MPI, us
    #[arg(long, value_name = "US", default_value_t = 25.0)]
    send_us: f64,
    /// Latency of a message, us
    #[arg(long, value_name = "US", default_value_t = 200.0)]
    message_us: f64,
    /// Passed by cargo
    #[arg(long, hide = true)]
    bench: bool,
}

type Failure = Box<dyn std::error::Error>;

/// One simulated run.
#[derive(Debug)]
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

/// A space to simulate.
struct Case<'a> {
    name: String,
    identity: StoreIdentity,
    mesh: TetMesh,
    fixed: Vec<u32>,
    active: Vec<(String, u32)>,
    actives: Vec<usize>,
    solves: Solves<'a>,
}

fn main() -> Result<(), Failure> {
    let args = Args::parse();
    if args.workers.contains(&0) {
        return Err("--workers: give at least one worker".into());
    }
    let dir = tempfile::tempdir()?;
    let solved = args.space.as_deref().map(SolvedSpace::load).transpose()?;
    let given = args.times.as_deref().map(solved::durations_in).transpose()?;
    let own = solved.as_ref().map(SolvedSpace::durations);
    let constant = Durations::constant(args.solve_ms / 1e3);
    let durations = given.as_ref().or(own.as_ref()).unwrap_or(&constant);
    if durations.others.is_empty() {
        return Err("the file contains no solves".into());
    }
    let rank0_us = args.rank0_us;
    let costs = Costs {
        // Rank 0 plans and reads before it sends a job, and stores after it receives an outcome.
        give: nanoseconds((rank0_us / 2.0 + args.send_us) * 1e-6),
        take: nanoseconds(rank0_us / 2.0 * 1e-6),
        message: nanoseconds(args.message_us * 1e-6),
    };
    let mut cases: Vec<Case<'_>> = Vec::new();
    cases.extend(solved.as_ref().map(|solved| Case::of(solved, given.as_ref())));
    for &points in &args.points {
        cases.push(Case::lattice(points, durations)?);
    }
    println!(
        "mean solve {:.1} ms; rank 0 {rank0_us:.0} us per attempt and {:.0} us per send; latency of a message {:.0} us\n",
        1e3 * durations.mean_s(),
        args.send_us,
        args.message_us
    );
    println!(
        "case       points   tries  levels  workers  makespan s  speed-up  efficiency    bound s    chain s  barrier s  rank 0"
    );
    for case in &cases {
        for &workers in &args.workers {
            let path = dir.path().join("simulated.space");
            println!("{}", case.simulate(workers, costs, &path)?.line());
            std::fs::remove_file(&path)?;
        }
    }
    Ok(())
}

fn grid_of(points: usize) -> Result<SpaceGrid, Failure> {
    let cells = match points {
        514 => 5.0,
        1418 => 7.0,
        4168 => 10.0,
        14146 => 15.0,
        _ => return Err(format!("no grid has {points} points; choose from 514, 1418, 4168 and 14146").into()),
    };
    Ok(SpaceGrid::new(0.05 / cells, 0.05)?)
}

impl<'a> Case<'a> {
    /// The expansion of a solved space, with other solve times if some are given.
    fn of(solved: &'a SolvedSpace, times: Option<&'a Durations>) -> Self {
        Self {
            name: "as solved".into(),
            identity: solved.identity.clone(),
            mesh: solved.mesh.clone(),
            fixed: solved.fixed.clone(),
            active: solved.active.clone(),
            actives: solved.actives.clone(),
            solves: Solves::Known(&solved.records, times),
        }
    }

    /// A grid of this many points on an arbitrary body.
    fn lattice(points: usize, durations: &'a Durations) -> Result<Self, Failure> {
        let grid = grid_of(points)?;
        let mesh = TetMesh::cuboid([1; 3], 0.1);
        let identity = lattice::identity(grid, &mesh);
        Ok(Self {
            name: points.to_string(),
            identity,
            mesh,
            fixed: Vec::new(),
            active: vec![("A".into(), 0)],
            actives: vec![0],
            solves: Solves::Spring(grid, durations),
        })
    }

    fn simulate(&self, workers: usize, costs: Costs, path: &Path) -> Result<Row, Failure> {
        let store = Store::create_or_resume(path, &self.identity, &self.mesh, &self.fixed, &self.active)?;
        let mut executor = Simulated::new(workers, costs, &self.solves);
        space::expand(&self.actives, &store, &mut executor, &AtomicBool::new(false), |_| ())?;
        let seconds = |ns: u64| ns as f64 * 1e-9;
        let ran = executor.ran();
        let (makespan, work, chain) = (seconds(ran.makespan), seconds(ran.work), seconds(ran.chain));
        let mean = work / ran.tries.max(1) as f64;
        let rounds = ran.levels.values().map(|tries| tries.div_ceil(workers)).sum::<usize>();
        let speed_up = work / makespan;
        Ok(Row {
            case: self.name.clone(),
            points: ran.points,
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
}

impl Row {
    fn line(&self) -> String {
        format!(
            "{:9} {:>7} {:>7} {:>7} {:>8} {:>11.3} {:>9.1} {:>10.1}% {:>10.3} {:>10.3} {:>10.3} {:>6.1}%",
            self.case,
            self.points,
            self.tries,
            self.levels,
            self.workers,
            self.makespan_s,
            self.speed_up,
            100.0 * self.efficiency,
            self.bound_s,
            self.chain_s,
            self.barrier_s,
            100.0 * self.rank0_busy
        )
    }
}
