//! The prediction for the sampling that the scene specifies: intervals, and their file.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::draws::{Common, DRAWS, NodeDraw, Outlook, Random};
use crate::error::InputError;
use crate::pipeline::PipelineError;
use crate::space::Store;

/// Shares of the outcomes below the ends and the middle of an interval.
const SHARES: [f64; 3] = [0.1, 0.5, 0.9];
/// Mark of the file.
const FORMAT: &str = "palpate prediction 1";
/// A less probable lattice is not mentioned.
const MENTIONED: f64 = 0.01;
/// Factor of the interval about a predicted error at p99: 15 of 25 were within a factor of two.
const ERROR: f64 = 3.0;
/// The same of a query's time.
const QUERY: f64 = 2.0;
/// Streams of pseudo-random numbers besides those of the nodes.
const OTHERS: u64 = u64::MAX - 1;
const FALLBACK: u64 = 1 << 32;

/// The 10 %, 50 % and 90 % points of a quantity.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Interval {
    /// One outcome in ten is below.
    pub low: f64,
    /// The median.
    pub likely: f64,
    /// One outcome in ten is above.
    pub high: f64,
}

impl Interval {
    /// Of these outcomes; zero if there are none.
    fn of(mut outcomes: Vec<f64>) -> Self {
        outcomes.sort_by(f64::total_cmp);
        let last = outcomes.len().saturating_sub(1);
        let at = |share: f64| outcomes.get((share * last as f64).round() as usize).copied().unwrap_or(0.0);
        let [low, likely, high] = SHARES.map(at);
        Self { low, likely, high }
    }

    /// A value up to a factor in either direction.
    fn about(value: f64, factor: f64) -> Self {
        Self { low: value / factor, likely: value, high: value * factor }
    }

    /// The values less `by`, at least zero.
    pub(super) fn less(self, by: f64) -> Self {
        let Self { low, likely, high } = self;
        let [low, likely, high] = [low, likely, high].map(|x| (x - by).max(0.0));
        Self { low, likely, high }
    }

    /// Whether a value is inside.
    pub(super) fn contains(&self, value: f64) -> bool {
        (self.low..=self.high).contains(&value)
    }

    fn is_valid(&self) -> bool {
        [self.low, self.likely, self.high].iter().all(|x| x.is_finite())
            && self.low <= self.likely
            && self.likely <= self.high
    }
}

/// What happens if a lattice takes over a search.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Takeover {
    /// Its probability.
    pub probability: f64,
    /// Solves in this case.
    pub tried: Interval,
    /// Seconds of the solves in this case, on one thread.
    pub seconds: Interval,
}

/// The prediction for a node, or for all nodes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Line {
    /// Name of the node.
    pub of: String,
    /// Solves, with those that fail or are repeated.
    pub tried: Interval,
    /// Configurations that are kept.
    pub kept: Interval,
    /// Seconds of the solves on one thread.
    pub seconds: Interval,
    /// Bytes of the tables of the method `energy`; for all nodes, of the whole blob.
    pub blob_bytes: Interval,
    /// 99th percentile of the error, N; `None` if the probes do not show it.
    pub p99_n: Option<Interval>,
    /// A lattice that may take over the search.
    pub lattice: Option<Takeover>,
}

/// Memory of the fits of searches with these numbers of configurations on this number of threads, bytes.
type FitBytes = fn(&[f64], usize) -> f64;

/// A saved prediction.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Prediction {
    format: String,
    /// Name of the scene.
    pub scene: String,
    /// Hash of the scene's content, as in its space.
    pub key: String,
    /// Threads of the predicted work.
    pub threads: usize,
    /// The probed nodes.
    pub nodes: Vec<Line>,
    /// Each of the other nodes.
    pub others: Option<Line>,
    /// All nodes together.
    pub total: Line,
    /// Number of nodes at which a lattice takes over.
    pub lattices: Interval,
    /// Peak memory, bytes.
    pub memory_bytes: Interval,
    /// Bytes of the certificate in the blob.
    pub certificate_bytes: f64,
    /// Time of the slowest query, ns; `None` without a table.
    pub query_ns: Option<Interval>,
}

