//! A process of its own that holds the device and takes the force away when the loop's process dies, stops or hangs.
//!
//! ```text
//! host process                                   supervisor process
//! loop -> Supervised (a Device) -- orders -->    serve: one exchange with the real device for each tick's order
//!                               <-- reports --   nothing for 10 ms, or nobody there: zero, latched
//! ```
//!
//! Orders and reports are datagrams of a socket pair ([`wire`]). A tick's order is the supervisor's clock and the loop's heartbeat. After
//! the supervisor has taken the force away it obeys no force until the host has said that its user has reset the fault ([`watch`]): a host
//! that comes back finds the session it rendered in closed.
//!
//! What it cannot do: if both processes are killed or stopped nobody sends zero. Nor can the host reach the device without it.

pub mod serve;
pub mod supervised;
pub mod watch;
pub mod wire;

pub use serve::{Served, serve, serve_stdin};
pub use supervised::{StartError, Supervised, Supervision};

/// Time without an order after which it takes the force away, by default, ms: the age at which a sample is a fault.
pub const DEFAULT_LIMIT_MS: u32 = 10;
