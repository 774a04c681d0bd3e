use palpate_core::{Field, JetMemory, NodeWeight, Touch};

use super::*;
use crate::live::Published;
use crate::num::{SPLIT_MIX_STEP, split_mix, unit_interval};

/// Solver and loop remove the same jets, whatever was solved and flushed: the solver must not believe in a jet
/// that the loop has removed.
#[test]
fn the_loop_keeps_what_the_solver_keeps() {
    keeps_the_same(Known::default(), |numbers, control_m| EnergyJet::from_numbers(control_m, numbers));
    // The numbers are those of s, which is 0.2 at the origin.
    keeps_the_same(Known::of_stiffness(Some(200.0)), |numbers, control_m| {
        let mut numbers = *numbers;
        numbers[0] = 0.2 + 8.0 * control_m[2];
        numbers[3] += 8.0;
        EnergyJet::from_numbers(control_m, &numbers).squared()
    });
}

fn keeps_the_same(mut known: Known, jet: impl Fn(&[f64; 20], [f64; 3]) -> EnergyJet) {
    let mut state = 11u64;
    let mut random = || {
        state = state.wrapping_add(SPLIT_MIX_STEP);
        unit_interval(split_mix(state))
    };
    let mut memory = Box::new(JetMemory::<1, 256>::new());
    let (mut flushes, mut removed) = (0, 0);
    for number in 0..3_000 {
        // The force of a body that stiffens, with another level after each jump.
        let control_m: [f64; 3] = std::array::from_fn(|_| 0.02 * (2.0 * random() - 1.0));
        let control_m = if number == 0 { [0.0; 3] } else { control_m };
        let level = 1.0 + f64::from(flushes % 3) * 0.05;
        let r2 = control_m.iter().map(|x| x * x).sum::<f64>();
        let force_n = control_m.map(|x| level * 200.0 * x * (1.0 + 2e3 * r2));
        let mut numbers = [0.0; 20];
        numbers[1..4].copy_from_slice(&force_n);
        for (at, value) in [(4, 1.0), (7, 1.0), (9, 1.0)] {
            numbers[at] = value * level * 200.0 * (1.0 + 2e3 * r2);
        }
        numbers[10..].iter_mut().for_each(|third| *third = 4e4 * (2.0 * random() - 1.0));
        let trust = known.trust(jet(&numbers, control_m), None);
        let flush = number % 17 == 16;
        flushes += u32::from(flush);
        let before = known.jets().len();
        known.add(trust, 0, flush);
        removed += (before + 1).saturating_sub(known.jets().len());
        let published =
            Published { contact: 0, trust, joins: !flush, is_fresh: false, is_unstable: false, model: 0 };
        assert!(memory.insert(&published.jet(number)), "{number}");
        // A force that differs by the limit to seven digits may be judged in both ways.
        assert!(
            memory.jets(0).abs_diff(known.jets().len()) <= 1,
            "{number}: {} {}",
            memory.jets(0),
            known.jets().len()
        );
    }
    assert!(known.jets().len() <= 256 && removed > 500, "{removed} removed");
    // A full table: what the solver keeps is there, and gives its own force at its own control.
    for number in 3_000..3_400 {
        let control_m: [f64; 3] = std::array::from_fn(|_| 0.02 * (2.0 * random() - 1.0));
        let mut numbers = [0.0; 20];
        numbers[1] = f64::from(number);
        let trust = known.trust(jet(&numbers, control_m), None);
        known.add(trust, 0, false);
        let published =
            Published { contact: 0, trust, joins: true, is_fresh: false, is_unstable: false, model: 0 };
        assert!(memory.insert(&published.jet(number)), "{number}");
    }
    assert_eq!((known.jets().len(), memory.jets(0)), (256, 256));
    for trust in known.jets().filter(|trust| trust.root.is_none()) {
        memory.released(0);
        let at_m = trust.jet.control_m.map(|x| x as f32);
        let (of, none) = (NodeWeight { space: 0, weight: 1.0 }, NodeWeight::default());
        let (weights, half_axis_m) = ([of, none, none], None);
        let touch = Touch { now_us: 0, weights, displacement_m: at_m, hip_m: at_m, half_axis_m };
        let found_n = memory.force(&touch).expect("jets").force_n.map(f64::from);
        assert!(distance(found_n, trust.jet.force_n) < 1e-3 * norm(trust.jet.force_n), "{:?}", trust.jet);
    }
}

