//! Emulated Novint Falcon: the FTDI chip, the board with its boot loader and firmware, and the grip in a
//! hand.
//!
//! ```text
//! vendor requests, bulk pipes -> chip <- UART -> loader | firmware <- encoders, motors -> grip <- hand
//! ```
//!
//! Input: control and bulk transfers as on USB, and the time. Output: packets with status bytes, and a record
//! of the force on the hand. [`MemoryFtdi`] serves a driver in the same process; [`crate::bench`] serves a
//! real bus.
//!
//! The emulator is written from the protocol's description. It has no watchdog: the motors keep the last
//! command, also after the cable is pulled, because the board has its own power supply.

pub mod chip;
pub mod descriptors;
pub mod faults;
pub mod firmware;
pub mod grip;
pub mod image;
pub mod kinematics;
pub mod loader;
pub mod memory;
pub mod uart;

pub use chip::{Chip, Setup, Stall};
pub use faults::FaultyFtdi;
pub use image::synthetic_image;
pub use loader::{LoaderFault, LoaderOptions};
pub use memory::MemoryFtdi;

use crate::force_record::ForceRecord;
use crate::mechanism::Waypoint;
use firmware::Firmware;
use grip::{Grip, NM_PER_MOTOR_COUNT};
use image::Image;
use loader::Loader;
use palpate_core::Vec3;
use palpate_host::device::hand::{Drag, HandConfig};
use std::time::Duration;
use uart::WireByte;

/// Time from the last byte of a request to the first byte of its reply, ns. This is an assumption; the
/// transfer itself takes five times as long.
const TURNAROUND_NS: u64 = 20_000;

/// Configuration of the device and the hand.
#[derive(Debug, Clone, PartialEq)]
pub struct FalconConfig {
    /// The hand.
    pub hand: HandConfig,
    /// The mechanism.
    pub drag: Drag,
    /// Path of the hand; it starts with the first homing request.
    pub path: Vec<Waypoint>,
    /// Torque of one count of each motor's command, N m.
    pub nm_per_motor_count: [f64; 3],
    /// Offset of the encoders before homing, counts.
    pub raw_offset: [i16; 3],
    /// Options of the boot loader.
    pub loader: LoaderOptions,
    /// The firmware already runs, as after an earlier session.
    pub firmware_runs: bool,
}

impl Default for FalconConfig {
    fn default() -> Self {
        Self {
            hand: HandConfig { persistence: 0.0, tremor_m: 0.0, ..HandConfig::default() },
            // As assumed by the profile "falcon".
            drag: Drag { mass_kg: 0.15, damping_n_s_m: 1.0, coulomb_n: 0.2 },
            path: homing_path(),
            nm_per_motor_count: NM_PER_MOTOR_COUNT,
            raw_offset: [1_234, -4_321, 77],
            loader: LoaderOptions::default(),
            firmware_runs: false,
        }
    }
}

/// Homing motion: pulls the grip out, pushes it in, and holds it in the middle of the workspace. Lasts 1.5 s.
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
    /// How often the cable was plugged in. Handles opened before the last time are lost.
    plug_count: u64,
}

