//! Those who do the jobs: threads here, processes elsewhere ([`Crew`] is all the expansion sees of them).

use std::sync::Arc;
use std::sync::mpsc;

use serde::{Deserialize, Serialize};

use super::job::{Done, Work, Worker, Workshop};

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
}

impl std::fmt::Display for CrewError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Panicked => write!(f, "a worker stopped on an internal error; please report it"),
            Self::Seed => write!(f, "a stored state does not fit the body; the file is damaged"),
            Self::Confused => write!(f, "a worker gave back what it was not asked for; please report it"),
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

    /// Waits for whoever is done next.
    fn take(&mut self) -> Result<(usize, Done), CrewError>;
}

/// Pieces of work a worker has at once: the one it does and the next, so that it never waits for the store.
const AT_A_DESK: usize = 2;

/// What every worker of a crew has before it.
#[derive(Debug)]
pub(crate) struct Desks(Vec<Desk>);

#[derive(Debug, Clone, Copy, Default)]
struct Desk {
    pieces: usize,
    /// The active node of its last piece.
    last: Option<usize>,
}

impl Desks {
    /// Empty desks.
    pub(crate) fn of(crew: &dyn Crew) -> Self {
        Self(vec![Desk::default(); crew.size()])
    }

    /// The worker with the least to do, if any has room, and the active node it knows.
    pub(crate) fn free(&self) -> Option<(usize, Option<usize>)> {
        let (worker, desk) = self.0.iter().enumerate().min_by_key(|(_, desk)| desk.pieces)?;
        (desk.pieces < AT_A_DESK).then_some((worker, desk.last))
    }

    /// A worker was given a piece of work on this active node.
    pub(crate) fn given(&mut self, worker: usize, active: usize) {
        self.0[worker].pieces += 1;
        self.0[worker].last = Some(active);
    }

    /// A worker gave a piece back.
    pub(crate) fn taken(&mut self, worker: usize) {
        self.0[worker].pieces -= 1;
    }

    /// Whether nothing is out.
    pub(crate) fn all_clear(&self) -> bool {
        self.0.iter().all(|desk| desk.pieces == 0)
    }
}

/// Runs `work` with a crew of `threads` threads, which end with it.
pub fn with_threads<R>(workshop: &Arc<Workshop>, threads: usize, work: impl FnOnce(&mut Threads) -> R) -> R {
    std::thread::scope(|scope| {
        let (sender, done) = mpsc::channel();
        let desks = (0..threads.max(1))
            .map(|number| {
                let (desk, pieces) = mpsc::channel::<Work>();
                let (sender, workshop) = (sender.clone(), workshop.clone());
                scope.spawn(move || {
                    // Without this a panic would leave the others waiting for an outcome that never comes.
                    let alarm = Alarm { number, sender: &sender };
                    let mut worker = Worker::new(workshop);
                    for work in pieces {
                        let done = worker.work(&work).map_err(|_| CrewError::Seed);
                        if sender.send((number, done)).is_err() {
                            break;
                        }
                    }
                    std::mem::forget(alarm);
                });
                desk
            })
            .collect();
        drop(sender);
        // The desks go with the crew; a worker without a desk ends.
        work(&mut Threads { desks, done })
    })
}

/// Threads of this process.
#[derive(Debug)]
pub struct Threads {
    desks: Vec<mpsc::Sender<Work>>,
    done: mpsc::Receiver<(usize, Result<Done, CrewError>)>,
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

impl Threads {
    /// What is done already; does not wait.
    pub fn poll(&mut self) -> Result<Option<(usize, Done)>, CrewError> {
        match self.done.try_recv() {
            Ok((worker, done)) => Ok(Some((worker, done?))),
            Err(mpsc::TryRecvError::Empty) => Ok(None),
            Err(mpsc::TryRecvError::Disconnected) => Err(CrewError::Panicked),
        }
    }
}

impl Crew for Threads {
    fn size(&self) -> usize {
        self.desks.len()
    }

    fn give(&mut self, worker: usize, work: Work) -> Result<(), CrewError> {
        self.desks[worker].send(work).map_err(|_| CrewError::Panicked)
    }

    fn take(&mut self) -> Result<(usize, Done), CrewError> {
        let (worker, done) = self.done.recv().map_err(|_| CrewError::Panicked)?;
        Ok((worker, done?))
    }
}