/// What a prediction is made from.
pub(super) struct Basis<'p> {
    /// Name and content hash of the scene.
    pub scene: (&'p str, String),
    /// Threads of the predicted work.
    pub threads: usize,
    /// Name, outlook and error at p99 (N) of each probed node.
    pub probed: Vec<(&'p str, &'p Outlook, Option<f64>)>,
    /// Number of active nodes.
    pub nodes: usize,
    /// Memory without the fits of the searches, and that of the fits of these numbers of configurations.
    pub memory_bytes: (f64, FitBytes),
    /// Bytes of the blob outside its spaces, and those of the certificate among them.
    pub other_bytes: [f64; 2],
    /// Time of the slowest query, ns.
    pub query_ns: Option<f64>,
}

/// The draws of all nodes in one outcome.
struct Outcome {
    /// The probed nodes first.
    draws: Vec<NodeDraw>,
    memory_bytes: f64,
}

impl Prediction {
    /// The prediction for these nodes.
    pub(super) fn of(basis: &Basis<'_>) -> Self {
        let outcomes: Vec<Outcome> = (0..DRAWS).map(|n| basis.outcome(n)).collect();
        let nodes = basis.probed.iter().enumerate().map(|(at, (name, outlook, p99_n))| {
            let draws: Vec<NodeDraw> = outcomes.iter().map(|outcome| outcome.draws[at]).collect();
            let forced =
                |n| outlook.taken_over(&mut Random::new(FALLBACK + at as u64, n), Common::new(at, n));
            let p99_n = p99_n.map(|p99_n| Interval::about(p99_n, ERROR));
            line(name, &draws, (0..DRAWS).filter_map(forced), p99_n)
        });
        let others = (basis.nodes > basis.probed.len()).then(|| {
            let draws: Vec<NodeDraw> =
                outcomes.iter().flat_map(|outcome| &outcome.draws[basis.probed.len()..]).copied().collect();
            let forced = draws.iter().copied().filter(|draw| draw.lattices > 0.0);
            let count = basis.nodes - basis.probed.len();
            line(&format!("each of {count} others"), &draws, forced, None)
        });
        let sums: Vec<NodeDraw> =
            outcomes.iter().map(|outcome| sum(&outcome.draws, basis.other_bytes[0])).collect();
        let all = if basis.nodes == 1 { "total".into() } else { format!("all {} nodes", basis.nodes) };
        Self {
            format: FORMAT.into(),
            scene: basis.scene.0.into(),
            key: basis.scene.1.clone(),
            threads: basis.threads,
            nodes: nodes.collect(),
            others,
            total: Line { lattice: None, ..line(&all, &sums, [].into_iter(), None) },
            lattices: Interval::of(sums.iter().map(|sum| sum.lattices).collect()),
            memory_bytes: Interval::of(outcomes.iter().map(|outcome| outcome.memory_bytes).collect()),
            certificate_bytes: basis.other_bytes[1],
            query_ns: basis.query_ns.map(|ns| Interval::about(ns, QUERY)),
        }
    }

    /// Reads a saved prediction of the scene that is solved in `store`.
    pub fn load(path: &Path, store: &Store) -> Result<Self, PipelineError> {
        let found = Self::read(path)?;
        let solved = store.identity()?.content_hash;
        if solved == found.key {
            return Ok(found);
        }
        let (scene, space) = (&found.scene, store.path().display());
        let what = format!("is the prediction of another scene ({scene}) than that of {space}");
        let fix = "make one of its scene with `palpate plan SCENE.toml --out FILE.json`";
        Err(InputError::new(path, what, fix).into())
    }

