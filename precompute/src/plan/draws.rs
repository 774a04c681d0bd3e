//! What a space may cost: random draws of solves, configurations, seconds and bytes.
//!
//! The constants were measured on 63 spaces of the bundled organ with other nodes, laws, radii and force
//! limits. A *search* is adaptive sampling, its *probes* are the solves of `plan`, and the *surrogate* is the
//! fit of the probes. A probe is *lost* if it failed, left its branch, or has another solution from another
//! start.
//!
//! - A search that ends within the probes is known exactly.
//! - The number of solves of a longer one is log-normal. Its median is the prediction, corrected by
//!   [`likely_solves`].
//! - A lattice takes over a search beyond [`TAKEOVER_AFTER`] solves, and half of the searches with a lost
//!   probe. The lattice is solved from neighbour to neighbour. Its failed points and branch jumps are solved
//!   again.
//!
//! The numbers are pseudo-random with a fixed seed and do not depend on the platform.

use crate::num::{SPLIT_MIX_STEP, split_mix, unit_interval};

use super::probe::Probed;

/// Number of random outcomes of a prediction.
pub(super) const DRAWS: u64 = 400;

/// Predicted numbers of solves up to this one are unbiased.
const UNBIASED_SOLVES: f64 = 40.0;
/// Above it the number of solves grows with this power of the prediction.
const GROWTH_EXPONENT: f64 = 0.4;
/// Number of solves after which a lattice takes over a search that has not ended.
const TAKEOVER_AFTER: f64 = 90.0;
/// Number of solves of a search before the takeover, smallest and largest.
const SOLVES_BEFORE_TAKEOVER: [f64; 2] = [84.0, 145.0];
/// Probability that a lattice takes over a search with a lost probe, also if the search is short.
const TAKEOVER_IF_LOST: f64 = 0.5;
/// Standard deviation s (probes / [`REFERENCE_PROBES`])^e of the logarithm of the number of solves: s and e.
/// It is 1.15 with two probes.
const SOLVES_SPREAD: [f64; 2] = [0.5, -0.4];
const REFERENCE_PROBES: f64 = 16.0;
/// Minimum, quartiles and maximum of the number of repeated solves per point of a lattice with branch jumps.
const REPEATS_PER_POINT: [f64; 5] = [0.3, 0.43, 0.45, 0.67, 1.7];
/// Probability of branch jumps on a lattice that the scene specifies, if a probe was lost. They also occur if
/// the drawn number of solves of a search exceeds [`TAKEOVER_AFTER`].
const JUMPS_IF_LOST: f64 = 0.9;
/// Largest number of repeated solves per point of a lattice without branch jumps.
const REPEATS_WITHOUT_JUMPS: f64 = 0.02;
/// Minimum, quartiles and maximum of the time per point of a lattice with branch jumps, relative to the mean
/// time of a probe.
const POINT_TIME: [f64; 5] = [0.35, 0.6, 0.85, 1.24, 1.3];
/// The same statistics of the time of a repeated solve, relative to that of such a point.
const REPEAT_TIME: [f64; 5] = [0.9, 1.75, 2.0, 2.1, 3.1];
/// Standard deviation of the logarithm of the time of a solve relative to the same solve among the probes, on
/// a shared machine.
const SLOWDOWN_SPREAD: f64 = 0.4;
/// Standard deviation of the logarithm of a table's size, and of a lattice's number of points, relative to
/// their predictions.
const SIZE_SPREAD: f64 = 0.1;
/// Table of a search that does not end within the probes, relative to the surrogate's table: median, and
/// standard deviation of the logarithm. Measured tables were 1.1 to 2.3 times as large.
const OPEN_TABLE_SIZE: [f64; 2] = [1.15, 0.3];
/// Standard deviation of the logarithm of the peak memory, relative to its estimate.
const MEMORY_SPREAD: f64 = 0.25;

/// Maximum number of draws until a number of solves exceeds the solves so far.
const REDRAWS: u32 = 30;
/// Streams of pseudo-random numbers besides those of the nodes.
const SLOWDOWN_STREAM: u64 = u64::MAX;
const UNSEEN_STREAM: u64 = 1 << 33;

/// A possible outcome of one node.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct NodeDraw {
    /// Solves, with those that failed or were repeated.
    pub tried: f64,
    /// Configurations with a solution.
    pub kept: f64,
    /// Seconds of the solves on one thread.
    pub seconds: f64,
    /// Bytes of the node in a blob of the method `energy`.
    pub blob_bytes: f64,
    /// Configurations in the fit of the search.
    pub fitted: f64,
    /// 1 if a lattice took over; for several nodes, the number of those.
    pub lattices: f64,
}

