//! One session from start to report: the haptic thread, its statistics, and an observer outside.
//!
//! ```text
//! haptic thread -> latest value (triple buffer)   -> Observer::show, 30 Hz
//!               -> bounded queue                  -> statistics, Observer::record
//!               -> bounded queue of the recorder  -> recorder's thread -> file
//! ```
//!
//! The haptic thread waits for none of them. Each queue counts the records that it drops.

mod observer;
mod statistics;
mod summary;

pub use observer::Observer;
pub use statistics::{TouchDisplacement, TouchStatistics};
pub use summary::SessionSummary;

use crate::device::{Device, DeviceInfo};
use crate::doctor::{Probe, SystemInfo};
use crate::instructions::Instructions;
use crate::live::LiveField;
use crate::model::{self, ModelError, TouchMemory};
use crate::rt::thread::spawn;
use crate::rt::{Controls, HapticLoop, LoopConfig, LoopOutcome, MonotonicClock, Outputs, TickRecord};
use crate::sys::{MAX_LOOP_FIFO_PRIORITY, RtReport, RtRequest};
use core::fmt;
use core::sync::atomic::{AtomicBool, Ordering};
use core::time::Duration;
use palpate_core::{Config, Controller, Organ};
use std::sync::{Arc, OnceLock};

/// Longest pause between two drains of the queue.
const DRAIN_PAUSE: Duration = Duration::from_millis(5);

/// Options of a session.
#[derive(Debug, Clone, PartialEq)]
pub struct SessionOptions {
    /// Length of the session; `None` runs until stopped.
    pub seconds: Option<f64>,
    /// Timing of the loop and how it is armed.
    pub haptic: LoopConfig,
    /// Real-time rights to request from the operating system.
    pub real_time: RtRequest,
    /// Records that can wait for the caller. Further records are dropped and counted.
    pub queue_ticks: usize,
    /// Interval after which the next of several organs is rendered.
    pub change_every: Option<Duration>,
    /// What the operating system granted; set before the first tick.
    pub granted: Arc<OnceLock<RtReport>>,
}

impl Default for SessionOptions {
    fn default() -> Self {
        Self {
            seconds: None,
            haptic: LoopConfig::default(),
            real_time: RtRequest::default(),
            // Sixteen seconds: longer than any frame or file write.
            queue_ticks: 16_384,
            change_every: None,
            granted: Arc::default(),
        }
    }
}

/// Reason why a session did not start or failed.
#[derive(Debug)]
pub enum SessionError {
    /// The controller refuses these organs, their combination or the configuration.
    Model(ModelError),
    /// The length is negative or not a number.
    Seconds(f64),
    /// The SCHED_FIFO priority leaves none for the guard.
    Priority(i32),
    /// A thread could not be started.
    Thread(std::io::Error),
    /// The haptic loop panicked. The device received zero force.
    LoopPanicked,
}

impl fmt::Display for SessionError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Model(error) => error.fmt(f),
            Self::Seconds(seconds) => write!(
                f,
                "the length of the session is {seconds} s: give a number of seconds that is not negative"
            ),
            Self::Priority(priority) => write!(
                f,
                "SCHED_FIFO {priority} leaves no priority between the loop and the kernel's 99 for the guard: request at most {MAX_LOOP_FIFO_PRIORITY}"
            ),
            Self::Thread(error) => write!(f, "cannot start the haptic thread: {error}"),
            Self::LoopPanicked => {
                f.write_str("the haptic loop panicked (a defect of this program); the device has zero force")
            }
        }
    }
}

impl core::error::Error for SessionError {}

impl From<ModelError> for SessionError {
    fn from(error: ModelError) -> Self {
        Self::Model(error)
    }
}

impl SessionOptions {
    /// Number of periods of the session. Refuses a length or a priority that no session can have, so a caller
    /// can check the options before it opens the device.
    ///
    /// # Errors
    ///
    /// [`SessionError::Seconds`], [`SessionError::Priority`].
    pub fn periods(&self) -> Result<u64, SessionError> {
        if let Some(priority) = self.real_time.fifo_priority.filter(|p| *p > MAX_LOOP_FIFO_PRIORITY) {
            return Err(SessionError::Priority(priority));
        }
        match self.seconds {
            None => Ok(u64::MAX),
            Some(seconds) if seconds >= 0.0 => {
                Ok((seconds * 1e6 / f64::from(self.haptic.period_us.max(1))).round() as u64)
            }
            Some(seconds) => Err(SessionError::Seconds(seconds)),
        }
    }
}

