//! What watches a session from outside: a screen, a recorder, a log. The session knows none of them.

use crate::live::TakenJet;
use crate::rt::{Controls, TickRecord};
use core::ops::ControlFlow;
use core::time::Duration;
use std::sync::Arc;

/// Watches a session on the thread that called [`run_session`](super::run_session).
///
/// No method runs on the haptic thread, so each may block. A closure over records is an observer that shows
/// nothing.
pub trait Observer {
    /// The queue of a recorder on a thread of its own. The session requests it once, before the loop begins.
    ///
    /// The loop fills it directly, so a slow frame loses no record of a recording.
    fn recording(&mut self) -> Option<rtrb::Producer<TickRecord>> {
        None
    }

    /// The queue of a recorder for the jets of a live solver. The session requests it once, before the loop begins.
    fn recording_jets(&mut self) -> Option<rtrb::Producer<TakenJet>> {
        None
    }

    /// The flags that the loop reads in every tick. The session requests them once, before the loop begins; an
    /// observer that keeps a clone can set them at any time, from any thread.
    fn controls(&mut self) -> Arc<Controls> {
        Arc::default()
    }

    /// Receives every record of the session's queue in order, with a delay of a few milliseconds.
    fn record(&mut self, record: &TickRecord);

    /// Time until the next picture is due. Without pictures it never is.
    fn time_to_frame(&self) -> Duration {
        Duration::MAX
    }

    /// Shows the newest record when a picture is due; `controls` passes on what the user requests.
    ///
    /// `Break` ends the session: the user quits, or nothing can be shown any more. The session does not call
    /// it again; the observer keeps its error for its owner.
    fn show(&mut self, newest: &TickRecord, controls: &Controls) -> ControlFlow<()> {
        let _ = (newest, controls);
        ControlFlow::Continue(())
    }
}

impl<F: FnMut(&TickRecord)> Observer for F {
    fn record(&mut self, record: &TickRecord) {
        self(record);
    }
}
