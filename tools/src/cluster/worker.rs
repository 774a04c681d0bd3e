//! A rank that solves: one thread for the messages, the others for the jobs.

use std::path::Path;
use std::time::Duration;

use mpi::point_to_point::MatchedReceiveVec;
use mpi::topology::SimpleCommunicator;
use mpi::traits::{Communicator, Destination, Source};
use palpate_precompute::pipeline::Analysis;
use palpate_precompute::space::{Executor, ExecutorError, Threads, with_threads};

use super::messages::{Order, RankConfig, Report, decode, encode};
use super::ranks::PAUSE;
use crate::analysis::{is_space, of_space};
use crate::failure::Failure;

/// Works for rank 0 until it releases this rank. Errors are sent to rank 0, which reports them.
pub(super) fn serve(world: &SimpleCommunicator, scene: &Path, threads: usize) {
    let line = || Line { world, released: false };
    let loaded = if is_space(scene) { of_space(scene) } else { Analysis::load(scene).map_err(Failure::from) };
    let ready = loaded.and_then(|bench| Ok((RankConfig::of(&bench), bench.context()?)));
    let host = mpi::environment::processor_name().unwrap_or_default();
    let hello = |basis| Report::Hello { host: host.clone(), threads: threads as u32, basis };
    let served = ready.and_then(|(basis, context)| {
        let served = with_threads(&context, threads, |executor| {
            line().serve(executor, &hello(Ok(basis)));
            Ok::<(), ExecutorError>(())
        });
        served.map_err(Failure::work)
    });
    if let Err(failure) = served {
        line().report_failure(&hello(Err(failure.line())));
    }
}

/// The connection to rank 0.
struct Line<'w> {
    world: &'w SimpleCommunicator,
    released: bool,
}

impl Line<'_> {
    fn serve(mut self, executor: &mut Threads, hello: &Report) {
        self.say(hello, Some(executor));
        let mut stuck = false;
        while !self.released {
            let heard = self.receive_orders(executor);
            let outcome = if stuck { Ok(None) } else { heard.and_then(|()| executor.take(Duration::ZERO)) };
            match outcome {
                Ok(Some((thread, outcome))) => {
                    let done = Report::Done { thread: thread as u32, outcome: Box::new(outcome) };
                    self.say(&done, Some(executor));
                }
                Ok(None) => std::thread::sleep(PAUSE),
                Err(error) => {
                    stuck = true;
                    self.say(&Report::Stuck(error), Some(executor));
                }
            }
        }
        self.say(&Report::Gone, None);
    }

    /// Reports why this rank cannot work, and waits for the release.
    fn report_failure(mut self, hello: &Report) {
        self.say(hello, None);
        while !self.released {
            match self.order() {
                Some(_) => {}
                None => std::thread::sleep(PAUSE),
            }
        }
        self.say(&Report::Gone, None);
    }

    /// A received order, if there is one.
    fn order(&mut self) -> Option<Option<Order>> {
        let found = self.world.process_at_rank(0).immediate_matched_probe()?;
        let order = decode(&found.matched_receive_vec::<u8>().0);
        self.released |= matches!(order, Some(Order::Release));
        Some(order)
    }

    /// Passes the received orders on.
    fn receive_orders(&mut self, executor: &mut Threads) -> Result<(), ExecutorError> {
        while let Some(order) = self.order() {
            match order {
                Some(Order::Work { thread, job }) => executor.give(thread as usize, *job)?,
                Some(Order::Stop) => executor.stop(),
                Some(Order::Release) => {}
                None => {
                    return Err(ExecutorError::Lost(
                        "rank 0 sent a message that this build cannot decode".into(),
                    ));
                }
            }
        }
        Ok(())
    }

    /// Sends a report and receives orders meanwhile, because two ends that only send would block each other.
    fn say(&mut self, report: &Report, mut executor: Option<&mut Threads>) {
        let bytes = encode(report);
        mpi::request::scope(|scope| {
            let mut request = self.world.process_at_rank(0).immediate_send(scope, &bytes[..]);
            loop {
                request = match request.test() {
                    Ok(_) => return,
                    Err(request) => request,
                };
                if let Some(executor) = executor.as_deref_mut() {
                    // If a thread has ended, the next report fails and gives the reason.
                    let _ = self.receive_orders(executor);
                }
                std::thread::sleep(PAUSE);
            }
        });
    }
}
