//! Time of rank 0 of a cluster per attempt, without the transport: plan, read the parent's state, encode the job,
//! decode the outcome, store it. `cargo bench -p palpate-precompute --bench rank0`.

#[path = "scheduler/lattice.rs"]
mod lattice;

use std::collections::VecDeque;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use divan::Bencher;
use divan::counter::ItemsCount;
use palpate_precompute::fem::{Pose, Seed};
use palpate_precompute::mesh::TetMesh;
use palpate_precompute::num::EnergyJet;
use palpate_precompute::space::{
    Done, Executor, ExecutorError, Outcome, Record, Store, StoredSeed, Work, expand,
};
use palpate_precompute::spec::SpaceGrid;

fn main() {
    divan::main();
}

/// Workers that solve a spring of 1 N/m at once, with states of this many unknowns.
struct AtOnce {
    grid: SpaceGrid,
    seed: StoredSeed,
    done: VecDeque<(usize, Vec<u8>)>,
}

impl AtOnce {
    fn new(grid: SpaceGrid, unknowns: usize) -> Self {
        let column = vec![0.5; unknowns];
        let seed = StoredSeed::pack(&Seed {
            pose: Pose::translation([0.0; 3]),
            sensitivity: [column.clone(), column.clone(), column.clone()],
            state: column,
            jet: EnergyJet::from_numbers([0.0; 3], &[0.0; 20]),
            coupling: None,
        });
        Self { grid, seed, done: VecDeque::new() }
    }
}

fn lost(error: impl std::fmt::Display) -> ExecutorError {
    ExecutorError::Lost(error.to_string())
}

impl Executor for AtOnce {
    fn size(&self) -> usize {
        8
    }

    fn give(&mut self, worker: usize, work: Work) -> Result<(), ExecutorError> {
        divan::black_box(postcard::to_stdvec(&work).map_err(lost)?);
        let Work::Point(job) = work else { return Err(lost("only points are solved")) };
        let d = self.grid.displacement_m(job.task.target);
        let mut numbers = [0.0; 20];
        (numbers[0], numbers[4], numbers[7], numbers[9]) =
            (0.5 * d.iter().map(|x| x * x).sum::<f64>(), 1.0, 1.0, 1.0);
        numbers[1..4].copy_from_slice(&d);
        let record = Record::of_jet(&job.task, &EnergyJet::from_numbers(d, &numbers), false);
        let (active, seed) = (job.active, Some(self.seed.clone()));
        let outcome = Outcome { active, record, seed, intermediate: Vec::new() };
        let message = postcard::to_stdvec(&Done::Point(Box::new(outcome))).map_err(lost)?;
        self.done.push_back((worker, message));
        Ok(())
    }

    fn take(&mut self, _: Duration) -> Result<Option<(usize, Done)>, ExecutorError> {
        let (worker, message) = self.done.pop_front().ok_or_else(|| lost("no message is in flight"))?;
        Ok(Some((worker, postcard::from_bytes(&message).map_err(lost)?)))
    }

    fn stop(&mut self) {}
}

/// The 1,014 points of the paper's coarsest grid, with the unknowns of the small, the large and a finer organ. The
/// worker's part, to encode the outcome, is included.
#[divan::bench(args = [1_839, 7_862, 51_971], sample_count = 5, sample_size = 1)]
fn attempts(bencher: Bencher<'_, '_>, unknowns: usize) {
    let grid = SpaceGrid::new(0.01, 0.05).expect("a grid");
    let mesh = TetMesh::cuboid([1; 3], 0.1);
    let identity = lattice::identity(grid, &mesh);
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("rank0.space");
    let empty = || {
        let _ = std::fs::remove_file(&path);
        Store::create_or_resume(&path, &identity, &mesh, &[], &[("A".into(), 0)]).expect("a new file")
    };
    bencher.with_inputs(empty).counter(ItemsCount::new(grid.points(true).len())).bench_values(|store| {
        let mut executor = AtOnce::new(grid, unknowns);
        expand(&[0], &store, &mut executor, &AtomicBool::new(false), |_| ()).expect("every point is solved")
    });
}
