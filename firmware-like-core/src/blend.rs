//! Two methods in one table, and the way from one to the other without a jump.
//!
//! h(p) = h_a + w (h_b - h_a),   w = smoothstep(tri-linear interpolation of a flag of the grid points)
//!
//! The better method b has cells that it must not answer in. None of the four corners of such a cell's face carries the flag, so
//! w = 0 on the face from both sides, and h_a is continuous there. Elsewhere w itself is continuous, as any tri-linear function of
//! node values is. Cost: one method alone where w is 0 or 1, both between.

use crate::flags::{FOLD, INTERIOR, SMOOTH, SUPERCELL};
use crate::hermite::HermiteTable;
use crate::tricubic;
use crate::trilinear;
use crate::vec3::{self, Vec3};

/// Hybrid estimate of the reaction force: tri-cubic where the super-cell is complete, tri-linear at the rim.
///
/// Source: Peterlik 2010, section 7. Deviation: the paper switches at the face, where the force would jump.
#[inline]
pub fn hybrid(force: &[&[f32]; 3], flags: &[u8], side: usize, slot: usize, t: Vec3) -> Vec3 {
    let complete = flags.get(slot).is_some_and(|bits| bits & SUPERCELL != 0);
    let weight = if complete { share(flags, INTERIOR, side, slot, t) } else { 0.0 };
    let linear = || trilinear::interpolate(force, side, slot, t);
    let cubic = || tricubic::interpolate(force, side, slot, t);
    blend(weight, linear, cubic)
}

/// The gradient of the energy, and cubic Hermite interpolants of the force in cells that a fold runs through.
///
/// Conservative wherever no corner of the cell touches such a cell.
#[inline]
pub fn energy(table: &HermiteTable<'_>, flags: &[u8], side: usize, slot: usize, t: Vec3) -> Vec3 {
    let folded = flags.get(slot).is_some_and(|bits| bits & FOLD != 0);
    let weight = if folded { 0.0 } else { share(flags, SMOOTH, side, slot, t) };
    blend(weight, || table.force(side, slot, t), || table.energy_gradient(side, slot, t))
}

/// Slopes dh_i/dt_j of [`hybrid`] as rows i.
pub fn hybrid_slopes(force: &[&[f32]; 3], flags: &[u8], side: usize, slot: usize, t: Vec3) -> [Vec3; 3] {
    let complete = flags.get(slot).is_some_and(|bits| bits & SUPERCELL != 0);
    let flag = if complete { INTERIOR } else { NEVER };
    let linear = || (trilinear::interpolate(force, side, slot, t), trilinear::slopes(force, side, slot, t));
    let cubic = || (tricubic::interpolate(force, side, slot, t), tricubic::slopes(force, side, slot, t));
    blend_slopes(flags, flag, side, slot, t, linear, cubic)
}

/// Slopes of [`energy`], and W if it is the energy's gradient alone that answers.
pub fn energy_slopes(
    table: &HermiteTable<'_>,
    flags: &[u8],
    side: usize,
    slot: usize,
    t: Vec3,
) -> ([Vec3; 3], Option<f32>) {
    let folded = flags.get(slot).is_some_and(|bits| bits & FOLD != 0);
    let flag = if folded { NEVER } else { SMOOTH };
    let jet = table.energy_jet(side, slot, t);
    let cubic = || (table.force(side, slot, t), table.force_slope(side, slot, t));
    let slopes = blend_slopes(flags, flag, side, slot, t, cubic, || (jet.gradient, jet.hessian));
    let alone = share(flags, flag, side, slot, t) >= 1.0;
    (slopes, alone.then_some(jet.value))
}

/// A flag that no grid point carries.
const NEVER: u8 = 0;

/// dh_a/dt + w (dh_b/dt - dh_a/dt) + (h_b - h_a) (dw/dt)^T
fn blend_slopes(
    flags: &[u8],
    flag: u8,
    side: usize,
    slot: usize,
    t: Vec3,
    a: impl FnOnce() -> (Vec3, [Vec3; 3]),
    b: impl FnOnce() -> (Vec3, [Vec3; 3]),
) -> [Vec3; 3] {
    let weight = share(flags, flag, side, slot, t);
    if weight >= 1.0 {
        return b().1;
    }
    if weight <= 0.0 {
        return a().1;
    }
    let ((value_a, slopes_a), (value_b, slopes_b)) = (a(), b());
    let turn = share_slope(flags, flag, side, slot, t);
    let mut rows = slopes_a;
    let apart = vec3::sub(value_b, value_a);
    for ((row, other), apart) in rows.iter_mut().zip(slopes_b).zip(apart) {
        let towards = vec3::scale(vec3::sub(other, *row), weight);
        *row = vec3::add(vec3::add(*row, towards), vec3::scale(turn, apart));
    }
    rows
}

/// dw/dt of [`share`].
fn share_slope(flags: &[u8], flag: u8, side: usize, slot: usize, [tx, ty, tz]: Vec3) -> Vec3 {
    let raw = |t: Vec3| -> f32 {
        let corners = trilinear::corners(side, slot, t);
        corners.iter().filter(|corner| carries(flags, flag, corner.0)).map(|(_, weight)| weight).sum()
    };
    let w = raw([tx, ty, tz]).min(1.0);
    let rise = [
        raw([1.0, ty, tz]) - raw([0.0, ty, tz]),
        raw([tx, 1.0, tz]) - raw([tx, 0.0, tz]),
        raw([tx, ty, 1.0]) - raw([tx, ty, 0.0]),
    ];
    vec3::scale(rise, 6.0 * w * (1.0 - w))
}

fn carries(flags: &[u8], flag: u8, slot: usize) -> bool {
    flags.get(slot).is_some_and(|bits| bits & flag != 0)
}

#[inline]
fn blend(weight: f32, a: impl FnOnce() -> Vec3, b: impl FnOnce() -> Vec3) -> Vec3 {
    if weight >= 1.0 {
        b()
    } else if weight <= 0.0 {
        a()
    } else {
        let ([ax, ay, az], [bx, by, bz]) = (a(), b());
        [ax + weight * (bx - ax), ay + weight * (by - ay), az + weight * (bz - az)]
    }
}

/// Share of the better method, 0 to 1: all of it where all corners carry the flag.
#[inline]
pub fn share(flags: &[u8], flag: u8, side: usize, slot: usize, t: Vec3) -> f32 {
    // Exactly 1 inside: the rounded sum of eight weights would evaluate both methods for nothing.
    if corner_flags(flags, side, slot) & flag != 0 {
        return 1.0;
    }
    let corners = trilinear::corners(side, slot, t);
    let share: f32 =
        corners.iter().filter(|corner| carries(flags, flag, corner.0)).map(|(_, weight)| weight).sum();
    let share = share.min(1.0);
    share * share * (3.0 - 2.0 * share)
}

/// The flags that all eight corners of a cell have.
#[inline]
fn corner_flags(flags: &[u8], side: usize, slot: usize) -> u8 {
    let pair = |slot: usize| -> u8 {
        let pair = flags.get(slot..).and_then(|rest| rest.first_chunk::<2>());
        pair.map_or(0, |[low, high]| low & high)
    };
    let next = slot.wrapping_add(side.wrapping_mul(side));
    pair(slot) & pair(slot.wrapping_add(side)) & pair(next) & pair(next.wrapping_add(side))
}
