//! Those who do the jobs: threads here, processes elsewhere ([`Crew`] is all the expansion sees of them).

use std::sync::Arc;
use std::sync::mpsc;

use serde::{Deserialize, Serialize};

use super::job::{Job, Outcome, Worker, Workshop};

/// Why a crew cannot go on.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum CrewError {
    /// A worker stopped on an internal error.
    Panicked,
    /// The state a job started from is not one of this body.
    Seed,
    /// A worker on another machine is lost.
    Lost(String),
}

impl std::fmt::Display for CrewError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Panicked => write!(f, "a worker stopped on an internal error; please report it"),
            Self::Seed => write!(f, "a stored state does not fit the body; the file is damaged"),
            Self::Lost(what) => write!(f, "{what}; what it was doing is lost, run the same command to go on"),
        }
    }
}

/// Workers with a number each. Outcomes depend on the jobs alone, never on who does them or when.
pub trait Crew {
    /// How many workers there are.
    fn size(&self) -> usize;

    /// Gives a job to a worker; it may still be busy with another one.
    fn give(&mut self, worker: usize, job: Job) -> Result<(), CrewError>;

    /// Waits for the next outcome, whoever has it.
    fn take(&mut self) -> Result<(usize, Outcome), CrewError>;
}

/// Runs `work` with a crew of `threads` threads, which end with it.
pub fn with_threads<R>(workshop: &Arc<Workshop>, threads: usize, work: impl FnOnce(&mut Threads) -> R) -> R {
    std::thread::scope(|scope| {
        let (sender, outcomes) = mpsc::channel();
        let desks = (0..threads.max(1))
            .map(|number| {
                let (desk, jobs) = mpsc::channel::<Job>();
                let (sender, workshop) = (sender.clone(), workshop.clone());
                scope.spawn(move || {
                    // Without this a panic would leave the others waiting for an outcome that never comes.
                    let alarm = Alarm { number, sender: &sender };
                    let mut worker = Worker::new(workshop);
                    for job in jobs {
                        let outcome = worker.work(&job).map_err(|_| CrewError::Seed);
                        if sender.send((number, outcome)).is_err() {
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
        work(&mut Threads { desks, outcomes })
    })
}

/// Threads of this process.
#[derive(Debug)]
pub struct Threads {
    desks: Vec<mpsc::Sender<Job>>,
    outcomes: mpsc::Receiver<(usize, Result<Outcome, CrewError>)>,
}

struct Alarm<'s> {
    number: usize,
    sender: &'s mpsc::Sender<(usize, Result<Outcome, CrewError>)>,
}

impl Drop for Alarm<'_> {
    fn drop(&mut self) {
        let _ = self.sender.send((self.number, Err(CrewError::Panicked)));
    }
}

impl Threads {
    /// An outcome that is there already; does not wait.
    pub fn poll(&mut self) -> Result<Option<(usize, Outcome)>, CrewError> {
        match self.outcomes.try_recv() {
            Ok((worker, outcome)) => Ok(Some((worker, outcome?))),
            Err(mpsc::TryRecvError::Empty) => Ok(None),
            Err(mpsc::TryRecvError::Disconnected) => Err(CrewError::Panicked),
        }
    }
}

impl Crew for Threads {
    fn size(&self) -> usize {
        self.desks.len()
    }

    fn give(&mut self, worker: usize, job: Job) -> Result<(), CrewError> {
        self.desks[worker].send(job).map_err(|_| CrewError::Panicked)
    }

    fn take(&mut self) -> Result<(usize, Outcome), CrewError> {
        let (worker, outcome) = self.outcomes.recv().map_err(|_| CrewError::Panicked)?;
        Ok((worker, outcome?))
    }
}
