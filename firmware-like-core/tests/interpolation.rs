//! What each method reproduces, its derivatives, and that every answer is finite. Continuity is in
//! `continuity.rs`.

use crate::common::{Random, Recipe, distance, force};
use palpate_core::vec3::{self, Vec3};
use palpate_core::{AlignedBytes, Coverage, Method, Organ};

fn read(blob: &AlignedBytes) -> Organ<'_, 2> {
    Organ::read(blob).expect("the blob is good")
}

/// Nodes, faces, edges, the rim, and numbers that are not finite or extreme.
fn odd_queries(spacing_m: f32, radius_m: f32) -> Vec<Vec3> {
    let values = [
        0.0,
        -0.0,
        spacing_m,
        -spacing_m,
        2.0 * spacing_m,
        0.5 * spacing_m,
        radius_m,
        -radius_m,
        radius_m * 1.000_001,
        f32::MIN_POSITIVE,
        1e-42,
        -1e-45,
        1e10,
        1e30,
        -1e30,
        f32::MAX,
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
    ];
    let mut queries = Vec::new();
    for x in values {
        for y in values {
            queries.extend(values.map(|z| [x, y, z]));
        }
    }
    queries
}

#[test]
fn every_answer_is_finite() {
    let recipe = Recipe::default();
    let blob = recipe.blob();
    let space = &read(&blob).spaces[0];
    let mut random = Random(3);
    let mut queries = odd_queries(0.01, 0.03);
    queries.extend((0..2000).map(|_| random.point(0.05)));
    for d in queries {
        for method in Method::OF_LATTICE {
            let answer = space.force(method, d).expect("every method is in the blob");
            assert!(vec3::is_finite(answer.force_n), "{method:?} at {d:?}: {answer:?}");
            if !vec3::is_finite(d) {
                assert_eq!(answer.coverage, Coverage::Extrapolated);
                assert!(vec3::norm(answer.force_n) < 1e-4, "no force at rest: {answer:?}");
            }
        }
    }
}

/// The stiffness is the derivative of the force, and the force the gradient of the energy.
#[test]
fn stiffness_and_energy_agree_with_differences_of_the_force() {
    let blob = Recipe {
        radius_m: 0.04,
        solved: |ijk| ijk != [2, 1, 0],
        fold: |[i, j, k]| i == -2 && j == 0 && k == 0,
        ..Recipe::default()
    }
    .blob();
    let organ = read(&blob);
    let space = &organ.spaces[0];
    let mut random = Random(14);
    let (mut compared, mut with_energy) = (0, 0);
    for _ in 0..3000 {
        let d = random.point(0.045);
        let h = 1e-4_f32;
        for method in Method::OF_LATTICE {
            let here = space.estimate(method, d).expect("packed");
            assert_eq!(Some(here.force_n), space.force(method, d).map(|sample| sample.force_n));
            let cell = space.lattice().locate(d);
            // The ends of a difference must lie in one cell and inside the ball.
            if !cell.inside || vec3::norm(d) > 0.0395 || cell.t.iter().any(|t| !(0.02..0.98).contains(t)) {
                continue;
            }
            compared += 1;
            for axis in 0..3 {
                let [low, high] = [-h, h].map(|step| {
                    let mut at = d;
                    at[axis] += step;
                    space.estimate(method, at).expect("packed")
                });
                let column = [0, 1, 2].map(|i| here.stiffness_n_m[i][axis]);
                let slope = vec3::scale(vec3::sub(high.force_n, low.force_n), 0.5 / h);
                // Third derivatives of the interpolants times h^2 / 6, and the rounding of forces over h.
                let tolerance =
                    2e-3 * vec3::norm(column) + if method == Method::RbfLinear { 8.0 } else { 1.5 };
                assert!(distance(column, slope) < tolerance, "{method:?} {d:?}: {column:?} {slope:?}");
                if let (Some(low), Some(_), Some(high)) = (low.energy_j, here.energy_j, high.energy_j) {
                    with_energy += 1;
                    let slope = (high - low) * 0.5 / h;
                    assert!((slope - here.force_n[axis]).abs() < 0.01, "{slope} {:?}", here.force_n);
                }
            }
            if method == Method::Energy && here.energy_j.is_some() {
                let s = here.stiffness_n_m;
                assert!(
                    (s[0][1] - s[1][0]).abs() + (s[0][2] - s[2][0]).abs() + (s[1][2] - s[2][1]).abs() < 1e-3
                );
            }
        }
    }
    assert!(compared > 5000 && with_energy > 1000, "{compared} {with_energy}");
}

