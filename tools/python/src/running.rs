//! Long work beside the interpreter: progress to a callback, and Ctrl-C to the work.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::Duration;

use palpate_precompute::pipeline::Run;
use pyo3::prelude::*;

use crate::failure::Failure;

/// Time between two looks for a signal.
const LOOK: Duration = Duration::from_millis(50);

/// Takes reports, from any thread.
pub(crate) type Reporter<'r> = &'r (dyn Fn(Report) + Sync);

/// What is done, what it counts, and how many there are if that is known.
pub(crate) type Report = (&'static str, usize, Option<usize>);

/// Largest accepted number of threads: each keeps a solver in memory.
const MAX_THREADS: usize = 1024;

/// The number of threads of an argument; one a core if not given.
pub(crate) fn threads(given: Option<usize>) -> Result<usize, Failure> {
    match given {
        None => Ok(Run::run_to_end().threads.min(MAX_THREADS)),
        Some(count) if (1..=MAX_THREADS).contains(&count) => Ok(count),
        Some(count) => {
            Err(Failure::input(format!("threads = {count}: give 1 to {MAX_THREADS}, or None for one a core")))
        }
    }
}

/// Does `work` on a thread of its own, without the interpreter.
///
/// Reports go to `progress(phase, done, total)` on the calling thread; a slow callback misses some. Ctrl-C,
/// or an exception of the callback, sets the stop flag; the exception is raised when the work has ended.
pub(crate) fn interruptible<T: Send>(
    py: Python<'_>,
    threads: usize,
    progress: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(Run<'_>, Reporter<'_>) -> Result<T, Failure> + Send,
) -> Result<T, Failure> {
    let stop = AtomicBool::new(false);
    let (sender, mut reports) = channel();
    std::thread::scope(|scope| {
        let run = Run { threads, stop: &stop };
        let working = scope.spawn(move || begin(run, sender, work));
        let mut raised = None;
        loop {
            let (report, has_ended) = py.detach(|| newest(&mut reports));
            let told = match (report, progress, &raised) {
                (Some(report), Some(progress), None) => progress.call1(report).map(drop),
                _ => Ok(()),
            };
            if let Err(error) = told.and_then(|()| py.check_signals()) {
                stop.store(true, Ordering::Relaxed);
                raised.get_or_insert(error);
            }
            if has_ended {
                break;
            }
        }
        let done =
            py.detach(|| working.join()).map_err(|_| Failure::work("a thread has panicked; report it"))?;
        match raised {
            Some(error) => Err(Failure::Raised(error)),
            None => done,
        }
    })
}

/// The thread of the work; its end closes the channel.
fn begin<T>(
    run: Run<'_>,
    sender: Sender<Report>,
    work: impl FnOnce(Run<'_>, Reporter<'_>) -> Result<T, Failure>,
) -> Result<T, Failure> {
    // The receiver outlives the work.
    work(run, &|report| {
        let _ = sender.send(report);
    })
}

/// The newest report of the next moment, and whether the work has ended.
fn newest(reports: &mut Receiver<Report>) -> (Option<Report>, bool) {
    let first = reports.recv_timeout(LOOK);
    let has_ended = first == Err(RecvTimeoutError::Disconnected);
    (reports.try_iter().last().or(first.ok()), has_ended)
}
