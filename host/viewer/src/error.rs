//! The error of the viewer.

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
