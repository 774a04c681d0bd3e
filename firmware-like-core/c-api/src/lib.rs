//! The controller core for C and C++.
//!
//! ```text
//! blob in memory -> palpate_organ_open -> palpate_controller_open -> palpate_tick (1 kHz) -> hand force
//! ```
//!
//! Inputs: pointers from C. Outputs: plain structures, and a status from every call.
//!
//! Invariants:
//! - all state lies in memory of the caller. Nothing is allocated or global, so any number of organs and
//!   controllers may exist at the same time, and none has to be closed;
//! - a null pointer, an index out of range and an unknown method each give a status, never a crash; a call
//!   that fails writes zero force;
//! - the caller guarantees what the library cannot check: a pointer that is not null points to a value of its
//!   type, and the blob and the organ exist as long as the objects opened on them.
//!
//! Only `memory.rs` converts memory of the caller into Rust references. The four functions that receive a
//! pointer with a length are therefore unsafe. The other arguments are `Option<&T>`, which are nullable
//! pointers in C.
#![cfg_attr(not(any(test, feature = "std")), no_std)]

mod controller;
mod memory;
mod organ;
mod status;

pub use controller::*;
pub use organ::*;
pub use status::*;

/// Never called: `check-host` proves that no code path leads here.
#[cfg(not(any(test, feature = "std")))]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {}
}

/// A planted fault that `check-host` must detect: an unchecked index.
///
/// cbindgen:ignore
#[cfg(palpate_planted)]
#[unsafe(no_mangle)]
pub extern "C" fn palpate_planted(index: usize) -> u8 {
    core::hint::black_box([1, 2, 3])[index]
}
