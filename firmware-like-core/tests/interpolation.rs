//! What each method reproduces, where it is continuous, and that it is finite everywhere.

mod common;

use common::{Aligned, Random, Recipe, distance, force};
use palpate_core::vec3::{self, Vec3};
use palpate_core::{Coverage, Estimate, Method, Organ, flags};

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
        for method in Method::OF_LATTICE {
            let answer = space.force(method, d).expect("every method is in the blob");
            assert!(vec3::is_finite(answer.force_n), "{method:?} at {d:?}: {answer:?}");
            if !vec3::is_finite(d) {
                assert_eq!(answer.coverage, Coverage::Extrapolated);
                assert!(vec3::norm(answer.force_n) < 1e-4, "no force without a position: {answer:?}");
            }
        }
    }
}

/// Value and slope go on across the rim; a cell later the force is constant, however far.
#[test]
fn beyond_the_rim_the_force_bends_into_a_constant() {
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
            // 0.6 um of a slope of 2 kN/m at most, plus f32 rounding of a force of 8 N.
            assert!(distance(inside.force_n, outside.force_n) < 2e-3, "{method:?} {direction:?}");
            let step = 2e-5;
            let [low, high] = [-step, step].map(|d| {
                let [near, far] = [force(radius + 0.05 * d).force_n, force(radius + d).force_n];
                vec3::scale(vec3::sub(far, near), 1.0 / (0.95 * d))
            });
            // The slope turns by its own curvature over 20 um (much, near ghosts that are wrong by a quarter of W), and by 20 um
            // in a cell of the way to zero. Were it constant at once, the slope would fall by 300 N/m and more. The slope of the
            // tri-linear force jumps at every face; beyond the rim it is that of the tri-cubic.
            let jumps = matches!(method, Method::Trilinear | Method::Hybrid);
            assert!(jumps || distance(low, high) < 12.0, "{method:?} {direction:?}: {low:?} {high:?}");
            let last = force(radius + 1.001 * cell).force_n;
            for far in [0.05, 1.0, 1e20, 3e38] {
                assert!(distance(force(far).force_n, last) < 2e-4, "{method:?} {direction:?} at {far}");
            }
        }
    }
}

/// The stiffness is the derivative of the force that is given, and the energy of the force that is its gradient.
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
            let cell = space.lattice.locate(d);
            // Differences want one cell, and no rim, between their two ends; the continuation's stiffness is not exact.
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
                // Third derivatives of the interpolants times h^2 / 6, and rounding of forces over h.
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

/// Where two methods far apart are blended, the turn of their shares is most of the stiffness; beyond the rim so is the turn of the ray.
#[test]
fn the_stiffness_holds_the_turn_of_the_shares_and_of_the_ray() {
    // Waves of three cells, on which tri-linear and tri-cubic differ by newtons.
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
        let at = space.lattice.locate(d);
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

/// Beyond the rim the cell of the rim's point changes too: with holes, bad ghosts and folds there, nothing may jump, however far out.
#[test]
fn no_method_jumps_beyond_the_rim() {
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
        // A point of the rim on a face of the grid, and the ray through it.
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
        let cells = [low, high].map(|d| space.lattice.locate(d).slot);
        folded += usize::from(cells.iter().any(|&slot| space.flags[slot] & flags::FOLD != 0));
        for method in Method::OF_LATTICE {
            let [a, b] = [low, high].map(|d| space.force(method, d).expect("packed"));
            // 40 nm of a slope of 10 kN/m beside bad ghosts, and f32 rounding of the rim's point and of 8 N.
            let jump = distance(a.force_n, b.force_n);
            assert!(jump < 1e-3, "{method:?} at {low:?}: {jump} N");
        }
    }
    assert!(folded > 300, "{folded} crossings beside a fold");
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

/// Both Hermite forces are C1 at faces, whatever the ghosts; the seam between them at a fold is continuous.
#[test]
fn hermite_and_energy_join_smoothly_across_faces_and_folds() {
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
            // The blend has kinks; either method alone has none.
            let [a, b] = [low, high].map(|d| space.estimate(method, d).expect("packed"));
            if method == Method::Hermite || (a.energy_j.is_some() && b.energy_j.is_some()) {
                let column = |e: Estimate| [0, 1, 2].map(|i| e.stiffness_n_m[i][axis]);
                *worst = worst.max(distance(column(a), column(b)));
            }
        }
        let folded = |d: Vec3| {
            let at = space.lattice.locate(d);
            space.flags[at.slot] & flags::FOLD != 0
        };
        crossed += usize::from(folded(low) != folded(high));
    }
    assert!(crossed > 50, "{crossed} crossings of a folded cell's faces");
    // Rounding of slopes of 1e3 N/m, and h'' up to 3e6 N/m^2 near the wrong ghosts over the gap of 1e-7 m.
    assert!(worst[0] < 2.0 && worst[1] < 2.0, "slopes jump by {worst:?} N/m");
}

/// The energy's force does no work on a closed path, whatever the ghosts; the tri-cubic's does.
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
        "the path meets the ghosts: {tricubic} {hermite} of {of} J"
    );
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
    // The field is a cubic: both Hermite methods are exact but for rounding.
    assert!(hermite < 1e-5 && energy < 1e-5, "{worst:?}");
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
    let blob =
        Recipe { lattice_table: false, hermite: false, displacement: false, ..Recipe::default() }.blob();
    let space = &read(&blob).spaces[0];
    assert!(!space.has(Method::Energy) && space.force(Method::Hermite, [0.0; 3]).is_none());
    assert!(!space.has(Method::Hybrid) && space.has(Method::RbfCubic));
    assert_eq!(space.force(Method::Trilinear, [0.0; 3]), None);
    assert!(!space.displacement_into([0.01, 0.0, 0.0], &mut [[1.0; 3]; 4]));
}
