//! Touch with a live solver: a process beside the session solves where the hand goes, and sends jets.
//!
//! ```text
//! session process                                            solver process
//! loop: LiveField = JetMemory + LoopEnd  <- shared memory ->  SolverEnd: read Hand, solve, send jets, beat
//! viewer: SolverView                     <-                   displacements of the surface
//! SolverProcess                          <- socket ->         Service: progress, the organ, lines of text
//! ```
//!
//! The solver's process has the finite elements; this crate knows neither them nor how the solver chooses a
//! position. Per tick the loop takes at most one frame, and it never waits: a full queue makes the solver wait.
//!
//! Either may end or hang at any time. The session's end closes the socket, at which the solver exits. The
//! solver's end, or a heartbeat older than [`SILENT_NS`] and [`GONE_NS`], is a [`palpate_core::Solver`] state of
//! the next tick, and the core lets the force fade.

mod channel;
mod field;
mod hand;
mod message;
mod partner;
mod ring;
mod second;
mod serve;
mod start;

pub use channel::{
    Counters, GONE_NS, Heart, LoopEnd, SILENT_NS, SessionEnded, SolverEnd, SolverMeter, SolverView, Work,
    local,
};
pub use field::{CONTACTS, JETS, JetSource, LiveCounts, LiveField, LiveTick, TakenJet};
pub use hand::{Axis, Hand, VelocityFilter};
pub use partner::{LinkState, Partner, PartnerLink, STALE_NS};
pub use ring::RING_FRAMES;
pub use second::{SecondError, SecondSession, link_of_stdin};
pub use serve::{Service, Serving};
pub use start::{Ready, SolverProcess, StartError, start, start_at};

/// The bytes of one jet.
pub type Frame = [u8; palpate_core::Jet::FRAME_LEN];
