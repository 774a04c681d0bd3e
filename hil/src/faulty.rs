//! A transport that loses, cuts, damages, doubles and delays frames, from a seed.

use crate::fault::{FaultCounts, Faults, Lane};
use crate::transport::Transport;
use std::io;

/// The transport with its faults.
#[derive(Debug)]
pub struct Faulty<T> {
    inner: T,
    to_device: Lane,
    to_driver: Lane,
    /// What did not fit into the device's buffer.
    rest: Vec<u8>,
    /// Bytes handed to the transport inside.
    delivered: u64,
}

impl<T: Transport> Faulty<T> {
    /// Wraps a transport.
    pub fn new(inner: T, faults: Faults, seed: u64) -> Self {
        // Two sequences that have nothing in common.
        let (to_device, to_driver) = (Lane::new(seed), Lane::new(!seed));
        let mut faulty = Self { inner, to_device, to_driver, rest: Vec::new(), delivered: 0 };
        faulty.set_faults(faults);
        faulty
    }

    /// Changes the faults from here on, in both directions.
    pub const fn set_faults(&mut self, faults: Faults) {
        self.set_faults_each(faults, faults);
    }

    /// Changes the faults of each direction from here on.
    pub const fn set_faults_each(&mut self, to_device: Faults, to_driver: Faults) {
        self.to_device.set_faults(to_device);
        self.to_driver.set_faults(to_driver);
    }

    /// What was done so far, both ways.
    #[must_use]
    pub fn counts(&self) -> FaultCounts {
        self.to_device.counts() + self.to_driver.counts()
    }

    /// The same on the way to the device and on the way to the driver.
    #[must_use]
    pub const fn counts_each(&self) -> [FaultCounts; 2] {
        [self.to_device.counts(), self.to_driver.counts()]
    }

    /// Bytes that went on to the driver so far, late ones when they were due.
    #[must_use]
    pub const fn delivered(&self) -> u64 {
        self.delivered
    }

    /// When the device had sent the newest of what has gone on to the driver.
    #[must_use]
    pub const fn heard_us(&self) -> Option<u64> {
        self.to_driver.newest_us()
    }

    /// The transport inside.
    pub const fn inner_mut(&mut self) -> &mut T {
        &mut self.inner
    }

    /// A cable that is pulled is pulled for both directions.
    fn is_cut(&self, now_us: u64) -> bool {
        self.to_device.cut_until_us(now_us).is_some() || self.to_driver.cut_until_us(now_us).is_some()
    }

    fn deliver(&mut self, now_us: u64) -> io::Result<()> {
        while let Some(frame) = self.to_driver.take(now_us) {
            self.delivered += frame.len() as u64;
            self.inner.send(now_us, &frame)?;
        }
        Ok(())
    }
}

impl<T: Transport> Transport for Faulty<T> {
    fn receive(&mut self, now_us: u64, buffer: &mut [u8]) -> io::Result<usize> {
        self.deliver(now_us)?;
        let count = self.inner.receive(now_us, buffer)?;
        if count > 0 && !self.is_cut(now_us) {
            self.to_device.put(now_us, &buffer[..count]);
        }
        while let Some(frame) = self.to_device.take(now_us) {
            self.rest.extend(frame);
        }
        let count = self.rest.len().min(buffer.len());
        buffer[..count].copy_from_slice(&self.rest[..count]);
        self.rest.drain(..count);
        Ok(count)
    }

    fn send(&mut self, now_us: u64, frame: &[u8]) -> io::Result<()> {
        self.deliver(now_us)?;
        if !self.is_cut(now_us) {
            self.to_driver.put(now_us, frame);
        }
        self.deliver(now_us)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transport::MemoryTransport;

    fn pair(faults: Faults) -> (Faulty<MemoryTransport>, MemoryTransport) {
        let (device, driver) = MemoryTransport::pair();
        (Faulty::new(device, faults, 7), driver)
    }

    #[test]
    fn without_faults_everything_passes_both_ways() {
        let (mut faulty, mut driver) = pair(Faults::default());
        let mut buffer = [0; 64];
        for i in 0..200_u8 {
            faulty.send(0, &[i; 8]).expect("memory");
            assert_eq!(driver.receive(0, &mut buffer).expect("memory"), 8);
            driver.send(0, &[i; 100]).expect("memory");
            assert_eq!(faulty.receive(0, &mut buffer).expect("memory"), 64);
            assert_eq!(faulty.receive(0, &mut buffer).expect("memory"), 36);
        }
        assert_eq!((faulty.counts(), faulty.delivered()), (FaultCounts::default(), 1_600));
    }

    #[test]
    fn late_frames_go_on_when_the_device_next_looks() {
        let (mut faulty, mut driver) = pair(Faults { delay: 1.0, delay_us: 7_000, ..Faults::default() });
        let mut buffer = [0; 64];
        faulty.send(0, b"late").expect("memory");
        faulty.receive(6_999, &mut buffer).expect("memory");
        assert_eq!(driver.receive(0, &mut buffer).expect("memory"), 0);
        faulty.receive(7_000, &mut buffer).expect("memory");
        assert_eq!(driver.receive(0, &mut buffer).expect("memory"), 4);
        assert_eq!(faulty.heard_us(), Some(0));
        driver.send(0, b"late too").expect("memory");
        assert_eq!(faulty.receive(7_000, &mut buffer).expect("memory"), 0);
        assert_eq!(faulty.receive(13_999, &mut buffer).expect("memory"), 0);
        assert_eq!(faulty.receive(14_000, &mut buffer).expect("memory"), 8);
        assert_eq!(faulty.counts().delayed, 2);
    }

    #[test]
    fn what_is_doubled_is_read_to_its_end_and_a_pulled_cable_is_pulled_both_ways() {
        let (mut faulty, mut driver) = pair(Faults { duplicate: 1.0, ..Faults::default() });
        let mut buffer = [0; 10];
        driver.send(0, b"01234567").expect("memory");
        assert_eq!(faulty.receive(0, &mut buffer).expect("memory"), 10);
        assert_eq!(faulty.receive(0, &mut buffer).expect("memory"), 6);
        faulty.set_faults(Faults { unplug: 1.0, unplug_us: 1_000, ..Faults::default() });
        driver.send(0, b"gone").expect("memory");
        assert_eq!(faulty.receive(0, &mut buffer).expect("memory"), 0);
        faulty.set_faults(Faults::default());
        faulty.send(999, b"gone").expect("memory");
        assert_eq!((driver.receive(0, &mut buffer).expect("memory"), faulty.counts().unplugged), (0, 1));
        faulty.send(1_000, b"back").expect("memory");
        assert_eq!(driver.receive(0, &mut buffer).expect("memory"), 4);
    }
}
