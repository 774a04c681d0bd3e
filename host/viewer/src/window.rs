//! A 30 Hz window with mouse and keys. Without a display, opening it returns an error.

use super::error::ViewerError;
use super::image::Image;
use super::navigation::Pointer;
use glam::Vec2;
use minifb::{InputCallback, Key, MouseButton, MouseMode, Window, WindowOptions};
use std::cell::RefCell;
use std::rc::Rc;

/// Events since the last frame.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct WindowEvents {
    /// Closed, or Esc.
    pub quit: bool,
    /// Space.
    pub screenshot: bool,
    /// Whether Shift and A are held (the chord that arms).
    pub arming_chord: bool,
    /// D.
    pub disarm: bool,
    /// R: clears a latched fault.
    pub reset: bool,
    /// N: the next of several models.
    pub next_model: bool,
    /// Home or 0: the initial view.
    pub home: bool,
    /// H: help on and off.
    pub help: bool,
    /// T: shape at rest on and off.
    pub ghost: bool,
    /// G: reachable region on and off.
    pub reach: bool,
    /// V: side view on and off.
    pub side: bool,
    /// 1 to 9: a knob of a live session, counted from 0.
    pub knob: Option<u8>,
}

/// The keys of the knobs.
const KNOBS: [Key; 9] =
    [Key::Key1, Key::Key2, Key::Key3, Key::Key4, Key::Key5, Key::Key6, Key::Key7, Key::Key8, Key::Key9];

/// Keys pressed since the last frame, including those released again: a tap may be shorter than a frame.
#[derive(Debug, Clone, Default)]
struct KeyPresses(Rc<RefCell<Vec<Key>>>);

impl InputCallback for KeyPresses {
    fn add_char(&mut self, _: u32) {}

    fn set_key_state(&mut self, key: Key, is_down: bool) {
        if is_down {
            self.0.borrow_mut().push(key);
        }
    }
}

/// The window.
pub struct ViewWindow {
    window: Window,
    presses: KeyPresses,
    /// Keys held at the last frame: key repeat does not count as a press.
    held: Vec<Key>,
}

impl ViewWindow {
    /// Opens a window; an error if there is no display.
    pub fn open(title: &str, width: usize, height: usize) -> Result<Self, ViewerError> {
        let options = WindowOptions { resize: false, ..WindowOptions::default() };
        let mut window = Window::new(title, width, height, options)
            .map_err(|error| ViewerError::NoDisplay(error.to_string()))?;
        // The session limits the frame rate.
        window.set_target_fps(0);
        let presses = KeyPresses::default();
        window.set_input_callback(Box::new(presses.clone()));
        Ok(Self { window, presses, held: Vec::new() })
    }

    /// Shows a picture of the window's size; returns the events and the pointer.
    pub fn show(&mut self, image: &Image) -> Result<(WindowEvents, Pointer), ViewerError> {
        self.window
            .update_with_buffer(image.pixels(), image.width(), image.height())
            .map_err(|error| ViewerError::NoDisplay(error.to_string()))?;
        let presses = self.presses.0.take();
        let pressed = |key| presses.contains(&key) && !self.held.contains(&key);
        let events = WindowEvents {
            quit: !self.window.is_open() || pressed(Key::Escape),
            screenshot: pressed(Key::Space),
            // A window without the focus keeps the keys that were held when it lost it.
            arming_chord: self.window.is_active() && self.is_shift_down() && self.window.is_key_down(Key::A),
            disarm: pressed(Key::D),
            reset: pressed(Key::R),
            home: pressed(Key::Home) || pressed(Key::Key0) || pressed(Key::NumPad0),
            help: pressed(Key::H),
            ghost: pressed(Key::T),
            reach: pressed(Key::G),
            side: pressed(Key::V),
            next_model: pressed(Key::N),
            knob: (0..).zip(KNOBS).find(|(_, key)| pressed(*key)).map(|(knob, _)| knob),
        };
        self.held = self.window.get_keys();
        Ok((events, self.pointer()))
    }

    fn is_shift_down(&self) -> bool {
        self.window.is_key_down(Key::LeftShift) || self.window.is_key_down(Key::RightShift)
    }

    fn pointer(&self) -> Pointer {
        let down = |button| self.window.get_mouse_down(button);
        let deeper = |key: Key| f32::from(u8::from(self.window.is_key_down(key)));
        Pointer {
            at_px: self.window.get_mouse_pos(MouseMode::Pass).map(|(x, y)| Vec2::new(x, y)),
            left: down(MouseButton::Left),
            other: down(MouseButton::Right) || down(MouseButton::Middle),
            shift: self.is_shift_down(),
            grasp: [Key::LeftCtrl, Key::RightCtrl, Key::E].iter().any(|key| self.window.is_key_down(*key)),
            wheel: self.window.get_scroll_wheel().map_or(0.0, |(_, steps)| steps),
            deeper: deeper(Key::W) - deeper(Key::S),
        }
    }
}

impl core::fmt::Debug for ViewWindow {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("ViewWindow").finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Only without a display: a test must not open a window on a user's display.
    #[test]
    fn without_a_display_opening_returns_an_error() {
        if std::env::var_os("DISPLAY").is_none() {
            let refused = ViewWindow::open("test", 64, 64);
            assert!(matches!(refused, Err(ViewerError::NoDisplay(_))), "{refused:?}");
        }
    }
}