/// A stream of pseudo-random numbers.
#[derive(Debug)]
pub(super) struct Random(u64);

impl Random {
    /// The numbers of draw `n` in this stream.
    pub(super) fn new(stream: u64, n: u64) -> Self {
        Self(split_mix(split_mix(stream) ^ n))
    }

    /// Uniform in [0, 1).
    pub(super) fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(SPLIT_MIX_STEP);
        unit_interval(split_mix(self.0))
    }

    /// One of `count` numbers, each with the same probability.
    pub(super) fn below(&mut self, count: usize) -> usize {
        ((self.uniform() * count as f64) as usize).min(count.saturating_sub(1))
    }

    /// Standard normal up to six standard deviations: a sum of twelve uniform numbers.
    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }

    /// Log-normal with the median 1.
    fn factor(&mut self, spread: f64) -> f64 {
        libm::exp(spread * self.normal())
    }

    /// Distributed with this minimum, these quartiles and this maximum, uniform in between.
    fn draw_by_quartiles(&mut self, quartiles: &[f64; 5]) -> f64 {
        let place = 4.0 * self.uniform();
        let n = (place as usize).min(3);
        quartiles[n] + (place - n as f64) * (quartiles[n + 1] - quartiles[n])
    }

    /// Peak memory relative to its estimate.
    pub(super) fn memory(&mut self) -> f64 {
        self.factor(MEMORY_SPREAD)
    }
}

/// Random factors that the nodes of an outcome have in common.
#[derive(Debug, Clone, Copy)]
pub(super) struct Common {
    /// Time of a solve relative to the same solve among the probes.
    slowdown: f64,
    /// Standard-normal error due to few probes, common to all nodes that resemble the same probed node.
    unseen: f64,
}

impl Common {
    /// Of outcome `n`, for nodes that resemble the probed node `at`.
    pub(super) fn new(at: usize, n: u64) -> Self {
        let slowdown = Random::new(SLOWDOWN_STREAM, n).factor(SLOWDOWN_SPREAD);
        Self { slowdown, unseen: Random::new(UNSEEN_STREAM + at as u64, n).normal() }
    }
}

/// Median number of solves of a search, for the number that the surrogate predicts. With few probes the
/// surrogate of a body whose force varies strongly needs far more configurations than the body.
pub(super) fn likely_solves(predicted: f64) -> f64 {
    if predicted <= UNBIASED_SOLVES {
        predicted
    } else {
        UNBIASED_SOLVES * libm::pow(predicted / UNBIASED_SOLVES, GROWTH_EXPONENT)
    }
}

/// Measured seconds of solves on a node, with the scene's own element order and law.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SolveTimes {
    /// All solves of the search so far, including the rest state.
    spent_s: f64,
    /// Mean of the probes.
    far_s: f64,
    /// Mean of the lattice steps.
    near_s: f64,
    probes: f64,
}

impl SolveTimes {
    #[cfg(test)]
    pub(super) fn made_up() -> Self {
        Self { spent_s: 49.0, far_s: 3.0, near_s: 2.0, probes: 16.0 }
    }

    /// Of these probes.
    pub(super) fn of(probed: &Probed) -> Self {
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
        let (far_s, near_s) = (mean(&probed.far_s), mean(&probed.near_s));
        let spent_s = probed.rest_s + probed.far_s.iter().sum::<f64>();
        Self { spent_s, far_s, near_s, probes: probed.far_s.len() as f64 }
    }

    /// Seconds of this number of scattered configurations. The first take as long as the probes. Later ones
    /// start from nearer parents: the distance decreases with the cube root of the number, down to a lattice
    /// step.
    pub(super) fn search_s(&self, configurations: f64) -> f64 {
        let near_s = self.near_s.min(self.far_s);
        let probes = self.probes.min(configurations);
        let farther = probes + 1.5 * (libm::cbrt(probes * configurations * configurations) - probes);
        configurations * near_s + farther * (self.far_s - near_s)
    }

    /// Seconds of this number of points of a lattice that the scene specifies.
    pub(super) fn lattice_s(&self, points: f64) -> f64 {
        points * self.near_s
    }
}

/// The fallback lattice of a node.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Fallback {
    /// Points that are solved.
    pub points: f64,
    /// Bytes of its table.
    pub blob_bytes: f64,
}

/// A search that has not ended within the probes.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct OpenSearch {
    /// Number of solves so far, including the rest state.
    pub tried: f64,
    /// Number of solves of the search on the surrogate, and that predicted for the body.
    pub solves: [f64; 2],
    /// Share of the solves that fail.
    pub failing: f64,
    /// Whether a probe failed, left its branch, or has another solution from another start.
    pub has_lost_probe: bool,
    /// Cells along the radius of the surrogate's table.
    pub cells: f64,
    /// Bytes of a table with 2, 3, .. cells along the radius.
    pub bytes: Vec<f64>,
    /// The lattice that may take over.
    pub fallback: Option<Fallback>,
}

