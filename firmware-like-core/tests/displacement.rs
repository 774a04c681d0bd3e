//! Surface displacements at the configurations and between them.

use crate::common::{ODD, Random, Recipe, SHARES, bent, distance};
use palpate_core::flags::{BRANCH_JUMP, CELL, SMOOTH};
use palpate_core::{AlignedBytes, Organ, Space, Vec3, vec3};

fn read(blob: &AlignedBytes) -> Organ<'_, 1> {
    Organ::read(blob).expect("the blob is good")
}

fn recipe(slopes: usize) -> Recipe {
    Recipe { radius_m: 0.04, lattice_table: false, rbf: false, hermite: false, slopes, ..Recipe::default() }
}

/// Numbers of modes with slopes, out of three modes.
const SLOPES: [usize; 3] = [0, 2, 3];

fn moved(space: &Space<'_>, d: Vec3) -> [Vec3; 4] {
    let mut out = [[9.0; 3]; 4];
    assert!(space.displacement_into(d, &mut out));
    out
}

fn apart(a: &[Vec3], b: &[Vec3]) -> f32 {
    a.iter().zip(b).map(|(a, b)| distance(*a, *b)).fold(0.0, f32::max)
}

/// Unit of a coefficient.
const QUANTUM_M: f32 = 1e-5;

/// The surface moves in proportion to the node: the table of a linear field is exact.
#[test]
fn a_linear_field_is_exact_and_every_query_finite() {
    for slopes in SLOPES {
        let blob = recipe(slopes).blob();
        let space = &read(&blob).spaces[0];
        let mut random = Random(13);
        for _ in 0..500 {
            let d = random.point(0.015);
            let mut out = [[9.0; 3]; 5];
            assert!(space.displacement_into(d, &mut out));
            for (moved, share) in out.iter().zip(SHARES) {
                assert!(distance(*moved, vec3::scale(d, share)) < 1e-7, "{d:?} {moved:?}");
            }
            assert_eq!(out[4], [0.0; 3], "beyond the last vertex");
        }
        let mut short = [[9.0; 3]; 2];
        for d in [0.0, 0.04, -0.04, 0.5, 1e-40, 1e30, f32::INFINITY, f32::NAN, f32::MIN] {
            for d in [[d, 0.0, 0.0], [0.01, d, 0.0], [d, d, d]] {
                assert!(space.displacement_into(d, &mut short));
                let sane = |moved: &Vec3| vec3::is_finite(*moved) && vec3::norm(*moved) < 0.07;
                assert!(short.iter().all(sane), "{d:?} {short:?}");
            }
        }
        assert_eq!(moved(space, [f32::NAN; 3]), [[0.0; 3]; 4], "a query that is not finite is at rest");
        // Outside the ball the displacement is that at the rim.
        let outward = vec3::normalize_or_zero([0.3, -0.5, 0.8]);
        let [rim, beyond] = [0.04, 0.3].map(|r| moved(space, vec3::scale(outward, r)));
        assert!(apart(&rim, &beyond) < 1e-7);
    }
}

#[test]
fn configurations_are_reproduced() {
    for slopes in SLOPES {
        let blob = Recipe { bent: true, ..recipe(slopes) }.blob();
        let space = &read(&blob).spaces[0];
        let table = space.displacement().expect("packed");
        for ijk in space.lattice().points() {
            let d = space.lattice().displacement_m(ijk);
            let expected = SHARES.map(|share| vec3::scale(bent(d), share));
            let mut of_slot = [[9.0; 3]; 4];
            table.configuration_into(space.lattice().slot(ijk).expect("in the box"), &mut of_slot);
            assert!(apart(&of_slot, &expected) < QUANTUM_M, "{ijk:?} {of_slot:?}");
            assert!(apart(&moved(space, d), &of_slot) < 1e-6, "{ijk:?}");
        }
        assert_eq!(moved(space, [0.0; 3]), [[0.0; 3]; 4], "no displacement at rest");
    }
}

/// The slopes reproduce a cubic field; the values alone do not.
#[test]
fn slopes_reproduce_a_cubic() {
    let errors = SLOPES.map(|slopes| {
        let blob = Recipe { bent: true, radius_m: 0.05, ..recipe(slopes) }.blob();
        let space = &read(&blob).spaces[0];
        let mut random = Random(14);
        let mut worst = 0.0_f32;
        for _ in 0..2000 {
            let d = random.point(0.022);
            let expected = SHARES.map(|share| vec3::scale(bent(d), share));
            worst = worst.max(apart(&moved(space, d), &expected));
        }
        worst
    });
    let [linear, some, all] = errors;
    // Values and slopes are rounded by half a unit each. With two of three modes the mode along z has no
    // slopes.
    assert!(all < 1.5 * QUANTUM_M && linear > 20.0 * all, "{errors:?}");
    assert!(linear >= some && some > 10.0 * all, "{errors:?}");
}

