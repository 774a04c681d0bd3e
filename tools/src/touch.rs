//! Sessions of the real-time loop for `run` and `demo`.

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, SystemTime};

use palpate_core::{Config, Method, Organ, Phase, vec3};
use palpate_host::device::mouse::MouseHandle;
use palpate_host::device::profile::Profile;
use palpate_host::model::ModelError;
use palpate_host::recording::{End, Header, RecorderReport};
use palpate_host::rt::{LoopEnd, TickRecord};
use palpate_host::session::View;
use palpate_host::settings::controller_config;
use palpate_host::viewer::{RendererConfig, ViewerError};
use palpate_host::{Device, DeviceInfo, Recorder, SessionError, SessionOptions, SessionSummary, run_session};

use crate::failure::Failure;
use crate::files::Output;
use crate::timing::Timing;

/// Frame rate of headless pictures: enough to follow a stroke, few enough to store.
const HEADLESS_RATE_HZ: f32 = 2.0;
/// Frame rate of a film: motion is visible, and ten seconds take less than 5 MB.
const FILM_RATE_HZ: f32 = 12.5;
/// Size of a film.
const FILM_PICTURE: RendererConfig = RendererConfig { width: 800, height: 450, samples: 2 };

/// Error of the mouse device without a window.
pub(crate) const MOUSE_NEEDS_WINDOW: &str =
    "the mouse device needs a window: use a display without --headless, or --device sim";

/// How a session is shown and how long it lasts.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Show<'p> {
    /// Duration, s; until stopped if `None`.
    pub seconds: Option<f64>,
    /// PNG frames instead of a window.
    pub headless: bool,
    /// Frame rate of the frames or the film, if not the default; 0 for no frames.
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
    /// A film instead of PNG frames.
    pub gif: Option<&'p Output>,
    /// The mouse device whose tool the window moves.
    pub mouse: Option<&'p MouseHandle>,
}

impl Show<'_> {
    /// PNG frames, or a film if requested.
    pub(crate) fn frames(&self) -> View {
        if self.rate_hz == Some(0.0) {
            return View::Nothing;
        }
        if let Some(file) = self.gif {
            let rate_hz = self.rate_hz.unwrap_or(FILM_RATE_HZ);
            return View::Gif { file: file.path().to_path_buf(), rate_hz, picture: FILM_PICTURE };
        }
        View::Frames {
            directory: self.pictures.to_path_buf(),
            rate_hz: self.rate_hz.unwrap_or(HEADLESS_RATE_HZ),
            picture: RendererConfig::still(),
        }
    }

    /// A picture that could not be written during the session.
    pub(crate) fn picture_failure(&self, error: &std::io::Error) -> Failure {
        let place = self.gif.map_or(self.pictures, Output::path);
        Failure::work(Failure::file(place, error).line())
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
}

impl Record<'_> {
    fn start(
        &self,
        organ: &Organ<'_>,
        config: Config,
        options: &SessionOptions,
        device: DeviceInfo,
    ) -> Result<Recorder<BufWriter<File>>, Failure> {
        let blob = self.blob_blake3.to_vec();
        let since_1970 = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        let start_unix_ns = since_1970.as_nanos() as u64;
        let header = Header::new(organ, blob, config, options.haptic, device, start_unix_ns);
        Recorder::start(BufWriter::new(self.file.create_new()?), &header)
            .map_err(|error| Failure::work(format!("{}: {error}", self.file.path().display())))
    }
}

/// Summary of a session, and of its recording.
#[derive(Debug)]
pub(crate) struct Touched {
    /// Summary of the session.
    pub summary: SessionSummary,
    /// Summary of the recording.
    pub recording: Option<RecorderReport>,
}

