//! The device link: what a microcontroller that drives a mechanism and its host say to each other.
//!
//! ```text
//! HostMessage -> encode -> frame -> wire -> FrameReader -> Device::receive -> DeviceMessage -> the same way back
//! encoders, buttons -> Device::step -> torque for the motors
//! ```
//!
//! Both ends are here: the codec, and the rules that a device keeps. A firmware links [`Device`] and
//! [`FrameReader`]; so does the emulated device that the host is tested with. `docs/formats.md`, section 7, has the bytes.
//!
//! - [`message`]: the messages, [`frame`]: their bytes on the wire;
//! - [`device`]: the device's state machine, [`guard`]: what it checks a command and its own motion with.
//!
//! As in the rest of the core nothing allocates, panics, waits or reads a clock.

pub mod device;
mod fixed;
pub mod frame;
pub mod guard;
pub mod message;

pub use device::{Device, DeviceProfile, Inputs, Outputs, Phase};
pub use frame::{EncodeError, FrameCounts, FrameError, FrameReader, MAX_FRAME, encode};
pub use message::{DeviceFault, DeviceInfo, DeviceMessage, HostMessage, InfoError, Message, VERSION};
