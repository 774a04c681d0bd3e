//! Requests of other threads to the loop: arm, disarm, reset, select a model. They are flags that the next
//! tick reads.

use super::record::Applied;
use core::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use palpate_core::{Fault, State};

/// Largest number of models in one session.
pub const MAX_MODELS: usize = u8::MAX as usize - 1;
/// No model, or no knob, is requested.
const NONE: u8 = u8::MAX;

/// Requests from other threads, applied at the next tick.
#[derive(Debug)]
pub struct Controls {
    arm: AtomicBool,
    disarm: AtomicBool,
    reset: AtomicBool,
    model: AtomicU8,
    /// Not read by the loop: a knob of the model of a live session.
    knob: AtomicU8,
    /// Set by a replay only: the device was zeroed before this tick.
    zeroed: AtomicBool,
}

impl Default for Controls {
    fn default() -> Self {
        let no = || AtomicBool::new(false);
        let [model, knob] = [NONE; 2].map(AtomicU8::new);
        Self { arm: no(), disarm: no(), reset: no(), model, knob, zeroed: no() }
    }
}

impl Controls {
    /// Starts rendering. On a real device it must come from a deliberate act of the user.
    pub fn arm(&self) {
        self.arm.store(true, Ordering::Relaxed);
    }

    /// Stops rendering.
    pub fn disarm(&self) {
        self.disarm.store(true, Ordering::Relaxed);
    }

    /// Clears a latched fault, which leaves the controller disarmed.
    pub fn reset(&self) {
        self.reset.store(true, Ordering::Relaxed);
    }

    /// Selects another model; the index wraps round.
    pub fn select(&self, model: u8) {
        self.model.store(model, Ordering::Relaxed);
    }

    /// Takes the model requested since the last tick, if any.
    pub(super) fn take_model(&self) -> Option<u8> {
        Some(self.model.swap(NONE, Ordering::Relaxed)).filter(|model| *model != NONE)
    }

    /// Turns a knob of a live session, counted from 0.
    pub fn turn(&self, knob: u8) {
        self.knob.store(knob, Ordering::Relaxed);
    }

    /// Takes the knob turned since the last call. Not for the loop.
    pub fn take_knob(&self) -> Option<u8> {
        Some(self.knob.swap(NONE, Ordering::Relaxed)).filter(|knob| *knob != NONE)
    }

    /// Repeats the requests that were applied before a recorded tick.
    pub fn repeat(&self, applied: Applied) {
        self.reset.store(applied.reset, Ordering::Relaxed);
        self.arm.store(applied.arm, Ordering::Relaxed);
        self.disarm.store(applied.disarm, Ordering::Relaxed);
        self.zeroed.store(applied.zeroed, Ordering::Relaxed);
    }

    /// Applies the requests. Disarming comes last, so it overrides other requests of the same tick. A device
    /// that is not ready is not armed. A key that was pressed while the loop was stalled neither arms nor
    /// resets. `reset_device` clears the zero latch of the device; where it fails, nothing is reset.
    pub(super) fn apply(
        &self,
        state: &mut State,
        ready: bool,
        zeroed: bool,
        reset_device: impl FnOnce() -> bool,
    ) -> Applied {
        let zeroed = self.zeroed.swap(false, Ordering::Relaxed) || zeroed;
        let applied = Applied {
            zeroed,
            reset: self.reset.swap(false, Ordering::Relaxed) && !zeroed && reset_device(),
            arm: self.arm.swap(false, Ordering::Relaxed) && ready && !zeroed,
            disarm: self.disarm.swap(false, Ordering::Relaxed),
        };
        if applied.zeroed {
            state.trip(Fault::Watchdog);
        }
        if applied.reset {
            state.reset();
        }
        if applied.arm {
            state.arm();
        }
        if applied.disarm {
            state.disarm();
        }
        applied
    }
}
