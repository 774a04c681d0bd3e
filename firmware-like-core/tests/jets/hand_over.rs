//! The force where another jet takes over.

use palpate_core::vec3;
use palpate_core::{Coverage, Jet, JetFlags};

use crate::common::jets::{Tool, flat, jet};
use crate::common::potential;

type OnePoint = Tool<1, 8>;

/// The forces of `ticks` ticks at a place.
fn forces(tool: &mut OnePoint, at: f32, ticks: usize) -> Vec<f32> {
    (0..ticks).map(|_| tool.at([at, 0.0, 0.0]).force_n[0]).collect()
}

#[test]
fn a_step_between_two_jets_takes_ten_milliseconds() {
    let mut tool = OnePoint::new(&[(0, 1.0)]);
    tool.learn([flat(0, [0.0; 3], [1.0, 0.0, 0.0]), flat(0, [0.01, 0.0, 0.0], [2.0, 0.0, 0.0])]);
    assert_eq!(forces(&mut tool, 0.002, 3), [1.0; 3]);
    assert_eq!(tool.memory.fade_step_n(), 0.0);
    let after = forces(&mut tool, 0.008, 60);
    assert_eq!(after[0], 1.0, "the force of the change itself");
    // The last of 60 ticks: what the fade takes of the remaining e^(-5.8) N.
    let last_n = (-5.8_f32).exp() * (1.0 - (-0.1_f32).exp());
    assert!((tool.memory.fade_step_n() / last_n - 1.0).abs() < 1e-3, "{}", tool.memory.fade_step_n());
    for (tick, force_n) in after.iter().enumerate() {
        let exact_n = 2.0 - (-0.1 * tick as f32).exp();
        assert!((force_n - exact_n).abs() < 1e-5, "tick {tick}: {force_n} {exact_n}");
    }
    let largest_n = after.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f32::max);
    assert!(largest_n <= 0.1, "{largest_n} N of 1 N in one tick");
    assert_eq!(tool.memory.hand_overs(), 1);
    assert_eq!(*forces(&mut tool, 0.008, 150).last().expect("ticks"), 2.0, "nothing remains");
    // The time between the ticks counts, not their number.
    let before_n = tool.at([0.001, 0.0, 0.0]).force_n[0];
    assert_eq!(before_n, 2.0);
    let late_n = tool.after_us(5_000, [0.001, 0.0, 0.0]).force_n[0];
    assert!((late_n - (1.0 + (-0.5_f32).exp())).abs() < 1e-5, "{late_n}");
}

#[test]
fn another_jet_must_be_nearer_by_a_tenth() {
    let mut tool = OnePoint::new(&[(0, 1.0)]);
    // Trust radii of 20 and 10 mm, 30 mm apart: equal distances at 20 mm.
    let right = Jet { trust_m: 0.01, ..flat(0, [0.03, 0.0, 0.0], [2.0, 0.0, 0.0]) };
    tool.learn([flat(0, [0.0; 3], [1.0, 0.0, 0.0]), right]);
    let mut takes_over = |from: f32, to: f32| {
        let before = tool.memory.hand_overs();
        let step = (to - from) / 2_000.0;
        let at = |n: u32| from + step * n as f32;
        let n = (0..2_000).find(|&n| {
            tool.at([at(n), 0.0, 0.0]);
            tool.memory.hand_overs() > before
        });
        at(n.expect("it takes over"))
    };
    let (there, back) = (takes_over(0.0, 0.03), takes_over(0.03, 0.0));
    // (30 - x) / 10 = 0.9 x / 20, and x / 20 = 0.9 (30 - x) / 10.
    assert!((there - 0.030 / 1.45).abs() < 3e-5, "{there}");
    assert!((back - 0.054 / 2.8).abs() < 3e-5, "{back}");
}

#[test]
fn a_better_jet_at_the_same_place_fades_in() {
    let mut tool = OnePoint::new(&[(0, 1.0)]);
    tool.learn([flat(0, [0.0; 3], [1.0, 0.0, 0.0])]);
    assert_eq!(forces(&mut tool, 0.0, 2), [1.0; 2]);
    tool.learn([flat(0, [5e-7, 0.0, 0.0], [1.5, 0.0, 0.0])]);
    assert_eq!(tool.memory.jets(0), 1, "replaced");
    let after = forces(&mut tool, 0.0, 2);
    assert!(after[0] == 1.0 && (after[1] - (1.5 - 0.5 * (-0.1_f32).exp())).abs() < 1e-5, "{after:?}");
    tool.learn([flat(0, [2e-6, 0.0, 0.0], [1.5, 0.0, 0.0])]);
    assert_eq!(tool.memory.jets(0), 2, "further away than a micrometre");
}

