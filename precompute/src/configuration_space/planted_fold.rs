//! A space with a fold in it, from a made-up energy: what the flags see of it, and that the expansion mends it.

use std::collections::VecDeque;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use nalgebra::{Matrix3, Vector3};
use palpate_core::ConfigTag;

use super::plan::Task;
use super::{
    Crew, CrewError, Done, Expansion, GridIndex, Job, Outcome, Record, SpaceGrid, Store, StoreIdentity,
    StoredSeed, Work, fold,
};
use crate::boundary::Pose;
use crate::fit::DisplacementBound;
use crate::mesh::TetMesh;
use crate::solve::{Configuration, Potential, Seed};

const SPACING_M: f64 = 0.01;
/// The fold is the plane halfway between the grid points of i = 1 and those of i = 2.
const FOLD_M: f64 = 1.5 * SPACING_M;

/// W = scale (k r^2 / 2 + c r^4 / 4), and beyond the fold a second branch of higher energy whose force is `jump_n` more along x.
///
/// A transition straight across the fold lands on the upper branch, an oblique one on the lower; else a child is on its parent's
/// branch. The branch travels in the stored state, as that of a body does.
struct Fake {
    grid: SpaceGrid,
    scale: f64,
    jump_n: f64,
    done: VecDeque<Outcome>,
}

impl Fake {
    fn new(scale: f64, jump_n: f64) -> Self {
        let grid = SpaceGrid::new(SPACING_M, 3.2 * SPACING_M).expect("a valid grid");
        Self { grid, scale, jump_n, done: VecDeque::new() }
    }

    fn record(&self, task: &Task, upper: bool) -> Record {
        let (k, c) = (200.0 * self.scale, 4e4 * self.scale);
        let d = Vector3::from(self.grid.displacement_m(task.target));
        let squared = d.norm_squared();
        let jump_n = if upper { self.jump_n } else { 0.0 };
        let energy_j = 0.5 * k * squared + 0.25 * c * squared * squared + jump_n * (d.x - FOLD_M);
        let force_n = d * (k + c * squared) + Vector3::x() * jump_n;
        let stiffness_n_m = Matrix3::identity() * (k + c * squared) + d * d.transpose() * (2.0 * c);
        Record {
            tag: ConfigTag::Expandable,
            energy_j,
            force_n: force_n.into(),
            stiffness_n_m,
            third_n_m2: [0.0; 10],
            residual_n: 0.0,
            min_jacobian: 1.0,
            volume_m3: 1.0,
            ..Record::blank(task)
        }
    }

    fn upper(&self, job: &Job) -> bool {
        let (Some((parent, _)), Some(seed)) = (job.task.parent, &job.seed) else { return false };
        let target = job.task.target;
        let was_upper = seed.state[0] == 1;
        match (parent[0] > 1, target[0] > 1) {
            (false, true) => parent[1..] == target[1..],
            (true, true) => was_upper,
            (_, false) => false,
        }
    }

    /// Runs the whole expansion.
    fn expand(mut self) -> (tempfile::TempDir, Store) {
        let folder = tempfile::tempdir().expect("a folder");
        let mesh = TetMesh::cuboid([1, 1, 1], 0.01);
        let identity = StoreIdentity {
            scene_name: "made-up".into(),
            scene: String::new(),
            content_hash: "0".into(),
            mesh_hash: mesh.content_hash(),
            law: "made-up".into(),
            max_force_n: f64::INFINITY,
            spacing_m: self.grid.spacing_m,
            radius_m: self.grid.radius_m,
            visual: false,
            displacement_bound: DisplacementBound::default(),
            complete_cells: false,
            increments: None,
        };
        let path = folder.path().join("a.space");
        let store =
            Store::create_or_resume(&path, &identity, &mesh, &[0], &[("A".into(), 1)]).expect("a store");
        let expansion = Expansion { actives: vec![0], grid: self.grid, complete_cells: false };
        let counts =
            expansion.run(&store, &mut self, &AtomicBool::new(false), |_| ()).expect("runs to its end");
        assert_eq!((counts[0].failed, counts[0].unknown), (0, 0));
        (folder, store)
    }
}

