//! The controller core on a Cortex-M4F, for QEMU's mps2-an386.
//!
//! ```text
//! golden blob in flash -> palpate-core -> semihosting: bits, instructions, stack
//! ```
//!
//! These are the parts that a firmware adds to the core: the location of the blob, and its hardware.
//! `answers` compares the core with that of the host; `device` is a device of the device link.
#![no_std]
#![deny(unsafe_code)]

pub mod comparison;
pub mod stack;
pub mod uart;

use palpate_core::Aligned;

static BLOB: &Aligned<[u8]> = &Aligned(*include_bytes!("../../golden/organ-514.blob"));

/// The golden organ, in flash.
pub static GOLDEN: &[u8] = &BLOB.0;
