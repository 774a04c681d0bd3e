//! An executor without a solver. Its body has an analytic energy, so that a whole space costs milliseconds.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use nalgebra::{Matrix3, Vector3};
use palpate_core::ConfigTag;

use crate::mesh::TetMesh;
use crate::num::jet::EnergyJet;
use crate::space::record::Solution;
use crate::space::{
    Done, Executor, ExecutorError, Job, Outcome, Record, Store, StoreIdentity, StoredSeed, TagCounts, Task,
    Work, expand,
};
use crate::space::{Truth, WalkJob, WalkOutcome};
use crate::spec::{DisplacementBound, GridIndex, Lattice, Sampling, SpaceGrid};

const SPACING_M: f64 = 0.01;
/// The branch jump is at the plane halfway between the grid points i = 1 and i = 2.
const JUMP_M: f64 = 1.5 * SPACING_M;

/// W = scale (k r^2 / 2 + c r^4 / 4). Beyond the jump plane there is a second branch of higher energy, whose
/// force is larger by `jump_n` along x. The stiffness of active node n is multiplied by 1 + n.
///
/// A transition perpendicular to the plane arrives on the upper branch, an oblique one on the lower branch.
/// All other transitions keep the branch of the parent. The stored state contains the branch.
pub(crate) struct SyntheticExecutor {
    pub(crate) grid: SpaceGrid,
    scale: f64,
    jump_n: f64,
    /// The work received, in order.
    pub(crate) given: Vec<Work>,
    /// Tag of a held-out position, by the number of its walk.
    pub(crate) tag_of_walk: fn(u32) -> ConfigTag,
    /// Whether the rest point fails.
    pub(crate) rest_fails: bool,
    done: VecDeque<Done>,
}

impl SyntheticExecutor {
    pub(crate) fn new(scale: f64, jump_n: f64) -> Self {
        let grid = SpaceGrid::new(SPACING_M, 3.2 * SPACING_M).expect("a valid grid");
        let tag_of_walk = |_| ConfigTag::Expandable;
        Self { grid, scale, jump_n, given: Vec::new(), tag_of_walk, rest_fails: false, done: VecDeque::new() }
    }

    /// The outcome of `task`.
    pub(crate) fn record(&self, active: u32, task: &Task, upper: bool) -> Record {
        let scale = self.scale * f64::from(1 + active);
        let (k, c) = (200.0 * scale, 4e4 * scale);
        let d = Vector3::from(self.grid.displacement_m(task.target));
        let squared = d.norm_squared();
        let jump_n = if upper { self.jump_n } else { 0.0 };
        let energy_j = 0.5 * k * squared + 0.25 * c * squared * squared + jump_n * (d.x - JUMP_M);
        let force_n = d * (k + c * squared) + Vector3::x() * jump_n;
        let stiffness_n_m = Matrix3::identity() * (k + c * squared) + d * d.transpose() * (2.0 * c);
        let (control_m, third_n_m2) = (d.into(), [0.0; 10]);
        let jet = EnergyJet { control_m, energy_j, force_n: force_n.into(), stiffness_n_m, third_n_m2 };
        Record::of_jet(task, &jet, false)
    }

    fn upper(&self, job: &Job) -> bool {
        let (Some((parent, _)), Some(seed)) = (job.task.parent, &job.seed) else { return false };
        let target: GridIndex = job.task.target;
        let was_upper = seed.state[0] == 1;
        match (parent[0] > 1, target[0] > 1) {
            (false, true) => parent[1..] == target[1..],
            (true, true) => was_upper,
            (_, false) => false,
        }
    }

    fn point(&self, job: &Job) -> Outcome {
        let upper = self.upper(job);
        let state = vec![u8::from(upper), 0, 0, 0];
        let seed = StoredSeed { sensitivity: state.repeat(3), state, numbers: [0.0; 20], from_m: [0.0; 3] };
        let (active, intermediate) = (job.active, Vec::new());
        if self.rest_fails {
            let record = Record { residual_n: Some(1.0), ..Record::new(&job.task, Err("singular".into())) };
            return Outcome { active, record, seed: None, intermediate };
        }
        let record = self.record(job.active, &job.task, upper);
        Outcome { active, record, seed: Some(seed), intermediate }
    }

