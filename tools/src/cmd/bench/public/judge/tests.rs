//! The judge against values computed by hand.

use super::*;
use crate::cmd::bench::public::questions::Position;

fn value(judged: &[Judged], key: &str) -> Option<f64> {
    judged.iter().find(|figure| figure.key == key).unwrap_or_else(|| panic!("no figure {key}")).value
}

fn near(found: Option<f64>, wanted: f64) {
    let found = found.expect("a figure");
    assert!((found - wanted).abs() <= 1e-9 * wanted.abs().max(1e-3), "{found} is not {wanted}");
}

/// Forces of 1, 2 and 4 N.
fn three_positions() -> Questions {
    let at = |truth_n: Vec3| Position { displacement_m: [0.0; 3], truth_n, residual_n: 0.0 };
    Questions {
        organ: "o".into(),
        positions: vec![at([1.0, 0.0, 0.0]), at([0.0, 2.0, 0.0]), at([0.0, 0.0, -4.0])],
        ..Questions::default()
    }
}

#[test]
fn errors_are_those_computed_by_hand() {
    let questions = three_positions();
    let mut forces = Forces::none(&questions);
    // 30 mN of 1 N cannot be felt (3.5 % are 35 mN), 100 mN of 2 N can, 130 mN of 4 N cannot.
    forces.positions = vec![Some([1.03, 0.0, 0.0]), Some([0.06, 2.08, 0.0]), Some([0.05, 0.12, -4.0])];
    let judged = positions(&questions, &forces);
    near(value(&judged, "mean_mn"), (30.0 + 100.0 + 130.0) / 3.0);
    near(value(&judged, "max_mn"), 130.0);
    near(value(&judged, "not_felt_percent"), 200.0 / 3.0);
    near(value(&judged, "answered_percent"), 100.0);
}

#[test]
fn a_wrong_answer_shows_and_a_missing_one_is_stated() {
    let questions = three_positions();
    let exact = Forces {
        positions: questions.positions.iter().map(|p| Some(p.truth_n)).collect(),
        ..Forces::none(&questions)
    };
    near(value(&positions(&questions, &exact), "max_mn"), 0.0);
    let mut wrong = exact.clone();
    wrong.positions[1] = Some([0.0, -2.0, 0.0]);
    near(value(&positions(&questions, &wrong), "max_mn"), 4000.0);
    near(value(&positions(&questions, &wrong), "not_felt_percent"), 200.0 / 3.0);
    let mut partial = wrong;
    partial.positions[1] = None;
    near(value(&positions(&questions, &partial), "max_mn"), 0.0);
    near(value(&positions(&questions, &partial), "answered_percent"), 200.0 / 3.0);
    let none = positions(&questions, &Forces::none(&questions));
    assert!(none.iter().all(|figure| figure.value.is_none()), "no answer is no figure: {none:?}");
}

/// A square of 10 mm in x and y after two ticks of approach.
fn square() -> Questions {
    let corners = [[0.0, 0.0], [0.0, 0.0], [0.0, 0.0], [0.01, 0.0], [0.01, 0.01], [0.0, 0.01], [0.0, 0.0]];
    let displacement_m: Vec<Vec3> = corners.iter().map(|[x, y]| [*x, *y, 0.0]).collect();
    let truth_n = vec![None; displacement_m.len()];
    let way = Way { name: "square".into(), counted_from: 2, displacement_m, truth_n };
    Questions { organ: "o".into(), loops: vec![way], ..Questions::default() }
}

#[test]
fn the_energy_of_a_loop_is_that_computed_by_hand() {
    let questions = square();
    // h = (0, c x, 0) has the curl c: the work on the body round the square is c A, on the hand -c A.
    let curl_n_m = 50.0;
    let forces = Forces::of_field(&questions, |d| Some([0.0, curl_n_m * d[0], 0.0]));
    let (net_j, exchanged_j) = loop_work(&questions.loops[0], &forces.loops[0]).expect("answered");
    assert!((net_j + curl_n_m * 1e-4).abs() < 1e-15 && (exchanged_j - curl_n_m * 1e-4).abs() < 1e-15);
    let judged = energy(&questions, &forces);
    near(value(&judged, "net_mj"), 5.0);
    near(value(&judged, "share_percent"), 100.0);
    // A gradient gives nothing back: each edge and its opposite cancel.
    let spring = Forces::of_field(&questions, |d| Some(d.map(|x| 200.0 * x)));
    let judged = energy(&questions, &spring);
    assert!(value(&judged, "net_mj").expect("answered") < 1e-9);
    // Each edge away from the origin stores 200 / 2 * 1e-4 J = 10 mJ, and returns it.
    near(value(&judged, "exchanged_mj"), 40.0);
}

#[test]
fn the_approach_does_not_count_and_a_gap_is_no_answer() {
    let questions = square();
    let mut forces = Forces::of_field(&questions, |_| Some([0.0; 3]));
    forces.loops[0][0] = None;
    near(value(&energy(&questions, &forces), "net_mj"), 0.0);
    forces.loops[0][4] = None;
    assert_eq!(value(&energy(&questions, &forces), "net_mj"), None);
}

#[test]
fn hands_are_judged_where_they_were_solved() {
    let truth_n = vec![Some([1.0, 0.0, 0.0]), None, Some([2.0, 0.0, 0.0])];
    let way = Way { name: "press".into(), counted_from: 0, displacement_m: vec![[0.0; 3]; 3], truth_n };
    let questions = Questions { hands: vec![way], ..Questions::default() };
    let mut forces = Forces::none(&questions);
    forces.hands[0] = vec![Some([1.01, 0.0, 0.0]), Some([9.0, 0.0, 0.0]), Some([2.03, 0.0, 0.0])];
    let judged = hands(&questions, &forces);
    near(value(&judged, "press.mean_mn"), 20.0);
    near(value(&judged, "press.max_mn"), 30.0);
}

#[test]
fn fewer_than_a_hundred_errors_have_a_largest_one_and_no_percentile() {
    // Errors of 1, 2, ... mN.
    let of = |asked: usize, answered: usize| {
        let truth_n = [1.0, 0.0, 0.0];
        let at = Position { displacement_m: [0.0; 3], truth_n, residual_n: 0.0 };
        let questions = Questions { positions: vec![at; asked], ..Questions::default() };
        let mut forces = Forces::none(&questions);
        for (n, force) in forces.positions.iter_mut().take(answered).enumerate() {
            *force = Some([1.0 + 1e-3 * (n + 1) as f64, 0.0, 0.0]);
        }
        positions(&questions, &forces)
    };
    let few = of(99, 99);
    assert!(few.iter().all(|figure| figure.key != "p99_mn"), "{few:?}");
    assert!(few.iter().any(|figure| figure.name == "largest of 99 errors, mN"), "{few:?}");
    near(value(&of(100, 100), "p99_mn"), 99.0);
    near(value(&of(100, 100), "max_mn"), 100.0);
    assert_eq!(value(&of(100, 99), "p99_mn"), None);
}
