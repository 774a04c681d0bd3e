//! Exchanges with a device whose library or service has no thread for them: a thread of ours.

use crate::sys::{RtRequest, enter_real_time};
use core::sync::atomic::{AtomicBool, Ordering};
use core::time::Duration;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::thread::{Builder, JoinHandle};
use std::time::Instant;

/// Time between two exchanges: half a tick, so that a force and a sample wait for each other no longer.
const PERIOD: Duration = Duration::from_micros(500);

/// Exchanges with an open device, one after another.
pub trait Cycle: Send {
    /// One exchange. It may wait for the device, as long as it has to.
    fn run(&mut self);

    /// Sends a last zero and closes the device.
    fn close(&mut self);
}

/// The thread of a cycle. The device is closed when this is dropped.
#[derive(Debug)]
pub struct Cycles {
    stopping: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Cycles {
    /// Starts the thread, with real-time priority if the system gives it.
    pub fn start(mut cycle: Box<dyn Cycle>, fifo_priority: Option<i32>) -> io::Result<Self> {
        let stopping = Arc::new(AtomicBool::new(false));
        let is_stopping = stopping.clone();
        let run = move || {
            let (_, _held) = enter_real_time(&RtRequest { fifo_priority, ..RtRequest::none() });
            let mut due = Instant::now();
            while !is_stopping.load(Ordering::Acquire) {
                // Without this, a panic would leave the last force on the motors.
                if catch_unwind(AssertUnwindSafe(|| cycle.run())).is_err() {
                    break;
                }
                due = (due + PERIOD).max(Instant::now() - PERIOD);
                std::thread::sleep(due.saturating_duration_since(Instant::now()));
            }
            cycle.close();
        };
        let thread = Builder::new().name("haptic-device".into()).spawn(run)?;
        Ok(Self { stopping, thread: Some(thread) })
    }
}

impl Drop for Cycles {
    fn drop(&mut self) {
        self.stopping.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::sync::atomic::AtomicU32;

    struct Counted {
        runs: Arc<AtomicU32>,
        closed: Arc<AtomicBool>,
        panics: bool,
    }

    impl Cycle for Counted {
        fn run(&mut self) {
            assert!(self.runs.fetch_add(1, Ordering::Relaxed) < 5 || !self.panics, "planted");
        }

        fn close(&mut self) {
            self.closed.store(true, Ordering::Relaxed);
        }
    }

    #[test]
    fn a_device_is_closed_at_the_end_and_after_a_panic() {
        for panics in [false, true] {
            let (runs, closed) = (Arc::new(AtomicU32::new(0)), Arc::new(AtomicBool::new(false)));
            let cycle = Counted { runs: runs.clone(), closed: closed.clone(), panics };
            let cycles = Cycles::start(Box::new(cycle), None).expect("a thread");
            while runs.load(Ordering::Relaxed) < 6 {
                std::thread::sleep(PERIOD);
            }
            if panics {
                while !closed.load(Ordering::Relaxed) {
                    std::thread::sleep(PERIOD);
                }
            }
            drop(cycles);
            assert!(closed.load(Ordering::Relaxed), "{panics}");
        }
    }
}
