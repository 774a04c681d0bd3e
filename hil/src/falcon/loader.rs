//! The boot loader: how a board without firmware gets one.
//!
//! 1. DTR goes high: the monitor listens at 9600 baud. `0A 43 0D` is answered by `0A 44 2C 0D`, perhaps after a `00`.
//! 2. DTR goes low: the processor listens at 142,857 baud. `41` is echoed.
//! 3. Every byte of the boot stream is echoed; at its end the firmware runs. A stream that is none ends the echo.
//!
//! DTR going high begins again at any time, also while firmware runs: assumed, since a load may be repeated.

use super::chip::ModemLines;
use super::image::{BootStream, Image};

/// Rate of the monitor.
pub const MONITOR_BAUD: u32 = 9_600;
/// Rate of the load.
pub const LOAD_BAUD: u32 = 142_857;

const HELLO: [u8; 3] = [0x0a, 0x43, 0x0d];
const WELCOME: [u8; 4] = [0x0a, 0x44, 0x2c, 0x0d];
/// The byte by which the processor would measure the rate.
const AUTOBAUD: u8 = 0x41;

/// What a loader may do wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LoaderFault {
    /// It never answers.
    Silent,
    /// It answers the handshake, but not as it should.
    Refuses,
    /// It echoes this byte of the stream with a bit flipped, and takes it so.
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
}

/// How the loader is to behave.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LoaderOptions {
    /// A `00` comes before the answer to the handshake.
    pub leading_zero: bool,
    /// What goes wrong, and in how many tries before one goes well.
    pub fault: Option<(LoaderFault, u32)>,
}

/// How far it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Waits for DTR to go high.
    Idle,
    /// Waits for the handshake.
    Monitor,
    /// The handshake is done; waits for DTR to go low.
    Greeted,
    /// Waits for the byte that says the rate.
    Autobaud,
    /// Takes the stream.
    Loading,
    /// The stream was none, or the loader has a fault: nothing more is said.
    Dead,
}

/// What a byte brought.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Answer {
    /// Bytes to send back.
    pub bytes: Vec<u8>,
    /// The firmware that runs from now on.
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
    /// Tries so far: handshakes begun.
    tries: u32,
}

impl Loader {
    /// A board that has just got its power.
    #[must_use]
    pub fn new(options: LoaderOptions) -> Self {
        Self {
            options,
            stage: Stage::Idle,
            dtr: false,
            recent: [0; HELLO.len()],
            stream: BootStream::default(),
            taken: 0,
            tries: 0,
        }
    }

    /// How far it is.
    #[must_use]
    pub const fn stage(&self) -> Stage {
        self.stage
    }

    /// Loads begun so far.
    #[must_use]
    pub const fn tries(&self) -> u32 {
        self.tries
    }

    /// The rate it listens and speaks at now.
    #[must_use]
    pub const fn baud(&self) -> u32 {
        match self.stage {
            Stage::Idle | Stage::Monitor | Stage::Greeted => MONITOR_BAUD,
            Stage::Autobaud | Stage::Loading | Stage::Dead => LOAD_BAUD,
        }
    }

    /// The host has set the modem lines; true if that resets the board.
    pub fn lines(&mut self, lines: ModemLines) -> bool {
        let (rises, falls) = (lines.dtr && !self.dtr, !lines.dtr && self.dtr);
        self.dtr = lines.dtr;
        if rises {
            (self.stage, self.recent) = (Stage::Monitor, [0; HELLO.len()]);
        } else if falls {
            self.stage = if self.stage == Stage::Greeted { Stage::Autobaud } else { Stage::Idle };
        }
        rises
    }

    /// The board has lost its power and got it again: only another rise of DTR wakes the monitor.
    pub const fn restart(&mut self) {
        self.stage = Stage::Idle;
    }

    /// The fault of the load that goes on now.
    fn fault(&self) -> Option<LoaderFault> {
        self.options.fault.filter(|(_, times)| self.tries <= *times).map(|(fault, _)| fault)
    }

    /// Takes a byte as it was heard at the loader's rate.
    pub fn take(&mut self, byte: u8) -> Answer {
        match self.stage {
            Stage::Monitor | Stage::Greeted => self.greet(byte),
            Stage::Autobaud if byte == AUTOBAUD => {
                (self.stage, self.stream, self.taken) = (Stage::Loading, BootStream::default(), 0);
                Answer { bytes: vec![AUTOBAUD], started: None }
            }
            Stage::Loading => self.load(byte),
            Stage::Idle | Stage::Autobaud | Stage::Dead => Answer::default(),
        }
    }

