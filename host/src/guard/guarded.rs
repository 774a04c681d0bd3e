//! A device with its guard, as the loop uses it.

use super::start::{Guard, GuardOptions, GuardStatus, shared_fence};
use crate::device::fence::Fence;
use crate::device::{Device, DeviceError, DeviceErrorKind, DeviceInfo, DeviceState};
use crate::sys;
use palpate_core::{Sample, Vec3, vec3};
use std::io;
use std::os::unix::net::UnixStream;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// A device and its guard. Every exchange is a beat; a closed fence and a silent guard end in zero force.
#[derive(Debug)]
pub struct Guarded<D: Device> {
    /// Dropped before the device: the guard writes its last zero while the device is open.
    guard: Guard,
    fence: Fence,
    limit_ns: u64,
    /// Whether the loop has been told that the fence is closed.
    is_reported: bool,
    /// Whether the driver can no longer write: the loop then stops to beat, so that the guard writes.
    is_stalled: bool,
    device: D,
}

/// A guard, or the device that has no motors to guard.
#[derive(Debug)]
pub enum Guarding<D: Device> {
    /// The device with its guard.
    Guarded(Box<Guarded<D>>),
    /// The device, which offers no path to a guard.
    Unneeded(D),
}

impl<D: Device> Guarded<D> {
    /// Starts `command` as the guard of an open device.
    pub fn start(mut device: D, command: Command, options: GuardOptions) -> io::Result<Guarding<D>> {
        let (fence, page) = shared_fence()?;
        let Some(path) = device.guard_path(&fence)? else { return Ok(Guarding::Unneeded(device)) };
        let guard = Guard::start(command, options, &page, &path)?;
        Ok(Guarding::Guarded(Box::new(Self::new(guard, fence, options, device))))
    }

    /// As [`Guarded::start`], with a guard that already waits at the other end of `socket`.
    pub fn at(mut device: D, socket: UnixStream, options: GuardOptions) -> io::Result<Guarding<D>> {
        let (fence, page) = shared_fence()?;
        let Some(path) = device.guard_path(&fence)? else { return Ok(Guarding::Unneeded(device)) };
        let guard = Guard::at(socket, options, &page, &path)?;
        Ok(Guarding::Guarded(Box::new(Self::new(guard, fence, options, device))))
    }

    fn new(guard: Guard, fence: Fence, options: GuardOptions, device: D) -> Self {
        let limit_ns = u64::from(options.limit_ms) * 1_000_000;
        Self { guard, fence, limit_ns, is_reported: false, is_stalled: false, device }
    }

    /// Status of the guard.
    #[must_use]
    pub fn status(&self) -> Arc<GuardStatus> {
        Arc::clone(&self.guard.status)
    }

    /// Whether the guard has been silent for longer than it allows the loop to be. A stopped process has not
    /// ended.
    fn guard_is_silent(&self, now_ns: u64) -> bool {
        now_ns.saturating_sub(self.fence.page().guard_beat_ns()) >= self.limit_ns
    }
}

impl<D: Device> Device for Guarded<D> {
    fn exchange(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        let now_ns = sys::monotonic_ns();
        if !self.is_stalled {
            self.fence.page().beat_loop(now_ns);
        }
        if self.guard.has_ended() {
            // The caller stops the device; nothing would zero it if this process were lost now.
            self.fence.page().close();
            return Err(DeviceError::new(DeviceErrorKind::GuardLost));
        }
        if self.guard_is_silent(now_ns) && !self.fence.is_closed() {
            self.fence.page().close();
        }
        let hand_force_n = if self.fence.is_closed() { vec3::ZERO } else { hand_force_n };
        let exchanged = self.device.exchange(now_us, hand_force_n);
        self.is_stalled = exchanged.is_err_and(|error| error.kind() == DeviceErrorKind::Stalled);
        exchanged
    }

    fn stop(&mut self) {
        self.device.stop();
        self.fence.page().end_loop();
    }

    fn home(&mut self, stop: &AtomicBool) -> Result<bool, DeviceError> {
        self.device.home(stop)
    }

    fn info(&self) -> DeviceInfo {
        self.device.info()
    }

    fn state(&self) -> DeviceState {
        self.device.state()
    }

    fn was_zeroed(&mut self) -> bool {
        let is_closed = self.fence.is_closed();
        let is_new = is_closed && !self.is_reported;
        if is_new {
            self.guard.status.count_firing();
        }
        self.is_reported = is_closed;
        self.device.was_zeroed() || is_new
    }

    fn set_armed(&mut self, is_armed: bool) {
        self.device.set_armed(is_armed);
    }

    fn reported_n(&self) -> Option<Vec3> {
        self.device.reported_n()
    }

    fn reset(&mut self) -> bool {
        // Behind a silent guard the fence stays closed, and was reported.
        if self.guard_is_silent(sys::monotonic_ns()) {
            return false;
        }
        self.fence.open();
        self.is_reported = false;
        self.device.reset()
    }
}
