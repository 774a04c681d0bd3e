//! A process that owns the device and zeroes the force when the loop's process dies, stops or hangs.
//!
//! ```text
//! host process                                   supervisor process
//! loop -> Supervised (a Device) -- orders -->    serve: one exchange with the real device per tick order
//!                               <-- reports --   no order for 10 ms, or the host is gone: zero, latched
//! ```
//!
//! Orders and reports are datagrams of a socket pair ([`wire`]). The order of a tick is the clock of the
//! supervisor and the heartbeat of the loop. After the supervisor has zeroed the force it ignores forces
//! until the host reports that its user has reset the fault ([`watch`]): a host that resumes finds its
//! session ended.
//!
//! Limits: if both processes are killed or stopped, no zero is sent. Without the supervisor the host cannot
//! reach the device.

pub mod serve;
pub mod supervised;
pub mod watch;
pub mod wire;

pub use serve::{ServeSummary, serve, serve_stdin};
pub use supervised::{StartError, Supervised, Supervision};

/// Default time without an order after which it zeroes the force, ms: the age at which a sample becomes a
/// fault.
pub const DEFAULT_LIMIT_MS: u32 = 10;
