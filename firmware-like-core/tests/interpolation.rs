//! What each method reproduces, where it is continuous, and that it is finite everywhere.

mod common;

use common::{Aligned, Random, Recipe, SHARES, distance, force};
use palpate_core::vec3::{self, Vec3};
use palpate_core::{Coverage, Method, Organ};

fn read(blob: &Aligned) -> Organ<'_, 2> {
    Organ::read(blob.bytes()).expect("the blob is good")
}

/// Displacements that deserve a test of their own: nodes, faces, edges, the rim, and numbers without sense.
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
        for method in Method::ALL {
            let answer = space.force(method, d).expect("every method is in the blob");
            assert!(vec3::is_finite(answer.force_n), "{method:?} at {d:?}: {answer:?}");
            if !vec3::is_finite(d) {
                assert_eq!(answer.coverage, Coverage::Extrapolated);
                assert!(vec3::norm(answer.force_n) < 1e-4, "no force without a position: {answer:?}");
            }
        }
    }
}

#[test]
fn beyond_the_rim_the_force_goes_on_constant() {
    let blob = Recipe::default().blob();
    let space = &read(&blob).spaces[0];
    let mut random = Random(4);
    for _ in 0..500 {
        let direction = vec3::normalize_or_zero(random.point(1.0));
        for method in Method::ALL {
            let rim = space.force(method, vec3::scale(direction, 0.03 * 0.999_999)).expect("packed");
            for far in [0.030_001, 0.05, 1.0, 1e20, 3e38] {
                let beyond = space.force(method, vec3::scale(direction, far)).expect("packed");
                assert_eq!(beyond.coverage, Coverage::Extrapolated);
                // 1e-6 of the radius times the slope, plus f32 rounding of a force of 8 N.
                assert!(distance(beyond.force_n, rim.force_n) < 2e-4, "{method:?} {direction:?} at {far}");
            }
        }
    }
}

#[test]
fn every_method_is_exact_on_the_nodes() {
    let recipe = Recipe { radius_m: 0.02, ..Recipe::default() };
    let blob = recipe.blob();
    let space = &read(&blob).spaces[0];
    for ijk in recipe.solved_points() {
        let d = recipe.lattice().displacement_m(ijk);
        let h = force(d).map(|h| h as f32);
        for method in Method::ALL {
            let answer = space.force(method, d).expect("packed");
            // RBF: the solver's and f32's rounding; the scale is 8 N.
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

/// Exact on products of quadratics, one per axis: what three independent Catmull-Rom passes reproduce.
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

/// Force just left and just right of a face, edge or corner of the grid.
fn crossings(spacing_m: f32, radius_m: f32, count: usize) -> Vec<(usize, Vec3, Vec3, f32)> {
    let mut random = Random(8);
    let gap = 2e-7 * spacing_m;
    let mut found = Vec::new();
    while found.len() < count {
        let mut on_face = random.point(radius_m);
        let axis = found.len() % 3;
        on_face[axis] = (on_face[axis] / spacing_m).round() * spacing_m;
        if found.len() % 5 == 0 {
            // Also along an edge.
            let other = (axis + 1) % 3;
            on_face[other] = (on_face[other] / spacing_m).round() * spacing_m;
        }
        if vec3::norm(on_face) < 0.999 * radius_m {
            // The nearest f32 below and above, or a gap where those would be denormal.
            let (mut low, mut high) = (on_face, on_face);
            let step = gap.max(on_face[axis].abs() * 3e-7);
            low[axis] -= step;
            high[axis] += step;
            found.push((axis, low, high, high[axis] - low[axis]));
        }
    }
    found
}

/// With holes in the table and ghosts that are wrong by a quarter, no method may jump at any face.
#[test]
fn no_method_jumps_at_a_face() {
    let recipe = Recipe {
        spacing_m: 0.01,
        radius_m: 0.05,
        solved: |ijk| ijk != [2, 1, 0] && ijk != [-1, -3, 1],
        rbf: false,
        ..Recipe::default()
    };
    let blob = recipe.blob();
    let space = &read(&blob).spaces[0];
    let scale = vec3::norm(force([0.0, 0.0, -0.05]).map(|h| h as f32));
    let mut hybrid_changes = 0;
    for (_, low, high, width) in crossings(0.01, 0.05, 60_000) {
        for method in [Method::Trilinear, Method::Tricubic, Method::Hybrid] {
            let [a, b] = [low, high].map(|d| space.force(method, d).expect("packed"));
            // The force moves by the slope over the gap (below 2 kN/m, 5 with bad ghosts) and rounds: the rest is a jump.
            let jump = distance(a.force_n, b.force_n) - 5000.0 * width;
            assert!(jump < 1e-5 * scale, "{method:?} at {low:?}: {jump} of {scale}");
            hybrid_changes += usize::from(method == Method::Hybrid && a.coverage != b.coverage);
        }
    }
    assert!(hybrid_changes > 1000, "the border of the tri-cubic region was crossed {hybrid_changes} times");
}

/// The slope of the tri-cubic force is the same on both sides of a face; that of the tri-linear is not.
#[test]
fn tricubic_is_c1_across_faces() {
    let blob = Recipe { radius_m: 0.05, rbf: false, ghost: force, ..Recipe::default() }.blob();
    let space = &read(&blob).spaces[0];
    let (mut worst_cubic, mut worst_linear) = (0.0_f32, 0.0_f32);
    for (axis, low, high, _) in crossings(0.01, 0.03, 3000) {
        let h = 2e-5_f32;
        let slope = |method, from: Vec3, step: f32| {
            let mut to = from;
            to[axis] += step;
            let width = to[axis] - from[axis];
            let [a, b] = [from, to].map(|d| space.force(method, d).expect("packed").force_n);
            vec3::scale(vec3::sub(b, a), 1.0 / width)
        };
        for (method, worst) in [(Method::Tricubic, &mut worst_cubic), (Method::Trilinear, &mut worst_linear)]
        {
            *worst = worst.max(distance(slope(method, low, -h), slope(method, high, h)));
        }
    }
    // One-sided differences over 20 um see curvature (h'' up to 1e4 N/m^2 times 20 um) and f32 rounding over 20 um
    // (1e-6 N / 2e-5 m = 0.05 N/m).
    assert!(worst_cubic < 3.0, "tri-cubic slope jumps by {worst_cubic} N/m");
    assert!(worst_linear > 20.0, "the test can see a kink: tri-linear {worst_linear} N/m");
}

/// Where it can, the hybrid is the tri-cubic; where it cannot, the tri-linear.
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
                assert!(apart <= along + 1e-6, "between the two");
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
            assert_eq!(hybrid, cubic, "the middle is all tri-cubic");
        }
    }
    assert!(seen.iter().all(|&seen| seen > 100), "all regions were visited: {seen:?}");
}

