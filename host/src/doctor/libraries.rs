//! Checks of the libraries of makers: they are loaded, and no device is opened.

use super::Check;
use super::Verdict::{Bad, Good};
use crate::device::maker::LibraryError;
use crate::device::maker::touch::Hd;

/// The library of the Touch and the Phantom.
#[must_use]
pub fn openhaptics() -> Check {
    const NAME: &str = "openhaptics";
    match Hd::load(None) {
        Ok((_, file)) => Check::new(NAME, Good, format!("{}, for --device touch", file.display())),
        Err(LibraryError::Missing { .. }) => {
            Check::new(NAME, Good, "not installed: only --device touch (3D Systems Touch, Phantom) needs it")
        }
        Err(error) => {
            let found = error.to_string();
            let (found, fix) = found.split_once("; ").unwrap_or((&found, ""));
            Check::new(NAME, Bad, found).fix([fix])
        }
    }
}
