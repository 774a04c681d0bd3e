//! Cubic Hermite interpolants of the three force components: C1, but no gradient.
//!
//! h_i(t) = sum over corners and a, b, c in 0..=1 of H_a(tx) H_b(ty) H_c(tz) d^(a+b+c) h_i / dx^a dy^b dz^c
//!
//! The derivatives of h_i are derivatives of W, so the table is the energy's. Where a fold or a failed solve makes W useless this is
//! the calmer of the two: it takes no derivative of W beyond the fourth, and errs by h^4 in h, not by a slope of W across a jump.

use core::ops::{Add, Mul};

use super::{Corners, HermiteTable, Node};
use crate::grid::Strides;
use crate::lanes::{Baseline, F32x4, Machine, sums};
use crate::vec3::{self, Vec3};

/// The cubics at t: `[corner][value or slope]`.
type Weights = [[f32; 2]; 2];

#[inline(always)]
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
    #[inline(always)]
    pub fn force<M: Machine>(&self, machine: M, strides: Strides, slot: usize, [tx, ty, tz]: Vec3) -> Vec3 {
        let Some(corners) = self.corners(strides, slot) else { return vec3::ZERO };
        contract(machine, &corners, &[values(tx), values(ty), values(tz)])
    }

    /// dh_i/dt_j as rows i; zero past the end of the box.
    pub fn force_slope(&self, strides: Strides, slot: usize, [tx, ty, tz]: Vec3) -> [Vec3; 3] {
        let Some(corners) = self.corners(strides, slot) else { return [vec3::ZERO; 3] };
        let [wx, wy, wz] = [values(tx), values(ty), values(tz)];
        vec3::transposed([
            contract(Baseline, &corners, &[slopes(tx), wy, wz]),
            contract(Baseline, &corners, &[wx, slopes(ty), wz]),
            contract(Baseline, &corners, &[wx, wy, slopes(tz)]),
        ])
    }
}

#[inline(always)]
fn contract<M: Machine>(machine: M, corners: &Corners<'_>, [wx, wy, wz]: &[Weights; 3]) -> Vec3 {
    let (wx, wy) = (spread(machine, wx), spread(machine, wy));
    // Corners as [x][y][z]; those along z side by side.
    let [[n0, n1], [f0, f1]] = corners;
    let (near, far) = (contract_x(machine, n0, f0, &wx), contract_x(machine, n1, f1, &wx));
    let ([a, b, c], [d, e, f]) = (near.plain, far.plain);
    let (x, y, z) = (sum(&wy, near.of_x, far.of_x), sum(&wy, [b, c], [e, f]), sum(&wy, [a, b], [d, e]));
    let [[n0, n1], [f0, f1]] = *wz;
    let first = [F32x4::new([n0, n1, 0.0, 0.0]), F32x4::new([f0, f1, 0.0, 0.0])];
    let second = [F32x4::new([0.0, n0, n1, 0.0]), F32x4::new([0.0, f0, f1, 0.0])];
    sums(contract_z(machine, x, first), contract_z(machine, y, first), contract_z(machine, z, second))
}

/// Weights of one axis in all lanes.
#[inline(always)]
fn spread<M: Machine>(machine: M, [[n0, n1], [f0, f1]]: &Weights) -> [[M::F32x8; 2]; 2] {
    [[machine.splat(*n0), machine.splat(*n1)], [machine.splat(*f0), machine.splat(*f1)]]
}

/// Rows along c of both corners in z: those of h_x for b = 0, 1, and those of h_y and h_z for b = 0, 1, 2.
struct Rows<V> {
    of_x: [V; 2],
    plain: [V; 3],
}

#[inline(always)]
fn contract_x<M: Machine>(
    machine: M,
    near: &[&Node; 2],
    far: &[&Node; 2],
    wx: &[[M::F32x8; 2]; 2],
) -> Rows<M::F32x8> {
    let ([n0, n1, n2], [f0, f1, f2]) = (rows(machine, near), rows(machine, far));
    let ([n00, n01, n02], [n10, n11, n12], [n20, n21, _]) = (n0, n1, n2);
    let ([f00, f01, f02], [f10, f11, f12], [f20, f21, _]) = (f0, f1, f2);
    // h_x takes one derivative more in x than h_y and h_z.
    Rows {
        of_x: [sum(wx, [n10, n20], [f10, f20]), sum(wx, [n11, n21], [f11, f21])],
        plain: [
            sum(wx, [n00, n10], [f00, f10]),
            sum(wx, [n01, n11], [f01, f11]),
            sum(wx, [n02, n12], [f02, f12]),
        ],
    }
}

/// Two nodes side by side as `[a][b]`.
#[inline(always)]
fn rows<M: Machine>(machine: M, [low, high]: &[&Node; 2]) -> [[M::F32x8; 3]; 3] {
    let ([l0, l1, l2], [h0, h1, h2]) = (low, high);
    [row(machine, l0, h0), row(machine, l1, h1), row(machine, l2, h2)]
}

#[inline(always)]
fn row<M: Machine>(machine: M, [l0, l1, l2]: &[[f32; 4]; 3], [h0, h1, h2]: &[[f32; 4]; 3]) -> [M::F32x8; 3] {
    [machine.rows(l0, h0), machine.rows(l1, h1), machine.rows(l2, h2)]
}

#[inline(always)]
fn sum<V>([[n0, n1], [f0, f1]]: &[[V; 2]; 2], [a, b]: [V; 2], [c, d]: [V; 2]) -> V
where
    V: Copy + Add<Output = V> + Mul<Output = V>,
{
    (*n0 * a + *n1 * b) + (*f0 * c + *f1 * d)
}

#[inline(always)]
fn contract_z<M: Machine>(machine: M, rows: M::F32x8, [of_low, of_high]: [F32x4; 2]) -> F32x4 {
    let [low, high] = machine.halves(rows);
    F32x4::new(low) * of_low + F32x4::new(high) * of_high
}