    fn read(path: &Path) -> Result<Self, InputError> {
        let text = std::fs::read_to_string(path).map_err(|error| InputError::unreadable(path, &error))?;
        let refused = |why: String| {
            let what = format!("is not a saved prediction ({why})");
            let fix = "make one with `palpate plan SCENE.toml --out FILE.json` before the scene is solved";
            InputError::new(path, what, fix)
        };
        let found: Self = serde_json::from_str(&text).map_err(|error| refused(error.to_string()))?;
        if found.format != FORMAT {
            return Err(refused(format!("its format is `{}`, not `{FORMAT}`", found.format)));
        }
        let invalid = found.intervals().find(|(_, interval)| !interval.is_valid()).map(|(what, _)| what);
        match invalid {
            Some(what) => Err(refused(format!("low <= likely <= high does not hold for {what}"))),
            None => Ok(found),
        }
    }

    fn intervals(&self) -> impl Iterator<Item = (&'static str, Interval)> {
        let lines = self.nodes.iter().chain(&self.others).chain([&self.total]);
        let whole = [("memory_bytes", self.memory_bytes), ("lattices", self.lattices)];
        let own = whole.map(Some).into_iter().chain([self.query_ns.map(|ns| ("query_ns", ns))]);
        lines.flat_map(Line::intervals).chain(own.flatten())
    }

    /// The prediction of the node `name`.
    pub(super) fn of_node(&self, name: &str) -> Option<&Line> {
        self.nodes.iter().find(|line| line.of == name).or(self.others.as_ref())
    }
}

impl Line {
    fn intervals(&self) -> impl Iterator<Item = (&'static str, Interval)> {
        let own = [
            ("tried", Some(self.tried)),
            ("kept", Some(self.kept)),
            ("seconds", Some(self.seconds)),
            ("blob_bytes", Some(self.blob_bytes)),
            ("p99_n", self.p99_n),
            ("lattice.tried", self.lattice.map(|lattice| lattice.tried)),
            ("lattice.seconds", self.lattice.map(|lattice| lattice.seconds)),
        ];
        own.into_iter().filter_map(|(what, interval)| Some((what, interval?)))
    }
}

impl Basis<'_> {
    /// Outcome `n` of all nodes. Nodes that were not probed resemble a random choice of the probed ones.
    fn outcome(&self, n: u64) -> Outcome {
        let probed = self.probed.iter().enumerate();
        let own = probed
            .map(|(at, (_, outlook, _))| outlook.draw(&mut Random::new(at as u64, n), Common::new(at, n)));
        let mut draws: Vec<NodeDraw> = own.collect();
        let mut random = Random::new(OTHERS, n);
        let count = self.probed.len();
        let alike: Vec<usize> = (0..count).map(|_| random.below(count)).collect();
        for _ in count..self.nodes {
            let at = alike[random.below(count)];
            draws.push(self.probed[at].1.draw(&mut random, Common::new(at, n)));
        }
        let (base, of_fits) = self.memory_bytes;
        let fitted: Vec<f64> = draws.iter().map(|draw| draw.fitted).collect();
        let memory_bytes = base + of_fits(&fitted, self.threads);
        Outcome { draws, memory_bytes: memory_bytes * random.memory() }
    }
}

/// The sum over all nodes, with the other bytes of the blob.
fn sum(draws: &[NodeDraw], other_bytes: f64) -> NodeDraw {
    let start = NodeDraw { blob_bytes: other_bytes, ..NodeDraw::default() };
    draws.iter().fold(start, |a, b| NodeDraw {
        tried: a.tried + b.tried,
        kept: a.kept + b.kept,
        seconds: a.seconds + b.seconds,
        blob_bytes: a.blob_bytes + b.blob_bytes,
        fitted: a.fitted + b.fitted,
        lattices: a.lattices + b.lattices,
    })
}

