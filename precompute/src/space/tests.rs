//! A space with a branch jump from an analytic energy: tests of its flags, and of the repeated solves that
//! remove it.

pub(crate) mod synthetic;

use synthetic::SyntheticExecutor;

use super::task::Task;
use super::{Kind, Outcome, Record, Solution, StoreError, Truth, Walk, WalkOutcome, branch_jumps};
use crate::fit::BranchJump;
use crate::num::jet::EnergyJet;
use crate::spec::GridIndex;

fn energy_j(record: &Record) -> f64 {
    record.equilibrium().expect("solved").energy_j
}

fn first_tries(attempts: &[Record]) -> Vec<Record> {
    attempts.iter().filter(|r| r.attempt == 0).cloned().collect()
}

/// The jump is about 40 % of the force there, at every scale of the forces.
#[test]
fn a_jump_halfway_between_grid_points_is_flagged_by_the_force_where_the_energy_is_blind() {
    for scale in [1.0, 30.0, 1000.0] {
        let jump_n = 1.3 * scale;
        let synthetic = SyntheticExecutor::new(scale, jump_n);
        let grid = synthetic.grid;
        let (_folder, store) = synthetic.expanded();
        let branch_jumps = branch_jumps(&grid, &first_tries(&store.attempts(0).expect("records")));
        let straight: Vec<_> =
            branch_jumps.iter().filter(|f| (f.from[1..] == f.to[1..]) && f.from[0] + f.to[0] == 3).collect();
        assert!(straight.len() >= 9, "scale {scale}: {} edges straight across the fold", straight.len());
        for f in straight {
            assert!(f.rho_n < 1e-9 * jump_n, "scale {scale}: the energy cancels at mid-edge, {f:?}");
            assert!((f.rho_h_n / jump_n - 1.0).abs() < 0.2, "scale {scale}: the force does not, {f:?}");
        }
        let crosses = |f: &BranchJump| f.from[0].max(f.to[0]) > 1;
        assert!(branch_jumps.iter().all(crosses), "scale {scale}: a smooth edge is flagged");
    }
}

#[test]
fn a_space_without_a_jump_is_solved_once_and_without_a_flag() {
    for (scale, jump_n) in [(1.0, 0.0), (1000.0, 0.0), (1.0, 0.09), (1000.0, 90.0)] {
        let synthetic = SyntheticExecutor::new(scale, jump_n);
        let grid = synthetic.grid;
        let (_folder, store) = synthetic.expanded();
        let attempts = store.attempts(0).expect("records");
        assert_eq!(branch_jumps(&grid, &attempts), [], "scale {scale}, {jump_n} N");
        assert!(attempts.iter().all(|r| r.attempt == 0), "scale {scale}, {jump_n} N");
    }
}

#[test]
fn flagged_points_are_solved_from_another_parent_and_the_lower_energy_is_kept_both_recorded() {
    for scale in [1.0, 1000.0] {
        let smooth = SyntheticExecutor::new(scale, 0.0);
        let synthetic = SyntheticExecutor::new(scale, 1.3 * scale);
        let grid = synthetic.grid;
        let (_folder, store) = synthetic.expanded();
        let attempts = store.attempts(0).expect("records");
        let kept = store.records(0).expect("records");
        let lower = |r: &Record| {
            let task = Task { target: r.index, attempt: 0, round: 0, parent: None, chart: None };
            energy_j(&smooth.record(0, &task, false))
        };
        let first_upper: Vec<GridIndex> = first_tries(&attempts)
            .iter()
            .filter(|r| energy_j(r) > lower(r) * (1.0 + 1e-9))
            .map(|r| r.index)
            .collect();
        assert!(first_upper.len() > 10, "scale {scale}: {} points on the upper branch", first_upper.len());
        for index in first_upper {
            let tries: Vec<&Record> = attempts.iter().filter(|r| r.index == index).collect();
            let counts = kept.iter().find(|r| r.index == index).expect("solved");
            assert!(tries.len() > 1, "scale {scale}, {index:?}: solved again");
            assert_ne!(tries[0].parent, tries[1].parent, "from another parent");
            assert!(counts.attempt > 0 && energy_j(counts) < energy_j(tries[0]), "scale {scale}, {index:?}");
        }
        for record in &kept {
            assert_eq!(
                energy_j(record),
                lower(record),
                "scale {scale}, {:?}: the lower branch",
                record.index
            );
        }
        assert_eq!(branch_jumps(&grid, &kept), [], "a branch jump is left");
    }
}