    fn walk(&self, job: &WalkJob) -> WalkOutcome {
        let tag = (self.tag_of_walk)(job.walk.number);
        let jet = EnergyJet::from_numbers([0.0; 3], &[1.0; 20]);
        let solution = Solution::of_jet(&jet, tag == ConfigTag::Terminating).equilibrium;
        let truth = |&displacement_m| Truth {
            displacement_m,
            result: if tag.is_solved() { Ok(solution) } else { Err("line-search".into()) },
            residual_n: Some(0.0),
            iterations: 1,
            factorisations: 1,
            seconds: 0.0,
            displacements: Vec::new(),
        };
        let ends_at_once = tag != ConfigTag::Expandable;
        let steps = if ends_at_once { 1 } else { job.positions_m.len() };
        WalkOutcome { walk: job.walk, truths: job.positions_m[..steps].iter().map(truth).collect() }
    }

    /// Identity of its stores.
    pub(crate) fn identity(&self) -> StoreIdentity {
        StoreIdentity {
            scene_name: "made-up".into(),
            scene: String::new(),
            content_hash: "0".into(),
            mesh_hash: mesh().content_hash(),
            law: "made-up".into(),
            max_force_n: f64::INFINITY,
            sampling: Sampling::Lattice(Lattice { grid: self.grid, complete_cells: false, increments: None }),
            normals: Vec::new(),
            visited_m: Vec::new(),
            contacts: None,
            charts: None,
            visual: false,
            displacement_bound: DisplacementBound::default(),
        }
    }

    /// Its store at `path` with `nodes` active nodes.
    pub(crate) fn store(&self, path: &Path, nodes: u32) -> Store {
        Store::create_or_resume(path, &self.identity(), &mesh(), &[0], &actives(nodes)).expect("a store")
    }

    /// Runs the expansion of `nodes` nodes to its end.
    pub(crate) fn expand(&mut self, store: &Store, nodes: u32) -> Vec<TagCounts> {
        let counts = expand(&all(nodes), store, self, &AtomicBool::new(false), |_| ());
        let counts = counts.expect("runs to its end");
        assert!(counts.iter().all(|c| (c.failed, c.unknown) == (0, 0)), "{counts:?}");
        counts
    }

    /// A complete space of one node.
    pub(crate) fn expanded(mut self) -> (tempfile::TempDir, Store) {
        let folder = tempfile::tempdir().expect("a folder");
        let store = self.store(&folder.path().join("a.space"), 1);
        self.expand(&store, 1);
        (folder, store)
    }
}

/// A placeholder mesh.
pub(crate) fn mesh() -> TetMesh {
    TetMesh::cuboid([1, 1, 1], 0.01)
}

/// The numbers of `nodes` active nodes.
pub(crate) fn all(nodes: u32) -> Vec<usize> {
    (0..nodes as usize).collect()
}

/// `nodes` active nodes.
pub(crate) fn actives(nodes: u32) -> Vec<(String, u32)> {
    (0..nodes).map(|n| (format!("A{n}"), n + 1)).collect()
}

impl Executor for SyntheticExecutor {
    fn size(&self) -> usize {
        1
    }

    fn give(&mut self, _: usize, work: Work) -> Result<(), ExecutorError> {
        self.done.push_back(match &work {
            Work::Point(job) => Done::Point(Box::new(self.point(job))),
            Work::Walk(job) => Done::Walk(self.walk(job)),
        });
        self.given.push(work);
        Ok(())
    }

    fn take(&mut self, _: Duration) -> Result<Option<(usize, Done)>, ExecutorError> {
        Ok(Some((0, self.done.pop_front().ok_or(ExecutorError::Panicked)?)))
    }

    fn stop(&mut self) {
        self.done.iter_mut().for_each(|done| *done = Done::Abandoned);
    }
}