/// Runs a session; a window that cannot be opened falls back to PNG frames.
///
/// `device` is called again if the window fails, before the first tick.
pub(crate) fn run<D: Device>(
    organs: &[&Organ<'_>],
    method: Method,
    show: Show<'_>,
    stop: &AtomicBool,
    mut device: impl FnMut() -> Result<D, Failure>,
    mut on_record: impl FnMut(&TickRecord),
) -> Result<Touched, Failure> {
    let organ = organs.first().ok_or_else(|| Failure::input(SessionError::Model(ModelError::Count)))?;
    let mut options = SessionOptions {
        seconds: show.seconds,
        view: show.view(),
        change_every: show.change_every,
        haptic: show.timing.haptic(show.profile),
        real_time: show.timing.request(),
        ..SessionOptions::default()
    };
    if options.haptic.spin_us >= options.haptic.period_us {
        return Err(Failure::input(format!(
            "--spin-us {} leaves no time to sleep in a period of {} us: give a smaller value",
            options.haptic.spin_us, options.haptic.period_us
        )));
    }
    let granted = Arc::clone(&options.granted);
    let mut moved = false;
    loop {
        let device = device()?;
        let info = device.info();
        let mut config = controller_config(organs, method, &info, show.profile);
        config.contact.friction = show.friction.unwrap_or(config.contact.friction);
        // The user arms a real device by pressing its button; the next press grasps.
        options.haptic.arm_button = if info.self_arming { 0 } else { config.contact.grasp_button };
        let record = show.record.map(|record| record.start(organ, config, &options, info));
        let mut recorder = record.transpose()?;
        let ended = run_session(organs, config, device, &options, stop, |record| {
            if let (false, Some(report)) = (moved, granted.get()) {
                // Printed at once: the user should know of a refused real-time request before touching the
                // device.
                eprintln!("palpate: {}", report.line());
            }
            moved = true;
            if let Some(recorder) = &mut recorder {
                recorder.push(record);
            }
            on_record(record);
        });
        let end = ended.as_ref().ok().map(End::of_session);
        let recording = recorder.map(|recorder| recorder.finish(end));
        if ended.is_err() && !moved {
            // Created by this call, and without a tick.
            show.record.iter().try_for_each(|record| record.file.remove())?;
            show.gif.iter().try_for_each(|gif| gif.remove())?;
        }
        match ended {
            Err(SessionError::Viewer(ViewerError::NoDisplay(_))) if show.mouse.is_some() && !moved => {
                return Err(Failure::input(MOUSE_NEEDS_WINDOW));
            }
            Err(SessionError::Viewer(ViewerError::NoDisplay(error)))
                if matches!(options.view, View::Window { .. }) && !moved =>
            {
                eprintln!("palpate: no window ({error}); writing PNG frames instead");
                options.view = show.frames();
            }
            Err(error @ (SessionError::Model(_) | SessionError::Seconds(_) | SessionError::Priority(_))) => {
                return Err(Failure::input(error));
            }
            Err(SessionError::Viewer(ViewerError::Frame(error))) => {
                return Err(show.picture_failure(&error));
            }
            Err(error) => return Err(Failure::work(error)),
            Ok(summary) => return Ok(Touched { summary, recording }),
        }
    }
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
    use palpate_host::device::simulated::{SimulatedConfig, SimulatedHand};
    use palpate_host::{BlobFile, Recording};
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
                pictures: &pictures,
                record: Some(Record { file: &record, blob_blake3: &blob_blake3 }),
                friction: None,
                change_every: None,
                profile: None,
                timing: Timing { fifo: 0, ..Timing::default() },
                gif: None,
                mouse: None,
            };
            let mut ticks = 0;
            let device = || Ok(SimulatedHand::new(&organ, SimulatedConfig::default()));
            let ended = catch_unwind(AssertUnwindSafe(|| {
                run(&[&organ], Method::Tricubic, show, &AtomicBool::new(false), device, |_| {
                    ticks += 1;
                    if ticks == 100 {
                        std::fs::remove_dir_all(&pictures).expect("the frames are there");
                        assert!(fault != Fault::Panic, "planted panic");
                    }
                })
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
            assert_eq!(recorded.len(), ticks, "{fault:?}");
        }
    }

    /// A film has its own default frame rate.
    #[test]
    fn a_film_takes_the_rate_it_is_given() {
        let film = Output::in_scratch(&tempfile::tempdir().expect("a folder"), "film.gif");
        let show = Show {
            seconds: None,
            headless: true,
            rate_hz: None,
            pictures: Path::new("frames"),
            record: None,
            friction: None,
            change_every: None,
            profile: None,
            timing: Timing::default(),
            gif: Some(&film),
            mouse: None,
        };
        let rate_hz = |show: Show<'_>| match show.view() {
            View::Gif { rate_hz, .. } | View::Frames { rate_hz, .. } => rate_hz,
            other => panic!("{other:?}"),
        };
        assert_eq!(rate_hz(show), FILM_RATE_HZ);
        assert_eq!(rate_hz(Show { rate_hz: Some(25.0), ..show }), 25.0);
        assert_eq!(rate_hz(Show { gif: None, ..show }), HEADLESS_RATE_HZ);
        assert_eq!(rate_hz(Show { gif: None, rate_hz: Some(25.0), ..show }), 25.0);
        assert_eq!(Show { gif: None, rate_hz: Some(0.0), ..show }.view(), View::Nothing);
    }
}
