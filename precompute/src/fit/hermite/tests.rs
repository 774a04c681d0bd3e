//! The table of a polynomial of known derivatives.

use nalgebra::Matrix3;
use palpate_core::{HermitePlanes, flags};

use super::*;
use crate::num::jet::EnergyJet;

/// W = sum of c_n (u_n . x)^5 / 5!, x in m: a quintic polynomial with known derivatives.
const TERMS: [([f64; 3], f64); 4] =
    [([1.0, 0.3, -0.5], 8e6), ([0.2, -1.0, 0.6], 5e6), ([0.4, 0.5, 1.0], -6e6), ([0.7, -0.7, 0.2], 4e6)];

fn derivative(x: [f64; 3], axes: &[usize]) -> f64 {
    let factorial = |n: usize| (1..=n).product::<usize>() as f64;
    let of = |(u, c): &([f64; 3], f64)| {
        let along: f64 = u.iter().zip(x).map(|(u, x)| u * x).sum();
        let left = 5 - axes.len();
        c * along.powi(left as i32) / factorial(left) * axes.iter().map(|&i| u[i]).product::<f64>()
    };
    // A stiffness at rest, so that the forces have a realistic size.
    let base = match axes {
        [] => 150.0 * x.iter().map(|x| x * x).sum::<f64>(),
        [i] => 300.0 * x[*i],
        [i, j] if i == j => 300.0,
        _ => 0.0,
    };
    base + TERMS.iter().map(of).sum::<f64>()
}

fn sample(grid: &SpaceGrid, index: GridIndex) -> Sample {
    let x = grid.displacement_m(index);
    Sample {
        index,
        attempt: 0,
        jet: EnergyJet {
            control_m: x,
            energy_j: derivative(x, &[]),
            force_n: std::array::from_fn(|i| derivative(x, &[i])),
            stiffness_n_m: Matrix3::from_fn(|i, j| derivative(x, &[i, j])),
            third_n_m2: crate::num::jet::THIRD_INDICES.map(|triple| derivative(x, &triple)),
        },
        derivatives: None,
        terminating: false,
        inverted: false,
    }
}

/// Largest errors of `energy` and `hermite` at inner positions, N.
fn errors(spacing_m: f64, without: impl Fn(GridIndex) -> bool) -> [f64; 2] {
    let grid = SpaceGrid::new(spacing_m, 0.06).unwrap();
    let samples: Vec<Sample> =
        Domain::new(&grid, true).points().filter(|&p| !without(p)).map(|p| sample(&grid, p)).collect();
    let table = hermite_nodes(&grid, &samples, &[]);
    let table = HermitePlanes { row: &table.row, nodes: &table.nodes };
    table.check(&grid.lattice).expect("a table");
    let mut worst = [0.0f64; 2];
    for n in 0..4000u32 {
        let x: [f64; 3] = std::array::from_fn(|i| 0.022 * f64::sin(f64::from(n + 1) * [1.3, 2.9, 4.7][i]));
        let place = grid.lattice.locate(x.map(|x| x as f32));
        let found = [table.energy_gradient(&grid.lattice, &place), table.cubic_force(&grid.lattice, &place)];
        for (worst, found) in worst.iter_mut().zip(found) {
            for i in 0..3 {
                *worst = worst.max((f64::from(found[i]) - derivative(x, &[i])).abs());
            }
        }
    }
    worst
}

#[test]
fn a_polynomial_of_degree_five_is_met_to_rounding_and_hermite_converges_with_order_four() {
    let coarse = errors(0.01, |_| false);
    let fine = errors(0.005, |_| false);
    assert!(coarse[0] < 6e-5 && fine[0] < 6e-5, "energy: {} {} N", coarse[0], fine[0]);
    let order = (coarse[1] / fine[1]).log2();
    assert!(
        coarse[1] > 1e-4 && (3.5..4.6).contains(&order),
        "hermite: {} {} N, order {order}",
        coarse[1],
        fine[1]
    );
}

#[test]
fn a_ghost_continues_its_neighbours() {
    let hole = |p: GridIndex| p == [1, 1, 0] || p == [-2, 0, 1];
    let [energy, hermite] = errors(0.01, hole);
    let largest = derivative([0.02, 0.02, 0.02], &[0]);
    assert!(energy < 2e-2 * largest && hermite < 2e-2 * largest, "{energy} {hermite} of {largest} N");
}

