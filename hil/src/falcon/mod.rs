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
pub mod socket;
pub mod uart;

pub use chip::{Chip, Setup, Stall};
pub use faults::FaultyFtdi;
pub use image::synthetic_image;
pub use loader::{LoaderFault, LoaderOptions};
pub use memory::MemoryFtdi;

use crate::felt::Felt;
use crate::mechanism::Waypoint;
use firmware::Firmware;
use grip::{Grip, NM_PER_MOTOR_COUNT};
use image::Image;
use loader::Loader;
use palpate_core::Vec3;
use palpate_host::device::hand::{Drag, HandConfig};
use std::time::Duration;
use uart::WireByte;

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
    /// Torque of one count of each motor's command, N m.
    pub nm_per_motor_count: [f64; 3],
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
            nm_per_motor_count: NM_PER_MOTOR_COUNT,
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
        let FalconConfig { hand, drag, path, nm_per_motor_count, raw_offset, loader, firmware_runs } = config;
        let grip = Grip::new(hand, drag, path).with_motors(nm_per_motor_count);
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

    /// The cable is pulled. The chip had its power from there: it forgets what it held. The motors keep their command.
    pub fn unplug(&mut self) {
        self.plugged = false;
        self.start_chip();
    }

    /// The cable is put in again: another device for whoever had this one open.
    pub fn replug(&mut self) {
        self.plugged = true;
        self.plugs += 1;
        self.start_chip();
    }

    fn start_chip(&mut self) {
        self.chip = Chip::new(self.now_us);
        self.loader.lines(self.chip.lines());
    }

    /// The board sends bytes that nobody asked for.
    pub fn babble(&mut self, bytes: &[u8]) {
        self.chip.from_board(self.now_us * 1_000, bytes, firmware::BAUD);
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

    /// From now on hand and grip stand still while no command has come for so long.
    pub const fn stand_without_commands(&mut self, after: Duration) {
        self.grip.stand_without_commands(after);
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

    /// What the wheels of the encoders stand at, from their indices, and what was miscounted since.
    #[must_use]
    pub fn counts(&self) -> [i32; 3] {
        let miscounted = self.firmware.as_ref().map_or([0; 3], Firmware::miscounted);
        let counts = self.grip.counts();
        core::array::from_fn(|axis| counts[axis] + miscounted[axis])
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Zero for the motors but 100 for the first, homing.
    const PUSH: &[u8; 16] = b"<EGAAAAAAAAAABA>";

    fn running() -> EmulatedFalcon {
        let mut falcon = EmulatedFalcon::new(FalconConfig { firmware_runs: true, ..FalconConfig::default() });
        for (request, value) in [(3, 2), (9, 1), (6, 0x013e)] {
            falcon.control(Setup::vendor(request, value), &[]).expect("a known request");
        }
        falcon
    }

    fn pushed() -> EmulatedFalcon {
        let mut falcon = running();
        assert_eq!(falcon.bulk_out(PUSH), 16);
        falcon.advance(500);
        assert!(falcon.felt().force_n[2] < 0.0, "a positive command pulls the first arm in");
        falcon
    }

    #[test]
    fn a_packet_sets_the_motors_when_its_last_byte_is_there() {
        let mut falcon = running();
        falcon.bulk_out(PUSH);
        falcon.advance(106);
        assert_eq!(falcon.felt().commands, 0);
        falcon.advance(107);
        assert_eq!((falcon.felt().commands, falcon.felt().last_command_us), (1, Some(106)));
        assert_eq!(falcon.felt().largest_motor, 100);
        assert!(falcon.felt().largest_unhomed_n > 0.0, "and it was not homed");
        assert_eq!(falcon.bulk_in(64), None);
        falcon.advance(234);
        assert_eq!(falcon.bulk_in(64).map(|packet| packet.len()), Some(18));
    }

    #[test]
    fn one_long_step_of_time_is_as_good_as_many() {
        let (mut often, mut once) = (running(), running());
        for falcon in [&mut often, &mut once] {
            falcon.bulk_out(PUSH);
        }
        for us in 0..300_000 {
            often.advance(us);
        }
        often.advance(300_000);
        once.advance(300_000);
        once.advance(200_000);
        assert_eq!((often.felt(), often.position_m()), (once.felt(), once.position_m()));
        assert_eq!(often.bulk_in(512), once.bulk_in(512));
        assert_eq!(once.now_us(), 300_000);
    }

    #[test]
    fn at_another_rate_the_firmware_hears_noise() {
        let mut falcon = running();
        falcon.control(Setup::vendor(3, 0x15), &[]).expect("a known request");
        falcon.bulk_out(PUSH);
        falcon.advance(10_000);
        assert_eq!(falcon.firmware().map(Firmware::requests), Some(0));
    }

    #[test]
    fn dtr_resets_the_board_and_takes_the_force_away() {
        let mut falcon = pushed();
        falcon.control(Setup::vendor(1, 0x0101), &[]).expect("a known request");
        assert!(falcon.firmware().is_none());
        assert_eq!((falcon.felt().force_n, falcon.felt().off_since_us), ([0.0; 3], Some(500)));
    }

    #[test]
    fn what_was_on_its_way_is_lost_with_the_cable_and_the_force_is_not() {
        let mut falcon = pushed();
        falcon.bulk_out(b"<AAAAAAAAAAAABA>");
        falcon.unplug();
        falcon.advance(100_000);
        falcon.replug();
        falcon.advance(200_000);
        assert!(falcon.felt().force_n[2] < 0.0 && falcon.felt().off_since_us.is_none());
        assert_eq!(falcon.chip().baud(), 9_600, "a chip with new power");
    }

    #[test]
    fn babble_comes_in_as_any_other_bytes() {
        let mut falcon = running();
        falcon.babble(b"noise>");
        falcon.advance(100);
        assert_eq!(falcon.bulk_in(64), Some(b"\x01\x60noise>".to_vec()));
    }
}