/// At 5 cells the whole ball is covered 58 % by cells and 15 % by super-cells (INTERPOLATION.md section 5).
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

/// More data, less error: a check that all methods approximate the same field, not only its nodes.
#[test]
fn every_method_approximates_the_field() {
    let blob = Recipe { radius_m: 0.04, ghost: force, ..Recipe::default() }.blob();
    let space = &read(&blob).spaces[0];
    let mut random = Random(11);
    let mut worst = [0.0_f32; 5];
    for _ in 0..2000 {
        let d = random.point(0.017);
        let exact = force(d).map(|h| h as f32);
        for (worst, method) in worst.iter_mut().zip(Method::ALL) {
            let answer = space.force(method, d).expect("packed").force_n;
            *worst = worst.max(distance(answer, exact));
        }
    }
    let [linear, cubic, hybrid, rbf_linear, rbf_cubic] = worst;
    assert!(linear < 0.3 && cubic < 0.05 && hybrid < 0.3 && rbf_linear < 0.3 && rbf_cubic < 0.1, "{worst:?}");
    assert!(cubic < 0.5 * linear && rbf_cubic < linear, "{worst:?}");
}

#[test]
fn radial_sums_repeat_bit_for_bit() {
    let blob = Recipe::default().blob();
    let organ = read(&blob);
    let copy = Aligned::new(blob.bytes());
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
    let blob = Recipe { lattice_table: false, displacement: false, ..Recipe::default() }.blob();
    let space = &read(&blob).spaces[0];
    assert!(!space.has(Method::Hybrid) && space.has(Method::RbfCubic));
    assert_eq!(space.force(Method::Trilinear, [0.0; 3]), None);
    assert!(!space.displacement_into([0.01, 0.0, 0.0], &mut [[1.0; 3]; 4]));
}

/// The surface follows the node in proportion; a tri-linear table of a linear field is exact.
#[test]
fn displacement_of_the_surface() {
    let blob = Recipe { radius_m: 0.04, ..Recipe::default() }.blob();
    let space = &read(&blob).spaces[0];
    let mut random = Random(13);
    for _ in 0..500 {
        let d = random.point(0.015);
        let mut out = [[9.0; 3]; 5];
        assert!(space.displacement_into(d, &mut out));
        for (moved, share) in out.iter().zip(SHARES) {
            assert!(distance(*moved, vec3::scale(d, share)) < 1e-7, "{d:?} {moved:?}");
        }
        assert_eq!(out[4], [0.0; 3], "beyond the last vertex nothing moves");
    }
    for d in odd_queries(0.01, 0.04) {
        let mut out = [[9.0; 3]; 2];
        space.displacement_into(d, &mut out);
        assert!(out.iter().all(|moved| vec3::is_finite(*moved) && vec3::norm(*moved) < 0.07), "{d:?}");
    }
}