/// Runs a session: the loop on its own thread, the observer on the calling thread.
///
/// The first organ is rendered until another is selected; all use the same settings. `stop` ends the session
/// from outside (Ctrl-C); the loop reads it in every tick, whatever the calling thread does.
///
/// # Errors
///
/// [`SessionError`]: settings that no session can have are refused before the first tick; a loop that
/// panicked has zeroed the device.
pub fn run_session<D: Device, const N: usize>(
    organs: &[&Organ<'_, N>],
    config: Config,
    device: D,
    options: &SessionOptions,
    stop: &AtomicBool,
    observer: &mut impl Observer,
) -> Result<SessionSummary, SessionError> {
    run(organs, config, None, device, options, stop, observer)
}

/// As [`run_session`], with the jets of a live solver in place of tables. `config` has no method.
///
/// # Errors
///
/// As [`run_session`].
pub fn run_live_session<D: Device, const N: usize>(
    organ: &Organ<'_, N>,
    config: Config,
    jets: LiveField,
    device: D,
    options: &SessionOptions,
    stop: &AtomicBool,
    observer: &mut impl Observer,
) -> Result<SessionSummary, SessionError> {
    run(&[organ], Config { method: None, ..config }, Some(jets), device, options, stop, observer)
}

fn run<D: Device, const N: usize>(
    organs: &[&Organ<'_, N>],
    config: Config,
    jets: Option<LiveField>,
    device: D,
    options: &SessionOptions,
    stop: &AtomicBool,
    observer: &mut impl Observer,
) -> Result<SessionSummary, SessionError> {
    let mut memory = TouchMemory::default();
    let controllers = model::controllers(organs, config, &mut memory)?;
    // The stiffest organ, and the smallest force share of all.
    let stiffest_n_m = controllers.iter().map(Controller::stiffest_n_m).fold(0.0, f32::max);
    let stiffness = (stiffest_n_m, controllers.iter().map(Controller::hand_scale).fold(1.0, f32::min));
    let periods = options.periods()?;
    let info = device.info();
    let (producer, records) = rtrb::RingBuffer::new(options.queue_ticks.max(1));
    let (latest, newest) = triple_buffer::triple_buffer(&TickRecord::EMPTY);
    let controls = observer.controls();
    let ended_here = AtomicBool::new(false);
    let mut watched =
        Watched { observer, records, newest, touch: TouchStatistics::default(), organs: organs.len() };

    let joined = std::thread::scope(|scope| -> Result<_, SessionError> {
        // If this side fails, the loop must end as well, or the scope waits for ever.
        let _end = SetOnDrop(&ended_here);
        let outputs = Outputs { records: producer, latest };
        let (clock, timing) = (MonotonicClock, options.haptic);
        let haptic = match jets {
            None => HapticLoop::with_models(&controllers, device, clock, timing, &controls, outputs),
            Some(jets) => {
                let jets = jets.with_recording(watched.observer.recording_jets());
                HapticLoop::live(controllers[0], jets, device, clock, timing, &controls, outputs)
            }
        };
        let haptic = haptic.with_recording(watched.observer.recording()).with_stop_flag(stop);
        let instructions = haptic.instructions();
        let (real_time, granted) = (options.real_time, &*options.granted);
        let handle = spawn(scope, haptic, real_time, &ended_here, periods, granted);
        let handle = handle.map_err(SessionError::Thread)?;
        while !handle.is_finished() {
            if stop.load(Ordering::Relaxed) {
                ended_here.store(true, Ordering::Relaxed);
            }
            watched.turn(options.change_every, &controls, &ended_here);
        }
        let joined = handle.join().map_err(|_| SessionError::LoopPanicked)?;
        watched.drain();
        Ok((instructions, joined))
    });
    let (instructions, (real_time, outcome)) = joined?;
    Ok(summary(info, instructions, stiffness, real_time, outcome, watched.touch))
}

/// The side of the calling thread.
struct Watched<'o, O> {
    observer: &'o mut O,
    records: rtrb::Consumer<TickRecord>,
    newest: triple_buffer::Output<TickRecord>,
    touch: TouchStatistics,
    organs: usize,
}

impl<O: Observer> Watched<'_, O> {
    /// Drains the queue, changes the organ, and shows a picture if one is due; otherwise it sleeps.
    fn turn(&mut self, change_every: Option<Duration>, controls: &Controls, ended: &AtomicBool) {
        self.drain();
        let record = self.newest.read();
        if let Some(every) = change_every {
            let turns = record.t_us as u128 / every.as_micros().max(1);
            controls.select((turns % self.organs as u128) as u8);
        }
        let wait = self.observer.time_to_frame().min(DRAIN_PAUSE);
        if ended.load(Ordering::Relaxed) {
            // The loop has not seen it yet.
            std::thread::sleep(Duration::from_millis(1));
        } else if !wait.is_zero() {
            std::thread::sleep(wait);
        } else if self.observer.show(record, controls).is_break() {
            ended.store(true, Ordering::Relaxed);
        }
    }

    fn drain(&mut self) {
        while let Ok(record) = self.records.pop() {
            self.touch.add(&record);
            self.observer.record(&record);
        }
    }
}

fn summary(
    device: DeviceInfo,
    instructions: Instructions,
    (stiffest_n_m, force_share): (f32, f32),
    real_time: RtReport,
    outcome: LoopOutcome,
    touch: TouchStatistics,
) -> SessionSummary {
    SessionSummary {
        device,
        instructions,
        stiffest_n_m,
        force_share,
        system: SystemInfo::of(&Probe::system(), real_time.cpu),
        real_time,
        end: outcome.end,
        phase: outcome.phase,
        ticks: outcome.ticks,
        latency: outcome.latency.report(),
        dropped_records: outcome.dropped_records,
        dropped_by_recorder: outcome.dropped_by_recorder,
        device_errors: outcome.device_errors,
        live: outcome.live,
        touch,
    }
}

struct SetOnDrop<'f>(&'f AtomicBool);

impl Drop for SetOnDrop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests;