/// State of knowledge about the space of a node.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Known {
    /// The search ended within the probes.
    Ended { tried: f64, kept: f64, blob_bytes: f64 },
    /// It goes on.
    Open(OpenSearch),
    /// A lattice that the scene specifies: points solved on the surrogate; all points of the domain;
    /// predicted number of solves of a search; whether a probe was lost; load increments per point; bytes of
    /// the table.
    Lattice {
        points: f64,
        domain: f64,
        search_solves: f64,
        has_lost_probe: bool,
        increments: f64,
        blob_bytes: f64,
    },
}

/// The possible outcomes of a node.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Outlook {
    /// Measured times.
    pub times: SolveTimes,
    /// What is known.
    pub known: Known,
}

impl Outlook {
    /// One outcome in these circumstances.
    pub(super) fn draw(&self, random: &mut Random, common: Common) -> NodeDraw {
        let drawn = match &self.known {
            &Known::Ended { tried, kept, blob_bytes } => {
                NodeDraw { tried, kept, seconds: self.times.spent_s, blob_bytes, fitted: kept, lattices: 0.0 }
            }
            Known::Open(search) => self.search(search, random, common.unseen),
            &Known::Lattice { points, domain, search_solves, has_lost_probe, increments, blob_bytes } => {
                let kept = (points * random.factor(SIZE_SPREAD)).min(domain).round();
                let has_jumps = self.draw_solves(search_solves, 0.0, random, common.unseen) > TAKEOVER_AFTER
                    || (has_lost_probe && random.uniform() < JUMPS_IF_LOST);
                let (repeats, point_s) = if has_jumps {
                    (
                        random.draw_by_quartiles(&REPEATS_PER_POINT),
                        self.times.far_s * random.draw_by_quartiles(&POINT_TIME),
                    )
                } else {
                    (REPEATS_WITHOUT_JUMPS * random.uniform(), self.times.near_s)
                };
                let (repeats, point_s) = ((kept * repeats).round(), increments * point_s);
                let seconds = point_s * (kept + repeats * random.draw_by_quartiles(&REPEAT_TIME));
                NodeDraw { tried: kept + repeats, kept, seconds, blob_bytes, ..NodeDraw::default() }
            }
        };
        let blob_bytes = drawn.blob_bytes * random.factor(SIZE_SPREAD);
        NodeDraw { seconds: common.slowdown * drawn.seconds, blob_bytes, ..drawn }
    }

    /// An outcome in which the lattice takes over; `None` if no lattice can.
    pub(super) fn taken_over(&self, random: &mut Random, common: Common) -> Option<NodeDraw> {
        let Known::Open(search) = &self.known else { return None };
        let drawn = self.with_fallback(search, search.fallback?, random);
        let blob_bytes = drawn.blob_bytes * random.factor(SIZE_SPREAD);
        Some(NodeDraw { seconds: common.slowdown * drawn.seconds, blob_bytes, ..drawn })
    }

    /// Number of solves of a search with this prediction that has not ended after `tried` solves.
    fn draw_solves(&self, predicted: f64, tried: f64, random: &mut Random, unseen: f64) -> f64 {
        let [own, exponent] = SOLVES_SPREAD;
        let spread = own * libm::pow(self.times.probes.max(1.0) / REFERENCE_PROBES, exponent);
        let of_few_probes = (spread * spread - own * own).max(0.0).sqrt();
        let median = likely_solves(predicted) * libm::exp(of_few_probes * unseen);
        let mut drawn = (0..REDRAWS).map(|_| (median * random.factor(own)).round());
        drawn.find(|&solves| solves > tried).unwrap_or(tried + 1.0)
    }

    fn search(&self, search: &OpenSearch, random: &mut Random, unseen: f64) -> NodeDraw {
        let [on_surrogate, likely] = search.solves;
        let tried = self.draw_solves(likely, search.tried, random, unseen);
        let is_replaced = search.has_lost_probe && random.uniform() < TAKEOVER_IF_LOST;
        if let Some(fallback) = search.fallback
            && (is_replaced || tried > TAKEOVER_AFTER)
        {
            return self.with_fallback(search, fallback, random);
        }
        let kept = (tried * (1.0 - search.failing)).round();
        let cells = (search.cells * libm::cbrt(tried / on_surrogate)).round() as usize;
        let table = cells.clamp(2, search.bytes.len() + 1) - 2;
        let [larger, spread] = OPEN_TABLE_SIZE;
        let blob_bytes = larger * random.factor(spread) * search.bytes.get(table).copied().unwrap_or(0.0);
        let seconds = self.times.search_s(tried);
        NodeDraw { tried, kept, seconds, blob_bytes, fitted: kept, lattices: 0.0 }
    }

