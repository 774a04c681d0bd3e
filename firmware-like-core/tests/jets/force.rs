//! The force of one jet inside and beyond its trust radius.

use palpate_core::vec3::{self, Vec3};
use palpate_core::{Coverage, Jet};
use proptest::prelude::*;

use crate::common::jets::jet;
use crate::common::{Monomial, Random, polynomial, potential};

/// A cubic with every monomial.
const CUBIC: [Monomial; 19] = [
    (2.0, [1, 0, 0]),
    (-1.0, [0, 1, 0]),
    (3.0, [0, 0, 1]),
    (150.0, [2, 0, 0]),
    (40.0, [1, 1, 0]),
    (-30.0, [1, 0, 1]),
    (200.0, [0, 2, 0]),
    (25.0, [0, 1, 1]),
    (180.0, [0, 0, 2]),
    (5e3, [3, 0, 0]),
    (-2e3, [2, 1, 0]),
    (1e3, [2, 0, 1]),
    (3e3, [1, 2, 0]),
    (-4e3, [1, 1, 1]),
    (2e3, [1, 0, 2]),
    (-6e3, [0, 3, 0]),
    (1.5e3, [0, 2, 1]),
    (-1e3, [0, 1, 2]),
    (7e3, [0, 0, 3]),
];

fn cubic(d: Vec3, orders: [usize; 3]) -> f64 {
    polynomial(&CUBIC, d, orders)
}

fn gradient(of: impl Fn(Vec3, [usize; 3]) -> f64, d: Vec3) -> [f64; 3] {
    [of(d, [1, 0, 0]), of(d, [0, 1, 0]), of(d, [0, 0, 1])]
}

fn unit(random: &mut Random) -> Vec3 {
    vec3::normalize_or_zero(random.point(1.0))
}

#[test]
fn a_cubic_energy_is_reproduced() {
    let mut random = Random(3);
    for _ in 0..2_000 {
        let control_m = random.point(0.02);
        let jet = jet(cubic, 0, control_m, 0.02);
        let d = vec3::add(control_m, vec3::scale(unit(&mut random), 0.019_9 * random.next().abs()));
        let found = jet.force(d);
        assert_eq!(found.coverage, Coverage::Scattered);
        for (found, exact) in found.force_n.iter().zip(gradient(cubic, d)) {
            assert!((f64::from(*found) - exact).abs() < 2e-5, "{found} {exact}");
        }
        assert!((f64::from(jet.energy_j(d)) - cubic(d, [0; 3])).abs() < 2e-7);
    }
}

/// The error of the expansion grows with the third power of the distance: terms up to the second are right.
#[test]
fn the_error_of_a_quartic_energy_is_of_third_order() {
    let jet = jet(potential, 0, [0.004, -0.003, -0.01], 0.025);
    let mut random = Random(4);
    for _ in 0..100 {
        let outward = unit(&mut random);
        let error = |distance_m: f32| {
            let d = vec3::add(jet.control_m, vec3::scale(outward, distance_m));
            let exact = gradient(potential, d).map(|h| h as f32);
            vec3::distance(jet.force(d).force_n, exact)
        };
        let order = (error(0.02) / error(0.01)).log2();
        assert!((2.95..3.05).contains(&order), "{order}");
    }
}