#[test]
fn a_trusted_jet_is_bounded_and_continuous_at_its_radius() {
    for third in [0.0, 1e3, 1e6, 1e9] {
        let mut numbers = [0.0; 20];
        numbers[1..4].copy_from_slice(&[0.1, -0.2, 1.0]);
        (numbers[4], numbers[7], numbers[9], numbers[10], numbers[19]) = (300.0, 200.0, 100.0, third, -third);
        let trust = Trust::of(EnergyJet::from_numbers([0.0; 3], &numbers), 300.0);
        let along = |r_m: f64| trust.force_n([0.6 * r_m, 0.0, 0.8 * r_m], None);
        let radius_m = trust.radius_m;
        let step = distance(along(radius_m * (1.0 + 1e-9)), along(radius_m * (1.0 - 1e-9)));
        assert!(step < 1e-6, "{third}: {step}");
        let far = distance(along(0.1), along(0.0));
        assert!(far <= 2.0 * 600.0 * (radius_m + 0.5 * radius_m.max(MIN_LEVELLING_M)), "{third}: {far} N");
    }
}

#[test]
fn a_contact_that_is_given_up_keeps_its_jet_at_rest() {
    let jet = |at: f64| EnergyJet::from_numbers([0.0, 0.0, -1e-3 * at], &[1.0; 20]);
    let mut known = Known::default();
    for at in [0.0, 3.0, 2.0, 5.0] {
        let trust = known.trust(jet(at), None);
        known.add(trust, 0, false);
    }
    assert_eq!(known.away_from_rest(), 3);
    let mut tabled = known.clone();
    known.keep_rest();
    assert_eq!(known.jets().map(|trust| trust.jet.control_m).collect::<Vec<_>>(), [[0.0; 3]]);
    tabled.are_tabled(1e-3);
    tabled.keep_rest();
    assert_eq!((tabled.away_from_rest(), tabled.jets().len()), (0, 4));
}

/// Two series with errors of c r^3 contradict each other by as much, whatever was measured elsewhere.
#[test]
fn series_that_contradict_each_other_are_not_believed() {
    let growth = Growth { error_n_m3: 1.0, least_n_m3: 0.0 };
    // The force 200 x + c x^3, and its expansions at 0 and at 10 mm.
    let jet = |c: f64, x: f64| {
        let mut numbers = [0.0; 20];
        numbers[1] = 200.0 * x + c * x * x * x;
        (numbers[4], numbers[7], numbers[9]) = (200.0 + 3.0 * c * x * x, 200.0, 200.0);
        numbers[10] = 6.0 * c * x;
        EnergyJet::from_numbers([x, 0.0, 0.0], &numbers)
    };
    for (c, is_known) in [(0.0, true), (1e6, false)] {
        let mut known = Known::default();
        for x in [0.0, 0.01] {
            let trust = known.trust(jet(c, x), None);
            known.add(trust, 0, false);
        }
        let at = ([0.005, 0.0, 0.0], 0);
        assert_eq!(growth.knows(&known, at, 1.0, Limit::Unknown), is_known, "c = {c:e} N/m^3");
        let (nearest, r_m) = known.nearest(at.0, 0).expect("a jet");
        let shown_n_m3 = known.contradiction_n_m3(at.0, 0, (nearest, r_m));
        assert!((0.5 * c..=2.0 * c).contains(&shown_n_m3) || c == 0.0 && shown_n_m3 < 1e-3, "{shown_n_m3:e}");
    }
}
