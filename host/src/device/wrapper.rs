//! Wrappers of a device: they change part of its behaviour and delegate the rest.

use super::fence::{Fence, GuardPath};
use super::{Device, DeviceError, DeviceInfo, DeviceState};
use core::sync::atomic::AtomicBool;
use palpate_core::{Sample, Vec3};

/// A wrapper of a [`Device`]. It implements [`Device`]: its own methods override four functions and all
/// others go to the inner device.
///
/// A wrapper that implemented [`Device`] itself could omit a function and fall back to the trait's default,
/// so a fault latched by the inner device would be lost. Here stop, homing, guard path, latch and reset always
/// go to the inner device.
pub trait DeviceWrapper: Send {
    /// The inner device.
    type Inner: Device + ?Sized;

    /// The inner device.
    fn inner(&self) -> &Self::Inner;

    /// The inner device, mutable.
    fn inner_mut(&mut self) -> &mut Self::Inner;

    /// [`Device::exchange`].
    fn wrapped_exchange(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        self.inner_mut().exchange(now_us, hand_force_n)
    }

    /// [`Device::set_armed`].
    fn wrapped_set_armed(&mut self, is_armed: bool) {
        self.inner_mut().set_armed(is_armed);
    }

    /// [`Device::info`].
    fn wrapped_info(&self) -> DeviceInfo {
        self.inner().info()
    }

    /// [`Device::state`].
    fn wrapped_state(&self) -> DeviceState {
        self.inner().state()
    }
}

impl<A: DeviceWrapper> Device for A {
    fn exchange(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        self.wrapped_exchange(now_us, hand_force_n)
    }

    fn stop(&mut self) {
        self.inner_mut().stop();
    }

    fn info(&self) -> DeviceInfo {
        self.wrapped_info()
    }

    fn state(&self) -> DeviceState {
        self.wrapped_state()
    }

    fn home(&mut self, stop: &AtomicBool) -> Result<bool, DeviceError> {
        self.inner_mut().home(stop)
    }

    fn guard_path(&mut self, fence: &Fence) -> std::io::Result<Option<GuardPath>> {
        self.inner_mut().guard_path(fence)
    }

    fn was_zeroed(&mut self) -> bool {
        self.inner_mut().was_zeroed()
    }

    fn set_armed(&mut self, is_armed: bool) {
        self.wrapped_set_armed(is_armed);
    }

    fn reported_n(&self) -> Option<Vec3> {
        self.inner().reported_n()
    }

    fn reset(&mut self) -> bool {
        self.inner_mut().reset()
    }
}

impl<D: Device + ?Sized> DeviceWrapper for Box<D> {
    type Inner = D;

    fn inner(&self) -> &D {
        self
    }

    fn inner_mut(&mut self) -> &mut D {
        self
    }
}

impl<D: Device + ?Sized> DeviceWrapper for &mut D {
    type Inner = D;

    fn inner(&self) -> &D {
        self
    }

    fn inner_mut(&mut self) -> &mut D {
        self
    }
}
