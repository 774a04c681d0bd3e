//! The executor of jobs: threads of this process or processes elsewhere. The expansion uses only the trait
//! [`Executor`].

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, mpsc};
use std::thread::Builder;
use std::time::Duration;

use super::job::{Done, ExecutorError, Work};
use super::store::{Store, StoreError};
use super::worker::{Worker, WorkerContext};
use crate::num::parallel::ThreadError;

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

/// Pieces of work per worker in flight: the current and the next one, so that a worker never waits for the
/// store.
const MAX_IN_FLIGHT: usize = 2;

/// Work of one worker in flight.
#[derive(Clone, Copy, Default)]
struct InFlight {
    pieces: usize,
    /// Active node of the last piece.
    last: Option<usize>,
}

/// Sends the work of one store to an executor and collects its results.
pub(crate) struct Dispatcher<'a> {
    executor: &'a mut dyn Executor,
    store: &'a Store,
    stop: &'a AtomicBool,
    executor_told: bool,
    /// By worker.
    in_flight: Vec<InFlight>,
}

impl<'a> Dispatcher<'a> {
    /// Dispatcher with no work in flight.
    pub(crate) fn new(executor: &'a mut dyn Executor, store: &'a Store, stop: &'a AtomicBool) -> Self {
        let in_flight = vec![InFlight::default(); executor.size()];
        Self { in_flight, executor, store, stop, executor_told: false }
    }

    /// Whether a stop was requested.
    pub(crate) fn is_stopping(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// The worker with the least work in flight and the active node of its last piece. `None` if every worker
    /// has two pieces or a stop was requested.
    pub(crate) fn free(&self) -> Option<(usize, Option<usize>)> {
        let (worker, work) = self.in_flight.iter().enumerate().min_by_key(|(_, work)| work.pieces)?;
        (work.pieces < MAX_IN_FLIGHT && !self.is_stopping()).then_some((worker, work.last))
    }

    /// Sends a worker a piece of work for this active node.
    pub(crate) fn give(&mut self, worker: usize, active: usize, work: Work) -> Result<(), ExecutorError> {
        self.executor.give(worker, work)?;
        let InFlight { pieces, last } = &mut self.in_flight[worker];
        (*pieces, *last) = (*pieces + 1, Some(active));
        Ok(())
    }

    /// Whether no work is in flight.
    pub(crate) fn is_idle(&self) -> bool {
        self.in_flight.iter().all(|work| work.pieces == 0)
    }

    /// After a stop request: number of workers that still have work in flight. Their queued pieces are not
    /// started.
    pub(crate) fn busy_after_stop(&self) -> Option<usize> {
        self.is_stopping().then(|| self.in_flight.iter().filter(|work| work.pieces > 0).count())
    }

    /// The next result; `None` if the work was abandoned or no result arrives within [`COMMIT_WAIT`]. In the
    /// latter case the results stored so far are committed.
    pub(crate) fn take<E: From<StoreError> + From<ExecutorError>>(&mut self) -> Result<Option<Done>, E> {
        if self.is_stopping() && !std::mem::replace(&mut self.executor_told, true) {
            self.executor.stop();
        }
        let Some((worker, done)) = self.executor.take(COMMIT_WAIT)? else {
            self.store.commit()?;
            return Ok(None);
        };
        self.in_flight[worker].pieces -= 1;
        match done {
            Done::Abandoned if self.executor_told => Ok(None),
            Done::Abandoned => Err(ExecutorError::UnexpectedResult.into()),
            done => Ok(Some(done)),
        }
    }
}

/// Runs `run` with a pool of `threads` threads, which end when `run` returns.
///
/// # Errors
///
/// [`ExecutorError::Threads`] if the threads cannot be started; `run` is then not called.
pub fn with_threads<R, E: From<ExecutorError>>(
    context: &Arc<WorkerContext>,
    threads: usize,
    run: impl FnOnce(&mut Threads) -> Result<R, E>,
) -> Result<R, E> {
    let wanted = threads.max(1);
    std::thread::scope(|scope| {
        let (sender, done) = mpsc::channel();
        let stop = Arc::new(AtomicBool::new(false));
        let queues: Result<Vec<_>, std::io::Error> = (0..wanted)
            .map(|number| {
                let (queue, pieces) = mpsc::channel::<Work>();
                let (sender, context, stop) = (sender.clone(), context.clone(), stop.clone());
                Builder::new().spawn_scoped(scope, move || {
                    let mut worker = Worker::new(context, stop);
                    for piece in pieces {
                        // A panic is reported. Otherwise the pool would wait for a result that never arrives.
                        // The run ends with it, and the half-changed worker solves nothing more.
                        let done = catch_unwind(AssertUnwindSafe(|| worker.execute(&piece)));
                        let done = done.unwrap_or(Err(ExecutorError::Panicked));
                        let panicked = matches!(done, Err(ExecutorError::Panicked));
                        if sender.send((number, done)).is_err() || panicked {
                            break;
                        }
                    }
                })?;
                Ok(queue)
            })
            .collect();
        drop(sender);
        // On an error the started threads end because their queues are empty and closed.
        let queues =
            queues.map_err(|why| ExecutorError::Threads(ThreadError { wanted, why: why.to_string() }))?;
        // The queues are dropped with the pool, and a worker without a queue ends.
        run(&mut Threads { queues, done, stop })
    })
}

/// Worker threads of this process.
#[derive(Debug)]
pub struct Threads {
    queues: Vec<mpsc::Sender<Work>>,
    done: mpsc::Receiver<(usize, Result<Done, ExecutorError>)>,
    stop: Arc<AtomicBool>,
}

impl Drop for Threads {
    /// Cancels the work in flight, because no result is received any more. Queued pieces are not started.
    fn drop(&mut self) {
        self.stop();
    }
}

impl Executor for Threads {
    fn size(&self) -> usize {
        self.queues.len()
    }

    fn give(&mut self, worker: usize, work: Work) -> Result<(), ExecutorError> {
        self.queues[worker].send(work).map_err(|_| ExecutorError::Panicked)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::space::Task;
    use crate::space::job::Job;
    use crate::spec::{Lattice, Sampling, SpaceGrid};

    #[test]
    fn a_panic_of_a_worker_is_an_error_of_the_run() {
        let grid = SpaceGrid::new(0.01, 0.03).expect("a lattice");
        let sampling = Sampling::Lattice(Lattice { grid, complete_cells: false, increments: None });
        let context = WorkerContext::new(|_, _| panic!("planted"), sampling, 1.0);
        let task = Task { target: [0; 3], attempt: 0, round: 0, parent: None, chart: None };
        let work = Work::Point(Job { active: 0, task, seed: None });
        let ended: Result<(), ExecutorError> = with_threads(&Arc::new(context), 1, |threads| {
            threads.give(0, work)?;
            while threads.take(Duration::from_secs(60))?.is_none() {}
            Ok(())
        });
        assert_eq!(ended, Err(ExecutorError::Panicked));
    }
}
