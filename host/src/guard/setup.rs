//! The two messages between a session and its guard: what to guard, and that it is guarded. Both processes are
//! the same program.

use crate::device::fence::Wire;
use serde::{Deserialize, Serialize};

/// The session's message. The page, the device and the session's process come with it as descriptors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Setup {
    /// Time without a tick after which the guard zeroes the force, ms.
    pub limit_ms: u32,
    /// SCHED_FIFO priority to request.
    pub fifo_priority: Option<i32>,
    /// Whether to request locked memory.
    pub locks_memory: bool,
    /// How bytes reach the device.
    pub wire: Wire,
}

/// The guard's reply.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Ready {
    /// Its SCHED_FIFO priority; 0 for ordinary scheduling.
    pub fifo_priority: i32,
}

impl Setup {
    /// Longest encoding.
    pub(super) const MAX_LEN: usize = 32;

    pub(super) fn encode(&self) -> Vec<u8> {
        postcard::to_allocvec(self).expect("four small fields")
    }

    pub(super) fn decode(bytes: &[u8]) -> Option<Self> {
        postcard::from_bytes(bytes).ok().filter(|setup: &Self| setup.limit_ms > 0)
    }
}

impl Ready {
    /// Longest encoding.
    pub(super) const MAX_LEN: usize = 8;

    pub(super) fn encode(&self) -> Vec<u8> {
        postcard::to_allocvec(self).expect("one small field")
    }

    pub(super) fn decode(bytes: &[u8]) -> Option<Self> {
        postcard::from_bytes(bytes).ok()
    }
}