#[test]
fn force_and_slopes_are_continuous_at_the_trust_radius() {
    let mut random = Random(5);
    for trust_m in [2e-3, 8e-3] {
        let jet = jet(potential, 0, [0.003, 0.002, -0.012], trust_m);
        for _ in 0..200 {
            let outward = unit(&mut random);
            let across = vec3::normalize_or_zero(vec3::cross(outward, unit(&mut random)));
            let at = |r: f32, t: f32| {
                let along = vec3::add(vec3::scale(outward, r), vec3::scale(across, t));
                jet.force(vec3::add(jet.control_m, along))
            };
            let (inside, outside) = (at(0.999_999 * trust_m, 0.0), at(1.000_001 * trust_m, 0.0));
            assert_eq!(inside.coverage, Coverage::Scattered);
            assert_eq!(outside.coverage, Coverage::Extrapolated);
            assert!(vec3::distance(inside.force_n, outside.force_n) < 1e-5);
            let slope = |from: (f32, f32), to: (f32, f32), step_m: f32| {
                let difference_n = vec3::sub(at(to.0, to.1).force_n, at(from.0, from.1).force_n);
                vec3::scale(difference_n, 1.0 / step_m)
            };
            // Differences on both sides of the radius, along the ray and across it. They approach each other
            // with the step: the slope is about 300 N/m.
            let gap = |step_m: f32| {
                let along = vec3::distance(
                    slope((trust_m - step_m, 0.0), (trust_m, 0.0), step_m),
                    slope((trust_m, 0.0), (trust_m + step_m, 0.0), step_m),
                );
                let (low, high) = (0.999 * trust_m - step_m * step_m / trust_m, 1.001 * trust_m);
                let beside = vec3::distance(
                    slope((low, 0.0), (low, step_m), step_m),
                    slope((high, 0.0), (high, step_m), step_m),
                );
                (along, beside)
            };
            let (along, beside) = gap(1e-4);
            assert!(along < 12.0, "along {along} N/m");
            assert!(beside < 3.0, "across {beside} N/m");
        }
    }
}

#[test]
fn beyond_the_trust_radius_the_force_levels_off() {
    let mut random = Random(6);
    for trust_m in [1e-3_f32, 5e-3, 0.02] {
        let jet = jet(potential, 0, [0.0, 0.0, -0.01], trust_m);
        let length_m = trust_m.max(5e-3);
        for _ in 0..200 {
            let outward = unit(&mut random);
            let at = |r: f32| jet.force(vec3::add(jet.control_m, vec3::scale(outward, r))).force_n;
            let step_m = 1e-2 * trust_m;
            let rim_n = at(trust_m);
            let slope_n_m = vec3::norm(vec3::sub(rim_n, at(trust_m - step_m))) / step_m;
            let level_n = at(trust_m + length_m);
            let most_n = 0.5 * length_m * slope_n_m * 1.02 + 1e-4;
            assert!(vec3::distance(level_n, rim_n) <= most_n, "{level_n:?} {rim_n:?}, {slope_n_m} N/m");
            for far_m in [trust_m + 1.2 * length_m, 0.1, 3.0, 900.0] {
                assert!(vec3::distance(at(far_m), level_n) < 1e-3, "{far_m} m");
            }
        }
        for d in [[1e30, 0.0, 0.0], [f32::MAX; 3], [-f32::MAX, 1.0, f32::MIN_POSITIVE]] {
            assert!(vec3::norm(jet.force(d).force_n) < 20.0, "{d:?}");
        }
    }
}

/// A sphere far from where a jet was solved touches another place or nothing.
#[test]
fn far_from_its_place_a_root_has_no_force() {
    for trust_m in [1e-3_f32, 0.02] {
        let mut jet = jet(potential, 0, [0.0, 0.0, -0.01], trust_m);
        (jet.flags.root, jet.energy_j) = (true, 0.5);
        let length_m = trust_m.max(5e-3);
        let at =
            |beyond_m: f32| jet.force([0.6 * (trust_m + beyond_m), 0.0, -0.01 - 0.8 * (trust_m + beyond_m)]);
        let near_n = vec3::norm(at(0.9 * length_m).force_n);
        assert!(near_n > 0.1, "{near_n} N");
        let mut before_n = at(0.0).force_n;
        for step in 1..=400 {
            let now_n = at(0.01 * length_m * step as f32).force_n;
            assert!(vec3::distance(now_n, before_n) < 0.05 * near_n, "{step}: {now_n:?} after {before_n:?}");
            before_n = now_n;
        }
        assert_eq!(at(3.01 * length_m).force_n, vec3::ZERO);
        assert_eq!(jet.energy_j([0.1, 0.0, -0.01]), 0.0);
        assert_eq!(jet.force([f32::NAN, 0.0, 0.0]).force_n, vec3::ZERO);
    }
}

