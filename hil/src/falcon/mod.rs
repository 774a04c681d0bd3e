//! Emulated Novint Falcon: the FTDI chip, the board behind it with its boot loader and its firmware, and the grip in a hand.
//!
//! ```text
//! vendor requests, bulk pipes -> chip <- UART -> loader | firmware <- encoders, motors -> grip <- hand
//! ```
//!
//! In: control and bulk transfers as USB carries them, and the time. Out: packets with status bytes, and a record of what the hand felt. Two
//! fronts stand before it: [`MemoryFtdi`] for a driver in the same process, and whatever serves the transfers of a real bus.
//!
//! Written from the protocol's description. No watchdog: the motors go on with the last command, also after the cable was pulled, because the
//! board has a power supply of its own.

pub mod chip;
pub mod descriptors;
pub mod faults;
pub mod firmware;
pub mod grip;
pub mod image;
pub mod kinematics;
pub mod loader;
pub mod memory;

pub use chip::{Chip, Setup, Stall};
pub use faults::FaultyFtdi;
pub use grip::Felt;
pub use image::synthetic_image;
pub use loader::{LoaderFault, LoaderOptions};
pub use memory::MemoryFtdi;

use crate::mechanism::Waypoint;
use chip::WireByte;
use firmware::Firmware;
use grip::Grip;
use image::Image;
use loader::Loader;
use palpate_core::Vec3;
use palpate_host::device::hand::{Drag, HandConfig};

/// Time from the last byte of a request to the first of its reply, ns. Assumed; the wire takes five times as long.
const TURNAROUND_NS: u64 = 20_000;

/// What the device and the hand on it are like.
#[derive(Debug, Clone, PartialEq)]
pub struct FalconConfig {
    /// The hand.
    pub hand: HandConfig,
    /// The mechanism it moves.
    pub drag: Drag,
    /// What the hand does; it begins when the first packet asks for homing.
    pub path: Vec<Waypoint>,
    /// How far the encoders are off before homing, counts.
    pub raw_offset: [i16; 3],
    /// How the boot loader behaves.
    pub loader: LoaderOptions,
    /// The firmware runs already, as after an earlier session.
    pub firmware_runs: bool,
}

impl Default for FalconConfig {
    fn default() -> Self {
        Self {
            hand: HandConfig { persistence: 0.0, tremor_m: 0.0, ..HandConfig::default() },
            // As the profile "falcon" assumes it.
            drag: Drag { mass_kg: 0.15, damping_n_s_m: 1.0, coulomb_n: 0.2 },
            path: homing_path(),
            raw_offset: [1_234, -4_321, 77],
            loader: LoaderOptions::default(),
            firmware_runs: false,
        }
    }
}

/// Pulls the grip out and pushes it in, which homes it, then holds it in the middle of the workspace: done after 1.5 s.
#[must_use]
pub fn homing_path() -> Vec<Waypoint> {
    [(0, 0.115), (400_000, 0.155), (500_000, 0.155), (1_100_000, 0.100), (1_400_000, 0.120)]
        .map(|(t_us, z)| Waypoint { t_us, position_m: [0.0, 0.0, z] })
        .to_vec()
}

/// The device.
#[derive(Debug, Clone)]
pub struct EmulatedFalcon {
    chip: Chip,
    loader: Loader,
    firmware: Option<Firmware>,
    image: Option<Image>,
    grip: Grip,
    raw_offset: [i16; 3],
    buttons: u8,
    now_us: u64,
    plugged: bool,
    /// How often the cable was put in: who has opened the device before has lost it.
    plugs: u64,
}

impl EmulatedFalcon {
    /// A device that was just plugged in, at time 0.
    #[must_use]
    pub fn new(config: FalconConfig) -> Self {
        let FalconConfig { hand, drag, path, raw_offset, loader, firmware_runs } = config;
        let grip = Grip::new(hand, drag, path);
        Self {
            chip: Chip::new(0),
            loader: Loader::new(loader),
            firmware: firmware_runs.then(|| Firmware::new(grip.counts(), raw_offset)),
            image: None,
            grip,
            raw_offset,
            buttons: 0,
            now_us: 0,
            plugged: true,
            plugs: 0,
        }
    }

    /// The time it is at, us.
    #[must_use]
    pub const fn now_us(&self) -> u64 {
        self.now_us
    }

    /// Moves on to a time; one that has passed already changes nothing.
    pub fn advance(&mut self, now_us: u64) {
        self.now_us = self.now_us.max(now_us);
        while let Some(wire) = self.chip.next_for_board(self.now_us * 1_000) {
            self.move_grip(wire.at_ns / 1_000);
            self.hear(wire);
        }
        self.move_grip(self.now_us);
        self.chip.advance(self.now_us);
    }

