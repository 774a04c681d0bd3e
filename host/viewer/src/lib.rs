//! The viewer: the deformed organ, the tool, the force and text, in a window or as PNG frames.
//!
//! ```text
//! session (palpate-host) -> Observer: newest record, 30 Hz -> Renderer -> Image -> window | PNG
//!                                     every record         -> Live (charts, timing)
//! ```
//!
//! Inputs: organs, and the records of a session or a replay through [`Screen`], which is the session's
//! [`Observer`](palpate_host::session::Observer). Outputs: pictures, and what the user requests by key.
//!
//! Invariants:
//! - One [`Renderer`] draws for every output, on an ordinary thread: the haptic thread never waits for it.
//! - A [`Screen`] needs no device: a missing display is found before a device moves.
//!
//! Depends on palpate-core and palpate-host. Needs no GPU.
#![forbid(unsafe_code)]

mod arming;
pub mod camera;
mod charts;
mod contact;
pub mod deformation;
mod error;
pub mod font;
pub mod frames;
mod help;
pub mod image;
mod inset;
pub mod live;
pub mod map;
pub mod material;
mod mouse_tool;
pub mod navigation;
mod occlusion;
pub mod overlay;
pub mod palette;
pub mod pick;
pub mod raster;
mod reach;
mod regions;
pub mod renderer;
pub mod scene;
pub mod screen;
mod section;
pub mod shade;
pub mod shapes;
pub mod smooth;
mod still;
mod ticks;
mod tool;
mod touched;
mod verdict;
pub mod viewpoint;
pub mod window;
mod window_controller;

#[cfg(test)]
#[path = "../../tests/common/synthetic.rs"]
mod synthetic;

pub use contact::Patch;
pub use error::ViewerError;
pub use frames::FrameWriter;
pub use help::Help;
pub use image::Image;
pub use live::Live;
pub use regions::Regions;
pub use renderer::{Layers, Renderer, RendererConfig};
pub use screen::{Frames, Screen, View};
pub use verdict::Verdict;
pub use window::{ViewWindow, WindowEvents};
