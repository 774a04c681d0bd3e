//! One session from start to report: haptic thread, viewer and record stream together.

use crate::device::{Device, DeviceInfo};
use crate::instructions::Instructions;
use crate::rt::thread::spawn;
use crate::rt::{
    Controls, HapticLoop, LatencyReport, LoopConfig, LoopEnd, LoopOutcome, MonotonicClock, Outputs,
    TickRecord,
};
use crate::sys::{RtReport, RtRequest};
use crate::viewer::screen::DRAIN_PAUSE;
use crate::viewer::{Live, ViewerError};
use core::fmt;
use core::sync::atomic::{AtomicBool, Ordering};
use palpate_core::controller::ControllerError;
use palpate_core::{Config, Controller, Coverage, Organ, Phase, vec3};

pub(crate) use crate::viewer::screen::Screen;
pub use crate::viewer::screen::View;

/// How a session runs.
#[derive(Debug, Clone, PartialEq)]
pub struct SessionOptions {
    /// Length of the session; `None` runs until stopped.
    pub seconds: Option<f64>,
    /// Timing of the loop and how it is armed.
    pub haptic: LoopConfig,
    /// What to ask of the operating system.
    pub real_time: RtRequest,
    /// Records that may wait for the caller; the rest are dropped and counted.
    pub queue_ticks: usize,
    /// What to show.
    pub view: View,
}

impl Default for SessionOptions {
    fn default() -> Self {
        Self {
            seconds: None,
            haptic: LoopConfig::default(),
            real_time: RtRequest::default(),
            // Sixteen seconds: longer than any frame or file write.
            queue_ticks: 16_384,
            view: View::Nothing,
        }
    }
}

/// Why a session did not come about or did not end well.
#[derive(Debug)]
pub enum SessionError {
    /// The controller refused organ or configuration.
    Controller(ControllerError),
    /// The length is negative or not a number.
    Seconds(f64),
    /// Nothing to show on, or a frame was not written.
    Viewer(ViewerError),
    /// No thread could be started.
    Thread(std::io::Error),
    /// The haptic loop panicked; the device was given zero force on the way out.
    LoopPanicked,
}

impl fmt::Display for SessionError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Controller(error) => error.fmt(f),
            Self::Seconds(seconds) => write!(f, "{seconds} is no length for a session, in seconds"),
            Self::Viewer(error) => error.fmt(f),
            Self::Thread(error) => write!(f, "cannot start the haptic thread: {error}"),
            Self::LoopPanicked => {
                f.write_str("the haptic loop panicked (a fault of this program); the device has zero force")
            }
        }
    }
}

impl core::error::Error for SessionError {}

impl From<ControllerError> for SessionError {
    fn from(error: ControllerError) -> Self {
        Self::Controller(error)
    }
}

impl From<ViewerError> for SessionError {
    fn from(error: ViewerError) -> Self {
        Self::Viewer(error)
    }
}

/// Largest values and counts over the records that reached the caller.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct TouchFigures {
    /// Largest |h| of the model, N.
    pub peak_reaction_n: f32,
    /// Largest force for the hand, N.
    pub peak_hand_force_n: f32,
    /// Largest displacement of an active node, m.
    pub peak_displacement_m: f32,
    /// Times the tool touched.
    pub contacts: u64,
    /// Ticks in touch.
    pub engaged_ticks: u64,
    /// Ticks in touch by coverage, in the order of `Coverage::ALL`.
    pub coverage_ticks: [u64; Coverage::ALL.len()],
    /// Ticks in which the force limit cut the force.
    pub clamped_ticks: u64,
    engaged_before: bool,
}

