//! The Falcon as a device of the loop: opening, homing, exchanging, stopping.
//!
//! An exchange waits neither for a reply nor for a transfer. It takes what has come, and sends the next request once the last one was answered or
//! given up. A sample is stamped with the time its request was sent: it cannot be older, so a link that delivers late cannot pass for a fresh one.
//!
//! Homing counts only if it was done since the device was opened. A board that keeps its power keeps its homing, and nobody has seen what was done
//! to the grip since: it is made to forget, by loading its firmware anew, or it is not opened. Nor does it count after an encoder has miscounted,
//! whatever the board says of it: until the board has forgotten it.
//!
//! Lights: red, not homed (and no force); blue, homed; green, a force is on the motors.
//! The device has no watchdog as far as is known: its motors keep the last command. See [`Device::stop`] and [`Device::emergency_stop`].

use super::config::{FalconConfig, FalconError};
use super::firmware::Image;
use super::ftdi::Ftdi;
use super::intake::{Intake, Tally};
use super::kinematics::{Kinematics, Pose, Solution};
use super::line::Setting;
use super::loader;
use super::motor::MotorConfig;
use super::outlet::{Outlet, WRITE_TIMEOUT, write_whole};
use super::packet::{ALL_HOMED, Lights, Reply, Request};
use super::usb::UsbFtdi;
use crate::device::buttons::Buttons;
use crate::device::motion::{Motion, Verdict};
use crate::device::pending::Pending;
use crate::device::{
    Device, DeviceError, DeviceErrorKind, DeviceInfo, DeviceState, EmergencyStop, wait_homed,
};
use core::fmt;
use core::sync::atomic::{AtomicBool, Ordering};
use core::time::Duration;
use palpate_core::link::DeviceFault;
use palpate_core::{Sample, Vec3};
use std::sync::Arc;

/// Coarsest step of the position, m: 42 to 54 um in x and y, 27 um in z.
const RESOLUTION_M: f32 = 54e-6;
/// How long torques may be held: until the next exchange, and two more on a link that is late, s.
const HELD_S: f64 = 3e-3;
/// Longest wait for a zero to leave when the device is stopped.
const STOP_PATIENCE: Duration = Duration::from_millis(10);
/// How often the last zero is tried where it is refused.
const STOP_TRIES: u32 = 100;
/// Between two of these tries.
const STOP_PAUSE: Duration = Duration::from_millis(1);
/// After this nothing is on its way any more.
const SETTLING: Duration = Duration::from_millis(10);

/// Replies in a row that say that it is not homed, after which it is not and the coordinates are set anew: one may be a damaged packet.
const FORGOTTEN: u32 = 3;

/// What is known of the axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Homing {
    Unknown,
    /// The board says that it is not homed.
    Unhomed {
        /// Replies in a row that said so, up to [`FORGOTTEN`].
        forgotten: u32,
    },
    Homed,
    /// The board says that it is homed, and an encoder has miscounted since: nothing it says is believed until it has lost its homing and was
    /// homed anew.
    Doubted {
        /// Replies in a row that said it has lost it.
        forgotten: u32,
    },
}

/// The device behind a chip.
pub struct Falcon<F: Ftdi + 'static> {
    ftdi: Arc<F>,
    config: FalconConfig,
    motor: MotorConfig,
    intake: Intake,
    outlet: Outlet,
    /// What of it has been looked at.
    seen: Tally,
    pending: Pending,
    kinematics: Kinematics,
    homing: Homing,
    motion: Motion,
    buttons: Buttons,
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
    /// Opens the Falcon on USB; its firmware is loaded if it is silent, or homed already. Blocks for up to some seconds.
    pub fn open(config: FalconConfig, firmware: Option<&Image>) -> Result<Self, FalconError> {
        let chip = UsbFtdi::open().map_err(FalconError::Usb)?;
        Self::start(Arc::new(chip), config, firmware)
    }
}

