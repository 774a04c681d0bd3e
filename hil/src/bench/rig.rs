//! The emulated Falcon of one run, its hand, and what goes wrong with it.

use super::jump::Jump;
use super::order::{Order, Report};
use super::stepped::control;
use super::strike::Strike;
use crate::falcon::descriptors::PACKET_LEN;
use crate::falcon::firmware::is_whole;
use crate::falcon::memory::Link;
use crate::falcon::{
    EmulatedFalcon, FalconConfig, FaultyFtdi, LoaderFault, LoaderOptions, MemoryFtdi, Setup, Stall,
    homing_path,
};
use crate::fault::Faults;
use crate::mechanism::Waypoint;
use crate::usbredir::UsbDevice;
use palpate_core::vec3;
use palpate_host::device::falcon::Ftdi;
use std::time::Duration;

/// The grip moves on while the guest does, whose time is not real: a tick of the driver's loop for each command.
const HAND_MOVES: Duration = Duration::from_millis(1);
/// The same while it is homed, which no force depends on, and no time of a loop: sooner done.
pub const HOMING_MOVES: Duration = Duration::from_millis(3);
/// How long the cable is out, us: long enough for a guest to notice.
const OUT_US: u64 = 400_000;
/// Bytes of a request that reach the board before the cable is pulled.
const CUT_AT: usize = 7;
/// Enough for them to go over the wire.
const CUT_WAIT: Duration = Duration::from_micros(200);
/// The byte of the firmware that a faulty loader echoes wrong.
const WRONG_AT: usize = 300;
/// Where the hand waits, and where it would be without resistance when it presses, m.
const ABOVE_M: f32 = 0.120;
const BELOW_M: f32 = 0.103;
/// Between the two, us.
const STROKE_US: u64 = 200_000;

/// A device, a hand and a fault.
#[derive(Debug)]
pub struct Rig {
    link: FaultyFtdi<MemoryFtdi>,
    seed: u64,
    strike: Option<Strike>,
    /// Requests that may still pass before it strikes.
    countdown: Option<u64>,
    struck: u64,
    /// It strikes, or has.
    has_begun: bool,
    /// What the motors are to be off for: a fault that comes once; on the wire the first frame it struck since a whole reply went out.
    struck_us: Option<u64>,
    /// Frames struck that have been seen.
    seen: u64,
    stall_in: bool,
    replug_us: Option<u64>,
}