impl TouchFigures {
    /// Takes one record, in order.
    pub fn take(&mut self, record: &TickRecord) {
        self.peak_reaction_n = self.peak_reaction_n.max(vec3::norm(record.reaction_n));
        self.peak_hand_force_n = self.peak_hand_force_n.max(vec3::norm(record.hand_force_n));
        self.peak_displacement_m = self.peak_displacement_m.max(vec3::norm(record.displacement_m));
        let engaged = record.engaged.is_some();
        self.contacts += u64::from(engaged && !self.engaged_before);
        self.engaged_before = engaged;
        self.engaged_ticks += u64::from(engaged);
        self.clamped_ticks += u64::from(record.clamped);
        let kinds = Coverage::ALL.iter().zip(&mut self.coverage_ticks);
        for (_, ticks) in kinds.filter(|(kind, _)| record.coverage == Some(**kind)) {
            *ticks += 1;
        }
    }
}

/// What a session came to.
#[derive(Debug, Clone, PartialEq)]
pub struct SessionSummary {
    /// The device.
    pub device: DeviceInfo,
    /// The instructions the force was interpolated with.
    pub instructions: Instructions,
    /// Largest stiffness of the organ as the hand would feel it, N/m.
    pub stiffest_n_m: f32,
    /// What every force was scaled by to stay within the device's stiffness; 1 where nothing had to be.
    pub force_share: f32,
    /// What the operating system granted.
    pub real_time: RtReport,
    /// Why it ended.
    pub end: LoopEnd,
    /// Phase at the end.
    pub phase: Phase,
    /// Ticks that ran.
    pub ticks: u64,
    /// Timing.
    pub latency: LatencyReport,
    /// Records that did not fit into the queue.
    pub dropped_records: u64,
    /// Exchanges that failed in passing.
    pub device_errors: u64,
    /// Forces, displacements, contacts.
    pub touch: TouchFigures,
    /// Frames written.
    pub frames_written: u64,
    /// Mean time to draw a frame, ms; 0 without frames.
    pub mean_frame_ms: f32,
}

impl SessionSummary {
    /// Share of the ticks in touch by the data behind their force.
    fn write_coverage(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "\ncoverage    ")?;
        for (kind, ticks) in Coverage::ALL.iter().zip(self.touch.coverage_ticks) {
            if ticks > 0 {
                let share = 100.0 * ticks as f64 / self.touch.engaged_ticks as f64;
                write!(f, " {} {share:.1} %", kind.name())?;
            }
        }
        Ok(())
    }
}

impl fmt::Display for SessionSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "device       {}", self.device.name)?;
        writeln!(f, "instructions {}", self.instructions)?;
        write!(f, "stiffness    up to {:.0} N/m", self.stiffest_n_m)?;
        if self.force_share < 1.0 {
            let cap_n_m = self.force_share * self.stiffest_n_m;
            write!(
                f,
                ", held to {cap_n_m:.0} N/m: all forces times {:.2}, the organ feels softer",
                self.force_share
            )?;
        }
        writeln!(f)?;
        writeln!(f, "{}", self.real_time)?;
        writeln!(f, "{}", self.latency)?;
        let touch = &self.touch;
        write!(
            f,
            "touch        {} contacts, {:.1} % of the ticks; peak force {:.2} N on the body, {:.2} N for the hand; \
             peak displacement {:.1} mm",
            touch.contacts,
            100.0 * touch.engaged_ticks as f64 / self.ticks.max(1) as f64,
            touch.peak_reaction_n,
            touch.peak_hand_force_n,
            touch.peak_displacement_m * 1e3
        )?;
        if touch.engaged_ticks > 0 {
            self.write_coverage(f)?;
        }
        match self.end {
            LoopEnd::Completed => {}
            LoopEnd::Stopped => write!(f, "\nend          stopped")?,
            LoopEnd::DeviceLost(error) => write!(f, "\nend          {error}")?,
        }
        if let Phase::SafeZero(fault) = self.phase {
            write!(f, "\nfault        {} (force zero, latched)", fault.name())?;
        }
        if self.dropped_records + self.device_errors > 0 {
            let (dropped, errors) = (self.dropped_records, self.device_errors);
            write!(f, "\nlosses       {dropped} records dropped, {errors} device exchanges failed")?;
        }
        if self.frames_written > 0 {
            write!(
                f,
                "\nframes       {} written, {:.1} ms each to draw",
                self.frames_written, self.mean_frame_ms
            )?;
        }
        Ok(())
    }
}

