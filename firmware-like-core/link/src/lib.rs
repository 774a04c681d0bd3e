//! The device link: the protocol between a host and a microcontroller that drives a haptic mechanism.
//!
//! ```text
//! HostMessage -> encode -> frame -> wire -> FrameReader -> Device::receive -> DeviceMessage -> back
//! encoders, buttons -> Device::step -> torque for the motors
//! ```
//!
//! ```
//! use palpate_link::{FrameReader, HostMessage, MAX_FRAME, VERSION, encode};
//!
//! let hello = HostMessage::Hello { version: VERSION, nonce: 7 };
//! let mut frame = [0; MAX_FRAME];
//! let mut bytes = encode(&hello, &mut frame)?;
//! let mut reader = FrameReader::<HostMessage>::new();
//! assert_eq!(reader.read(&mut bytes), Some(Ok(hello)));
//! # Ok::<(), palpate_link::EncodeError>(())
//! ```
//!
//! The crate contains both ends: the codec of the frames, and the state machine of a device. A firmware links
//! [`Device`] and [`FrameReader`]; so does the emulated device with which the host is tested. Section 7 of
//! `docs/formats.md` lists the bytes.
//!
//! - [`message`]: the messages; `frame`: their bytes on the wire;
//! - `device`: the state machine of the device; `guard`: its checks of commands and of its own motion.
//!
//! No function allocates, panics, waits or reads a clock. The crate depends on no other of the workspace, so
//! that the firmware of a device contains neither interpolation nor blobs.
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

mod device;
mod fixed;
mod frame;
mod guard;
pub mod message;

pub use device::{Device, DeviceProfile, Inputs, Outputs, Phase, ProfileError};
pub use frame::{EncodeError, FrameError, FrameReader, MAX_FRAME, encode};
pub use guard::{clamp_torque, is_newer};
pub use message::{DeviceFault, DeviceInfo, DeviceMessage, HostMessage, InfoError, Message, VERSION};
