//! The controller core on a Cortex-M4F, for QEMU's mps2-an386.
//!
//! ```text
//! golden blob in flash -> palpate-core -> semihosting: bits, instructions, stack
//! ```
//!
//! What is here is what a firmware brings beside the core: where the blob lies, and its hardware. `answers` compares the core with the
//! host's; `device` is a device that speaks the device link.
#![no_std]
#![deny(unsafe_code)]

pub mod comparison;
pub mod stack;
pub mod uart;

/// A blob wants to start at a multiple of 8; its planes are at multiples of 64.
#[repr(C, align(64))]
struct Aligned<T: ?Sized>(T);

static BLOB: &Aligned<[u8]> = &Aligned(*include_bytes!("../../golden/organ-514.blob"));

/// The golden organ, in flash.
pub static GOLDEN: &[u8] = &BLOB.0;
