//! The haptic thread: requests real-time scheduling, runs the loop, and stops the device on every exit.

use super::clock::Clock;
use super::haptic_loop::{HapticLoop, LoopOutcome};
use crate::device::Device;
use crate::sys::{self, RtReport, RtRequest};
use core::sync::atomic::AtomicBool;
use std::io;
use std::sync::OnceLock;
use std::thread::{Builder, Scope, ScopedJoinHandle};

/// Starts the loop on its own thread inside a scope, so organ and flags need to outlive only the scope.
///
/// `granted` is set to what the operating system granted before the first tick. A panic in the loop unwinds:
/// it stops the device and reaches the caller through the handle.
pub fn spawn<'scope, D, C, const N: usize>(
    scope: &'scope Scope<'scope, '_>,
    haptic: HapticLoop<'scope, 'scope, 'scope, D, C, N>,
    request: RtRequest,
    stop: &'scope AtomicBool,
    periods: u64,
    granted: &'scope OnceLock<RtReport>,
) -> io::Result<ScopedJoinHandle<'scope, (RtReport, LoopOutcome)>>
where
    D: Device + 'scope,
    C: Clock + Send + 'scope,
{
    Builder::new().name("palpate-haptic".into()).spawn_scoped(scope, move || {
        let (report, _memory_lock) = sys::enter_real_time(&request);
        // The cell is set once: with the same cell a second thread does not change it.
        let _ = granted.set(report);
        (report, haptic.run(stop, periods))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::{DeviceError, DeviceInfo};
    use crate::rt::{Controls, LoopConfig, LoopEnd, MonotonicClock, Outputs, TickRecord};
    use crate::synthetic::{self, Shape};
    use core::sync::atomic::{AtomicU64, Ordering};
    use palpate_core::{Config, Controller, Method, Organ, Sample, Vec3};

    struct PanickingDevice<'t> {
        stops: &'t AtomicU64,
        panics_at: u64,
        calls: u64,
    }

    impl Device for PanickingDevice<'_> {
        fn exchange(&mut self, now_us: u64, _: Vec3) -> Result<Option<Sample>, DeviceError> {
            self.calls += 1;
            assert!(self.calls < self.panics_at, "injected panic");
            Ok(Some(Sample { t_us: now_us, position_m: [0.0; 3], ..Sample::default() }))
        }

        fn stop(&mut self) {
            self.stops.fetch_add(1, Ordering::SeqCst);
        }

        fn info(&self) -> DeviceInfo {
            DeviceInfo {
                name: "falling".into(),
                self_arming: true,
                max_force_n: 1.0,
                max_stiffness_n_m: 1e3,
                resolution_m: 0.0,
            }
        }
    }

    fn run(panics_at: u64, periods: u64, stops: &AtomicU64) -> std::thread::Result<LoopOutcome> {
        let blob = synthetic::organ(&Shape::default());
        let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
        let controller = Controller::new(&organ, Config::new(Method::Trilinear)).expect("has the method");
        let (records, _drained) = rtrb::RingBuffer::new(1_000);
        let (latest, _seen) = triple_buffer::triple_buffer(&TickRecord::EMPTY);
        let (controls, stop) = (Controls::default(), AtomicBool::new(false));
        let granted = OnceLock::new();
        std::thread::scope(|scope| {
            let device = PanickingDevice { stops, panics_at, calls: 0 };
            let haptic = HapticLoop::new(
                controller,
                device,
                MonotonicClock,
                LoopConfig::default(),
                &controls,
                Outputs { records, latest },
            );
            let handle =
                spawn(scope, haptic, RtRequest::none(), &stop, periods, &granted).expect("a thread starts");
            handle.join().map(|(_, outcome)| outcome)
        })
    }

    #[test]
    fn a_panic_in_the_loop_ends_in_zero_force_and_is_reported() {
        let stops = AtomicU64::new(0);
        // Far more periods than ticks until the panic: a machine that stalls skips some.
        assert!(run(10, 5_000, &stops).is_err());
        assert_eq!(stops.load(Ordering::SeqCst), 1);
    }

    #[test]
    fn the_real_clock_paces_the_loop() {
        let stops = AtomicU64::new(0);
        let started = std::time::Instant::now();
        let outcome = run(u64::MAX, 40, &stops).expect("no panic");
        assert!(started.elapsed().as_secs_f64() >= 0.039, "40 periods of 1 ms");
        assert_eq!(outcome.end, LoopEnd::Completed);
        assert_eq!(outcome.ticks + outcome.latency.report().skipped_periods, 40);
        assert_eq!(stops.load(Ordering::SeqCst), 1);
    }
}