/// The line of these outcomes; `forced` are outcomes with a fallback lattice.
fn line(
    of: &str,
    draws: &[NodeDraw],
    forced: impl Iterator<Item = NodeDraw>,
    p99_n: Option<Interval>,
) -> Line {
    let interval =
        |draws: &[NodeDraw], figure: fn(&NodeDraw) -> f64| Interval::of(draws.iter().map(figure).collect());
    let taken = draws.iter().filter(|draw| draw.lattices > 0.0).count();
    let probability = taken as f64 / draws.len().max(1) as f64;
    let forced: Vec<NodeDraw> = forced.collect();
    Line {
        of: of.into(),
        tried: interval(draws, |draw| draw.tried),
        kept: interval(draws, |draw| draw.kept),
        seconds: interval(draws, |draw| draw.seconds),
        blob_bytes: interval(draws, |draw| draw.blob_bytes),
        p99_n,
        lattice: (probability >= MENTIONED && !forced.is_empty()).then(|| Takeover {
            probability,
            tried: interval(&forced, |draw| draw.tried),
            seconds: interval(&forced, |draw| draw.seconds),
        }),
    }
}

#[cfg(test)]
pub(super) mod tests {
    use std::io::Write;

    use super::super::draws::{Known, SolveTimes};
    use super::*;

    pub(in crate::plan) fn ended(nodes: usize) -> Prediction {
        let known = Known::Ended { tried: 11.0, kept: 10.0, blob_bytes: 1e5 };
        let outlook = Outlook { times: SolveTimes::made_up(), known };
        Prediction::of(&Basis {
            scene: ("a", "key".into()),
            threads: 2,
            probed: vec![("A1", &outlook, Some(0.01)), ("A2", &outlook, None)],
            nodes,
            memory_bytes: (1e7, |fitted, threads| 1e3 * fitted.iter().take(threads).sum::<f64>()),
            other_bytes: [5e4, 3e3],
            query_ns: Some(80.0),
        })
    }

    #[test]
    fn the_ends_hold_eight_of_ten_outcomes() {
        let interval = Interval::of((0..=100).rev().map(f64::from).collect());
        assert_eq!(interval, Interval { low: 10.0, likely: 50.0, high: 90.0 });
        assert!(interval.contains(10.0) && interval.contains(90.0) && !interval.contains(90.1));
        assert_eq!(Interval::about(5.0, 2.0), Interval { low: 2.5, likely: 5.0, high: 10.0 });
        assert_eq!(interval.less(20.0), Interval { low: 0.0, likely: 30.0, high: 70.0 });
    }

    #[test]
    fn what_is_certain_is_added_and_what_is_not_probed_resembles_the_probed() {
        let prediction = ended(5);
        let exactly = |value| Interval { low: value, likely: value, high: value };
        assert_eq!((prediction.total.tried, prediction.total.kept), (exactly(55.0), exactly(50.0)));
        let others = prediction.of_node("A5").expect("the others");
        assert_eq!((others.of.as_str(), others.tried.likely), ("each of 3 others", 11.0));
        assert!(prediction.total.blob_bytes.low > 4.5e5 && prediction.total.blob_bytes.high < 6.5e5);
        assert!(prediction.total.seconds.low < prediction.total.seconds.high);
        assert_eq!(prediction.nodes[0].p99_n, Some(Interval::about(0.01, ERROR)));
        assert!(prediction.nodes.iter().all(|line| line.lattice.is_none()));
    }

    #[test]
    fn a_file_that_is_no_prediction_is_refused_in_one_line() {
        let file = |text: &str| {
            let mut file = tempfile::NamedTempFile::new().expect("a file");
            file.write_all(text.as_bytes()).expect("written");
            file
        };
        let refused = |text: &str| Prediction::read(file(text).path()).expect_err("refused").to_string();
        assert!(refused("{}").contains("palpate plan SCENE.toml --out FILE.json"));
        let mut prediction = ended(2);
        prediction.total.tried.low = 1e9;
        let text = serde_json::to_string(&prediction).expect("JSON");
        assert!(refused(&text).contains("does not hold for tried"), "{}", refused(&text));
        prediction = ended(2);
        prediction.format = "palpate prediction 0".into();
        assert!(refused(&serde_json::to_string(&prediction).expect("JSON")).contains("its format is"));
        let whole = serde_json::to_string(&ended(5)).expect("JSON");
        assert_eq!(Prediction::read(file(&whole).path()).expect("valid"), ended(5));
    }
}
