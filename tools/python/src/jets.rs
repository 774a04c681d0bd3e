//! The way of jets from the solver to the controller within one process, without a clock.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use palpate_core::Solver;
use palpate_host::live::{Frame, Hand, JetSource};
use palpate_precompute::live::{Axis, Hand as Seen, Touch};

/// Frames on the way to the controller, and the hand on the way to the solver.
#[derive(Debug, Default)]
struct Between {
    frames: VecDeque<Frame>,
    hand: Hand,
}

/// Either end of the way.
#[derive(Debug, Clone, Default)]
pub(crate) struct Way(Arc<Mutex<Between>>);

impl Way {
    fn between(&self) -> MutexGuard<'_, Between> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sends a jet.
    pub(crate) fn send(&self, frame: Frame) {
        self.between().frames.push_back(frame);
    }

    /// Number of jets that no tick has taken yet.
    pub(crate) fn waiting(&self) -> usize {
        self.between().frames.len()
    }

    /// What the solver sees of the last tick.
    pub(crate) fn seen(&self) -> Seen {
        let hand = self.between().hand;
        Seen {
            hip_m: hand.hip_m.map(f64::from),
            velocity_m_s: hand.velocity_m_s.map(f64::from),
            touch: hand.is_engaged.then(|| Touch {
                contacts: hand.engaged.map(|node| (node.space, f64::from(node.weight))),
                control_m: hand.displacement_m.map(f64::from),
            }),
            partner: None,
            axis: hand.axis.map(|axis| Axis {
                half_m: axis.half_m.map(f64::from),
                velocity_m_s: axis.velocity_m_s.map(f64::from),
            }),
        }
    }
}

impl JetSource for Way {
    fn take(&mut self, frame: &mut Frame) -> bool {
        let next = self.between().frames.pop_front();
        next.map(|next| *frame = next).is_some()
    }

    fn solver(&mut self, _now_ns: u64) -> Solver {
        // It works whenever Python lets it.
        Solver::Alive
    }

    fn publish(&mut self, hand: &Hand) {
        self.between().hand = *hand;
    }
}
