//! A source of jets that repeats a recording: the same frames before the same ticks, with the same state of the
//! solver.

use palpate_core::Solver;
use palpate_host::live::{Frame, Hand, JetSource, Partner};

/// What the solver gave to one recorded tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RecordedLive {
    /// The frame taken in the tick, if there was one.
    pub(crate) frame: Option<Frame>,
    /// State of the solver.
    pub(crate) solver: Solver,
    /// Another tool on the same body.
    pub(crate) partner: Option<Partner>,
}

/// The solver of a replay. [`replay`](crate::replay()) feeds it once for each tick.
#[derive(Debug)]
pub(crate) struct ReplayJets {
    fed: rtrb::Consumer<RecordedLive>,
    solver: Solver,
    partner: Option<Partner>,
}

impl ReplayJets {
    pub(crate) const fn new(fed: rtrb::Consumer<RecordedLive>) -> Self {
        Self { fed, solver: Solver::Gone, partner: None }
    }
}

impl JetSource for ReplayJets {
    fn take(&mut self, frame: &mut Frame) -> bool {
        let Ok(recorded) = self.fed.pop() else { return false };
        (self.solver, self.partner) = (recorded.solver, recorded.partner);
        recorded.frame.inspect(|recorded| *frame = *recorded).is_some()
    }

    fn solver(&mut self, _now_ns: u64) -> Solver {
        self.solver
    }

    fn partner(&mut self, _now_ns: u64) -> Option<Partner> {
        self.partner
    }

    fn publish(&mut self, _hand: &Hand) {
        // There is nobody to tell.
    }
}