impl Rig {
    /// The device of a run, in real time; its cable is out for a moment.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        let strike = Strike::of(seed);
        let wrong =
            (strike == Some(Strike::WrongEcho)).then_some((LoaderFault::WrongEcho { at: WRONG_AT }, 1));
        let loader = LoaderOptions { leading_zero: seed % 2 == 1, fault: wrong };
        let mut falcon = EmulatedFalcon::new(FalconConfig { loader, ..FalconConfig::default() });
        falcon.stand_without_commands(HOMING_MOVES);
        falcon.unplug();
        Self {
            link: FaultyFtdi::new(MemoryFtdi::in_real_time(falcon), seed),
            seed,
            strike,
            countdown: None,
            struck: 0,
            has_begun: false,
            struck_us: None,
            seen: 0,
            stall_in: false,
            replug_us: Some(OUT_US),
        }
    }

    /// A device whose cable stays out until it is ordered in: pulled while a guest still starts it is lost to that guest for half a minute.
    #[must_use]
    pub fn put_away() -> Self {
        Self { replug_us: None, ..Self::new(0) }
    }

    /// Whether the cable is in.
    #[must_use]
    pub fn is_plugged(&self) -> bool {
        self.link.inner().falcon().is_plugged()
    }

    /// Puts the cable in if it is time.
    pub fn poll(&mut self) {
        if self.replug_us.is_some_and(|due_us| due_us <= self.link.now_us()) {
            self.replug_us = None;
            self.link.replug();
            self.link.reopen().expect("the cable is in");
        }
    }

    /// Does what was asked; the answer is a line.
    pub fn obey(&mut self, order: Order) -> String {
        match order {
            Order::Plug { seed } => *self = Self::new(seed),
            Order::Home => self.moves(homing_path(), HOMING_MOVES),
            Order::Press => self.stroke(BELOW_M),
            Order::Lift => self.stroke(ABOVE_M),
            // Where there is none it is the host that something happens to, now.
            Order::Strike if self.strike.is_none() => self.struck_us = Some(self.link.now_us()),
            Order::Strike => self.countdown = Some(Strike::passes(self.seed)),
            Order::Calm => {
                self.countdown = None;
                self.link.set_faults(Faults::NONE, Faults::NONE);
            }
            Order::Forget => self.link.inner().falcon().forget(),
            Order::Report => return self.report().to_string(),
            Order::End => {}
        }
        "ok".into()
    }

    /// From wherever the grip is, so that it never leaps.
    fn stroke(&self, to_m: f32) {
        let from = Waypoint { t_us: 0, position_m: self.link.inner().falcon().position_m() };
        self.moves(vec![from, Waypoint { t_us: STROKE_US, position_m: [0.0, 0.0, to_m] }], HAND_MOVES);
    }

    fn moves(&self, path: Vec<Waypoint>, each_command: Duration) {
        let mut falcon = self.link.inner().falcon();
        falcon.stand_without_commands(each_command);
        falcon.follow(path);
    }

    /// The truth.
    #[must_use]
    pub fn report(&self) -> Report {
        let falcon = self.link.inner().falcon();
        let felt = falcon.felt();
        let zero_us = self.struck_us.zip(felt.off_since_us).map(|(struck, off)| off.saturating_sub(struck));
        Report {
            plugged: falcon.is_plugged(),
            homed: falcon.is_homed(),
            loads: falcon.loader().tries(),
            requests: falcon.firmware().map_or(0, |firmware| firmware.requests()),
            force_n: vec3::norm(felt.force_n),
            push_n: felt.force_n[2],
            largest_n: felt.largest_force_n,
            step_n: felt.largest_step_n,
            unhomed_n: felt.largest_unhomed_n,
            struck: self.struck + self.on_the_wire(),
            zero_ms: zero_us.map(|us| us as f32 * 1e-3),
        }
    }

    /// Frames that were struck on the wire, and times that it was held up.
    fn on_the_wire(&self) -> u64 {
        let (there, back) = self.link.counts();
        (there + back).total()
    }

    /// A transfer is done, and perhaps a whole reply went out with it. While single frames are struck and others pass, it is not the first of
    /// them that the motors are off for in the end.
    fn note(&mut self, is_whole: bool) {
        let off = self.link.inner().falcon().felt().off_since_us.is_some();
        if !self.strike.is_some_and(Strike::is_on_the_wire) || off {
            return;
        }
        if is_whole {
            self.struck_us = None;
        }
        let struck = self.on_the_wire();
        if struck > core::mem::replace(&mut self.seen, struck) {
            self.struck_us.get_or_insert_with(|| self.link.now_us());
        }
    }

    /// A request is on its way; whether it is struck, and what is then left of it.
    fn struck(&mut self, bytes: &[u8]) -> Option<Result<usize, Stall>> {
        let left = self.countdown.as_mut()?;
        if *left > 0 {
            *left -= 1;
            return None;
        }
        self.countdown = None;
        let strike = self.strike?;
        self.has_begun = true;
        if strike.is_on_the_wire() {
            // What strikes there is counted there.
            let (there, back) = strike.on_the_wire();
            self.link.set_faults(there, back);
            return None;
        }
        self.struck_us = Some(self.link.now_us());
        self.struck += 1;
        match strike {
            Strike::DropRequest => return Some(Ok(bytes.len())),
            Strike::StallOut => return Some(Err(Stall)),
            Strike::StallIn => self.stall_in = true,
            Strike::Homing => self.link.inner().falcon().lose_homing(),
            Strike::PowerCycle => self.link.inner().falcon().power_cycle(),
            Strike::EncoderJump => {
                let mut falcon = self.link.inner().falcon();
                let jump = Jump::of(self.seed, falcon.counts()).expect("the legs reach one way or the other");
                falcon.jump_encoder(jump.axis, jump.counts);
            }
            Strike::UnplugMidFrame | Strike::Replug | Strike::UnplugPower => {
                if strike != Strike::Replug {
                    self.link.inner().falcon().bulk_out(&bytes[..bytes.len().min(CUT_AT)]);
                }
                // What is on the wire arrives.
                std::thread::sleep(CUT_WAIT);
                self.replug_us = Some(self.link.now_us() + OUT_US);
                self.link.unplug();
                if strike == Strike::UnplugPower {
                    self.link.inner().falcon().power_cycle();
                }
                return Some(Ok(0));
            }
            _ => {}
        }
        None
    }
}

impl UsbDevice for Rig {
    fn control(&mut self, setup: Setup, data: &[u8]) -> Result<Vec<u8>, Stall> {
        control(&self.link, setup, data)
    }

    fn bulk_out(&mut self, bytes: &[u8]) -> Result<usize, Stall> {
        if !self.is_plugged() {
            // Nobody is there to say anything, until the bus notices.
            return Ok(0);
        }
        if let Some(outcome) = self.struck(bytes) {
            return outcome;
        }
        if self.has_begun {
            // What the wire does to a frame it does to all of it, room or not.
            let written = self.link.write(bytes, Duration::ZERO).map_err(|_| Stall);
            self.note(false);
            return written;
        }
        Ok(self.link.inner().falcon().bulk_out(bytes))
    }

    fn bulk_in(&mut self, max: usize) -> Result<Option<Vec<u8>>, Stall> {
        if !self.is_plugged() {
            return Ok(None);
        }
        if core::mem::take(&mut self.stall_in) {
            return Err(Stall);
        }
        let mut buffer = vec![0; max];
        debug_assert!(max >= PACKET_LEN);
        let read = self.link.read(&mut buffer, Duration::ZERO);
        if self.strike == Some(Strike::DropReply) && self.link.counts().1.dropped > 0 {
            // One is enough.
            self.link.set_faults(Faults::NONE, Faults::NONE);
        }
        match read {
            Ok(count) => {
                buffer.truncate(count);
                self.note(is_whole(&buffer));
                Ok(Some(buffer))
            }
            Err(error) if error.kind().is_transient() => Ok(None),
            Err(_) => Err(Stall),
        }
    }
}