impl<F: Ftdi + 'static> Falcon<F> {
    /// Brings up the device behind a chip and leaves it with zero force and not homed. Blocks for up to some seconds.
    ///
    /// It asks for no homing, so no axis is homed before the first exchange, and what is homed later was homed by the user of this session.
    pub fn start(ftdi: Arc<F>, config: FalconConfig, firmware: Option<&Image>) -> Result<Self, FalconError> {
        Setting::Reset.apply(&ftdi)?;
        loader::set_normal(&ftdi)?;
        let forgotten = |reply: &Reply| reply.homed & ALL_HOMED == 0;
        match (loader::probe(&ftdi)?, firmware) {
            (Some(reply), _) if forgotten(&reply) => {}
            (_, Some(image)) => {
                let reply = loader::load(&ftdi, image).map_err(FalconError::Load)?;
                if !forgotten(&reply) {
                    return Err(FalconError::HomedBefore);
                }
            }
            (Some(_), None) => return Err(FalconError::HomedBefore),
            (None, None) => return Err(FalconError::NeedsFirmware),
        }
        // Replies to the probe are no answers to what follows.
        loader::set_normal(&ftdi)?;
        let disturbed = Arc::default();
        Ok(Self {
            intake: Intake::start(&ftdi, config.mode)?,
            outlet: Outlet::start(&ftdi, config.mode, &disturbed)?,
            ftdi,
            config,
            motor: config.motor(),
            seen: Tally::default(),
            pending: Pending::default(),
            kinematics: Kinematics::default(),
            homing: Homing::Unknown,
            // Its board cannot start anew and go on counting, as it forgets its firmware: no bound is needed.
            motion: Motion::within(f32::INFINITY),
            buttons: Buttons::default(),
            rendering: false,
            lost: false,
            disturbed,
        })
    }

    /// Waits until the user has homed it, or until `stop`; true if it is homed. Before the loop, whose clock begins anew.
    pub fn home(&mut self, stop: &AtomicBool) -> Result<bool, DeviceError> {
        wait_homed(self, stop)?;
        // What is still open belongs to another time: let it come, and forget it.
        std::thread::sleep(SETTLING);
        self.receive(0)?;
        self.motion.forget();
        self.pending = Pending::default();
        Ok(self.homing == Homing::Homed)
    }

    /// Waits until the newest request has left or was refused once more, or for so long: for a bench whose device must not run ahead of its driver.
    pub fn wait_tried(&mut self, patience: Duration) {
        self.outlet.wait_tried(patience);
    }

    fn lights(&self, rendering: bool) -> Lights {
        let homed = self.homing == Homing::Homed;
        Lights { red: !homed, blue: homed && !rendering, green: homed && rendering }
    }

    /// Motor commands for a force in the model's frame; none before the device is homed, and none without a pose.
    fn commands(&self, now_us: u64, hand_force_n: Vec3) -> [i16; 3] {
        let Some((last_us, _)) = self.motion.last().filter(|_| self.homing == Homing::Homed) else {
            return [0; 3];
        };
        let pose = self.kinematics.pose();
        let ahead = self.ahead(pose, now_us.saturating_sub(last_us));
        self.motor.commands(pose, &ahead, self.config.workspace.to_device_n(hand_force_n))
    }

    /// Where the handle may have come to by the time the next torques replace these; the same pose where its legs would not reach.
    fn ahead(&self, pose: &Pose, age_us: u64) -> Pose {
        let seconds = HELD_S + age_us as f64 * 1e-6;
        let velocity_m_s = self.motion.velocity_m_s();
        let there_m = |axis: usize| pose.position_m[axis] + seconds * f64::from(velocity_m_s[axis]);
        self.kinematics.pose_with(core::array::from_fn(there_m)).unwrap_or(*pose)
    }

    fn send(&mut self, motors: [i16; 3]) -> Result<(), DeviceError> {
        let rendering = motors != [0; 3];
        let homing = self.homing != Homing::Homed;
        let request = Request { motors, homing, lights: self.lights(rendering) };
        let sent = self.outlet.send(&*self.ftdi, request);
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
        for newer in self.outlet.skipped() {
            self.pending.never_left(newer);
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
        let homing = match self.homing {
            // Less than all of it may be a damaged packet, and so may one that says nothing of it.
            Homing::Doubted { .. } if reply.homed & ALL_HOMED != 0 => Homing::Doubted { forgotten: 0 },
            Homing::Doubted { forgotten } if forgotten + 1 < FORGOTTEN => {
                Homing::Doubted { forgotten: forgotten + 1 }
            }
            Homing::Doubted { .. } => Homing::Unhomed { forgotten: FORGOTTEN },
            _ if reply.is_homed() => Homing::Homed,
            Homing::Unhomed { forgotten } => Homing::Unhomed { forgotten: FORGOTTEN.min(forgotten + 1) },
            Homing::Unknown | Homing::Homed => Homing::Unhomed { forgotten: 1 },
        };
        self.set_homing(homing);
    }

    /// Homing sets the coordinates anew: where the hand was is no more. A flag that was damaged does not, and after it the hand is where it was.
    fn set_homing(&mut self, homing: Homing) {
        let is_anew = matches!(homing, Homing::Unhomed { forgotten: FORGOTTEN } | Homing::Doubted { .. });
        if is_anew && homing != self.homing {
            self.motion.forget();
            self.kinematics.reset();
        }
        self.homing = homing;
    }

    /// The sample of a reply; `None` before the device is homed.
    fn sample(&mut self, t_us: u64, now_us: u64, reply: &Reply) -> Result<Option<Sample>, DeviceError> {
        if self.homing != Homing::Homed {
            return Ok(None);
        }
        let before = self.kinematics;
        let solution = self.kinematics.solve(reply.encoders);
        let device_m = self.kinematics.pose().position_m.map(|metres| metres as f32);
        let verdict = self.motion.judge(t_us, now_us, Some(device_m).filter(|_| solution != Solution::Kept));
        if verdict != Verdict::Moved {
            // The force goes on for a few ticks with the Jacobian of where the hand was.
            self.kinematics = before;
        }
        match verdict {
            Verdict::Moved => {}
            Verdict::Refused => return Err(DeviceError::new(DeviceErrorKind::BadFrame)),
            Verdict::Lost => {
                self.set_homing(Homing::Doubted { forgotten: 0 });
                return Err(DeviceError::new(DeviceErrorKind::Faulted(DeviceFault::HomeLost)));
            }
        }
        let position_m = self.config.workspace.to_model_m(device_m);
        Ok(Some(Sample { t_us, position_m, buttons: self.buttons.hear(u32::from(reply.buttons)) }))
    }

    fn exchange_packets(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        let (reply, damaged) = self.receive(now_us)?;
        let unsent = self.outlet.failure();
        if let Some(error) = unsent.filter(|error| !error.kind().is_passing()) {
            return Err(error);
        }
        let sample = reply.map_or(Ok(None), |(t_us, reply)| self.sample(t_us, now_us, &reply));
        if self.disturbed.swap(false, Ordering::Acquire) {
            // Its replies are no answers to ours: silence first.
            self.pending.pause(now_us);
        }
        self.pending.ends_pause(now_us);
        let overdue = self.pending.is_overdue(now_us);
        let motors = self.commands(now_us, hand_force_n);
        // Taking a force away never waits for a pause or for a reply: a fault ends in zero whatever the link does.
        let release = self.rendering && motors == [0; 3];
        let again = motors == [0; 3] && self.pending.may_repeat_zero(now_us);
        if self.pending.may_send(now_us) || release || again {
            // Also one that failed: it may have arrived, and its reply must not pass for that to a later one.
            self.pending.sent(now_us, motors == [0; 3]);
            self.send(motors)?;
        }
        match sample? {
            None if damaged => Err(DeviceError::new(DeviceErrorKind::BadFrame)),
            None if overdue || unsent.is_some() => Err(DeviceError::new(DeviceErrorKind::Timeout)),
            sample => Ok(sample),
        }
    }
}