/// The stiffness includes the derivative of the blending weight, which dominates where two different methods
/// are blended, and the rotation of the ray outside the ball.
#[test]
fn the_stiffness_includes_the_weight_and_the_ray() {
    // Waves of three cells, for which tri-linear and tri-cubic differ by newtons.
    fn rough(d: Vec3) -> [f64; 3] {
        let wave = |x: f32, y: f32| 3.0 * f64::from(200.0 * x).sin() * f64::from(170.0 * y).cos();
        let [x, y, z] = d;
        let [a, b, c] = force(d);
        [a + wave(x, y), b + wave(y, z), c + wave(z, x)]
    }
    let blob = Recipe {
        radius_m: 0.05,
        force: rough,
        ghost: rough,
        rbf: false,
        hermite: false,
        ..Recipe::default()
    }
    .blob();
    let organ = read(&blob);
    let space = &organ.spaces[0];
    let (mut random, mut apart, mut beyond) = (Random(15), 0, 0);
    for _ in 0..12_000 {
        let d = random.point(0.07);
        let at = space.lattice().locate(d);
        let h = 2e-5_f32;
        let out = vec3::norm(d);
        if at.t.iter().any(|t| !(0.02..0.98).contains(t))
            || (out - 0.05).abs() < 1e-3
            || (out - 0.06).abs() < 1e-3
        {
            continue;
        }
        for method in [Method::Hybrid, Method::Tricubic] {
            let stiffness = space.estimate(method, d).expect("packed").stiffness_n_m;
            for axis in 0..3 {
                let [low, high] = [-h, h].map(|step| {
                    let mut at = d;
                    at[axis] += step;
                    space.force(method, at).expect("packed").force_n
                });
                let column = [0, 1, 2].map(|i| stiffness[i][axis]);
                let slope = vec3::scale(vec3::sub(high, low), 0.5 / h);
                let tolerance = 2e-3 * vec3::norm(slope) + if at.inside { 3.0 } else { 6.0 };
                assert!(distance(column, slope) < tolerance, "{method:?} {d:?}: {column:?} {slope:?}");
            }
        }
        let [hybrid, linear] =
            [Method::Hybrid, Method::Trilinear].map(|m| space.force(m, d).expect("packed").force_n);
        apart += usize::from(at.inside && distance(hybrid, linear) > 0.2);
        beyond += usize::from(!at.inside);
    }
    assert!(apart > 100 && beyond > 500, "{apart} {beyond}");
}

#[test]
fn every_method_is_exact_on_the_nodes() {
    let recipe = Recipe { radius_m: 0.02, ..Recipe::default() };
    let blob = recipe.blob();
    let space = &read(&blob).spaces[0];
    for ijk in recipe.solved_points() {
        let d = recipe.lattice().displacement_m(ijk);
        let h = force(d).map(|h| h as f32);
        for method in Method::OF_LATTICE {
            let answer = space.force(method, d).expect("packed");
            // RBF: the rounding of the solver and of f32; forces are about 8 N.
            let tolerance = if method == Method::RbfLinear { 5e-5 } else { 1e-5 };
            assert!(distance(answer.force_n, h) < tolerance, "{method:?} at {ijk:?}: {answer:?} != {h:?}");
        }
    }
}

#[test]
fn trilinear_reproduces_trilinear_functions() {
    fn trilinear(d: Vec3) -> [f64; 3] {
        let [x, y, z] = d.map(|x| f64::from(x) * 100.0);
        [x - 2.0 * y + x * y * z, 3.0 * z + x * y, y * z - x * z]
    }
    let blob = Recipe { force: trilinear, ghost: trilinear, rbf: false, ..Recipe::default() }.blob();
    let space = &read(&blob).spaces[0];
    let mut random = Random(5);
    for _ in 0..5000 {
        let d = random.point(0.017);
        let answer = space.force(Method::Trilinear, d).expect("packed").force_n;
        assert!(distance(answer, trilinear(d).map(|h| h as f32)) < 2e-5, "{d:?}");
    }
}

