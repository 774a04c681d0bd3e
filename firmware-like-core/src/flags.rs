//! One byte per slot: which configurations are solved, and which cells and super-cells are therefore complete.
//!
//! CELL, SUPERCELL and INTERIOR follow from SOLVED, SMOOTH from FOLD. The writer derives them with [`derive()`], the reader verifies them
//! with [`first_inconsistent`], and both ask the same functions; the tick only looks them up.

use crate::grid::BallLattice;

/// A converged configuration stands behind this slot (otherwise its values are a ghost's).
pub const SOLVED: u8 = 1;
/// Solved, and the reaction is beyond the device's force.
pub const TERMINATING: u8 = 2;
/// Solved, with at least one inverted element.
pub const INVERTED: u8 = 4;
/// All 8 corners of the cell whose low corner is this slot are solved.
pub const CELL: u8 = 8;
/// All 64 points of that cell's super-cell are solved.
pub const SUPERCELL: u8 = 16;
/// All 8 cells that touch this slot are SUPERCELL.
pub const INTERIOR: u8 = 32;

/// Two corners of the cell whose low corner is this slot lie on different branches.
pub const FOLD: u8 = 64;
/// None of the 8 cells that touch this slot is FOLD.
pub const SMOOTH: u8 = 128;

/// Bits the writer sets; the others are derived.
const GIVEN: u8 = SOLVED | TERMINATING | INVERTED | FOLD;

/// Whether every slot of the block ijk + from ..= ijk + to carries all bits of `mask`.
fn block_has(lattice: &BallLattice, flags: &[u8], ijk: [i32; 3], from: i32, to: i32, mask: u8) -> bool {
    let [i, j, k] = ijk;
    (from..=to).all(|a| {
        (from..=to).all(|b| {
            (from..=to).all(|c| {
                let corner = [i.saturating_add(a), j.saturating_add(b), k.saturating_add(c)];
                let found = lattice.slot(corner).and_then(|slot| flags.get(slot));
                found.is_some_and(|bits| bits & mask == mask)
            })
        })
    })
}

fn cell_bits(lattice: &BallLattice, flags: &[u8], ijk: [i32; 3]) -> u8 {
    let cell = if block_has(lattice, flags, ijk, 0, 1, SOLVED) { CELL } else { 0 };
    // The super-cell holds the cell, so its 64 look-ups are only made where the 8 succeeded.
    let supercell = if cell != 0 && block_has(lattice, flags, ijk, -1, 2, SOLVED) { SUPERCELL } else { 0 };
    cell | supercell
}

fn smooth_bit(lattice: &BallLattice, flags: &[u8], [i, j, k]: [i32; 3]) -> u8 {
    let folded = (0..8).any(|code: i32| {
        let cell = [i.saturating_sub(code & 1), j.saturating_sub(code >> 1 & 1), k.saturating_sub(code >> 2)];
        lattice.slot(cell).and_then(|slot| flags.get(slot)).is_some_and(|bits| bits & FOLD != 0)
    });
    if folded { 0 } else { SMOOTH }
}

fn interior_bit(lattice: &BallLattice, flags: &[u8], ijk: [i32; 3]) -> u8 {
    if block_has(lattice, flags, ijk, -1, 0, SUPERCELL) { INTERIOR } else { 0 }
}

/// Sets CELL, SUPERCELL, INTERIOR and SMOOTH of every slot from SOLVED and FOLD. `flags` has one byte per slot of the box.
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

/// First slot whose bits contradict each other, if any.
pub fn first_inconsistent(lattice: &BallLattice, flags: &[u8]) -> Option<usize> {
    flags.iter().enumerate().position(|(slot, &bits)| {
        let ijk = lattice.ijk(slot);
        // INTERIOR is tested against stored SUPERCELL bits, which the same pass tests against SOLVED.
        let derived = cell_bits(lattice, flags, ijk)
            | interior_bit(lattice, flags, ijk)
            | smooth_bit(lattice, flags, ijk);
        let qualified_but_not_solved = bits & SOLVED == 0 && bits & (TERMINATING | INVERTED) != 0;
        bits & !GIVEN != derived || qualified_but_not_solved
    })
}