impl Crew for Fake {
    fn size(&self) -> usize {
        1
    }

    fn give(&mut self, _: usize, work: Work) -> Result<(), CrewError> {
        let Work::Point(job) = work else { return Err(CrewError::Confused) };
        let upper = self.upper(&job);
        let state = vec![u8::from(upper), 0, 0, 0];
        let seed = StoredSeed { sensitivity: state.repeat(3), state, potential: [0.0; 10] };
        let record = self.record(&job.task, upper);
        self.done.push_back(Outcome {
            active: job.active,
            record,
            seed: Some(seed),
            intermediate: Vec::new(),
        });
        Ok(())
    }

    fn take(&mut self, _: Duration) -> Result<Option<(usize, Done)>, CrewError> {
        let outcome = self.done.pop_front().ok_or(CrewError::Panicked)?;
        Ok(Some((0, Done::Point(Box::new(outcome)))))
    }

    fn stop(&mut self) {
        self.done.clear();
    }
}

fn first_tries(attempts: &[Record]) -> Vec<Record> {
    attempts.iter().filter(|r| r.attempt == 0).cloned().collect()
}

/// The jump is some four tenths of the force there, at every scale of the forces.
#[test]
fn a_jump_halfway_between_grid_points_is_flagged_by_the_force_where_the_energy_is_blind() {
    for scale in [1.0, 30.0, 1000.0] {
        let jump_n = 1.3 * scale;
        let fake = Fake::new(scale, jump_n);
        let grid = fake.grid;
        let (_folder, store) = fake.expand();
        let folds = fold::folds(&grid, &first_tries(&store.attempts(0).expect("records")));
        let straight: Vec<_> =
            folds.iter().filter(|f| (f.from[1..] == f.to[1..]) && f.from[0] + f.to[0] == 3).collect();
        assert!(straight.len() >= 9, "scale {scale}: {} edges straight across the fold", straight.len());
        for f in straight {
            assert!(f.rho_n < 1e-9 * jump_n, "scale {scale}: the energy cancels at mid-edge, {f:?}");
            assert!((f.rho_h_n / jump_n - 1.0).abs() < 0.2, "scale {scale}: the force does not, {f:?}");
        }
        let crosses = |f: &fold::Fold| f.from[0].max(f.to[0]) > 1;
        assert!(folds.iter().all(crosses), "scale {scale}: nothing is flagged where all is smooth");
    }
}

#[test]
fn a_space_without_a_jump_is_solved_once_and_without_a_flag() {
    for (scale, jump_n) in [(1.0, 0.0), (1000.0, 0.0), (1.0, 0.09), (1000.0, 90.0)] {
        let fake = Fake::new(scale, jump_n);
        let grid = fake.grid;
        let (_folder, store) = fake.expand();
        let attempts = store.attempts(0).expect("records");
        assert_eq!(fold::folds(&grid, &attempts), [], "scale {scale}, {jump_n} N");
        assert!(attempts.iter().all(|r| r.attempt == 0), "scale {scale}, {jump_n} N");
    }
}

