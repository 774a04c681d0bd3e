//! A rank that solves: one thread for the messages, the others for the jobs.

use std::path::Path;
use std::time::Duration;

use mpi::point_to_point::MatchedReceiveVec;
use mpi::topology::SimpleCommunicator;
use mpi::traits::{Communicator, Destination, Source};
use palpate_precompute::pipeline::Analysis;
use palpate_precompute::space::{Crew, CrewError, Threads, with_threads};

use super::messages::{Basis, Order, Report, decode, encode};
use super::ranks::PAUSE;
use crate::failure::Failure;

/// Works for rank 0 until it releases this rank. Errors are sent to rank 0, which reports them.
pub(super) fn serve(world: &SimpleCommunicator, scene: &Path, desks: usize) {
    let line = || Line { world, released: false };
    let loaded = Analysis::load(scene).map_err(Failure::from);
    let ready = loaded.and_then(|bench| Ok((Basis::of(&bench), bench.workshop()?)));
    let host = mpi::environment::processor_name().unwrap_or_default();
    let hello = |basis| Report::Hello { host: host.clone(), desks: desks as u32, basis };
    let served = ready.and_then(|(basis, workshop)| {
        let served = with_threads(&workshop, desks, |crew| {
            line().serve(crew, &hello(Ok(basis)));
            Ok::<(), CrewError>(())
        });
        served.map_err(Failure::work)
    });
    if let Err(failure) = served {
        line().apologise(&hello(Err(failure.line())));
    }
}

/// The connection to rank 0.
struct Line<'w> {
    world: &'w SimpleCommunicator,
    released: bool,
}

impl Line<'_> {
    fn serve(mut self, crew: &mut Threads, hello: &Report) {
        self.say(hello, Some(crew));
        let mut stuck = false;
        while !self.released {
            let heard = self.hear(crew);
            let outcome = if stuck { Ok(None) } else { heard.and_then(|()| crew.take(Duration::ZERO)) };
            match outcome {
                Ok(Some((desk, outcome))) => {
                    let done = Report::Done { desk: desk as u32, outcome: Box::new(outcome) };
                    self.say(&done, Some(crew));
                }
                Ok(None) => std::thread::sleep(PAUSE),
                Err(error) => {
                    stuck = true;
                    self.say(&Report::Stuck(error), Some(crew));
                }
            }
        }
        self.say(&Report::Gone, None);
    }

    /// Reports why this rank cannot work, and waits for the release.
    fn apologise(mut self, hello: &Report) {
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
    fn hear(&mut self, crew: &mut Threads) -> Result<(), CrewError> {
        while let Some(order) = self.order() {
            match order {
                Some(Order::Work { desk, job }) => crew.give(desk as usize, *job)?,
                Some(Order::Stop) => crew.stop(),
                Some(Order::Release) => {}
                None => {
                    return Err(CrewError::Lost(
                        "rank 0 sent a message that this build cannot decode".into(),
                    ));
                }
            }
        }
        Ok(())
    }

    /// Sends a report and receives orders meanwhile, because two ends that only send would block each other.
    fn say(&mut self, report: &Report, mut crew: Option<&mut Threads>) {
        let bytes = encode(report);
        mpi::request::scope(|scope| {
            let mut request = self.world.process_at_rank(0).immediate_send(scope, &bytes[..]);
            loop {
                request = match request.test() {
                    Ok(_) => return,
                    Err(request) => request,
                };
                if let Some(crew) = crew.as_deref_mut() {
                    // If a thread has ended, the next report fails and gives the reason.
                    let _ = self.hear(crew);
                }
                std::thread::sleep(PAUSE);
            }
        });
    }
}
