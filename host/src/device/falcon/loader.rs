//! Bringing the firmware up: does it answer already, and if not, the processor's boot loader and the image.
//!
//! Blocks for seconds; all of it happens before the loop. Source of the procedure: libnifalcon.

use super::firmware::Image;
use super::ftdi::Ftdi;
use super::line::{Patience, Setting, apply_all, listen, send};
use super::packet::{Decoder, Lights, Reply, Request};
use crate::device::DeviceError;
use core::fmt;
use core::time::Duration;

/// Called to the loader.
const CALL: &[u8] = b"\x0AC\x0D";
/// What it answers.
const ANSWER: &[u8] = b"\x0AD,\x0D";
/// Begins the image at the higher rate, and is echoed.
const BEGIN: &[u8] = b"A";
/// Bytes of the image at a time: what comes back in one packet.
const CHUNK_LEN: usize = 62;
/// How often the loader is called.
const CALLS: u32 = 100;
/// How often the image is sent, if it comes back changed.
const LOADS: u32 = 20;
/// How often a packet is sent to see whether there is an answer.
const PROBES: u32 = 10;
/// Longest write.
const WRITE_TIMEOUT: Duration = Duration::from_secs(1);
/// For an answer to a call: five times the latency timer of 16 ms.
const CALL_PATIENCE: Patience = Patience { reads: 5, each: Duration::from_millis(16) };
/// For the echo of a chunk, half a second.
const ECHO_PATIENCE: Patience = Patience { reads: 30, each: Duration::from_millis(16) };
/// For the reply to a packet. The latency timer of 1 ms ends each of these reads.
const REPLY_PATIENCE: Patience = Patience { reads: 20, each: Duration::from_millis(5) };

