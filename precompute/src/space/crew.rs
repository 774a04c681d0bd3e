//! The executor of jobs: threads of this process or processes elsewhere. The expansion uses only the trait
//! [`Crew`].

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, mpsc};
use std::thread::Builder;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::job::{Done, Work};
use super::store::{Store, StoreError};
use super::worker::{Worker, Workshop};
use crate::num::parallel::ThreadError;

/// Why an executor failed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum CrewError {
    /// A worker stopped on an internal error.
    Panicked,
    /// The start state of a job does not fit this body.
    Seed,
    /// The connection to a worker on another machine is lost.
    Lost(String),
    /// A worker returned a result that was not requested.
    Confused,
    /// The operating system refuses to start so many threads.
    Threads(ThreadError),
}

impl std::fmt::Display for CrewError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Panicked => write!(f, "a worker stopped on an internal error; please report it"),
            Self::Seed => write!(f, "a stored state does not fit the body; the file is damaged"),
            Self::Confused => {
                write!(f, "a worker returned a result that was not requested; please report it")
            }
            Self::Threads(error) => write!(f, "{error}"),
            Self::Lost(what) => {
                write!(f, "{what}; its unfinished work is lost, run the same command to continue")
            }
        }
    }
}

/// A pool of numbered workers. Results depend on the jobs alone, not on the worker or the time.
pub trait Crew {
    /// Number of workers.
    fn size(&self) -> usize;

    /// Sends work to a worker, which may still be busy.
    fn give(&mut self, worker: usize, work: Work) -> Result<(), CrewError>;

    /// The next result with its worker; `None` if no result arrives within `patience`.
    fn take(&mut self, patience: Duration) -> Result<Option<(usize, Done)>, CrewError>;

    /// Cancels what can be cancelled, which returns as [`Done::Abandoned`]. Later work is not executed.
    fn stop(&mut self);
}

/// Longest wait for the next result before finished results are committed.
const PATIENCE: Duration = Duration::from_millis(100);

/// Dispatcher of an executor for one store.
pub(crate) struct Shift<'a> {
    crew: &'a mut dyn Crew,
    store: &'a Store,
    stop: &'a AtomicBool,
    /// The executor was asked to stop.
    stopped: bool,
    desks: Desks,
}

impl<'a> Shift<'a> {
    /// Dispatcher with no work in flight.
    pub(crate) fn new(crew: &'a mut dyn Crew, store: &'a Store, stop: &'a AtomicBool) -> Self {
        Self { desks: Desks(vec![Desk::default(); crew.size()]), crew, store, stop, stopped: false }
    }

