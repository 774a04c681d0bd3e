//! Work shared among threads, all of which start before the work begins.
//!
//! The result of an item depends on the item alone, so the bits do not depend on the number of threads.

use rayon::iter::{IndexedParallelIterator, IntoParallelIterator, IntoParallelRefIterator, ParallelIterator};
use rayon::{ThreadPool, ThreadPoolBuilder};
use serde::{Deserialize, Serialize};

/// A worker thread that the operating system does not start.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[error("{wanted} worker threads cannot be started ({why}); give fewer with --threads")]
pub struct ThreadError {
    /// Number of requested threads.
    pub wanted: usize,
    /// Error of the operating system.
    pub why: String,
}

/// Threads that serve several pieces of work.
#[derive(Debug)]
pub(crate) struct Pool(ThreadPool);

impl Pool {
    /// A pool of `threads` threads, at least one.
    pub(crate) fn new(threads: usize) -> Result<Self, ThreadError> {
        let wanted = threads.max(1);
        let pool = ThreadPoolBuilder::new().num_threads(wanted).build();
        pool.map(Self).map_err(|error| ThreadError { wanted, why: error.to_string() })
    }

    /// Results of `work` for all numbers below `n`, in order.
    pub(crate) fn numbers<T: Send>(&self, n: usize, work: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
        self.0.install(|| (0..n).into_par_iter().map(work).collect())
    }
}

/// Results of `work`, run once on each of `threads` threads. `work` itself divides the items among them.
pub fn on_each_thread<T: Send>(threads: usize, work: impl Fn() -> T + Sync) -> Result<Vec<T>, ThreadError> {
    Ok(Pool::new(threads)?.0.broadcast(|_| work()))
}

/// Results of `work` for all items, in order, on at most `threads` threads. Items are long, so each is
/// scheduled separately.
pub fn in_parallel<I: Sync, T: Send>(
    items: &[I],
    threads: usize,
    work: impl Fn(&I) -> T + Sync + Send,
) -> Result<Vec<T>, ThreadError> {
    let threads = threads.min(items.len());
    if threads <= 1 {
        return Ok(items.iter().map(work).collect());
    }
    let pool = Pool::new(threads)?;
    Ok(pool.0.install(|| items.par_iter().with_max_len(1).map(work).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_are_in_the_order_of_the_items_whatever_the_threads() {
        let items: Vec<u64> = (0..100).collect();
        for threads in [0, 1, 2, 7, 300] {
            let squares = in_parallel(&items, threads, |n| n * n).expect("threads start");
            assert!(squares.iter().zip(&items).all(|(square, n)| *square == n * n), "{threads}");
        }
        let pool = Pool::new(3).expect("threads start");
        assert_eq!(pool.numbers(5, |n| n + 1), [1, 2, 3, 4, 5]);
        assert_eq!(on_each_thread(3, || 7), Ok(vec![7; 3]));
    }
}
