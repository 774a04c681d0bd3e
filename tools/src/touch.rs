//! Sessions of the real-time loop for `run` and `demo`.

use std::fmt;
use std::fs::File;
use std::io::BufWriter;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, OnceLock};
use std::time::{Duration, SystemTime};

use palpate_core::{Config, Method, Organ, Phase};
use palpate_host::device::mouse::MouseHandle;
use palpate_host::device::profile::Profile;
use palpate_host::live::{LiveField, SolverView, TakenJet};
use palpate_host::model::ModelError;
use palpate_host::rt::{Controls, LoopEnd, TickRecord};
use palpate_host::session::Observer;
use palpate_host::settings::{arm_button, controller_config};
use palpate_host::sys::RtReport;
use palpate_host::{
    Device, DeviceInfo, SessionError, SessionOptions, SessionSummary, run_live_session, run_session,
};
use palpate_record::{End, Header, Recorder, RecorderReport};
use palpate_viewer::{Frames, Regions, RendererConfig, Screen, View, ViewerError};

use crate::blob::verdicts;
use crate::control::Control;
use crate::failure::Failure;
use crate::files::Output;
use crate::friction;
use crate::timing::Timing;

/// Frame rate of headless pictures: enough to follow a stroke, few enough to store.
const HEADLESS_RATE_HZ: f32 = 2.0;

/// Error of the mouse device without a window.
pub(crate) const MOUSE_NEEDS_WINDOW: &str =
    "the mouse device needs a window: use a display without --headless, or --device sim";

/// Error of a device whose button is pressed before the session begins.
const BUTTON_IS_HELD: &str = "the button that arms is held, or stuck: release it and start again; docs/devices.md, Profiles, says which it is";

/// How a session is shown and how long it lasts.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Show<'p> {
    /// Duration, s; until stopped if `None`.
    pub seconds: Option<f64>,
    /// PNG frames instead of a window.
    pub headless: bool,
    /// Frame rate of the frames, if not the default; 0 for no frames.
    pub rate_hz: Option<f32>,
    /// Folder for frames and screenshots.
    pub pictures: &'p Path,
    /// The recording, if any.
    pub record: Option<Record<'p>>,
    /// Friction of a pushing tool, if not the default.
    pub friction: Option<f32>,
    /// Interval after which the session changes to the next of several organs.
    pub change_every: Option<Duration>,
    /// The device's profile, if known, with its cycle time, limits and workspace.
    pub profile: Option<&'p Profile>,
    /// Timing of the loop.
    pub timing: Timing,
    /// The mouse device whose tool the window moves.
    pub mouse: Option<&'p MouseHandle>,
    /// Whether the device has motors: its session has no window only if the user asked for none.
    pub has_motors: bool,
    /// The socket that controls the session.
    pub control: Option<&'p Control>,
    /// Regions inside the body that the side view shows.
    pub regions: Option<&'p Regions>,
    /// What the session asks in between, on the thread that draws: a line to show, if there is one.
    pub between: Option<&'p dyn Between>,
}

/// What happens beside a session, on the thread that draws.
pub(crate) trait Between: fmt::Debug {
    /// Passes on what the user asks for; a line for the picture, if there is one.
    fn poll(&self, controls: &Controls) -> Option<String>;
}

/// The end of a live solver that shows the surface, and its process.
#[derive(Debug)]
pub(crate) struct LiveSource {
    pub jets: LiveField,
    pub view: SolverView,
}

