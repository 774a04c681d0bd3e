//! Cubic Hermite interpolants of the three force components: C1, but no gradient.
//!
//! h_i(t) = sum over corners and a, b, c in 0..=1 of H_a(tx) H_b(ty) H_c(tz) d^(a+b+c) h_i / dx^a dy^b dz^c
//!
//! The derivatives of h_i are derivatives of W, so the table is the energy's. Where a fold or a failed solve makes W useless this is
//! the calmer of the two: it takes no derivative of W beyond the fourth, and errs by h^4 in h, not by a slope of W across a jump.

use super::energy::add_scaled;
use super::{Corners, HermiteTable};
use crate::vec3::{self, Vec3};

/// The cubics at t: `[corner][value or slope]`.
type Weights = [[f32; 2]; 2];

#[inline]
fn values(t: f32) -> Weights {
    let s = 1.0 - t;
    [[(1.0 + 2.0 * t) * s * s, t * s * s], [(3.0 - 2.0 * t) * t * t, -s * t * t]]
}

fn slopes(t: f32) -> Weights {
    let s = 1.0 - t;
    [[-6.0 * t * s, s * (1.0 - 3.0 * t)], [6.0 * t * s, t * (3.0 * t - 2.0)]]
}

impl HermiteTable<'_> {
    /// h in the cell whose low corner is `slot`, newtons. Zero past the end of the box.
    #[inline]
    pub fn force(&self, side: usize, slot: usize, [tx, ty, tz]: Vec3) -> Vec3 {
        let weights = [values(tx), values(ty), values(tz)];
        self.corners(side, slot).map_or(vec3::ZERO, |corners| contract(&corners, &weights))
    }

    /// dh_i/dt_j as rows i; zero past the end of the box.
    pub fn force_slope(&self, side: usize, slot: usize, [tx, ty, tz]: Vec3) -> [Vec3; 3] {
        let Some(corners) = self.corners(side, slot) else { return [vec3::ZERO; 3] };
        let [wx, wy, wz] = [values(tx), values(ty), values(tz)];
        vec3::transposed([
            contract(&corners, &[slopes(tx), wy, wz]),
            contract(&corners, &[wx, slopes(ty), wz]),
            contract(&corners, &[wx, wy, slopes(tz)]),
        ])
    }
}

#[inline]
fn contract(corners: &Corners<'_>, [wx, wy, wz]: &[Weights; 3]) -> Vec3 {
    let (mut x, mut y, mut z) = ([[0.0; 4]; 2], [[0.0; 4]; 2], [[0.0; 4]; 2]);
    let [near, far] = corners;
    for ((near, far), [w0, w1]) in near.iter().zip(far).zip(wy) {
        let columns = near.iter().zip(far);
        let sums = x.iter_mut().zip(&mut y).zip(&mut z);
        for ((near, far), ((x, y), z)) in columns.zip(sums) {
            // In x: h_x takes one derivative of W more than h_y and h_z.
            let (mut plain, mut of_x) = ([0.0; 12], [0.0; 12]);
            for (node, [w0, w1]) in [near, far].into_iter().zip(wx) {
                let [r0, r1, r2] = node;
                add_scaled(&mut plain, r0, *w0);
                add_scaled(&mut plain, r1, *w1);
                add_scaled(&mut of_x, r1, *w0);
                add_scaled(&mut of_x, r2, *w1);
            }
            let ([p0, p1, p2], [x0, x1, _]) = (runs(&plain), runs(&of_x));
            add_scaled(x, &x0, *w0);
            add_scaled(x, &x1, *w1);
            add_scaled(y, &p1, *w0);
            add_scaled(y, &p2, *w1);
            add_scaled(z, &p0, *w0);
            add_scaled(z, &p1, *w1);
        }
    }
    let first = |rows: &[[f32; 4]; 2]| -> f32 {
        rows.iter().zip(wz).map(|([c0, c1, ..], [w0, w1])| c0 * w0 + c1 * w1).sum()
    };
    let second = |rows: &[[f32; 4]; 2]| -> f32 {
        rows.iter().zip(wz).map(|([_, c1, c2, _], [w0, w1])| c1 * w0 + c2 * w1).sum()
    };
    [first(&x), first(&y), second(&z)]
}

/// The rows of four along c, b = 0, 1, 2.
#[inline]
fn runs(row: &[f32; 12]) -> [[f32; 4]; 3] {
    let [a, b, c, d, e, f, g, h, i, j, k, l] = *row;
    [[a, b, c, d], [e, f, g, h], [i, j, k, l]]
}
