//! The controller core for C and C++.
//!
//! ```text
//! blob in memory -> palpate_organ_open -> palpate_controller_open -> palpate_tick, each millisecond -> hand force
//! ```
//!
//! In: pointers from C. Out: plain structures, and a status for every call.
//!
//! Invariants:
//! - state lies in memory of the caller: nothing is allocated, nothing is global, so any number of organs and controllers may live at
//!   once, and nothing needs to be closed;
//! - a null pointer, an index out of range, an unknown method is a status, never a crash; a call that fails writes zero force;
//! - what cannot be checked is the caller's to keep: that a pointer that is not null points to what its type says, and that the blob and
//!   the organ outlive what was opened on them.
//!
//! Bytes of the caller become Rust's in `memory.rs` alone; four functions pass it pointers with lengths, and are unsafe therefore. Arguments
//! elsewhere are `Option<&T>`, which C sees as pointers that may be null.
#![cfg_attr(not(any(test, feature = "std")), no_std)]

mod controller;
mod memory;
mod organ;
mod status;

pub use controller::*;
pub use organ::*;
pub use status::*;

/// Reached by nothing: `check-host` proves that no path leads here.
#[cfg(not(any(test, feature = "std")))]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {}
}

/// What the proof must find: an index that nobody checked.
///
/// cbindgen:ignore
#[cfg(palpate_planted)]
#[unsafe(no_mangle)]
pub extern "C" fn palpate_planted(index: usize) -> u8 {
    core::hint::black_box([1, 2, 3])[index]
}