    fn greet(&mut self, byte: u8) -> Answer {
        self.recent = [self.recent[1], self.recent[2], byte];
        if self.recent != HELLO {
            return Answer::default();
        }
        self.tries += 1;
        let mut bytes = if self.options.leading_zero { vec![0] } else { Vec::new() };
        match self.fault() {
            Some(LoaderFault::Silent) => return Answer::default(),
            Some(LoaderFault::Refuses) => bytes.extend([0x0a, 0x45, 0x0d]),
            _ => {
                self.stage = Stage::Greeted;
                bytes.extend(WELCOME);
            }
        }
        Answer { bytes, started: None }
    }

    fn load(&mut self, byte: u8) -> Answer {
        let fault = self.fault();
        let heard = match fault {
            Some(LoaderFault::WrongEcho { at }) if at == self.taken => byte ^ 0x10,
            Some(LoaderFault::FallsSilent { at }) if at <= self.taken => {
                self.stage = Stage::Dead;
                return Answer::default();
            }
            _ => byte,
        };
        self.taken += 1;
        let mut answer = Answer { bytes: vec![heard], started: None };
        match self.stream.take(heard) {
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

    fn say(loader: &mut Loader, bytes: &[u8]) -> Vec<u8> {
        bytes.iter().flat_map(|byte| loader.take(*byte).bytes).collect()
    }

    fn image() -> Vec<u8> {
        synthetic_image(0x3f_8000, &[(0x3f_8000, &[0x1234; 50])])
    }

    /// As far as the echo of the stream, and whether the firmware started.
    fn load(loader: &mut Loader, image: &[u8]) -> (Vec<u8>, bool) {
        loader.lines(LOW);
        assert!(loader.lines(HIGH));
        say(loader, &HELLO);
        assert!(!loader.lines(LOW));
        if say(loader, &[AUTOBAUD]) != [AUTOBAUD] {
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
    fn the_handshake_is_answered_while_dtr_is_high_and_only_then() {
        let mut loader = Loader::new(LoaderOptions::default());
        assert_eq!(say(&mut loader, &HELLO), b"");
        loader.lines(HIGH);
        assert_eq!(loader.baud(), 9_600);
        assert_eq!(say(&mut loader, b"\x0a\x43\x43"), b"");
        assert_eq!(say(&mut loader, &HELLO), WELCOME);
        assert_eq!(say(&mut loader, &HELLO), WELCOME, "again, if the first answer was lost");
        loader.lines(LOW);
        assert_eq!((loader.stage(), loader.baud()), (Stage::Autobaud, 142_857));
        assert_eq!(say(&mut loader, b"\xff\x41"), [0x41]);
    }

    #[test]
    fn without_a_greeting_dtr_leads_nowhere() {
        let mut loader = Loader::new(LoaderOptions::default());
        loader.lines(HIGH);
        loader.lines(LOW);
        assert_eq!(loader.stage(), Stage::Idle);
        assert_eq!(say(&mut loader, &[AUTOBAUD]), b"");
    }

    #[test]
    fn a_sound_image_is_echoed_and_started() {
        let mut loader = Loader::new(LoaderOptions { leading_zero: true, fault: None });
        assert_eq!(load(&mut loader, &image()), (image(), true));
    }

    #[test]
    fn an_image_that_is_none_loses_its_echo_and_dtr_begins_again() {
        let mut loader = Loader::new(LoaderOptions::default());
        let mut damaged = image();
        damaged[1] = 0x07;
        assert_eq!(load(&mut loader, &damaged), (vec![0xaa], false));
        assert_eq!(loader.stage(), Stage::Dead);
        assert_eq!(load(&mut loader, &image()), (image(), true));
        assert_eq!(loader.tries(), 2);
    }

    #[test]
    fn faults_strike_as_many_tries_as_asked() {
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
                    LoaderFault::Silent | LoaderFault::Refuses => assert!(echo.is_empty()),
                }
            }
            assert_eq!(load(&mut loader, &image()), (image(), true), "{fault:?}");
        }
    }
}