    fn with_fallback(&self, search: &OpenSearch, fallback: Fallback, random: &mut Random) -> NodeDraw {
        let Fallback { points, blob_bytes } = fallback;
        let [shortest, longest] = SOLVES_BEFORE_TAKEOVER;
        let before = (shortest + (longest - shortest) * random.uniform()).round();
        let repeats = (points * random.draw_by_quartiles(&REPEATS_PER_POINT)).round();
        let point_s = self.times.far_s * random.draw_by_quartiles(&POINT_TIME);
        let fitted = (before * (1.0 - search.failing)).round();
        NodeDraw {
            tried: before + points + repeats,
            kept: fitted + points,
            seconds: self.times.search_s(before)
                + point_s * (points + repeats * random.draw_by_quartiles(&REPEAT_TIME)),
            blob_bytes,
            fitted,
            lattices: 1.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn times() -> SolveTimes {
        SolveTimes::made_up()
    }

    fn open(likely: f64, has_lost_probe: bool) -> Outlook {
        let search = OpenSearch {
            tried: 17.0,
            solves: [likely, likely],
            failing: 0.0,
            has_lost_probe,
            cells: 4.0,
            bytes: (2..=12).map(|cells| f64::from(cells).powi(3)).collect(),
            fallback: Some(Fallback { points: 600.0, blob_bytes: 5e5 }),
        };
        Outlook { times: times(), known: Known::Open(search) }
    }

    fn share(outlook: &Outlook, of: impl Fn(&NodeDraw) -> bool) -> f64 {
        let drawn = (0..DRAWS).filter(|&n| of(&outlook.draw(&mut Random::new(7, n), Common::new(0, n))));
        drawn.count() as f64 / DRAWS as f64
    }

    #[test]
    fn later_configurations_take_less_than_the_probes() {
        let seconds = |configurations| times().search_s(configurations);
        assert_eq!(seconds(1.0), 3.0);
        assert!(seconds(8.0) < 24.1 && seconds(8.0) > 2.0 * 8.0);
        let last = seconds(1001.0) - seconds(1000.0);
        assert!(last > 2.0 && last < 2.6, "{last}");
    }

    #[test]
    fn a_search_that_ended_is_known_and_an_open_one_is_longer_than_its_probes() {
        let known = Known::Ended { tried: 11.0, kept: 11.0, blob_bytes: 1e5 };
        let ended = Outlook { times: times(), known };
        assert_eq!(share(&ended, |draw| draw.tried == 11.0 && draw.kept == 11.0), 1.0);
        assert!(ended.taken_over(&mut Random::new(7, 0), Common::new(0, 0)).is_none());
        assert_eq!(share(&open(20.0, false), |draw| draw.tried >= 18.0), 1.0);
    }

    /// In the calibration 8 of 13 searches with a lost probe were taken over, and 2 of 30 without.
    #[test]
    fn a_lattice_takes_over_as_often_as_measured() {
        let taken = |likely, has_lost_probe| share(&open(likely, has_lost_probe), |draw| draw.lattices > 0.0);
        assert!(taken(25.0, false) < 0.03, "{}", taken(25.0, false));
        assert!((0.1..0.3).contains(&taken(90.0, false)), "{}", taken(90.0, false));
        assert!((0.5..0.7).contains(&taken(70.0, true)), "{}", taken(70.0, true));
        let of_lattice = |draw: &NodeDraw| draw.lattices == 0.0 || (864.0..=1765.0).contains(&draw.tried);
        assert_eq!(share(&open(70.0, true), of_lattice), 1.0);
        assert_eq!(share(&open(70.0, true), |draw| draw.kept <= draw.tried), 1.0);
    }

    #[test]
    fn the_number_of_solves_is_log_normal_and_longer_predictions_count_less() {
        let below = share(&open(40.0, false), |draw| draw.tried < 40.0 / 1.9);
        assert!((0.03..0.1).contains(&below), "{below}");
        assert_eq!((likely_solves(12.0), likely_solves(40.0)), (12.0, 40.0));
        assert!((likely_solves(160.0) - 69.6).abs() < 0.1);
    }

    /// The numbers are the same on every platform.
    #[test]
    fn the_random_numbers_are_those_of_split_mix() {
        let mut random = Random::new(1, 2);
        let found = [random.uniform(), random.uniform(), random.uniform()];
        assert_eq!(found, [0.280_142_580_453_872_86, 0.007_557_212_222_805_365, 0.164_928_192_629_296_92]);
    }
}
