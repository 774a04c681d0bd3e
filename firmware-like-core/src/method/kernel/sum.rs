//! Sums over the configurations: the gradient with four side by side, and all derivatives up to the second in
//! sequence.

use super::{Block, LANES};
use crate::num::exponential::exp_of_minus;
use crate::num::lanes::{Baseline, Machine};

/// sum_n E_n (grad P_n - r P_n), N, at x in lengths.
///
/// With the derivatives c, A, T of P at its configuration let P_1 = c, P_2 = A r and P_3 = T r r / 2. Then
/// grad P = P_1 + P_2 + P_3. Euler's theorem, applied to each homogeneous part, gives
/// P = P(0) + r . (P_1 + P_2 / 2 + P_3 / 3).
#[inline(always)]
pub(super) fn gradient<M: Machine>(machine: M, blocks: &[Block], at: [f64; 3]) -> [f64; 3] {
    let (gradient, _) = gradient_and_value(machine, blocks, at);
    gradient
}

/// [`gradient`] and sum_n E_n P_n, N.
#[inline(always)]
pub(super) fn gradient_and_value<M: Machine>(
    machine: M,
    blocks: &[Block],
    [x, y, z]: [f64; 3],
) -> ([f64; 3], f64) {
    let (x, y, z) = (machine.splat_f64(x), machine.splat_f64(y), machine.splat_f64(z));
    let (half, third) = (machine.splat_f64(0.5), machine.splat_f64(1.0 / 3.0));
    let [mut sum_x, mut sum_y, mut sum_z, mut sum] = [machine.splat_f64(0.0); 4];
    for block in blocks {
        let [cx, cy, cz, p, px, py, pz, pxx, pxy, pxz, pyy, pyz, pzz, third_of @ ..] = block;
        let [pxxx, pxxy, pxxz, pxyy, pxyz, pxzz, pyyy, pyyz, pyzz, pzzz] = third_of;
        let (rx, ry, rz) = (x - machine.load_f64(cx), y - machine.load_f64(cy), z - machine.load_f64(cz));
        let (xx, yy, zz) = (half * rx * rx, half * ry * ry, half * rz * rz);
        let (xy, xz, yz) = (rx * ry, rx * rz, ry * rz);
        let (pxy, pxz, pyz) = (machine.load_f64(pxy), machine.load_f64(pxz), machine.load_f64(pyz));
        let second_x = machine.load_f64(pxx) * rx + (pxy * ry + pxz * rz);
        let second_y = pxy * rx + (machine.load_f64(pyy) * ry + pyz * rz);
        let second_z = pxz * rx + (pyz * ry + machine.load_f64(pzz) * rz);
        let (pxxy, pxxz, pxyy) = (machine.load_f64(pxxy), machine.load_f64(pxxz), machine.load_f64(pxyy));
        let (pxyz, pxzz) = (machine.load_f64(pxyz), machine.load_f64(pxzz));
        let (pyyz, pyzz) = (machine.load_f64(pyyz), machine.load_f64(pyzz));
        let third_x =
            (machine.load_f64(pxxx) * xx + pxyy * yy + pxzz * zz) + (pxxy * xy + pxxz * xz + pxyz * yz);
        let third_y =
            (pxxy * xx + machine.load_f64(pyyy) * yy + pyzz * zz) + (pxyy * xy + pxyz * xz + pyyz * yz);
        let third_z =
            (pxxz * xx + pyyz * yy + machine.load_f64(pzzz) * zz) + (pxyz * xy + pxzz * xz + pyzz * yz);
        let (px, py, pz) = (machine.load_f64(px), machine.load_f64(py), machine.load_f64(pz));
        let of_x = px + (half * second_x + third * third_x);
        let of_y = py + (half * second_y + third * third_y);
        let of_z = pz + (half * second_z + third * third_z);
        let value = machine.load_f64(p) + (rx * of_x + (ry * of_y + rz * of_z));
        let e = exp_of_minus(machine, xx + (yy + zz));
        sum = sum + e * value;
        sum_x = sum_x + e * ((px + (second_x + third_x)) - rx * value);
        sum_y = sum_y + e * ((py + (second_y + third_y)) - ry * value);
        sum_z = sum_z + e * ((pz + (second_z + third_z)) - rz * value);
    }
    ([lane_sum(machine, sum_x), lane_sum(machine, sum_y), lane_sum(machine, sum_z)], lane_sum(machine, sum))
}

