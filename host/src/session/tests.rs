//! Sessions on a simulated hand: records, ends, refusals.

use super::*;
use crate::device::DeviceError;
use crate::device::simulated::{SimulatedConfig, SimulatedHand};
use crate::rt::LoopEnd;
use crate::synthetic::{self, Shape};
use core::ops::ControlFlow;
use palpate_core::{Method, Sample, Vec3};
use std::time::Instant;

fn options(seconds: f64) -> SessionOptions {
    SessionOptions { seconds: Some(seconds), real_time: RtRequest::none(), ..SessionOptions::default() }
}

fn run(
    options: &SessionOptions,
    stop: &AtomicBool,
    observer: &mut impl Observer,
) -> Result<SessionSummary, SessionError> {
    let blob = synthetic::organ(&Shape::default());
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let mut config = SimulatedConfig::default();
    // Quick strokes: this hand's time does not advance while the machine is busy.
    config.strokes.seconds_per_node = 1.0;
    let hand = SimulatedHand::new(&organ, config);
    run_session(&[&organ], Config::new(Method::Hybrid), hand, options, stop, observer)
}

/// Counts pictures, and ends the session at one of them.
#[derive(Default)]
struct Counting {
    ticks: Vec<u64>,
    queue: Option<rtrb::Producer<TickRecord>>,
    pictures: u64,
    last: Option<u64>,
}

impl Observer for Counting {
    fn recording(&mut self) -> Option<rtrb::Producer<TickRecord>> {
        self.queue.take()
    }

    fn record(&mut self, record: &TickRecord) {
        self.ticks.push(record.tick);
    }

    fn time_to_frame(&self) -> Duration {
        Duration::ZERO
    }

    fn show(&mut self, _: &TickRecord, _: &Controls) -> ControlFlow<()> {
        self.pictures += 1;
        std::thread::sleep(Duration::from_millis(1));
        if Some(self.pictures) == self.last { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}

#[test]
fn a_short_session_counts_its_records_and_touches() {
    let mut ticks = Vec::new();
    let summary = run(&options(1.2), &AtomicBool::new(false), &mut |record: &TickRecord| {
        ticks.push(record.tick);
    })
    .expect("it runs");
    assert_eq!(summary.end, LoopEnd::Completed);
    assert_eq!(ticks.len() as u64, summary.ticks);
    assert!(ticks.windows(2).all(|pair| pair[0] < pair[1]));
    assert_eq!(summary.ticks + summary.latency.skipped_periods, 1_200);
    assert!(summary.touch.contacts >= 1 && summary.touch.peak_reaction_n > 0.5, "{summary}");
    let text = summary.to_string();
    assert!(text.contains("simulated hand") && text.contains("p99.9") && text.contains("contacts"), "{text}");
}

/// The queue of a recorder is filled by the loop: an observer that draws for half a second loses statistics,
/// but no record of the recording.
#[test]
fn a_slow_picture_drops_no_record_of_the_recording() {
    let (queue, mut recorded) = rtrb::RingBuffer::new(2_000);
    let mut slow = Slow(Counting { queue: Some(queue), ..Counting::default() });
    let short = SessionOptions { queue_ticks: 50, ..options(1.0) };
    let summary = run(&short, &AtomicBool::new(false), &mut slow).expect("it runs");
    let recorded: Vec<u64> = core::iter::from_fn(|| recorded.pop().ok()).map(|record| record.tick).collect();
    assert_eq!((recorded.len() as u64, summary.dropped_by_recorder), (summary.ticks, 0));
    assert!(summary.dropped_records > 300, "{summary}");
    assert_eq!(slow.0.ticks.len() as u64 + summary.dropped_records, summary.ticks);

    // A recorder that does not keep up drops records of its own queue only.
    let (queue, recorded) = rtrb::RingBuffer::new(10);
    let mut counting = Counting { queue: Some(queue), ..Counting::default() };
    let summary = run(&options(0.2), &AtomicBool::new(false), &mut counting).expect("it runs");
    assert_eq!((recorded.slots(), summary.dropped_by_recorder), (10, summary.ticks - 10));
    assert_eq!((counting.ticks.len() as u64, summary.dropped_records), (summary.ticks, 0));
}

struct Slow(Counting);

impl Observer for Slow {
    fn recording(&mut self) -> Option<rtrb::Producer<TickRecord>> {
        self.0.recording()
    }

    fn record(&mut self, record: &TickRecord) {
        self.0.record(record);
    }

    fn time_to_frame(&self) -> Duration {
        Duration::ZERO
    }

    fn show(&mut self, _: &TickRecord, _: &Controls) -> ControlFlow<()> {
        std::thread::sleep(Duration::from_millis(500));
        ControlFlow::Continue(())
    }
}

#[test]
fn an_observer_that_breaks_ends_the_session_and_is_not_shown_again() {
    let mut counting = Counting { last: Some(3), ..Counting::default() };
    let endless = SessionOptions { seconds: None, ..options(0.0) };
    let summary = run(&endless, &AtomicBool::new(false), &mut counting).expect("it runs");
    assert_eq!((summary.end, counting.pictures), (LoopEnd::Stopped, 3));
    assert_eq!(counting.ticks.len() as u64, summary.ticks);
}

/// A simulated hand that records when its force was zeroed.
struct ZeroObserved<'z>(SimulatedHand, &'z AtomicBool);

impl Device for ZeroObserved<'_> {
    fn exchange(&mut self, now_us: u64, force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        self.0.exchange(now_us, force_n)
    }

