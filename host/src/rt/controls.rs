//! What other threads ask of the loop: arming, disarming, a reset, another model. Flags, taken up at the next tick.

use super::Applied;
use core::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use palpate_core::{Fault, State};

/// Most models in one session.
pub const MOST_MODELS: usize = u8::MAX as usize - 1;
/// No model was asked for.
const NO_MODEL: u8 = u8::MAX;

/// Requests from other threads, taken up at the next tick.
#[derive(Debug)]
pub struct Controls {
    arm: AtomicBool,
    disarm: AtomicBool,
    reset: AtomicBool,
    model: AtomicU8,
    /// Only a replay asks for it: a watchdog has fired.
    zeroed: AtomicBool,
}

impl Default for Controls {
    fn default() -> Self {
        let no = || AtomicBool::new(false);
        Self { arm: no(), disarm: no(), reset: no(), model: AtomicU8::new(NO_MODEL), zeroed: no() }
    }
}

impl Controls {
    /// Starts rendering. For a real device this must stand for a deliberate act of the user.
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

    /// Goes on with another model; after the last comes the first again.
    pub fn select(&self, model: u8) {
        self.model.store(model, Ordering::Relaxed);
    }

    /// The model that was asked for since the last tick, if any.
    pub(super) fn take_model(&self) -> Option<u8> {
        Some(self.model.swap(NO_MODEL, Ordering::Relaxed)).filter(|model| *model != NO_MODEL)
    }

    /// Asks again for what was done before a recorded tick.
    pub fn repeat(&self, applied: Applied) {
        self.reset.store(applied.reset, Ordering::Relaxed);
        self.arm.store(applied.arm, Ordering::Relaxed);
        self.disarm.store(applied.disarm, Ordering::Relaxed);
        self.zeroed.store(applied.zeroed, Ordering::Relaxed);
    }

    /// Disarming goes last, so that it wins over whatever was asked in the same tick. A device that is not ready is not armed, and no key
    /// that was pressed while the loop stood still arms or resets.
    pub(super) fn apply(&self, state: &mut State, ready: bool, zeroed: bool) -> Applied {
        let zeroed = self.zeroed.swap(false, Ordering::Relaxed) || zeroed;
        let applied = Applied {
            zeroed,
            reset: self.reset.swap(false, Ordering::Relaxed) && !zeroed,
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
