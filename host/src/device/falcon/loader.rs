//! Starts the firmware: probes whether it runs; if not, calls the processor's boot loader and sends the
//! image.
//!
//! It blocks for seconds and runs before the loop. Source of the procedure: libnifalcon.

use super::firmware::Image;
use super::ftdi::Ftdi;
use super::line::{ReplyTimeout, Setting, apply_all, read_until, send};
use super::packet::{Decoder, Lights, Reply, Request};
use crate::device::DeviceError;
use core::fmt;
use core::time::Duration;

/// Call to the boot loader.
const CALL: &[u8] = b"\x0AC\x0D";
/// Its answer.
const ANSWER: &[u8] = b"\x0AD,\x0D";
/// Starts the image at the higher rate; echoed.
const BEGIN: &[u8] = b"A";
/// Bytes of the image per chunk: the echo fits into one packet.
const CHUNK_LEN: usize = 62;
/// Largest number of calls to the boot loader.
const MAX_CALLS: u32 = 100;
/// Largest number of attempts to send the image.
const MAX_LOADS: u32 = 20;
/// Largest number of probe packets.
const MAX_PROBES: u32 = 10;
/// Timeout of a write.
const WRITE_TIMEOUT: Duration = Duration::from_secs(1);
/// Timeout for the answer to a call: five times the latency timer of 16 ms.
const CALL_TIMEOUT: ReplyTimeout = ReplyTimeout { reads: 5, each: Duration::from_millis(16) };
/// Timeout for the echo of a chunk: half a second.
const ECHO_TIMEOUT: ReplyTimeout = ReplyTimeout { reads: 30, each: Duration::from_millis(16) };
/// Timeout for the reply to a packet. The latency timer of 1 ms ends each of these reads.
const REPLY_TIMEOUT: ReplyTimeout = ReplyTimeout { reads: 20, each: Duration::from_millis(5) };

/// Reason why the firmware could not be loaded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LoadError {
    /// The link failed.
    Device(DeviceError),
    /// The boot loader does not answer.
    NoLoader,
    /// The echo differed from the sent bytes in every attempt.
    Echo {
        /// Index of the first wrong byte of the image; `None` before the image.
        at: Option<usize>,
    },
    /// The loaded firmware does not reply.
    Silent,
}

impl fmt::Display for LoadError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Device(error) => write!(f, "{error}; check the cable and connect the device again"),
            Self::NoLoader => f.write_str(
                "its boot loader does not answer; disconnect its power, wait, and connect it again",
            ),
            Self::Echo { at: Some(at) } => {
                write!(
                    f,
                    "the echo of byte {at} of the firmware was wrong in {MAX_LOADS} attempts; try another cable or port"
                )
            }
            Self::Echo { at: None } => f.write_str(
                "its boot loader does not echo the start byte; disconnect its power, wait, and connect it again",
            ),
            Self::Silent => f.write_str(
                "no reply after the firmware was loaded; check that the file is the Falcon's firmware",
            ),
        }
    }
}

impl core::error::Error for LoadError {}

impl From<DeviceError> for LoadError {
    fn from(error: DeviceError) -> Self {
        Self::Device(error)
    }
}

/// Configures the line for the firmware. Both directions are then empty.
pub fn set_normal(ftdi: &impl Ftdi) -> Result<(), DeviceError> {
    apply_all(
        ftdi,
        &[Setting::Latency(1), Setting::NoFlowControl, Setting::EightBits, Setting::BaudFirmware],
    )?;
    // With the event byte a packet is sent with its last byte instead of at the timer. A chip without this
    // setting is slower; a disconnected one fails in the next request.
    let _ = Setting::EventByte(super::packet::END).apply(ftdi);
    apply_all(ftdi, &[Setting::PurgeReceived, Setting::PurgeUnsent])
}

/// Sends packets without force until the firmware replies; `None` if it does not.
pub fn probe(ftdi: &impl Ftdi) -> Result<Option<Reply>, DeviceError> {
    let lights = Lights { red: true, ..Lights::default() };
    let request = Request { lights, ..Request::default() }.encode();
    for _ in 0..MAX_PROBES {
        send(ftdi, &request, WRITE_TIMEOUT)?;
        let found = |bytes: &[u8]| Decoder::default().push(bytes).newest;
        let received = read_until(ftdi, REPLY_TIMEOUT, |bytes| found(bytes).is_some() || bytes.len() > 4096)?;
        if let Some(reply) = found(&received) {
            return Ok(Some(reply));
        }
    }
    Ok(None)
}

/// Loads the firmware and returns its first reply.
pub fn load(ftdi: &impl Ftdi, image: &Image) -> Result<Reply, LoadError> {
    let mut failure = LoadError::NoLoader;
    for _ in 0..MAX_LOADS {
        match load_once(ftdi, image) {
            Ok(()) => {
                set_normal(ftdi)?;
                return probe(ftdi)?.ok_or(LoadError::Silent);
            }
            Err(error @ LoadError::Echo { .. }) => failure = error,
            // After a hundred calls without answer, or a failed link, another attempt is useless.
            Err(error) => return Err(error),
        }
    }
    Err(failure)
}

fn load_once(ftdi: &impl Ftdi, image: &Image) -> Result<(), LoadError> {
    apply_all(
        ftdi,
        &[
            Setting::PurgeReceived,
            Setting::PurgeUnsent,
            Setting::Latency(16),
            Setting::Baud9600,
            Setting::EightBits,
            Setting::NoFlowControl,
            Setting::RtsLow,
            Setting::Dtr(false),
            Setting::Dtr(true),
        ],
    )?;
    call(ftdi)?;
    apply_all(ftdi, &[Setting::Dtr(false), Setting::BaudImage])?;
    if echo(ftdi, BEGIN)? != BEGIN {
        return Err(LoadError::Echo { at: None });
    }
    for (index, chunk) in image.bytes().chunks(CHUNK_LEN).enumerate() {
        let back = echo(ftdi, chunk)?;
        if back != chunk {
            let same = back.iter().zip(chunk).take_while(|(a, b)| a == b).count();
            return Err(LoadError::Echo { at: Some(index * CHUNK_LEN + same) });
        }
    }
    Ok(())
}

/// Calls until the loader answers. A zero, or the rest of an earlier answer, may come first.
fn call(ftdi: &impl Ftdi) -> Result<(), LoadError> {
    for _ in 0..MAX_CALLS {
        send(ftdi, CALL, WRITE_TIMEOUT)?;
        let received = read_until(ftdi, CALL_TIMEOUT, |bytes| bytes.ends_with(ANSWER) || bytes.len() > 64)?;
        if received.ends_with(ANSWER) {
            return Ok(());
        }
    }
    Err(LoadError::NoLoader)
}

/// Sends bytes and returns their echo.
fn echo(ftdi: &impl Ftdi, bytes: &[u8]) -> Result<Vec<u8>, LoadError> {
    send(ftdi, bytes, WRITE_TIMEOUT)?;
    Ok(read_until(ftdi, ECHO_TIMEOUT, |back| back.len() >= bytes.len())?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::DeviceErrorKind;

    #[test]
    fn errors_are_one_line_and_name_the_fix() {
        let disconnected = LoadError::Device(DeviceError::new(DeviceErrorKind::Disconnected));
        for error in [
            disconnected,
            LoadError::NoLoader,
            LoadError::Echo { at: None },
            LoadError::Echo { at: Some(7) },
            LoadError::Silent,
        ] {
            let text = error.to_string();
            assert!(!text.contains('\n') && text.contains("; "), "{text}");
        }
    }
}
