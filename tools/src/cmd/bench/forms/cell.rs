//! The energy's table as one polynomial per cell: the data that the core would read if it stored cells
//! instead of nodes. It is measured, not packed.
//!
//! W(t) = sum_abc C_abc tx^a ty^b tz^c, a, b, c in 0..=5: 216 coefficients per cell, rows along c padded to
//! eight, 1,152 bytes. In the loop the core computes the same polynomial from the eight nodes.

use palpate_core::lanes::{Baseline, Machine};
use palpate_core::{BallLattice, CORNERS, Space, Vec3};

/// `[a][b][c]`.
type Cell = [[[f32; 8]; 6]; 6];
type Lanes = <Baseline as Machine>::F32x8;

/// Quintic Hermite in powers of t: value, slope and curvature at 0, then at 1.
const QUINTIC: [[f64; 6]; 6] = [
    [1.0, 0.0, 0.0, -10.0, 15.0, -6.0],
    [0.0, 1.0, 0.0, -6.0, 8.0, -3.0],
    [0.0, 0.0, 0.5, -1.5, 1.5, -0.5],
    [0.0, 0.0, 0.0, 10.0, -15.0, 6.0],
    [0.0, 0.0, 0.0, -4.0, 7.0, -3.0],
    [0.0, 0.0, 0.0, 0.5, -1.0, 0.5],
];

/// Every cell that intersects the ball.
pub(super) struct CellTable {
    lattice: BallLattice,
    /// The cell of a slot.
    row: Vec<u32>,
    cells: Vec<Cell>,
}

impl CellTable {
    /// The cells from the nodes of a space; `None` if it has none.
    pub(super) fn of(space: &Space<'_>) -> Option<Self> {
        let (lattice, planes) = (*space.lattice(), space.planes().hermite?);
        let (mut row, mut cells) = (vec![0; lattice.slots()], vec![[[[0.0; 8]; 6]; 6]]);
        let in_cells = lattice.radius_m() / lattice.spacing_m();
        for (slot, row) in row.iter_mut().enumerate() {
            let low = lattice.ijk(slot);
            let nearest = low.map(|n| if n < 0 { (n + 1) as f32 } else { n as f32 });
            let is_there = low.iter().all(|n| (-lattice.reach()..lattice.reach()).contains(n))
                && nearest.iter().map(|x| x * x).sum::<f32>() < in_cells * in_cells;
            if !is_there {
                continue;
            }
            *row = cells.len() as u32;
            let mut sum = [[[0.0; 6]; 6]; 6];
            for end in CORNERS {
                let corner = std::array::from_fn(|axis| low[axis] + end[axis]);
                let node = planes.nodes.get(*planes.row.get(lattice.slot(corner)?)? as usize)?;
                for (i, j, k) in (0..27).map(|code: usize| (code / 9, code / 3 % 3, code % 3)) {
                    let of = |axis: usize, order: usize| &QUINTIC[3 * end[axis] as usize + order];
                    for (a, x) in of(0, i).iter().enumerate() {
                        for (b, y) in of(1, j).iter().enumerate() {
                            for (c, z) in of(2, k).iter().enumerate() {
                                sum[a][b][c] += f64::from(node[i][j][k]) * x * y * z;
                            }
                        }
                    }
                }
            }
            cells.push(sum.map(|plane| {
                plane.map(|line| std::array::from_fn(|c| line.get(c).map_or(0.0, |x| *x as f32)))
            }));
        }
        Some(Self { lattice, row, cells })
    }

    /// Bytes of both planes.
    pub(super) fn bytes(&self) -> usize {
        size_of_val(self.row.as_slice()) + size_of_val(self.cells.as_slice())
    }

    /// h within the ball, N: Horner's rule along x and y, two sums along z.
    #[inline]
    pub(super) fn force_n(&self, displacement_m: &Vec3) -> Vec3 {
        let at = self.lattice.locate(*displacement_m);
        let Some(cell) = self.row.get(at.slot).and_then(|row| self.cells.get(*row as usize)) else {
            return [0.0; 3];
        };
        let [tx, ty, tz] = at.t;
        let (x, y) = (Baseline.splat(tx), Baseline.splat(ty));
        let nothing = Baseline.splat(0.0);
        let [mut value, mut along_x, mut along_y] = [nothing; 3];
        for b in (0..6).rev() {
            let (mut column, mut slope) = (line(&cell[5][b]), nothing);
            for plane in cell[..5].iter().rev() {
                slope = slope * x + column;
                column = column * x + line(&plane[b]);
            }
            along_y = along_y * y + value;
            value = value * y + column;
            along_x = along_x * y + slope;
        }
        let (z2, z3) = (tz * tz, tz * tz * tz);
        let powers = [1.0, tz, z2, z3, z2 * z2, z2 * z3, 0.0, 0.0];
        let slopes = [0.0, 1.0, 2.0 * tz, 3.0 * z2, 4.0 * z3, 5.0 * z2 * z2, 0.0, 0.0];
        [sum(along_x * line(&powers)), sum(along_y * line(&powers)), sum(value * line(&slopes))]
    }
}

#[inline(always)]
fn line([a, b, c, d, e, f, g, h]: &[f32; 8]) -> Lanes {
    Baseline.join([*a, *b, *c, *d], [*e, *f, *g, *h])
}

#[inline(always)]
fn sum(lanes: Lanes) -> f32 {
    let [[a, b, c, d], [e, f, g, h]] = Baseline.halves(lanes);
    ((a + e) + (c + g)) + ((b + f) + (d + h))
}
