//! A stand-in for libHD of OpenHaptics, written from its headers and its programmer's guide; nothing of the maker's is in it.
//! The device at its other end is a file, the [`Cable`], which the emulator writes and reads.
//!
//! As the guide says: one stack of errors, newest first; a frame begins without a force; values of the device outside a frame
//! are an error; forces need the scheduler and the capability; amplifiers go off after an exceeded limit and come back by
//! themselves; the first frames after the start are damaged.
#![allow(unsafe_code, unreachable_pub, non_snake_case, reason = "the symbols of a C interface")]

mod cable;
mod functions;

pub use cable::{Cable, Field, VARIABLE};
