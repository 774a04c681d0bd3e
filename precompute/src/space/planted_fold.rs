//! A space with a branch jump from an analytic energy: tests of its flags, and of the repeated solves that
//! remove it.

use nalgebra::Matrix3;
use palpate_core::ConfigTag;

use super::made_up::MadeUp;
use super::task::Task;
use super::{Record, folds};
use crate::fem::boundary::Pose;
use crate::fem::solve::{Configuration, Seed};
use crate::fit::Fold;
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
        let made_up = MadeUp::new(scale, jump_n);
        let grid = made_up.grid;
        let (_folder, store) = made_up.expanded();
        let folds = folds(&grid, &first_tries(&store.attempts(0).expect("records")));
        let straight: Vec<_> =
            folds.iter().filter(|f| (f.from[1..] == f.to[1..]) && f.from[0] + f.to[0] == 3).collect();
        assert!(straight.len() >= 9, "scale {scale}: {} edges straight across the fold", straight.len());
        for f in straight {
            assert!(f.rho_n < 1e-9 * jump_n, "scale {scale}: the energy cancels at mid-edge, {f:?}");
            assert!((f.rho_h_n / jump_n - 1.0).abs() < 0.2, "scale {scale}: the force does not, {f:?}");
        }
        let crosses = |f: &Fold| f.from[0].max(f.to[0]) > 1;
        assert!(folds.iter().all(crosses), "scale {scale}: a smooth edge is flagged");
    }
}

#[test]
fn a_space_without_a_jump_is_solved_once_and_without_a_flag() {
    for (scale, jump_n) in [(1.0, 0.0), (1000.0, 0.0), (1.0, 0.09), (1000.0, 90.0)] {
        let made_up = MadeUp::new(scale, jump_n);
        let grid = made_up.grid;
        let (_folder, store) = made_up.expanded();
        let attempts = store.attempts(0).expect("records");
        assert_eq!(folds(&grid, &attempts), [], "scale {scale}, {jump_n} N");
        assert!(attempts.iter().all(|r| r.attempt == 0), "scale {scale}, {jump_n} N");
    }
}

#[test]
fn flagged_points_are_solved_from_another_parent_and_the_lower_energy_is_kept_both_recorded() {
    for scale in [1.0, 1000.0] {
        let smooth = MadeUp::new(scale, 0.0);
        let made_up = MadeUp::new(scale, 1.3 * scale);
        let grid = made_up.grid;
        let (_folder, store) = made_up.expanded();
        let attempts = store.attempts(0).expect("records");
        let kept = store.records(0).expect("records");
        let lower = |r: &Record| {
            let task = Task { target: r.index, attempt: 0, round: 0, parent: None };
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
        assert_eq!(folds(&grid, &kept), [], "a branch jump is left");
    }
}

#[test]
fn an_energy_that_is_not_finite_or_does_not_fit_the_force_breaks_every_pair_of_its_point() {
    let made_up = MadeUp::new(1.0, 0.0);
    let grid = made_up.grid;
    let (_folder, store) = made_up.expanded();
    let whole = store.records(0).expect("records");
    let at = whole.iter().position(|r| r.index == [1, 0, 0]).expect("solved");
    let pairs = crate::spec::neighbours().filter(|o| whole.iter().any(|r| r.index == [1 + o[0], o[1], o[2]]));
    let pairs = pairs.count();
    let energy = energy_j(&whole[at]);
    for broken in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, energy + 0.02, energy - 0.02] {
        let mut records = whole.clone();
        records[at].result.as_mut().expect("solved").equilibrium.energy_j = broken;
        let folds = folds(&grid, &records);
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
            jet: EnergyJet {
                control_m: displacement_m,
                energy_j: 1.0,
                force_n,
                stiffness_n_m,
                third_n_m2: [0.0; 10],
            },
        },
        torque_n_m: [0.0; 3],
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
    assert_eq!(Record::solved(&task, &sound, 10.0, 0.0).tag(), ConfigTag::Expandable);
    let breakers: [fn(&mut Configuration); 4] = [
        |c| c.seed.jet.energy_j = f64::NAN,
        |c| c.seed.jet.force_n[1] = f64::INFINITY,
        |c| c.seed.jet.stiffness_n_m[(2, 1)] = f64::NAN,
        |c| c.seed.jet.third_n_m2[9] = f64::NEG_INFINITY,
    ];
    for breaker in breakers {
        let mut broken = sound.clone();
        breaker(&mut broken);
        let record = Record::solved(&task, &broken, 10.0, 0.0);
        assert_eq!((record.tag(), record.failure()), (ConfigTag::Failed, Some("not-finite")));
        assert_eq!(record.iterations, 3);
    }
}
