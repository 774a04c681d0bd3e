//! A space of scattered positions: the same bits for any number of threads and interruptions, and force
//! errors within the tolerance.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use palpate_core::{Method, Organ};
use palpate_host::BlobFile;
use palpate_precompute::adaptive::{STREAK, Verdict};
use palpate_precompute::certificate::{MethodCertificate, SpaceCertificate, answers, certify};
use palpate_precompute::held_out::{Draw, HeldOut};
use palpate_precompute::pack::{PackOptions, pack};
use palpate_precompute::space::{ExpansionError, Kind, Store, state, with_threads};
use palpate_precompute::spec::{Sampling, Scattered, Tolerance};
use palpate_tests::space_bench::SpaceBench;

const TOLERANCE: Tolerance = Tolerance { relative: 0.035, absolute_n: 0.005 };

/// The scattered sampling of a tool with this radius.
fn scattered(radius_m: f64) -> Scattered {
    Scattered { radius_m, tolerance: TOLERANCE, only_push: false, workspace_m: None }
}

fn energy(space: &SpaceCertificate) -> &MethodCertificate {
    space.methods.iter().find(|of| of.method == Method::Energy.name()).expect("packed")
}

fn bench() -> SpaceBench {
    let mut bench = SpaceBench::new(1.0);
    bench.identity.sampling = Sampling::Scattered(scattered(0.01));
    bench
}

/// With small displacements the linear body suffices, for any number of threads, and independent held-out
/// solutions agree.
#[test]
fn small_displacements_are_stored_as_a_linear_body() {
    let (mut bench, folder) = (bench(), tempfile::tempdir().expect("a folder for the stores"));
    let verdict = |store: &Store| {
        let fit = state(store, 0).expect("readable").fit.expect("scattered");
        (fit.verdict, fit.linear)
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
    assert_eq!((ended, counts.solved(), suits.tests), (Some(Verdict::Linear), STREAK, STREAK));
    assert!(suits.worst <= 1.0);

    let held_out = HeldOut {
        actives: vec![(0, "A".into())],
        sampling: bench.identity.sampling,
        draw: Draw { uniform: 40, random: 0, regular_m: None, ..Draw::PAPER },
        places: None,
        keep_displacements: true,
    };
    let context: Arc<_> = bench.context();
    let solved =
        with_threads(&context, 2, |executor| held_out.run(&one, executor, &AtomicBool::new(false), |_| ()));
    solved.expect("the held-out truth is solved");
    let options = PackOptions { methods: &[Method::Energy], use_intermediate_states: false, threads: 2 };
    let file = BlobFile::of(&pack(&one, &options).expect("the space packs").bytes().expect("bytes"));
    let organ: Organ<'_> = Organ::read(file.bytes()).expect("a blob");
    let space = &certify(&one, &organ).expect("measured").spaces[0];
    assert_eq!(space.linear, Some(suits));
    // One cell along the radius, and the errors at the held-out positions.
    assert_eq!(organ.spaces[0].lattice().reach(), 1);
    let uniform = &energy(space).uniform;
    assert!(uniform.count == 40 && uniform.max_n < 1.5 * TOLERANCE.absolute_n, "{uniform:?}");
    let displacement = space.displacement.as_ref().expect("displacements");
    assert!(displacement.modes <= 3 && displacement.uniform.rms_max_mm < 0.1, "{displacement:?}");
}

/// Half of the ball is outside the device's workspace. No positions are solved or certified there.
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
    // The adaptive sampling needs as many validation passes as for the whole ball, so the saving is small for
    // this simple body.
    println!("{counts:?}, the whole ball {all:?}");
    let beyond = |store: &Store| bits(store).iter().filter(|(at, ..)| at[2] > 1001).count();
    assert!(beyond(&one) == 0 && beyond(&whole) > 0);

    // Paths leave the workspace, uniform positions do not. Only positions inside are counted.
    let draw = Draw { uniform: 40, random: 0, regular_m: Some(0.01), ..Draw::PAPER };
    let held_out = HeldOut {
        actives: vec![(0, "A".into())],
        sampling: bench.identity.sampling,
        draw,
        places: None,
        keep_displacements: false,
    };
    let context: Arc<_> = bench.context();
    let solved =
        with_threads(&context, 2, |executor| held_out.run(&one, executor, &AtomicBool::new(false), |_| ()));
    solved.expect("the held-out truth is solved");
    let mut outside = [0, 0];
    one.each_truth(0, |walk, _, truth| {
        let is_uniform = walk.kind == Kind::Uniform;
        outside[usize::from(is_uniform)] += usize::from(truth.displacement_m[2] > 0.001 + 1e-9);
    })
    .expect("truth");
    assert!(outside[0] > 0 && outside[1] == 0, "{outside:?}");
    let options = PackOptions { methods: &[Method::Energy], use_intermediate_states: false, threads: 2 };
    let file = BlobFile::of(&pack(&one, &options).expect("the space packs").bytes().expect("bytes"));
    let organ: Organ<'_> = Organ::read(file.bytes()).expect("a blob");
    let answers = answers(&one, 0, &organ, Method::Energy).expect("answers");
    assert!(answers.len() > 40 && answers.iter().all(|answer| answer.displacement_m[2] <= 0.001 + 1e-9));
}

/// Positions and the bits of force and energy, in the order of the store.
fn bits(store: &Store) -> Vec<([i32; 3], u32, [u64; 4])> {
    let records = store.attempts(0).expect("records");
    let of = |r: &palpate_precompute::space::Record| {
        let at = r.equilibrium().expect("every position is solved");
        let [x, y, z] = at.force_n.map(f64::to_bits);
        (r.index, r.round, [at.energy_j.to_bits(), x, y, z])
    };
    records.iter().map(of).collect()
}