#[test]
fn a_closed_loop_inside_takes_no_work() {
    let jet = jet(potential, 0, [0.005, -0.002, -0.012], 0.012);
    let mut random = Random(7);
    for _ in 0..20 {
        let (first, second) = (unit(&mut random), unit(&mut random));
        let steps = 4_000;
        let place = |step: u32| {
            let angle = core::f64::consts::TAU * f64::from(step % steps) / f64::from(steps);
            let (sine, cosine) = ((0.007 * angle.sin()) as f32, (0.007 * (2.0 * angle).cos()) as f32);
            let away = vec3::add(vec3::scale(first, sine), vec3::scale(second, cosine));
            vec3::add(jet.control_m, vec3::scale(away, 0.7))
        };
        let (mut work_j, mut turned_j) = (0.0_f64, 0.0_f64);
        for step in 0..steps {
            let (from, to) = (place(step), place(step + 1));
            let mean = vec3::scale(vec3::add(jet.force(from).force_n, jet.force(to).force_n), 0.5);
            let one_j = f64::from(vec3::dot(mean, vec3::sub(to, from)));
            work_j += one_j;
            turned_j += one_j.abs();
        }
        assert!(turned_j > 1e-3, "the path must do work: {turned_j} J");
        assert!(work_j.abs() < 1e-7, "{work_j} J of {turned_j}");
    }
}

/// Between two points in one direction from the control, inside and beyond the radius.
#[test]
fn the_energy_is_the_work_along_a_ray() {
    let jet = jet(potential, 0, [0.001, 0.002, -0.008], 0.006);
    let mut random = Random(8);
    for _ in 0..50 {
        let outward = unit(&mut random);
        let place = |step: u32| vec3::add(jet.control_m, vec3::scale(outward, 1e-5 * step as f32));
        let mut work_j = 0.0_f64;
        for step in 0..2_500 {
            let middle = vec3::scale(vec3::add(place(step), place(step + 1)), 0.5);
            work_j += f64::from(vec3::dot(jet.force(middle).force_n, outward)) * 1e-5;
        }
        let difference_j = f64::from(jet.energy_j(place(2_500)) - jet.energy_j(place(0)));
        assert!((work_j - difference_j).abs() < 2e-6, "{work_j} {difference_j}");
    }
}

/// Any float but NaN and infinity.
fn finite() -> impl Strategy<Value = f32> {
    any::<u32>().prop_map(f32::from_bits).prop_filter("finite", |x| x.is_finite())
}

fn within(most: f32) -> impl Strategy<Value = f32> {
    prop_oneof![-most..=most, Just(most), Just(-most), Just(0.0), finite().prop_map(move |x| x % most)]
}

fn any_jet() -> impl Strategy<Value = Jet> {
    let numbers = prop::collection::vec(within(1e9), 20);
    let trust = prop_oneof![1e-4..=Jet::MAX_TRUST_M, Just(f32::from_bits(1)), Just(f32::MIN_POSITIVE)];
    (prop::array::uniform3(within(0.57)), numbers, trust).prop_map(|(control_m, numbers, trust_m)| Jet {
        control_m,
        energy_j: numbers[0],
        force_n: numbers[1..4].try_into().expect("three"),
        stiffness_n_m: numbers[4..10].try_into().expect("six"),
        third_n_m2: numbers[10..20].try_into().expect("ten"),
        trust_m,
        ..Jet::default()
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 20_000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn every_answer_is_finite(jet in any_jet(), d in prop::array::uniform3(finite()), scale in finite()) {
        prop_assert_eq!(Jet::decode(&jet.encode()), Ok(jet));
        // Also beside the control, at a distance of which the reciprocal overflows.
        let beside = vec3::add(jet.control_m, [0.0, scale % 1e-38, 0.0]);
        for d in [d, beside, jet.control_m] {
            prop_assert!(vec3::is_finite(jet.force(d).force_n), "{:?}", jet.force(d));
            prop_assert!(jet.energy_j(d).is_finite());
        }
        for odd in [f32::NAN, f32::INFINITY] {
            let [x, y, _] = d;
            let found = jet.force([x, y, odd]);
            prop_assert_eq!((found.force_n, found.coverage), (jet.force_n, Coverage::Extrapolated));
        }
    }
}
