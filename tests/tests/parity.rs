//! The core's f32 compared with the same tables evaluated in f64: within the rounding bound of the blob, for
//! every method and every instruction set of this machine.
//!
//! `firmware-like-core/check-cortex-m` shows that a Cortex-M gives the same bits;
//! `host/tests/instructions.rs` shows it for wider registers.

use palpate_core::{AlignedBytes, Method, Organ, Vec3};
use palpate_host::{Instructions, Interpolator};
use palpate_precompute::certificate::{Certificate, reference_force_n};

/// Uniform positions in the ball, the same in every run.
fn positions(radius_m: f32) -> impl Iterator<Item = Vec3> {
    let mut bits = 99_u64;
    let mut next = move || {
        bits = bits.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((bits >> 40) as f32 / 8_388_608.0 - 1.0) * radius_m
    };
    let points = std::iter::repeat_with(move || [next(), next(), next()]);
    points.filter(move |d: &Vec3| d.iter().map(|x| x * x).sum::<f32>() < (0.999 * radius_m).powi(2))
}

#[test]
fn rounding_in_the_core_is_within_the_certified_bound() {
    let blob = AlignedBytes::from(include_bytes!("../../firmware-like-core/golden/organ-514.blob"));
    let organ: Organ<'_> = Organ::read(&blob).expect("the golden blob is valid");
    let certificate: Certificate =
        serde_json::from_slice(organ.certificate.expect("a certificate")).expect("of this version");
    let space = &organ.spaces[0];
    println!("method       largest  bound, mN   instructions");
    for method in Method::OF_LATTICE {
        let measured = certificate.spaces[0].methods.iter().find(|m| m.method == method.name());
        let bound_n = measured.expect("certified").probe.rounding_bound_n;
        for instructions in Instructions::ALL {
            let Some(interpolator) = Interpolator::with_instructions(instructions, method) else { continue };
            let mut largest_n = 0.0_f64;
            for d in positions(space.lattice().radius_m()).take(100_000) {
                let exact_n = reference_force_n(space, method, d).expect("packed");
                let found_n = interpolator.force(space, &d).expect("packed").force_n;
                let apart = (0..3).map(|i| (exact_n[i] - f64::from(found_n[i])).powi(2)).sum::<f64>().sqrt();
                largest_n = largest_n.max(apart);
            }
            println!(
                "{:<11} {:8.5} {:8.5}    {}",
                method.name(),
                1e3 * largest_n,
                1e3 * bound_n,
                instructions.name()
            );
            assert!(
                largest_n <= bound_n,
                "{method:?} on {instructions}: {largest_n} N, the bound is {bound_n} N"
            );
            assert!(largest_n > 0.01 * bound_n, "{method:?}: the bound is too loose");
        }
    }
}
