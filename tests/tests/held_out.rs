//! Held-out solutions: the same bits for any number of threads, at the drawn positions, and never on a grid
//! point. `tools/tests/space_faults` interrupts them.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use palpate_core::ConfigTag;
use palpate_precompute::fem::Solver;
use palpate_precompute::held_out::{
    Draw, HeldOut, HeldOutError, HeldOutProgress, Summary, is_on_training_lattice,
};
use palpate_precompute::num::norm;
use palpate_precompute::space::{Kind, Store, Truth, with_threads};
use palpate_tests::space_bench::SpaceBench;

const DRAW: Draw =
    Draw { seed: 3, step_m: 5e-4, regular_m: Some(6e-3), random: 3, random_steps: 24, uniform: 12 };

fn solve(
    bench: &SpaceBench,
    store: &Store,
    draw: Draw,
    threads: usize,
    stop: &AtomicBool,
    progress: impl FnMut(&HeldOutProgress),
) -> Result<(), HeldOutError> {
    let actives = vec![(0, "A".to_string())];
    let held_out =
        HeldOut { actives, sampling: bench.identity.sampling, draw, places: None, keep_displacements: true };
    with_threads(&bench.context(), threads, |executor| held_out.run(store, executor, stop, progress))
}

fn solved(bench: &SpaceBench, path: &Path, draw: Draw, threads: usize) -> Store {
    let (store, _) = bench.solve(path, 2);
    solve(bench, &store, draw, threads, &AtomicBool::new(false), |_| ()).expect("the run completes");
    store
}

/// Every held-out solution by kind, walk and step.
fn truths(store: &Store) -> BTreeMap<(Kind, u32, u32), Truth> {
    let mut all = BTreeMap::new();
    store
        .each_truth(0, |walk, step, truth| {
            all.insert((walk.kind, walk.number, step), truth.clone());
        })
        .expect("intact");
    all
}

/// All held-out solutions except the seconds, bit for bit.
fn bits(store: &Store) -> Vec<String> {
    let truths = truths(store).into_iter();
    truths.map(|(key, truth)| format!("{key:?} {:?}", Truth { seconds: 0.0, ..truth })).collect()
}

#[test]
fn threads_and_extensions_change_no_bit() {
    let bench = SpaceBench::new(1.0);
    let folder = tempfile::tempdir().expect("a folder for the stores");
    let at = |name: &str| folder.path().join(name);
    let expected = bits(&solved(&bench, &at("one.space"), DRAW, 1));
    assert_eq!(expected, bits(&solved(&bench, &at("two.space"), DRAW, 2)));

    let grown = solved(&bench, &at("grown.space"), Draw { random: 1, uniform: 5, ..DRAW }, 2);
    solve(&bench, &grown, DRAW, 2, &AtomicBool::new(false), |_| ()).expect("the run completes");
    assert_eq!(expected, bits(&grown), "an extension keeps the earlier ones");
}