#[test]
fn threads_and_interruptions_change_no_bit_and_the_error_is_within_tolerance() {
    let (bench, folder) = (bench(), tempfile::tempdir().expect("a folder for the stores"));
    let (one, counts) = bench.solve(&folder.path().join("one.space"), 1);
    assert!((8..60).contains(&counts.solved()), "{counts:?}");
    assert_eq!(bench.still_to_solve(&one), 0);
    let (two, _) = bench.solve(&folder.path().join("two.space"), 2);
    assert_eq!(bits(&one), bits(&two));

    // Interrupted repeatedly, after every two configurations.
    let path = folder.path().join("torn.space");
    for round in 0..100 {
        let (store, stop) = (bench.store(&path).expect("the store opens"), AtomicBool::new(false));
        let ended = bench.expand(&store, 2, &stop, |p| stop.store(p.solved_now >= 2, Ordering::Relaxed));
        match ended {
            Ok(_) => break,
            Err(ExpansionError::Interrupted) => assert!(round < 99, "the space never completes"),
            Err(error) => panic!("{error}"),
        }
    }
    let torn = Store::open(&path).expect("the store opens");
    assert_eq!(bits(&one), bits(&torn));

    let ended = state(&one, 0).expect("readable");
    assert_eq!((ended.fit.expect("scattered").verdict, ended.open), (Some(Verdict::Passed), 0));

    // Held-out solutions, and the errors of the blob at their positions.
    let draw = Draw { uniform: 60, random: 0, regular_m: None, ..Draw::PAPER };
    let held_out = HeldOut {
        actives: vec![(0, "A".into())],
        sampling: bench.identity.sampling,
        draw,
        places: None,
        keep_displacements: true,
    };
    let context: Arc<_> = bench.context();
    let solved =
        with_threads(&context, 2, |executor| held_out.run(&one, executor, &AtomicBool::new(false), |_| ()));
    solved.expect("the held-out truth is solved");
    let methods = &[Method::Energy, Method::Kernel];
    let options = PackOptions { methods, use_intermediate_states: false, threads: 2 };
    let packed = pack(&one, &options).expect("the space packs");
    packed.expect_kernels().expect("the fit is packed");
    let file = BlobFile::of(&packed.bytes().expect("bytes"));
    let organ: Organ<'_> = Organ::read(file.bytes()).expect("a blob");
    let certificate = certify(&one, &organ).expect("measured");
    let space = &certificate.spaces[0];
    let uniform = &energy(space).uniform;
    assert_eq!(uniform.count, 60);
    // Absolute tolerance 5 mN, with forces of up to 1 N.
    assert!(uniform.p99_n < 0.02 && uniform.mean_n < 0.005, "{uniform:?}");
    // The certificate uses the scene's tolerance, which is a quarter of the human just-noticeable difference.
    let tolerated = energy(space).tolerated.expect("the certificate has a tolerance");
    assert_eq!(tolerated.tolerance, TOLERANCE);
    assert!(tolerated.count >= 57 && tolerated.count <= uniform.below_jnd, "{tolerated:?}");
    // The table differs from the kernel fit by at most a tenth of the tolerance.
    let of = |method: Method| space.methods.iter().find(|m| m.method == method.name()).expect("packed");
    let (energy, kernel) = (of(Method::Energy), of(Method::Kernel));
    assert!(
        kernel.uniform.p99_n < 0.02 && (kernel.uniform.mean_n - energy.uniform.mean_n).abs() < 1e-3,
        "{kernel:?}"
    );
    assert!(20 * kernel.uniform.covered >= 19 * kernel.uniform.count, "{:?}", kernel.uniform);
    assert!(kernel.probe.rounding_n < 1e-5, "{:?}", kernel.probe);
    kernel_is_the_fit(&one, &organ);
    let displacement = space.displacement.as_ref().expect("displacements");
    assert!(displacement.uniform.rms_max_mm < 0.2, "{displacement:?}");
}

/// Compares force and stiffness of the blob with the offline fit within the tool's reach. A fit has a small
/// residual force at rest.
fn kernel_is_the_fit(store: &Store, organ: &Organ<'_>) {
    let (search, space) = (state(store, 0).expect("readable").fit.expect("scattered"), &organ.spaces[0]);
    let (fit, rest) = (&search.fit, search.fit.force_n([0.0; 3]));
    let (mut compared, mut worst_n) = (0, 0.0_f64);
    for at in search.places(600) {
        let at = at.map(|x| x as f32);
        let found = space.estimate(Method::Kernel, at).expect("packed");
        if found.energy_j.is_none() {
            continue;
        }
        compared += 1;
        let exact = fit.jet(at.map(f64::from));
        for i in 0..3 {
            worst_n = worst_n.max((f64::from(found.force_n[i]) - (exact.force_n[i] - rest[i])).abs());
            for j in 0..3 {
                let (a, b) = (f64::from(found.stiffness_n_m[i][j]), exact.stiffness_n_m[(i, j)]);
                assert!((a - b).abs() < 1e-3 + 1e-5 * b.abs(), "{i}{j}: {a} {b}");
            }
        }
    }
    println!("{compared} positions, {worst_n:.2e} N from the fit; residual at rest {rest:?} N");
    assert!(compared > 500 && worst_n < 1e-6, "{compared} {worst_n}");
}
