//! Two processes hammer the channel: nothing is torn, lost or reordered, and the death of one leaves the other
//! with whole values.

use super::process::started;
use crate::fake_solver::jet;
use palpate_core::{Jet, Solver};
use palpate_host::live::{Hand, Serving};
use palpate_host::sys::monotonic_ns;
use std::time::{Duration, Instant};

pub(super) const VERTICES: usize = 101;
const FRAMES: u32 = 50_000;
const CERTAIN: Duration = Duration::from_secs(60);

fn hand(number: u64) -> Hand {
    let x = (number % 4_096) as f32;
    let [displacement_m, velocity_m_s, hip_m] = [[x; 3], [-x; 3], [x, 0.0, -x]];
    Hand { tick: number, t_us: 3 * number, displacement_m, velocity_m_s, hip_m, ..Hand::default() }
}

fn frame_jet(sequence: u32) -> Jet {
    jet((sequence % 7) as u16, sequence, [1e-6 * (sequence % 10_000) as f32, 0.0, 1e-3])
}

/// The solver's side. It reports what it saw of the hand after `FRAMES` frames, and goes on for ever.
pub(super) fn solver(mut serving: Serving) {
    let (mut newest, mut torn) = (0, 0);
    for sequence in 1.. {
        if serving.end.send(&frame_jet(sequence)).is_err() {
            return;
        }
        let read = serving.end.hand();
        torn += u64::from(read != hand(read.tick) || read.tick < newest);
        newest = read.tick;
        serving.end.show(&[[sequence as f32; 3]; VERTICES]);
        if sequence == FRAMES {
            let line = format!("torn {torn}, newest above 0: {}", newest > 0);
            assert!(serving.report(&line).expect("the session goes on"));
        }
    }
}

#[test]
fn two_processes_lose_reorder_and_tear_nothing_and_a_kill_leaves_whole_values() {
    let mut ready = started("hammer");
    let (mut frame, mut taken, mut tick) = ([0; Jet::FRAME_LEN], 0, 0);
    let (mut surface, mut before) = ([[0.0; 3]; VERTICES], 0);
    let begun = Instant::now();
    let mut killed = None;
    loop {
        tick += 1;
        ready.for_loop.publish(&hand(tick));
        if ready.for_loop.take(&mut frame) {
            taken += 1;
            assert_eq!(Jet::decode(&frame), Ok(frame_jet(taken)));
        } else if killed.is_some_and(|at: Instant| at.elapsed() > Duration::from_millis(50)) {
            // Nothing more can come.
            break;
        }
        let number = ready.view.surface(&mut surface);
        let is_whole = surface.as_flattened().iter().all(|x| *x == number as f32);
        assert!(is_whole && number >= before, "surface {number} after {before}");
        before = number;
        // In the middle of whatever it does.
        if taken > FRAMES && killed.is_none() {
            let line = ready.process.next_line(CERTAIN).expect("it goes on");
            assert_eq!(line.as_deref(), Some("torn 0, newest above 0: true"));
            let pid = ready.process.pid().expect("a process");
            super::lost::signal(pid, nix::sys::signal::Signal::SIGKILL);
            killed = Some(Instant::now());
        }
        assert!(begun.elapsed() < CERTAIN, "{taken} frames");
    }
    let noticed = Instant::now();
    while ready.for_loop.solver(monotonic_ns()) != Solver::Gone {
        assert!(noticed.elapsed() < CERTAIN);
    }
    assert!(ready.process.has_ended() && taken >= FRAMES);
}
