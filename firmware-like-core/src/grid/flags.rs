//! One byte per slot: which configurations are solved, and which cells and super-cells are therefore
//! complete.
//!
//! [`CELL`], [`SUPERCELL`] and [`INTERIOR`] follow from [`SOLVED`], and [`SMOOTH`] from [`BRANCH_JUMP`]. The
//! writer derives them with [`derive()`], the reader verifies them; a query only looks them up.

use super::{BallLattice, CORNERS, Location, corner_weights};
use crate::num::vec3::{self, Vec3};

/// A converged configuration belongs to this slot; otherwise its values are extrapolated ("ghosts").
pub const SOLVED: u8 = 1;
/// Solved, and the reaction exceeds the device's force.
pub const TERMINATING: u8 = 2;
/// Solved, with at least one inverted element.
pub const INVERTED: u8 = 4;
/// All 8 corners of the cell whose low corner is this slot are solved.
pub const CELL: u8 = 8;
/// All 64 points of that cell's super-cell are solved.
pub const SUPERCELL: u8 = 16;
/// All 8 cells that touch this slot are SUPERCELL.
pub const INTERIOR: u8 = 32;
/// The corners of the cell whose low corner is this slot lie on different solution branches (a bifurcation,
/// called fold here): the force jumps inside the cell.
pub const BRANCH_JUMP: u8 = 64;
/// None of the 8 cells that touch this slot is BRANCH_JUMP.
pub const SMOOTH: u8 = 128;

/// The bits that the writer sets; the others are derived.
const GIVEN: u8 = SOLVED | TERMINATING | INVERTED | BRANCH_JUMP;

/// Whether every slot of the block ijk + from ..= ijk + to has all bits of `mask`.
fn block_has(lattice: &BallLattice, flags: &[u8], ijk: [i32; 3], from: i32, to: i32, mask: u8) -> bool {
    let [i, j, k] = ijk;
    (from..=to).all(|a| {
        (from..=to).all(|b| {
            (from..=to).all(|c| {
                let point = [i.saturating_add(a), j.saturating_add(b), k.saturating_add(c)];
                let found = lattice.slot(point).and_then(|slot| flags.get(slot));
                found.is_some_and(|bits| bits & mask == mask)
            })
        })
    })
}

fn cell_bits(lattice: &BallLattice, flags: &[u8], ijk: [i32; 3]) -> u8 {
    let cell = if block_has(lattice, flags, ijk, 0, 1, SOLVED) { CELL } else { 0 };
    // The super-cell contains the cell, so its 64 points are looked up only where the 8 corners are solved.
    let supercell = if cell != 0 && block_has(lattice, flags, ijk, -1, 2, SOLVED) { SUPERCELL } else { 0 };
    cell | supercell
}

fn smooth_bit(lattice: &BallLattice, flags: &[u8], [i, j, k]: [i32; 3]) -> u8 {
    let touches_fold = CORNERS.iter().any(|[a, b, c]| {
        let cell = [i.saturating_sub(*a), j.saturating_sub(*b), k.saturating_sub(*c)];
        lattice.slot(cell).and_then(|slot| flags.get(slot)).is_some_and(|bits| bits & BRANCH_JUMP != 0)
    });
    if touches_fold { 0 } else { SMOOTH }
}

fn interior_bit(lattice: &BallLattice, flags: &[u8], ijk: [i32; 3]) -> u8 {
    if block_has(lattice, flags, ijk, -1, 0, SUPERCELL) { INTERIOR } else { 0 }
}

/// Sets CELL, SUPERCELL, INTERIOR and SMOOTH of every slot from SOLVED and BRANCH_JUMP.
///
/// Shapes: `flags` has one byte per slot of the lattice's box.
pub fn derive(lattice: &BallLattice, flags: &mut [u8]) {
    for slot in 0..flags.len() {
        let derived = cell_bits(lattice, flags, lattice.ijk(slot));
        if let Some(bits) = flags.get_mut(slot) {
            *bits = (*bits & GIVEN) | derived;
        }
    }
    for slot in 0..flags.len() {
        let ijk = lattice.ijk(slot);
        let derived = interior_bit(lattice, flags, ijk) | smooth_bit(lattice, flags, ijk);
        if let Some(bits) = flags.get_mut(slot) {
            *bits |= derived;
        }
    }
}

