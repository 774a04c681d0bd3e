//! The executor of jobs: threads of this process or processes elsewhere. The expansion uses only the trait
//! [`Executor`].

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, mpsc};
use std::thread::Builder;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::job::{Done, Work};
use super::store::{Store, StoreError};
use super::worker::{Worker, WorkerContext};
use crate::num::parallel::ThreadError;

/// Why an executor failed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum ExecutorError {
    /// A worker stopped on an internal error.
    Panicked,
    /// The start state of a job does not fit this body.
    Seed,
    /// The connection to a worker on another machine is lost.
    Lost(String),
    /// A worker returned a result that was not requested.
    UnexpectedResult,
    /// The operating system refuses to start so many threads.
    Threads(ThreadError),
}

impl std::fmt::Display for ExecutorError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Panicked => write!(f, "a worker stopped on an internal error; please report it"),
            Self::Seed => write!(f, "a stored state does not fit the body; the file is damaged"),
            Self::UnexpectedResult => {
                write!(f, "a worker returned a result that was not requested; please report it")
            }
            Self::Threads(error) => write!(f, "{error}"),
            Self::Lost(what) => {
                write!(
                    f,
                    "{what}; the unfinished work of this worker is lost; run the same command to continue"
                )
            }
        }
    }
}

/// A pool of numbered workers. Results depend on the jobs alone, not on the worker or the time.
pub trait Executor {
    /// Number of workers.
    fn size(&self) -> usize;

    /// Sends work to a worker, which may still be busy.
    fn give(&mut self, worker: usize, work: Work) -> Result<(), ExecutorError>;

    /// The next result with its worker; `None` if no result arrives within `timeout`.
    fn take(&mut self, timeout: Duration) -> Result<Option<(usize, Done)>, ExecutorError>;

    /// Cancels the work in flight where possible; cancelled work returns as [`Done::Abandoned`]. Work given
    /// after this call is not executed.
    fn stop(&mut self);
}

/// Longest wait for the next result before finished results are committed.
const COMMIT_WAIT: Duration = Duration::from_millis(100);

/// Sends the work of one store to an executor and collects its results.
pub(crate) struct Dispatcher<'a> {
    executor: &'a mut dyn Executor,
    store: &'a Store,
    stop: &'a AtomicBool,
    /// The executor was asked to stop.
    stopped: bool,
    slots: InFlight,
}

impl<'a> Dispatcher<'a> {
    /// Dispatcher with no work in flight.
    pub(crate) fn new(executor: &'a mut dyn Executor, store: &'a Store, stop: &'a AtomicBool) -> Self {
        Self {
            slots: InFlight(vec![InFlightSlot::default(); executor.size()]),
            executor,
            store,
            stop,
            stopped: false,
        }
    }

