//! Devices that are another one with something about them: whatever they do not do themselves that one does.

use super::{Device, DeviceError, DeviceInfo, DeviceState, EmergencyStop};
use palpate_core::{Sample, Vec3};

/// A device around another one. It is a [`Device`] by what it says here; all else goes on to the inner one.
///
/// What a wrapper forgets to hand on would fall back to the defaults of [`Device`], and a fault that the inner one has latched would go unheard.
/// So there is nothing that can be forgotten: stop, second handle, latch and reset are always the inner one's.
pub trait Around: Send {
    /// What is inside.
    type Inner: Device + ?Sized;

    /// The device inside.
    fn inner(&self) -> &Self::Inner;

    /// The device inside.
    fn inner_mut(&mut self) -> &mut Self::Inner;

    /// [`Device::exchange`].
    fn exchange_around(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        self.inner_mut().exchange(now_us, hand_force_n)
    }

    /// [`Device::info`].
    fn info_around(&self) -> DeviceInfo {
        self.inner().info()
    }

    /// [`Device::state`].
    fn state_around(&self) -> DeviceState {
        self.inner().state()
    }
}

impl<A: Around> Device for A {
    fn exchange(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        self.exchange_around(now_us, hand_force_n)
    }

    fn stop(&mut self) {
        self.inner_mut().stop();
    }

    fn info(&self) -> DeviceInfo {
        self.info_around()
    }

    fn state(&self) -> DeviceState {
        self.state_around()
    }

    fn emergency_stop(&mut self) -> Option<Box<dyn EmergencyStop>> {
        self.inner_mut().emergency_stop()
    }

    fn was_zeroed(&mut self) -> bool {
        self.inner_mut().was_zeroed()
    }

    fn reset(&mut self) {
        self.inner_mut().reset();
    }
}

impl<D: Device + ?Sized> Around for Box<D> {
    type Inner = D;

    fn inner(&self) -> &D {
        self
    }

    fn inner_mut(&mut self) -> &mut D {
        self
    }
}

impl<D: Device + ?Sized> Around for &mut D {
    type Inner = D;

    fn inner(&self) -> &D {
        self
    }

    fn inner_mut(&mut self) -> &mut D {
        self
    }
}
