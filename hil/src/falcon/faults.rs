//! Faults of the UART between the chip and the board, as the driver sees them: loss, corruption, duplication,
//! delay and noise.
//!
//! USB protects its packets, so status bytes and packet boundaries stay intact. The wrapper unpacks the
//! payload, applies the faults, and packs it again. Vendor requests pass unless the cable is pulled.

use super::chip::{PAYLOAD_LEN, STATUS_LEN};
use super::descriptors::PACKET_LEN;
use super::memory::Link;
use crate::fault::{Channel, FaultCounts, Faults};
use palpate_host::device::falcon::Ftdi;
use palpate_host::{DeviceError, DeviceErrorKind};
use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// How long the chip runs during a blocking read before the clock is read again.
const READ_STEP: Duration = Duration::from_micros(100);

/// A chip, or another link, with faults.
#[derive(Debug)]
pub struct FaultyFtdi<F> {
    inner: F,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    to_device: Channel,
    to_host: Channel,
    /// Payload that has left the channel.
    ready: VecDeque<u8>,
    /// Status bytes of the last packet.
    status: [u8; STATUS_LEN],
    /// While the cable is out: the time at which it is plugged in again.
    replug_us: Option<u64>,
}

impl<F: Link> FaultyFtdi<F> {
    /// A link without faults.
    #[must_use]
    pub fn new(inner: F, seed: u64) -> Self {
        let state = State {
            to_device: Channel::new(seed),
            to_host: Channel::new(!seed),
            ready: VecDeque::new(),
            status: [0; STATUS_LEN],
            replug_us: None,
        };
        Self { inner, state: Mutex::new(state) }
    }

    /// Sets the faults of each direction from now on.
    pub fn set_faults(&self, to_device: Faults, to_host: Faults) {
        let mut state = self.lock();
        state.to_device.set_faults(to_device);
        state.to_host.set_faults(to_host);
    }

    /// Counts of the faults so far: to the device, and to the host.
    #[must_use]
    pub fn counts(&self) -> (FaultCounts, FaultCounts) {
        let state = self.lock();
        (state.to_device.counts(), state.to_host.counts())
    }

    /// The time at which the chip sent the newest payload that has reached the host.
    #[must_use]
    pub fn last_received_us(&self) -> Option<u64> {
        self.lock().to_host.newest_sent_us()
    }

    /// The wrapped link.
    pub const fn inner(&self) -> &F {
        &self.inner
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Plugs the cable in when it is due, and forwards the frames that are due to the device.
    fn serve(&self, state: &mut State) -> Result<(), DeviceError> {
        let now_us = self.inner.now_us();
        if state.replug_us.is_some_and(|replug_us| replug_us <= now_us) {
            state.replug_us = None;
            self.inner.replug();
        }
        while let Some(frame) = state.to_device.take(now_us) {
            // Bytes without room are lost, as with a sender that does not wait.
            match self.inner.write(&frame, Duration::ZERO) {
                Err(error) if !error.kind().is_transient() => return Err(error),
                Ok(_) | Err(_) => {}
            }
        }
        Ok(())
    }

    /// Pulls the cable if a fault of either direction requires it.
    fn pull(&self, state: &mut State) {
        let now_us = self.inner.now_us();
        let cut_us = state.to_device.unplugged_until_us(now_us).or(state.to_host.unplugged_until_us(now_us));
        if let (Some(until_us), None) = (cut_us, state.replug_us) {
            state.replug_us = Some(until_us);
            state.clear();
            self.inner.unplug();
        }
    }

    /// Applies the faults to the chip's packets, and packs the payload that is due into the buffer.
    fn forward(&self, state: &mut State, packets: &[u8], buffer: &mut [u8]) -> usize {
        let payload: Vec<u8> =
            packets.chunks(PACKET_LEN).flat_map(|packet| &packet[STATUS_LEN..]).copied().collect();
        if let Some(status) = packets.first_chunk() {
            state.status = *status;
        }
        if !payload.is_empty() {
            state.to_host.put(self.inner.now_us(), &payload);
        }
        self.pull(state);
        while let Some(frame) = state.to_host.take(self.inner.now_us()) {
            state.ready.extend(frame);
        }
        let is_idle = !packets.is_empty() && payload.is_empty();
        state.pack(buffer, is_idle)
    }
}

impl State {
    /// Packs full packets and a short one as far as they fit. Packs an idle packet if there is no payload and
    /// the chip sent one.
    fn pack(&mut self, buffer: &mut [u8], is_idle: bool) -> usize {
        let mut count = 0;
        while buffer.len() - count >= PACKET_LEN && (!self.ready.is_empty() || (is_idle && count == 0)) {
            buffer[count..count + STATUS_LEN].copy_from_slice(&self.status);
            count += STATUS_LEN;
            for byte in self.ready.drain(..self.ready.len().min(PAYLOAD_LEN)) {
                buffer[count] = byte;
                count += 1;
            }
        }
        count
    }

