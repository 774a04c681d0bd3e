//! A solver that lags, is silent, or is gone.

use palpate_core::vec3::{self, Vec3};
use palpate_core::{Coverage, Field, Jet, Solver};

use crate::common::jets::Tool;

type OnePoint = Tool<1, 8>;

/// Trusted for 10 mm, 100 N/m along x: beyond 20 mm the force is 1.5 N.
fn spring() -> Jet {
    Jet { stiffness_n_m: [100.0, 0.0, 0.0, 0.0, 0.0, 0.0], trust_m: 0.01, ..Jet::default() }
}

fn at(x_mm: f32) -> Vec3 {
    [1e-3 * x_mm, 0.0, 0.0]
}

fn tool() -> OnePoint {
    let mut tool = OnePoint::new(&[(0, 1.0)]);
    tool.learn([spring()]);
    assert_eq!(tool.at(at(5.0)).coverage, Coverage::Scattered);
    tool
}

/// The force after `ms` milliseconds at a place, one tick per millisecond.
fn wait(tool: &mut OnePoint, x_mm: f32, ms: u32) -> f32 {
    (0..ms).map(|_| tool.at(at(x_mm)).force_n[0]).last().expect("a tick")
}

/// What the jet alone would give.
fn continued_n(x_mm: f32) -> f32 {
    spring().force(at(x_mm)).force_n[0]
}

#[test]
fn for_150_ms_the_force_is_continued_then_held() {
    for (ms, is_held) in [(1, false), (100, false), (149, false), (151, true), (300, true)] {
        let mut tool = tool();
        // The clock starts in the first of these ticks, so it is at `ms` in the next one.
        assert_eq!(wait(&mut tool, 12.0, ms), continued_n(12.0));
        // Deeper: the continuation grows, but a held force does not.
        let found = tool.at(at(15.0));
        assert_eq!(found.coverage, Coverage::Extrapolated);
        let expected_n = if is_held { continued_n(12.0) } else { continued_n(15.0) };
        if ms <= 149 {
            assert_eq!(found.force_n[0], expected_n, "{ms} ms");
        }
        // After the damping of this step.
        let rested_n = wait(&mut tool, 15.0, 20);
        assert!((rested_n - expected_n).abs() < 1e-5, "{ms} ms: {rested_n}, not {expected_n}");
    }
}

/// A held force still falls where the continuation falls.
#[test]
fn a_held_force_follows_the_tool_back() {
    let mut tool = tool();
    wait(&mut tool, 15.0, 200);
    assert!((wait(&mut tool, 11.0, 20) - continued_n(11.0)).abs() < 1e-5);
    assert!((wait(&mut tool, 15.0, 20) - continued_n(15.0)).abs() < 1e-5);
    assert!((wait(&mut tool, 18.0, 20) - continued_n(15.0)).abs() < 1e-5, "as large as when it was held");
}

#[test]
fn while_it_is_held_the_tool_is_damped() {
    let mut tool = tool();
    wait(&mut tool, 30.0, 300);
    // 0.1 m/s against the force, along y where the jet has no force.
    let force_n: Vec<Vec3> = (1..=20).map(|n| tool.at([0.03, 1e-4 * n as f32, 0.0]).force_n).collect();
    let [_, y, _] = *force_n.last().expect("ticks");
    assert!((y - 0.2).abs() < 0.01, "2 N s/m at 0.1 m/s, h has the sign of the velocity: {y}");
    // Below 150 ms there is none.
    let mut tool = self::tool();
    wait(&mut tool, 30.0, 10);
    for n in 1..=20 {
        assert_eq!(tool.at([0.03, 1e-4 * n as f32, 0.0]).force_n[1], 0.0);
    }
}

#[test]
fn from_500_ms_it_fades_out_in_300() {
    let mut tool = tool();
    wait(&mut tool, 15.0, 1);
    let full_n = continued_n(15.0);
    // `ms` after the clock started.
    let mut ms = 0;
    let mut until = |tool: &mut OnePoint, then: u32| {
        let found = wait(tool, 15.0, then - ms);
        ms = then;
        found / full_n
    };
    for (then, share) in
        [(149, 1.0), (151, 1.0), (500, 1.0), (530, 0.9), (650, 0.5), (770, 0.1), (801, 0.0), (2_000, 0.0)]
    {
        let found = until(&mut tool, then);
        assert!((found - share).abs() < 1e-4, "{then} ms: {found}, not {share}");
        // The force remains the gradient of the energy that a slip uses.
        let energy_j = tool.memory.energy_j(0, at(15.0)).expect("a jet");
        let whole_j = spring().energy_j(at(15.0));
        assert!((energy_j / whole_j - share).abs() < 1e-4, "{then} ms: {energy_j} J of {whole_j} J");
    }
    assert!(!tool.memory.is_lost(), "the solver is alive");
}

