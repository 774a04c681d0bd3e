//! The emulated Falcon behind a rig in the guest. Time advances only on the guest's request, because the
//! guest's own clock is not real time.

use super::remote::{RigReply, RigRequest};
use crate::falcon::{FaultyFtdi, MemoryFtdi, Setup, Stall};
use crate::rig::FalconRig;
use crate::usbredir::UsbDevice;
use palpate_host::device::falcon::Ftdi;
use std::sync::Arc;
use std::time::Duration;

/// Time step for each poll while a driver is being opened, us.
const RUN_STEP_US: u64 = 50;

/// A device, its hand and the link of the driver that holds it.
pub struct Stepped {
    rig: FalconRig,
    link: Arc<FaultyFtdi<MemoryFtdi>>,
    is_opening: bool,
}

impl Stepped {
    /// A new device, plugged in.
    ///
    /// # Panics
    ///
    /// Never: its cable is in.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        let mut rig = FalconRig::new(seed);
        let link = rig.connect().expect("a new device is plugged in");
        Self { rig, link, is_opening: false }
    }

    /// Whether the cable is in.
    #[must_use]
    pub fn is_plugged(&self) -> bool {
        self.link.inner().falcon().is_plugged()
    }

    /// Whether a driver is being opened: time advances while the host waits for a transfer.
    #[must_use]
    pub const fn is_opening(&self) -> bool {
        self.is_opening
    }

    /// Advances time if a driver is being opened. Called while the host waits for a transfer.
    pub fn wait(&mut self) {
        if self.is_opening {
            let mut falcon = self.link.inner().falcon();
            let next_us = falcon.now_us() + RUN_STEP_US;
            falcon.advance(next_us);
        }
    }

    /// Executes a request.
    pub fn execute(&mut self, request: RigRequest) -> RigReply {
        match request {
            RigRequest::NewDevice { seed } => *self = Self::new(seed),
            RigRequest::BeginOpen => {
                // Data of the earlier driver is lost with its link.
                if let Ok(link) = self.rig.connect() {
                    self.link = link;
                }
                self.is_opening = true;
            }
            RigRequest::EndOpen => {
                self.is_opening = false;
                self.rig.begin();
            }
            request => return RigReply::of(&mut self.rig, request),
        }
        RigReply::Done
    }
}

impl UsbDevice for Stepped {
    fn control(&mut self, setup: Setup, data: &[u8]) -> Result<Vec<u8>, Stall> {
        control(&self.link, setup, data)
    }

    fn bulk_out(&mut self, bytes: &[u8]) -> Result<usize, Stall> {
        if !self.is_plugged() {
            // The transfer is lost until the guest detects the unplugging.
            return Ok(0);
        }
        // A transfer during which the cable is pulled is lost too.
        Ok(self.link.write(bytes, Duration::ZERO).unwrap_or(0))
    }

    fn bulk_in(&mut self, max: usize) -> Result<Option<Vec<u8>>, Stall> {
        if !self.is_plugged() {
            return Ok(None);
        }
        let mut buffer = vec![0; max];
        let read = self.link.read(&mut buffer, Duration::ZERO);
        Ok(read.ok().map(|count| {
            buffer.truncate(count);
            buffer
        }))
    }
}

/// A control transfer. Requests of the chip pass through the faulty link, because a purge also discards what
/// that holds.
pub(super) fn control(link: &FaultyFtdi<MemoryFtdi>, setup: Setup, data: &[u8]) -> Result<Vec<u8>, Stall> {
    if setup == Setup::vendor(setup.request, setup.value) {
        return link.control(setup.request, setup.value).map(|()| Vec::new()).map_err(|_| Stall);
    }
    link.inner().falcon().control(setup, data)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_advances_only_while_a_driver_is_being_opened() {
        let mut device = Stepped::new(1);
        let now_us = |device: &Stepped| device.link.inner().falcon().now_us();
        device.wait();
        assert_eq!(now_us(&device), 0);
        device.execute(RigRequest::BeginOpen);
        device.wait();
        assert_eq!(now_us(&device), RUN_STEP_US);
        device.execute(RigRequest::EndOpen);
        device.wait();
        assert_eq!(now_us(&device), RUN_STEP_US);
        let reply = device.execute(RigRequest::Advance {
            from_us: 0,
            until_us: 1_000,
            every_us: 250,
            wait_for_driver: false,
        });
        assert!(matches!(reply, RigReply::Positions(positions) if positions.len() == 4));
        assert_eq!(now_us(&device), RUN_STEP_US + 1_000, "the driver's clock began when opening ended");
    }

    #[test]
    fn an_unplugged_device_is_silent_and_a_new_driver_has_a_new_link() {
        let mut device = Stepped::new(1);
        device.execute(RigRequest::InjectFault(crate::fault::FaultKind::Replug));
        assert!(!device.is_plugged());
        assert_eq!((device.bulk_out(b"x"), device.bulk_in(64)), (Ok(0), Ok(None)));
        device.execute(RigRequest::Replug);
        device.execute(RigRequest::BeginOpen);
        assert_eq!(device.bulk_out(b"x"), Ok(1));
        for _ in 0..1_000 {
            device.wait();
        }
        assert_eq!(device.bulk_in(64).map(|packet| packet.map(|bytes| bytes.len())), Ok(Some(2)));
    }
}