    fn stop(&mut self) {
        self.1.store(true, Ordering::SeqCst);
    }

    fn info(&self) -> DeviceInfo {
        self.0.info()
    }
}

/// A screen or disk that hangs must not keep the force on after Ctrl-C.
#[test]
fn the_stop_flag_zeroes_the_force_while_the_caller_hangs() {
    let blob = synthetic::organ(&Shape::default());
    let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
    let (stop, zeroed) = (AtomicBool::new(false), AtomicBool::new(false));
    let hand = SimulatedHand::new(&organ, SimulatedConfig::default());
    let endless = SessionOptions { seconds: None, ..options(0.0) };
    let (mut requested, mut in_time) = (false, false);
    let config = Config::new(Method::Hybrid);
    run_session(&[&organ], config, ZeroObserved(hand, &zeroed), &endless, &stop, &mut |_: &TickRecord| {
        if !core::mem::replace(&mut requested, true) {
            stop.store(true, Ordering::Relaxed);
            let started = Instant::now();
            while !zeroed.load(Ordering::SeqCst) && started.elapsed() < Duration::from_secs(20) {
                std::thread::sleep(Duration::from_millis(1));
            }
            in_time = zeroed.load(Ordering::SeqCst);
        }
    })
    .expect("it runs");
    assert!(in_time, "the loop ends while its caller hangs");
}

#[test]
fn the_stop_flag_ends_an_endless_session() {
    let stop = AtomicBool::new(false);
    let endless = SessionOptions { seconds: None, ..options(0.0) };
    let mut on_record = |record: &TickRecord| stop.store(record.tick >= 50, Ordering::Relaxed);
    let summary = run(&endless, &stop, &mut on_record);
    assert_eq!(summary.expect("it runs").end, LoopEnd::Stopped);
}

#[test]
fn invalid_options_are_refused_before_the_first_tick() {
    let stop = AtomicBool::new(false);
    let mut no_tick = |_: &TickRecord| panic!("no tick may run");
    let refused = run(&options(f64::NAN), &stop, &mut no_tick);
    assert!(matches!(refused, Err(SessionError::Seconds(_))));
    for priority in [98, 99] {
        let real_time = RtRequest { fifo_priority: Some(priority), ..RtRequest::none() };
        let refused = run(&SessionOptions { real_time, ..options(1.0) }, &stop, &mut no_tick);
        let refused = refused.expect_err("no priority is left for the guard");
        assert!(refused.to_string().contains("at most 97"), "{refused}");
    }
}

#[test]
fn a_panic_of_the_caller_does_not_hang_the_session() {
    let caught = std::panic::catch_unwind(|| {
        let endless = SessionOptions { seconds: None, ..options(0.0) };
        let mut panics = |_: &TickRecord| panic!("injected panic");
        let _ = run(&endless, &AtomicBool::new(false), &mut panics);
    });
    assert!(caught.is_err());
}