impl<F: Ftdi + 'static> Device for Falcon<F> {
    fn exchange(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        let result = self.exchange_packets(now_us, hand_force_n);
        self.lost |= result.is_err_and(|error| !error.kind().is_passing());
        result
    }

    fn stop(&mut self) {
        // Twice: should the device be in the middle of a damaged packet, the first one only resynchronises it. A device that is gone cannot
        // be helped, and there is nobody left to tell. The second one goes past the thread, should that hang or have fallen.
        let _ = self.send([0; 3]);
        self.outlet.flush(STOP_PATIENCE);
        let zero = Request { lights: self.lights(false), ..Request::default() };
        for _ in 0..STOP_TRIES {
            match write_whole(&*self.ftdi, &zero, WRITE_TIMEOUT) {
                Err(error) if error.kind().is_passing() => std::thread::sleep(STOP_PAUSE),
                Ok(()) | Err(_) => return,
            }
        }
    }

    fn info(&self) -> DeviceInfo {
        DeviceInfo {
            name: "Novint Falcon on USB".into(),
            self_arming: false,
            max_force_n: self.config.max_force_n,
            max_stiffness_n_m: self.config.max_stiffness_n_m / self.config.workspace.scale,
            resolution_m: RESOLUTION_M * self.config.workspace.scale,
        }
    }

    fn state(&self) -> DeviceState {
        match self.homing {
            _ if self.lost => DeviceState::Disconnected,
            Homing::Unknown => DeviceState::FirmwareLoaded,
            Homing::Unhomed { .. } | Homing::Doubted { .. } => DeviceState::Unhomed,
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
        let first = write_whole(&*self.ftdi, &zero, WRITE_TIMEOUT);
        write_whole(&*self.ftdi, &zero, WRITE_TIMEOUT).and(first)
    }
}

#[cfg(test)]
mod tests;
