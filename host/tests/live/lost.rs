//! A solver process that dies, hangs or loses its core during a touch.

use super::process::started;
use super::{Press, is_right};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use palpate_core::{Config, Fault, Organ, Phase, Solver, vec3};
use palpate_host::live::{LiveField, TakenJet};
use palpate_host::rt::{LoopConfig, TickRecord};
use palpate_host::run_live_session;
use palpate_host::session::{Observer, SessionOptions, SessionSummary};
use palpate_host::sys::RtRequest;
use std::sync::atomic::AtomicBool;

pub(super) fn signal(pid: u32, signal: Signal) {
    kill(Pid::from_raw(pid as i32), signal).expect("it runs");
}

/// A press that stays, in real time: 4 mm, first 0.5 s long. At each of these ticks the solver gets the signal.
fn touched(seconds: f64, signals: &[(u64, Signal)]) -> (Vec<TickRecord>, SessionSummary) {
    let ready = started("serve");
    let organ: Organ<'_> = Organ::read(ready.blob.bytes()).expect("a valid blob");
    let pid = ready.process.pid().expect("a process");
    let jets = LiveField::new(ready.for_loop).expect("memory");
    let options = SessionOptions {
        seconds: Some(seconds),
        haptic: LoopConfig::default(),
        real_time: RtRequest { lock_memory: false, keep_awake: false, ..RtRequest::default() },
        ..SessionOptions::default()
    };
    let (press, stop) = (Press::on(&organ, 0.008, 0.0), AtomicBool::new(false));
    let (queue, mut taken) = rtrb::RingBuffer::new(1_000);
    let mut watch = Watch { pid, records: Vec::new(), left: signals.to_vec(), jets: Some(queue) };
    let summary = run_live_session(&organ, Config::live(), jets, press, &options, &stop, &mut watch);
    let summary = summary.expect("it runs");
    // Every jet reaches the recorder, with its number.
    let numbers: Vec<u32> = core::iter::from_fn(|| taken.pop().ok()).map(|jet| jet.number).collect();
    let live = summary.live.expect("a live session");
    assert_eq!((live.refused, live.dropped_by_recorder), (0, 0));
    assert!(live.taken >= 4 && numbers == (1..=live.taken).collect::<Vec<_>>(), "{numbers:?}");
    (watch.records, summary)
}

/// Keeps the records, and sends each signal when its tick has come.
struct Watch {
    pid: u32,
    records: Vec<TickRecord>,
    left: Vec<(u64, Signal)>,
    jets: Option<rtrb::Producer<TakenJet>>,
}

impl Observer for Watch {
    fn recording_jets(&mut self) -> Option<rtrb::Producer<TakenJet>> {
        self.jets.take()
    }

    fn record(&mut self, record: &TickRecord) {
        self.records.push(*record);
        while let Some((_, due)) = self.left.first().filter(|(tick, _)| *tick <= record.tick) {
            signal(self.pid, *due);
            self.left.remove(0);
        }
    }
}

/// The first record for which something holds.
fn first(records: &[TickRecord], what: &str, is: impl Fn(&TickRecord) -> bool) -> TickRecord {
    *records.iter().find(|record| is(record)).unwrap_or_else(|| panic!("no record: {what}"))
}

fn state(record: &TickRecord) -> Solver {
    record.live.expect("a live tick").solver
}

/// Largest change of the force between two ticks from `begin_us` on, N. A machine that stands still for a moment
/// makes a longer step, and the velocity by which the tool is damped changes until its 15 positions are new:
/// these ticks do not count.
fn largest_step_n(records: &[TickRecord], begin_us: u64) -> f32 {
    let steady = records.windows(17).filter(|ticks| {
        ticks[15].t_us >= begin_us && ticks.windows(2).all(|pair| pair[1].t_us - pair[0].t_us < 2_000)
    });
    steady.map(|ticks| vec3::distance(ticks[15].hand_force_n, ticks[16].hand_force_n)).fold(0.0, f32::max)
}

/// The fade after a loss: without a step, and complete 800 ms after the first tick in which the solver was not
/// alive.
fn assert_soft_fade(records: &[TickRecord], lost: &TickRecord) {
    let latched = first(records, "the fault", |record| record.phase == Phase::SafeZero(Fault::Solver));
    let took_us = latched.t_us - lost.t_us;
    assert!((790_000..900_000).contains(&took_us), "{took_us} us from the loss to the fault");
    let before = records.iter().rfind(|record| record.t_us < lost.t_us).expect("a touch");
    let force_n = vec3::norm(before.hand_force_n);
    assert!(force_n > 1.5, "{force_n} N at the loss");
    // The whole force in 300 ms is 1/300 of it a tick.
    let step_n = largest_step_n(records, before.t_us);
    assert!(step_n < 0.05 * force_n, "{step_n} N of {force_n} N");
    let last = records.iter().rfind(|record| record.phase == Phase::Active).expect("it faded");
    let left_n = force_n * (latched.t_us - last.t_us) as f32 / 300e3;
    assert!(vec3::norm(last.hand_force_n) < f32::max(0.05, 2.0 * left_n), "{last:?}");
}

#[test]
fn a_killed_solver_ends_in_a_soft_fade_and_a_fault() {
    let (records, summary) = touched(2.5, &[(1_000, Signal::SIGKILL)]);
    let gone = first(&records, "gone", |record| state(record) == Solver::Gone);
    assert!((1_000_000..1_150_000).contains(&gone.t_us), "noticed at {} us", gone.t_us);
    assert!(records.iter().filter(|record| record.t_us < gone.t_us).all(is_right));
    assert_soft_fade(&records, &gone);
    assert_eq!(summary.phase, Phase::SafeZero(Fault::Solver), "{summary}");
}

#[test]
fn a_hung_solver_ends_in_a_soft_fade_and_a_fault() {
    let (records, summary) = touched(2.9, &[(1_000, Signal::SIGSTOP)]);
    let silent = first(&records, "silent", |record| state(record) == Solver::Silent);
    let gone = first(&records, "gone", |record| state(record) == Solver::Gone);
    assert!((1_095_000..1_250_000).contains(&silent.t_us), "silent at {} us", silent.t_us);
    assert!(gone.t_us - silent.t_us >= 395_000, "{silent:?} {gone:?}");
    let late = records.iter().find(|r| r.t_us > silent.t_us + 405_000 && state(r) != Solver::Gone);
    assert!(late.is_none(), "{silent:?} {late:?}");
    assert_soft_fade(&records, &silent);
    assert_eq!(summary.phase, Phase::SafeZero(Fault::Solver), "{summary}");
}

#[test]
fn a_core_stolen_for_200_ms_does_not_end_the_touch() {
    let (records, summary) = touched(
        2.0,
        &[
            (1_000, Signal::SIGSTOP),
            (1_200, Signal::SIGCONT),
            (1_500, Signal::SIGSTOP),
            (1_700, Signal::SIGCONT),
        ],
    );
    assert!(records.iter().any(|record| state(record) == Solver::Silent), "the silence is noticed");
    assert!(records.iter().all(|record| state(record) != Solver::Gone && record.phase == Phase::Active));
    assert!(records.iter().all(is_right), "the force is that of the jets all the time");
    let force_n = records.last().map(|record| vec3::norm(record.hand_force_n));
    assert!(force_n.is_some_and(|force_n| force_n > 1.5), "{force_n:?}");
    let text = summary.to_string();
    println!("{text}");
    assert!(text.contains("jets taken; first force 0.") && text.contains("0.00 % of the ticks"), "{text}");
}
