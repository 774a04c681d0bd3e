//! The Falcon as a device of the loop: opening, homing, exchanging, stopping.
//!
//! An exchange waits neither for a reply nor for a transfer. It processes what has arrived, and sends the
//! next request after the last one was answered or timed out. The time stamp of a sample is the send time of
//! its request: the sample cannot be older, so a delayed link is detected.
//!
//! Homing is valid only if it was done after the device was opened. A board with power keeps its homing flag,
//! but its grip may have been moved in the meantime: the driver clears the flag by loading the firmware
//! again, or refuses to open the device. Homing is also invalid after an encoder has miscounted, until the
//! board reports that it is not homed.
//!
//! Lights: red, not homed and no force; blue, homed; green, a force is on the motors.
//! No watchdog of the device is known: its motors hold the last command. See [`Device::stop`] and
//! [`Device::guard_path`].

use super::config::{FalconConfig, FalconError};
use super::firmware::Image;
use super::ftdi::Ftdi;
use super::kinematics::{Kinematics, Pose, Solution};
use super::line::Setting;
use super::loader;
use super::motor::MotorConfig;
use super::packet::{ALL_HOMED, Lights, Reply, Request};
use super::reply_reader::{ReplyCounts, ReplyReader};
use super::request_writer::{RequestWriter, WRITE_TIMEOUT, write_whole};
use super::usb::UsbFtdi;
use crate::device::buttons::ButtonDebouncer;
use crate::device::fence::{Fence, GuardPath};
use crate::device::in_flight::{InFlight, Unnumbered};
use crate::device::position_check::{PositionCheck, Verdict};
use crate::device::{Device, DeviceError, DeviceErrorKind, DeviceInfo, DeviceState, wait_homed};
use core::fmt;
use core::sync::atomic::AtomicBool;
use core::time::Duration;
use palpate_core::{Sample, Vec3};
use palpate_link::DeviceFault;
use std::sync::{Arc, OnceLock};

/// Coarsest resolution of the position, m: 42 to 54 um in x and y, 27 um in z.
const RESOLUTION_M: f32 = 54e-6;
/// Time for which torques may be held: until the next exchange, and two more on a delayed link, s.
const COMMAND_HOLD_S: f64 = 3e-3;
/// Longest wait for a zero to be written when the device is stopped.
const STOP_TIMEOUT: Duration = Duration::from_millis(10);
/// Number of attempts to write the last zero.
const STOP_ATTEMPTS: u32 = 100;
/// Pause between two of these attempts.
const STOP_PAUSE: Duration = Duration::from_millis(1);
/// Time after which no transfer is under way.
const SETTLE_TIME: Duration = Duration::from_millis(10);

/// Number of consecutive replies without the homed flags after which the device counts as not homed and the
/// coordinates are reset. A single one may be a damaged packet.
const MIN_UNHOMED_REPLIES: u32 = 3;

/// State of the homing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Homing {
    Unknown,
    /// The board reports that it is not homed.
    Unhomed {
        /// Consecutive replies that reported it, up to [`MIN_UNHOMED_REPLIES`].
        unhomed_replies: u32,
    },
    Homed,
    /// The board reports that it is homed, but an encoder has miscounted since. Its positions are rejected
    /// until it reports a loss of the homing and is homed again.
    Invalid {
        /// Consecutive replies that reported the loss.
        unhomed_replies: u32,
    },
}

/// The device behind a chip.
pub struct Falcon<F: Ftdi + 'static> {
    ftdi: Arc<F>,
    config: FalconConfig,
    motor: MotorConfig,
    reply_reader: ReplyReader,
    request_writer: RequestWriter,
    /// Replies processed so far.
    seen: ReplyCounts,
    pending: Unnumbered,
    kinematics: Kinematics,
    homing: Homing,
    motion: PositionCheck,
    buttons: ButtonDebouncer,
    /// Whether the motors may have a force.
    rendering: bool,
    lost: bool,
    /// The guard's fence, once there is a guard. The writer has it too.
    fence: Arc<OnceLock<Fence>>,
    /// Requests of the guard on this line that are accounted for.
    seen_zeros: u64,
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
    /// Opens the Falcon on USB. Loads its firmware if it does not reply or is already homed. Blocks for up to
    /// a few seconds.
    pub fn open(config: FalconConfig, firmware: Option<&Image>) -> Result<Self, FalconError> {
        let chip = UsbFtdi::open().map_err(FalconError::Usb)?;
        Self::start(Arc::new(chip), config, firmware)
    }
}