    fn clear(&mut self) {
        self.to_device.purge();
        self.to_host.purge();
        self.ready.clear();
    }
}

impl<F: Link> Ftdi for FaultyFtdi<F> {
    fn control(&self, request: u8, value: u16) -> Result<(), DeviceError> {
        let mut state = self.lock();
        self.serve(&mut state)?;
        self.inner.control(request, value)?;
        if request == 0 && value != 2 {
            // A purge also discards the payload that the chip has already sent.
            state.ready.clear();
        }
        Ok(())
    }

    fn write(&self, bytes: &[u8], timeout: Duration) -> Result<usize, DeviceError> {
        let mut state = self.lock();
        self.serve(&mut state)?;
        // A lost handle is an error under any fault.
        self.inner.write(&[], timeout)?;
        if state.to_device.refuses() {
            return Err(DeviceError::new(DeviceErrorKind::Timeout));
        }
        state.to_device.put(self.inner.now_us(), bytes);
        self.pull(&mut state);
        let served = self.serve(&mut state);
        if state.replug_us.is_some() {
            Err(DeviceError::new(DeviceErrorKind::Disconnected))
        } else {
            served
        }?;
        Ok(bytes.len())
    }

    fn read(&self, buffer: &mut [u8], timeout: Duration) -> Result<usize, DeviceError> {
        if buffer.len() < PACKET_LEN {
            return Err(DeviceError::new(DeviceErrorKind::Io));
        }
        let until_us = self.inner.now_us() + timeout.as_micros() as u64;
        let mut packets = vec![0; buffer.len()];
        loop {
            self.serve(&mut self.lock())?;
            let left = Duration::from_micros(until_us.saturating_sub(self.inner.now_us()));
            // The lock is released during the read, so that another thread can write.
            let count = match self.inner.read(&mut packets, left.min(READ_STEP)) {
                Err(error) if error.kind() != DeviceErrorKind::Timeout => return Err(error),
                read => read.unwrap_or(0),
            };
            let count = self.forward(&mut self.lock(), &packets[..count], buffer);
            if count > 0 {
                return Ok(count);
            }
            if left.is_zero() {
                return Err(DeviceError::new(DeviceErrorKind::Timeout));
            }
        }
    }
}

impl<F: Link> Link for FaultyFtdi<F> {
    fn now_us(&self) -> u64 {
        self.inner.now_us()
    }

    fn unplug(&self) {
        let mut state = self.lock();
        state.clear();
        self.inner.unplug();
    }

    fn replug(&self) {
        self.lock().replug_us = None;
        self.inner.replug();
    }

