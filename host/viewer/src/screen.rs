//! The screen of a session or a replay: a window, files, or nothing, driven by the calling thread.

use super::error::ViewerError;
use super::frames::FrameWriter;
use super::live::Live;
use super::regions::Regions;
use super::renderer::{Renderer, RendererConfig};
use super::verdict::Verdict;
use super::window_controller::WindowController;
use core::fmt;
use core::ops::ControlFlow;
use core::time::Duration;
use palpate_core::{Organ, vec3};
use palpate_host::device::mouse::MouseHandle;
use palpate_host::first_place::first_place;
use palpate_host::live::SolverView;
use palpate_host::rt::{Controls, TickRecord};
use palpate_host::session::Observer;
use std::path::PathBuf;
use std::time::Instant;

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
    /// A window.
    Window {
        /// Directory of screenshots.
        screenshots: PathBuf,
        /// Size and sampling.
        picture: RendererConfig,
        /// The mouse device whose tool the window moves.
        mouse: Option<MouseHandle>,
    },
}

/// The pictures of a session.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Frames {
    /// Number of pictures written to files.
    pub written: u64,
    /// Mean time to draw a picture, ms; 0 without pictures.
    pub mean_ms: f32,
}

impl fmt::Display for Frames {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "frames       {} written, {:.1} ms each to draw", self.written, self.mean_ms)
    }
}

/// Height of the tool above its first place before a device reports its position, m.
const WAITING_HEIGHT_M: f32 = 0.03;

/// A record before the first tick: no device, the tool above its first place.
fn at_rest<const N: usize>(organ: &Organ<'_, N>) -> TickRecord {
    let hip_m = organ.spaces.get(first_place(organ)).map_or(vec3::ZERO, |space| {
        vec3::add(space.active.rest_position_m, vec3::scale(space.active.outward_normal, WAITING_HEIGHT_M))
    });
    TickRecord { hip_m, ..TickRecord::EMPTY }
}

/// The screen of a session: an [`Observer`] that draws the newest record.
///
/// It needs no device, so a caller opens it first: a missing display is found before a device moves.
pub struct Screen<'s, 'o, const N: usize> {
    organs: &'s [&'s Organ<'o, N>],
    renderer: Option<Renderer>,
    output: Output,
    live: Live,
    interval: Duration,
    due: Instant,
    drawn: u64,
    drawing: Duration,
    /// The first failure of the output. It ended the session.
    failure: Option<ViewerError>,
}

impl<const N: usize> fmt::Debug for Screen<'_, '_, N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Screen")
            .field("interval", &self.interval)
            .field("drawn", &self.drawn)
            .finish_non_exhaustive()
    }
}

/// The output.
enum Output {
    Nothing,
    Frames(FrameWriter),
    Window(Box<WindowController>),
}

impl<'s, 'o, const N: usize> Screen<'s, 'o, N> {
    /// Opens the window or the files. The first organ is shown until a record names another.
    ///
    /// # Errors
    ///
    /// [`ViewerError`]: no display, or a file that cannot be created.
    pub fn open(organs: &'s [&'s Organ<'o, N>], method: &str, view: &View) -> Result<Self, ViewerError> {
        let nothing = |organs| Self::of(organs, Output::Nothing, Duration::MAX, None);
        let Some(organ) = organs.first() else { return Ok(nothing(organs)) };
        let renderer = |picture: &RendererConfig| {
            let mut renderer = Renderer::new(organ, method, *picture);
            renderer.set_models(organs.len());
            renderer
        };
        let interval = |rate_hz: f32| Duration::from_secs_f32(rate_hz.clamp(0.01, 1000.0).recip());
        Ok(match view {
            View::Nothing => nothing(organs),
            View::Frames { directory, rate_hz, picture } => {
                let output = Output::Frames(FrameWriter::new(directory)?);
                Self::of(organs, output, interval(*rate_hz), Some(renderer(picture)))
            }
            View::Window { screenshots, picture, mouse } => {
                let title = format!("palpate \u{2013} {}", organ.scene);
                let controller = WindowController::open(&title, screenshots, *picture, mouse.clone())?;
                let mut renderer = renderer(picture);
                renderer.layers_mut().help = controller.help();
                let output = Output::Window(Box::new(controller));
                let mut screen = Self::of(organs, output, interval(30.0), Some(renderer));
                // Homing a device can take a minute: the window shows the organ from the start.
                screen.draw(&at_rest(organ), &Controls::default())?;
                screen
            }
        })
    }

