//! The viewer: the deformed organ, the tool, the force and text, in a window or as PNG frames.
//!
//! One [`Renderer`] draws for both. It runs on an ordinary thread and reads the newest record; the haptic
//! thread never waits for it.

pub mod animation;
pub mod camera;
mod charts;
pub mod comparison;
pub mod deformation;
mod error;
pub mod font;
pub mod frames;
mod help;
pub mod image;
mod lanes;
pub mod live;
pub mod map;
pub mod material;
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

#[cfg(test)]
#[path = "../../tests/common/synthetic.rs"]
mod synthetic;

pub use animation::GifWriter;
pub use error::ViewerError;
pub use frames::FrameWriter;
pub use help::Help;
pub use image::Image;
pub use live::Live;
pub use renderer::{Layers, Renderer, RendererConfig};
pub use screen::{Frames, Screen, View};
pub use window::{ViewWindow, WindowEvents};
