//! Tests of the device link from outside: frames, and the state machine of a device.

mod device;
mod frames;
mod fuzz_replay;