/// Exact for products of quadratics, one per axis.
#[test]
fn tricubic_reproduces_quadratics_per_axis() {
    fn quadratic(d: Vec3) -> [f64; 3] {
        let [x, y, z] = d.map(|x| f64::from(x) * 100.0);
        [x * x - 0.5 * y * z * z, x * x * y * y * z * z + z, x + y * y + 0.25 * x * x * z]
    }
    let blob = Recipe { force: quadratic, ghost: quadratic, rbf: false, ..Recipe::default() }.blob();
    let space = &read(&blob).spaces[0];
    let mut random = Random(6);
    for _ in 0..5000 {
        let d = random.point(0.017);
        let exact = quadratic(d).map(|h| h as f32);
        let answer = space.force(Method::Tricubic, d).expect("packed").force_n;
        assert!(distance(answer, exact) < 1e-4, "{d:?}: {answer:?} {exact:?}");
    }
}

/// The hybrid is the tri-cubic where its super-cells are complete, and the tri-linear elsewhere.
#[test]
fn hybrid_is_tricubic_inside_and_trilinear_at_the_rim() {
    let blob = Recipe { radius_m: 0.06, rbf: false, ..Recipe::default() }.blob();
    let space = &read(&blob).spaces[0];
    let mut random = Random(9);
    let mut seen = [0; 3];
    for _ in 0..5000 {
        let d = random.point(0.045);
        let [linear, cubic, hybrid] = [Method::Trilinear, Method::Tricubic, Method::Hybrid]
            .map(|method| space.force(method, d).expect("packed"));
        match hybrid.coverage {
            Coverage::SuperCell => {
                assert_eq!(cubic.coverage, Coverage::SuperCell);
                let [along, apart] = [linear, hybrid].map(|other| distance(other.force_n, cubic.force_n));
                assert!(apart <= along + 1e-6, "the blend lies between both methods");
                seen[0] += 1;
            }
            Coverage::Cell => {
                assert_eq!((hybrid.force_n, linear.coverage), (linear.force_n, Coverage::Cell));
                assert_eq!(cubic.coverage, Coverage::Extrapolated);
                seen[1] += 1;
            }
            _ => {
                assert_eq!((hybrid, linear.coverage), (linear, Coverage::Extrapolated));
                seen[2] += 1;
            }
        }
        if d.iter().all(|x| x.abs() < 0.0099) {
            assert_eq!(hybrid, cubic, "only tri-cubic in the middle");
        }
    }
    assert!(seen.iter().all(|&seen| seen > 100), "all regions were visited: {seen:?}");
}

/// With 5 cells along the radius, cells cover 58 % of the ball and super-cells 15 %.
#[test]
fn coverage_shares_of_the_514_grid() {
    let blob = Recipe { radius_m: 0.05, rbf: false, displacement: false, ..Recipe::default() }.blob();
    let space = &read(&blob).spaces[0];
    let mut random = Random(10);
    let (mut count, mut cell, mut supercell) = (0, 0, 0);
    while count < 40_000 {
        let d = random.point(0.05);
        if vec3::norm(d) < 0.05 {
            count += 1;
            let covers = |method, what| space.force(method, d).is_some_and(|answer| answer.coverage == what);
            cell += usize::from(covers(Method::Trilinear, Coverage::Cell));
            supercell += usize::from(covers(Method::Tricubic, Coverage::SuperCell));
        }
    }
    let [cell, supercell] = [cell, supercell].map(|hits| hits as f64 / f64::from(count));
    assert!((cell - 0.58).abs() < 0.02 && (supercell - 0.15).abs() < 0.02, "{cell} {supercell}");
}