/// On both sides of faces, edges and the rim, with unsolved points, an outlier and a fold.
#[test]
fn the_displacement_is_continuous() {
    for slopes in SLOPES {
        let blob = Recipe {
            bent: true,
            outlier: Some([1, 0, -1]),
            solved: |ijk| ijk != [1, 1, 0],
            fold: |ijk| ijk == [-2, 0, 0],
            ..recipe(slopes)
        }
        .blob();
        let space = &read(&blob).spaces[0];
        let mut random = Random(15);
        let mut worst = 0.0_f32;
        for n in 0..20_000 {
            let mut d = random.point(0.03);
            let axis = n % 3;
            d[axis] = (d[axis] * 100.0).round() * 0.01;
            if n % 7 == 0 {
                d[(axis + 1) % 3] = (d[(axis + 1) % 3] * 100.0).round() * 0.01;
            }
            let step = random.point(1e-7);
            let sides = [1.0, -1.0].map(|sign| moved(space, vec3::add(d, vec3::scale(step, sign))));
            worst = worst.max(apart(&sides[0], &sides[1]));
        }
        for _ in 0..2000 {
            let outward = vec3::normalize_or_zero(random.point(1.0));
            let sides = [0.039_999_9, 0.040_000_1].map(|r| moved(space, vec3::scale(outward, r)));
            worst = worst.max(apart(&sides[0], &sides[1]));
        }
        // The steepest change is towards the outlier, 15 mm per cell, over twice 1e-7 m.
        assert!(worst < 2e-6, "{slopes} slopes: {worst} m");
    }
}

#[test]
fn the_residual_of_an_outlier_decays_towards_its_neighbours() {
    for slopes in SLOPES {
        let point = [1, 0, -1];
        let [plain, odd] =
            [None, Some(point)].map(|outlier| Recipe { bent: true, outlier, ..recipe(slopes) }.blob());
        let (plain, odd) = (read(&plain), read(&odd));
        let (plain, odd) = (&plain.spaces[0], &odd.spaces[0]);
        assert_eq!(odd.displacement().expect("packed").planes().outlier_row.len(), 1);
        let more = |d: Vec3| {
            let (with, without) = (moved(odd, d), moved(plain, d));
            [0, 1, 2, 3].map(|v| vec3::sub(with[v], without[v]))
        };
        let at = odd.lattice().displacement_m(point);
        assert!(apart(&more(at), &ODD) < 1e-6);
        let beside = vec3::add(at, [0.0025, -0.005, 0.0]);
        let share = 0.75 * 0.5;
        assert!(apart(&more(beside), &ODD.map(|u| vec3::scale(u, share))) < 1e-6);
        assert_eq!(more(vec3::add(at, [0.01, 0.002, 0.0])), [[0.0; 3]; 4]);
    }
}

/// In a cell with a fold the slope at one end does not predict the other.
#[test]
fn slopes_are_not_used_in_a_cell_with_a_fold() {
    let of = |slopes| Recipe { bent: true, fold: |ijk| ijk == [0, 0, 0], ..recipe(slopes) }.blob();
    let (linear, hermite) = (of(0), of(3));
    let (linear, hermite) = (read(&linear), read(&hermite));
    let (linear, hermite) = (&linear.spaces[0], &hermite.spaces[0]);
    let mut random = Random(16);
    let (mut folded, mut smooth) = (0, 0);
    for _ in 0..4000 {
        let d = random.point(0.025);
        let at = linear.lattice().locate(d);
        let difference = apart(&moved(linear, d), &moved(hermite, d));
        let flags = linear.planes().flags[at.slot];
        let without = hermite.displacement().expect("packed").without_slopes();
        let mut same = [[0.0; 3]; 4];
        without.displacement_into(hermite.lattice(), hermite.planes().flags, d, &mut same);
        assert!(apart(&moved(linear, d), &same) < 1e-7);
        if flags & BRANCH_JUMP != 0 {
            folded += 1;
            assert!(difference < 1e-7, "{d:?} {difference}");
        } else if flags & (CELL | SMOOTH) == CELL | SMOOTH && difference > 1e-5 {
            smooth += 1;
        }
    }
    assert!(folded > 20 && smooth > 1000, "{folded} {smooth}");
}