impl<F: Ftdi + 'static> Falcon<F> {
    /// Starts the device behind a chip with zero force and without homing. Blocks for up to a few seconds.
    ///
    /// It does not request homing, so no axis is homed before the first exchange: a later homing is by the
    /// user of this session.
    pub fn start(ftdi: Arc<F>, config: FalconConfig, firmware: Option<&Image>) -> Result<Self, FalconError> {
        Setting::Reset.apply(&ftdi)?;
        loader::set_normal(&ftdi)?;
        let unhomed_replies = |reply: &Reply| reply.homed & ALL_HOMED == 0;
        match (loader::probe(&ftdi)?, firmware) {
            (Some(reply), _) if unhomed_replies(&reply) => {}
            (_, Some(image)) => {
                let reply = loader::load(&ftdi, image).map_err(FalconError::Load)?;
                if !unhomed_replies(&reply) {
                    return Err(FalconError::HomedBefore);
                }
            }
            (Some(_), None) => return Err(FalconError::HomedBefore),
            (None, None) => return Err(FalconError::NeedsFirmware),
        }
        // Replies to the probe must not be assigned to later requests.
        loader::set_normal(&ftdi)?;
        let fence = Arc::default();
        Ok(Self {
            reply_reader: ReplyReader::start(&ftdi, config.mode)?,
            request_writer: RequestWriter::start(&ftdi, config.mode, &fence)?,
            ftdi,
            config,
            motor: config.motor(),
            seen: ReplyCounts::default(),
            pending: Unnumbered::default(),
            kinematics: Kinematics::default(),
            homing: Homing::Unknown,
            // The board loses its firmware when it restarts, so its counters cannot restart unnoticed: no
            // bound is needed.
            motion: PositionCheck::with_reach(f32::INFINITY),
            buttons: ButtonDebouncer::default(),
            rendering: false,
            lost: false,
            fence,
            seen_zeros: 0,
        })
    }

    /// Waits until the newest request is written or has failed once more, or for the timeout. For a bench
    /// whose device must not run ahead of its driver.
    pub fn wait_attempted(&mut self, timeout: Duration) {
        self.request_writer.wait_attempted(timeout);
    }

    fn lights(&self, rendering: bool) -> Lights {
        let homed = self.homing == Homing::Homed;
        Lights { red: !homed, blue: homed && !rendering, green: homed && rendering }
    }

    /// Motor commands for a force in the model frame. Zero before the device is homed and without a pose.
    fn commands(&self, now_us: u64, hand_force_n: Vec3) -> [i16; 3] {
        let Some((last_us, _)) = self.motion.last().filter(|_| self.homing == Homing::Homed) else {
            return [0; 3];
        };
        let pose = self.kinematics.pose();
        let ahead = self.predicted_pose(pose, now_us.saturating_sub(last_us));
        self.motor.commands(pose, &ahead, self.config.workspace.to_device_n(hand_force_n))
    }

    /// Pose that the handle may have reached when the next torques replace these; the current pose if its
    /// legs would not reach that far.
    fn predicted_pose(&self, pose: &Pose, age_us: u64) -> Pose {
        let seconds = COMMAND_HOLD_S + age_us as f64 * 1e-6;
        let velocity_m_s = self.motion.velocity_m_s();
        let predicted_m = |axis: usize| pose.position_m[axis] + seconds * f64::from(velocity_m_s[axis]);
        self.kinematics.pose_with(core::array::from_fn(predicted_m)).unwrap_or(*pose)
    }

    fn send(&mut self, motors: [i16; 3]) -> Result<(), DeviceError> {
        let rendering = motors != [0; 3];
        let homing = self.homing != Homing::Homed;
        let request = Request { motors, homing, lights: self.lights(rendering) };
        let sent = self.request_writer.send(&*self.ftdi, request);
        // A failed write may have transmitted a force, so the flag stays set.
        self.rendering = rendering || (self.rendering && sent.is_err());
        sent
    }

    /// Processes what has arrived: the newest reply with the send time of its request, and whether packets
    /// were damaged.
    fn receive(&mut self, now_us: u64) -> Result<(Option<(u64, Reply)>, bool), DeviceError> {
        let counts = self.reply_reader.poll(&*self.ftdi);
        let seen = core::mem::replace(&mut self.seen, counts);
        if let Some(error) = counts.lost {
            return Err(error);
        }
        for newer in self.request_writer.skipped() {
            self.pending.not_transmitted(newer);
        }
        let mut sent_us = None;
        // Assign the valid replies first: if they arrived last, they appear older than they are, but not
        // younger.
        for _ in seen.whole..counts.whole {
            sent_us = self.pending.answered(now_us, false).or(sent_us);
        }
        for _ in seen.damaged..counts.damaged {
            self.pending.answered(now_us, true);
        }
        let new = counts.newest.filter(|_| counts.whole > seen.whole);
        // A reply without a request has an unknown age: its flags are used, its position is not.
        if let Some(reply) = new {
            self.note_homing(&reply);
        }
        Ok((sent_us.zip(new), counts.damaged > seen.damaged))
    }

    fn note_homing(&mut self, reply: &Reply) {
        let homing = match self.homing {
            // A packet with some of the flags may be damaged, and so may one with none.
            Homing::Invalid { .. } if reply.homed & ALL_HOMED != 0 => Homing::Invalid { unhomed_replies: 0 },
            Homing::Invalid { unhomed_replies } if unhomed_replies + 1 < MIN_UNHOMED_REPLIES => {
                Homing::Invalid { unhomed_replies: unhomed_replies + 1 }
            }
            Homing::Invalid { .. } => Homing::Unhomed { unhomed_replies: MIN_UNHOMED_REPLIES },
            _ if reply.is_homed() => Homing::Homed,
            Homing::Unhomed { unhomed_replies } => {
                Homing::Unhomed { unhomed_replies: MIN_UNHOMED_REPLIES.min(unhomed_replies + 1) }
            }
            Homing::Unknown | Homing::Homed => Homing::Unhomed { unhomed_replies: 1 },
        };
        self.set_homing(homing);
    }

    /// Resets the position check and the kinematics when the coordinates change. A single damaged flag
    /// changes nothing.
    fn set_homing(&mut self, homing: Homing) {
        let is_reset = matches!(
            homing,
            Homing::Unhomed { unhomed_replies: MIN_UNHOMED_REPLIES } | Homing::Invalid { .. }
        );
        if is_reset && homing != self.homing {
            self.motion.reset();
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
        let verdict = self.motion.check(t_us, now_us, Some(device_m).filter(|_| solution != Solution::Kept));
        if verdict != Verdict::Accepted {
            // The next forces use the Jacobian of the last accepted pose.
            self.kinematics = before;
        }
        match verdict {
            Verdict::Accepted => {}
            Verdict::Rejected => return Err(DeviceError::new(DeviceErrorKind::BadFrame)),
            Verdict::Lost => {
                self.set_homing(Homing::Invalid { unhomed_replies: 0 });
                return Err(DeviceError::new(DeviceErrorKind::Faulted(DeviceFault::HomeLost)));
            }
        }
        let position_m = self.config.workspace.to_model_m(device_m);
        Ok(Some(Sample {
            t_us,
            position_m,
            buttons: self.buttons.update(now_us, u32::from(reply.buttons)),
            ..Sample::default()
        }))
    }

    /// Writes a zero past the thread, which may hang or have panicked.
    fn write_zero(&self) {
        let zero = Request { lights: self.lights(false), ..Request::default() };
        for _ in 0..STOP_ATTEMPTS {
            match write_whole(&*self.ftdi, &zero, WRITE_TIMEOUT) {
                Err(error) if error.kind().is_transient() => std::thread::sleep(STOP_PAUSE),
                Ok(()) | Err(_) => return,
            }
        }
    }

    fn exchange_packets(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        let (reply, damaged) = self.receive(now_us)?;
        let unsent = self.request_writer.failure(now_us);
        if let Some(error) = unsent.filter(|error| !error.kind().is_transient()) {
            return Err(error);
        }
        let sample = reply.map_or(Ok(None), |(t_us, reply)| self.sample(t_us, now_us, &reply));
        let zeros = self.fence.get().map_or(0, Fence::zeros);
        if core::mem::replace(&mut self.seen_zeros, zeros) != zeros {
            // The replies to the guard's requests must not be assigned to ours: wait for silence.
            self.pending.pause(now_us);
        }
        self.pending.ends_pause(now_us);
        let overdue = self.pending.is_overdue(now_us);
        // The writer looks again before it writes.
        let is_closed = self.fence.get().is_some_and(Fence::is_closed);
        let motors = if is_closed { [0; 3] } else { self.commands(now_us, hand_force_n) };
        // A release never waits for a pause or a reply: a fault ends in zero force, whatever the state of the
        // link.
        let release = self.rendering && motors == [0; 3];
        let repeat = motors == [0; 3] && self.pending.may_repeat_zero(now_us);
        if self.pending.may_send(now_us) || release || repeat {
            // Also count a failed send: it may have arrived, and its reply must not be assigned to a later
            // request.
            self.pending.sent(now_us, motors == [0; 3]);
            self.send(motors)?;
        }
        match sample? {
            None if damaged => Err(DeviceError::new(DeviceErrorKind::BadFrame)),
            None if overdue || unsent.is_some() => {
                Err(unsent.unwrap_or(DeviceError::new(DeviceErrorKind::Timeout)))
            }
            sample => Ok(sample),
        }
    }
}

