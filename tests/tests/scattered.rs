//! A space of scattered positions: the same bits whoever solves it and however often it is stopped, and forces within the tolerance.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use palpate_core::{Method, Organ};
use palpate_host::BlobFile;
use palpate_precompute::blob_writer::{PackOptions, pack};
use palpate_precompute::certificate::{answers, certify};
use palpate_precompute::configuration_space::{
    ExpansionError, Plans, Sampling, Scattered, SpacePlan, Store, with_threads,
};
use palpate_precompute::held_out::{Draw, HeldOut, Kind};
use palpate_precompute::scattered::{PASSES, Tolerance, Verdict};
use palpate_tests::space_bench::SpaceBench;

const TOLERANCE: Tolerance = Tolerance { relative: 0.035, absolute_n: 0.005 };

/// Of a tool that moves so far.
fn scattered(radius_m: f64) -> Scattered {
    Scattered { radius_m, tolerance: TOLERANCE, only_push: false, workspace_m: None }
}

fn bench() -> SpaceBench {
    let mut bench = SpaceBench::new(1.0);
    bench.identity.sampling = Sampling::Scattered(scattered(0.01));
    bench
}

/// A tool that gets nowhere: the linear body is enough, on any number of threads, and fresh truth agrees.
#[test]
fn small_displacements_are_stored_as_a_linear_body() {
    let (mut bench, folder) = (bench(), tempfile::tempdir().expect("a folder for the stores"));
    let verdict = |store: &Store| {
        let (plan, _) = Plans::of(store).expect("plans").replayed(0, &store.attempts(0).expect("records"));
        let SpacePlan::Scattered(plan) = plan else { panic!("not scattered") };
        (plan.verdict(), plan.search().expect("a search").linear())
    };
    let (far, _) = bench.solve(&folder.path().join("far.space"), 2);
    let (ended, suits) = verdict(&far);
    assert!(ended == Some(Verdict::Passed) && suits.worst > 1.0, "{ended:?} {suits:?}");

    bench.identity.sampling = Sampling::Scattered(scattered(0.0005));
    let (one, counts) = bench.solve(&folder.path().join("near-one.space"), 1);
    let (two, _) = bench.solve(&folder.path().join("near-two.space"), 2);
    assert_eq!(bits(&one), bits(&two));
    let (ended, suits) = verdict(&one);
    println!("{counts:?} {suits:?}");
    assert_eq!((ended, counts.solved(), suits.tests), (Some(Verdict::Linear), PASSES, PASSES));
    assert!(suits.worst <= 1.0);

    let held_out = HeldOut {
        actives: vec![(0, "A".into())],
        sampling: bench.identity.sampling,
        draw: Draw { uniform: 40, random: 0, regular_m: None, ..Draw::PAPER },
        keep_displacements: true,
    };
    let workshop: Arc<_> = bench.workshop();
    let solved = with_threads(&workshop, 2, |crew| held_out.run(&one, crew, &AtomicBool::new(false), |_| ()));
    solved.expect("the truth is solved");
    let options = PackOptions { methods: &[Method::Energy], intermediate: false, threads: 2 };
    let file = BlobFile::of(&pack(&one, &options).expect("it packs").bytes().expect("bytes"));
    let organ: Organ<'_> = Organ::read(file.bytes()).expect("a blob");
    let space = &certify(&one, &organ).expect("measured").spaces[0];
    assert_eq!(space.linear, Some(suits));
    // One cell along the radius, and what the fresh positions say of it.
    assert_eq!(organ.spaces[0].lattice.reach(), 1);
    let uniform = &space.methods[0].uniform;
    assert!(uniform.count == 40 && uniform.max_n < 1.5 * TOLERANCE.absolute_n, "{uniform:?}");
    let displacement = space.displacement.as_ref().expect("displacements");
    assert!(displacement.modes <= 3 && displacement.uniform.rms_max_mm < 0.1, "{displacement:?}");
}

/// Half of the ball is out of the device's workspace: nothing is solved there, and nothing is certified there.
#[test]
fn nothing_is_solved_outside_the_workspace() {
    let (mut bench, folder) = (bench(), tempfile::tempdir().expect("a folder for the stores"));
    let (whole, all) = bench.solve(&folder.path().join("whole.space"), 2);
    let node = whole.active().expect("active nodes")[0].1;
    let rest_m = whole.body().expect("a body").0.nodes_m[node as usize];
    let low = rest_m.map(|x| x - 0.02);
    let high = [rest_m[0] + 0.02, rest_m[1] + 0.02, rest_m[2] + 0.001];
    bench.identity.sampling =
        Sampling::Scattered(Scattered { workspace_m: Some([low, high]), ..scattered(0.01) });
    let (one, counts) = bench.solve(&folder.path().join("one.space"), 1);
    let (two, _) = bench.solve(&folder.path().join("two.space"), 2);
    assert_eq!(bits(&one), bits(&two));
    // Its stop takes as many passes as that of the whole ball: few are saved in a body as simple as this.
    println!("{counts:?}, the whole ball {all:?}");
    let beyond = |store: &Store| bits(store).iter().filter(|(at, ..)| at[2] > 1001).count();
    assert!(beyond(&one) == 0 && beyond(&whole) > 0);

    // Paths lead out of it, uniform positions do not; what is counted are those within.
    let draw = Draw { uniform: 40, random: 0, regular_m: Some(0.01), ..Draw::PAPER };
    let held_out = HeldOut {
        actives: vec![(0, "A".into())],
        sampling: bench.identity.sampling,
        draw,
        keep_displacements: false,
    };
    let workshop: Arc<_> = bench.workshop();
    let solved = with_threads(&workshop, 2, |crew| held_out.run(&one, crew, &AtomicBool::new(false), |_| ()));
    solved.expect("the truth is solved");
    let mut outside = [0, 0];
    one.each_truth(0, |walk, _, truth| {
        let is_uniform = walk.kind == Kind::Uniform;
        outside[usize::from(is_uniform)] += usize::from(truth.displacement_m[2] > 0.001 + 1e-9);
    })
    .expect("truth");
    assert!(outside[0] > 0 && outside[1] == 0, "{outside:?}");
    let options = PackOptions { methods: &[Method::Energy], intermediate: false, threads: 2 };
    let file = BlobFile::of(&pack(&one, &options).expect("it packs").bytes().expect("bytes"));
    let organ: Organ<'_> = Organ::read(file.bytes()).expect("a blob");
    let answers = answers(&one, 0, &organ.spaces[0], Method::Energy).expect("answers");
    assert!(answers.len() > 40 && answers.iter().all(|answer| answer.displacement_m[2] <= 0.001 + 1e-9));
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