/// The sum of the lanes as (0 + 2) + (1 + 3).
#[inline(always)]
fn lane_sum<M: Machine>(machine: M, lanes: M::F64x4) -> f64 {
    let [a, b, c, d] = machine.to_array_f64(lanes);
    (a + c) + (b + d)
}

/// sum_n E_n P_n, its gradient and its second derivatives, N, at x in lengths.
///
/// d2(E P) = E (A + T r - r (x) grad P - grad P (x) r + (r (x) r - I) P)
pub(super) fn derivatives(blocks: &[Block], at: [f64; 3]) -> (f64, [f64; 3], [[f64; 3]; 3]) {
    let (mut value, mut slope, mut curve) = (0.0, [0.0; 3], [[0.0; 3]; 3]);
    for block in blocks {
        for lane in 0..LANES {
            let one = block.map(|number| number.get(lane).copied().unwrap_or(0.0));
            let [cx, cy, cz, p, px, py, pz, xx, xy, xz, yy, yz, zz, third @ ..] = one;
            let [xxx, xxy, xxz, xyy, xyz, xzz, yyy, yyz, yzz, zzz] = third;
            let [x, y, z] = at;
            let r = [x - cx, y - cy, z - cz];
            let bend = [
                [dot([xxx, xxy, xxz], r), dot([xxy, xyy, xyz], r), dot([xxz, xyz, xzz], r)],
                [dot([xxy, xyy, xyz], r), dot([xyy, yyy, yyz], r), dot([xyz, yyz, yzz], r)],
                [dot([xxz, xyz, xzz], r), dot([xyz, yyz, yzz], r), dot([xzz, yzz, zzz], r)],
            ];
            let first = [px, py, pz];
            let second = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]].map(|row| dot(row, r));
            let third = bend.map(|row| 0.5 * dot(row, r));
            let parts = || first.into_iter().zip(second).zip(third);
            let mut grad = [0.0; 3];
            let mut polynomial = p;
            for ((grad, r), ((a, b), c)) in grad.iter_mut().zip(r).zip(parts()) {
                *grad = a + b + c;
                polynomial += r * (a + b / 2.0 + c / 3.0);
            }
            let q = Baseline.load_f64(&[0.5 * dot(r, r); LANES]);
            let [e, ..] = Baseline.to_array_f64(exp_of_minus(Baseline, q));
            value += e * polynomial;
            for ((slope, grad), r) in slope.iter_mut().zip(grad).zip(r) {
                *slope += e * (grad - r * polynomial);
            }
            let straight = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]];
            for (i, (curve, (straight, bend))) in
                curve.iter_mut().zip(straight.into_iter().zip(bend)).enumerate()
            {
                let (ri, gi) = (component(r, i), component(grad, i));
                for (j, (curve, (a, t))) in curve.iter_mut().zip(straight.into_iter().zip(bend)).enumerate() {
                    let (rj, gj) = (component(r, j), component(grad, j));
                    let unit = if i == j { 1.0 } else { 0.0 };
                    *curve += e * (a + t - ri * gj - gi * rj + (ri * rj - unit) * polynomial);
                }
            }
        }
    }
    (value, slope, curve)
}

fn dot([ax, ay, az]: [f64; 3], [bx, by, bz]: [f64; 3]) -> f64 {
    ax * bx + ay * by + az * bz
}

fn component(a: [f64; 3], axis: usize) -> f64 {
    a.get(axis).copied().unwrap_or(0.0)
}
