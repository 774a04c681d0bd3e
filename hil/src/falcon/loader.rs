//! The boot loader, which loads the firmware into the board.
//!
//! 1. DTR rises: the monitor listens at 9600 baud. `0A 43 0D` is answered by `0A 44 2C 0D`, optionally after
//!    a `00`.
//! 2. DTR falls: the processor listens at 142,857 baud. `41` is echoed.
//! 3. Every byte of the boot stream is echoed, and at its end the firmware starts. An invalid stream ends the
//!    echo.
//!
//! A rise of DTR restarts the sequence at any time, also while the firmware runs. This is an assumption,
//! because a load can be repeated.

use super::chip::ModemLines;
use super::image::{BootStream, Image};

/// Baud rate of the monitor.
pub const MONITOR_BAUD: u32 = 9_600;
/// Baud rate of the load.
pub const LOAD_BAUD: u32 = 142_857;

const HELLO: [u8; 3] = [0x0a, 0x43, 0x0d];
const WELCOME: [u8; 4] = [0x0a, 0x44, 0x2c, 0x0d];
/// The byte from which the processor measures the baud rate.
const AUTOBAUD: u8 = 0x41;

/// Faults of the loader.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LoaderFault {
    /// It never answers.
    Silent,
    /// It answers the handshake with an error.
    Refuses,
    /// It receives and echoes this byte of the stream with a flipped bit.
    WrongEcho {
        /// Index of the byte.
        at: usize,
    },
    /// It echoes no byte from this one on.
    FallsSilent {
        /// Index of the first byte without echo.
        at: usize,
    },
    /// It echoes everything, but the firmware does not start.
    NeverStarts,
    /// The firmware starts with an old homing.
    StartsHomed,
}

/// Options of the loader.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LoaderOptions {
    /// A `00` precedes the answer to the handshake.
    pub leading_zero: bool,
    /// The fault, and the number of loads that have it.
    pub fault: Option<(LoaderFault, u32)>,
}

/// State of the loader.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Waits for DTR to go high.
    Idle,
    /// Waits for the handshake.
    Monitor,
    /// The handshake is done. Waits for DTR to go low.
    HandshakeDone,
    /// Waits for the byte that determines the baud rate.
    Autobaud,
    /// Receives the stream.
    Loading,
    /// The stream is invalid or the loader has a fault. It is silent.
    Dead,
}

/// The result of a received byte.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Answer {
    /// Bytes to send back.
    pub bytes: Vec<u8>,
    /// The firmware that starts now.
    pub started: Option<Image>,
}

/// The loader.
#[derive(Debug, Clone)]
pub struct Loader {
    options: LoaderOptions,
    stage: Stage,
    dtr: bool,
    recent: [u8; HELLO.len()],
    stream: BootStream,
    taken: usize,
    /// Handshakes so far.
    loads: u32,
}

impl Loader {
    /// A board that is powered up now.
    #[must_use]
    pub fn new(options: LoaderOptions) -> Self {
        Self {
            options,
            stage: Stage::Idle,
            dtr: false,
            recent: [0; HELLO.len()],
            stream: BootStream::default(),
            taken: 0,
            loads: 0,
        }
    }

    /// State of the loader.
    #[must_use]
    pub const fn stage(&self) -> Stage {
        self.stage
    }

    /// Loads started so far.
    #[must_use]
    pub const fn loads(&self) -> u32 {
        self.loads
    }

    /// The present baud rate of both directions.
    #[must_use]
    pub const fn baud(&self) -> u32 {
        match self.stage {
            Stage::Idle | Stage::Monitor | Stage::HandshakeDone => MONITOR_BAUD,
            Stage::Autobaud | Stage::Loading | Stage::Dead => LOAD_BAUD,
        }
    }

    /// Sets the modem lines. Returns true if that resets the board.
    pub fn lines(&mut self, lines: ModemLines) -> bool {
        let (rises, falls) = (lines.dtr && !self.dtr, !lines.dtr && self.dtr);
        self.dtr = lines.dtr;
        if rises {
            (self.stage, self.recent) = (Stage::Monitor, [0; HELLO.len()]);
        } else if falls {
            self.stage = if self.stage == Stage::HandshakeDone { Stage::Autobaud } else { Stage::Idle };
        }
        rises
    }

    /// Power cycle of the board: only another rise of DTR starts the monitor.
    pub const fn restart(&mut self) {
        self.stage = Stage::Idle;
    }

    /// The fault of the present load.
    pub(super) fn fault(&self) -> Option<LoaderFault> {
        self.options.fault.filter(|(_, times)| self.loads <= *times).map(|(fault, _)| fault)
    }

    /// Takes a byte as received at the loader's baud rate.
    pub fn take(&mut self, byte: u8) -> Answer {
        match self.stage {
            Stage::Monitor | Stage::HandshakeDone => self.handshake(byte),
            Stage::Autobaud if byte == AUTOBAUD => {
                (self.stage, self.stream, self.taken) = (Stage::Loading, BootStream::default(), 0);
                Answer { bytes: vec![AUTOBAUD], started: None }
            }
            Stage::Loading => self.load(byte),
            Stage::Idle | Stage::Autobaud | Stage::Dead => Answer::default(),
        }
    }

