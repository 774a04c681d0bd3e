//! Continuity of the methods at the rim, at faces and at folds; and that `energy` is conservative.

use crate::common::{Random, Recipe, distance, force};
use palpate_core::vec3::{self, Vec3};
use palpate_core::{AlignedBytes, Coverage, Estimate, Method, Organ, flags};

fn read(blob: &AlignedBytes) -> Organ<'_, 2> {
    Organ::read(blob).expect("the blob is good")
}

/// Value and slope are continuous at the rim, and one cell further out the force is constant.
#[test]
fn outside_the_ball_the_force_becomes_constant() {
    let blob = Recipe::default().blob();
    let organ = read(&blob);
    let space = &organ.spaces[0];
    let mut random = Random(4);
    let (radius, cell) = (0.03_f32, 0.01_f32);
    for _ in 0..300 {
        let direction = vec3::normalize_or_zero(random.point(1.0));
        for method in Method::OF_LATTICE {
            let force = |r: f32| space.force(method, vec3::scale(direction, r)).expect("packed");
            let [inside, outside] = [0.999_99, 1.000_01].map(|share| force(radius * share));
            assert_eq!(outside.coverage, Coverage::Extrapolated);
            // 0.6 um at 2 kN/m, and the f32 rounding of 8 N.
            assert!(distance(inside.force_n, outside.force_n) < 2e-3, "{method:?} {direction:?}");
            let step = 2e-5;
            let [low, high] = [-step, step].map(|d| {
                let [near, far] = [force(radius + 0.05 * d).force_n, force(radius + d).force_n];
                vec3::scale(vec3::sub(far, near), 1.0 / (0.95 * d))
            });
            // The tolerance covers the curvature over 20 um (large near wrong extrapolation) and the decrease
            // of the slope over the first 20 um of the continuation. A constant force would change the slope
            // by 300 N/m and more. The tri-linear slope jumps at every face, and outside the ball the slope
            // is the tri-cubic one.
            let jumps = matches!(method, Method::Trilinear | Method::Hybrid);
            assert!(jumps || distance(low, high) < 12.0, "{method:?} {direction:?}: {low:?} {high:?}");
            let last = force(radius + 1.001 * cell).force_n;
            for far in [0.05, 1.0, 1e20, 3e38] {
                assert!(distance(force(far).force_n, last) < 2e-4, "{method:?} {direction:?} at {far}");
            }
        }
    }
}

/// Axis, positions on both sides of a face, edge or corner of the grid, and their distance.
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
            // The nearest f32 below and above, or a gap where these would be denormal.
            let (mut low, mut high) = (on_face, on_face);
            let step = gap.max(on_face[axis].abs() * 3e-7);
            low[axis] -= step;
            high[axis] += step;
            found.push((axis, low, high, high[axis] - low[axis]));
        }
    }
    found
}

/// Outside the ball the cell of the rim changes along the rim: no method jumps there, with holes, wrong
/// extrapolation and folds.
#[test]
fn no_method_jumps_outside_the_ball() {
    let recipe = Recipe {
        spacing_m: 0.01,
        radius_m: 0.05,
        solved: |ijk| ijk != [4, 2, 1] && ijk != [-3, -3, 2],
        fold: |ijk| ijk[0] == 3 || ijk == [-4, 1, 1],
        ..Recipe::default()
    };
    let blob = recipe.blob();
    let space = &read(&blob).spaces[0];
    let (mut random, mut folded) = (Random(9), 0);
    for n in 0..20_000 {
        // The ray through a point of the rim on a face of the grid.
        let mut on_rim = vec3::scale(vec3::normalize_or_zero(random.point(1.0)), 0.05);
        let axis = n % 3;
        on_rim[axis] = (on_rim[axis] / 0.01).round() * 0.01;
        let (a, b) = (on_rim[(axis + 1) % 3], on_rim[(axis + 2) % 3]);
        let stretch = ((0.0025 - on_rim[axis] * on_rim[axis]).max(0.0) / (a * a + b * b).max(1e-12)).sqrt();
        on_rim[(axis + 1) % 3] *= stretch;
        on_rim[(axis + 2) % 3] *= stretch;
        let out = [1.0004_f32, 1.1, 1.4, 10.0][n % 4];
        let [low, high] = [-2e-8, 2e-8].map(|step| {
            let mut at = on_rim;
            at[axis] += step;
            vec3::scale(at, out)
        });
        let cells = [low, high].map(|d| space.lattice().locate(d).slot);
        folded += usize::from(cells.iter().any(|&slot| space.planes().flags[slot] & flags::BRANCH_JUMP != 0));
        for method in Method::OF_LATTICE {
            let [a, b] = [low, high].map(|d| space.force(method, d).expect("packed"));
            // 40 nm at 10 kN/m near wrong extrapolation, and the f32 rounding of the point and of 8 N.
            let jump = distance(a.force_n, b.force_n);
            assert!(jump < 1e-3, "{method:?} at {low:?}: {jump} N");
        }
    }
    assert!(folded > 300, "{folded} crossings at a fold");
}

