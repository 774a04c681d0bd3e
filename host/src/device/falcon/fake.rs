//! A scripted chip with a device behind it, for the unit tests of the driver: no clock, and no motion of its own.

use super::firmware::Image;
use super::ftdi::{Ftdi, PACKET_LEN};
use super::kinematics::{CENTRE_M, Kinematics};
use super::line::Setting;
use super::packet::{self, Reply, Request};
use crate::device::{DeviceError, DeviceErrorKind};
use core::time::Duration;
use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex};

/// What the script may set and look at.
#[derive(Debug, Default)]
pub(super) struct Script {
    /// The firmware runs.
    pub loaded: bool,
    /// Calls that the boot loader does not hear.
    pub deaf_calls: u32,
    /// Loads during which the byte of the image at this place comes back changed.
    pub wrong_echoes: (u32, usize),
    /// Loads begun.
    pub loads: u32,
    /// The image as it came.
    pub image: Vec<u8>,
    /// Settings in the order they came.
    pub settings: Vec<(u8, u16)>,
    /// Requests understood.
    pub requests: Vec<Request>,
    /// What the device says when it is asked.
    pub reply: Reply,
    /// Replies wait in `held` instead of being sent.
    pub holds: bool,
    /// These.
    pub held: Vec<Vec<u8>>,
    /// It says that it is homed whatever is loaded.
    pub never_forgets: bool,
    /// The cable is out.
    pub unplugged: bool,
    /// There is no room for what is written: a write waits until there is.
    pub stalls: bool,
    /// Writes that wait now.
    pub stalled: u32,
    /// Writes to come that fail.
    pub failing_writes: u32,
    incoming: VecDeque<Vec<u8>>,
    called: Vec<u8>,
}

impl Script {
    /// Puts bytes into the next transfer to the host.
    pub(super) fn say(&mut self, bytes: &[u8]) {
        self.incoming.push_back(bytes.to_vec());
    }

    /// Lets go of what was held.
    pub(super) fn release(&mut self) {
        self.incoming.extend(self.held.drain(..));
    }

    /// Moves the hand.
    pub(super) fn put(&mut self, position_m: [f64; 3]) {
        self.reply.encoders = Kinematics::default().counts(position_m).expect("within reach");
    }

    fn last(&self, request: u8) -> Option<u16> {
        self.settings.iter().rev().find(|(r, _)| *r == request).map(|(_, value)| *value)
    }

    fn take(&mut self, bytes: &[u8]) {
        match self.last(3) {
            Some(0x2) if self.loaded => self.take_packet(bytes),
            Some(0x4138) if !self.loaded => self.take_call(bytes),
            Some(0x15) if !self.loaded => self.take_image(bytes),
            _ => {}
        }
    }

    fn take_packet(&mut self, bytes: &[u8]) {
        let packet: Result<[u8; packet::PACKET_LEN], _> = bytes.try_into();
        if let Some(request) = packet.ok().and_then(|packet| Request::decode(&packet)) {
            self.requests.push(request);
            let reply = self.reply.encode().to_vec();
            if self.holds { self.held.push(reply) } else { self.incoming.push_back(reply) }
        }
    }

    fn take_call(&mut self, bytes: &[u8]) {
        self.called.extend(bytes);
        if self.called.ends_with(b"\x0AC\x0D") {
            self.called.clear();
            if self.deaf_calls > 0 {
                self.deaf_calls -= 1;
            } else {
                self.say(b"\0\x0AD,\x0D");
                self.loads += 1;
                self.image.clear();
            }
        }
    }

    fn take_image(&mut self, bytes: &[u8]) {
        if self.image.is_empty() && bytes == b"A" {
            self.say(b"A");
            self.image.push(b'A');
            return;
        }
        let begins = self.image.len() - 1;
        self.image.extend(bytes);
        // Whatever ran before is gone, and its homing with it.
        self.reply.homed = if self.never_forgets { packet::ALL_HOMED } else { 0 };
        let mut echo = bytes.to_vec();
        let (loads, at) = self.wrong_echoes;
        if let Some(byte) =
            at.checked_sub(begins).and_then(|at| echo.get_mut(at)).filter(|_| self.loads <= loads)
        {
            *byte ^= 0x10;
        }
        // In two pieces, as a UART does it.
        let (first, second) = echo.split_at(echo.len() / 2);
        self.say(first);
        self.say(second);
        self.loaded = Image::new(self.image[1..].to_vec()).is_ok() && self.loads > loads;
    }
}

