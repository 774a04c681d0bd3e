//! The lattice: counts, indices, cells, flags.

use crate::common::Random;
use palpate_core::flags::{self, CELL, INTERIOR, SOLVED, SUPERCELL};
use palpate_core::{
    ActiveNode, BallLattice, CORNERS, LatticeError, MAX_CELLS, PlaneProblem, Space, SpacePlanes,
};

fn lattice(cells: f32) -> BallLattice {
    BallLattice::new(0.05 / cells, 0.05).expect("valid")
}

/// The paper's four grids are the ball's lattice points less the rest point.
#[test]
fn the_four_grids_of_the_paper() {
    for radius_m in [0.05, 0.1, 0.03, 1.0, 0.037] {
        for (cells, count) in [(5.0, 514), (7.0, 1418), (10.0, 4168), (15.0, 14146)] {
            let lattice = BallLattice::new(radius_m / cells, radius_m).expect("valid");
            assert_eq!(lattice.points().count(), count, "{cells} cells of {radius_m} m");
            assert_eq!(lattice.reach(), cells as i32);
            assert_eq!(lattice.slots(), (2 * (cells as usize) + 3).pow(3));
        }
    }
    // The radius is not a whole number of cells: the box is rounded up, the ball is not.
    let lattice = BallLattice::new(0.02, 0.05).expect("valid");
    assert_eq!((lattice.reach(), lattice.contains([2, 1, 1]), lattice.contains([2, 2, 0])), (3, true, false));
}

#[test]
fn slots_and_points_are_inverse() {
    let lattice = lattice(5.0);
    for slot in 0..lattice.slots() {
        assert_eq!(lattice.slot(lattice.ijk(slot)), Some(slot));
    }
    let e = lattice.reach() + 1;
    assert_eq!(lattice.ijk(1), [-e, -e, 1 - e], "z runs fastest");
    assert_eq!(lattice.slot([0; 3]), Some(lattice.slots() / 2));
    for outside in [[e + 1, 0, 0], [0, -e - 1, 0], [0, 0, i32::MAX], [i32::MIN, 0, 0]] {
        assert_eq!(lattice.slot(outside), None);
        assert!(!lattice.contains(outside));
    }
    assert!(lattice.points().all(|ijk| ijk != [0; 3] && lattice.contains(ijk)));
}

#[test]
fn impossible_sizes_are_refused() {
    for (spacing_m, radius_m) in [
        (0.0, 1.0),
        (-1.0, 1.0),
        (1.0, 0.5),
        (f32::NAN, 1.0),
        (0.1, f32::NAN),
        (0.1, f32::INFINITY),
        (1e-44, 1e-44),
    ] {
        assert!(
            matches!(BallLattice::new(spacing_m, radius_m), Err(LatticeError::Size { .. })),
            "{spacing_m} {radius_m}"
        );
    }
    assert!(matches!(BallLattice::new(1e-6, 1.0), Err(LatticeError::TooFine { .. })));
    assert!(BallLattice::new(1.0, MAX_CELLS as f32).is_ok());
}

/// Any query has a cell that contains it and whose super-cell is in the box.
#[test]
fn every_query_has_a_cell_with_its_super_cell() {
    let lattice = lattice(5.0);
    let mut random = Random(1);
    let extremes = [0.05, -0.05, 0.0, 1e-42, -1e-42, 1e30, -1e30, f32::NAN, f32::INFINITY, f32::NEG_INFINITY];
    let mut queries: Vec<_> = (0..10_000).map(|_| random.point(0.08)).collect();
    for x in extremes {
        for y in extremes {
            queries.extend(extremes.map(|z| [x, y, z]));
        }
    }
    for d in queries {
        let at = lattice.locate(d);
        let low = lattice.ijk(at.slot);
        assert!(lattice.slot(low.map(|n| n - 1)).is_some() && lattice.slot(low.map(|n| n + 2)).is_some());
        assert!(at.t.iter().all(|t| (0.0..=1.0).contains(t)) && at.position.iter().all(|x| x.abs() < 5.001));
        let norm = d.map(f64::from).iter().map(|x| x * x).sum::<f64>().sqrt();
        if (norm - 0.05).abs() > 1e-7 || !norm.is_finite() {
            assert_eq!(at.inside, norm < 0.05, "{d:?}");
        }
        if at.inside {
            for axis in 0..3 {
                let back = (low[axis] as f32 + at.t[axis]) * lattice.spacing_m();
                assert!((back - d[axis]).abs() < 1e-7, "{d:?}");
            }
        }
    }
}

/// Corners are listed in the order of their slots.
#[test]
fn corners_are_in_the_order_of_the_slots() {
    let lattice = lattice(5.0);
    for low in [[0, 0, 0], [-3, 2, 1], [-5, -5, -5]] {
        let slot = |offset: [i32; 3]| lattice.slot(std::array::from_fn(|i| low[i] + offset[i]));
        let corners = lattice.corners(slot([0; 3]).expect("in the box"));
        assert!(corners.is_sorted());
        assert_eq!(corners.map(Some), CORNERS.map(slot));
    }
}

/// Derived flags against their definition, on a ball with holes.
#[test]
fn flags_follow_from_the_solved_points() {
    let lattice = lattice(5.0);
    let solved = |n: [i32; 3]| lattice.contains(n) && n != [2, 1, 0] && n != [-4, 0, 0];
    let mut bits: Vec<u8> = (0..lattice.slots()).map(|slot| u8::from(solved(lattice.ijk(slot)))).collect();
    flags::derive(&lattice, &mut bits);
    let all = |n: [i32; 3], from: i32, to: i32, test: &dyn Fn([i32; 3]) -> bool| {
        (from..=to).all(|a| (from..=to).all(|b| (from..=to).all(|c| test([n[0] + a, n[1] + b, n[2] + c]))))
    };
    let supercell = |n| all(n, -1, 2, &solved);
    let mut seen = [0; 3];
    for (slot, &bits) in bits.iter().enumerate() {
        let n = lattice.ijk(slot);
        assert_eq!(bits & SOLVED != 0, solved(n));
        assert_eq!(bits & CELL != 0, all(n, 0, 1, &solved));
        assert_eq!(bits & SUPERCELL != 0, supercell(n));
        assert_eq!(bits & INTERIOR != 0, all(n, -1, 0, &supercell));
        for (seen, flag) in seen.iter_mut().zip([CELL, SUPERCELL, INTERIOR]) {
            *seen += usize::from(bits & flag != 0);
        }
    }
    assert!(seen.iter().all(|&seen| seen > 0), "each flag occurs: {seen:?}");
    let refusal = |flags: &[u8]| {
        let planes = SpacePlanes { flags, ..SpacePlanes::default() };
        Space::new(ActiveNode::default(), lattice, planes, 0).err().map(|error| error.problem)
    };
    assert_eq!(refusal(&bits), None);
    // Any single wrong bit is found.
    for slot in 0..bits.len() {
        for bit in 0..8 {
            let mut wrong = bits.clone();
            wrong[slot] ^= 1 << bit;
            let harmless =
                matches!(1 << bit, flags::TERMINATING | flags::INVERTED) && bits[slot] & SOLVED != 0;
            // A single solved point that completes no cell gives another consistent table.
            let other = bit == 0 && {
                let mut derived = wrong.clone();
                flags::derive(&lattice, &mut derived);
                derived == wrong
            };
            let found = refusal(&wrong);
            assert!(found.is_none() || matches!(found, Some(PlaneProblem::Flags { .. })), "{found:?}");
            assert_eq!(found.is_some(), !harmless && !other, "slot {slot}, bit {bit}");
        }
    }
}
