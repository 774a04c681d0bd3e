//! The certificate measures the packed bytes and detects wrong ones.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use palpate_core::{Method, Organ};
use palpate_host::BlobFile;
use palpate_precompute::certificate::{Certificate, MethodCertificate, certify};
use palpate_precompute::fem::Problem;
use palpate_precompute::fem::material::{Material, MooneyRivlin};
use palpate_precompute::held_out::{Draw, HeldOut};
use palpate_precompute::pack::{PackOptions, pack};
use palpate_precompute::space::{Store, with_threads};
use palpate_precompute::spec::Tolerance;
use palpate_tests::soft_beam;
use palpate_tests::space_bench::SpaceBench;

const DRAW: Draw = Draw { regular_m: Some(0.01), random: 4, random_steps: 30, uniform: 40, ..Draw::PAPER };

/// A beam with the material of the tests, scaled by `factor`.
fn bench(factor: f64) -> SpaceBench {
    let law = Material::MooneyRivlin(MooneyRivlin { c10_pa: 1300.0 * factor, c01_pa: 1280.0 * factor });
    let (_, _, active, body) = soft_beam(law);
    SpaceBench { problem: Arc::new(Problem::new(body, active)), ..SpaceBench::new(f64::INFINITY) }
}

fn blob(store: &Store) -> BlobFile {
    let options = PackOptions { methods: &Method::OF_LATTICE, use_intermediate_states: false, threads: 2 };
    BlobFile::of(&pack(store, &options).and_then(|packed| packed.bytes()).expect("the space packs"))
}

fn method(certificate: &Certificate, method: Method) -> &MethodCertificate {
    let all = &certificate.spaces[0].methods;
    all.iter().find(|m| m.method == method.name()).expect("the method is packed")
}

#[test]
fn the_certificate_separates_good_tables_from_bad_ones() {
    let folder = tempfile::tempdir().expect("a folder for the stores");
    let bench_of_truth = bench(1.0);
    let (store, _) = bench_of_truth.solve(&folder.path().join("truth.space"), 2);
    let actives = vec![(0, "A".to_string())];
    let held_out = HeldOut {
        actives,
        sampling: bench_of_truth.identity.sampling,
        draw: DRAW,
        places: None,
        keep_displacements: true,
    };
    with_threads(&bench_of_truth.context(), 2, |executor| {
        held_out.run(&store, executor, &AtomicBool::new(false), |_| ())
    })
    .expect("the held-out truth is solved");

    let file = blob(&store);
    let organ: Organ<'_> = Organ::read(file.bytes()).expect("a valid blob");
    assert_eq!(organ.max_force_n, f32::INFINITY, "the scene has no force limit");
    let good = certify(&store, &organ).expect("intact");
    let space = &good.spaces[0];
    assert_eq!((space.active.as_str(), space.cost.configurations, space.branch_jump_pairs), ("A", 125, 0));
    assert_eq!(space.branch_jump_volume, 0.0);
    for m in &space.methods {
        assert_eq!((m.uniform.count, m.random.count, m.at_branch_jumps.count), (40, 120, 0), "{}", m.method);
        // 26 paths of ten steps of 1 mm. Along the six axes, steps 5 and 10 are grid points. Step 10 is on
        // the rim, so rounding determines on which side it lies.
        assert!((26 * 9 - 6..=26 * 10 - 12).contains(&m.regular.count), "{}: {}", m.method, m.regular.count);
        let rings: usize = m.by_radius.iter().map(|ring| ring.count).sum();
        assert_eq!(rings, 40, "{}", m.method);
        assert!(m.probe.rounding_n < 1e-5 && m.probe.seam_n < 1e-4, "{}: {:?}", m.method, m.probe);
        assert!(m.probe.work.circles == 200 && m.probe.nanoseconds > 1.0, "{}: {:?}", m.method, m.probe);
    }
    let [energy, hermite, cubic, linear] =
        [Method::Energy, Method::Hermite, Method::RbfCubic, Method::Trilinear].map(|m| method(&good, m));
    assert!(energy.uniform.mean_n < hermite.uniform.mean_n && hermite.uniform.mean_n < cubic.uniform.mean_n);
    assert!(cubic.uniform.mean_n < linear.uniform.mean_n);
    assert!(energy.probe.work.max < 1e-4 && linear.probe.work.max > 10.0 * energy.probe.work.max);
    assert_eq!(energy.uniform.below_jnd, 40);
    assert!((energy.below_jnd_certified - 0.05f64.powf(1.0 / 40.0)).abs() < 1e-9, "0 of 40");

    // The same positions in a blob of a body 10 % stiffer: every method has a relative error of 10 %.
    let (stiffer, _) = bench(1.1).solve(&folder.path().join("stiffer.space"), 2);
    let file = blob(&stiffer);
    let organ: Organ<'_> = Organ::read(file.bytes()).expect("a valid blob");
    let bad = certify(&store, &organ).expect("intact");
    for m in &bad.spaces[0].methods {
        assert!((m.uniform.relative_mean - 0.1).abs() < 0.02, "{}: {:?}", m.method, m.uniform);
        assert!(
            m.uniform.mean_n > Tolerance::IMPERCEPTIBLE.absolute_n && m.uniform.below_jnd < 10,
            "{}: {:?}",
            m.method,
            m.uniform
        );
        assert!(m.below_jnd_certified < 0.5, "{}", m.method);
    }
}