/// The chip.
#[derive(Debug)]
pub(super) struct Fake {
    script: Mutex<Script>,
    room: Condvar,
}

impl Fake {
    /// A device in the middle of its workspace, with its firmware, that nobody has homed.
    pub(super) fn running() -> Arc<Self> {
        Self::of(Script { loaded: true, ..Script::default() })
    }

    /// The same without its firmware.
    pub(super) fn silent() -> Arc<Self> {
        Self::of(Script::default())
    }

    fn of(mut script: Script) -> Arc<Self> {
        script.put(CENTRE_M);
        Arc::new(Self { script: Mutex::new(script), room: Condvar::new() })
    }

    /// The user has homed it.
    pub(super) fn home(&self) {
        self.with(|script| script.reply.homed = packet::ALL_HOMED);
    }

    /// Lets the write that is stalled go on.
    pub(super) fn make_room(&self) {
        self.with(|script| script.stalls = false);
        self.room.notify_all();
    }

    /// Looks at the script, or changes it.
    pub(super) fn with<R>(&self, act: impl FnOnce(&mut Script) -> R) -> R {
        act(&mut self.script.lock().expect("no test panics within"))
    }

    /// The last request.
    pub(super) fn last(&self) -> Request {
        self.with(|script| *script.requests.last().expect("a request"))
    }
}

/// Longest that a write is stalled: a test that waits for it fails instead of hanging.
pub(super) const STALL: Duration = Duration::from_secs(20);

fn gone() -> DeviceError {
    DeviceError::new(DeviceErrorKind::Disconnected)
}

impl Ftdi for Fake {
    fn control(&self, request: u8, value: u16) -> Result<(), DeviceError> {
        self.with(|script| {
            script.settings.push((request, value));
            // DTR that rises resets the board: its boot loader listens.
            script.loaded &= (request, value) != Setting::Dtr(true).request();
            if (request, value) == Setting::PurgeReceived.request() {
                script.incoming.clear();
            }
            if script.unplugged { Err(gone()) } else { Ok(()) }
        })
    }

    fn write(&self, bytes: &[u8], timeout: Duration) -> Result<usize, DeviceError> {
        assert!(!timeout.is_zero(), "for ever, to libusb");
        let mut script = self.script.lock().expect("no test panics within");
        script.stalled += 1;
        // Longer than it is asked to wait: a test is not to depend on how long that is.
        let (mut script, _) = self
            .room
            .wait_timeout_while(script, STALL, |script| script.stalls)
            .expect("no test panics within");
        script.stalled -= 1;
        drop(script);
        self.with(|script| {
            if script.unplugged {
                return Err(gone());
            }
            if script.failing_writes > 0 {
                script.failing_writes -= 1;
                return Err(DeviceError::new(DeviceErrorKind::Timeout));
            }
            script.take(bytes);
            Ok(bytes.len())
        })
    }

    fn read(&self, buffer: &mut [u8], timeout: Duration) -> Result<usize, DeviceError> {
        let found =
            self.with(|script| if script.unplugged { Err(gone()) } else { Ok(script.incoming.pop_front()) })?;
        let Some(bytes) = found else {
            // A thread must not spin; the tests do not wait for real time.
            std::thread::sleep(timeout.min(Duration::from_micros(50)));
            return Err(DeviceError::new(DeviceErrorKind::Timeout));
        };
        let mut len = 0;
        for piece in bytes.chunks(PACKET_LEN - 2) {
            buffer[len..len + 2].copy_from_slice(&[0x01, 0x60]);
            buffer[len + 2..len + 2 + piece.len()].copy_from_slice(piece);
            len += 2 + piece.len();
        }
        Ok(len)
    }
}