impl Show<'_> {
    /// PNG frames.
    pub(crate) fn frames(&self) -> View {
        if self.rate_hz == Some(0.0) {
            return View::Nothing;
        }
        View::Frames {
            directory: self.pictures.to_path_buf(),
            rate_hz: self.rate_hz.unwrap_or(HEADLESS_RATE_HZ),
            picture: RendererConfig::still(),
        }
    }

    /// A screen that could not be opened, or that failed during the session.
    pub(crate) fn screen_failure(&self, error: ViewerError) -> Failure {
        match error {
            ViewerError::Frame(error) => Failure::work(Failure::file(self.pictures, &error).line()),
            error => Failure::work(error),
        }
    }

    /// Opens the screen. A window that cannot be opened falls back to PNG frames; the mouse device needs it.
    pub(crate) fn screen<'s, 'o, const N: usize>(
        &self,
        organs: &'s [&'s Organ<'o, N>],
        method: &str,
    ) -> Result<Screen<'s, 'o, N>, Failure> {
        let opened = match Screen::open(organs, method, &self.view()) {
            Err(ViewerError::NoDisplay(_)) if self.mouse.is_some() => {
                return Err(Failure::input(MOUSE_NEEDS_WINDOW));
            }
            Err(ViewerError::NoDisplay(error)) if self.has_motors => {
                return Err(Failure::input(format!(
                    "no window ({error}), so no key would disarm the device: give --headless, and --control SOCKET to disarm it"
                )));
            }
            Err(ViewerError::NoDisplay(error)) => {
                eprintln!("palpate: no window ({error}); writing PNG frames instead");
                Screen::open(organs, method, &self.frames())
            }
            opened => opened,
        };
        let mut screen = opened.map_err(|error| self.screen_failure(error))?;
        screen.set_verdicts(organs.iter().map(|organ| verdicts(organ)).collect());
        self.regions.iter().for_each(|regions| screen.set_regions(regions));
        Ok(screen)
    }

    /// Deletes the folder of a screen that showed nothing, if it is empty and the screen made it. The failure
    /// that left it so is the one to report.
    pub(crate) fn discard(&self, had_folder: bool) {
        if !had_folder {
            let _ = std::fs::remove_dir(self.pictures);
        }
    }

    /// The options of the session, refused before the device is opened if no session can have them.
    fn options(&self) -> Result<SessionOptions, Failure> {
        let options = SessionOptions {
            seconds: self.seconds,
            change_every: self.change_every,
            haptic: self.timing.haptic(self.profile),
            real_time: self.timing.request(),
            ..SessionOptions::default()
        };
        if options.haptic.spin_us >= options.haptic.period_us {
            return Err(Failure::input(format!(
                "--spin-us {} leaves no time to sleep in a period of {} us: give a smaller value",
                options.haptic.spin_us, options.haptic.period_us
            )));
        }
        options.periods().map_err(Failure::input)?;
        Ok(options)
    }

    /// A window, or PNG frames if requested.
    pub(crate) fn view(&self) -> View {
        if self.headless {
            self.frames()
        } else {
            View::Window {
                screenshots: self.pictures.to_path_buf(),
                picture: RendererConfig::live(),
                mouse: self.mouse.cloned(),
            }
        }
    }
}

/// A recording to be made.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Record<'p> {
    /// The .mcap file, which must not exist.
    pub file: &'p Output,
    /// BLAKE3 of each blob.
    pub blob_blake3: &'p [String],
    /// The blob of a live session, which no file keeps.
    pub live: Option<&'p [u8]>,
}

/// The queues of a recorder.
struct Queues {
    ticks: rtrb::Producer<TickRecord>,
    jets: Option<rtrb::Producer<TakenJet>>,
}

/// Where the force comes from.
#[derive(Debug)]
pub(crate) enum Source {
    /// The tables of the organs, by a method.
    Tables(Method),
    /// The jets of a live solver.
    Jets(Box<LiveSource>),
}

impl Source {
    /// The method, or what takes its place.
    pub(crate) fn name(&self) -> &'static str {
        match self {
            Self::Tables(method) => method.name(),
            Self::Jets(_) => "jets",
        }
    }
}

impl Record<'_> {
    fn start<const N: usize>(
        &self,
        organ: &Organ<'_, N>,
        config: Config,
        options: &SessionOptions,
        device: DeviceInfo,
    ) -> Result<(Recorder<BufWriter<File>>, Queues), Failure> {
        let blob = self.blob_blake3.to_vec();
        let since_1970 = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        let start_unix_ns = since_1970.as_nanos() as u64;
        let header = Header::new(organ, blob, config, options.haptic, device, start_unix_ns);
        let stream = BufWriter::new(self.file.create_new()?);
        let started = match self.live {
            None => Recorder::start(stream, &header)
                .map(|(recorder, ticks)| (recorder, Queues { ticks, jets: None })),
            Some(organ) => Recorder::start_live(stream, &header, organ).map(|(recorder, queues)| {
                (recorder, Queues { ticks: queues.ticks, jets: Some(queues.jets) })
            }),
        };
        started.map_err(|error| Failure::work(format!("{}: {error}", self.file.path().display())))
    }
}

