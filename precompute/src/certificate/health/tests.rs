//! Verdicts of single figures, and of whole spaces.

use super::super::{Cost, Errors, Within};
use super::*;
use crate::num::jet::EnergyJet;
use crate::space::Task;

#[test]
fn a_figure_is_judged_by_its_limits_and_no_number_is_red() {
    for (figure, verdict) in
        [(0.0, Verdict::Green), (1e-3, Verdict::Yellow), (0.02, Verdict::Red), (f64::NAN, Verdict::Red)]
    {
        assert_eq!(BRANCHES.of(figure), verdict, "{figure}");
    }
}

/// With `count` independent positions.
fn method(count: usize, below_jnd: usize, tolerated: Option<Within>) -> MethodCertificate {
    let uniform = Errors { count, below_jnd, ..Errors::default() };
    MethodCertificate { method: "energy".into(), uniform, tolerated, ..MethodCertificate::default() }
}

/// A space of `configurations` without a branch jump.
fn space(configurations: usize, methods: &[MethodCertificate]) -> SpaceCertificate {
    let cost = Cost { configurations, ..Cost::default() };
    SpaceCertificate { cost, methods: methods.to_vec(), ..SpaceCertificate::default() }
}

#[test]
fn configurations_at_the_rounding_floor_are_counted() {
    let task = Task { target: [1, 0, 0], attempt: 0, round: 1, parent: None, chart: None };
    let record = |force_n: f64, residual_n: f64| {
        let mut numbers = [0.0; 20];
        numbers[1] = force_n;
        let jet = EnergyJet::from_numbers([0.0; 3], &numbers);
        Record { residual_n: Some(residual_n), ..Record::of_jet(&task, &jet, false) }
    };
    let found = space(3, &[method(300, 300, None)]);
    let of = |records: &[Record]| Health::of(records, &found, None, None);
    let health = of(&[record(0.0, 1e-13), record(1.0, 9e-9), record(3.0, 2e-8)]);
    assert_eq!((health.at_rounding_floor, health.verdict), (0, Verdict::Green), "{:?}", health.reasons);
    let health = of(&[record(1.0, 9e-9), record(1.0, 2e-7), record(0.0, 1e-9)]);
    assert_eq!((health.at_rounding_floor, health.verdict), (2, Verdict::Yellow));
    assert!(health.reasons[0].what.starts_with("2 of 3 reachable configurations have a residual above"));
}

#[test]
fn an_unknown_stability_is_said_and_is_no_part_of_the_share_of_unstable_ones() {
    let task = Task { target: [1, 0, 0], attempt: 0, round: 1, parent: None, chart: None };
    let record = |unstable_modes: Option<u32>| {
        let mut record = Record::of_jet(&task, &EnergyJet::from_numbers([0.0; 3], &[0.0; 20]), false);
        let solution = record.result.as_mut().expect("it is solved");
        solution.equilibrium.unstable_modes = unstable_modes;
        record
    };
    let found = space(300, &[method(300, 300, None)]);
    let records = |stable: usize| [vec![record(Some(0)); stable], vec![record(None); 3 * stable]].concat();
    let health = Health::of(&records(50), &found, None, None);
    assert_eq!((health.unstable, health.unknown_stability), (0, 150));
    let [Reason { verdict: Verdict::Yellow, what }] = &health.reasons[..] else { panic!("{health:?}") };
    assert!(what.starts_with("the stability of 150 of 200 reachable configurations is unknown"), "{what}");
    // One of 50 is more than 1 %, one of 200 is not.
    let health = Health::of(&[records(49), vec![record(Some(1))]].concat(), &found, None, None);
    assert_eq!(health.verdict, Verdict::Red, "{health:?}");
    assert!(health.reasons[0].what.starts_with("1 of 50 configurations of known stability are unstable"));
    // A certificate of an earlier version has no such number.
    let mut earlier = serde_json::to_value(&health).expect("plain data");
    earlier.as_object_mut().expect("an object").remove("unknown_stability").expect("it is written");
    let read: Health = serde_json::from_value(earlier).expect("it reads");
    assert_eq!((read.unstable, read.unknown_stability), (1, 0));
}

/// Each defect alone makes a sound space yellow or red, with its reason.
#[test]
fn the_loudest_reason_is_the_verdict() {
    let sound = Health { reachable: 200, min_jacobian: 0.4, ..Health::default() };
    let measured = [method(300, 300, None)];
    let judge = |health: &Health, methods: &[MethodCertificate], change: &dyn Fn(&mut SpaceCertificate)| {
        let mut found = space(200, methods);
        change(&mut found);
        let reasons = health.judged(&found, None);
        (reasons.iter().map(|r| r.verdict).max().unwrap_or_default(), reasons.len())
    };
    let judged = |health: &Health, change: &dyn Fn(&mut SpaceCertificate)| judge(health, &measured, change);
    let nothing = |_: &mut SpaceCertificate| {};
    assert_eq!(judge(&sound, &[], &nothing), (Verdict::Yellow, 1));
    let tolerance = Tolerance { relative: 0.0, absolute_n: 0.5 };
    for (of, below_jnd, tolerated, verdict) in [
        (5, 4, None, Verdict::Yellow),
        (5, 3, None, Verdict::Red),
        (300, 290, None, Verdict::Yellow),
        (300, 250, Some(300), Verdict::Yellow),
        (300, 300, Some(290), Verdict::Yellow),
        (300, 300, Some(250), Verdict::Red),
    ] {
        let tolerated = tolerated.map(|count| Within { tolerance, count, certified: 0.0 });
        let judged = judge(&sound, &[method(of, below_jnd, tolerated)], &nothing);
        assert_eq!(judged, (verdict, 1), "{below_jnd} of {of}, {tolerated:?}");
    }
    assert_eq!(judged(&sound, &nothing), (Verdict::Green, 0));
    for (health, verdict) in [
        (Health { unstable: 1, ..sound.clone() }, Verdict::Yellow),
        (Health { unstable: 10, ..sound.clone() }, Verdict::Red),
        (Health { unknown_stability: 1, ..sound.clone() }, Verdict::Yellow),
        (Health { unknown_stability: 200, ..sound.clone() }, Verdict::Yellow),
        (Health { switched: 10, ..sound.clone() }, Verdict::Red),
        (Health { inverted: 10, ..sound.clone() }, Verdict::Yellow),
        (Health { inverted: 90, ..sound.clone() }, Verdict::Red),
        (Health { residual_n: 1e-4, ..sound.clone() }, Verdict::Yellow),
        (Health { residual_n: f64::NAN, ..sound.clone() }, Verdict::Red),
        (Health { condition: Some(1e14), ..sound.clone() }, Verdict::Yellow),
        (Health { loop_passed: Some(false), ..sound.clone() }, Verdict::Yellow),
        (Health { loop_passed: Some(false), loop_stalled: true, ..sound.clone() }, Verdict::Yellow),
    ] {
        assert_eq!(judged(&health, &nothing), (verdict, 1), "{health:?}");
    }
    let jumps = |found: &mut SpaceCertificate| found.branch_jump_volume = 0.2;
    assert_eq!(judged(&sound, &jumps), (Verdict::Red, 1));
    let buckled =
        |found: &mut SpaceCertificate| found.two_solutions = BranchDifference { points: 1, apart_n: 0.5 };
    assert_eq!(judged(&sound, &buckled), (Verdict::Yellow, 1));
}
