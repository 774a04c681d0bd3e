//! Driver for the Polhem / WoodenHaptics text protocol over a serial port: lines of 64 bytes, one reply per
//! request.
//!
//! Host to device: seven decimal i16, `fx fy fz command a0 a1 a2`, forces in mN. Device to host: `x y z` in
//! mm, four angles in rad, an info word. Both are padded with spaces; the last byte is a newline.
//!
//! An exchange never waits. It reads what has arrived, and sends the next request after the last one was
//! answered or timed out. The time stamp of a sample is the send time of its request: the sample cannot be
//! older, so a delayed link is detected.
//! A position that no hand motion can reach is rejected. If such positions persist, the device's counters
//! have miscounted, or restarted after a loss of power. Then its positions are invalid, and it must be opened
//! again because it has no homing.
//! The device is a Teensy on USB CDC, so the baud rate has no effect.

use super::buttons::ButtonDebouncer;
use super::fence::{Fence, GuardPath, Wire};
use super::in_flight::{InFlight, Unnumbered};
use super::nonblocking_port::Port;
use super::position_check::{PositionCheck, Verdict};
use super::profile::DEFAULT_CAP_N_M;
use super::serial::{MAX_READS, from_serial, open, read_waiting};
use super::workspace::Workspace;
use super::{Device, DeviceError, DeviceErrorKind, DeviceInfo, DeviceState};
use palpate_core::{Sample, Vec3, clamp_force};
use palpate_link::DeviceFault;
use serialport::ClearBuffer;
use std::io::{Read, Write};
use std::time::{Duration, Instant};

/// Length of a line in both directions, newline included.
pub const LINE_LEN: usize = 64;
/// The command word for normal operation.
const NORMAL_OPERATION: i16 = 2;
/// Largest deviation of the position accepted after a silence, m. When its force is zeroed, a hand moves by
/// less. A device that has lost power restarts its counters, and its replies do not show it.
const REACH_M: f32 = 0.03;
/// Pause between two wake-up newlines.
const WAKE_PAUSE: Duration = Duration::from_millis(100);

/// Settings of the device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PolhemConfig {
    /// Placement of the device's workspace in the model.
    pub workspace: Workspace,
    /// Largest force of the mechanism, N: of the vector, and of each axis before the conversion to i16.
    pub max_force_n: f32,
    /// Largest stiffness that may be rendered, N/m in device metres: the cap of its profile.
    pub max_stiffness_n_m: f32,
    /// How long to try to wake the device.
    pub wake_timeout: Duration,
}

impl Default for PolhemConfig {
    fn default() -> Self {
        Self {
            workspace: Workspace::default(),
            max_force_n: 8.0,
            // Default for a mechanism whose damping is not stated.
            max_stiffness_n_m: DEFAULT_CAP_N_M,
            wake_timeout: Duration::from_secs(3),
        }
    }
}

/// The device behind an open port.
pub struct Polhem {
    port: Box<dyn Port>,
    config: PolhemConfig,
    /// Bytes of an incomplete line.
    line: LineBuffer,
    pending: Unnumbered,
    motion: PositionCheck,
    buttons: ButtonDebouncer,
    /// Whether its reference is lost.
    has_lost_reference: bool,
    /// Whether the last request carried a force.
    rendering: bool,
    fence: Fence,
    /// Requests of the guard on this line that are accounted for.
    seen_zeros: u64,
}

/// Result of reading the port.
#[derive(Debug, Clone, Copy, Default)]
struct Received {
    newest: Option<Reply>,
    /// Send time of the request of that reply.
    sent_us: Option<u64>,
    damaged: bool,
}

impl core::fmt::Debug for Polhem {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Polhem").field("config", &self.config).finish_non_exhaustive()
    }
}

impl Polhem {
    /// Opens a port by its name and wakes the device.
    pub fn open(path: &str, config: PolhemConfig) -> Result<Self, DeviceError> {
        let port = open(path, 115_200)?;
        Self::with_port(port, config)
    }

    /// Wakes the device behind an open port and commands zero force. Blocks for at most the wake timeout.
    pub fn with_port(mut port: Box<dyn Port>, config: PolhemConfig) -> Result<Self, DeviceError> {
        port.set_timeout(WAKE_PAUSE).map_err(from_serial)?;
        let mut device = Self {
            port,
            config,
            line: LineBuffer::default(),
            pending: Unnumbered::default(),
            motion: PositionCheck::with_reach(REACH_M),
            buttons: ButtonDebouncer::default(),
            has_lost_reference: false,
            rendering: false,
            fence: Fence::default(),
            seen_zeros: 0,
        };
        device.wake()?;
        // From here on a write that does not complete immediately is a fault of the link.
        device.port.set_timeout(Duration::ZERO).map_err(from_serial)?;
        Ok(device)
    }

