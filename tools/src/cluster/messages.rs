//! The messages between rank 0 and the other ranks: postcard bytes, one message each.

use palpate_precompute::pipeline::Analysis;
use palpate_precompute::space::{Done, ExecutorError, Work, solver_version};
use serde::{Deserialize, Serialize};

/// Message from rank 0.
#[derive(Debug, Serialize, Deserialize)]
pub(super) enum Order {
    /// A job for one thread of the rank.
    Work {
        /// Number of the thread.
        thread: u32,
        /// The job.
        job: Box<Work>,
    },
    /// Abandon all jobs that can be abandoned; they are returned as such.
    Stop,
    /// No more messages follow; send [`Report::Gone`] and end.
    Release,
}

/// Message to rank 0.
#[derive(Debug, Serialize, Deserialize)]
pub(super) enum Report {
    /// The first message of a rank.
    Hello {
        /// Name of its host.
        host: String,
        /// Number of its solver threads.
        threads: u32,
        /// Scene and solver version, or the error that prevents the rank from working.
        basis: Result<RankConfig, String>,
    },
    /// A job is done.
    Done {
        /// Number of the thread.
        thread: u32,
        /// The outcome.
        outcome: Box<Done>,
    },
    /// The rank cannot continue.
    Stuck(ExecutorError),
    /// The last message of a rank.
    Gone,
}

/// Properties that must be equal on all ranks. Otherwise the bits would differ from those of one machine.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct RankConfig {
    /// Hash of everything in scene and mesh that affects the numbers.
    content: [u8; 32],
    /// Version of the solver, and instruction set.
    solver: String,
}

impl RankConfig {
    /// The basis of this process.
    pub(super) fn of(bench: &Analysis) -> Self {
        Self { content: bench.scene.content_hash().into(), solver: solver_version() }
    }

    /// Why a rank with basis `other` cannot work for one with this basis; `None` if it can.
    pub(super) fn objection(&self, other: &Self) -> Option<String> {
        let short =
            |hash: &[u8; 32]| format!("{:08x}", u32::from_be_bytes([hash[0], hash[1], hash[2], hash[3]]));
        if self.solver != other.solver {
            let (theirs, ours) = (&other.solver, &self.solver);
            Some(format!(
                "solves with {theirs}, rank 0 with {ours}; use the same build and the same kind of processor on all ranks"
            ))
        } else if self.content != other.content {
            let (theirs, ours) = (short(&other.content), short(&self.content));
            Some(format!(
                "has another scene or mesh ({theirs}, rank 0 has {ours}); give all ranks the same files"
            ))
        } else {
            None
        }
    }
}

/// Bytes of a message.
pub(super) fn encode(message: &impl Serialize) -> Vec<u8> {
    postcard::to_stdvec(message).expect("a vector takes everything")
}

/// The message in `bytes`; `None` if another build wrote it.
pub(super) fn decode<M: for<'de> Deserialize<'de>>(bytes: &[u8]) -> Option<M> {
    postcard::from_bytes(bytes).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_object_to_another_scene_and_to_another_processor() {
        let ours = RankConfig { content: [1; 32], solver: "1 x86_64+avx2+fma".into() };
        assert_eq!(ours.objection(&ours.clone()), None);
        let scene = ours.objection(&RankConfig { content: [2; 32], ..ours.clone() });
        assert!(
            scene.is_some_and(|line| line.contains("another scene or mesh (02020202, rank 0 has 01010101)"))
        );
        let processor = ours.objection(&RankConfig { solver: "1 x86_64+avx512f".into(), ..ours.clone() });
        assert!(processor.is_some_and(|line| line.contains("solves with 1 x86_64+avx512f")));
    }

    #[test]
    fn bytes_that_are_no_message_are_refused() {
        assert!(decode::<Order>(&[9, 9, 9]).is_none());
        assert!(matches!(decode(&encode(&Order::Release)), Some(Order::Release)));
    }
}
