//! A session of the real-time loop as the command line starts it: `run` and `demo` share it.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use palpate_core::{Config, Method, Organ};
use palpate_host::rt::TickRecord;
use palpate_host::session::View;
use palpate_host::viewer::RendererConfig;
use palpate_host::{Device, SessionError, SessionOptions, SessionSummary, run_session};

use crate::failure::Failure;

/// Frames a second of headless pictures: enough to follow a stroke, few enough to keep.
const HEADLESS_RATE_HZ: f32 = 2.0;

/// How a session is shown and how long it lasts.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Show<'p> {
    /// Seconds; until stopped if `None`.
    pub seconds: Option<f64>,
    /// PNG frames instead of a window.
    pub headless: bool,
    /// Where frames and screenshots go.
    pub pictures: &'p Path,
}

/// Controller settings for `organ` and a device of `device_force_n`.
pub(crate) fn config(organ: &Organ<'_>, method: Method, device_force_n: f32) -> Config {
    let mut config = Config::new(method);
    config.limits.max_force_n = device_force_n.min(organ.max_force_n);
    config
}

/// Runs a session; a window that cannot be opened falls back to PNG frames.
///
/// `device` is asked for afresh when the window fails, before anything has moved.
pub(crate) fn run<D: Device>(
    organ: &Organ<'_>,
    method: Method,
    show: Show<'_>,
    stop: &AtomicBool,
    mut device: impl FnMut() -> Result<D, Failure>,
    mut on_record: impl FnMut(&TickRecord),
) -> Result<SessionSummary, Failure> {
    let frames = View::Frames {
        directory: show.pictures.to_path_buf(),
        rate_hz: HEADLESS_RATE_HZ,
        picture: RendererConfig::still(),
    };
    let window = View::Window { screenshots: show.pictures.to_path_buf(), picture: RendererConfig::live() };
    let mut options = SessionOptions {
        seconds: show.seconds,
        view: if show.headless { frames.clone() } else { window },
        ..SessionOptions::default()
    };
    loop {
        let device = device()?;
        let info = device.info();
        let config = config(organ, method, info.max_force_n);
        // A real device is armed by a deliberate press of its button; the press after that grasps.
        options.haptic.arm_button = if info.self_arming { 0 } else { config.contact.grasp_button };
        match run_session(organ, config, device, &options, stop, &mut on_record) {
            Err(SessionError::Viewer(error)) if matches!(options.view, View::Window { .. }) => {
                eprintln!("palpate: no window ({error}); writing PNG frames instead");
                options.view = frames.clone();
            }
            Err(SessionError::Controller(error)) => return Err(Failure::input(error)),
            Err(error) => return Err(Failure::work(error)),
            Ok(summary) => return Ok(summary),
        }
    }
}