    fn move_grip(&mut self, until_us: u64) {
        while let Some(counts) = self.grip.step(until_us) {
            if let Some(firmware) = &mut self.firmware {
                firmware.note(counts);
            }
        }
    }

    /// A byte has reached the board.
    fn hear(&mut self, wire: WireByte) {
        let reply_ns = wire.at_ns + TURNAROUND_NS;
        let Some(firmware) = &mut self.firmware else {
            let baud = self.loader.baud();
            let answer = self.loader.take(wire.heard_at(baud));
            self.chip.from_board(reply_ns, &answer.bytes, baud);
            if answer.started.is_some() {
                self.image = answer.started;
                self.firmware = Some(Firmware::new(self.grip.counts(), self.raw_offset));
            }
            return;
        };
        firmware.set_buttons(self.buttons);
        let Some(reply) = firmware.take(wire.heard_at(firmware::BAUD)) else { return };
        self.grip.command(wire.at_ns / 1_000, firmware.motors(), firmware.homed() == [true; 3]);
        if firmware.is_homing() {
            self.grip.begin();
        }
        self.chip.from_board(reply_ns, &reply, firmware::BAUD);
    }

    /// A control transfer.
    pub fn control(&mut self, setup: Setup, data: &[u8]) -> Result<Vec<u8>, Stall> {
        let answer = self.chip.control(setup, data)?;
        if self.loader.lines(self.chip.lines()) {
            self.reset_board();
        }
        Ok(answer)
    }

    /// A transfer from the host: how many bytes there was room for.
    pub fn bulk_out(&mut self, bytes: &[u8]) -> usize {
        self.chip.bulk_out(bytes)
    }

    /// Packets for the host that are ready, at most `max` bytes.
    pub fn bulk_in(&mut self, max: usize) -> Option<Vec<u8>> {
        self.chip.bulk_in(max)
    }

    fn reset_board(&mut self) {
        self.firmware = None;
        self.grip.power_off(self.now_us);
    }

    /// The cable is pulled. Chip and board have power of their own lines: the chip loses its settings, the motors keep their command.
    pub const fn unplug(&mut self) {
        self.plugged = false;
    }

    /// The cable is put in again: another device for whoever had this one open.
    pub fn replug(&mut self) {
        self.chip = Chip::new(self.now_us);
        self.loader.lines(self.chip.lines());
        self.plugged = true;
        self.plugs += 1;
    }

    /// The board loses its power and gets it again: no firmware, no motors, no homing. The cable stays where it is.
    pub fn power_cycle(&mut self) {
        self.loader.restart();
        self.reset_board();
    }

    /// Whether the cable is in.
    #[must_use]
    pub const fn is_plugged(&self) -> bool {
        self.plugged
    }

    /// How often the cable was put in again.
    #[must_use]
    pub const fn plugs(&self) -> u64 {
        self.plugs
    }

    /// An encoder miscounts by so much from now on.
    pub fn jump_encoder(&mut self, axis: usize, counts: i32) {
        if let Some(firmware) = &mut self.firmware {
            firmware.jump(axis, counts);
        }
    }

    /// The firmware forgets its homing and where its encoders stand; what the motors do it does not forget.
    pub fn lose_homing(&mut self) {
        if let Some(firmware) = &mut self.firmware {
            firmware.lose_homing(self.raw_offset);
        }
    }

    /// The hand leaves what it does for another path, whose times count from now.
    pub fn follow(&mut self, path: Vec<Waypoint>) {
        self.grip.follow(path);
    }

    /// The hand holds these buttons: plus, forward, centre, minus from bit 0.
    pub const fn press(&mut self, buttons: u8) {
        self.buttons = buttons;
    }

    /// What the hand felt.
    #[must_use]
    pub const fn felt(&self) -> &Felt {
        self.grip.felt()
    }

    /// Begins the record of what the hand felt anew.
    pub fn forget(&mut self) {
        self.grip.forget();
    }

    /// Where the grip is, m.
    #[must_use]
    pub const fn position_m(&self) -> Vec3 {
        self.grip.position_m()
    }

    /// The boot loader.
    #[must_use]
    pub const fn loader(&self) -> &Loader {
        &self.loader
    }

    /// The firmware, if it runs.
    #[must_use]
    pub const fn firmware(&self) -> Option<&Firmware> {
        self.firmware.as_ref()
    }

    /// The image that was loaded last.
    #[must_use]
    pub const fn image(&self) -> Option<Image> {
        self.image
    }

    /// Whether all three axes are homed.
    #[must_use]
    pub fn is_homed(&self) -> bool {
        self.firmware.as_ref().is_some_and(|firmware| firmware.homed() == [true; 3])
    }

    /// The chip as USB sees it.
    #[must_use]
    pub const fn chip(&self) -> &Chip {
        &self.chip
    }
}
