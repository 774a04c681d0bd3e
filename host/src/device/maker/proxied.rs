//! A maker's device as the loop uses it: an exchange swaps two values in shared memory.

use super::child::Process;
use super::exchange::SILENT_NS;
use super::page::{Force, Health, SessionEnd};
use crate::device::workspace::Workspace;
use crate::device::{Device, DeviceError, DeviceErrorKind, DeviceInfo, DeviceState, wait_homed};
use core::sync::atomic::AtomicBool;
use palpate_core::{Orientation, Sample, Vec3, vec3};

/// Where the time of the pages comes from, ns.
pub type Clock = Box<dyn Fn() -> u64 + Send>;

/// The device behind a proxy.
pub struct Proxied {
    end: SessionEnd,
    workspace: Workspace,
    info: DeviceInfo,
    clock: Clock,
    /// The proxy's process; `None` of a proxy on a thread. Dropped after the last zero.
    process: Option<Process>,
    /// Time of the newest sample that was returned, ns.
    seen_ns: u64,
    /// The force that the device reported with it, model frame, N.
    reported_n: Option<Vec3>,
    /// The loop is armed.
    is_armed: bool,
    /// Number of the newest latch of which the loop has been told.
    told: u64,
}

impl core::fmt::Debug for Proxied {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Proxied").field("info", &self.info).finish_non_exhaustive()
    }
}

impl Proxied {
    pub(super) fn new(
        end: SessionEnd,
        workspace: Workspace,
        info: DeviceInfo,
        clock: Clock,
        process: Option<Process>,
    ) -> Self {
        Self { end, workspace, info, clock, process, seen_ns: 0, reported_n: None, is_armed: false, told: 0 }
    }

    /// A force or an axis of the device frame in the model frame.
    fn turned(&self, vector: Vec3) -> Vec3 {
        self.workspace.axes.map(|axis| vec3::dot(axis, vector))
    }

    /// Whether the proxy, or a device that is ready, has given nothing for too long.
    fn is_silent(&self, now_ns: u64, state: DeviceState) -> bool {
        let is_old = |t_ns: u64| now_ns.saturating_sub(t_ns) >= SILENT_NS;
        is_old(self.end.proxy_beat_ns()) || (state == DeviceState::Homed && is_old(self.seen_ns))
    }

    /// The rotation of the grip in the model frame, R q R^T with the rotation R from the device frame: the same angle about the
    /// axis there.
    fn in_model(&self, grip: Orientation) -> Orientation {
        Orientation { w: grip.w, xyz: self.turned(grip.xyz) }
    }
}

impl Device for Proxied {
    fn exchange(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        let now_ns = (self.clock)();
        if self.process.as_ref().is_some_and(Process::has_ended) {
            return Err(DeviceError::new(DeviceErrorKind::GuardLost));
        }
        let force_n = self.workspace.to_device_n(hand_force_n);
        self.end.send(Force { t_ns: now_ns, force_n, is_armed: self.is_armed });
        let (measured, health) = (self.end.measured(), self.end.health());
        let is_new = measured.t_ns > self.seen_ns;
        self.seen_ns = self.seen_ns.max(measured.t_ns);
        if is_new && health.state == DeviceState::Homed {
            self.reported_n = measured.rendered_n.map(|force_n| self.turned(force_n));
            let age_us = now_ns.saturating_sub(measured.t_ns) / 1_000;
            return Ok(Some(Sample {
                t_us: now_us.saturating_sub(age_us),
                position_m: self.workspace.to_model_m(measured.position_m),
                orientation: self.in_model(measured.orientation),
                buttons: measured.buttons,
            }));
        }
        match health.fault {
            _ if health.state == DeviceState::Disconnected => {
                Err(DeviceError::new(DeviceErrorKind::Disconnected))
            }
            Some(fault) => Err(DeviceError::new(DeviceErrorKind::Faulted(fault))),
            None if self.is_silent(now_ns, health.state) => Err(DeviceError::new(DeviceErrorKind::Timeout)),
            None => Ok(None),
        }
    }

    fn stop(&mut self) {
        self.end.send(Force { t_ns: (self.clock)(), ..Force::default() });
        self.end.end_loop();
    }

    fn info(&self) -> DeviceInfo {
        self.info.clone()
    }

    fn state(&self) -> DeviceState {
        self.end.health().state
    }

    fn home(&mut self, stop: &AtomicBool) -> Result<bool, DeviceError> {
        wait_homed(self, stop)?;
        Ok(self.state() == DeviceState::Homed)
    }

    fn was_zeroed(&mut self) -> bool {
        let Health { fault, latch, .. } = self.end.health();
        let is_new = latch != self.told && fault.is_some();
        self.told = if is_new { latch } else { self.told };
        is_new
    }

    fn reported_n(&self) -> Option<Vec3> {
        self.reported_n
    }

    fn reset(&mut self) -> bool {
        // Of one that comes meanwhile the loop is told first.
        self.end.reset(self.told);
        true
    }

    fn set_armed(&mut self, is_armed: bool) {
        self.is_armed = is_armed;
    }
}

