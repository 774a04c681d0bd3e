//! The viewer of a session: a window, files, or nothing, driven by the calling thread.

use super::animation::GifWriter;
use super::error::ViewerError;
use super::frames::FrameWriter;
use super::live::Live;
use super::renderer::{Renderer, RendererConfig};
use super::window_controller::WindowController;
use crate::device::mouse::MouseHandle;
use crate::rt::{Controls, TickRecord};
use core::sync::atomic::{AtomicBool, Ordering};
use core::time::Duration;
use palpate_core::{Config, Organ};
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Longest pause between two drains of the queue.
pub(crate) const DRAIN_PAUSE: Duration = Duration::from_millis(5);

/// Output of the viewer during the session.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum View {
    /// Nothing.
    #[default]
    Nothing,
    /// PNG frames.
    Frames {
        /// The directory.
        directory: PathBuf,
        /// Frames per second; fewer if drawing takes longer.
        rate_hz: f32,
        /// Size and sampling.
        picture: RendererConfig,
    },
    /// An animated GIF.
    Gif {
        /// The file. It must not exist, unless it is a device.
        file: PathBuf,
        /// Frames per second; fewer if drawing takes longer.
        rate_hz: f32,
        /// Size and sampling.
        picture: RendererConfig,
    },
    /// A window.
    Window {
        /// Directory of screenshots and films.
        screenshots: PathBuf,
        /// Size and sampling.
        picture: RendererConfig,
        /// The mouse device whose tool the window moves.
        mouse: Option<MouseHandle>,
    },
}

/// Creates the file of a film. A device is opened as it is.
fn film_file(path: &Path) -> io::Result<File> {
    match File::create_new(path) {
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists && !path.metadata()?.is_file() => {
            File::create(path)
        }
        made => made,
    }
}

/// The viewer of a session.
pub(crate) struct Screen {
    renderer: Option<Renderer>,
    output: Output,
    interval: Duration,
    due: Instant,
    drawn: u64,
    drawing: Duration,
}

/// The output.
enum Output {
    Nothing,
    Frames(FrameWriter),
    Gif(Box<GifWriter>),
    Window(Box<WindowController>),
}

impl Screen {
    pub(crate) fn open<const N: usize>(
        organs: &[&Organ<'_, N>],
        config: &Config,
        view: &View,
    ) -> Result<Self, ViewerError> {
        let Some(organ) = organs.first() else { return Ok(Self::of(Output::Nothing, Duration::MAX, None)) };
        let renderer = |picture: &RendererConfig| {
            let mut renderer = Renderer::new(organ, config.method, *picture);
            renderer.set_models(organs.len());
            Some(renderer)
        };
        let interval = |rate_hz: f32| Duration::from_secs_f32(rate_hz.clamp(0.01, 1000.0).recip());
        let (output, interval, renderer) = match view {
            View::Nothing => (Output::Nothing, Duration::MAX, None),
            View::Frames { directory, rate_hz, picture } => {
                (Output::Frames(FrameWriter::new(directory)?), interval(*rate_hz), renderer(picture))
            }
            View::Gif { file, rate_hz, picture } => (
                Output::Gif(Box::new(GifWriter::new(film_file(file)?))),
                interval(*rate_hz),
                renderer(picture),
            ),
            View::Window { screenshots, picture, mouse } => {
                let title = format!("palpate \u{2013} {}", organ.scene);
                let controller = WindowController::open(&title, screenshots, *picture, mouse.clone())?;
                let mut renderer = renderer(picture);
                if let Some(renderer) = &mut renderer {
                    renderer.layers_mut().help = controller.help();
                }
                (Output::Window(Box::new(controller)), interval(30.0), renderer)
            }
        };
        Ok(Self::of(output, interval, renderer))
    }

    fn of(output: Output, interval: Duration, renderer: Option<Renderer>) -> Self {
        Self { renderer, output, interval, due: Instant::now(), drawn: 0, drawing: Duration::ZERO }
    }

    /// Mean time to draw a frame, ms; 0 without frames.
    pub(crate) fn mean_frame_ms(&self) -> f32 {
        if self.drawn == 0 { 0.0 } else { 1e3 * self.drawing.as_secs_f32() / self.drawn as f32 }
    }

    /// Number of frames written.
    pub(crate) fn frames_written(&self) -> u64 {
        match &self.output {
            Output::Nothing => 0,
            Output::Frames(frames) => frames.written(),
            Output::Gif(film) => film.written(),
            Output::Window(controller) => controller.written(),
        }
    }

    pub(crate) fn is_due(&self) -> bool {
        self.renderer.is_some() && Instant::now() >= self.due
    }

    pub(crate) fn time_left(&self) -> Duration {
        if self.renderer.is_some() { self.due.saturating_duration_since(Instant::now()) } else { DRAIN_PAUSE }
    }

    pub(crate) fn show<const N: usize>(
        &mut self,
        organ: &Organ<'_, N>,
        record: &TickRecord,
        live: &mut Live,
        controls: &Controls,
        end: &AtomicBool,
    ) -> Result<(), ViewerError> {
        let Some(renderer) = &mut self.renderer else { return Ok(()) };
        let started = Instant::now();
        renderer.render(organ, record, live);
        self.drawing += started.elapsed();
        self.drawn += 1;
        match &mut self.output {
            Output::Nothing => {}
            Output::Frames(frames) => {
                frames.write(renderer.image())?;
            }
            Output::Gif(film) => film.write(renderer.image(), record.t_us)?,
            Output::Window(controller) => {
                let events = controller.show(renderer, organ, record)?;
                if events.arm {
                    controls.arm();
                }
                if events.disarm {
                    controls.disarm();
                }
                if events.reset {
                    controls.reset();
                }
                if events.next_model {
                    // The index after the last one wraps round to the first.
                    controls.select(record.model + 1);
                }
                if events.quit {
                    end.store(true, Ordering::Relaxed);
                }
            }
        }
        // Counted from now, not from the due time: a slow frame is not followed by a burst.
        self.due = (self.due + self.interval).max(Instant::now());
        Ok(())
    }

    /// Completes a film. A drop completes it as well, but cannot report a full disk.
    pub(crate) fn finish(&mut self) -> Result<(), ViewerError> {
        match &mut self.output {
            Output::Gif(film) => Ok(film.finish()?),
            Output::Window(controller) => controller.finish(),
            Output::Nothing | Output::Frames(_) => Ok(()),
        }
    }
}