    fn of(
        organs: &'s [&'s Organ<'o, N>],
        output: Output,
        interval: Duration,
        renderer: Option<Renderer>,
    ) -> Self {
        Self {
            organs,
            renderer,
            output,
            live: Live::new(),
            interval,
            due: Instant::now(),
            drawn: 0,
            drawing: Duration::ZERO,
            failure: None,
        }
    }

    /// Sets the certificate's verdict on each active node of each organ, see [`Renderer::set_verdicts`].
    pub fn set_verdicts(&mut self, verdicts: Vec<Vec<Verdict>>) {
        if let Some(renderer) = &mut self.renderer {
            renderer.set_verdicts(verdicts);
        }
    }

    /// Sets the boundaries of regions inside the body, see [`Renderer::set_regions`].
    pub fn set_regions(&mut self, regions: &Regions) {
        if let Some(renderer) = &mut self.renderer {
            renderer.set_regions(regions);
        }
    }

    /// Sets the live solver that shows the displacements, see [`Renderer::set_solver`].
    pub fn set_solver(&mut self, solver: SolverView) {
        if let Some(renderer) = &mut self.renderer {
            renderer.set_solver(Some(solver));
        }
    }

    /// Sets a line under the title, for example what was changed last.
    pub fn set_note(&mut self, note: String) {
        if let Some(renderer) = &mut self.renderer {
            renderer.set_note(note);
        }
    }

    /// Time between two pictures; `None` if it shows nothing.
    pub fn interval(&self) -> Option<Duration> {
        self.renderer.as_ref().map(|_| self.interval)
    }

    /// Whether it is a window, which a user watches in real time.
    pub fn is_window(&self) -> bool {
        matches!(self.output, Output::Window(_))
    }

    /// The pictures so far.
    pub fn frames(&self) -> Frames {
        let written = match &self.output {
            Output::Nothing => 0,
            Output::Frames(frames) => frames.written(),
            Output::Window(controller) => controller.written(),
        };
        let mean_ms =
            if self.drawn == 0 { 0.0 } else { 1e3 * self.drawing.as_secs_f32() / self.drawn as f32 };
        Frames { written, mean_ms }
    }

    /// The pictures of the session.
    ///
    /// # Errors
    ///
    /// The first failure of the output, which ended the session.
    pub fn finish(mut self) -> Result<Frames, ViewerError> {
        if let Some(error) = self.failure.take() {
            return Err(error);
        }
        Ok(self.frames())
    }

    /// Draws and puts out one picture; true if the user quits.
    fn draw(&mut self, record: &TickRecord, controls: &Controls) -> Result<bool, ViewerError> {
        let organ = self.organs.get(usize::from(record.model)).or(self.organs.first());
        let (Some(renderer), Some(organ)) = (&mut self.renderer, organ) else { return Ok(false) };
        let started = Instant::now();
        renderer.render(organ, record, &mut self.live);
        self.drawing += started.elapsed();
        self.drawn += 1;
        let mut quit = false;
        match &mut self.output {
            Output::Nothing => {}
            Output::Frames(frames) => {
                frames.write(renderer.image())?;
            }
            Output::Window(controller) => {
                let requests = controller.show(renderer, organ, record)?;
                if requests.arm {
                    controls.arm();
                }
                if requests.disarm {
                    controls.disarm();
                }
                if requests.reset {
                    controls.reset();
                }
                if requests.next_model {
                    // The index after the last one wraps round to the first.
                    controls.select(record.model + 1);
                }
                if let Some(knob) = requests.knob {
                    controls.turn(knob);
                }
                quit = requests.quit;
            }
        }
        // Counted from now, not from the due time: a slow frame is not followed by a burst.
        self.due = (self.due + self.interval).max(Instant::now());
        Ok(quit)
    }
}

impl<const N: usize> Observer for Screen<'_, '_, N> {
    fn record(&mut self, record: &TickRecord) {
        self.live.push(record);
    }

    fn time_to_frame(&self) -> Duration {
        match self.renderer {
            Some(_) => self.due.saturating_duration_since(Instant::now()),
            None => Duration::MAX,
        }
    }

    fn show(&mut self, newest: &TickRecord, controls: &Controls) -> ControlFlow<()> {
        // Before the first tick there is no place of the tool.
        let waiting =
            self.organs.first().filter(|_| *newest == TickRecord::EMPTY).map(|organ| at_rest(organ));
        match self.draw(waiting.as_ref().unwrap_or(newest), controls) {
            Ok(false) => ControlFlow::Continue(()),
            Ok(true) => ControlFlow::Break(()),
            Err(error) => {
                self.failure.get_or_insert(error);
                ControlFlow::Break(())
            }
        }
    }
}
