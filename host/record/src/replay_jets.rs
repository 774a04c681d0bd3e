//! A source of jets that repeats a recording: the same frames before the same ticks, with the same state of the
//! solver.

use palpate_core::Solver;
use palpate_host::live::{Frame, Hand, JetSource};

/// What the solver gave to one recorded tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RecordedLive {
    /// The frame taken in the tick, if there was one.
    pub(crate) frame: Option<Frame>,
    /// State of the solver.
    pub(crate) solver: Solver,
}

/// The solver of a replay. [`replay`](crate::replay()) feeds it once for each tick.
#[derive(Debug)]
pub(crate) struct ReplayJets {
    fed: rtrb::Consumer<RecordedLive>,
    solver: Solver,
}

impl ReplayJets {
    pub(crate) const fn new(fed: rtrb::Consumer<RecordedLive>) -> Self {
        Self { fed, solver: Solver::Gone }
    }
}

impl JetSource for ReplayJets {
    fn take(&mut self, frame: &mut Frame) -> bool {
        let Ok(recorded) = self.fed.pop() else { return false };
        self.solver = recorded.solver;
        recorded.frame.inspect(|recorded| *frame = *recorded).is_some()
    }

    fn solver(&mut self, _now_ns: u64) -> Solver {
        self.solver
    }

    fn publish(&mut self, _hand: &Hand) {
        // There is nobody to tell.
    }
}