    fn reopen(&self) -> Result<(), DeviceError> {
        let mut state = self.lock();
        state.clear();
        // Nothing calls a lost handle, so the cable may still have to be plugged in.
        let served = self.serve(&mut state);
        self.inner.reopen().and(served)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::falcon::{EmulatedFalcon, FalconConfig, MemoryFtdi};

    const ZERO: &[u8; 16] = b"<AAAAAAAAAAAAAA>";
    const NONE: Faults = Faults::NONE;

    fn device() -> FaultyFtdi<MemoryFtdi> {
        let config = FalconConfig { firmware_runs: true, ..FalconConfig::default() };
        let ftdi = FaultyFtdi::new(MemoryFtdi::new(EmulatedFalcon::new(config)), 5);
        for (request, value) in [(3, 2), (9, 1), (6, 0x013e)] {
            ftdi.control(request, value).expect("a known request");
        }
        ftdi
    }

    /// Payload that arrives within 10 ms.
    fn answer(ftdi: &FaultyFtdi<MemoryFtdi>) -> Vec<u8> {
        ftdi.write(ZERO, Duration::ZERO).expect("the cable is in");
        let (mut got, mut buffer, until_us) = (Vec::new(), [0; 512], ftdi.now_us() + 10_000);
        while ftdi.now_us() < until_us {
            if let Ok(count) = ftdi.read(&mut buffer, Duration::from_micros(500)) {
                for packet in buffer[..count].chunks(PACKET_LEN) {
                    assert_eq!(packet[..STATUS_LEN], [0x01, 0x60], "the status stays intact");
                    got.extend(&packet[STATUS_LEN..]);
                }
            }
        }
        got
    }

    #[test]
    fn a_frame_lost_in_either_direction_has_no_reply() {
        let ftdi = device();
        assert_eq!(answer(&ftdi).len(), 16);
        let all = Faults { drop: 1.0, ..NONE };
        ftdi.set_faults(all, NONE);
        assert_eq!(answer(&ftdi), b"");
        ftdi.set_faults(NONE, all);
        assert_eq!(answer(&ftdi), b"");
        let received = ftdi.inner().falcon().firmware().map(|firmware| firmware.requests());
        assert_eq!((received, ftdi.counts().0.dropped, ftdi.counts().1.dropped), (Some(2), 1, 1));
    }

    #[test]
    fn replies_are_duplicated_delayed_and_preceded_by_noise() {
        let ftdi = device();
        ftdi.set_faults(NONE, Faults { duplicate: 1.0, ..NONE });
        let twice = answer(&ftdi);
        assert_eq!((twice.len(), &twice[..16]), (32, &twice[16..]));
        ftdi.set_faults(NONE, Faults { noise: 1.0, ..NONE });
        assert!((17..=40).contains(&answer(&ftdi).len()));
        ftdi.set_faults(NONE, Faults { delay: 1.0, delay_us: 12_000, ..NONE });
        assert_eq!(answer(&ftdi), b"");
        ftdi.set_faults(NONE, NONE);
        assert_eq!(answer(&ftdi).len(), 32, "together with the next one");
    }

    /// A delayed command arrives after a newer one and overrides it.
    #[test]
    fn a_delayed_request_reaches_the_motors_late() {
        let ftdi = device();
        ftdi.set_faults(Faults { delay: 1.0, delay_us: 5_000, ..NONE }, NONE);
        ftdi.write(b"<EGAAAAAAAAAAAA>", Duration::ZERO).expect("the cable is in");
        assert!(ftdi.read(&mut [0; 64], Duration::from_micros(4_900)).is_ok(), "is_idle");
        assert_eq!(ftdi.inner().falcon().force_record().largest_motor, 0);
        let until_us = ftdi.now_us() + 6_000;
        while ftdi.now_us() < until_us {
            let _ = ftdi.read(&mut [0; 64], Duration::from_micros(500));
        }
        assert_eq!(ftdi.inner().falcon().force_record().largest_motor, 100);
    }

    #[test]
    fn a_purge_discards_received_payload() {
        let ftdi = device();
        ftdi.set_faults(NONE, Faults { duplicate: 1.0, ..NONE });
        ftdi.write(ZERO, Duration::ZERO).expect("the cable is in");
        ftdi.write(ZERO, Duration::ZERO).expect("the cable is in");
        ftdi.inner().falcon().advance(900);
        // A buffer of one packet leaves 2 of 64 bytes unread.
        assert_eq!(ftdi.read(&mut [0; 64], Duration::ZERO), Ok(64));
        ftdi.control(0, 1).expect("a known request");
        assert!(ftdi.read(&mut [0; 64], Duration::ZERO).is_err());
    }
}
