//! The Falcon as a device of the loop: opening, homing, exchanging, stopping.
//!
//! An exchange never waits for a reply. It takes what has come, and sends the next request once the last one was answered or given up. A
//! sample is stamped with the time its request was sent: it cannot be older, so a link that delivers late cannot pass for a fresh one.
//!
//! Lights: red, not homed (and no force); blue, homed; green, a force is on the motors.
//! The device has no watchdog as far as is known: its motors keep the last command. See [`Device::stop`] and [`Device::emergency_stop`].

use super::firmware::Image;
use super::ftdi::Ftdi;
use super::intake::{Intake, Mode, Tally};
use super::kinematics::{Kinematics, Solution};
use super::line::Setting;
use super::loader::{self, LoadError};
use super::motor::MotorConfig;
use super::packet::{Lights, Reply, Request};
use super::usb::{UsbError, UsbFtdi};
use crate::device::pending::Pending;
use crate::device::workspace::Workspace;
use crate::device::{Device, DeviceError, DeviceErrorKind, DeviceInfo, DeviceState, EmergencyStop};
use core::fmt;
use core::sync::atomic::{AtomicBool, Ordering};
use core::time::Duration;
use palpate_core::{Sample, Vec3, vec3};
use std::sync::Arc;
use std::time::Instant;

/// Longest wait for a request to leave; a healthy link takes a tenth of a millisecond.
const WRITE_TIMEOUT: Duration = Duration::from_millis(2);
/// Largest stiffness as long as nobody has measured the mechanism's damping, N/m.
const MAX_STIFFNESS_N_M: f32 = 1_000.0;
/// Coarsest step of the position, m: 42 to 54 um in x and y, 27 um in z.
const RESOLUTION_M: f32 = 54e-6;
/// Fastest that a hand moves the grip, m/s: a jump beyond it is a miscounted encoder or a damaged packet that looks whole.
const FASTEST_M_S: f32 = 3.0;
/// What it may jump in no time, m: requests are stamped within a tick.
const JUMP_M: f32 = 2e-3;
/// Pause between two exchanges while the user homes it.
const HOMING_PAUSE: Duration = Duration::from_millis(1);

/// After this nothing is on its way any more.
const SETTLING: Duration = Duration::from_millis(10);

/// How to use the device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FalconConfig {
    /// Where the device's workspace lies in the model.
    pub workspace: Workspace,
    /// Largest force of the mechanism, N.
    pub max_force_n: f32,
    /// Motor counts to one N m at a crank, with its sign (`MotorConfig`).
    pub counts_per_n_m: f64,
    /// Force up that carries the weight of the grip, N; comes and goes with the force.
    pub gravity_n: f64,
    /// How replies are read.
    pub mode: Mode,
}

impl Default for FalconConfig {
    fn default() -> Self {
        let MotorConfig { counts_per_n_m, gravity_n, max_force_n } = MotorConfig::default();
        Self {
            workspace: Workspace::default(),
            max_force_n: max_force_n as f32,
            counts_per_n_m,
            gravity_n,
            mode: Mode::Threaded { fifo_priority: None },
        }
    }
}

impl FalconConfig {
    fn motor(&self) -> MotorConfig {
        MotorConfig {
            counts_per_n_m: self.counts_per_n_m,
            gravity_n: self.gravity_n,
            max_force_n: self.max_force_n.into(),
        }
    }
}

/// Why the device cannot be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FalconError {
    /// No chip to talk to.
    Usb(UsbError),
    /// The link failed.
    Device(DeviceError),
    /// Silent, and no firmware was given.
    NeedsFirmware,
    /// The firmware could not be loaded.
    Load(LoadError),
}

impl fmt::Display for FalconError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Usb(error) => error.fmt(f),
            Self::Device(error) => write!(f, "{error}; check the cable and connect the device again"),
            Self::NeedsFirmware => f.write_str(
                "the Falcon is silent: it has forgotten its firmware; give the file with falcon:FIRMWARE (docs/devices.md)",
            ),
            Self::Load(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for FalconError {}

impl From<DeviceError> for FalconError {
    fn from(error: DeviceError) -> Self {
        Self::Device(error)
    }
}

/// What is known of the axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Homing {
    Unknown,
    Unhomed,
    Homed,
}

/// The device behind a chip.
pub struct Falcon<F: Ftdi + 'static> {
    ftdi: Arc<F>,
    config: FalconConfig,
    motor: MotorConfig,
    intake: Intake,
    /// What of it has been looked at.
    seen: Tally,
    pending: Pending,
    kinematics: Kinematics,
    homing: Homing,
    /// When and where the last sample was, device frame.
    last: Option<(u64, Vec3)>,
    /// The motors may still have a force of ours.
    rendering: bool,
    lost: bool,
    /// Somebody else has sent a request on this line.
    disturbed: Arc<AtomicBool>,
}

