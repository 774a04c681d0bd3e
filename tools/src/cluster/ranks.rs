//! The other ranks as an executor on rank 0.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use mpi::point_to_point::MatchedReceiveVec;
use mpi::topology::SimpleCommunicator;
use mpi::traits::{Communicator, Destination, Source};
use palpate_precompute::space::{Done, Executor, ExecutorError, Work};

use super::messages::{Order, RankConfig, Report, decode, encode};
use crate::failure::Failure;

/// Pause between two polls for a message. A blocking MPI receive would keep a core busy that solver threads
/// can use.
pub(super) const PAUSE: Duration = Duration::from_micros(100);

/// MPI's buffer for jobs in flight, bytes. Without it a send of more than some kilobytes lasts until the
/// receiver polls for it. That takes milliseconds if all its cores are solving.
pub(super) const BUFFER: usize = 256 << 20;

/// All ranks except 0. They are released on drop, for any reason.
pub(super) struct Ranks<'w> {
    world: &'w SimpleCommunicator,
    /// Whether a rank has not yet sent its last message.
    present: Vec<bool>,
    /// Rank and thread of every worker, the first threads of all ranks first.
    threads: Vec<(i32, u32)>,
    /// Bytes of the jobs in flight of each worker, oldest first, and their sum: an upper bound of the used
    /// part of the buffer.
    unanswered: Vec<VecDeque<usize>>,
    buffered: usize,
}

impl<'w> Ranks<'w> {
    /// The ranks of `world`, before their first messages.
    pub(super) fn new(world: &'w SimpleCommunicator) -> Self {
        let mut present = vec![true; world.size() as usize];
        present[0] = false;
        Self { world, present, threads: Vec::new(), unanswered: Vec::new(), buffered: 0 }
    }

    /// Waits for the first message of every rank and checks that all have the same basis.
    pub(super) fn check_ranks(&mut self, ours: &RankConfig, stop: &AtomicBool) -> Result<(), Failure> {
        for _ in 1..self.world.size() {
            let (rank, report) = loop {
                match self.look().map_err(Failure::work)? {
                    Some(found) => break found,
                    None if stop.load(Ordering::Relaxed) => return Err(Failure::work("interrupted")),
                    None => std::thread::sleep(PAUSE),
                }
            };
            let Report::Hello { host, threads, basis } = report else {
                return Err(Failure::work(format!(
                    "rank {rank} did not start with a Hello message; use the same build on all ranks"
                )));
            };
            let objection = match basis {
                Ok(theirs) => ours.objection(&theirs),
                Err(line) => Some(line),
            };
            if let Some(line) = objection {
                return Err(Failure::input(format!("rank {rank} on {host} {line}")));
            }
            self.threads.extend((0..threads).map(|thread| (rank, thread)));
        }
        self.threads.sort_by_key(|&(rank, thread)| (thread, rank));
        self.unanswered = vec![VecDeque::new(); self.threads.len()];
        Ok(())
    }

    /// Number of jobs that the ranks can solve at once.
    pub(super) fn workers(&self) -> usize {
        self.threads.len()
    }

    /// A received message, if there is one.
    fn look(&mut self) -> Result<Option<(i32, Report)>, ExecutorError> {
        let Some(found) = self.world.any_process().immediate_matched_probe() else { return Ok(None) };
        let (bytes, status) = found.matched_receive_vec::<u8>();
        let rank = status.source_rank();
        let report = decode(&bytes).ok_or_else(|| {
            ExecutorError::Lost(format!("rank {rank} sent a message that this build cannot decode"))
        })?;
        if matches!(report, Report::Gone) {
            self.present[rank as usize] = false;
        }
        Ok(Some((rank, report)))
    }

    /// Sends a job. The send does not wait while at most half of the buffer is used; the rest allows for
    /// fragmentation.
    fn hand(&mut self, worker: usize, job: Work) {
        let (rank, thread) = self.threads[worker];
        let bytes = encode(&Order::Work { thread, job: Box::new(job) });
        let to = self.world.process_at_rank(rank);
        self.unanswered[worker].push_back(bytes.len());
        self.buffered += bytes.len();
        if self.buffered <= BUFFER / 2 { to.buffered_send(&bytes[..]) } else { to.send(&bytes[..]) }
    }

    /// The worker that an outcome comes from.
    fn answered(&mut self, rank: i32, thread: u32) -> Option<usize> {
        let worker = self.threads.iter().position(|&at| at == (rank, thread))?;
        self.buffered -= self.unanswered[worker].pop_front()?;
        Some(worker)
    }

    /// Ranks that have not ended.
    fn others(&self) -> Vec<i32> {
        (0..).zip(&self.present).filter_map(|(rank, present)| present.then_some(rank)).collect()
    }

    fn tell(&self, rank: i32, order: &Order) {
        self.world.process_at_rank(rank).send(&encode(order)[..]);
    }
}

impl Drop for Ranks<'_> {
    fn drop(&mut self) {
        for rank in self.others() {
            self.tell(rank, &Order::Release);
        }
        // Outcomes in flight are received, because their senders cannot end before that.
        while self.present.contains(&true) {
            if matches!(self.look(), Ok(None)) {
                std::thread::sleep(PAUSE);
            }
        }
    }
}

/// The executor, after [`Ranks::check_ranks`].
impl Executor for Ranks<'_> {
    fn size(&self) -> usize {
        self.workers()
    }

    fn give(&mut self, worker: usize, job: Work) -> Result<(), ExecutorError> {
        self.hand(worker, job);
        Ok(())
    }

    fn take(&mut self, timeout: Duration) -> Result<Option<(usize, Done)>, ExecutorError> {
        let until = Instant::now() + timeout;
        let (rank, report) = loop {
            match self.look()? {
                Some(found) => break found,
                None if Instant::now() >= until => return Ok(None),
                None => std::thread::sleep(PAUSE),
            }
        };
        match report {
            Report::Done { thread, outcome } => {
                let unasked =
                    || ExecutorError::Lost(format!("rank {rank} returned a result that was not requested"));
                let worker = self.answered(rank, thread).ok_or_else(unasked)?;
                Ok(Some((worker, *outcome)))
            }
            Report::Stuck(error) => Err(error),
            Report::Hello { .. } | Report::Gone => {
                Err(ExecutorError::Lost(format!("rank {rank} ended too early")))
            }
        }
    }

    fn stop(&mut self) {
        for rank in self.others() {
            self.tell(rank, &Order::Stop);
        }
    }
}