impl<F: Ftdi + 'static> Device for Falcon<F> {
    fn exchange(&mut self, now_us: u64, hand_force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
        let result = self.exchange_packets(now_us, hand_force_n);
        self.lost |= result.is_err_and(|error| !error.kind().is_transient());
        result
    }

    fn stop(&mut self) {
        // Send it twice: in the middle of a damaged packet the first one only resynchronises the device. If
        // the device is gone, the error cannot be handled here. The second one bypasses the thread, which may
        // hang or have panicked.
        let _ = self.send([0; 3]);
        self.request_writer.flush(STOP_TIMEOUT);
        self.write_zero();
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
            Homing::Unhomed { .. } | Homing::Invalid { .. } => DeviceState::Unhomed,
            Homing::Homed => DeviceState::Homed,
        }
    }

    fn home(&mut self, stop: &AtomicBool) -> Result<bool, DeviceError> {
        wait_homed(self, stop)?;
        // Open requests have times of another clock: let their replies arrive and discard them.
        std::thread::sleep(SETTLE_TIME);
        self.receive(0)?;
        self.motion.reset();
        self.pending = Unnumbered::default();
        Ok(self.homing == Homing::Homed)
    }

    fn guard_path(&mut self, fence: &Fence) -> std::io::Result<Option<GuardPath>> {
        let zero = Request { lights: Lights { red: true, ..Lights::default() }, ..Request::default() };
        // Twice, as in stop().
        fence.set_zero_message(&self.ftdi.guard_message(&zero.encode()).repeat(2));
        self.seen_zeros = fence.zeros();
        // The loop requests the path once.
        let _ = self.fence.set(fence.clone());
        self.ftdi.guard_path()
    }
}

impl<F: Ftdi + 'static> Drop for Falcon<F> {
    fn drop(&mut self) {
        self.stop();
        if !matches!(self.request_writer, RequestWriter::Direct) {
            // The thread may have been in the middle of an older request: zero again after its end.
            self.request_writer = RequestWriter::Direct;
            self.write_zero();
        }
    }
}