    /// Sends newlines until the device replies, then clears the input.
    fn wake(&mut self) -> Result<(), DeviceError> {
        let give_up = Instant::now() + self.config.wake_timeout;
        let mut scratch = [0; 256];
        loop {
            self.port.write_all(b"\n")?;
            match self.port.read(&mut scratch) {
                Ok(count) if count > 0 => break,
                Ok(_) => {}
                Err(error) if error.kind() == std::io::ErrorKind::TimedOut => {}
                Err(error) => return Err(error.into()),
            }
            if Instant::now() > give_up {
                return Err(DeviceError::new(DeviceErrorKind::Timeout));
            }
        }
        // The rest of the reply may still be under way; it would look like a reply to the first request.
        while let Ok(1..) = self.port.read(&mut scratch) {}
        self.port.clear(ClearBuffer::Input).map_err(from_serial)?;
        self.send([0.0; 3])?;
        // Its reply belongs to no later request: read and discard it.
        while let Ok(1..) = self.port.read(&mut scratch) {}
        self.port.clear(ClearBuffer::Input).map_err(from_serial)
    }

    fn send(&mut self, device_n: Vec3) -> Result<(), DeviceError> {
        // Clamp the vector: three axes at the limit would be 1.7 times as much. A value that is not finite
        // gives zero.
        let (device_n, _) = clamp_force(device_n, self.config.max_force_n);
        // The last look before the write: this process may have been stopped since the tick began.
        let device_n = if self.fence.is_closed() { [0.0; 3] } else { device_n };
        let request = request(device_n, self.config.max_force_n);
        let sent = self.port.write_all(&request).map_err(DeviceError::from);
        // A failed send may have transmitted a force, so the flag stays set.
        self.rendering = device_n != [0.0; 3] || (self.rendering && sent.is_err());
        sent
    }

    /// Reads the bytes that have arrived.
    fn receive(&mut self, now_us: u64) -> Result<Received, DeviceError> {
        let mut received = Received::default();
        let mut chunk = [0; 4 * LINE_LEN];
        for _ in 0..MAX_READS {
            let count = read_waiting(&mut *self.port, &mut chunk)?;
            if count == 0 {
                break;
            }
            for byte in &chunk[..count] {
                match self.line.push(*byte).map(|line| line.and_then(Reply::parse)) {
                    None => {}
                    Some(Some(reply)) => {
                        received.newest = Some(reply);
                        received.sent_us = self.pending.answered(now_us, false).or(received.sent_us);
                    }
                    Some(None) => {
                        received.damaged = true;
                        self.pending.answered(now_us, true);
                    }
                }
            }
        }
        Ok(received)
    }

    /// The sample of a reply; `None` if the device has lost its reference.
    fn sample(&mut self, t_us: u64, now_us: u64, reply: &Reply) -> Result<Option<Sample>, DeviceError> {
        if self.has_lost_reference {
            return Ok(None);
        }
        match self.motion.check(t_us, now_us, Some(reply.position_m)) {
            Verdict::Accepted => {}
            Verdict::Rejected => return Err(DeviceError::new(DeviceErrorKind::BadFrame)),
            Verdict::Lost => {
                self.has_lost_reference = true;
                return Err(DeviceError::new(DeviceErrorKind::Faulted(DeviceFault::HomeLost)));
            }
        }
        let position_m = self.config.workspace.to_model_m(reply.position_m);
        Ok(Some(Sample {
            t_us,
            position_m,
            buttons: self.buttons.update(now_us, reply.info),
            ..Sample::default()
        }))
    }

    fn exchange_lines(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        let received = self.receive(now_us)?;
        // A reply without a request counts as damage: its age is unknown.
        let sample = match (received.newest, received.sent_us) {
            (Some(reply), Some(t_us)) => self.sample(t_us, now_us, &reply),
            _ => Ok(None),
        };
        let hand_force_n = if self.has_lost_reference { [0.0; 3] } else { hand_force_n };
        if core::mem::replace(&mut self.seen_zeros, self.fence.zeros()) != self.seen_zeros {
            // The replies to the guard's requests must not be assigned to ours: wait for silence.
            self.pending.pause(now_us);
        }
        if self.pending.ends_pause(now_us) {
            self.line = LineBuffer::default();
            // Discard what has arrived since the read above. Read it instead of flushing: flushing a terminal
            // may wait for the kernel's worker.
            let mut late = [0; 4 * LINE_LEN];
            for _ in 0..MAX_READS {
                if read_waiting(&mut *self.port, &mut late)? == 0 {
                    break;
                }
            }
        }
        let overdue = self.pending.is_overdue(now_us);
        let free = self.pending.may_send(now_us);
        // A release never waits for a pause or a reply: a fault ends in zero force, whatever the state of the
        // link.
        let release = self.rendering && hand_force_n == [0.0; 3];
        let repeat = hand_force_n == [0.0; 3] && self.pending.may_repeat_zero(now_us);
        if free || release || repeat {
            self.send(self.config.workspace.to_device_n(hand_force_n))?;
            self.pending.sent(now_us, hand_force_n == [0.0; 3]);
        }
        match sample? {
            None if received.damaged => Err(DeviceError::new(DeviceErrorKind::BadFrame)),
            None if overdue => Err(DeviceError::new(DeviceErrorKind::Timeout)),
            sample => Ok(sample),
        }
    }
}

