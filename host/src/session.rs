//! One session from start to report: haptic thread, viewer and record stream.

use crate::device::{Device, DeviceInfo};
use crate::doctor::{Probe, SystemInfo};
use crate::instructions::Instructions;
use crate::model::{self, ModelError, TouchMemory};
use crate::rt::thread::spawn;
use crate::rt::{
    Controls, HapticLoop, LatencyReport, LoopConfig, LoopEnd, LoopOutcome, MonotonicClock, Outputs,
    TickRecord,
};
use crate::sys::{MAX_LOOP_FIFO_PRIORITY, RtReport, RtRequest};
use crate::viewer::screen::DRAIN_PAUSE;
use crate::viewer::{Live, ViewerError};
use core::fmt;
use core::sync::atomic::{AtomicBool, Ordering};
use core::time::Duration;
use palpate_core::{Config, Controller, Coverage, Organ, Phase, Vec3, vec3};
use std::sync::{Arc, OnceLock};

pub(crate) use crate::viewer::screen::Screen;
pub use crate::viewer::screen::View;

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
    /// What the viewer shows.
    pub view: View,
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
            view: View::Nothing,
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
    /// No display is available, or a frame could not be written.
    Viewer(ViewerError),
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
            Self::Viewer(error) => error.fmt(f),
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

impl From<ViewerError> for SessionError {
    fn from(error: ViewerError) -> Self {
        Self::Viewer(error)
    }
}

/// Largest values and counts over the records that reached the caller.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct TouchStatistics {
    /// Largest |h| of the model, N.
    pub peak_reaction_n: f32,
    /// Largest force for the hand, N.
    pub peak_hand_force_n: f32,
    /// Largest displacement of an active node, m.
    pub peak_displacement_m: f32,
    /// Number of contacts.
    pub contacts: u64,
    /// Ticks in contact.
    pub engaged_ticks: u64,
    /// Ticks in contact by coverage, in the order of `Coverage::ALL`.
    pub coverage_ticks: [u64; Coverage::ALL.len()],
    /// Ticks in which the force limit reduced the force.
    pub clamped_ticks: u64,
    /// Largest change of the force for the hand between consecutive ticks while rendering, N. The step to
    /// zero at a fault or at the end is excluded.
    pub largest_step_n: f32,
    /// Largest work on the hand since the start of a contact, J. A passive body cannot give more than 0.
    pub largest_work_j: f32,
    /// Ticks in which the energy guard added damping.
    pub damped_ticks: u64,
    before: Option<(u64, bool, Vec3)>,
}

impl TouchStatistics {
    /// Adds one record. Records come in order.
    pub fn add(&mut self, record: &TickRecord) {
        self.peak_reaction_n = self.peak_reaction_n.max(vec3::norm(record.reaction_n));
        self.peak_hand_force_n = self.peak_hand_force_n.max(vec3::norm(record.hand_force_n));
        self.peak_displacement_m = self.peak_displacement_m.max(vec3::norm(record.displacement_m));
        let engaged = record.engaged.is_some();
        let (before, was_engaged, force_n) = self.before.unwrap_or((0, false, vec3::ZERO));
        self.contacts += u64::from(engaged && !was_engaged);
        if record.phase == Phase::Active && record.tick == before + 1 {
            self.largest_step_n = self.largest_step_n.max(vec3::distance(force_n, record.hand_force_n));
        }
        self.before = Some((record.tick, engaged, record.hand_force_n));
        self.largest_work_j = self.largest_work_j.max(record.hand_work_j);
        self.damped_ticks += u64::from(record.damped);
        self.engaged_ticks += u64::from(engaged);
        self.clamped_ticks += u64::from(record.clamped);
        let kinds = Coverage::ALL.iter().zip(&mut self.coverage_ticks);
        for (_, ticks) in kinds.filter(|(kind, _)| record.coverage == Some(**kind)) {
            *ticks += 1;
        }
    }
}

/// Summary of a session.
#[derive(Debug, Clone, PartialEq)]
pub struct SessionSummary {
    /// The device.
    pub device: DeviceInfo,
    /// The instructions that evaluated the force.
    pub instructions: Instructions,
    /// Largest stiffness of the organ at the hand, N/m.
    pub stiffest_n_m: f32,
    /// Factor on every force that keeps the stiffness within the device's limit; 1 if no reduction is
    /// necessary.
    pub force_share: f32,
    /// What the operating system granted.
    pub real_time: RtReport,
    /// Kernel and CPUs.
    pub system: SystemInfo,
    /// Reason of the end.
    pub end: LoopEnd,
    /// Phase at the end.
    pub phase: Phase,
    /// Number of ticks.
    pub ticks: u64,
    /// Timing.
    pub latency: LatencyReport,
    /// Records dropped because the queue was full.
    pub dropped_records: u64,
    /// Device exchanges that failed.
    pub device_errors: u64,
    /// Forces, displacements, contacts.
    pub touch: TouchStatistics,
    /// Frames written.
    pub frames_written: u64,
    /// Mean time to draw a frame, ms; 0 without frames.
    pub mean_frame_ms: f32,
}