impl EmulatedFalcon {
    /// A device plugged in at time 0.
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
            plug_count: 0,
        }
    }

    /// The present time, us.
    #[must_use]
    pub const fn now_us(&self) -> u64 {
        self.now_us
    }

    /// Advances to a time; an earlier time has no effect.
    pub fn advance(&mut self, now_us: u64) {
        self.now_us = self.now_us.max(now_us);
        while let Some(wire) = self.chip.next_for_board(self.now_us * 1_000) {
            self.move_grip(wire.at_ns / 1_000);
            self.receive_byte(wire);
        }
        self.move_grip(self.now_us);
        self.chip.advance(self.now_us);
    }

    fn move_grip(&mut self, until_us: u64) {
        while let Some(counts) = self.grip.step(until_us) {
            if let Some(firmware) = &mut self.firmware {
                firmware.update(counts);
            }
        }
    }

    /// Handles a byte that has reached the board.
    fn receive_byte(&mut self, wire: WireByte) {
        let reply_ns = wire.at_ns + TURNAROUND_NS;
        let Some(firmware) = &mut self.firmware else {
            let baud = self.loader.baud();
            let answer = self.loader.take(wire.decoded_at(baud));
            self.chip.from_board(reply_ns, &answer.bytes, baud);
            if answer.started.is_some() {
                self.image = answer.started;
                let mut firmware = Firmware::new(self.grip.counts(), self.raw_offset);
                firmware.set_homed([self.loader.fault() == Some(LoaderFault::StartsHomed); 3]);
                self.firmware = Some(firmware);
            }
            return;
        };
        firmware.set_buttons(self.buttons);
        let Some(reply) = firmware.take(wire.decoded_at(firmware::BAUD)) else { return };
        self.grip.command(wire.at_ns / 1_000, firmware.motors(), firmware.homed() == [true; 3]);
        if firmware.is_homing() {
            self.grip.begin();
        }
        self.chip.from_board(reply_ns, &reply, firmware::BAUD);
    }

    /// Handles a control transfer.
    pub fn control(&mut self, setup: Setup, data: &[u8]) -> Result<Vec<u8>, Stall> {
        let answer = self.chip.control(setup, data)?;
        if self.loader.lines(self.chip.lines()) {
            self.reset_board();
        }
        Ok(answer)
    }

    /// A transfer from the host. Returns the number of bytes taken.
    pub fn bulk_out(&mut self, bytes: &[u8]) -> usize {
        self.chip.bulk_out(bytes)
    }

    /// Packets that are ready for the host, at most `max` bytes.
    pub fn bulk_in(&mut self, max: usize) -> Option<Vec<u8>> {
        self.chip.bulk_in(max)
    }

    fn reset_board(&mut self) {
        self.firmware = None;
        self.grip.power_off(self.now_us);
    }

    /// Pulls the cable. The chip is powered by USB and loses its state. The motors keep their command.
    pub fn unplug(&mut self) {
        self.plugged = false;
        self.start_chip();
    }

    /// Plugs the cable in again, as a new device for the host.
    pub fn replug(&mut self) {
        self.plugged = true;
        self.plug_count += 1;
        self.start_chip();
    }

    fn start_chip(&mut self) {
        self.chip = Chip::new(self.now_us);
        self.loader.lines(self.chip.lines());
    }

    /// Sends unsolicited bytes from the board.
    pub fn send_noise(&mut self, bytes: &[u8]) {
        self.chip.from_board(self.now_us * 1_000, bytes, firmware::BAUD);
    }

    /// Power cycle of the board: no firmware, no motor command, no homing. The cable stays in.
    pub fn power_cycle(&mut self) {
        self.loader.restart();
        self.reset_board();
    }

    /// Whether the cable is in.
    #[must_use]
    pub const fn is_plugged(&self) -> bool {
        self.plugged
    }

    /// How often the cable was plugged in again.
    #[must_use]
    pub const fn plug_count(&self) -> u64 {
        self.plug_count
    }

    /// Adds a miscount to an encoder.
    pub fn jump_encoder(&mut self, axis: usize, counts: i32) {
        if let Some(firmware) = &mut self.firmware {
            firmware.jump(axis, counts);
        }
    }

    /// Loses the homing and the encoder offsets of the firmware. The motors keep their command.
    pub fn lose_homing(&mut self) {
        if let Some(firmware) = &mut self.firmware {
            firmware.lose_homing(self.raw_offset);
        }
    }

    /// Sets which axes report that they are homed, and leaves their counts.
    pub const fn set_homed(&mut self, homed: [bool; 3]) {
        if let Some(firmware) = &mut self.firmware {
            firmware.set_homed(homed);
        }
    }

    /// Gives the hand another path; its times count from now.
    pub fn follow(&mut self, path: Vec<Waypoint>) {
        self.grip.follow(path);
    }

    /// Lets hand and grip stand still while no command has arrived for `after`.
    pub const fn freeze_without_commands(&mut self, after: Duration) {
        self.grip.freeze_without_commands(after);
    }

    /// Presses these buttons: plus, forward, centre, minus from bit 0.
    pub const fn press(&mut self, buttons: u8) {
        self.buttons = buttons;
    }

    /// Record of the force on the hand.
    #[must_use]
    pub const fn force_record(&self) -> &ForceRecord {
        self.grip.force_record()
    }

    /// Resets the record of the force on the hand.
    pub fn reset_record(&mut self) {
        self.grip.reset_record();
    }

    /// Position of the grip, m.
    #[must_use]
    pub const fn position_m(&self) -> Vec3 {
        self.grip.position_m()
    }

    /// Counts of the encoder wheels from their indices, with later miscounts.
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

    /// The chip.
    #[must_use]
    pub const fn chip(&self) -> &Chip {
        &self.chip
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Command 100 for the first motor and 0 for the others, with a homing request.
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
        assert!(falcon.force_record().force_n[2] < 0.0, "a positive command pulls the first arm in");
        falcon
    }

    #[test]
    fn a_packet_sets_the_motors_at_its_last_byte() {
        let mut falcon = running();
        falcon.bulk_out(PUSH);
        falcon.advance(106);
        assert_eq!(falcon.force_record().commands, 0);
        falcon.advance(107);
        assert_eq!((falcon.force_record().commands, falcon.force_record().last_command_us), (1, Some(106)));
        assert_eq!(falcon.force_record().largest_motor, 100);
        assert!(falcon.force_record().largest_unhomed_n > 0.0, "and it was not homed");
        assert_eq!(falcon.bulk_in(64), None);
        falcon.advance(234);
        assert_eq!(falcon.bulk_in(64).map(|packet| packet.len()), Some(18));
    }

    #[test]
    fn one_long_time_step_equals_many_short_ones() {
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
        assert_eq!((often.force_record(), often.position_m()), (once.force_record(), once.position_m()));
        assert_eq!(often.bulk_in(512), once.bulk_in(512));
        assert_eq!(once.now_us(), 300_000);
    }

    #[test]
    fn at_a_wrong_rate_the_firmware_receives_noise() {
        let mut falcon = running();
        falcon.control(Setup::vendor(3, 0x15), &[]).expect("a known request");
        falcon.bulk_out(PUSH);
        falcon.advance(10_000);
        assert_eq!(falcon.firmware().map(Firmware::requests), Some(0));
    }

    #[test]
    fn dtr_resets_the_board_and_removes_the_force() {
        let mut falcon = pushed();
        falcon.control(Setup::vendor(1, 0x0101), &[]).expect("a known request");
        assert!(falcon.firmware().is_none());
        assert_eq!(
            (falcon.force_record().force_n, falcon.force_record().off_since_us),
            ([0.0; 3], Some(500))
        );
    }

    #[test]
    fn unplugging_loses_bytes_in_flight_and_keeps_the_force() {
        let mut falcon = pushed();
        falcon.bulk_out(b"<AAAAAAAAAAAABA>");
        falcon.unplug();
        falcon.advance(100_000);
        falcon.replug();
        falcon.advance(200_000);
        assert!(falcon.force_record().force_n[2] < 0.0 && falcon.force_record().off_since_us.is_none());
        assert_eq!(falcon.chip().baud(), 9_600, "the chip was powered up again");
    }

    #[test]
    fn unsolicited_bytes_are_received_like_any_others() {
        let mut falcon = running();
        falcon.send_noise(b"noise>");
        falcon.advance(100);
        assert_eq!(falcon.bulk_in(64), Some(b"\x01\x60noise>".to_vec()));
    }
}
