//! A function of ours in the cycle of the library's scheduler.
#![allow(unsafe_code)]

use super::api::{CALLBACK_CONTINUE, CALLBACK_DONE, Hd, Scheduled};
use core::ffi::c_void;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Called in every cycle, until it returns false.
type Work = Box<dyn FnMut() -> bool + Send>;

/// What the callback gets.
struct Data {
    hd: Hd,
    device: u32,
    work: Work,
}

/// The function while it is in the cycle.
#[derive(Debug)]
pub(super) struct Running {
    hd: Hd,
    scheduled: Scheduled,
    data: *mut Data,
}

// SAFETY: only the scheduler's thread uses the data while the callback is in the cycle, and its owner afterwards.
unsafe impl Send for Running {}

/// Unwinding into the library would end the process with the last force on the motors. A frame without a force sends zero.
unsafe extern "C" fn cycle(data: *mut c_void) -> core::ffi::c_uint {
    // SAFETY: `begin` has given this pointer, which is valid until `end`, and only this thread uses it.
    let data = unsafe { &mut *data.cast::<Data>() };
    match catch_unwind(AssertUnwindSafe(|| (data.work)())) {
        Ok(true) => CALLBACK_CONTINUE,
        Ok(false) => CALLBACK_DONE,
        Err(_) => {
            data.hd.begin(data.device);
            data.hd.end(data.device);
            CALLBACK_DONE
        }
    }
}

impl Running {
    /// Puts the work for a device into the cycle.
    pub(super) fn begin(hd: Hd, device: u32, work: Work) -> Self {
        let data = Box::into_raw(Box::new(Data { hd, device, work }));
        // SAFETY: the callback's data, valid until `end`, or for good.
        let scheduled = unsafe { hd.schedule(cycle, data.cast()) };
        Self { hd, scheduled, data }
    }
}

impl Running {
    /// Takes the work out of the cycle. `has_ended`: it has returned false, so it is not called again. Work that hangs in the
    /// library keeps its memory.
    pub(super) fn end(self, has_ended: bool) {
        self.hd.stop();
        self.hd.unschedule(self.scheduled);
        if has_ended {
            // SAFETY: of `begin`, and the callback has returned for the last time.
            drop(unsafe { Box::from_raw(self.data) });
        }
    }
}