    /// Whether a stop was requested.
    pub(crate) fn is_stopping(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// The worker with the least work in flight and the active node of its last piece. `None` if every worker
    /// has two pieces or a stop was requested.
    pub(crate) fn free(&self) -> Option<(usize, Option<usize>)> {
        if self.is_stopping() { None } else { self.slots.free() }
    }

    /// Sends a worker a piece of work for this active node.
    pub(crate) fn give(&mut self, worker: usize, active: usize, work: Work) -> Result<(), ExecutorError> {
        self.executor.give(worker, work)?;
        self.slots.0[worker].pieces += 1;
        self.slots.0[worker].last = Some(active);
        Ok(())
    }

    /// Pieces of work in flight.
    pub(crate) fn out(&self) -> usize {
        self.slots.0.iter().map(|slot| slot.pieces).sum()
    }

    /// After a stop request: number of workers that still have work in flight. Their queued pieces are not
    /// started.
    pub(crate) fn stopping(&self) -> Option<usize> {
        self.is_stopping().then(|| self.slots.0.iter().filter(|slot| slot.pieces > 0).count())
    }

    /// The next result; `None` if the work was abandoned or no result arrives within [`COMMIT_WAIT`]. In the
    /// latter case the results stored so far are committed.
    pub(crate) fn take<E: From<StoreError> + From<ExecutorError>>(&mut self) -> Result<Option<Done>, E> {
        if self.is_stopping() && !std::mem::replace(&mut self.stopped, true) {
            self.executor.stop();
        }
        let Some((worker, done)) = self.executor.take(COMMIT_WAIT)? else {
            self.store.commit()?;
            return Ok(None);
        };
        self.slots.0[worker].pieces -= 1;
        match done {
            Done::Abandoned if self.stopped => Ok(None),
            Done::Abandoned => Err(ExecutorError::UnexpectedResult.into()),
            done => Ok(Some(done)),
        }
    }
}

/// Pieces of work per worker in flight: the current and the next one, so that a worker never waits for the
/// store.
const MAX_IN_FLIGHT: usize = 2;

/// In-flight work of every worker.
struct InFlight(Vec<InFlightSlot>);

#[derive(Clone, Copy, Default)]
struct InFlightSlot {
    pieces: usize,
    /// Active node of its last piece.
    last: Option<usize>,
}

impl InFlight {
    fn free(&self) -> Option<(usize, Option<usize>)> {
        let (worker, slot) = self.0.iter().enumerate().min_by_key(|(_, slot)| slot.pieces)?;
        (slot.pieces < MAX_IN_FLIGHT).then_some((worker, slot.last))
    }
}

/// Runs `work` with a pool of `threads` threads, which end when `work` returns.
///
/// # Errors
///
/// [`ExecutorError::Threads`] if the threads cannot be started; `work` then does not run.
pub fn with_threads<R, E: From<ExecutorError>>(
    context: &Arc<WorkerContext>,
    threads: usize,
    work: impl FnOnce(&mut Threads) -> Result<R, E>,
) -> Result<R, E> {
    let wanted = threads.max(1);
    std::thread::scope(|scope| {
        let (sender, done) = mpsc::channel();
        let stop = Arc::new(AtomicBool::new(false));
        let slots: Result<Vec<_>, std::io::Error> = (0..wanted)
            .map(|number| {
                let (slot, pieces) = mpsc::channel::<Work>();
                let (sender, context, stop) = (sender.clone(), context.clone(), stop.clone());
                Builder::new().spawn_scoped(scope, move || {
                    // Reports a panic. Otherwise the pool would wait for a result that never arrives.
                    let panic_report = PanicReport { number, sender: &sender };
                    let mut worker = Worker::new(context, stop);
                    for work in pieces {
                        let done = worker.work(&work).map_err(|_| ExecutorError::Seed);
                        if sender.send((number, done)).is_err() {
                            break;
                        }
                    }
                    std::mem::forget(panic_report);
                })?;
                Ok(slot)
            })
            .collect();
        drop(sender);
        // On an error the started threads end because their queues are empty and closed.
        let slots =
            slots.map_err(|why| ExecutorError::Threads(ThreadError { wanted, why: why.to_string() }))?;
        // The queues are dropped with the pool, and a worker without a queue ends.
        work(&mut Threads { slots, done, stop })
    })
}

/// Worker threads of this process.
#[derive(Debug)]
pub struct Threads {
    slots: Vec<mpsc::Sender<Work>>,
    done: mpsc::Receiver<(usize, Result<Done, ExecutorError>)>,
    stop: Arc<AtomicBool>,
}

impl Drop for Threads {
    /// Cancels the work in flight, because no result is received any more. Queued pieces are not started.
    fn drop(&mut self) {
        self.stop();
    }
}

struct PanicReport<'s> {
    number: usize,
    sender: &'s mpsc::Sender<(usize, Result<Done, ExecutorError>)>,
}

impl Drop for PanicReport<'_> {
    fn drop(&mut self) {
        let _ = self.sender.send((self.number, Err(ExecutorError::Panicked)));
    }
}

impl Executor for Threads {
    fn size(&self) -> usize {
        self.slots.len()
    }

    fn give(&mut self, worker: usize, work: Work) -> Result<(), ExecutorError> {
        self.slots[worker].send(work).map_err(|_| ExecutorError::Panicked)
    }

    fn take(&mut self, timeout: Duration) -> Result<Option<(usize, Done)>, ExecutorError> {
        match self.done.recv_timeout(timeout) {
            Ok((worker, done)) => Ok(Some((worker, done?))),
            Err(mpsc::RecvTimeoutError::Timeout) => Ok(None),
            Err(mpsc::RecvTimeoutError::Disconnected) => Err(ExecutorError::Panicked),
        }
    }

    fn stop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}
