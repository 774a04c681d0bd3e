//! Those who do the jobs: threads here, processes elsewhere ([`Crew`] is all the expansion sees of them).

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, mpsc};
use std::thread::Builder;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::job::{Done, Work};
use super::store::{Store, StoreError};
use super::worker::{Worker, Workshop};
use crate::num::parallel::ThreadError;

/// Why a crew cannot go on.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum CrewError {
    /// A worker stopped on an internal error.
    Panicked,
    /// The state a job started from is not one of this body.
    Seed,
    /// A worker on another machine is lost.
    Lost(String),
    /// A worker gave back what it was not asked for.
    Confused,
    /// The operating system does not start so many threads.
    Threads(ThreadError),
}

impl std::fmt::Display for CrewError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Panicked => write!(f, "a worker stopped on an internal error; please report it"),
            Self::Seed => write!(f, "a stored state does not fit the body; the file is damaged"),
            Self::Confused => write!(f, "a worker gave back what it was not asked for; please report it"),
            Self::Threads(error) => write!(f, "{error}"),
            Self::Lost(what) => write!(f, "{what}; what it was doing is lost, run the same command to go on"),
        }
    }
}

/// Workers with a number each. Outcomes depend on the jobs alone, never on who does them or when.
pub trait Crew {
    /// How many workers there are.
    fn size(&self) -> usize;

    /// Gives work to a worker; it may still be busy with something else.
    fn give(&mut self, worker: usize, work: Work) -> Result<(), CrewError>;

    /// Whoever is done next; `None` if nobody is within `patience`.
    fn take(&mut self, patience: Duration) -> Result<Option<(usize, Done)>, CrewError>;

    /// Whatever can be given up is: it comes back as [`Done::Abandoned`]. What follows is no longer worked on.
    fn stop(&mut self);
}

/// How long what is done may wait for the next before it is committed.
const PATIENCE: Duration = Duration::from_millis(100);

/// A crew at work for one store.
pub(crate) struct Shift<'a> {
    crew: &'a mut dyn Crew,
    store: &'a Store,
    stop: &'a AtomicBool,
    /// The crew knows that it is to stop.
    stopped: bool,
    desks: Desks,
}

impl<'a> Shift<'a> {
    /// A crew with nothing to do yet.
    pub(crate) fn new(crew: &'a mut dyn Crew, store: &'a Store, stop: &'a AtomicBool) -> Self {
        Self { desks: Desks(vec![Desk::default(); crew.size()]), crew, store, stop, stopped: false }
    }

    /// Whether somebody wants all of this to end.
    pub(crate) fn is_stopping(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// The worker with the least to do and the active node it knows, if it has room and there is time.
    pub(crate) fn free(&self) -> Option<(usize, Option<usize>)> {
        if self.is_stopping() { None } else { self.desks.free() }
    }

    /// Gives a worker a piece of work on this active node.
    pub(crate) fn give(&mut self, worker: usize, active: usize, work: Work) -> Result<(), CrewError> {
        self.crew.give(worker, work)?;
        self.desks.0[worker].pieces += 1;
        self.desks.0[worker].last = Some(active);
        Ok(())
    }

    /// Pieces of work that are out.
    pub(crate) fn out(&self) -> usize {
        self.desks.0.iter().map(|desk| desk.pieces).sum()
    }

    /// Once it was asked to stop: workers that still have something in hand. What lies at their desks beside it is not begun.
    pub(crate) fn stopping(&self) -> Option<usize> {
        self.is_stopping().then(|| self.desks.0.iter().filter(|desk| desk.pieces > 0).count())
    }

    /// What is done next; `None` if nothing was for a while, or was given up. Meanwhile what was done before is committed.
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

/// Pieces of work a worker has at once: the one it does and the next, so that it never waits for the store.
const AT_A_DESK: usize = 2;

/// What every worker of a crew has before it.
struct Desks(Vec<Desk>);

#[derive(Clone, Copy, Default)]
struct Desk {
    pieces: usize,
    /// The active node of its last piece.
    last: Option<usize>,
}

impl Desks {
    fn free(&self) -> Option<(usize, Option<usize>)> {
        let (worker, desk) = self.0.iter().enumerate().min_by_key(|(_, desk)| desk.pieces)?;
        (desk.pieces < AT_A_DESK).then_some((worker, desk.last))
    }
}

/// Runs `work` with a crew of `threads` threads, which end with it; an error before it begins if they do not start.
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
                    // Without this a panic would leave the others waiting for an outcome that never comes.
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
        // Those that did start end: nothing is at their desks.
        let desks = desks.map_err(|why| CrewError::Threads(ThreadError { wanted, why: why.to_string() }))?;
        // The desks go with the crew; a worker without a desk ends.
        work(&mut Threads { desks, done, stop })
    })
}

/// Threads of this process.
#[derive(Debug)]
pub struct Threads {
    desks: Vec<mpsc::Sender<Work>>,
    done: mpsc::Receiver<(usize, Result<Done, CrewError>)>,
    stop: Arc<AtomicBool>,
}

impl Drop for Threads {
    /// Nobody takes what comes now, whatever the reason: a walk is given up, and what lies at the desks is not begun.
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