impl SessionSummary {
    /// Writes the share of the contact ticks by coverage.
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
                ", limited to {cap_n_m:.0} N/m: all forces are multiplied by {:.2}, the organ feels softer",
                self.force_share
            )?;
        }
        writeln!(f)?;
        writeln!(f, "{}", self.real_time)?;
        writeln!(f, "{}", self.system)?;
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
            write!(
                f,
                "\nsmoothness   largest step of the force {:.0} mN a tick; work on the hand at most {:+.1} mJ in a touch",
                touch.largest_step_n * 1e3,
                touch.largest_work_j * 1e3
            )?;
            if touch.damped_ticks > 0 {
                write!(f, ", {} ticks damped", touch.damped_ticks)?;
            }
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

/// Runs a session: the loop on its own thread, viewer and records on the calling thread.
///
/// The first organ is rendered until another is selected; all use the same settings. `on_record` receives
/// every record in order, with a delay of a few milliseconds. It may block: the queue holds seconds. `stop`
/// ends the session from outside (Ctrl-C); the loop reads it in every tick, whatever the calling thread does.
/// A window that cannot be opened is an error before the device moves.
pub fn run_session<D: Device, const N: usize>(
    organs: &[&Organ<'_, N>],
    config: Config,
    device: D,
    options: &SessionOptions,
    stop: &AtomicBool,
    mut on_record: impl FnMut(&TickRecord),
) -> Result<SessionSummary, SessionError> {
    let mut memory = TouchMemory::default();
    let controllers = model::controllers(organs, config, &mut memory)?;
    // The stiffest organ, and the smallest force share of all.
    let stiffest_n_m = controllers.iter().map(Controller::stiffest_n_m).fold(0.0, f32::max);
    let stiffness = (stiffest_n_m, controllers.iter().map(Controller::hand_scale).fold(1.0, f32::min));
    let periods = periods(options)?;
    if let Some(priority) =
        options.real_time.fifo_priority.filter(|priority| *priority > MAX_LOOP_FIFO_PRIORITY)
    {
        return Err(SessionError::Priority(priority));
    }
    let mut screen = Screen::open(organs, &config, &options.view)?;
    let info = device.info();
    let (producer, mut records) = rtrb::RingBuffer::new(options.queue_ticks.max(1));
    let (latest, mut newest) = triple_buffer::triple_buffer(&TickRecord::EMPTY);
    let controls = Controls::default();
    let ended_here = AtomicBool::new(false);
    let mut touch = TouchStatistics::default();
    let mut live = Live::new();

    let joined = std::thread::scope(|scope| -> Result<_, SessionError> {
        // If this side fails, the loop must end as well, or the scope waits for ever.
        let _end = SetOnDrop(&ended_here);
        let outputs = Outputs { records: producer, latest };
        let haptic =
            HapticLoop::with_models(&controllers, device, MonotonicClock, options.haptic, &controls, outputs)
                .with_stop_flag(stop);
        let instructions = haptic.instructions();
        let (real_time, granted) = (options.real_time, &*options.granted);
        let handle = spawn(scope, haptic, real_time, &ended_here, periods, granted);
        let handle = handle.map_err(SessionError::Thread)?;
        let mut drain = |live: &mut Live| {
            while let Ok(record) = records.pop() {
                touch.add(&record);
                live.push(&record);
                on_record(&record);
            }
        };
        while !handle.is_finished() {
            if stop.load(Ordering::Relaxed) {
                ended_here.store(true, Ordering::Relaxed);
            }
            drain(&mut live);
            let record = newest.read();
            if let Some(every) = options.change_every {
                let turns = record.t_us as u128 / every.as_micros().max(1);
                controls.select((turns % organs.len() as u128) as u8);
            }
            if screen.is_due() {
                let organ = organs[usize::from(record.model)];
                screen.show(organ, record, &mut live, &controls, &ended_here)?;
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
    Ok(summary(info, instructions, stiffness, real_time, outcome, touch, &screen))
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
    touch: TouchStatistics,
    screen: &Screen,
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
    use crate::device::DeviceError;
    use crate::device::simulated::{SimulatedConfig, SimulatedHand};
    use crate::synthetic::{self, Shape};
    use crate::viewer::RendererConfig;
    use palpate_core::{Method, Sample, Vec3};
    use std::path::PathBuf;
    use std::time::Instant;

    fn options(seconds: f64) -> SessionOptions {
        SessionOptions { seconds: Some(seconds), real_time: RtRequest::none(), ..SessionOptions::default() }
    }

    fn run(
        options: &SessionOptions,
        stop: &AtomicBool,
        mut on_record: impl FnMut(&TickRecord),
    ) -> Result<SessionSummary, SessionError> {
        let blob = synthetic::organ(&Shape::default());
        let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
        let mut config = SimulatedConfig::default();
        // Quick strokes: this hand's time does not advance while the machine is busy.
        config.strokes.seconds_per_node = 1.0;
        let hand = SimulatedHand::new(&organ, config);
        run_session(&[&organ], Config::new(Method::Hybrid), hand, options, stop, |record| on_record(record))
    }

    #[test]
    fn a_short_session_writes_records_frames_and_statistics() {
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

    /// A simulated hand that records when its force was zeroed.
    struct ZeroObserved<'z>(SimulatedHand, &'z AtomicBool);

    impl Device for ZeroObserved<'_> {
        fn exchange(&mut self, now_us: u64, force_n: Vec3) -> Result<Option<Sample>, DeviceError> {
            self.0.exchange(now_us, force_n)
        }

        fn stop(&mut self) {
            self.1.store(true, Ordering::SeqCst);
        }

        fn info(&self) -> DeviceInfo {
            self.0.info()
        }
    }

    /// A screen or disk that hangs must not keep the force on after Ctrl-C.
    #[test]
    fn the_stop_flag_zeroes_the_force_while_the_caller_hangs() {
        let blob = synthetic::organ(&Shape::default());
        let organ: Organ<'_> = Organ::read(&blob).expect("a valid blob");
        let (stop, zeroed) = (AtomicBool::new(false), AtomicBool::new(false));
        let hand = SimulatedHand::new(&organ, SimulatedConfig::default());
        let endless = SessionOptions { seconds: None, ..options(0.0) };
        let (mut requested, mut in_time) = (false, false);
        let config = Config::new(Method::Hybrid);
        run_session(&[&organ], config, ZeroObserved(hand, &zeroed), &endless, &stop, |_| {
            if !core::mem::replace(&mut requested, true) {
                stop.store(true, Ordering::Relaxed);
                let started = Instant::now();
                while !zeroed.load(Ordering::SeqCst) && started.elapsed() < Duration::from_secs(20) {
                    std::thread::sleep(Duration::from_millis(1));
                }
                in_time = zeroed.load(Ordering::SeqCst);
            }
        })
        .expect("it runs");
        assert!(in_time, "the loop ends while its caller hangs");
    }

    #[test]
    fn the_stop_flag_ends_an_endless_session() {
        let stop = AtomicBool::new(false);
        let endless = SessionOptions { seconds: None, ..options(0.0) };
        let summary = run(&endless, &stop, |record| stop.store(record.tick >= 50, Ordering::Relaxed));
        assert_eq!(summary.expect("it runs").end, LoopEnd::Stopped);
    }

    #[test]
    fn invalid_options_are_refused_before_the_first_tick() {
        let refused = run(&options(f64::NAN), &AtomicBool::new(false), |_| panic!("no tick may run"));
        assert!(matches!(refused, Err(SessionError::Seconds(_))));
        for priority in [98, 99] {
            let real_time = RtRequest { fifo_priority: Some(priority), ..RtRequest::none() };
            let refused = run(&SessionOptions { real_time, ..options(1.0) }, &AtomicBool::new(false), |_| {
                panic!("no tick may run")
            });
            let refused = refused.expect_err("no priority is left for the watchdog");
            assert!(refused.to_string().contains("at most 97"), "{refused}");
        }
        if std::env::var_os("DISPLAY").is_none() {
            let picture = RendererConfig::live();
            let view = View::Window { screenshots: PathBuf::new(), picture, mouse: None };
            let refused = run(&SessionOptions { view, ..options(1.0) }, &AtomicBool::new(false), |_| {
                panic!("no tick may run");
            });
            assert!(matches!(refused, Err(SessionError::Viewer(ViewerError::NoDisplay(_)))));
        }
    }
}
