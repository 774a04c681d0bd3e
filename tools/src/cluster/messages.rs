//! What rank 0 and the other ranks tell each other: postcard bytes, one message each.

use palpate_precompute::pipeline::Analysis;
use palpate_precompute::space::{CrewError, Done, Work, solver_version};
use serde::{Deserialize, Serialize};

/// From rank 0.
#[derive(Debug, Serialize, Deserialize)]
pub(super) enum Order {
    /// A job for one of the rank's threads.
    Work {
        /// Which thread.
        desk: u32,
        /// The job.
        job: Box<Work>,
    },
    /// What can be given up is: it comes back as abandoned.
    Stop,
    /// Nothing more comes; say [`Report::Gone`] and end.
    Release,
}

/// To rank 0.
#[derive(Debug, Serialize, Deserialize)]
pub(super) enum Report {
    /// The first word of a rank.
    Hello {
        /// Where it runs.
        host: String,
        /// Threads that it works with.
        desks: u32,
        /// What it works on, or why it cannot.
        basis: Result<Basis, String>,
    },
    /// A job is done.
    Done {
        /// Which thread did it.
        desk: u32,
        /// What it found.
        outcome: Box<Done>,
    },
    /// The rank cannot go on.
    Stuck(CrewError),
    /// The last word of a rank.
    Gone,
}

/// What all ranks must agree on, or bits would not be those of one machine.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Basis {
    /// Hash over everything in scene and mesh that changes numbers.
    content: [u8; 32],
    /// Version of the solver, and instruction set.
    solver: String,
}

impl Basis {
    /// What this process would work on.
    pub(super) fn of(bench: &Analysis) -> Self {
        Self { content: bench.scene.content_hash().into(), solver: solver_version() }
    }

    /// Why a rank with basis `other` cannot work for one with this basis; `None` if it can.
    pub(super) fn objection(&self, other: &Self) -> Option<String> {
        let short =
            |hash: &[u8; 32]| format!("{:08x}", u32::from_be_bytes([hash[0], hash[1], hash[2], hash[3]]));
        if self.solver != other.solver {
            let (theirs, ours) = (&other.solver, &self.solver);
            Some(format!("solves with {theirs}, rank 0 with {ours}; use one build on processors of one kind"))
        } else if self.content != other.content {
            let (theirs, ours) = (short(&other.content), short(&self.content));
            Some(format!(
                "has another scene or mesh ({theirs}, rank 0 has {ours}); all must see the same files"
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

/// The message in `bytes`; `None` if another build wrote them.
pub(super) fn decode<M: for<'de> Deserialize<'de>>(bytes: &[u8]) -> Option<M> {
    postcard::from_bytes(bytes).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_object_to_another_scene_and_to_another_processor() {
        let ours = Basis { content: [1; 32], solver: "1 x86_64+avx2+fma".into() };
        assert_eq!(ours.objection(&ours.clone()), None);
        let scene = ours.objection(&Basis { content: [2; 32], ..ours.clone() });
        assert!(
            scene.is_some_and(|line| line.contains("another scene or mesh (02020202, rank 0 has 01010101)"))
        );
        let processor = ours.objection(&Basis { solver: "1 x86_64+avx512f".into(), ..ours.clone() });
        assert!(processor.is_some_and(|line| line.contains("solves with 1 x86_64+avx512f")));
    }

    #[test]
    fn bytes_that_are_no_message_are_refused() {
        assert!(decode::<Order>(&[9, 9, 9]).is_none());
        assert!(matches!(decode(&encode(&Order::Release)), Some(Order::Release)));
    }
}