impl<F: Ftdi + 'static> fmt::Debug for Falcon<F> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Falcon")
            .field("config", &self.config)
            .field("homing", &self.homing)
            .finish_non_exhaustive()
    }
}

impl Falcon<UsbFtdi> {
    /// Opens the Falcon on USB; its firmware is loaded if it is silent. Blocks for up to some seconds.
    pub fn open(config: FalconConfig, firmware: Option<&Image>) -> Result<Self, FalconError> {
        let chip = UsbFtdi::open().map_err(FalconError::Usb)?;
        Self::start(Arc::new(chip), config, firmware)
    }
}

impl<F: Ftdi + 'static> Falcon<F> {
    /// Brings up the device behind a chip and leaves it with zero force. Blocks for up to some seconds.
    pub fn start(ftdi: Arc<F>, config: FalconConfig, firmware: Option<&Image>) -> Result<Self, FalconError> {
        Setting::Reset.apply(&ftdi)?;
        loader::set_normal(&ftdi)?;
        if loader::probe(&ftdi)?.is_none() {
            let image = firmware.ok_or(FalconError::NeedsFirmware)?;
            loader::load(&ftdi, image).map_err(FalconError::Load)?;
        }
        // Replies to the probe are no answers to what follows.
        loader::set_normal(&ftdi)?;
        Ok(Self {
            intake: Intake::start(&ftdi, config.mode)?,
            ftdi,
            config,
            motor: config.motor(),
            seen: Tally::default(),
            pending: Pending::default(),
            kinematics: Kinematics::default(),
            homing: Homing::Unknown,
            last: None,
            rendering: false,
            lost: false,
            disturbed: Arc::default(),
        })
    }

    /// Waits until the user has homed it, or until `stop`; true if it is homed. Before the loop, whose clock begins anew.
    pub fn home(&mut self, stop: &AtomicBool) -> Result<bool, DeviceError> {
        let begun = Instant::now();
        while self.homing != Homing::Homed && !stop.load(Ordering::Relaxed) {
            match self.exchange(begun.elapsed().as_micros() as u64, [0.0; 3]) {
                Err(error) if !error.kind().is_passing() => return Err(error),
                _ => std::thread::sleep(HOMING_PAUSE),
            }
        }
        // What is still open belongs to another time: let it come, and forget it.
        std::thread::sleep(SETTLING);
        self.receive(0)?;
        self.last = None;
        self.pending = Pending::default();
        Ok(self.homing == Homing::Homed)
    }

    fn lights(&self, rendering: bool) -> Lights {
        let homed = self.homing == Homing::Homed;
        Lights { red: !homed, blue: homed && !rendering, green: homed && rendering }
    }

    /// Motor commands for a force in the model's frame; none before the device is homed, and none without a pose.
    fn commands(&self, hand_force_n: Vec3) -> [i16; 3] {
        if self.homing != Homing::Homed || self.last.is_none() {
            return [0; 3];
        }
        self.motor.commands(self.kinematics.pose(), self.config.workspace.to_device_n(hand_force_n))
    }

    fn send(&mut self, motors: [i16; 3]) -> Result<(), DeviceError> {
        let rendering = motors != [0; 3];
        let homing = self.homing != Homing::Homed;
        let request = Request { motors, homing, lights: self.lights(rendering) };
        let sent = write_whole(&*self.ftdi, &request);
        // What may have gone is taken away again.
        self.rendering = rendering || (self.rendering && sent.is_err());
        sent
    }

    /// Takes what has come since the last look: the newest reply with the time its request was sent, and whether something was damaged.
    fn receive(&mut self, now_us: u64) -> Result<(Option<(u64, Reply)>, bool), DeviceError> {
        let tally = self.intake.look(&*self.ftdi);
        let seen = core::mem::replace(&mut self.seen, tally);
        if let Some(error) = tally.lost {
            return Err(error);
        }
        let mut sent_us = None;
        // The good ones first: if they came last they look older than they are, and never younger.
        for _ in seen.whole..tally.whole {
            sent_us = self.pending.answered(now_us, false).or(sent_us);
        }
        for _ in seen.damaged..tally.damaged {
            self.pending.answered(now_us, true);
        }
        let new = tally.newest.filter(|_| tally.whole > seen.whole);
        // A reply that nothing asked for is of no known age: its flags count, its position does not.
        if let Some(reply) = new {
            self.note_homing(&reply);
        }
        Ok((sent_us.zip(new), tally.damaged > seen.damaged))
    }

    fn note_homing(&mut self, reply: &Reply) {
        let homing = if reply.is_homed() { Homing::Homed } else { Homing::Unhomed };
        if homing != self.homing {
            // Homing sets the coordinates anew.
            self.homing = homing;
            self.last = None;
            self.kinematics.reset();
        }
    }

    /// The sample of a reply; `None` before the device is homed.
    fn sample(&mut self, t_us: u64, reply: &Reply) -> Result<Option<Sample>, DeviceError> {
        if !reply.is_homed() {
            return Ok(None);
        }
        let before = self.kinematics;
        let solution = self.kinematics.solve(reply.encoders);
        let device_m = self.kinematics.pose().position_m.map(|metres| metres as f32);
        let jumps = self.last.is_some_and(|(last_us, last_m)| {
            let seconds = t_us.saturating_sub(last_us) as f32 * 1e-6;
            vec3::distance(device_m, last_m) > JUMP_M + FASTEST_M_S * seconds
        });
        if solution == Solution::Kept || jumps {
            // The force goes on for a few ticks with the Jacobian of where the hand was.
            self.kinematics = before;
            return Err(DeviceError::new(DeviceErrorKind::BadFrame));
        }
        self.last = Some((t_us, device_m));
        let position_m = self.config.workspace.to_model_m(device_m);
        Ok(Some(Sample { t_us, position_m, buttons: u32::from(reply.buttons) }))
    }

    fn exchange_packets(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        let (reply, damaged) = self.receive(now_us)?;
        let sample = reply.map_or(Ok(None), |(t_us, reply)| self.sample(t_us, &reply));
        if self.disturbed.swap(false, Ordering::Acquire) {
            // Its replies are no answers to ours: silence first.
            self.pending.pause(now_us);
        }
        self.pending.ends_pause(now_us);
        let overdue = self.pending.is_overdue(now_us);
        let motors = self.commands(hand_force_n);
        // Taking a force away never waits for a pause or for a reply: a fault ends in zero whatever the link does.
        let release = self.rendering && motors == [0; 3];
        if self.pending.may_send(now_us) || release {
            // Also one that failed: it may have arrived, and its reply must not pass for that to a later one.
            self.pending.sent(now_us);
            self.send(motors)?;
        }
        match sample? {
            None if damaged => Err(DeviceError::new(DeviceErrorKind::BadFrame)),
            None if overdue => Err(DeviceError::new(DeviceErrorKind::Timeout)),
            sample => Ok(sample),
        }
    }
}

