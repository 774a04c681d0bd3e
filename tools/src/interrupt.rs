//! Ctrl-C and SIGTERM: a flag for commands that keep their results, and process exit for the others.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use crate::failure::Failure;

/// A second signal ends the process at once only if it arrives this long after the first. Some senders signal
/// twice in succession, and the force on the hand must first become zero.
const SECOND_SIGNAL_DELAY: Duration = Duration::from_secs(2);

/// One flag for the process, because a handler can be set only once.
static STOP: OnceLock<Arc<AtomicBool>> = OnceLock::new();
/// When the first signal came.
static FIRST: Mutex<Option<Instant>> = Mutex::new(None);

/// Whether this run has no result yet.
static IS_BEGINNING: AtomicBool = AtomicBool::new(false);

const BEFORE_RESULTS: &str = "interrupted before the first result";

/// While it exists the first signal ends the process: this run has no result to keep.
#[derive(Debug)]
pub(crate) struct Beginning;

impl Beginning {
    /// Begins such work, unless there was a signal.
    pub(crate) fn new() -> Self {
        IS_BEGINNING.store(true, Ordering::SeqCst);
        if STOP.get().is_some_and(|stop| stop.load(Ordering::SeqCst)) {
            end(BEFORE_RESULTS);
        }
        Self
    }
}

impl Drop for Beginning {
    fn drop(&mut self) {
        IS_BEGINNING.store(false, Ordering::SeqCst);
    }
}

/// A flag that Ctrl-C and SIGTERM set. A later second signal ends the process, and the first one during a [`Beginning`].
pub(crate) fn stop_flag() -> Result<Arc<AtomicBool>, Failure> {
    if let Some(stop) = STOP.get() {
        return Ok(stop.clone());
    }
    let stop = STOP.get_or_init(Arc::default).clone();
    let raised = stop.clone();
    on_signal(move || {
        if IS_BEGINNING.load(Ordering::SeqCst) {
            end(BEFORE_RESULTS);
        }
        raised.store(true, Ordering::SeqCst);
        let mut first = FIRST.lock().unwrap_or_else(PoisonError::into_inner);
        if first.get_or_insert_with(Instant::now).elapsed() > SECOND_SIGNAL_DELAY {
            eprintln!("palpate: ended at once");
            std::process::exit(130);
        }
    })?;
    Ok(stop)
}

/// Lowers the flag for the next part of a command, which the next signal ends.
pub(crate) fn restart(stop: &AtomicBool) {
    *FIRST.lock().unwrap_or_else(PoisonError::into_inner) = None;
    stop.store(false, Ordering::SeqCst);
}

/// Ends the process at the first Ctrl-C or SIGTERM, for a command that keeps no results.
pub(crate) fn end_when_interrupted() -> Result<(), Failure> {
    on_signal(|| end("interrupted; nothing is kept"))
}

fn end(why: &str) -> ! {
    eprintln!("palpate: {why}");
    std::process::exit(1);
}

fn on_signal(handle: impl FnMut() + Send + 'static) -> Result<(), Failure> {
    ctrlc::set_handler(handle).map_err(|error| Failure::work(format!("cannot catch Ctrl-C: {error}")))
}