/// All methods approximate the field between its nodes.
#[test]
fn every_method_approximates_the_field() {
    let blob = Recipe { radius_m: 0.04, ghost: force, ..Recipe::default() }.blob();
    let space = &read(&blob).spaces[0];
    let mut random = Random(11);
    let mut worst = [0.0_f32; 7];
    for _ in 0..2000 {
        let d = random.point(0.017);
        let exact = force(d).map(|h| h as f32);
        for (worst, method) in worst.iter_mut().zip(Method::OF_LATTICE) {
            let answer = space.force(method, d).expect("packed").force_n;
            *worst = worst.max(distance(answer, exact));
        }
    }
    let [linear, cubic, hybrid, rbf_linear, rbf_cubic, hermite, energy] = worst;
    assert!(linear < 0.3 && cubic < 0.05 && hybrid < 0.3 && rbf_linear < 0.3 && rbf_cubic < 0.1, "{worst:?}");
    assert!(cubic < 0.5 * linear && rbf_cubic < linear, "{worst:?}");
    // The field is a cubic: both Hermite methods are exact except for rounding.
    assert!(hermite < 1e-5 && energy < 1e-5, "{worst:?}");
}

#[test]
fn radial_sums_repeat_bit_for_bit() {
    let blob = Recipe::default().blob();
    let organ = read(&blob);
    let copy = blob.clone();
    let other = read(&copy);
    let mut random = Random(12);
    for _ in 0..500 {
        let d = random.point(0.03);
        for method in [Method::RbfLinear, Method::RbfCubic] {
            assert_eq!(organ.spaces[0].force(method, d), other.spaces[0].force(method, d));
        }
    }
}

#[test]
fn a_method_that_was_not_packed_is_not_answered() {
    let blob = Recipe { rbf: false, ..Recipe::default() }.blob();
    let space = &read(&blob).spaces[0];
    assert!(space.has(Method::Hybrid) && !space.has(Method::RbfCubic));
    assert_eq!(space.force(Method::RbfLinear, [0.0; 3]), None);
    let blob =
        Recipe { lattice_table: false, hermite: false, displacement: false, ..Recipe::default() }.blob();
    let space = &read(&blob).spaces[0];
    assert!(!space.has(Method::Energy) && space.force(Method::Hermite, [0.0; 3]).is_none());
    assert!(!space.has(Method::Hybrid) && space.has(Method::RbfCubic));
    assert_eq!(space.force(Method::Trilinear, [0.0; 3]), None);
    assert!(!space.displacement_into([0.01, 0.0, 0.0], &mut [[1.0; 3]; 4]));
}

/// The energy alone is that of the estimate; outside it is continued by the work of the force along the ray.
#[test]
fn the_energy_continues_along_the_ray() {
    let blob = Recipe { radius_m: 0.03, ..Recipe::default() }.blob();
    let organ = read(&blob);
    let space = &organ.spaces[0];
    let mut random = Random(15);
    let (mut inside, mut outside) = (0, 0);
    for _ in 0..500 {
        let d = random.point(0.05);
        let Some(energy_j) = space.energy_j(Method::Energy, d) else { continue };
        let here = space.estimate(Method::Energy, d).expect("packed");
        if let Some(estimated_j) = here.energy_j {
            inside += 1;
            assert!(
                (energy_j - estimated_j).abs() <= 1e-6 * estimated_j.abs() + 1e-9,
                "{energy_j} {estimated_j}"
            );
            continue;
        }
        let (along, step_m) = (vec3::normalize_or_zero(d), 2e-4);
        let beside = [-step_m, step_m].map(|s| vec3::add(d, vec3::scale(along, s)));
        let [Some(low_j), Some(high_j)] = beside.map(|d| space.energy_j(Method::Energy, d)) else { continue };
        if space.lattice().locate(beside[0]).inside {
            continue;
        }
        outside += 1;
        let (slope_n, force_n) = ((high_j - low_j) / (2.0 * step_m), vec3::dot(here.force_n, along));
        assert!((slope_n - force_n).abs() < 0.01 * force_n.abs() + 2e-3, "{slope_n} {force_n} at {d:?}");
    }
    assert!(inside > 50 && outside > 50, "{inside} {outside}");
    assert_eq!(space.energy_j(Method::Trilinear, [0.01, 0.0, 0.0]), None);
}