    /// Whether a stop was requested.
    pub(crate) fn is_stopping(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// The worker with the least work in flight and the active node of its last piece. `None` if every worker
    /// has enough work.
    pub(crate) fn free(&self) -> Option<(usize, Option<usize>)> {
        if self.is_stopping() { None } else { self.desks.free() }
    }

    /// Sends a worker a piece of work for this active node.
    pub(crate) fn give(&mut self, worker: usize, active: usize, work: Work) -> Result<(), CrewError> {
        self.crew.give(worker, work)?;
        self.desks.0[worker].pieces += 1;
        self.desks.0[worker].last = Some(active);
        Ok(())
    }

    /// Pieces of work in flight.
    pub(crate) fn out(&self) -> usize {
        self.desks.0.iter().map(|desk| desk.pieces).sum()
    }

    /// After a stop request: number of workers that still have work in flight. Their queued pieces are not
    /// started.
    pub(crate) fn stopping(&self) -> Option<usize> {
        self.is_stopping().then(|| self.desks.0.iter().filter(|desk| desk.pieces > 0).count())
    }

    /// The next result; `None` if none arrived within [`PATIENCE`] or it was abandoned. A wait without a
    /// result commits the earlier ones.
    pub(crate) fn take<E: From<StoreError> + From<CrewError>>(&mut self) -> Result<Option<Done>, E> {
        if self.is_stopping() && !std::mem::replace(&mut self.stopped, true) {
            self.crew.stop();
        }
        let Some((worker, done)) = self.crew.take(PATIENCE)? else {
            self.store.commit()?;
            return Ok(None);
        };
        self.desks.0[worker].pieces -= 1;
        match done {
            Done::Abandoned if self.stopped => Ok(None),
            Done::Abandoned => Err(CrewError::Confused.into()),
            done => Ok(Some(done)),
        }
    }
}

/// Pieces of work per worker in flight: the current and the next one, so that a worker never waits for the
/// store.
const AT_A_DESK: usize = 2;

/// In-flight work of every worker.
struct Desks(Vec<Desk>);

#[derive(Clone, Copy, Default)]
struct Desk {
    pieces: usize,
    /// Active node of its last piece.
    last: Option<usize>,
}

impl Desks {
    fn free(&self) -> Option<(usize, Option<usize>)> {
        let (worker, desk) = self.0.iter().enumerate().min_by_key(|(_, desk)| desk.pieces)?;
        (desk.pieces < AT_A_DESK).then_some((worker, desk.last))
    }
}

/// Runs `work` with a pool of `threads` threads, which end when `work` returns.
///
/// # Errors
///
/// [`CrewError::Threads`] if the threads cannot be started; `work` then does not run.
pub fn with_threads<R, E: From<CrewError>>(
    workshop: &Arc<Workshop>,
    threads: usize,
    work: impl FnOnce(&mut Threads) -> Result<R, E>,
) -> Result<R, E> {
    let wanted = threads.max(1);
    std::thread::scope(|scope| {
        let (sender, done) = mpsc::channel();
        let stop = Arc::new(AtomicBool::new(false));
        let desks: Result<Vec<_>, std::io::Error> = (0..wanted)
            .map(|number| {
                let (desk, pieces) = mpsc::channel::<Work>();
                let (sender, workshop, stop) = (sender.clone(), workshop.clone(), stop.clone());
                Builder::new().spawn_scoped(scope, move || {
                    // Reports a panic. Otherwise the pool would wait for a result that never arrives.
                    let alarm = Alarm { number, sender: &sender };
                    let mut worker = Worker::new(workshop, stop);
                    for work in pieces {
                        let done = worker.work(&work).map_err(|_| CrewError::Seed);
                        if sender.send((number, done)).is_err() {
                            break;
                        }
                    }
                    std::mem::forget(alarm);
                })?;
                Ok(desk)
            })
            .collect();
        drop(sender);
        // On an error the started threads end because their queues are empty and closed.
        let desks = desks.map_err(|why| CrewError::Threads(ThreadError { wanted, why: why.to_string() }))?;
        // The queues are dropped with the pool, and a worker without a queue ends.
        work(&mut Threads { desks, done, stop })
    })
}

/// Worker threads of this process.
#[derive(Debug)]
pub struct Threads {
    desks: Vec<mpsc::Sender<Work>>,
    done: mpsc::Receiver<(usize, Result<Done, CrewError>)>,
    stop: Arc<AtomicBool>,
}

impl Drop for Threads {
    /// Cancels the work in flight, because no result is received any more. Queued pieces are not started.
    fn drop(&mut self) {
        self.stop();
    }
}

struct Alarm<'s> {
    number: usize,
    sender: &'s mpsc::Sender<(usize, Result<Done, CrewError>)>,
}

impl Drop for Alarm<'_> {
    fn drop(&mut self) {
        let _ = self.sender.send((self.number, Err(CrewError::Panicked)));
    }
}

impl Crew for Threads {
    fn size(&self) -> usize {
        self.desks.len()
    }

    fn give(&mut self, worker: usize, work: Work) -> Result<(), CrewError> {
        self.desks[worker].send(work).map_err(|_| CrewError::Panicked)
    }

    fn take(&mut self, patience: Duration) -> Result<Option<(usize, Done)>, CrewError> {
        match self.done.recv_timeout(patience) {
            Ok((worker, done)) => Ok(Some((worker, done?))),
            Err(mpsc::RecvTimeoutError::Timeout) => Ok(None),
            Err(mpsc::RecvTimeoutError::Disconnected) => Err(CrewError::Panicked),
        }
    }

    fn stop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}
