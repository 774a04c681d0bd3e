//! A transport with seeded faults: loss, truncation, corruption, duplication and delay of frames.

use crate::fault::{Channel, FaultCounts, Faults};
use crate::transport::Transport;
use std::io;

/// A transport with faults.
#[derive(Debug)]
pub struct Faulty<T> {
    inner: T,
    to_device: Channel,
    to_driver: Channel,
    /// Bytes that did not fit into the device's buffer.
    rest: Vec<u8>,
    /// Bytes forwarded to the driver.
    delivered: u64,
}

impl<T: Transport> Faulty<T> {
    /// Wraps a transport.
    pub fn new(inner: T, faults: Faults, seed: u64) -> Self {
        // Two independent sequences.
        let (to_device, to_driver) = (Channel::new(seed), Channel::new(!seed));
        let mut faulty = Self { inner, to_device, to_driver, rest: Vec::new(), delivered: 0 };
        faulty.set_faults(faults);
        faulty
    }

    /// Sets the faults of both directions from now on.
    pub const fn set_faults(&mut self, faults: Faults) {
        self.set_faults_each(faults, faults);
    }

    /// Sets the faults of each direction from now on.
    pub const fn set_faults_each(&mut self, to_device: Faults, to_driver: Faults) {
        self.to_device.set_faults(to_device);
        self.to_driver.set_faults(to_driver);
    }

    /// Counts of the faults so far, both directions together.
    #[must_use]
    pub fn counts(&self) -> FaultCounts {
        self.to_device.counts() + self.to_driver.counts()
    }

    /// Counts of the faults to the device and to the driver.
    #[must_use]
    pub const fn counts_each(&self) -> [FaultCounts; 2] {
        [self.to_device.counts(), self.to_driver.counts()]
    }

    /// Bytes forwarded to the driver so far, delayed ones when they were due.
    #[must_use]
    pub const fn delivered(&self) -> u64 {
        self.delivered
    }

    /// Time at which the device sent the newest frame that has reached the driver.
    #[must_use]
    pub const fn last_received_us(&self) -> Option<u64> {
        self.to_driver.newest_sent_us()
    }

    /// The wrapped transport.
    pub const fn inner_mut(&mut self) -> &mut T {
        &mut self.inner
    }

    /// A cut of the cable affects both directions.
    fn is_cut(&self, now_us: u64) -> bool {
        self.to_device.unplugged_until_us(now_us).is_some()
            || self.to_driver.unplugged_until_us(now_us).is_some()
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
    fn without_faults_frames_pass_in_both_directions() {
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
    fn delayed_frames_are_forwarded_at_the_next_poll() {
        let (mut faulty, mut driver) = pair(Faults { delay: 1.0, delay_us: 7_000, ..Faults::default() });
        let mut buffer = [0; 64];
        faulty.send(0, b"late").expect("memory");
        faulty.receive(6_999, &mut buffer).expect("memory");
        assert_eq!(driver.receive(0, &mut buffer).expect("memory"), 0);
        faulty.receive(7_000, &mut buffer).expect("memory");
        assert_eq!(driver.receive(0, &mut buffer).expect("memory"), 4);
        assert_eq!(faulty.last_received_us(), Some(0));
        driver.send(0, b"late too").expect("memory");
        assert_eq!(faulty.receive(7_000, &mut buffer).expect("memory"), 0);
        assert_eq!(faulty.receive(13_999, &mut buffer).expect("memory"), 0);
        assert_eq!(faulty.receive(14_000, &mut buffer).expect("memory"), 8);
        assert_eq!(faulty.counts().delayed, 2);
    }

    #[test]
    fn duplicates_are_read_completely_and_a_cut_affects_both_directions() {
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