#[test]
fn an_energy_that_is_not_finite_or_does_not_fit_the_force_breaks_every_pair_of_its_point() {
    let synthetic = SyntheticExecutor::new(1.0, 0.0);
    let grid = synthetic.grid;
    let (_folder, store) = synthetic.expanded();
    let whole = store.records(0).expect("records");
    let at = whole.iter().position(|r| r.index == [1, 0, 0]).expect("solved");
    let pairs = crate::spec::neighbours().filter(|o| whole.iter().any(|r| r.index == [1 + o[0], o[1], o[2]]));
    let pairs = pairs.count();
    let energy = energy_j(&whole[at]);
    for broken in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, energy + 0.02, energy - 0.02] {
        let mut records = whole.clone();
        records[at].result.as_mut().expect("solved").equilibrium.energy_j = broken;
        let branch_jumps = branch_jumps(&grid, &records);
        assert_eq!(branch_jumps.len(), pairs, "W = {broken}");
        assert!(branch_jumps.iter().all(|f| f.from == [1, 0, 0] || f.to == [1, 0, 0]), "W = {broken}");
    }
}

#[test]
fn numbers_that_are_not_finite_are_never_stored() {
    let folder = tempfile::tempdir().expect("a folder");
    let store = SyntheticExecutor::new(1.0, 0.0).store(&folder.path().join("a.space"), 1);
    let task = Task { target: [1, 0, 0], attempt: 0, round: 1, parent: Some(([0; 3], 0)), chart: None };
    let sound = EnergyJet::from_numbers([0.01, 0.0, 0.0], &[1.0; 20]);
    let add = |jet: &EnergyJet, intermediate| {
        let record = Record::of_jet(&task, jet, false);
        store.add(&Outcome { active: 0, record, seed: None, intermediate }, None)
    };
    let walk = Walk { active: 0, kind: Kind::Random, number: 7 };
    let add_walk = |displacement_m, jet: &EnergyJet| {
        let result = Ok(Solution::of_jet(jet, false).equilibrium);
        let displacements = Vec::new();
        let truth = Truth {
            displacement_m,
            result,
            residual_n: Some(0.0),
            iterations: 1,
            factorisations: 1,
            seconds: 0.0,
            displacements,
        };
        store.add_walk(&WalkOutcome { walk, truths: vec![truth] })
    };
    let refused = |added: Result<(), StoreError>, what: &str| {
        let line = added.expect_err("not finite").to_string();
        assert!(line.contains("a.space: ") && line.contains(what) && line.contains("not finite"), "{line}");
    };
    let breakers: [fn(&mut EnergyJet); 4] = [
        |jet| jet.energy_j = f64::NAN,
        |jet| jet.force_n[1] = f64::INFINITY,
        |jet| jet.stiffness_n_m[(0, 1)] = f64::NAN,
        |jet| jet.third_n_m2[9] = f64::NEG_INFINITY,
    ];
    for (n, breaker) in breakers.into_iter().enumerate() {
        let mut broken = sound;
        breaker(&mut broken);
        refused(add(&broken, Vec::new()), "grid point [1, 0, 0]");
        refused(add(&sound, vec![broken]), "grid point [1, 0, 0]");
        // Held-out solutions have no third derivatives.
        if n < 3 {
            refused(add_walk([0.01; 3], &broken), "random walk 7, step 1");
        }
    }
    let breakers: [fn(&mut Record); 3] = [
        |record| record.residual_n = None,
        |record| record.result.as_mut().expect("solved").equilibrium.min_jacobian = f64::NAN,
        |record| record.result.as_mut().expect("solved").volume_m3 = f64::INFINITY,
    ];
    for breaker in breakers {
        let mut record = Record::of_jet(&task, &sound, false);
        breaker(&mut record);
        let outcome = Outcome { active: 0, record, seed: None, intermediate: Vec::new() };
        refused(store.add(&outcome, None), "grid point [1, 0, 0]");
    }
    refused(add_walk([0.01, f64::NAN, 0.0], &sound), "random walk 7, step 1");
    assert_eq!(store.attempts(0).expect("readable"), []);
    assert!(store.walks_done(0).expect("readable").is_empty());
    add(&sound, vec![sound]).and_then(|()| add_walk([0.01; 3], &sound)).expect("finite");
}
