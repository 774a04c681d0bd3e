//! Timing by interleaved batches.

use std::hint::black_box;
use std::time::Instant;

use palpate_core::{Method, Vec3};

/// Number of positions: too many for a branch predictor to learn their order.
const QUERIES: usize = 1 << 16;
/// Approximate duration of a batch: much longer than the clock's resolution, much shorter than a time slice.
const BATCH_NS: f64 = 40_000.0;

/// Evaluates a batch of positions. In the second form each query depends on the result of the one before.
type Batch<'r> = Box<dyn FnMut(&[Vec3], &mut [Vec3]) + 'r>;

/// A function to be timed.
pub(super) struct Run<'r> {
    /// Its name; the last word is that of the project's method.
    pub(super) name: String,
    /// Its instruction set.
    pub(super) instructions: &'static str,
    /// The project's method with the same interpolant.
    pub(super) compared: Method,
    /// Bytes of its tables.
    pub(super) bytes: usize,
    batch: Batch<'r>,
    chain: Batch<'r>,
}

/// The timing of a run.
#[derive(Debug, Clone, Copy)]
pub(super) struct Timing {
    pub(super) median_ns: f64,
    pub(super) min_ns: f64,
    pub(super) waits_ns: Option<f64>,
}

impl<'r> Run<'r> {
    pub(super) fn new(
        name: String,
        instructions: &'static str,
        compared: Method,
        bytes: usize,
        ask: impl Fn(&Vec3) -> Vec3 + Clone + 'r,
    ) -> Self {
        let ask_in_turn = ask.clone();
        let batch = move |queries: &[Vec3], answers: &mut [Vec3]| {
            for (query, answer) in queries.iter().zip(answers) {
                *answer = ask(query);
            }
        };
        let chain = move |queries: &[Vec3], answers: &mut [Vec3]| {
            let mut before = [0.0_f32; 3];
            for query in queries {
                // The term rounds to zero, but the processor must wait for the previous result to compute it.
                let [x, y, z] = *query;
                let [hx, hy, hz] = before;
                before = ask_in_turn(&[x + hx * 1e-30, y + hy * 1e-30, z + hz * 1e-30]);
            }
            if let Some(answer) = answers.first_mut() {
                *answer = before;
            }
        };
        Self { name, instructions, compared, bytes, batch: Box::new(batch), chain: Box::new(chain) }
    }

    /// One query.
    pub(super) fn ask(&mut self, query: &Vec3) -> Vec3 {
        let mut answer = [[0.0; 3]];
        (self.batch)(std::slice::from_ref(query), &mut answer);
        answer[0]
    }
}

/// Uniform positions in the ball with a fixed seed, none on the rim.
pub(super) fn queries(radius_m: f32) -> Vec<Vec3> {
    let mut seed = 7_u64;
    let mut next = || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 40) as f32 / (1_u64 << 23) as f32 - 1.0
    };
    std::iter::repeat_with(|| [next(), next(), next()])
        .filter(|point| point.iter().map(|x| x * x).sum::<f32>() < 0.999)
        .map(|point| point.map(|x| x * radius_m))
        .take(QUERIES)
        .collect()
}

/// Runs `rounds` batches of each function, interleaved.
pub(super) fn interleave(runs: &mut [Run<'_>], queries: &[Vec3], rounds: usize) -> Vec<Timing> {
    let mut answers = vec![[0.0; 3]; queries.len()];
    let mut next = 0;
    let mut batch = |run: &mut Run<'_>, count: usize, chained: bool| -> f64 {
        if next + count > queries.len() {
            next = 0;
        }
        let questions = &queries[next..][..count];
        next += count;
        let work = if chained { &mut run.chain } else { &mut run.batch };
        let begun = Instant::now();
        work(questions, &mut answers[..count]);
        let ns = begun.elapsed().as_nanos() as f64 / count as f64;
        black_box(&answers);
        ns
    };
    // Number of queries per batch, from the best of a few short batches.
    let counts: Vec<usize> = runs
        .iter_mut()
        .map(|run| {
            let best = (0..5).map(|_| batch(run, 16, false)).fold(f64::INFINITY, f64::min);
            ((BATCH_NS / best.max(1.0)) as usize).clamp(4, 4_096)
        })
        .collect();
    let mut plain = vec![Vec::with_capacity(rounds); runs.len()];
    let mut waiting = vec![Vec::with_capacity(rounds); runs.len()];
    for _ in 0..rounds {
        for (run, ((count, plain), waiting)) in
            runs.iter_mut().zip(counts.iter().zip(&mut plain).zip(&mut waiting))
        {
            plain.push(batch(run, *count, false));
            waiting.push(batch(run, *count / 4 + 1, true));
        }
    }
    let of = |(mut plain, mut waiting): (Vec<f64>, Vec<f64>)| {
        let middle = |times: &mut Vec<f64>| -> Option<f64> {
            times.sort_unstable_by(f64::total_cmp);
            times.get(times.len() / 2).copied()
        };
        let median_ns = middle(&mut plain).unwrap_or(f64::NAN);
        Timing {
            median_ns,
            min_ns: plain.first().copied().unwrap_or(f64::NAN),
            waits_ns: middle(&mut waiting),
        }
    };
    plain.into_iter().zip(waiting).map(of).collect()
}
