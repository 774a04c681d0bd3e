//! A scripted chip with a device behind it, for the unit tests of the driver. It has no clock and no motion
//! of its own.

use super::firmware::Image;
use super::ftdi::{Ftdi, PACKET_LEN};
use super::kinematics::{CENTRE_M, Kinematics};
use super::line::Setting;
use super::packet::{self, Reply, Request};
use crate::device::{DeviceError, DeviceErrorKind};
use core::time::Duration;
use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex};

/// State that a test sets and inspects.
#[derive(Debug, Default)]
pub(super) struct Script {
    /// Whether the firmware is loaded.
    pub loaded: bool,
    /// Number of calls that the boot loader ignores.
    pub ignored_calls: u32,
    /// Number of loads with a wrong echo, and the index of the wrong byte in the image.
    pub wrong_echoes: (u32, usize),
    /// Number of loads started.
    pub loads: u32,
    /// The received image.
    pub image: Vec<u8>,
    /// Settings in the order of arrival.
    pub settings: Vec<(u8, u16)>,
    /// Valid requests.
    pub requests: Vec<Request>,
    /// The reply to the next request.
    pub reply: Reply,
    /// Whether replies are held back in `held`.
    pub holds: bool,
    /// Replies held back.
    pub held: Vec<Vec<u8>>,
    /// Whether it stays homed when its firmware is loaded.
    pub keeps_homing: bool,
    /// Whether the cable is unplugged.
    pub unplugged: bool,
    /// Whether its buffer is full: a write blocks until there is room.
    pub stalls: bool,
    /// Number of blocked writes.
    pub stalled: u32,
    /// Number of coming writes that fail.
    pub failing_writes: u32,
    incoming: VecDeque<Vec<u8>>,
    called: Vec<u8>,
}

impl Script {
    /// Queues bytes for the next transfer to the host.
    pub(super) fn queue(&mut self, bytes: &[u8]) {
        self.incoming.push_back(bytes.to_vec());
    }

    /// Releases the held replies.
    pub(super) fn release(&mut self) {
        self.incoming.extend(self.held.drain(..));
    }

    /// Moves the hand.
    pub(super) fn move_hand(&mut self, position_m: [f64; 3]) {
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
            if self.ignored_calls > 0 {
                self.ignored_calls -= 1;
            } else {
                self.queue(b"\0\x0AD,\x0D");
                self.loads += 1;
                self.image.clear();
            }
        }
    }

    fn take_image(&mut self, bytes: &[u8]) {
        if self.image.is_empty() && bytes == b"A" {
            self.queue(b"A");
            self.image.push(b'A');
            return;
        }
        let begins = self.image.len() - 1;
        self.image.extend(bytes);
        // Loading ends the running program and clears its homing.
        self.reply.homed = if self.keeps_homing { packet::ALL_HOMED } else { 0 };
        let mut echo = bytes.to_vec();
        let (loads, at) = self.wrong_echoes;
        if let Some(byte) =
            at.checked_sub(begins).and_then(|at| echo.get_mut(at)).filter(|_| self.loads <= loads)
        {
            *byte ^= 0x10;
        }
        // In two parts, like a UART.
        let (first, second) = echo.split_at(echo.len() / 2);
        self.queue(first);
        self.queue(second);
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
    /// A device in the middle of its workspace, with firmware and not homed.
    pub(super) fn running() -> Arc<Self> {
        Self::of(Script { loaded: true, ..Script::default() })
    }

    /// The same without firmware.
    pub(super) fn silent() -> Arc<Self> {
        Self::of(Script::default())
    }

    fn of(mut script: Script) -> Arc<Self> {
        script.move_hand(CENTRE_M);
        Arc::new(Self { script: Mutex::new(script), room: Condvar::new() })
    }

    /// Homes the device, like its user.
    pub(super) fn home(&self) {
        self.with(|script| script.reply.homed = packet::ALL_HOMED);
    }

    /// Releases the blocked write.
    pub(super) fn make_room(&self) {
        self.with(|script| script.stalls = false);
        self.room.notify_all();
    }

    /// Reads or changes the script.
    pub(super) fn with<R>(&self, act: impl FnOnce(&mut Script) -> R) -> R {
        act(&mut self.script.lock().expect("no test panics within"))
    }

    /// The last request.
    pub(super) fn last(&self) -> Request {
        self.with(|script| *script.requests.last().expect("a request"))
    }
}

/// Longest block of a write: a test that waits for it fails instead of hanging.
pub(super) const STALL: Duration = Duration::from_secs(20);

fn disconnected() -> DeviceError {
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
            if script.unplugged { Err(disconnected()) } else { Ok(()) }
        })
    }

    fn write(&self, bytes: &[u8], timeout: Duration) -> Result<usize, DeviceError> {
        assert!(!timeout.is_zero(), "libusb takes zero as no timeout");
        let mut script = self.script.lock().expect("no test panics within");
        script.stalled += 1;
        // Block longer than the timeout: the tests do not depend on its length.
        let (mut script, _) = self
            .room
            .wait_timeout_while(script, STALL, |script| script.stalls)
            .expect("no test panics within");
        script.stalled -= 1;
        drop(script);
        self.with(|script| {
            if script.unplugged {
                return Err(disconnected());
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
            self.with(
                |script| if script.unplugged { Err(disconnected()) } else { Ok(script.incoming.pop_front()) },
            )?;
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
