//! A transport that loses, cuts, damages and delays frames, from a seed.

use crate::transport::Transport;
use std::collections::VecDeque;
use std::io;

/// How often each fault strikes a frame, 0 to 1, in either direction.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Faults {
    /// The frame is lost.
    pub drop: f32,
    /// The frame ends early.
    pub truncate: f32,
    /// One byte has one bit flipped.
    pub corrupt: f32,
    /// The frame comes late. Only frames to the driver: late requests are the driver's own affair.
    pub delay: f32,
    /// By how much, us. Frames stay in order.
    pub delay_us: u64,
}

/// What was done so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FaultCounts {
    /// Frames lost.
    pub dropped: u64,
    /// Frames cut.
    pub truncated: u64,
    /// Frames damaged.
    pub corrupted: u64,
    /// Frames delayed.
    pub delayed: u64,
}

/// The transport with its faults.
#[derive(Debug)]
pub struct Faulty<T> {
    inner: T,
    faults: Faults,
    random: u64,
    counts: FaultCounts,
    /// Frames on their way: (due time, bytes).
    late: VecDeque<(u64, Vec<u8>)>,
    /// Bytes handed to the transport inside.
    delivered: u64,
}

impl<T: Transport> Faulty<T> {
    /// Wraps a transport.
    pub fn new(inner: T, faults: Faults, seed: u64) -> Self {
        Self {
            inner,
            faults,
            random: seed,
            counts: FaultCounts::default(),
            late: VecDeque::new(),
            delivered: 0,
        }
    }

    /// Changes the faults from here on.
    pub const fn set_faults(&mut self, faults: Faults) {
        self.faults = faults;
    }

    /// What was done so far.
    #[must_use]
    pub const fn counts(&self) -> FaultCounts {
        self.counts
    }

    /// Bytes that went on to the driver so far, late ones when they were due.
    #[must_use]
    pub const fn delivered(&self) -> u64 {
        self.delivered
    }

    /// The transport inside.
    pub const fn inner_mut(&mut self) -> &mut T {
        &mut self.inner
    }

    /// SplitMix64 (Steele, Lea and Flood 2014).
    fn next(&mut self) -> u64 {
        self.random = self.random.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.random;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn strikes(&mut self, rate: f32) -> bool {
        // Drawn whether the rate is zero or not, so that the other faults stay where they are when one is switched on.
        let drawn = (self.next() >> 40) as f32 / (1_u64 << 24) as f32;
        drawn < rate
    }

    /// Damages a frame in place; true if it is lost altogether.
    fn spoil(&mut self, frame: &mut Vec<u8>) -> bool {
        let Faults { drop, truncate, corrupt, .. } = self.faults;
        let (dropped, truncated, corrupted) =
            (self.strikes(drop), self.strikes(truncate), self.strikes(corrupt));
        let (place, bit) = (self.next() as usize % frame.len().max(1), self.next() % 8);
        self.counts.dropped += u64::from(dropped);
        if !dropped && corrupted {
            self.counts.corrupted += 1;
            if let Some(byte) = frame.get_mut(place) {
                *byte ^= 1 << bit;
            }
        }
        if !dropped && truncated {
            self.counts.truncated += 1;
            frame.truncate(place);
        }
        dropped
    }

    fn deliver(&mut self, now_us: u64) -> io::Result<()> {
        while self.late.front().is_some_and(|(due_us, _)| *due_us <= now_us) {
            if let Some((_, frame)) = self.late.pop_front() {
                self.hand_on(now_us, &frame)?;
            }
        }
        Ok(())
    }

    fn hand_on(&mut self, now_us: u64, frame: &[u8]) -> io::Result<()> {
        self.delivered += frame.len() as u64;
        self.inner.send(now_us, frame)
    }
}

impl<T: Transport> Transport for Faulty<T> {
    fn receive(&mut self, now_us: u64, buffer: &mut [u8]) -> io::Result<usize> {
        self.deliver(now_us)?;
        let count = self.inner.receive(now_us, buffer)?;
        if count == 0 {
            return Ok(0);
        }
        let mut frame = buffer[..count].to_vec();
        if self.spoil(&mut frame) {
            return Ok(0);
        }
        buffer[..frame.len()].copy_from_slice(&frame);
        Ok(frame.len())
    }

    fn send(&mut self, now_us: u64, frame: &[u8]) -> io::Result<()> {
        self.deliver(now_us)?;
        let mut frame = frame.to_vec();
        let lost = self.spoil(&mut frame);
        let late = self.strikes(self.faults.delay);
        if lost {
            return Ok(());
        }
        if late || !self.late.is_empty() {
            self.counts.delayed += 1;
            // Not before the frame ahead of it.
            let due_us = now_us + if late { self.faults.delay_us } else { 0 };
            let due_us = self.late.back().map_or(due_us, |(ahead_us, _)| due_us.max(*ahead_us));
            self.late.push_back((due_us, frame));
            return Ok(());
        }
        self.hand_on(now_us, &frame)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transport::MemoryTransport;

    fn through(faults: Faults, seed: u64) -> (Vec<u8>, FaultCounts) {
        let (device, mut driver) = MemoryTransport::pair();
        let mut faulty = Faulty::new(device, faults, seed);
        let (mut got, mut buffer) = (Vec::new(), [0; 256]);
        for i in 0..2_000_u64 {
            faulty.send(i * 1_000, &[b'a' + (i % 26) as u8; 16]).expect("memory");
            let count = driver.receive(0, &mut buffer).expect("memory");
            got.extend_from_slice(&buffer[..count]);
        }
        (got, faulty.counts())
    }

    #[test]
    fn without_faults_everything_passes() {
        let (got, counts) = through(Faults::default(), 7);
        assert_eq!((got.len(), counts), (32_000, FaultCounts::default()));
    }

    #[test]
    fn each_fault_strikes_as_often_as_asked_and_repeats_with_its_seed() {
        let faults = Faults { drop: 0.1, truncate: 0.05, corrupt: 0.2, delay: 0.02, delay_us: 5_000 };
        let (got, counts) = through(faults, 7);
        assert_eq!((got.clone(), counts), through(faults, 7));
        assert_ne!(got, through(faults, 8).0);
        assert!((150..250).contains(&counts.dropped), "{counts:?}");
        assert!((60..130).contains(&counts.truncated), "{counts:?}");
        assert!((300..440).contains(&counts.corrupted), "{counts:?}");
        assert!(counts.delayed >= 30, "{counts:?}");
    }

    #[test]
    fn delayed_frames_arrive_late_and_in_order() {
        let faults = Faults { delay: 0.3, delay_us: 7_000, ..Faults::default() };
        let (device, mut driver) = MemoryTransport::pair();
        let mut faulty = Faulty::new(device, faults, 3);
        let (mut got, mut buffer) = (Vec::new(), [0; 4096]);
        for i in 0..200_u8 {
            faulty.send(u64::from(i) * 1_000, &[i]).expect("memory");
        }
        assert!(faulty.counts().delayed > 50);
        faulty.receive(1_000_000, &mut buffer).expect("memory");
        loop {
            let count = driver.receive(0, &mut buffer).expect("memory");
            if count == 0 {
                break;
            }
            got.extend_from_slice(&buffer[..count]);
        }
        assert_eq!(got, (0..200).collect::<Vec<u8>>());
    }
}