/// Runs a session: the loop on its own thread, viewer and records on the calling one.
///
/// `on_record` gets every record in order, a few milliseconds late; it may take its time, the queue holds seconds. `stop` ends the
/// session from outside (Ctrl-C). A window that cannot be opened is an error before anything moves.
pub fn run_session<D: Device, const N: usize>(
    organ: &Organ<'_, N>,
    config: Config,
    device: D,
    options: &SessionOptions,
    stop: &AtomicBool,
    mut on_record: impl FnMut(&TickRecord),
) -> Result<SessionSummary, SessionError> {
    let controller = Controller::new(organ, config)?;
    let felt = (controller.stiffest_n_m(), controller.force_share());
    let periods = periods(options)?;
    let mut screen = Screen::open(organ, &config, &options.view)?;
    let info = device.info();
    let (producer, mut records) = rtrb::RingBuffer::new(options.queue_ticks.max(1));
    let (latest, mut newest) = triple_buffer::triple_buffer(&TickRecord::NOTHING);
    let controls = Controls::default();
    let ended_here = AtomicBool::new(false);
    let mut touch = TouchFigures::default();
    let mut live = Live::new();

    let joined = std::thread::scope(|scope| -> Result<_, SessionError> {
        // Whatever happens on this side, the other one must end, or the scope would wait for ever.
        let _end = SetOnDrop(&ended_here);
        let outputs = Outputs { records: producer, latest };
        let haptic = HapticLoop::new(controller, device, MonotonicClock, options.haptic, &controls, outputs);
        let instructions = haptic.instructions();
        let handle =
            spawn(scope, haptic, options.real_time, &ended_here, periods).map_err(SessionError::Thread)?;
        let mut drain = |live: &mut Live| {
            while let Ok(record) = records.pop() {
                touch.take(&record);
                live.take(&record);
                on_record(&record);
            }
        };
        while !handle.is_finished() {
            if stop.load(Ordering::Relaxed) {
                ended_here.store(true, Ordering::Relaxed);
            }
            drain(&mut live);
            if screen.is_due() {
                screen.show(organ, newest.read(), &mut live, &controls, &ended_here)?;
            } else {
                std::thread::sleep(screen.time_left().min(DRAIN_PAUSE));
            }
        }
        let joined = handle.join().map_err(|_| SessionError::LoopPanicked)?;
        drain(&mut live);
        Ok((instructions, joined))
    });
    let (instructions, (real_time, outcome)) = joined?;
    screen.finish()?;
    Ok(summary(info, instructions, felt, real_time, outcome, touch, &screen))
}

fn periods(options: &SessionOptions) -> Result<u64, SessionError> {
    match options.seconds {
        None => Ok(u64::MAX),
        Some(seconds) if seconds >= 0.0 => {
            Ok((seconds * 1e6 / f64::from(options.haptic.period_us.max(1))).round() as u64)
        }
        Some(seconds) => Err(SessionError::Seconds(seconds)),
    }
}

fn summary(
    device: DeviceInfo,
    instructions: Instructions,
    (stiffest_n_m, force_share): (f32, f32),
    real_time: RtReport,
    outcome: LoopOutcome,
    touch: TouchFigures,
    screen: &Screen,
) -> SessionSummary {
    SessionSummary {
        device,
        instructions,
        stiffest_n_m,
        force_share,
        real_time,
        end: outcome.end,
        phase: outcome.phase,
        ticks: outcome.ticks,
        latency: outcome.latency.report(),
        dropped_records: outcome.dropped_records,
        device_errors: outcome.device_errors,
        touch,
        frames_written: screen.frames_written(),
        mean_frame_ms: screen.mean_frame_ms(),
    }
}

