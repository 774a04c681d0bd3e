//! The device's side of the link: a torque acts only if every rule holds, and after a fault only after a new
//! handshake.

mod bench;
mod mechanism;
mod random;
mod sessions;
mod states;
mod timing;
