//! What an interrupted run keeps, and what a resumed run does with it.

use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::Duration;

use palpate_core::ConfigTag;

use super::super::tests::synthetic::{SyntheticExecutor, actives, all, mesh};
use super::super::{Outcome, Store};
use super::*;

/// Runs until `tries` attempts are solved in this run; returns the last reported number.
fn stopped(synthetic: &mut SyntheticExecutor, store: &Store, nodes: u32, tries: usize) -> usize {
    let (stop, mut told) = (AtomicBool::new(false), 0);
    let ended = expand(&all(nodes), store, synthetic, &stop, |p| {
        told = p.solved_now;
        stop.store(told >= tries, Ordering::Relaxed);
    });
    assert!(matches!(ended, Err(ExpansionError::Interrupted)), "{ended:?}");
    told
}

/// Committed attempts of so many nodes, which a kill would leave.
fn committed(path: &std::path::Path, nodes: usize) -> usize {
    let reader = Store::open(path).expect("a reader can open it");
    (0..nodes).map(|active| reader.attempts(active).expect("records").len()).sum()
}

#[test]
fn all_that_was_done_before_a_stop_is_committed() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.space");
    let mut synthetic = SyntheticExecutor::new(1.0, 1.3);
    // The writer stays open: the reader does not see its uncommitted rows.
    let store = synthetic.store(&path, 1);
    let mut before = 0;
    for tries in [1, 7, 30] {
        before += stopped(&mut synthetic, &store, 1, tries);
        assert_eq!(committed(&path, 1), before);
    }
}

/// An executor that fails after so many outcomes.
struct Dies(SyntheticExecutor, usize);

impl Executor for Dies {
    fn size(&self) -> usize {
        self.0.size()
    }

    fn give(&mut self, worker: usize, work: Work) -> Result<(), ExecutorError> {
        self.0.give(worker, work)
    }

    fn take(&mut self, timeout: Duration) -> Result<Option<(usize, Done)>, ExecutorError> {
        self.1 = self.1.checked_sub(1).ok_or_else(|| ExecutorError::Lost("gone".into()))?;
        self.0.take(timeout)
    }

    fn stop(&mut self) {
        self.0.stop();
    }
}

#[test]
fn all_that_was_done_before_a_worker_is_lost_is_committed() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.space");
    let synthetic = SyntheticExecutor::new(1.0, 1.3);
    let store = synthetic.store(&path, 1);
    let ended = expand(&[0], &store, &mut Dies(synthetic, 23), &AtomicBool::new(false), |_| ());
    assert!(matches!(ended, Err(ExpansionError::Executor(ExecutorError::Lost(_)))), "{ended:?}");
    assert_eq!(committed(&path, 1), 23);
}

/// Reports ten seconds of silence before every outcome, without an actual wait.
struct Slow {
    synthetic: SyntheticExecutor,
    path: PathBuf,
    silent: Duration,
    given_back: usize,
}

impl Executor for Slow {
    fn size(&self) -> usize {
        self.synthetic.size()
    }

    fn give(&mut self, worker: usize, work: Work) -> Result<(), ExecutorError> {
        self.synthetic.give(worker, work)
    }

    fn take(&mut self, timeout: Duration) -> Result<Option<(usize, Done)>, ExecutorError> {
        self.silent += timeout;
        if self.silent >= Duration::from_secs(1) {
            assert_eq!(
                committed(&self.path, 1),
                self.given_back,
                "committed after one second without a result"
            );
        }
        if self.silent < Duration::from_secs(10) {
            return Ok(None);
        }
        self.silent = Duration::ZERO;
        self.given_back += 1;
        self.synthetic.take(timeout)
    }

    fn stop(&mut self) {
        self.synthetic.stop();
    }
}

#[test]
fn what_is_done_before_a_long_silence_is_committed_within_a_second() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.space");
    let synthetic = SyntheticExecutor::new(1.0, 0.0);
    let (store, stop) = (synthetic.store(&path, 1), AtomicBool::new(false));
    let mut slow = Slow { synthetic, path, silent: Duration::ZERO, given_back: 0 };
    let ended = expand(&[0], &store, &mut slow, &stop, |p| stop.store(p.solved_now >= 4, Ordering::Relaxed));
    assert!(matches!(ended, Err(ExpansionError::Interrupted)), "{ended:?}");
    assert!(slow.given_back >= 4);
}

/// All rows of a node's store, in order.
fn outcomes(store: &Store, active: usize) -> Vec<Outcome> {
    let attempts = store.attempts(active).expect("records");
    let outcome = |record: Record| {
        let seed = store.stored_seed(active, record.index, record.attempt).ok();
        Outcome { active: active as u32, record, seed, intermediate: Vec::new() }
    };
    attempts.into_iter().map(outcome).collect()
}