#[test]
fn every_kind_is_at_its_position_and_in_equilibrium() {
    let bench = SpaceBench::new(1.0);
    let folder = tempfile::tempdir().expect("a folder for the stores");
    let store = solved(&bench, &folder.path().join("a.space"), DRAW, 2);
    let (all, sums) = (truths(&store), Summary::of(&store, 0).expect("intact"));
    let [regular, random, uniform] = [Kind::Regular, Kind::Random, Kind::Uniform].map(|kind| &sums[&kind]);
    assert_eq!((regular.walks, random.walks, uniform.whole), (26, 3, 12));
    assert!(regular.at_force_limit > 0 && uniform.at_force_limit > 0, "the force limit is reached: {sums:?}");
    assert_eq!(uniform.walks, uniform.whole + uniform.at_force_limit + uniform.failures());

    let nodes = bench.mesh.nodes_m.len();
    let mut solver = Solver::new(bench.problem.clone());
    let rest = solver.rest().expect("the beam is fixed");
    for (n, ((kind, number, step), truth)) in all.iter().enumerate() {
        let beyond = truth.equilibrium().is_some_and(|at| norm(at.force_n) >= 1.0);
        assert_eq!(truth.tag() == ConfigTag::Terminating, beyond, "{kind:?} {number} {step}");
        let last = !all.contains_key(&(*kind, *number, step + 1));
        assert!(last || truth.tag() == ConfigTag::Expandable, "a path ends where it leaves the reach");
        assert_eq!(truth.displacements.len(), if *kind == Kind::Uniform { 12 * nodes } else { 0 });
        let cells = truth.displacement_m.map(|x| x / bench.grid.spacing_m);
        let on_grid = cells.iter().all(|x| (x - x.round()).abs() < 1e-6);
        assert_eq!(is_on_training_lattice(&bench.grid, None, truth.displacement_m), on_grid);
        assert!(*kind == Kind::Regular || !on_grid);
        if let Some(at) = truth.equilibrium().filter(|_| n % 11 == 0) {
            let fresh = solver.advance(&rest.seed, truth.displacement_m).expect("converges");
            let error = (0..3).map(|i| (fresh.jet().force_n[i] - at.force_n[i]).abs()).fold(0.0, f64::max);
            assert!(error < 1e-9, "{kind:?} {number} {step}: {error} N");
        }
    }
    // The solution of a uniform position displaces the active node to that position.
    let ((_, number, _), truth) =
        all.iter().find(|((k, ..), _)| *k == Kind::Uniform).expect("there is a uniform position");
    let active = &truth.displacements[12 * bench.active as usize..][..12];
    let moved: Vec<f32> = active.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
    assert_eq!(moved, truth.displacement_m.map(|x| x as f32), "uniform {number}");
}

#[test]
fn intact_records_of_a_damaged_file_are_kept_and_the_rest_gets_the_same_bits() {
    const PAGE: usize = 4096;
    let bench = SpaceBench::new(1.0);
    let folder = tempfile::tempdir().expect("a folder for the stores");
    let path = folder.path().join("a.space");
    let expected = bits(&solved(&bench, &path, DRAW, 2));
    let whole = std::fs::read(&path).expect("checkpointed when the last handle closed");
    let damaged = |store: &Store| {
        store.each_truth(0, |_, _, _| ()).err().is_some_and(|e| e.to_string().contains("--salvage"))
    };
    let (mut hit, mut most_kept) = (0, 0);
    for page in 1..whole.len() / PAGE {
        let torn = folder.path().join(format!("torn{page}.space"));
        let mut bytes = whole.clone();
        for byte in &mut bytes[page * PAGE + 100..page * PAGE + PAGE - 100] {
            *byte ^= 0x5a;
        }
        std::fs::write(&torn, bytes).expect("written");
        if !Store::open(&torn).is_ok_and(|store| damaged(&store)) {
            continue;
        }
        hit += 1;
        let active = [("A".to_string(), bench.active)];
        let (saved, report) = Store::salvage(&torn, &bench.identity, &bench.mesh, &bench.fixed, &active)
            .unwrap_or_else(|error| panic!("page {page}: {error}"));
        most_kept = most_kept.max(report.walks);
        bench.expand(&saved, 2, &AtomicBool::new(false), |_| ()).expect("the space completes");
        solve(&bench, &saved, DRAW, 2, &AtomicBool::new(false), |_| ()).expect("the run completes");
        assert_eq!(bits(&saved), expected, "page {page}");
    }
    let walks = truths_walks(&expected);
    assert!(hit > 3, "{hit} pages hold truth");
    assert!(most_kept > walks / 2 && most_kept < walks, "{most_kept} of {walks} walks kept");
}

/// Number of paths among the rows of [`bits`]: each has a first step.
fn truths_walks(bits: &[String]) -> usize {
    bits.iter().filter(|row| row.split(')').next().is_some_and(|key| key.ends_with(", 1"))).count()
}
