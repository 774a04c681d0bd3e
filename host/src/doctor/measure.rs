//! Measures the wake-up lateness of the loop on this PC, with the rights of this user.

use super::Verdict;
use crate::rt::{
    Clock, LatencyRecorder, LatencyReport, LoopConfig, MonotonicClock, PeriodicTask, TickTimes, run_periodic,
};
use crate::sys::{self, RtReport, RtRequest};
use core::sync::atomic::AtomicBool;
use std::io;

/// p99 of the lateness above which 1 kHz is not possible, ns.
const OUT_OF_REACH_NS: u64 = 1_000_000;
/// p99 and p99.9 up to which the lateness is negligible against the period, ns.
const GOOD_NS: (u64, u64) = (50_000, 200_000);

/// Result of a measurement of the periodic schedule.
#[derive(Debug, Clone, PartialEq)]
pub struct Measurement {
    /// Period and spin.
    pub config: LoopConfig,
    /// What the operating system granted.
    pub real_time: RtReport,
    /// Lateness and missed deadlines.
    pub latency: LatencyReport,
}

impl Measurement {
    /// Assessment of the lateness.
    #[must_use]
    pub fn verdict(&self) -> Verdict {
        let wake = &self.latency.wake;
        match (wake.p99_ns, wake.p999_ns) {
            _ if wake.count == 0 => Verdict::Unknown,
            (p99_ns, _) if p99_ns > OUT_OF_REACH_NS => Verdict::Bad,
            (p99_ns, p999_ns) if p99_ns <= GOOD_NS.0 && p999_ns <= GOOD_NS.1 => Verdict::Good,
            _ => Verdict::Better,
        }
    }
}

/// A loop without work.
struct Idle<C> {
    clock: C,
    recorder: LatencyRecorder,
}

impl<C: Clock> PeriodicTask for Idle<C> {
    type Clock = C;
    type Error = core::convert::Infallible;

    fn clock(&self) -> &C {
        &self.clock
    }

    fn tick(&mut self, _index: u64, _origin_ns: u64, deadline_ns: u64) -> Result<(), Self::Error> {
        let wake_ns = self.clock.now_ns().saturating_sub(deadline_ns);
        self.recorder.record(TickTimes { wake_ns, device_ns: 0, compute_ns: 0 });
        Ok(())
    }

    fn overrun(&mut self, index: u64, skipped: u64, late_ns: u64) {
        self.recorder.record_overrun(index, skipped, late_ns);
    }
}

/// Runs an empty loop for `seconds` on its own thread, with the schedule of a session.
pub fn measure(
    seconds: f64,
    config: LoopConfig,
    request: RtRequest,
    stop: &AtomicBool,
) -> io::Result<Measurement> {
    let periods = (seconds * 1e6 / f64::from(config.period_us.max(1))).round() as u64;
    std::thread::scope(|scope| {
        let thread = std::thread::Builder::new().name("palpate-haptic".into());
        let handle = thread.spawn_scoped(scope, move || {
            let (real_time, _held) = sys::enter_real_time(&request);
            let latency = run_idle(MonotonicClock, config, stop, periods);
            Measurement { config, real_time, latency }
        })?;
        handle.join().map_err(|_| io::Error::other("the measuring thread panicked"))
    })
}

fn run_idle<C: Clock>(clock: C, config: LoopConfig, stop: &AtomicBool, periods: u64) -> LatencyReport {
    let mut idle = Idle { clock, recorder: LatencyRecorder::new() };
    run_periodic(&mut idle, config, stop, periods);
    idle.recorder.report()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rt::VirtualClock;
    use core::sync::atomic::{AtomicU64, Ordering};

    /// A clock on which every tenth wake-up is late by `late_ns`.
    struct Late {
        clock: VirtualClock,
        ticks: AtomicU64,
        late_ns: u64,
    }

    impl Clock for Late {
        fn now_ns(&self) -> u64 {
            self.clock.now_ns()
        }

        fn wait_until(&self, deadline_ns: u64, spin_ns: u64) {
            self.clock.wait_until(deadline_ns, spin_ns);
            if self.ticks.fetch_add(1, Ordering::Relaxed) % 10 == 9 {
                self.clock.advance_ns(self.late_ns);
            }
        }
    }

    fn measured(late_ns: u64) -> Measurement {
        let clock = Late { clock: VirtualClock::default(), ticks: AtomicU64::new(0), late_ns };
        let (config, stop) = (LoopConfig::default(), AtomicBool::new(false));
        let latency = run_idle(clock, config, &stop, 1_000);
        let (real_time, _) = sys::enter_real_time(&RtRequest::none());
        Measurement { config, real_time, latency }
    }

    #[test]
    fn the_verdict_follows_the_lateness() {
        for (late_ns, verdict) in [
            (0, Verdict::Good),
            (40_000, Verdict::Good),
            (900_000, Verdict::Better),
            (1_100_000, Verdict::Bad),
        ] {
            assert_eq!(measured(late_ns).verdict(), verdict, "{late_ns}");
        }
        let late = measured(2_500_000).latency;
        assert!(late.overruns > 50 && late.skipped_periods == 2 * late.overruns, "{late}");
    }

    #[test]
    fn the_real_schedule_is_measured_and_can_be_stopped() {
        let stop = AtomicBool::new(false);
        let measured =
            measure(0.05, LoopConfig::default(), RtRequest::none(), &stop).expect("a thread starts");
        let LatencyReport { wake, skipped_periods, .. } = measured.latency;
        assert_eq!(wake.count + skipped_periods, 50);
        stop.store(true, Ordering::Relaxed);
        let stopped = measure(1e6, LoopConfig::default(), RtRequest::none(), &stop).expect("a thread starts");
        assert_eq!(stopped.verdict(), Verdict::Unknown);
    }
}