#[test]
fn flagged_points_are_solved_from_another_parent_and_the_lower_energy_is_kept_both_recorded() {
    for scale in [1.0, 1000.0] {
        let smooth = Fake::new(scale, 0.0);
        let fake = Fake::new(scale, 1.3 * scale);
        let grid = fake.grid;
        let (_folder, store) = fake.expand();
        let attempts = store.attempts(0).expect("records");
        let kept = store.records(0).expect("records");
        let lower = |r: &Record| {
            let task = Task { target: r.index, attempt: 0, round: 0, parent: None };
            smooth.record(&task, false).energy_j
        };
        let first_upper: Vec<GridIndex> = first_tries(&attempts)
            .iter()
            .filter(|r| r.energy_j > lower(r) * (1.0 + 1e-9))
            .map(|r| r.index)
            .collect();
        assert!(first_upper.len() > 10, "scale {scale}: {} points on the upper branch", first_upper.len());
        for index in first_upper {
            let tries: Vec<&Record> = attempts.iter().filter(|r| r.index == index).collect();
            let counts = kept.iter().find(|r| r.index == index).expect("solved");
            assert!(tries.len() > 1, "scale {scale}, {index:?}: solved again");
            assert_ne!(tries[0].parent, tries[1].parent, "from another parent");
            assert!(counts.attempt > 0 && counts.energy_j < tries[0].energy_j, "scale {scale}, {index:?}");
        }
        for record in &kept {
            assert_eq!(record.energy_j, lower(record), "scale {scale}, {:?}: the lower branch", record.index);
        }
        assert_eq!(fold::folds(&grid, &kept), [], "no fold is left");
    }
}

#[test]
fn an_energy_that_is_not_finite_or_does_not_fit_the_force_breaks_every_pair_of_its_point() {
    let fake = Fake::new(1.0, 0.0);
    let grid = fake.grid;
    let (_folder, store) = fake.expand();
    let whole = store.records(0).expect("records");
    let at = whole.iter().position(|r| r.index == [1, 0, 0]).expect("solved");
    let pairs =
        super::domain::neighbours().filter(|o| whole.iter().any(|r| r.index == [1 + o[0], o[1], o[2]]));
    let pairs = pairs.count();
    let energy = whole[at].energy_j;
    for broken in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, energy + 0.02, energy - 0.02] {
        let mut records = whole.clone();
        records[at].energy_j = broken;
        let folds = fold::folds(&grid, &records);
        assert_eq!(folds.len(), pairs, "W = {broken}");
        assert!(folds.iter().all(|f| f.from == [1, 0, 0] || f.to == [1, 0, 0]), "W = {broken}");
    }
}

#[test]
fn a_configuration_that_is_not_finite_is_a_failure() {
    let task = Task { target: [1, 0, 0], attempt: 0, round: 1, parent: Some(([0; 3], 0)) };
    let (displacement_m, force_n, stiffness_n_m) = ([0.01, 0.0, 0.0], [1.0; 3], Matrix3::identity());
    let sound = Configuration {
        seed: Seed {
            pose: Pose::translation(displacement_m),
            state: vec![0.0],
            sensitivity: [const { Vec::new() }; 3],
            potential: Potential { displacement_m, energy_j: 1.0, force_n, stiffness_n_m },
        },
        energy_j: 1.0,
        force_n,
        torque_n_m: [0.0; 3],
        stiffness_n_m,
        third_n_m2: [0.0; 10],
        residual_n: 1e-9,
        min_jacobian: 1.0,
        inverted: 0,
        volume_m3: 1.0,
        unstable_modes: None,
        iterations: 3,
        factorisations: 1,
        increments: 1,
        switched: false,
    };
    assert_eq!(Record::solved(&task, &sound, 10.0, 0.0).tag, ConfigTag::Expandable);
    let breakers: [fn(&mut Configuration); 4] = [
        |c| c.energy_j = f64::NAN,
        |c| c.force_n[1] = f64::INFINITY,
        |c| c.stiffness_n_m[(2, 1)] = f64::NAN,
        |c| c.third_n_m2[9] = f64::NEG_INFINITY,
    ];
    for breaker in breakers {
        let mut broken = sound.clone();
        breaker(&mut broken);
        let record = Record::solved(&task, &broken, 10.0, 0.0);
        assert_eq!((record.tag, record.failure.as_deref()), (ConfigTag::Failed, Some("not-finite")));
        assert_eq!(record.iterations, 3);
    }
}
