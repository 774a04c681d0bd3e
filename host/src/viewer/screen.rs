//! The viewer of a session: a window, files, or nothing, paced by the calling thread.

use super::{FrameWriter, Live, Renderer, RendererConfig, ViewWindow, ViewerError};
use crate::rt::{Controls, TickRecord};
use core::sync::atomic::{AtomicBool, Ordering};
use core::time::Duration;
use palpate_core::{Config, Organ};
use std::path::PathBuf;
use std::time::Instant;

/// Longest pause between two looks at the queue.
pub(crate) const DRAIN_PAUSE: Duration = Duration::from_millis(5);

/// What to show while the session runs.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum View {
    /// Nothing.
    #[default]
    Nothing,
    /// PNG frames.
    Frames {
        /// Where to.
        directory: PathBuf,
        /// Frames a second; slower if drawing takes longer.
        rate_hz: f32,
        /// Size and fineness.
        picture: RendererConfig,
    },
    /// A window.
    Window {
        /// Where screenshots go.
        screenshots: PathBuf,
        /// Size and fineness.
        picture: RendererConfig,
    },
}

/// The viewer of a session, whichever kind it is.
pub(crate) struct Screen {
    renderer: Option<Renderer>,
    window: Option<ViewWindow>,
    /// Frames, or screenshots of a window.
    frames: Option<FrameWriter>,
    screenshots: Option<PathBuf>,
    interval: Duration,
    due: Instant,
    drawn: u64,
    drawing: Duration,
}

impl Screen {
    pub(crate) fn open<const N: usize>(
        organ: &Organ<'_, N>,
        config: &Config,
        view: &View,
    ) -> Result<Self, ViewerError> {
        let mut screen = Self {
            renderer: None,
            window: None,
            frames: None,
            screenshots: None,
            interval: Duration::MAX,
            due: Instant::now(),
            drawn: 0,
            drawing: Duration::ZERO,
        };
        match view {
            View::Nothing => {}
            View::Frames { directory, rate_hz, picture } => {
                screen.interval = Duration::from_secs_f32(rate_hz.clamp(0.01, 1000.0).recip());
                screen.frames = Some(FrameWriter::new(directory)?);
                screen.renderer = Some(Renderer::new(organ, config.method, *picture));
            }
            View::Window { screenshots, picture } => {
                screen.interval = Duration::from_micros(33_333);
                let title = format!("palpate \u{2013} {}", organ.scene);
                screen.window = Some(ViewWindow::open(&title, picture.width, picture.height)?);
                screen.screenshots = Some(screenshots.clone());
                screen.renderer = Some(Renderer::new(organ, config.method, *picture));
            }
        }
        Ok(screen)
    }

    /// Mean time to draw a frame, ms; 0 without frames.
    pub(crate) fn mean_frame_ms(&self) -> f32 {
        if self.drawn == 0 { 0.0 } else { 1e3 * self.drawing.as_secs_f32() / self.drawn as f32 }
    }

    /// Frames written so far.
    pub(crate) fn frames_written(&self) -> u64 {
        self.frames.as_ref().map_or(0, FrameWriter::written)
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
        let begun = Instant::now();
        renderer.render(organ, record, live);
        self.drawing += begun.elapsed();
        self.drawn += 1;
        let mut wanted = self.window.is_none();
        if let Some(window) = &mut self.window {
            let image = renderer.image().clone();
            let events = window.show(&image, renderer.camera_mut())?;
            wanted = events.screenshot;
            if events.arm {
                controls.arm();
            }
            if events.disarm {
                controls.disarm();
            }
            if events.reset {
                controls.reset();
            }
            if events.quit {
                end.store(true, Ordering::Relaxed);
            }
        }
        if wanted {
            if let (None, Some(directory)) = (&self.frames, &self.screenshots) {
                self.frames = Some(FrameWriter::new(directory)?);
            }
            if let Some(frames) = &mut self.frames {
                frames.write(renderer.image())?;
            }
        }
        // From now, not from the time it was due: a slow frame is followed by a pause, not by a rush.
        self.due = (self.due + self.interval).max(Instant::now());
        Ok(())
    }
}