#[test]
fn a_stored_try_from_another_parent_or_of_another_round_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut synthetic = SyntheticExecutor::new(1.0, 1.3);
    let whole = synthetic.store(&folder.path().join("whole.space"), 1);
    synthetic.expand(&whole, 1);
    let outcomes = outcomes(&whole, 0);
    let some_try =
        |wanted: u32| outcomes.iter().position(|o| o.record.attempt == wanted && o.record.round > 1);
    let (first, again) =
        (some_try(0).expect("a first attempt"), some_try(1).expect("a second attempt at the branch jump"));
    type Alter = fn(&mut Record);
    let altered: [(usize, Alter); 5] = [
        (first, |_| ()),
        (first, |record| record.round += 1),
        (again, |record| record.round -= 1),
        // Another solution of the same point, and another point.
        (again, |record| record.parent = record.parent.map(|(index, attempt)| (index, attempt + 1))),
        (first, |record| record.parent = Some(([0; 3], 0))),
    ];
    for (n, (at, alter)) in altered.into_iter().enumerate() {
        let store = synthetic.store(&folder.path().join(format!("{n}.space")), 1);
        let mut outcomes = outcomes.clone();
        alter(&mut outcomes[at].record);
        outcomes.iter().for_each(|outcome| store.add(outcome, None).expect("added"));
        synthetic.given.clear();
        let ended = expand(&[0], &store, &mut synthetic, &AtomicBool::new(false), |_| ());
        if n == 0 {
            ended.expect("the copy is accepted");
            assert_eq!(synthetic.given.len(), 0, "nothing is solved again");
            continue;
        }
        let line = ended.expect_err("the outcome does not match the plan").to_string();
        let index = format!("{:?}", outcomes[at].record.index);
        assert!(
            line.contains(&index) && line.contains("a plan that differs from that of this version"),
            "{n}: {line}"
        );
    }
}

/// After an interruption at any point, and after a salvage, each node has its own rows.
#[test]
fn two_nodes_of_one_store_are_resumed_and_salvaged_each_by_itself() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let mut synthetic = SyntheticExecutor::new(1.0, 1.3);
    let whole = synthetic.store(&at("whole.space"), 2);
    synthetic.expand(&whole, 2);
    let expected = [0, 1].map(|active| whole.attempts(active).expect("records"));
    let [one, other] = &expected;
    assert!(one.len() > 100 && other.len() > 100);
    let energy = |records: &[Record]| {
        records.iter().filter_map(Record::equilibrium).map(|at| at.energy_j).fold(0.0, f64::max)
    };
    assert!(energy(other) > 1.5 * energy(one), "each node has its own energy");

    let torn = synthetic.store(&at("torn.space"), 2);
    for tries in [1, one.len() / 2, one.len() / 2 + 10, other.len() / 2] {
        stopped(&mut synthetic, &torn, 2, tries);
    }
    synthetic.expand(&torn, 2);
    let found = [0, 1].map(|active| torn.attempts(active).expect("records"));
    assert!(found == expected, "the store of an interrupted run differs");
    drop(torn);

    let lost = other.iter().rfind(|record| record.equilibrium().is_some()).expect("a solution");
    let database = rusqlite::Connection::open(at("torn.space")).expect("a database");
    let damage = "UPDATE configuration SET energy_j = 2 * energy_j + 1 \
                  WHERE (active, i, j, k, attempt) = (1, ?1, ?2, ?3, ?4)";
    let [i, j, k] = lost.index;
    assert_eq!(database.execute(damage, (i, j, k, lost.attempt)).expect("written"), 1);
    drop(database);
    let (identity, nodes) = (synthetic.identity(), actives(2));
    let (saved, report) =
        Store::salvage(&at("torn.space"), &identity, &mesh(), &[0], &nodes).expect("is salvaged");
    assert_eq!((report.saved, report.damaged), (one.len() + other.len() - 1, 1));
    let mut intact = expected.clone();
    intact[1].retain(|record| (record.index, record.attempt) != (lost.index, lost.attempt));
    assert!([0, 1].map(|active| saved.attempts(active).expect("records")) == intact);
}

/// The failed rest point is stored like any other outcome. The space must not count as finished.
#[test]
fn a_body_without_a_rest_is_refused_the_second_time_too() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut synthetic = SyntheticExecutor::new(1.0, 0.0);
    synthetic.rest_fails = true;
    let store = synthetic.store(&folder.path().join("a.space"), 1);
    for time in ["first", "second"] {
        let ended = expand(&[0], &store, &mut synthetic, &AtomicBool::new(false), |_| ());
        assert!(matches!(&ended, Err(ExpansionError::Rest(why)) if why == "singular"), "{time}: {ended:?}");
    }
    assert_eq!(store.records(0).expect("read")[0].tag(), ConfigTag::Failed);
}
