//! The quintic Hermite interpolant of the energy: the force is its exact gradient.
//!
//! W(t) = sum over corners and a, b, c of H_a(tx) H_b(ty) H_c(tz) W_abc,   h = dW/dp,   S = d2W/dp2
//!
//! The six 1-D quintics H take value, slope and curvature of one end each. Two cells agree on W and its first two derivatives on
//! their common face, because those depend on the face's four corners alone: h is C1, and S is continuous. A force that is a
//! gradient does no work on a closed path: it cannot pump energy into the hand, whatever its error.

use super::{Corners, HermiteTable};
use crate::vec3::{self, Vec3};

/// W, its gradient and its second derivatives, in cell units and newtons.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Jet {
    /// W.
    pub value: f32,
    /// dW/dt.
    pub gradient: Vec3,
    /// d2W/dt2, rows.
    pub hessian: [Vec3; 3],
}

/// The quintics or one of their derivatives at t: `[corner][a]`.
type Weights = [[f32; 3]; 2];

/// H_a(t) for both corners.
#[inline]
fn values(t: f32) -> Weights {
    // From the corner 1 of t; corner 0 is the mirror image of it. Factored, so that it is exact at t = 0 and 1.
    let half = |t: f32, s: f32| {
        let cube = t * t * t;
        [cube * (10.0 - t * (15.0 - 6.0 * t)), -cube * s * (4.0 - 3.0 * t), 0.5 * cube * s * s]
    };
    let s = 1.0 - t;
    let [v, d, c] = half(s, t);
    [[v, -d, c], half(t, s)]
}

/// dH_a/dt.
#[inline]
fn slopes(t: f32) -> Weights {
    let half = |t: f32, s: f32| {
        let square = t * t;
        [30.0 * square * s * s, square * (t * (28.0 - 15.0 * t) - 12.0), 0.5 * square * s * (3.0 - 5.0 * t)]
    };
    let s = 1.0 - t;
    let [v, d, c] = half(s, t);
    [[-v, d, -c], half(t, s)]
}

/// d2H_a/dt2.
fn curvatures(t: f32) -> Weights {
    let half = |t: f32, s: f32| {
        [60.0 * t * s * (1.0 - 2.0 * t), -12.0 * t * s * (2.0 - 5.0 * t), t * (3.0 - t * (12.0 - 10.0 * t))]
    };
    let s = 1.0 - t;
    let [v, d, c] = half(s, t);
    [[v, -d, c], half(t, s)]
}

impl HermiteTable<'_> {
    /// dW/dt in the cell whose low corner is `slot`, newtons: the reaction force. Zero past the end of the box.
    ///
    /// Cost: x is contracted in rows of 12 values (all b and c of a node), value and slope at once, then y and z in rows of 4.
    #[inline]
    pub fn energy_gradient(&self, side: usize, slot: usize, t: Vec3) -> Vec3 {
        self.corners(side, slot).map_or(vec3::ZERO, |corners| gradient(&corners, t))
    }

    /// W and its first two derivatives there; zero past the end of the box.
    pub fn energy_jet(&self, side: usize, slot: usize, t: Vec3) -> Jet {
        let nothing = Jet { value: 0.0, gradient: vec3::ZERO, hessian: [vec3::ZERO; 3] };
        self.corners(side, slot).map_or(nothing, |corners| jet(&corners, t))
    }
}

#[inline]
fn gradient(corners: &Corners<'_>, [tx, ty, tz]: Vec3) -> Vec3 {
    let (wx, wy, wz) = (values(tx), values(ty), values(tz));
    let (dx, dy, dz) = (slopes(tx), slopes(ty), slopes(tz));
    // Rows along c for each of the two corners in z: contracted with H in y and H' in x, H' in y and H in x, and H in both.
    let (mut along_x, mut along_y, mut plain) = ([[0.0; 4]; 2], [[0.0; 4]; 2], [[0.0; 4]; 2]);
    let [near, far] = corners;
    for (((near, far), wy), dy) in near.iter().zip(far).zip(&wy).zip(&dy) {
        let columns = near.iter().zip(far);
        let sums = along_x.iter_mut().zip(&mut along_y).zip(&mut plain);
        for ((near, far), ((along_x, along_y), plain)) in columns.zip(sums) {
            let (mut value, mut slope) = ([0.0; 12], [0.0; 12]);
            for (node, (w, d)) in [near, far].into_iter().zip(wx.iter().zip(&dx)) {
                for (row, (w, d)) in node.iter().zip(w.iter().zip(d)) {
                    add_scaled(&mut value, row, *w);
                    add_scaled(&mut slope, row, *d);
                }
            }
            let rows = value.as_chunks::<4>().0.iter().zip(slope.as_chunks::<4>().0);
            for ((value, slope), (wy, dy)) in rows.zip(wy.iter().zip(dy)) {
                add_scaled(along_x, slope, *wy);
                add_scaled(along_y, value, *dy);
                add_scaled(plain, value, *wy);
            }
        }
    }
    [contract(&along_x, &wz), contract(&along_y, &wz), contract(&plain, &dz)]
}

/// All of it, one corner and derivative after the other: for stiffness and energy, which no tick asks for.
fn jet(corners: &Corners<'_>, t: Vec3) -> Jet {
    let weights = t.map(|t| [values(t), slopes(t), curvatures(t)]);
    let [x, y, z] = &weights;
    let sum = |order: [usize; 3]| -> f32 {
        let [Some(wx), Some(wy), Some(wz)] = [x.get(order[0]), y.get(order[1]), z.get(order[2])] else {
            return 0.0;
        };
        let mut total = 0.0;
        for (plane, wx) in corners.iter().zip(wx) {
            for (column, wy) in plane.iter().zip(wy) {
                for (node, wz) in column.iter().zip(wz) {
                    for (row, wx) in node.iter().zip(wx) {
                        for (run, wy) in row.as_chunks::<4>().0.iter().zip(wy) {
                            let [a, b, c, _] = run;
                            let [wa, wb, wc] = wz;
                            total += wx * wy * (a * wa + b * wb + c * wc);
                        }
                    }
                }
            }
        }
        total
    };
    let (xy, xz, yz) = (sum([1, 1, 0]), sum([1, 0, 1]), sum([0, 1, 1]));
    Jet {
        value: sum([0, 0, 0]),
        gradient: [sum([1, 0, 0]), sum([0, 1, 0]), sum([0, 0, 1])],
        hessian: [[sum([2, 0, 0]), xy, xz], [xy, sum([0, 2, 0]), yz], [xz, yz, sum([0, 0, 2])]],
    }
}

#[inline]
pub(super) fn add_scaled<const N: usize>(sums: &mut [f32; N], row: &[f32; N], weight: f32) {
    for (sum, value) in sums.iter_mut().zip(row) {
        *sum += weight * value;
    }
}

/// Sum over the two corners in z and c.
#[inline]
fn contract([near, far]: &[[f32; 4]; 2], [low, high]: &Weights) -> f32 {
    let dot = |[a, b, c, _]: &[f32; 4], [wa, wb, wc]: &[f32; 3]| a * wa + b * wb + c * wc;
    dot(near, low) + dot(far, high)
}