#[test]
fn after_a_jump_of_the_body_it_takes_no_longer() {
    let mut tool = OnePoint::new(&[(0, 1.0)]);
    tool.learn([flat(0, [0.0; 3], [1.0, 0.0, 0.0])]);
    forces(&mut tool, 0.0, 3);
    let flags = JetFlags { flush_before: true, ..JetFlags::default() };
    tool.learn([Jet { flags, ..flat(0, [1e-3, 0.0, 0.0], [4.0, 0.0, 0.0]) }]);
    assert_eq!(tool.memory.jets(0), 1, "the old jet contradicts the new one");
    for (tick, force_n) in forces(&mut tool, 0.0, 30).into_iter().enumerate() {
        let exact_n = 4.0 - 3.0 * (-(tick as f32) / 10.0).exp();
        assert!((force_n - exact_n).abs() < 1e-4, "tick {tick}: {force_n} {exact_n}");
    }
}

/// Where a tool has gone through a wall, or onto another one: a tenth of that speed.
#[test]
fn a_large_step_takes_a_hundred_milliseconds() {
    for (step_n, time_ms) in [(3.9, 10.0), (4.1, 100.0)] {
        let mut tool = OnePoint::new(&[(0, 1.0)]);
        let (near, far) = (flat(0, [0.0; 3], [6.0, 0.0, 0.0]), [6.0 - step_n, 0.0, 0.0]);
        tool.learn([near, flat(0, [0.01, 0.0, 0.0], far)]);
        forces(&mut tool, 0.002, 3);
        for (tick, force_n) in forces(&mut tool, 0.008, 60).into_iter().enumerate() {
            let exact_n = 6.0 - step_n * (1.0 - (-(tick as f32) / time_ms).exp());
            assert!((force_n - exact_n).abs() < 1e-4, "{step_n} N, tick {tick}: {force_n} {exact_n}");
        }
    }
}

#[test]
fn a_new_touch_begins_without_an_offset() {
    let mut tool = OnePoint::new(&[(0, 1.0)]);
    tool.learn([flat(0, [0.0; 3], [1.0, 0.0, 0.0]), flat(0, [0.01, 0.0, 0.0], [2.0, 0.0, 0.0])]);
    forces(&mut tool, 0.0, 2);
    tool.release();
    assert_eq!(tool.at([0.01, 0.0, 0.0]).force_n[0], 2.0);
    assert_eq!(tool.memory.hand_overs(), 0);
}

/// The only jet is of a place far away: its force comes in over the fade.
#[test]
fn a_touch_of_a_sphere_begins_without_force() {
    let mut tool = OnePoint::new(&[(0, 1.0)]);
    let flags = JetFlags { root: true, ..JetFlags::default() };
    tool.learn([Jet { flags, energy_j: 2.0, ..flat(0, [0.0; 3], [1.0, 0.0, 0.0]) }]);
    for (tick, force_n) in forces(&mut tool, 0.03, 30).into_iter().enumerate() {
        let exact_n = (2.0 + 0.03) * (1.0 - (-(tick as f32) / 10.0).exp());
        assert!((force_n - exact_n).abs() < 1e-4, "tick {tick}: {force_n} {exact_n}");
    }
}

/// A press of 20 mm at 0.2 m/s over jets of the nonlinear organ, 4 mm apart and each trusted for 4 mm.
#[test]
fn a_press_over_many_jets_is_smooth_and_right() {
    let mut tool = OnePoint::new(&[(0, 1.0)]);
    tool.learn((0..6).map(|n| jet(potential, 0, [0.0, 0.0, -4e-3 * n as f32], 4e-3)));
    let (mut largest_step_n, mut largest_error_n, mut before) = (0.0_f32, 0.0_f32, vec3::ZERO);
    for tick in 0..100 {
        let d = [0.0, 0.0, -2e-4 * tick as f32];
        let found = tool.at(d);
        assert_eq!(found.coverage, Coverage::Scattered);
        let exact = [0.0, 0.0, potential(d, [0, 0, 1]) as f32];
        largest_error_n = largest_error_n.max(vec3::distance(found.force_n, exact));
        largest_step_n = largest_step_n.max(vec3::distance(found.force_n, before));
        before = found.force_n;
    }
    assert_eq!(tool.memory.hand_overs(), 5);
    assert!(largest_error_n < 2e-3, "{largest_error_n} N");
    // 0.2 mm at 450 N/m.
    assert!(largest_step_n < 0.1, "{largest_step_n} N");
}
