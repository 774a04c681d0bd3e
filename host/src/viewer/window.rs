//! A window at 30 Hz with mouse orbit; without a display a clean error.

use super::ViewerError;
use super::camera::OrbitCamera;
use super::image::Image;
use minifb::{Key, KeyRepeat, MouseButton, MouseMode, Window, WindowOptions};

/// Radians a pixel of mouse drag.
const ORBIT_RAD_PER_PX: f32 = 0.006;
/// Zoom factor a step of the wheel.
const ZOOM_PER_STEP: f32 = 0.93;

/// What the user asked for since the last frame.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct WindowEvents {
    /// Closed, or Esc.
    pub quit: bool,
    /// Space.
    pub screenshot: bool,
    /// A: the deliberate act that arms a device.
    pub arm: bool,
    /// D.
    pub disarm: bool,
    /// R: clears a latched fault.
    pub reset: bool,
    /// N: the next of several models.
    pub next_model: bool,
}

/// The window.
pub struct ViewWindow {
    window: Window,
    drag_from: Option<(f32, f32)>,
}

impl ViewWindow {
    /// Opens a window; fails cleanly where there is no display.
    pub fn open(title: &str, width: usize, height: usize) -> Result<Self, ViewerError> {
        let options = WindowOptions { resize: false, ..WindowOptions::default() };
        let mut window = Window::new(title, width, height, options)
            .map_err(|error| ViewerError::NoDisplay(error.to_string()))?;
        // The session paces itself by the frame rate it was asked for.
        window.set_target_fps(0);
        Ok(Self { window, drag_from: None })
    }

    /// Shows a picture of the size the window was opened with, turns the camera, and returns what was pressed.
    pub fn show(&mut self, image: &Image, camera: &mut OrbitCamera) -> Result<WindowEvents, ViewerError> {
        self.window
            .update_with_buffer(image.pixels(), image.width(), image.height())
            .map_err(|error| ViewerError::NoDisplay(error.to_string()))?;
        self.turn(camera);
        let pressed = |key| self.window.is_key_pressed(key, KeyRepeat::No);
        Ok(WindowEvents {
            quit: !self.window.is_open() || pressed(Key::Escape),
            screenshot: pressed(Key::Space),
            arm: pressed(Key::A),
            disarm: pressed(Key::D),
            reset: pressed(Key::R),
            next_model: pressed(Key::N),
        })
    }

    fn turn(&mut self, camera: &mut OrbitCamera) {
        let here = self.window.get_mouse_pos(MouseMode::Pass);
        let held = self.window.get_mouse_down(MouseButton::Left);
        if let (Some((x, y)), Some((from_x, from_y)), true) = (here, self.drag_from, held) {
            camera.orbit((from_x - x) * ORBIT_RAD_PER_PX, (y - from_y) * ORBIT_RAD_PER_PX);
        }
        self.drag_from = if held { here } else { None };
        if let Some((_, steps)) = self.window.get_scroll_wheel() {
            camera.zoom(ZOOM_PER_STEP.powf(steps.clamp(-5.0, 5.0)));
        }
    }
}

impl core::fmt::Debug for ViewWindow {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("ViewWindow").field("drag_from", &self.drag_from).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Only where there is no display: where there is one, opening a window in a test would be a nuisance.
    #[test]
    fn without_a_display_opening_is_an_error_not_a_panic() {
        if std::env::var_os("DISPLAY").is_none() {
            let refused = ViewWindow::open("test", 64, 64);
            assert!(matches!(refused, Err(ViewerError::NoDisplay(_))), "{refused:?}");
        }
    }
}
