//! The viewer: the deformed organ, the tool, the force and text, in a window or as PNG frames.
//!
//! One [`Renderer`] draws for both. It runs on an ordinary thread and reads the newest record; the haptic
//! thread never waits for it.

pub mod animation;
pub mod camera;
mod charts;
pub mod comparison;
pub mod font;
pub mod frames;
mod help;
pub mod image;
mod lanes;
pub mod live;
pub mod map;
mod mouse_tool;
pub mod navigation;
mod occlusion;
pub mod overlay;
pub mod palette;
pub mod pick;
mod quantise;
pub mod raster;
mod reach;
pub mod renderer;
pub mod scene;
pub mod screen;
pub mod shade;
pub mod shapes;
pub mod smooth;
pub mod viewpoint;
pub mod window;
mod window_controller;

pub use animation::GifWriter;
pub use frames::FrameWriter;
pub use image::Image;
pub use live::Live;
pub use renderer::{Help, Layers, Renderer, RendererConfig};
pub use screen::View;
pub use window::{ViewWindow, WindowEvents};

use core::fmt;

/// Reason why nothing can be shown.
#[derive(Debug)]
pub enum ViewerError {
    /// No display. Use --headless.
    NoDisplay(String),
    /// A frame could not be written.
    Frame(std::io::Error),
}

impl fmt::Display for ViewerError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoDisplay(reason) => write!(f, "no display for a window ({reason}): use --headless"),
            Self::Frame(error) => write!(f, "cannot write a frame: {error}"),
        }
    }
}

impl core::error::Error for ViewerError {}

impl From<std::io::Error> for ViewerError {
    fn from(error: std::io::Error) -> Self {
        Self::Frame(error)
    }
}
