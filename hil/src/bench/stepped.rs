//! The emulated Falcon behind a rig in the guest: time stands still but where the guest says so, so that the guest's own time, which is not
//! real, does not matter.

use super::ask::{Ask, Told};
use crate::falcon::{FaultyFtdi, MemoryFtdi, Setup, Stall};
use crate::rig::FalconRig;
use crate::usbredir::UsbDevice;
use palpate_host::device::falcon::Ftdi;
use std::sync::Arc;
use std::time::Duration;

/// How far time goes each time the device is looked at while a driver that is being opened waits, us.
const RUN_STEP_US: u64 = 50;

/// A device, its hand and the link of the driver that has it.
pub struct Stepped {
    rig: FalconRig,
    link: Arc<FaultyFtdi<MemoryFtdi>>,
    runs: bool,
}

impl Stepped {
    /// A device like new.
    ///
    /// # Panics
    ///
    /// Never: its cable is in.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        let mut rig = FalconRig::new(seed);
        let link = rig.connect().expect("a new device is plugged in");
        Self { rig, link, runs: false }
    }

    /// Whether the cable is in.
    #[must_use]
    pub fn is_plugged(&self) -> bool {
        self.link.inner().falcon().is_plugged()
    }

    /// Whether time goes on by itself where somebody waits: a driver is being opened.
    #[must_use]
    pub const fn runs(&self) -> bool {
        self.runs
    }

    /// Somebody waits for what the device sends next: time goes on, if a driver is being opened.
    pub fn wait(&mut self) {
        if self.runs {
            let mut falcon = self.link.inner().falcon();
            let next_us = falcon.now_us() + RUN_STEP_US;
            falcon.advance(next_us);
        }
    }

    /// Does what was asked.
    pub fn obey(&mut self, ask: Ask) -> Told {
        match ask {
            Ask::Fresh { seed } => *self = Self::new(seed),
            Ask::Run => {
                // What the driver before had of it is lost with that one's link.
                if let Ok(link) = self.rig.connect() {
                    self.link = link;
                }
                self.runs = true;
            }
            Ask::Hold => {
                self.runs = false;
                self.rig.begin();
            }
            ask => return Told::of(&mut self.rig, ask),
        }
        Told::Done
    }
}

impl UsbDevice for Stepped {
    fn control(&mut self, setup: Setup, data: &[u8]) -> Result<Vec<u8>, Stall> {
        control(&self.link, setup, data)
    }

    fn bulk_out(&mut self, bytes: &[u8]) -> Result<usize, Stall> {
        if !self.is_plugged() {
            // Nobody is there to say anything, until the bus notices.
            return Ok(0);
        }
        // Once the cable is pulled in the middle of it nobody answers either.
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

/// A control transfer. The chip's own requests go through the wire's faults: a purge also throws away what they hold back.
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
    fn time_stands_still_but_while_a_driver_is_opened_and_waits() {
        let mut device = Stepped::new(1);
        let now_us = |device: &Stepped| device.link.inner().falcon().now_us();
        device.wait();
        assert_eq!(now_us(&device), 0);
        device.obey(Ask::Run);
        device.wait();
        assert_eq!(now_us(&device), RUN_STEP_US);
        device.obey(Ask::Hold);
        device.wait();
        assert_eq!(now_us(&device), RUN_STEP_US);
        let told = device.obey(Ask::Pass { from_us: 0, until_us: 1_000, every_us: 250, is_read: false });
        assert!(matches!(told, Told::Was(places) if places.len() == 4));
        assert_eq!(now_us(&device), RUN_STEP_US + 1_000, "the driver's clock began when it was open");
    }

    #[test]
    fn a_pulled_cable_is_silent_and_a_driver_that_is_opened_then_has_a_link_of_its_own() {
        let mut device = Stepped::new(1);
        device.obey(Ask::Unplug(crate::rig::Cut::Between));
        assert!(!device.is_plugged());
        assert_eq!((device.bulk_out(b"x"), device.bulk_in(64)), (Ok(0), Ok(None)));
        device.obey(Ask::Replug);
        device.obey(Ask::Run);
        assert_eq!(device.bulk_out(b"x"), Ok(1));
        for _ in 0..1_000 {
            device.wait();
        }
        assert_eq!(device.bulk_in(64).map(|packet| packet.map(|bytes| bytes.len())), Ok(Some(2)));
    }
}