/// No method jumps at a face, with holes in the table and extrapolation that is wrong by a quarter.
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
            // The force changes by the slope over the gap (5 kN/m near wrong extrapolation) and by rounding.
            let jump = distance(a.force_n, b.force_n) - 5000.0 * width;
            assert!(jump < 1e-5 * scale, "{method:?} at {low:?}: {jump} of {scale}");
            hybrid_changes += usize::from(method == Method::Hybrid && a.coverage != b.coverage);
        }
    }
    assert!(hybrid_changes > 1000, "the border of the tri-cubic region was crossed {hybrid_changes} times");
}

/// The slope of the tri-cubic force is continuous at faces, that of the tri-linear is not.
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
    // One-sided differences include the curvature (h'' up to 1e4 N/m^2 times 20 um) and the f32 rounding
    // (1e-6 N / 2e-5 m = 0.05 N/m).
    assert!(worst_cubic < 3.0, "tri-cubic slope jumps by {worst_cubic} N/m");
    assert!(worst_linear > 20.0, "the test must detect a kink: tri-linear {worst_linear} N/m");
}

/// Both Hermite forces are C1 at faces, also near wrong extrapolation, and their blend at a fold is
/// continuous.
#[test]
fn hermite_and_energy_are_smooth_at_faces_and_continuous_at_folds() {
    let blob = Recipe {
        radius_m: 0.05,
        rbf: false,
        solved: |ijk| ijk != [2, 1, 0] && ijk != [-1, -3, 1],
        fold: |[i, j, k]| i == 1 && j == 0 && k.abs() < 2,
        ..Recipe::default()
    }
    .blob();
    let organ = read(&blob);
    let space = &organ.spaces[0];
    let (mut worst, mut crossed) = ([0.0_f32; 2], 0);
    for (axis, low, high, width) in crossings(0.01, 0.045, 30_000) {
        for (method, worst) in [Method::Hermite, Method::Energy].into_iter().zip(&mut worst) {
            let [a, b] = [low, high].map(|d| space.force(method, d).expect("packed").force_n);
            assert!(distance(a, b) < 5000.0 * width + 2e-5, "{method:?} jumps at {low:?}: {a:?} {b:?}");
            // The blend has kinks; neither method alone has one.
            let [a, b] = [low, high].map(|d| space.estimate(method, d).expect("packed"));
            if method == Method::Hermite || (a.energy_j.is_some() && b.energy_j.is_some()) {
                let column = |e: Estimate| [0, 1, 2].map(|i| e.stiffness_n_m[i][axis]);
                *worst = worst.max(distance(column(a), column(b)));
            }
        }
        let folded = |d: Vec3| {
            let at = space.lattice().locate(d);
            space.planes().flags[at.slot] & flags::BRANCH_JUMP != 0
        };
        crossed += usize::from(folded(low) != folded(high));
    }
    assert!(crossed > 50, "{crossed} crossings of the faces of a cell with a fold");
    // The rounding of slopes of 1e3 N/m, and h'' up to 3e6 N/m^2 near wrong extrapolation over a gap of 1e-7
    // m.
    assert!(worst[0] < 2.0 && worst[1] < 2.0, "slopes jump by {worst:?} N/m");
}

/// The force of `energy` does no work on a closed path, also near wrong extrapolation; that of the tri-cubic
/// does.
#[test]
fn the_energy_does_no_work_round_a_closed_path() {
    let recipe = Recipe {
        radius_m: 0.05,
        rbf: false,
        solved: |ijk| ijk != [2, 1, 0] && ijk != [-1, -3, 1],
        ..Recipe::default()
    };
    let blob = recipe.blob();
    let space = &read(&blob).spaces[0];
    let work = |method| -> (f64, f64) {
        let (mut net, mut exchanged) = (0.0, 0.0);
        const STEPS: usize = 4000;
        let place = |n: usize| -> [f64; 3] {
            let angle = std::f64::consts::TAU * n as f64 / STEPS as f64;
            let (s, c) = angle.sin_cos();
            [0.017 + 0.012 * c, 0.008 + 0.012 * s, 0.004 + 0.006 * s * c]
        };
        for n in 0..STEPS {
            let (a, b) = (place(n), place(n + 1));
            let middle: [f32; 3] = std::array::from_fn(|i| (0.5 * (a[i] + b[i])) as f32);
            let h = space.force(method, middle).expect("packed").force_n;
            let step: f64 = (0..3).map(|i| f64::from(h[i]) * (b[i] - a[i])).sum();
            net += step;
            exchanged += step.abs();
        }
        (net.abs(), exchanged)
    };
    let [(energy, of), (tricubic, _), (hermite, _)] =
        [Method::Energy, Method::Tricubic, Method::Hermite].map(work);
    assert!(energy < 1e-5 * of, "{energy} J of {of} J");
    assert!(
        tricubic > 5e-5 * of && hermite > 1e-4 * of,
        "the path must show a difference: {tricubic} {hermite} of {of} J"
    );
}