/// Summary of a session, of its recording and of its pictures.
#[derive(Debug)]
pub(crate) struct Touched {
    /// Summary of the session.
    pub summary: SessionSummary,
    /// Summary of the recording.
    pub recording: Option<RecorderReport>,
    /// The pictures.
    pub frames: Frames,
}

impl Touched {
    /// The summary for a terminal.
    pub(crate) fn text(&self) -> String {
        with_frames(&self.summary, self.frames)
    }
}

/// A summary, followed by its pictures if there are any.
pub(crate) fn with_frames(summary: &impl fmt::Display, frames: Frames) -> String {
    if frames.written > 0 { format!("{summary}\n{frames}") } else { summary.to_string() }
}

/// The screen, the recorder's queue and the caller of a session.
struct Watch<'w, 's, 'o, F, const N: usize> {
    screen: &'w mut Screen<'s, 'o, N>,
    recording: Option<Queues>,
    granted: &'w OnceLock<RtReport>,
    /// Whether a tick has run.
    moved: bool,
    control: Option<&'w Control>,
    between: Option<&'w dyn Between>,
    controls: Arc<Controls>,
    /// The button that arms; 0 after the first sample.
    unseen_button: u32,
    /// Whether the first sample shows it pressed. The loop does not arm, and the session ends.
    is_held: bool,
    on_record: F,
}

impl<F: FnMut(&TickRecord), const N: usize> Observer for Watch<'_, '_, '_, F, N> {
    fn recording_jets(&mut self) -> Option<rtrb::Producer<TakenJet>> {
        self.recording.as_mut().and_then(|queues| queues.jets.take())
    }

    fn recording(&mut self) -> Option<rtrb::Producer<TickRecord>> {
        self.recording.take().map(|queues| queues.ticks)
    }

    fn controls(&mut self) -> Arc<Controls> {
        self.controls = self.control.map(Control::controls).unwrap_or_default();
        Arc::clone(&self.controls)
    }

    fn record(&mut self, record: &TickRecord) {
        if let Some(sample) = &record.sample {
            self.is_held |= sample.buttons & std::mem::take(&mut self.unseen_button) != 0;
        }
        if let Some(control) = self.control {
            control.take(record);
        }
        if let (false, Some(report)) = (self.moved, self.granted.get()) {
            // Printed at once: the user should know of a refused real-time request before touching the device.
            eprintln!("palpate: {}", report.line());
        }
        self.moved = true;
        self.screen.record(record);
        if let Some(note) = self.between.and_then(|between| between.poll(&self.controls)) {
            self.screen.set_note(note);
        }
        (self.on_record)(record);
    }

    fn time_to_frame(&self) -> Duration {
        if self.is_held { Duration::ZERO } else { self.screen.time_to_frame() }
    }

    fn show(&mut self, newest: &TickRecord, controls: &Controls) -> ControlFlow<()> {
        if self.is_held { ControlFlow::Break(()) } else { self.screen.show(newest, controls) }
    }
}

