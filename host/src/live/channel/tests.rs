//! The ends in one process: hammered by threads, judged by their heartbeats, and refused where they differ.

use super::*;
use palpate_core::NodeWeight;

fn jet(sequence: u32) -> Jet {
    Jet { sequence, trust_m: 0.01, force_n: [sequence as f32, 0.0, 1.0], ..Jet::default() }
}

/// A hand whose every number follows from one.
fn hand(number: u64) -> Hand {
    let x = (number % 1_000) as f32;
    Hand {
        tick: number,
        t_us: 1_000 * number,
        engaged: [NodeWeight { space: (number % 500) as u16, weight: x }; 3],
        displacement_m: [x; 3],
        velocity_m_s: [-x; 3],
        hip_m: [2.0 * x; 3],
        taken: number as u32,
        ..Hand::default()
    }
}

/// Both directions at once: frames in order and whole, hands and surfaces whole and never older.
#[test]
fn two_threads_hammer_every_part() {
    const LAST: u32 = 10_000;
    const VERTICES: usize = 333;
    let (mut solver, mut for_loop, mut view) = local(VERTICES);
    let begun = std::time::Instant::now();
    let in_time = || begun.elapsed() < Duration::from_secs(60);
    std::thread::scope(|scope| {
        scope.spawn(move || {
            let mut newest = 0;
            for sequence in 1..=LAST {
                solver.send(&jet(sequence)).expect("the session goes on");
                let read = solver.hand();
                assert!(read == hand(read.tick) && read.tick >= newest, "{read:?}");
                newest = read.tick;
                solver.show(&[[sequence as f32; 3]; VERTICES]);
            }
        });
        scope.spawn(move || {
            let (mut surface, mut before) = (vec![[0.0; 3]; VERTICES], 0);
            while before < u64::from(LAST) {
                assert!(in_time(), "the last surface seen is {before}");
                let number = view.surface(&mut surface);
                let is_whole = surface.as_flattened().iter().all(|x| *x == number as f32);
                assert!(is_whole && number >= before, "surface {number} after {before}");
                before = number;
            }
        });
        let (mut frame, mut taken, mut tick) = ([0; Jet::FRAME_LEN], 0, 0);
        while taken < LAST {
            assert!(in_time(), "{taken} frames");
            tick += 1;
            for_loop.publish(&hand(tick));
            if for_loop.take(&mut frame) {
                taken += 1;
                assert_eq!(Jet::decode(&frame), Ok(jet(taken)));
            }
        }
    });
}

#[test]
fn the_age_of_the_heartbeat_is_the_state() {
    const MS: u64 = 1_000_000;
    let (solver, for_loop, view) = local(0);
    solver.heart().beat(1_000 * MS);
    let states = [(0, Solver::Alive), (99, Solver::Alive), (100, Solver::Silent), (499, Solver::Silent)];
    for (age_ms, state) in states.into_iter().chain([(500, Solver::Gone), (1 << 30, Solver::Gone)]) {
        assert_eq!(for_loop.solver((1_000 + age_ms) * MS), state, "{age_ms}");
        assert_eq!(view.meter().solver((1_000 + age_ms) * MS), state, "{age_ms}");
    }
    assert_eq!(for_loop.solver(0), Solver::Alive, "the beat was after the start of the tick");
    solver.heart().beat(2_000 * MS);
    assert_eq!(for_loop.solver(2_001 * MS), Solver::Alive, "it resumes");
    for_loop.ended.note();
    assert_eq!(for_loop.solver(2_001 * MS), Solver::Gone, "a process that has ended is gone at once");
}

#[test]
fn counters_and_work_are_seen() {
    let (solver, _, view) = local(0);
    assert_eq!((view.meter().work(), view.meter().counters()), (Work::Idle, Counters::default()));
    let counters = Counters { solves: 3, busy_ns: 1 << 40, lost: 1 };
    solver.set_counters(counters);
    solver.set_work(Work::Solving);
    assert_eq!((view.meter().work(), view.meter().counters()), (Work::Solving, counters));
}

#[test]
fn an_odd_surface_is_shown_whole_and_is_at_rest_before() {
    let (mut solver, _, mut view) = local(3);
    let mut seen = [[9.0; 3]; 3];
    assert_eq!((view.surface(&mut seen), view.vertices(), solver.vertices()), (0, 3, 3));
    assert_eq!(seen, [[0.0; 3]; 3]);
    let shown = [[1.0, -2.0, 3.5], [0.0, 1e-9, 7.0], [5.0, 6.0, -0.25]];
    solver.show(&shown);
    assert_eq!((view.surface(&mut seen), seen), (1, shown));
}

#[test]
fn another_layout_is_refused() {
    let (_solver, fd) = create(10, Ended::default()).expect("memory");
    assert!(join(&fd, 10, Ended::default()).is_ok());
    let refused = |vertices| join(&fd, vertices, Ended::default()).expect_err("other sizes").kind();
    assert_eq!(refused(9), io::ErrorKind::InvalidData);
    assert_eq!(refused(100_000), io::ErrorKind::UnexpectedEof, "beyond the end of the file");
    assert_eq!(refused(usize::MAX), io::ErrorKind::InvalidData);
    assert!(create(usize::MAX, Ended::default()).is_err());
    let memory = SharedWords::map(&fd, 8).expect("the same memory");
    for (word, value) in [(0, MAGIC + 1), (1, VERSION + 1), (2, 1), (3, 1), (4, 1), (5, 11)] {
        let good = memory.words()[word].swap(value, Ordering::Relaxed);
        assert_eq!(refused(10), io::ErrorKind::InvalidData, "word {word}");
        memory.words()[word].store(good, Ordering::Relaxed);
    }
    assert!(join(&fd, 10, Ended::default()).is_ok());
}

/// A solver that waits for room beats, and learns that the session has ended.
#[test]
fn a_full_queue_makes_the_solver_wait_and_not_the_loop() {
    let session = Ended::default();
    let (mut solver, fd) = create(0, session.clone()).expect("memory");
    let (mut for_loop, _view) = join(&fd, 0, Ended::default()).expect("the same memory");
    let sent = (1..).take_while(|sequence| solver.try_send(&jet(*sequence))).count();
    assert_eq!(sent, RING_FRAMES);
    assert_eq!(for_loop.solver(crate::sys::monotonic_ns()), Solver::Gone, "it has never beaten");
    let waiting = std::thread::spawn(move || (solver.send(&jet(65)), solver.send(&jet(66))));
    while for_loop.solver(crate::sys::monotonic_ns()) != Solver::Alive {
        std::thread::yield_now();
    }
    let mut frame = [0; Jet::FRAME_LEN];
    assert!(for_loop.take(&mut frame) && Jet::decode(&frame) == Ok(jet(1)));
    session.note();
    let (first, second) = waiting.join().expect("no panic");
    assert_eq!((first.is_ok() || first == Err(SessionEnded), second), (true, Err(SessionEnded)));
}
