//! The guard: a sibling process that zeroes the device if the session's process dies, stops or hangs. The
//! session zeroes the device and ends if its guard dies, and latches a fault while it is stopped.
//!
//! ```text
//! session process                                   guard process
//! loop -> Guarded -> driver -> descriptor           duplicate of the descriptor
//!            |-- loop beat -->  shared page  <-- guard beat, fence --|
//!            |-- pidfd of the guard                  pidfd of the session --|
//! ```
//!
//! While the loop beats, the guard never touches the device, so a sample reaches the tick without a detour. If
//! the beat is older than the limit, or the session's process has ended, the guard closes the fence and writes
//! the zero message, again once per limit. A closed fence keeps every later force of the session back until the
//! user resets ([`crate::device::fence`]).
//!
//! A pidfd reports an end at once; a process that is stopped (SIGSTOP) has not ended, so heartbeats go both
//! ways. Limits: the session is lost within the time after the guard stopped in which the session has not yet
//! noticed (the limit, 10 ms); both are lost at once (the PC fails); a process is stopped between the driver's
//! look at the fence and its write, and sends one old request when it resumes, which the next tick zeroes.

mod guarded;
mod serve;
mod setup;
mod start;
mod watch;

pub use guarded::{Guarded, Guarding};
pub use serve::{GuardSummary, guard, guard_stdin};
pub use start::{DEFAULT_LIMIT_MS, GuardOptions, GuardStatus, try_start};
