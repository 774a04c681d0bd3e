//! A stand-in for the libraries of makers, written from their headers and guides; nothing of a maker's is in it. The device at its
//! other end is a file, the [`Cable`], which the emulator writes and reads.
//!
//! libHD of OpenHaptics (`hd`): one stack of errors, newest first; a frame begins without a force; values of the device outside
//! a frame are an error; forces need the scheduler and the capability; amplifiers go off after an exceeded limit and come back by
//! themselves; the first frames after the start are damaged.
//!
//! libdhd and libdrd of Force Dimension (`dhd`): errors are kept; the force of the last command stays until the next one or
//! until the firmware's watchdog; the motors go off for a cause and stay off until they are switched on.
#![allow(unsafe_code, unreachable_pub, non_snake_case, reason = "the symbols of a C interface")]

mod cable;
mod dhd;
mod hd;
mod loaded;

pub use cable::{Cable, Field, VARIABLE};
pub use loaded::Stub;

use core::ffi::{CStr, c_char};
use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

/// The file of the device, where the emulator has given it.
static FILE: Mutex<Option<Box<Path>>> = Mutex::new(None);

/// A new device of the emulator for this copy of the library, in place of that of the environment.
///
/// # Safety
///
/// `file` is a text that ends with a zero.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn palpate_fake_attach(file: *const c_char) {
    // SAFETY: the caller's.
    let file = unsafe { CStr::from_ptr(file) };
    let file = Path::new(OsStr::from_bytes(file.to_bytes()));
    *FILE.lock().unwrap_or_else(PoisonError::into_inner) = Some(file.into());
    hd::renew();
    dhd::renew();
}

/// One cycle of the library's scheduler and of the firmware, on the caller's thread.
#[unsafe(no_mangle)]
pub extern "C" fn palpate_fake_step() {
    hd::cycle();
    dhd::firmware();
}

/// The cable of this copy of the library.
fn attached() -> Option<Cable> {
    let file = FILE.lock().unwrap_or_else(PoisonError::into_inner).clone();
    file.map_or_else(Cable::of_environment, |file| Cable::open(&file).ok())
}