/// The first slot whose bits contradict those of its neighbours, if any.
///
/// Shapes: as in [`derive()`].
pub(crate) fn first_inconsistent(lattice: &BallLattice, flags: &[u8]) -> Option<usize> {
    flags.iter().enumerate().position(|(slot, &bits)| {
        let ijk = lattice.ijk(slot);
        // INTERIOR is compared with the stored SUPERCELL bits, which the same pass compares with SOLVED.
        let derived = cell_bits(lattice, flags, ijk)
            | interior_bit(lattice, flags, ijk)
            | smooth_bit(lattice, flags, ijk);
        let qualified_but_not_solved = bits & SOLVED == 0 && bits & (TERMINATING | INVERTED) != 0;
        bits & !GIVEN != derived || qualified_but_not_solved
    })
}

/// A lattice with the flags of its slots.
#[derive(Clone, Copy)]
pub(crate) struct Ball<'s> {
    pub(crate) lattice: &'s BallLattice,
    pub(crate) flags: &'s [u8],
}

impl Ball<'_> {
    /// The flags of the cell of a point.
    #[inline(always)]
    pub(crate) fn cell_flags(self, at: &Location) -> u8 {
        self.flags.get(at.slot).copied().unwrap_or(0)
    }

    /// Derivatives per cell as derivatives per metre.
    pub(crate) fn per_metre(self, rows: [Vec3; 3]) -> [Vec3; 3] {
        rows.map(|row| vec3::scale(row, self.lattice.cells_per_m()))
    }

    /// Smoothstep of the tri-linear interpolation of a flag: 1 where all corners of the cell have it, 0 where
    /// none has.
    ///
    /// w(t) = s^2 (3 - 2 s),   s = sum of w_c(t) over the corners c with the flag
    #[inline(always)]
    pub(crate) fn smooth(self, flag: u8, at: &Location) -> f32 {
        let Some(pairs) = self.corner_flags(at) else { return 0.0 };
        let [a, b, c, d] = pairs.map(u16::from_le_bytes);
        let both = u16::from_le_bytes([flag; 2]);
        // Exactly 1 inside: the rounded sum of eight weights would cause both methods to be evaluated.
        if a & b & c & d & both == both {
            return 1.0;
        }
        if (a | b | c | d) & both == 0 {
            return 0.0;
        }
        smooth_partly(pairs, flag, at.t)
    }

    /// dw/dt of [`Ball::smooth`].
    pub(crate) fn smooth_slope(self, flag: u8, at: &Location) -> Vec3 {
        let raw = |t: Vec3| -> f32 {
            let corners = self.lattice.corners(at.slot).into_iter().zip(corner_weights(t));
            let has_flag = |slot: usize| self.flags.get(slot).is_some_and(|bits| bits & flag != 0);
            corners.filter(|(slot, _)| has_flag(*slot)).map(|(_, weight)| weight).sum()
        };
        let [tx, ty, tz] = at.t;
        let w = raw(at.t).min(1.0);
        let rise = [
            raw([1.0, ty, tz]) - raw([0.0, ty, tz]),
            raw([tx, 1.0, tz]) - raw([tx, 0.0, tz]),
            raw([tx, ty, 1.0]) - raw([tx, ty, 0.0]),
        ];
        vec3::scale(rise, 6.0 * w * (1.0 - w))
    }

    /// The flags of the eight corners of a cell, in pairs along z.
    #[inline(always)]
    fn corner_flags(self, at: &Location) -> Option<[[u8; 2]; 4]> {
        let strides = self.lattice.strides();
        let (side, sheet) = (strides.side as usize, strides.sheet as usize);
        // One bounds check for all four: the compiler derives the others from it.
        let flags = self.flags.get(at.slot..)?.get(..sheet.wrapping_add(side).wrapping_add(2))?;
        Some([
            *flags.first_chunk()?,
            *flags.get(side..)?.first_chunk()?,
            *flags.get(sheet..)?.first_chunk()?,
            *flags.get(sheet.wrapping_add(side)..)?.first_chunk()?,
        ])
    }
}

#[inline(never)]
fn smooth_partly(pairs: [[u8; 2]; 4], flag: u8, t: Vec3) -> f32 {
    let weights = corner_weights(t);
    let with_flag = pairs.as_flattened().iter().zip(weights).filter(|(bits, _)| *bits & flag != 0);
    let sum: f32 = with_flag.map(|(_, weight)| weight).sum();
    let sum = sum.min(1.0);
    sum * sum * (3.0 - 2.0 * sum)
}