/// Sends a request in one piece: what is cut the device throws away.
fn write_whole(ftdi: &impl Ftdi, request: &Request) -> Result<(), DeviceError> {
    let packet = request.encode();
    if ftdi.write(&packet, WRITE_TIMEOUT)? < packet.len() {
        return Err(DeviceError::new(DeviceErrorKind::Timeout));
    }
    Ok(())
}

impl<F: Ftdi + 'static> Device for Falcon<F> {
    fn exchange(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        let result = self.exchange_packets(now_us, hand_force_n);
        self.lost |= result.is_err_and(|error| !error.kind().is_passing());
        result
    }

    fn stop(&mut self) {
        // Twice: should the device be in the middle of a damaged packet, the first one only resynchronises it. A device that is gone cannot
        // be helped, and there is nobody left to tell.
        for _ in 0..2 {
            let _ = self.send([0; 3]);
        }
    }

    fn info(&self) -> DeviceInfo {
        DeviceInfo {
            name: "Novint Falcon on USB".into(),
            self_arming: false,
            max_force_n: self.config.max_force_n,
            max_stiffness_n_m: MAX_STIFFNESS_N_M / self.config.workspace.scale,
            resolution_m: RESOLUTION_M * self.config.workspace.scale,
        }
    }

    fn state(&self) -> DeviceState {
        match self.homing {
            _ if self.lost => DeviceState::Disconnected,
            Homing::Unknown => DeviceState::FirmwareLoaded,
            Homing::Unhomed => DeviceState::Unhomed,
            Homing::Homed => DeviceState::Homed,
        }
    }

    fn emergency_stop(&mut self) -> Option<Box<dyn EmergencyStop>> {
        Some(Box::new(SecondHandle { ftdi: Arc::clone(&self.ftdi), disturbed: Arc::clone(&self.disturbed) }))
    }
}

impl<F: Ftdi + 'static> Drop for Falcon<F> {
    fn drop(&mut self) {
        self.stop();
    }
}

/// The same chip from another thread. libusb does not mix the bytes of two transfers.
struct SecondHandle<F: Ftdi> {
    ftdi: Arc<F>,
    disturbed: Arc<AtomicBool>,
}

impl<F: Ftdi> EmergencyStop for SecondHandle<F> {
    fn zero(&mut self) -> Result<(), DeviceError> {
        self.disturbed.store(true, Ordering::Release);
        let zero = Request { lights: Lights { red: true, ..Lights::default() }, ..Request::default() };
        // Twice, as in stop().
        let first = write_whole(&*self.ftdi, &zero);
        write_whole(&*self.ftdi, &zero).and(first)
    }
}

#[cfg(test)]
mod tests;