/// Runs a session. Screen and settings come before the device: what they refuse moves no motor, and
/// `device` is called at most once.
pub(crate) fn run<D: Device, const N: usize>(
    organs: &[&Organ<'_, N>],
    source: Source,
    show: Show<'_>,
    stop: &AtomicBool,
    device: impl FnOnce() -> Result<D, Failure>,
    on_record: impl FnMut(&TickRecord),
) -> Result<Touched, Failure> {
    let organ = organs.first().ok_or_else(|| Failure::input(SessionError::Model(ModelError::Count)))?;
    let mut options = show.options()?;
    let had_folder = show.pictures.exists();
    let mut screen = show.screen(organs, source.name())?;
    let (method, live) = match source {
        Source::Tables(method) => (Some(method), None),
        Source::Jets(live) => (None, Some(*live)),
    };
    let jets = live.map(|LiveSource { jets, view }| {
        screen.set_solver(view);
        jets
    });
    let device = device().inspect_err(|_| show.discard(had_folder))?;
    let info = device.info();
    let mut config = controller_config(organs, method, &info, show.profile);
    let is_sphere = organ.tool.sphere().is_some();
    let usual = if is_sphere { 0.0 } else { config.contact.friction };
    config.contact.friction = show.friction.unwrap_or(usual);
    if let Some(line) =
        show.friction.filter(|&friction| friction > 0.0).and_then(|_| friction::without_effect(organ))
    {
        eprintln!("palpate: warning: {line}");
    }
    options.haptic.arm_button = arm_button(&info, show.profile);
    let record = show.record.map(|record| record.start(organ, config, &options, info));
    let record = record.transpose().inspect_err(|_| show.discard(had_folder))?;
    let (recorder, recording) = record.unzip();
    let granted = Arc::clone(&options.granted);
    let mut watch = Watch {
        screen: &mut screen,
        recording,
        granted: &granted,
        moved: false,
        control: show.control,
        between: show.between,
        controls: Arc::default(),
        unseen_button: options.haptic.arm_button,
        is_held: false,
        on_record,
    };
    let ended = match jets {
        None => run_session(organs, config, device, &options, stop, &mut watch),
        Some(jets) => run_live_session(organ, config, jets, device, &options, stop, &mut watch),
    };
    let (moved, is_held) = (watch.moved, watch.is_held);
    let end = ended.as_ref().ok().map(End::of_session);
    let recording = recorder.map(|recorder| recorder.finish(end));
    let frames = screen.finish();
    let discard = || {
        show.discard(had_folder);
        show.record.iter().try_for_each(|record| record.file.remove())
    };
    let summary = match ended {
        Ok(_) if is_held => {
            discard()?;
            return Err(Failure::input(BUTTON_IS_HELD));
        }
        Ok(summary) => summary,
        Err(error) => {
            if !moved {
                // Created by this call, and without a tick.
                discard()?;
            }
            return Err(match error {
                SessionError::Model(_) | SessionError::Seconds(_) | SessionError::Priority(_) => {
                    Failure::input(error)
                }
                error => Failure::work(error),
            });
        }
    };
    let frames = frames.map_err(|error| show.screen_failure(error))?;
    Ok(Touched { summary, recording, frames })
}

/// Fails for a session that lost its device or ended in a fault.
pub(crate) fn judge(summary: &SessionSummary) -> Result<(), Failure> {
    match (summary.end, summary.phase) {
        (LoopEnd::DeviceLost(error), _) => Err(Failure::work(format!("device lost: {error}"))),
        (_, Phase::SafeZero(fault)) => Err(Failure::work(format!("ended in safe zero: {}", fault.name()))),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate_host::BlobFile;
    use palpate_host::device::simulated::{SimulatedConfig, SimulatedHand};
    use palpate_record::Recording;
    use std::panic::{AssertUnwindSafe, catch_unwind};

    const BLOB: &[u8] = include_bytes!("../../firmware-like-core/golden/organ-514.blob");

    /// An error of the drawing thread.
    #[derive(Debug, Clone, Copy, PartialEq)]
    enum Fault {
        Panic,
        NoFolder,
    }

    /// The recording is complete and can be replayed after any error of the drawing thread.
    #[test]
    fn a_viewer_that_fails_leaves_a_whole_recording() {
        let file = BlobFile::of(BLOB);
        let organ: Organ<'_> = Organ::read(file.bytes()).expect("a sound blob");
        let blob_blake3 = [file.blake3()];
        for fault in [Fault::Panic, Fault::NoFolder] {
            let folder = tempfile::tempdir().expect("a folder");
            let (path, pictures) = (folder.path().join("session.mcap"), folder.path().join("frames"));
            let record = Output::in_scratch(&folder, "session.mcap");
            let show = Show {
                seconds: Some(20.0),
                headless: true,
                rate_hz: Some(50.0),
                record: Some(Record { file: &record, blob_blake3: &blob_blake3, live: None }),
                ..no_pictures(&pictures)
            };
            let mut ticks = 0;
            let device = || Ok(SimulatedHand::new(&organ, SimulatedConfig::default()));
            let ended = catch_unwind(AssertUnwindSafe(|| {
                run(
                    &[&organ],
                    Source::Tables(Method::Tricubic),
                    show,
                    &AtomicBool::new(false),
                    device,
                    |_| {
                        ticks += 1;
                        if ticks == 100 {
                            std::fs::remove_dir_all(&pictures).expect("the frames are there");
                            assert!(fault != Fault::Panic, "planted panic");
                        }
                    },
                )
            }));
            match fault {
                Fault::Panic => assert!(ended.is_err()),
                Fault::NoFolder => {
                    let failure = ended.expect("no panic").expect_err("frames cannot be written");
                    assert_eq!(failure.exit_code(), std::process::ExitCode::from(1));
                }
            }
            let source = std::io::BufReader::new(File::open(&path).expect("it is there"));
            let mut recording = Recording::open(source).expect("sound");
            let recorded: Vec<TickRecord> = recording.by_ref().map(|tick| tick.expect("sound")).collect();
            assert!(!recording.is_cut(), "{fault:?}: the file has no end");
            // The loop goes on until it sees the end; its records do not pass through the drawing thread.
            assert!(
                recorded.len() >= ticks && recording.lost() == 0,
                "{fault:?}: {} {ticks}",
                recorded.len()
            );
        }
    }

    fn no_pictures(pictures: &Path) -> Show<'_> {
        Show {
            seconds: Some(0.05),
            headless: false,
            rate_hz: Some(0.0),
            pictures,
            record: None,
            friction: None,
            change_every: None,
            profile: None,
            timing: Timing { fifo: 0, ..Timing::default() },
            mouse: None,
            has_motors: false,
            control: None,
            regions: None,
            between: None,
        }
    }

    /// A Falcon that is opened again has lost its homing.
    #[test]
    fn a_device_is_opened_once_and_after_the_screen() {
        let file = BlobFile::of(BLOB);
        let organ: Organ<'_> = Organ::read(file.bytes()).expect("a sound blob");
        let folder = tempfile::tempdir().expect("a folder");
        let pictures = folder.path().join("frames");
        let go = AtomicBool::new(false);
        // Without a display, and with --headless. A display of the developer would be opened.
        let modes = if std::env::var_os("DISPLAY").is_none() { vec![false, true] } else { vec![true] };
        for headless in modes {
            let show = Show { headless, rate_hz: None, ..no_pictures(&pictures) };
            let mut opened = 0;
            let device = || {
                opened += 1;
                assert!(pictures.is_dir(), "the screen is open before the device");
                Ok(SimulatedHand::new(&organ, SimulatedConfig::default()))
            };
            let touched =
                run(&[&organ], Source::Tables(Method::Tricubic), show, &go, device, |_| ()).expect("it runs");
            assert_eq!(opened, 1);
            assert!(touched.frames.written >= 1);
        }
    }

    #[test]
    fn a_session_that_cannot_run_opens_no_device() {
        let file = BlobFile::of(BLOB);
        let organ: Organ<'_> = Organ::read(file.bytes()).expect("a sound blob");
        let folder = tempfile::tempdir().expect("a folder");
        let pictures = folder.path().join("frames");
        let go = AtomicBool::new(false);
        std::fs::write(&pictures, "a file").expect("writable");
        let show = Show { headless: true, ..no_pictures(&pictures) };
        for (refused, show) in [
            ("not a number", Show { seconds: Some(f64::NAN), ..show }),
            ("no folder for frames", Show { rate_hz: Some(2.0), ..show }),
            ("no priority for the guard", Show { timing: Timing { fifo: 99, ..show.timing }, ..show }),
        ] {
            let device =
                || -> Result<SimulatedHand, Failure> { panic!("{refused}: no device may be opened") };
            run(&[&organ], Source::Tables(Method::Tricubic), show, &go, device, |_| ()).expect_err(refused);
        }
        // The screen of a device that cannot be opened leaves nothing behind.
        let folder = folder.path().join("other");
        let show = Show { headless: true, rate_hz: Some(2.0), pictures: &folder, ..show };
        let device = || -> Result<SimulatedHand, Failure> {
            assert!(folder.is_dir(), "the screen is open before the device");
            Err(Failure::input("port in use"))
        };
        run(&[&organ], Source::Tables(Method::Tricubic), show, &go, device, |_| ()).expect_err("no device");
        assert!(!folder.exists());
    }
}