impl Device for Polhem {
    fn exchange(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        self.exchange_lines(now_us, hand_force_n).map_err(|error| match error.kind() {
            // The crate does not pass on the OS code. On an open port an unnamed error means that the device
            // is disconnected.
            DeviceErrorKind::Io => DeviceError { kind: DeviceErrorKind::Disconnected, ..error },
            _ => error,
        })
    }

    fn stop(&mut self) {
        // Send it twice: in the middle of a damaged line the first one only resynchronises the device. If the
        // port is gone, the error cannot be handled here.
        for _ in 0..2 {
            let _ = self.send([0.0; 3]);
        }
    }

    fn info(&self) -> DeviceInfo {
        DeviceInfo {
            name: format!("Polhem on {}", self.port.name().unwrap_or_else(|| "a serial port".into())),
            self_arming: false,
            max_force_n: self.config.max_force_n,
            max_stiffness_n_m: self.config.max_stiffness_n_m / self.config.workspace.scale,
            // The protocol rounds to micrometres; the mechanism is coarser, but its resolution is unknown.
            resolution_m: 1e-6,
        }
    }

    fn state(&self) -> DeviceState {
        if self.has_lost_reference { DeviceState::Unhomed } else { DeviceState::Homed }
    }

    fn guard_path(&mut self, fence: &Fence) -> std::io::Result<Option<GuardPath>> {
        // Twice: in the middle of a line the first one only resynchronises the device. The kernel does not
        // interleave two writes of this length.
        fence.set_zero_message([request([0.0; 3], 0.0); 2].as_flattened());
        (self.fence, self.seen_zeros) = (fence.clone(), fence.zeros());
        Ok(self.port.duplicate()?.map(|fd| GuardPath { fd, wire: Wire::Stream }))
    }
}

impl Drop for Polhem {
    fn drop(&mut self) {
        self.stop();
    }
}

/// Formats one request line. Formatting with the standard library may allocate.
fn request(device_n: Vec3, max_force_n: f32) -> [u8; LINE_LEN] {
    let mut line = [b' '; LINE_LEN];
    let [x, y, z] = device_n.map(|newtons| {
        // The cast saturates and maps NaN to zero, so no value wraps round to the other sign.
        (newtons.clamp(-max_force_n, max_force_n) * 1000.0).round() as i16
    });
    let mut at = 0;
    for value in [x, y, z, NORMAL_OPERATION, 0, 0, 0] {
        at = write_decimal(&mut line, at, value) + 1;
    }
    line[LINE_LEN - 1] = b'\n';
    line
}

/// Writes a number and returns the end index. Seven numbers of at most six characters and six spaces are 48
/// bytes: they fit.
fn write_decimal(line: &mut [u8; LINE_LEN], mut at: usize, value: i16) -> usize {
    if value < 0 {
        line[at] = b'-';
        at += 1;
    }
    let mut rest = value.unsigned_abs();
    let mut digits = [0_u8; 5];
    let mut count = 0;
    loop {
        digits[count] = b'0' + (rest % 10) as u8;
        rest /= 10;
        count += 1;
        if rest == 0 {
            break;
        }
    }
    for digit in digits[..count].iter().rev() {
        line[at] = *digit;
        at += 1;
    }
    at
}

/// Values of a reply, in SI units.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Reply {
    position_m: Vec3,
    info: u32,
}

impl Reply {
    /// Parses one line; `None` unless it has exactly eight finite numbers.
    fn parse(line: &[u8]) -> Option<Self> {
        let text = core::str::from_utf8(line).ok()?;
        let mut words = text.split_ascii_whitespace();
        let mut number = || words.next()?.parse::<f32>().ok().filter(|value| value.is_finite());
        let position_m = [number()? * 1e-3, number()? * 1e-3, number()? * 1e-3];
        for _ in 0..4 {
            number()?;
        }
        let info: i16 = words.next()?.parse().ok()?;
        if words.next().is_some() {
            return None;
        }
        Some(Self { position_m, info: u32::from(info as u16) })
    }
}

/// Assembles lines of exactly [`LINE_LEN`] bytes; other lines are discarded.
#[derive(Debug, Clone)]
struct LineBuffer {
    bytes: [u8; LINE_LEN],
    len: usize,
    overlong: bool,
}

impl Default for LineBuffer {
    fn default() -> Self {
        Self { bytes: [0; LINE_LEN], len: 0, overlong: false }
    }
}

impl LineBuffer {
    /// Takes a byte. At a newline it returns the line, or `Some(None)` if the length is wrong.
    fn push(&mut self, byte: u8) -> Option<Option<&[u8]>> {
        if byte != b'\n' {
            match self.bytes.get_mut(self.len) {
                Some(place) if self.len + 1 < LINE_LEN => {
                    *place = byte;
                    self.len += 1;
                }
                _ => self.overlong = true,
            }
            return None;
        }
        let whole = self.len + 1 == LINE_LEN && !self.overlong;
        self.len = 0;
        self.overlong = false;
        Some(whole.then_some(&self.bytes[..LINE_LEN - 1]))
    }
}

#[cfg(test)]
mod tests;