/// Why the firmware is not loaded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LoadError {
    /// The link failed.
    Device(DeviceError),
    /// The boot loader does not answer.
    NoLoader,
    /// It came back otherwise than it was sent, every time.
    Echo {
        /// First byte of the image that did; `None` before the image.
        at: Option<usize>,
    },
    /// Loaded, and silent.
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
                    "byte {at} of the firmware came back changed, {LOADS} times over; try another cable or port"
                )
            }
            Self::Echo { at: None } => f.write_str(
                "its boot loader does not follow; disconnect its power, wait, and connect it again",
            ),
            Self::Silent => f.write_str(
                "silent after its firmware was loaded; check that the file is the Falcon's firmware",
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

/// The line as the firmware wants it. Both directions are empty then.
pub fn set_normal(ftdi: &impl Ftdi) -> Result<(), DeviceError> {
    apply_all(
        ftdi,
        &[Setting::Latency(1), Setting::NoFlowControl, Setting::EightBits, Setting::BaudFirmware],
    )?;
    // A packet leaves with its last byte instead of with the timer. A chip that cannot do it is slower; one that is gone says so next.
    let _ = Setting::EventByte(super::packet::END).apply(ftdi);
    apply_all(ftdi, &[Setting::PurgeReceived, Setting::PurgeUnsent])
}

/// Asks the firmware for a sign of life, without force; `None` if there is none.
pub fn probe(ftdi: &impl Ftdi) -> Result<Option<Reply>, DeviceError> {
    let lights = Lights { red: true, ..Lights::default() };
    let request = Request { lights, ..Request::default() }.encode();
    for _ in 0..PROBES {
        send(ftdi, &request, WRITE_TIMEOUT)?;
        let found = |bytes: &[u8]| Decoder::default().push(bytes).newest;
        let received = listen(ftdi, REPLY_PATIENCE, |bytes| found(bytes).is_some() || bytes.len() > 4096)?;
        if let Some(reply) = found(&received) {
            return Ok(Some(reply));
        }
    }
    Ok(None)
}

/// Loads the firmware and hears its first reply.
pub fn load(ftdi: &impl Ftdi, image: &Image) -> Result<Reply, LoadError> {
    let mut failure = LoadError::NoLoader;
    for _ in 0..LOADS {
        match load_once(ftdi, image) {
            Ok(()) => {
                set_normal(ftdi)?;
                return probe(ftdi)?.ok_or(LoadError::Silent);
            }
            Err(error @ LoadError::Echo { .. }) => failure = error,
            // A loader that was called a hundred times, or a link that failed, is not there the next time either.
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

/// Calls until the loader answers. A zero, or what was left of an earlier answer, may come before.
fn call(ftdi: &impl Ftdi) -> Result<(), LoadError> {
    for _ in 0..CALLS {
        send(ftdi, CALL, WRITE_TIMEOUT)?;
        let received = listen(ftdi, CALL_PATIENCE, |bytes| bytes.ends_with(ANSWER) || bytes.len() > 64)?;
        if received.ends_with(ANSWER) {
            return Ok(());
        }
    }
    Err(LoadError::NoLoader)
}

/// Sends bytes and gives what comes back.
fn echo(ftdi: &impl Ftdi, bytes: &[u8]) -> Result<Vec<u8>, LoadError> {
    send(ftdi, bytes, WRITE_TIMEOUT)?;
    Ok(listen(ftdi, ECHO_PATIENCE, |back| back.len() >= bytes.len())?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::DeviceErrorKind;
    use crate::device::falcon::fake::Fake;

    #[test]
    fn running_firmware_is_heard_and_gets_no_force() {
        let chip = Fake::running();
        set_normal(&chip).expect("a link");
        assert!(probe(&chip).expect("a link").is_some());
        let request = chip.last();
        assert_eq!((request.motors, request.homing), ([0; 3], false));
        let silent = Fake::silent();
        set_normal(&silent).expect("a link");
        assert_eq!(probe(&silent), Ok(None));
    }

    #[test]
    fn an_image_is_loaded_byte_for_byte_and_answers() {
        let (chip, image) = (Fake::silent(), Image::synthetic(500));
        chip.with(|script| script.deaf_calls = 3);
        assert!(load(&chip, &image).is_ok());
        chip.with(|script| {
            assert_eq!(script.image[1..], *image.bytes());
            assert_eq!(script.loads, 1);
            let settings =
                [(0, 1), (0, 2), (9, 16), (3, 0x4138), (4, 8), (2, 0), (1, 0x200), (1, 0x100), (1, 0x101)];
            assert_eq!(script.settings[..9], settings);
            assert_eq!(script.settings[9..11], [(1, 0x100), (3, 0x15)]);
            let normal = [(9, 1), (2, 0), (4, 8), (3, 0x2), (6, 0x013E), (0, 1), (0, 2)];
            assert_eq!(script.settings[11..], normal);
        });
    }

    #[test]
    fn a_wrong_echo_begins_the_load_again() {
        let (chip, image) = (Fake::silent(), Image::synthetic(200));
        chip.with(|script| script.wrong_echoes = (3, 130));
        load(&chip, &image).expect("loaded the fourth time");
        assert_eq!(chip.with(|script| script.loads), 4);
    }

    #[test]
    fn an_echo_that_stays_wrong_is_an_error_with_its_place() {
        let (chip, image) = (Fake::silent(), Image::synthetic(200));
        chip.with(|script| script.wrong_echoes = (1000, 130));
        assert_eq!(load(&chip, &image), Err(LoadError::Echo { at: Some(130) }));
        assert_eq!(chip.with(|script| script.loads), LOADS);
    }

    #[test]
    fn a_loader_that_hears_nothing_and_a_cable_that_is_out_are_told_apart() {
        let (chip, image) = (Fake::silent(), Image::synthetic(2));
        chip.with(|script| script.deaf_calls = 1000);
        assert_eq!(load(&chip, &image), Err(LoadError::NoLoader));
        assert_eq!(chip.with(|script| script.deaf_calls), 1000 - CALLS);
        chip.with(|script| script.unplugged = true);
        let gone = DeviceError::new(DeviceErrorKind::Disconnected);
        assert_eq!(load(&chip, &image), Err(LoadError::Device(gone)));
    }

    #[test]
    fn errors_are_one_line_with_the_mend() {
        let gone = LoadError::Device(DeviceError::new(DeviceErrorKind::Disconnected));
        for error in [
            gone,
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