#[test]
fn no_difference_is_taken_across_a_fold() {
    let grid = SpaceGrid::new(0.01, 0.03).unwrap();
    let points: Vec<GridIndex> = Domain::new(&grid, true).points().collect();
    // Beyond x = 15 mm lies a different branch with unrelated derivatives.
    let beyond = |p: GridIndex| p[0] > 1;
    let samples = |jump: f64| -> Vec<Sample> {
        let of = |&p: &GridIndex| {
            let mut s = sample(&grid, p);
            if beyond(p) {
                s.jet.third_n_m2 = s.jet.third_n_m2.map(|w| w + jump);
            }
            s
        };
        points.iter().map(of).collect()
    };
    let branch_jumps: Vec<BranchJump> = points
        .iter()
        .flat_map(|&a| points.iter().map(move |&b| (a, b)))
        .filter(|&(a, b)| a < b && beyond(a) != beyond(b) && (0..3).all(|i| (a[i] - b[i]).abs() <= 1))
        .map(|(from, to)| BranchJump { from, to, rho_n: 1.0, rho_h_n: 1.0 })
        .collect();
    let node = |jump: f64, branch_jumps: &[BranchJump]| {
        let table = hermite_nodes(&grid, &samples(jump), branch_jumps);
        table.nodes[table.row[grid.lattice.slot([1, 0, 0]).unwrap()] as usize]
    };
    assert_eq!(node(0.0, &branch_jumps), node(1e6, &branch_jumps), "no difference is taken across the jump");
    assert_ne!(node(0.0, &[]), node(1e6, &[]), "without flags a difference is taken across the jump");
    let values = crate::fit::lattice_values(&grid, &samples(0.0), &branch_jumps);
    for (slot, bits) in values.flags.iter().enumerate() {
        let [i, j, k] = grid.lattice.ijk(slot);
        let crossed = i == 1 && [j, k].iter().all(|n| (-3..3).contains(n));
        let flagged = bits & flags::BRANCH_JUMP != 0;
        assert!(!flagged || i == 1, "cell {i} {j} {k}");
        if crossed && j.abs() < 2 && k.abs() < 2 {
            assert!(flagged, "cell {i} {j} {k}");
        }
    }
}

/// The stiffness of a branch is unbounded at the fold where it ends.
#[test]
fn a_runaway_stiffness_at_a_fold_is_held() {
    let grid = SpaceGrid::new(0.01, 0.03).unwrap();
    let runaway = |factor: f64, branch_jumps: &[BranchJump]| {
        let of = |p: GridIndex| {
            let mut s = sample(&grid, p);
            if p == [1, 0, 0] {
                s.jet.stiffness_n_m *= factor;
            }
            s
        };
        let samples: Vec<Sample> = Domain::new(&grid, true).points().map(of).collect();
        hermite_nodes(&grid, &samples, branch_jumps)
    };
    let largest_n = |nodes: &HermiteNodes| {
        let table = HermitePlanes { row: &nodes.row, nodes: &nodes.nodes };
        table.check(&grid.lattice).expect("a table");
        let at = |n: u32| -> [f32; 3] {
            let wave: [f64; 3] = std::array::from_fn(|i| f64::sin(f64::from(n + 1) * [1.3, 2.9, 4.7][i]));
            [0.01 + 0.01 * wave[0], 0.01 * wave[1], 0.01 * wave[2]].map(|x| x as f32)
        };
        (0..4000)
            .map(|n| {
                let place = grid.lattice.locate(at(n));
                norm(table.cubic_force(&grid.lattice, &place).map(f64::from))
            })
            .fold(0.0, f64::max)
    };
    let fold = [BranchJump { from: [1, 0, 0], to: [2, 0, 0], rho_n: 1.0, rho_h_n: 1.0 }];
    let read_only = largest_n(&runaway(1.0, &fold));
    let held = largest_n(&runaway(1e4, &fold));
    assert!(held < 3.0 * read_only, "held: {held} N beside {read_only} N");
    let free = largest_n(&runaway(1e4, &[]));
    assert!(
        free > 100.0 * read_only,
        "slopes are limited away from branch jumps: {free} N, unlimited {read_only} N"
    );
    // A realistic stiffness is not limited, also at branch jumps.
    let node = |nodes: &HermiteNodes, p| nodes.nodes[nodes.row[grid.lattice.slot(p).unwrap()] as usize];
    let (folded, plain) = (runaway(1.0, &fold), runaway(1.0, &[]));
    for p in [[1, 0, 0], [2, 0, 0], [1, 1, 1]] {
        // W_xx, W_yy and W_zz.
        let slopes = |node: palpate_core::HermiteNode| [node[2][0][0], node[0][2][0], node[0][0][2]];
        assert_eq!(slopes(node(&folded, p)), slopes(node(&plain, p)), "{p:?}");
    }
}