impl Drop for Proxied {
    fn drop(&mut self) {
        self.stop();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::maker::exchange::Exchange;
    use crate::device::maker::page::{Measured, Page};
    use core::sync::atomic::{AtomicU64, Ordering};
    use palpate_link::DeviceFault;
    use std::sync::Arc;

    const MS: u64 = 1_000_000;

    struct Bench {
        device: Proxied,
        exchange: Exchange,
        now_ns: Arc<AtomicU64>,
    }

    impl Bench {
        /// Model x is device y, model y device z, model z device x.
        fn new() -> Self {
            let workspace = Workspace {
                axes: [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]],
                ..Workspace::default()
            };
            let info = DeviceInfo {
                name: "a maker's".into(),
                self_arming: false,
                max_force_n: 3.0,
                max_stiffness_n_m: 1_000.0,
                resolution_m: 1e-5,
            };
            let now_ns = Arc::new(AtomicU64::new(0));
            let clock = {
                let now_ns = now_ns.clone();
                Box::new(move || now_ns.load(Ordering::Relaxed))
            };
            let page = Page::local();
            let mut exchange = Exchange::new(page.clone().proxy(), 3.0);
            exchange.set_state(DeviceState::Homed);
            let mut device = Proxied::new(page.session(), workspace, info, clock, None);
            device.set_armed(true);
            Self { device, exchange, now_ns }
        }

        /// A cycle of the device, then a tick of the loop, at this time.
        fn at(
            &mut self,
            ms: u64,
            position_m: Vec3,
            force_n: Vec3,
        ) -> (Result<Option<Sample>, DeviceError>, Vec3) {
            self.now_ns.store(ms * MS, Ordering::Relaxed);
            let sent_n = self.exchange.force_n(ms * MS);
            let orientation = Orientation::of_vector([0.0, 0.3, 0.0]);
            self.exchange.publish(&Measured {
                t_ns: ms * MS - 500_000,
                position_m,
                orientation,
                rendered_n: Some(sent_n),
                ..Measured::default()
            });
            (self.device.exchange(1_000 * ms, force_n), sent_n)
        }
    }

    #[test]
    fn forces_and_samples_change_their_frames() {
        let mut bench = Bench::new();
        bench.at(1, [0.0; 3], [1.0, 2.0, -0.5]).0.expect("it works");
        let (sample, sent_n) = bench.at(2, [0.01, 0.02, 0.03], [0.0; 3]);
        assert_eq!(sent_n, [-0.5, 1.0, 2.0]);
        assert_eq!(bench.device.reported_n(), Some([1.0, 2.0, -0.5]));
        let sample = sample.expect("it works").expect("a new one");
        assert_eq!((sample.t_us, sample.position_m), (1_500, [0.02, 0.03, 0.01]));
        let turned = Orientation::of_vector([0.3, 0.0, 0.0]);
        assert!(vec3::distance(sample.orientation.xyz, turned.xyz) < 1e-7, "about the model's x");
        assert_eq!(bench.device.exchange(2_100, [0.0; 3]), Ok(None), "the same measurement again");
    }

    #[test]
    fn a_latched_fault_is_told_once_and_ends_with_the_reset() {
        let mut bench = Bench::new();
        bench.at(1, [0.0; 3], [1.0, 0.0, 0.0]).0.expect("it works");
        assert!(!bench.device.was_zeroed());
        bench.exchange.latch(MS, DeviceFault::Hardware);
        let (sample, sent_n) = bench.at(2, [0.0; 3], [1.0, 0.0, 0.0]);
        assert!(sample.is_ok_and(|sample| sample.is_some()) && sent_n == vec3::ZERO, "positions go on");
        assert_eq!([bench.device.was_zeroed(), bench.device.was_zeroed()], [true, false]);
        let again = bench.device.exchange(2_100, [0.0; 3]).expect_err("no new sample");
        assert_eq!(again.kind(), DeviceErrorKind::Faulted(DeviceFault::Hardware));
        assert!(bench.device.reset());
        bench.at(3, [0.0; 3], [1.0, 0.0, 0.0]).0.expect("it works");
        let before = bench.at(4, [0.0; 3], [1.0, 0.0, 0.0]).1;
        assert_eq!(before, vec3::ZERO, "a force from before the end of the latch");
        assert_eq!(bench.at(5, [0.0; 3], [0.0; 3]).1, [0.0, 1.0, 0.0]);
        assert!(!bench.device.was_zeroed());
        // A fault that returns at once is told again.
        bench.exchange.latch(6 * MS, DeviceFault::Hardware);
        bench.at(6, [0.0; 3], [0.0; 3]).0.expect("it works");
        assert!(bench.device.was_zeroed());
        bench.device.reset();
        bench.at(7, [0.0; 3], [0.0; 3]).0.expect("it works");
        bench.exchange.latch(7 * MS, DeviceFault::Overspeed);
        bench.at(8, [0.0; 3], [0.0; 3]).0.expect("it works");
        assert!(bench.device.was_zeroed());
    }

    #[test]
    fn a_silent_proxy_times_out_and_a_dropped_device_has_no_force() {
        let mut bench = Bench::new();
        bench.at(1, [0.0; 3], [0.0; 3]).0.expect("it works");
        let mut after = |ms: u64| {
            bench.now_ns.store(ms * MS, Ordering::Relaxed);
            bench.device.exchange(1_000 * ms, [0.0; 3])
        };
        assert_eq!(after(10), Ok(None));
        assert_eq!(after(11).expect_err("silent").kind(), DeviceErrorKind::Timeout);
        drop(bench.device);
        assert_eq!(bench.exchange.force_n(12 * MS), vec3::ZERO);
    }
}