struct SetOnDrop<'f>(&'f AtomicBool);

impl Drop for SetOnDrop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::simulated::{SimulatedConfig, SimulatedHand};
    use crate::synthetic::{self, Shape};
    use crate::viewer::RendererConfig;
    use palpate_core::Method;
    use std::path::PathBuf;

    fn options(seconds: f64) -> SessionOptions {
        SessionOptions {
            seconds: Some(seconds),
            real_time: RtRequest::nothing(),
            ..SessionOptions::default()
        }
    }

    fn run(
        options: &SessionOptions,
        stop: &AtomicBool,
        mut on_record: impl FnMut(&TickRecord),
    ) -> Result<SessionSummary, SessionError> {
        let blob = synthetic::organ(&Shape::default());
        let organ: Organ<'_> = Organ::read(bytemuck::cast_slice(&blob)).expect("a sound blob");
        let mut config = SimulatedConfig::default();
        // Quick strokes: this hand's time stands still while the machine is busy elsewhere.
        config.strokes.seconds_per_node = 1.0;
        let hand = SimulatedHand::new(&organ, config);
        run_session(&organ, Config::new(Method::Hybrid), hand, options, stop, |record| on_record(record))
    }

    #[test]
    fn a_short_session_with_frames_gives_records_pictures_and_figures() {
        let directory = tempfile::tempdir().expect("a temporary directory");
        let view = View::Frames {
            directory: directory.path().join("frames"),
            rate_hz: 20.0,
            picture: RendererConfig { width: 320, height: 180, samples: 1 },
        };
        let mut ticks = Vec::new();
        let summary = run(&SessionOptions { view, ..options(1.2) }, &AtomicBool::new(false), |record| {
            ticks.push(record.tick);
        })
        .expect("it runs");
        assert_eq!(summary.end, LoopEnd::Completed);
        assert_eq!(ticks.len() as u64, summary.ticks);
        assert!(ticks.windows(2).all(|pair| pair[0] < pair[1]));
        assert_eq!(summary.ticks + summary.latency.skipped_periods, 1_200);
        assert!(summary.touch.contacts >= 1 && summary.touch.peak_reaction_n > 0.5, "{summary}");
        let found = std::fs::read_dir(directory.path().join("frames")).expect("there").count() as u64;
        assert!(summary.frames_written >= 2 && found == summary.frames_written);
        let text = summary.to_string();
        assert!(
            text.contains("simulated hand") && text.contains("p99.9") && text.contains("contacts"),
            "{text}"
        );
    }

    #[test]
    fn the_stop_flag_ends_an_endless_session() {
        let stop = AtomicBool::new(false);
        let endless = SessionOptions { seconds: None, ..options(0.0) };
        let summary = run(&endless, &stop, |record| stop.store(record.tick >= 50, Ordering::Relaxed));
        assert_eq!(summary.expect("it runs").end, LoopEnd::Stopped);
    }

    #[test]
    fn what_cannot_run_is_refused_before_anything_moves() {
        let refused = run(&options(f64::NAN), &AtomicBool::new(false), |_| panic!("no tick may run"));
        assert!(matches!(refused, Err(SessionError::Seconds(_))));
        if std::env::var_os("DISPLAY").is_none() {
            let picture = RendererConfig::live();
            let view = View::Window { screenshots: PathBuf::new(), picture, mouse: None };
            let refused = run(&SessionOptions { view, ..options(1.0) }, &AtomicBool::new(false), |_| {
                panic!("no tick may run");
            });
            assert!(matches!(refused, Err(SessionError::Viewer(ViewerError::NoDisplay(_)))));
        }
    }

    #[test]
    fn a_panic_of_the_caller_does_not_hang_the_session() {
        let caught = std::panic::catch_unwind(|| {
            let _ = run(&SessionOptions { seconds: None, ..options(0.0) }, &AtomicBool::new(false), |_| {
                panic!("planted panic")
            });
        });
        assert!(caught.is_err());
    }
}
