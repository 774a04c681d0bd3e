//! Interpolation from the condensed energy and its derivatives at the eight corners of a cell.
//!
//! A node of the table holds W_abc = d^(a+b+c) W / dx^a dy^b dz^c for a, b, c in 0..=2 at a grid point. The solver gives those of
//! order 0 to 3 exactly (W, h, S and its third derivatives), the fit makes the others. The quintic of [`energy`] takes all 27; the
//! cubics of [`force`] take those that are derivatives of h.

pub mod energy;
pub mod force;

use crate::grid::Strides;
use crate::table::{TableError, check_len};

/// W_abc at one grid point as `[a][b][c]`, in cell units and newtons: W_abc spacing^(a + b + c - 1). The fourth of every four
/// is padding, so that rows stay whole vectors.
pub type Node = [[[f32; 4]; 3]; 3];

/// Largest value in a table: as [`crate::table::LARGEST_VALUE`], and its sum over a cell cannot overflow.
const LARGEST: f32 = 1e9;

/// The derivatives of W at the grid points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HermiteTable<'a> {
    row: &'a [u32],
    nodes: &'a [Node],
}

/// The corners of a cell as `[x][y][z]`.
pub(crate) type Corners<'a> = [[[&'a Node; 2]; 2]; 2];

impl<'a> HermiteTable<'a> {
    /// Checks that every slot of the box has a node and that all values are finite.
    ///
    /// `row` has one index into `nodes` per slot. Slots that no query comes to may share a node.
    pub fn new(slots: usize, row: &'a [u32], nodes: &'a [Node]) -> Result<Self, TableError> {
        check_len(row, slots)?;
        let values = nodes.as_flattened().as_flattened().as_flattened();
        if let Some(index) = values.iter().position(|value| value.is_nan() || value.abs() > LARGEST) {
            return Err(TableError::NotFinite { index });
        }
        match row.iter().position(|&row| row as usize >= nodes.len()) {
            None => Ok(Self { row, nodes }),
            Some(index) => Err(TableError::OutOfRange { index }),
        }
    }

    /// Size of both planes.
    pub const fn bytes(&self) -> usize {
        size_of_val(self.row) + size_of_val(self.nodes)
    }

    /// The node of a slot.
    pub fn node(&self, slot: usize) -> Option<&'a Node> {
        self.nodes.get(*self.row.get(slot)? as usize)
    }

    /// The corners of the cell whose low corner is `slot`. `None` past the end of the box, where no query comes.
    #[inline(always)]
    pub(crate) fn corners(&self, strides: Strides, slot: usize) -> Option<Corners<'a>> {
        let (side, sheet) = (strides.side as usize, strides.sheet as usize);
        // One check for all four: the compiler sees that the others follow.
        let rows = self.row.get(slot..)?.get(..sheet.wrapping_add(side).wrapping_add(2))?;
        let column = |at: usize| -> Option<[&'a Node; 2]> {
            let [low, high] = rows.get(at..at.wrapping_add(2))?.first_chunk::<2>()?;
            Some([self.nodes.get(*low as usize)?, self.nodes.get(*high as usize)?])
        };
        Some([[column(0)?, column(side)?], [column(sheet)?, column(sheet.wrapping_add(side))?]])
    }
}
