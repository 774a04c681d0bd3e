//! Start points and acceptance of uniform positions, with a body of analytic energy.

use std::sync::atomic::Ordering;

use super::*;
use crate::space::Truth;
use crate::space::tests::synthetic::SyntheticExecutor;

const DRAW: Draw = Draw { regular_m: None, random: 0, uniform: 60, ..Draw::PAPER };

fn held_out(synthetic: &SyntheticExecutor, draw: Draw) -> HeldOut {
    HeldOut {
        actives: vec![(0, "A".into())],
        sampling: synthetic.identity().sampling,
        draw,
        places: None,
        keep_displacements: false,
    }
}

/// Held-out values of an active node, ordered by kind, number and step.
fn truths(store: &Store) -> Vec<(Walk, Truth)> {
    let mut all = Vec::new();
    store.each_truth(0, |walk, _, truth| all.push((*walk, truth.clone()))).expect("intact");
    all
}

#[test]
fn a_uniform_position_starts_from_the_nearest_corner_and_from_its_solution_that_counts() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut synthetic = SyntheticExecutor::new(1.0, 1.3);
    let store = synthetic.store(&folder.path().join("a.space"), 1);
    synthetic.expand(&store, 1);
    let records = store.records(0).expect("records");
    synthetic.given.clear();
    let held_out = held_out(&synthetic, DRAW);
    held_out.run(&store, &mut synthetic, &AtomicBool::new(false), |_| ()).expect("runs to its end");
    let mut superseded = 0;
    assert!(synthetic.given.len() >= 60);
    for work in &synthetic.given {
        let Work::Walk(job) = work else { panic!("a point") };
        let (corner, seed) = job.start.as_ref().expect("starts from the space");
        let cells = job.positions_m[0].map(|x| x / synthetic.grid.spacing_m);
        let squared =
            |index: GridIndex| (0..3).map(|i| (f64::from(index[i]) - cells[i]).powi(2)).sum::<f64>();
        let of_the_cell = |index: GridIndex| (0..3).all(|i| (f64::from(index[i]) - cells[i]).abs() < 1.0);
        assert!(of_the_cell(*corner), "{corner:?} is not a corner of the cell of {cells:?}");
        let nearer = records
            .iter()
            .find(|r| of_the_cell(r.index) && squared(r.index) < squared(*corner))
            .map(|r| r.index);
        assert_eq!(nearer, None, "nearer to {cells:?} than {corner:?}");
        let kept = records.iter().find(|r| r.index == *corner).expect("it is solved");
        assert_eq!(*seed, store.stored_seed(0, *corner, kept.attempt).expect("its state"));
        superseded += usize::from(*seed != store.stored_seed(0, *corner, 0).expect("the first one's"));
    }
    assert!(superseded > 0, "no position starts from a solution that replaced an earlier one");
}

#[test]
fn a_uniform_position_that_fails_or_is_beyond_the_limit_is_replaced() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut synthetic = SyntheticExecutor::new(1.0, 0.0);
    let store = synthetic.store(&folder.path().join("a.space"), 1);
    synthetic.expand(&store, 1);
    synthetic.tag_of_walk = |number| match number % 5 {
        1 => ConfigTag::Failed,
        3 => ConfigTag::Terminating,
        _ => ConfigTag::Expandable,
    };
    let held_out = held_out(&synthetic, DRAW);
    let mut last = HeldOutProgress::default();
    held_out.run(&store, &mut synthetic, &AtomicBool::new(false), |p| last = *p).expect("runs to its end");
    let truths = truths(&store);
    let [counts, beyond, failed] = [ConfigTag::Expandable, ConfigTag::Terminating, ConfigTag::Failed]
        .map(|tag| truths.iter().filter(|(_, truth)| truth.tag() == tag).count());
    assert_eq!(counts, 60, "{beyond} beyond, {failed} failed");
    assert!(beyond > 5 && failed > 5, "{beyond} beyond, {failed} failed");
    assert_eq!((last.walks, last.total), (60, 60), "the progress is complete");
}

#[test]
fn all_walks_that_were_done_before_a_stop_are_committed_and_none_is_cut_short() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.space");
    let mut synthetic = SyntheticExecutor::new(1.0, 0.0);
    let store = synthetic.store(&path, 1);
    let held_out = held_out(&synthetic, Draw { regular_m: Some(5e-3), random: 9, uniform: 0, ..DRAW });
    let mut before = 0;
    for walks in [1, 12] {
        let (stop, mut told) = (AtomicBool::new(false), 0);
        let ended = held_out.run(&store, &mut synthetic, &stop, |p| {
            told = p.walks_now;
            stop.store(told >= walks, Ordering::Relaxed);
        });
        assert!(matches!(ended, Err(HeldOutError::Interrupted)), "{ended:?}");
        before += told;
        // The writer stays open: the reader does not see its uncommitted rows.
        let done = Store::open(&path).and_then(|reader| reader.walks_done(0)).expect("a reader can open it");
        assert_eq!(done.len(), before);
    }
    held_out.run(&store, &mut synthetic, &AtomicBool::new(false), |_| ()).expect("runs to its end");
    assert_eq!(truths(&store).len(), 26 * 5 + 9 * 200);
}