    fn handshake(&mut self, byte: u8) -> Answer {
        self.recent = [self.recent[1], self.recent[2], byte];
        if self.recent != HELLO {
            return Answer::default();
        }
        self.loads += 1;
        let mut bytes = if self.options.leading_zero { vec![0] } else { Vec::new() };
        match self.fault() {
            Some(LoaderFault::Silent) => return Answer::default(),
            Some(LoaderFault::Refuses) => bytes.extend([0x0a, 0x45, 0x0d]),
            _ => {
                self.stage = Stage::HandshakeDone;
                bytes.extend(WELCOME);
            }
        }
        Answer { bytes, started: None }
    }

    fn load(&mut self, byte: u8) -> Answer {
        let fault = self.fault();
        let received = match fault {
            Some(LoaderFault::WrongEcho { at }) if at == self.taken => byte ^ 0x10,
            Some(LoaderFault::FallsSilent { at }) if at <= self.taken => {
                self.stage = Stage::Dead;
                return Answer::default();
            }
            _ => byte,
        };
        self.taken += 1;
        let mut answer = Answer { bytes: vec![received], started: None };
        match self.stream.take(received) {
            Ok(None) => {}
            Ok(Some(_)) if fault == Some(LoaderFault::NeverStarts) => self.stage = Stage::Dead,
            Ok(started) => (self.stage, answer.started) = (Stage::Idle, started),
            Err(_) => {
                self.stage = Stage::Dead;
                answer.bytes.clear();
            }
        }
        answer
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::falcon::image::synthetic_image;

    const HIGH: ModemLines = ModemLines { dtr: true, rts: false };
    const LOW: ModemLines = ModemLines { dtr: false, rts: false };

    fn send(loader: &mut Loader, bytes: &[u8]) -> Vec<u8> {
        bytes.iter().flat_map(|byte| loader.take(*byte).bytes).collect()
    }

    fn image() -> Vec<u8> {
        synthetic_image(0x3f_8000, &[(0x3f_8000, &[0x1234; 50])])
    }

    /// Loads an image. Returns the echo of the stream, and whether the firmware started.
    fn load(loader: &mut Loader, image: &[u8]) -> (Vec<u8>, bool) {
        loader.lines(LOW);
        assert!(loader.lines(HIGH));
        send(loader, &HELLO);
        assert!(!loader.lines(LOW));
        if send(loader, &[AUTOBAUD]) != [AUTOBAUD] {
            return (Vec::new(), false);
        }
        let (mut echo, mut started) = (Vec::new(), false);
        for byte in image {
            let answer = loader.take(*byte);
            echo.extend(answer.bytes);
            started |= answer.started.is_some();
        }
        (echo, started)
    }

    #[test]
    fn the_handshake_is_answered_only_while_dtr_is_high() {
        let mut loader = Loader::new(LoaderOptions::default());
        assert_eq!(send(&mut loader, &HELLO), b"");
        loader.lines(HIGH);
        assert_eq!(loader.baud(), 9_600);
        assert_eq!(send(&mut loader, b"\x0a\x43\x43"), b"");
        assert_eq!(send(&mut loader, &HELLO), WELCOME);
        assert_eq!(send(&mut loader, &HELLO), WELCOME, "again, because the first answer may be lost");
        loader.lines(LOW);
        assert_eq!((loader.stage(), loader.baud()), (Stage::Autobaud, 142_857));
        assert_eq!(send(&mut loader, b"\xff\x41"), [0x41]);
    }

    #[test]
    fn without_a_handshake_dtr_starts_no_load() {
        let mut loader = Loader::new(LoaderOptions::default());
        loader.lines(HIGH);
        loader.lines(LOW);
        assert_eq!(loader.stage(), Stage::Idle);
        assert_eq!(send(&mut loader, &[AUTOBAUD]), b"");
    }

    #[test]
    fn a_valid_image_is_echoed_and_started() {
        let mut loader = Loader::new(LoaderOptions { leading_zero: true, fault: None });
        assert_eq!(load(&mut loader, &image()), (image(), true));
    }

    #[test]
    fn an_invalid_image_ends_the_echo_and_dtr_restarts_the_load() {
        let mut loader = Loader::new(LoaderOptions::default());
        let mut damaged = image();
        damaged[1] = 0x07;
        assert_eq!(load(&mut loader, &damaged), (vec![0xaa], false));
        assert_eq!(loader.stage(), Stage::Dead);
        assert_eq!(load(&mut loader, &image()), (image(), true));
        assert_eq!(loader.loads(), 2);
    }

    #[test]
    fn a_fault_occurs_in_the_given_number_of_loads() {
        for fault in [
            LoaderFault::Silent,
            LoaderFault::Refuses,
            LoaderFault::WrongEcho { at: 60 },
            LoaderFault::FallsSilent { at: 60 },
            LoaderFault::NeverStarts,
        ] {
            let mut loader = Loader::new(LoaderOptions { leading_zero: false, fault: Some((fault, 2)) });
            for _ in 0..2 {
                let (echo, started) = load(&mut loader, &image());
                let sound = echo == image() && started;
                assert!(!sound, "{fault:?}");
                match fault {
                    LoaderFault::WrongEcho { at } => assert_eq!(echo[at], image()[at] ^ 0x10),
                    LoaderFault::FallsSilent { at } => assert_eq!(echo.len(), at),
                    LoaderFault::NeverStarts => assert_eq!((echo == image(), started), (true, false)),
                    LoaderFault::Silent | LoaderFault::Refuses | LoaderFault::StartsHomed => {
                        assert!(echo.is_empty())
                    }
                }
            }
            assert_eq!(load(&mut loader, &image()), (image(), true), "{fault:?}");
        }
    }
}
