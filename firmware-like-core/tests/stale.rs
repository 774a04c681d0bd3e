//! Missing, late and repeated samples.

use crate::common::bench::{assert_faults, assert_latched, config, sample};
use palpate_core::{Fault, Phase, vec3};

/// Three ticks hold the force, then it is zero, and after 10 ms a fault is latched.
#[test]
fn stale_samples() {
    bench!(bench, config());
    let held = bench.press();
    for _ in 0..3 {
        assert_eq!(bench.without_sample(), held);
    }
    for _ in 4..10 {
        let command = bench.without_sample();
        assert_eq!((command.hand_force_n, command.phase), ([0.0; 3], Phase::Active));
        assert_eq!(command.engaged, Some(0), "the contact is kept");
    }
    assert_faults(bench.without_sample(), Fault::Stale);
    assert_latched(bench, Fault::Stale);
}

/// A tick 9 ms after the last one may change the force as much as 2 ms permit.
#[test]
fn a_late_tick_permits_no_large_step() {
    let mut fast = config();
    (fast.limits.max_slew_n_per_s, fast.limits.max_speed_m_s) = (200.0, 100.0);
    for (late_us, most_n) in [(1_000, 0.2), (2_000, 0.4), (9_000, 0.4)] {
        bench!(bench, fast);
        let before = bench.press();
        bench.now_us += late_us;
        let sample = sample(bench.now_us, [0.0, 0.0, -12e-3]);
        let late = bench.controller.tick(&mut bench.state, bench.now_us, Some(&sample));
        let step_n = vec3::distance(late.hand_force_n, before.hand_force_n);
        assert_eq!(late.phase, Phase::Active);
        assert!((step_n - most_n).abs() < 1e-3, "{late_us} us late: {step_n} N");
    }
}

/// While samples are missing the force is held, then zero: the path over the gap is weighted with both.
#[test]
fn a_gap_is_weighted_with_its_zero_force() {
    bench!(bench, config());
    let held = bench.press();
    for _ in 0..6 {
        bench.without_sample();
    }
    let back = bench.at([0.0, 0.0, -6e-3]);
    let counted_j = back.hand_work_j - held.hand_work_j;
    // Over 7 ms: three ticks hold the force; the fourth computes zero, which is sent with the fifth.
    let expected_j = -1e-3 * held.hand_force_n[2] * 5.0 / 7.0;
    assert!((counted_j / expected_j - 1.0).abs() < 0.02, "{counted_j} J, not {expected_j}");
}

/// A repeated, an older or a very late sample counts as no sample.
#[test]
fn old_samples_are_no_samples() {
    type Age = fn(u64, u64) -> u64;
    let ages: [(&str, Age); 3] = [
        ("repeated", |pressed_us, _| pressed_us),
        ("older", |pressed_us, tick| pressed_us - 500 - tick),
        ("from before", |_, _| 0),
    ];
    for (name, age) in ages {
        bench!(bench, config());
        bench.press();
        let pressed_us = bench.now_us;
        for tick in 1..=10 {
            bench.now_us += 1000;
            let sample = sample(age(pressed_us, tick), [0.0, 0.0, -5e-3]);
            let command = bench.controller.tick(&mut bench.state, bench.now_us, Some(&sample));
            assert_eq!(command.hand_force_n == [0.0; 3], tick > 3, "{name}, tick {tick}");
        }
        assert_eq!(bench.state.phase(), Phase::SafeZero(Fault::Stale), "{name}");
    }
    // The sample is newer than the last one, but as old as the fault limit.
    bench!(bench, config());
    bench.press();
    bench.now_us += 20_000;
    let late = sample(bench.now_us - 10_000, [0.0, 0.0, -5e-3]);
    assert_faults(bench.controller.tick(&mut bench.state, bench.now_us, Some(&late)), Fault::Stale);
}

/// After a short gap the force returns within the slew limit.
#[test]
fn after_a_short_gap_the_force_returns_slowly() {
    let mut config = config();
    config.limits.max_slew_n_per_s = 100.0;
    bench!(bench, config);
    let steady = bench.press();
    for _ in 0..6 {
        bench.without_sample();
    }
    let mut force_n = 0.0;
    for _ in 0..100 {
        let now_n = vec3::norm(bench.at([0.0, 0.0, -5e-3]).hand_force_n);
        assert!(now_n - force_n <= 0.1 * 1.000_01 + 1e-6, "{force_n} -> {now_n}");
        force_n = now_n;
    }
    assert_eq!(force_n, vec3::norm(steady.hand_force_n));
}

/// The controller is armed, but receives no sample.
#[test]
fn silence_after_arming_is_stale() {
    bench!(bench, config());
    for _ in 0..10 {
        assert_eq!(bench.without_sample().phase, Phase::Active);
    }
    assert_faults(bench.without_sample(), Fault::Stale);
}
