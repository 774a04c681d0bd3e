//! Controller of a window: navigation, keys and screenshots.

use super::arming::ArmingChord;
use super::error::ViewerError;
use super::frames::FrameWriter;
use super::help::Help;
use super::mouse_tool::MouseTool;
use super::navigation::Navigation;
use super::renderer::{Renderer, RendererConfig};
use super::window::{ViewWindow, WindowEvents};
use core::time::Duration;
use palpate_core::Organ;
use palpate_host::device::mouse::MouseHandle;
use palpate_host::rt::TickRecord;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// A window and the actions of its keys and mouse.
pub(super) struct WindowController {
    window: ViewWindow,
    navigation: Navigation,
    /// Moves the tool if the mouse is the device.
    hand: Option<MouseTool>,
    directory: PathBuf,
    screenshots: Option<FrameWriter>,
    arming: ArmingChord,
    /// Time of the last picture.
    shown: Instant,
}

/// What the user requests of the session.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Requests {
    /// Arm: the chord was held for its time.
    pub arm: bool,
    /// Disarm.
    pub disarm: bool,
    /// Clear a latched fault.
    pub reset: bool,
    /// Change to the next model.
    pub next_model: bool,
    /// Turn this knob of a live session.
    pub knob: Option<u8>,
    /// End the session.
    pub quit: bool,
}

impl WindowController {
    pub(super) fn open(
        title: &str,
        directory: &Path,
        picture: RendererConfig,
        mouse: Option<MouseHandle>,
    ) -> Result<Self, ViewerError> {
        Ok(Self {
            window: ViewWindow::open(title, picture.width, picture.height)?,
            navigation: Navigation::default(),
            hand: mouse.map(MouseTool::new),
            directory: directory.to_owned(),
            screenshots: None,
            arming: ArmingChord::Spent,
            shown: Instant::now(),
        })
    }

    /// The initial help.
    pub(super) const fn help(&self) -> Help {
        if self.hand.is_some() { Help::KeysAndHand } else { Help::Keys }
    }

    /// Number of screenshots.
    pub(super) fn written(&self) -> u64 {
        self.screenshots.as_ref().map_or(0, FrameWriter::written)
    }

    /// Shows the renderer's picture and performs the user's actions; returns the requests to the session.
    pub(super) fn show<const N: usize>(
        &mut self,
        renderer: &mut Renderer,
        organ: &Organ<'_, N>,
        record: &TickRecord,
    ) -> Result<Requests, ViewerError> {
        let (events, pointer) = self.window.show(renderer.image())?;
        if events.screenshot {
            let writer = match &mut self.screenshots {
                Some(writer) => writer,
                none => none.insert(FrameWriter::new(&self.directory)?),
            };
            writer.write(renderer.image())?;
        }
        let taken =
            self.hand.as_mut().is_some_and(|hand| hand.update(&renderer.view(), organ, &pointer, record));
        let height_px = renderer.image().height();
        self.navigation.update(&pointer, taken, renderer.camera_mut(), height_px);
        if events.home {
            renderer.reset_view();
        }
        let help = self.help();
        let layers = renderer.layers_mut();
        layers.ghost ^= events.ghost;
        layers.reach ^= events.reach;
        layers.side ^= events.side;
        if events.help {
            layers.help = if layers.help == help { Help::Hint } else { help };
        }
        let step = core::mem::replace(&mut self.shown, Instant::now()).elapsed();
        let requests = self.requests(events, step, record);
        layers.arming = self.arming.remaining();
        Ok(requests)
    }

    /// The requests to the session. A request to disarm or to reset also ends a countdown.
    fn requests(&mut self, events: WindowEvents, step: Duration, record: &TickRecord) -> Requests {
        let WindowEvents { disarm, reset, next_model, knob, quit, .. } = events;
        if disarm || reset {
            self.arming.cancel();
        }
        let arm = self.arming.update(events.arming_chord, step, record);
        Requests { arm, disarm, reset, next_model, knob, quit }
    }
}
