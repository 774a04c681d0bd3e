//! A space of scattered positions: the same bits whoever solves it and however often it is stopped, and forces within the tolerance.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use palpate_core::{Method, Organ};
use palpate_host::BlobFile;
use palpate_precompute::blob_writer::{PackOptions, pack};
use palpate_precompute::certificate::certify;
use palpate_precompute::configuration_space::{
    ExpansionError, Plans, Sampling, Scattered, SpacePlan, Store, with_threads,
};
use palpate_precompute::held_out::{Draw, HeldOut};
use palpate_precompute::scattered::{Tolerance, Verdict};
use palpate_tests::space_bench::SpaceBench;

const TOLERANCE: Tolerance = Tolerance { relative: 0.035, absolute_n: 0.005 };

fn bench() -> SpaceBench {
    let mut bench = SpaceBench::new(1.0);
    bench.identity.sampling =
        Sampling::Scattered(Scattered { radius_m: 0.01, tolerance: TOLERANCE, only_push: false });
    bench
}

/// Where, and the bits of force and energy, in the order of the store.
fn bits(store: &Store) -> Vec<([i32; 3], u32, [u64; 4])> {
    let records = store.attempts(0).expect("records");
    let of = |r: &palpate_precompute::configuration_space::Record| {
        let [x, y, z] = r.force_n.map(f64::to_bits);
        (r.index, r.round, [r.energy_j.to_bits(), x, y, z])
    };
    records.iter().map(of).collect()
}

#[test]
fn threads_and_interruptions_change_nothing_and_the_error_is_within_tolerance() {
    let (bench, folder) = (bench(), tempfile::tempdir().expect("a folder for the stores"));
    let (one, counts) = bench.solve(&folder.path().join("one.space"), 1);
    assert!((8..60).contains(&counts.solved()), "{counts:?}");
    assert_eq!(bench.still_to_solve(&one), 0);
    let (two, _) = bench.solve(&folder.path().join("two.space"), 2);
    assert_eq!(bits(&one), bits(&two));

    // Stopped again and again, each time after two more.
    let path = folder.path().join("torn.space");
    for round in 0..100 {
        let (store, stop) = (bench.store(&path).expect("the store opens"), AtomicBool::new(false));
        let ended = bench.expand(&store, 2, &stop, |p| stop.store(p.solved_now >= 2, Ordering::Relaxed));
        match ended {
            Ok(_) => break,
            Err(ExpansionError::Interrupted) => assert!(round < 99, "it never ends"),
            Err(error) => panic!("{error}"),
        }
    }
    let torn = Store::open(&path).expect("the store opens");
    assert_eq!(bits(&one), bits(&torn));

    let (plan, open) = Plans::of(&one).expect("plans").replayed(0, &one.attempts(0).expect("records"));
    let SpacePlan::Scattered(plan) = plan else { panic!("not scattered") };
    assert_eq!((plan.verdict(), open), (Some(Verdict::Passed), 0));

    // Fresh truth, and what the blob says of it.
    let draw = Draw { uniform: 60, random: 0, regular_m: None, ..Draw::PAPER };
    let held_out = HeldOut {
        actives: vec![(0, "A".into())],
        sampling: bench.identity.sampling,
        draw,
        keep_displacements: true,
    };
    let workshop: Arc<_> = bench.workshop();
    let solved = with_threads(&workshop, 2, |crew| held_out.run(&one, crew, &AtomicBool::new(false), |_| ()));
    solved.expect("the truth is solved");
    let options = PackOptions { methods: &[Method::Energy], intermediate: false, threads: 2 };
    let file = BlobFile::of(&pack(&one, &options).expect("it packs").bytes().expect("bytes"));
    let organ: Organ<'_> = Organ::read(file.bytes()).expect("a blob");
    let certificate = certify(&one, &organ).expect("measured");
    let space = &certificate.spaces[0];
    let uniform = &space.methods[0].uniform;
    assert_eq!(uniform.count, 60);
    // Absolute tolerance 5 mN; forces of up to 1 N.
    assert!(uniform.p99_n < 0.02 && uniform.mean_n < 0.005, "{uniform:?}");
    let displacement = space.displacement.as_ref().expect("displacements");
    assert!(displacement.uniform.rms_max_mm < 0.2, "{displacement:?}");
}
