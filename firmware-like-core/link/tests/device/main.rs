//! The device's side of the link: torque only where every rule is kept, and never again after a fault without a handshake.

mod bench;
mod mechanism;
mod random;
mod sessions;
mod states;
mod timing;