#[test]
fn when_jets_cover_the_tool_the_force_returns_in_300_ms() {
    let mut tool = tool();
    wait(&mut tool, 15.0, 1_000);
    assert_eq!(wait(&mut tool, 15.0, 1), 0.0);
    let exact = Jet { control_m: at(15.0), force_n: [1.4, 0.0, 0.0], ..spring() };
    tool.learn([exact]);
    // The fade between the jets is scaled too; after 100 ms nothing of it is left.
    for (ms, share) in [(100, 1.0 / 3.0), (50, 0.5), (135, 0.95), (20, 1.0), (500, 1.0)] {
        let found = wait(&mut tool, 15.0, ms) / 1.4;
        assert!((found - share).abs() < 2e-4, "{found}, not {share}");
    }
    // The clock starts anew.
    wait(&mut tool, 30.0, 140);
    assert_eq!(tool.at(at(30.0)).force_n[0], wait(&mut tool, 30.0, 1));
    assert!(tool.at(at(30.0)).force_n[0] > 1.4);
}

/// An interruption of 200 ms of the solver changes no bit inside the trust of the jets.
#[test]
fn a_silence_of_200_ms_changes_nothing_inside() {
    let run = |silent: bool| -> Vec<Vec3> {
        let mut tool = tool();
        (0..600)
            .map(|n| {
                let state = if silent && (100..300).contains(&n) { Solver::Silent } else { Solver::Alive };
                tool.memory.solver(state);
                tool.at(at(5.0 + 4.0 * (n as f32 * 0.05).sin())).force_n
            })
            .collect()
    };
    assert_eq!(run(true), run(false));
}

#[test]
fn a_solver_that_is_gone_fades_out_inside_the_trust_too() {
    let mut tool = tool();
    tool.memory.solver(Solver::Gone);
    let full_n = continued_n(5.0);
    wait(&mut tool, 5.0, 1);
    for (ms, share) in [(149, 1.0), (351, 1.0), (150, 0.5), (149, 0.003_33)] {
        assert!((wait(&mut tool, 5.0, ms) / full_n - share).abs() < 1e-3, "{ms} {share}");
        assert!(!tool.memory.is_lost());
    }
    assert_eq!(wait(&mut tool, 5.0, 2), 0.0);
    assert!(tool.memory.is_lost());
    // It has come back, for example because it was only stopped.
    tool.memory.solver(Solver::Alive);
    assert!(!tool.memory.is_lost());
    assert!((wait(&mut tool, 5.0, 150) / full_n - 0.5).abs() < 0.01);
    assert_eq!(wait(&mut tool, 5.0, 160), full_n);
}

/// The time of silence counts once the solver is known to be gone.
#[test]
fn the_time_of_silence_counts() {
    let mut tool = tool();
    tool.memory.solver(Solver::Silent);
    wait(&mut tool, 5.0, 401);
    tool.memory.solver(Solver::Gone);
    let full_n = continued_n(5.0);
    assert_eq!(wait(&mut tool, 5.0, 100), full_n);
    assert!((wait(&mut tool, 5.0, 150) / full_n - 0.5).abs() < 1e-3);
}

/// Also where the clock was already beyond the fade when it got effect.
#[test]
fn no_clock_starts_a_step() {
    for wait_ms in [400_u32, 700, 5_000] {
        let mut tool = tool();
        tool.memory.solver(Solver::Silent);
        let mut before_n = wait(&mut tool, 5.0, wait_ms);
        tool.memory.solver(Solver::Gone);
        for tick in 0..420 {
            let now_n = wait(&mut tool, 5.0, 1);
            assert!((now_n - before_n).abs() <= 0.5 / 300.0 * 1.01, "{wait_ms} ms, tick {tick}");
            before_n = now_n;
        }
        assert_eq!(before_n, 0.0);
    }
}

#[test]
fn a_free_tool_loses_a_solver_that_is_gone_after_the_same_time() {
    let mut tool = tool();
    tool.memory.solver(Solver::Gone);
    for _ in 0..800 {
        tool.release();
        assert!(!tool.memory.is_lost());
    }
    tool.release();
    tool.release();
    assert!(tool.memory.is_lost());
    // Of an extrapolated touch nothing remains.
    let mut tool = self::tool();
    wait(&mut tool, 15.0, 700);
    tool.release();
    assert_eq!(wait(&mut tool, 15.0, 1), continued_n(15.0));
}

/// A hand of 0.3 m/s through all of it, there and back, with and without jets that come late.
#[test]
fn the_force_has_no_step_from_tick_to_tick() {
    for late in [false, true] {
        let mut tool = tool();
        let mut before_n = tool.at(at(5.0)).force_n;
        let (mut largest_n, mut has_faded) = (0.0_f32, false);
        for n in 0..3_500_u32 {
            // Five times there and back, then still at 45 mm.
            let phase = (15e-3 * n as f32).min(11.0 * core::f32::consts::PI);
            let x_mm = 5.0 + 20.0 * (1.0 - phase.cos());
            if late && n % 700 == 600 {
                tool.learn([Jet { control_m: at(x_mm), force_n: [2.0, 0.0, 0.0], ..spring() }]);
            }
            let now_n = tool.at(at(x_mm)).force_n;
            largest_n = largest_n.max(vec3::distance(now_n, before_n));
            has_faded |= now_n == vec3::ZERO;
            before_n = now_n;
        }
        // 0.3 mm at 100 N/m and 2 N s/m of 0.3 m/s over 50 ms; a tenth of the step between jets that differ by up
        // to 3 N.
        let most_n = 0.03 + 0.03 + if late { 0.3 } else { 0.0 };
        assert!(largest_n < most_n, "{largest_n} N, late jets: {late}");
        assert_eq!(has_faded, !late, "at rest without a jet it fades");
    }
}
