//! Two methods in one table, and the way from one to the other without a jump.
//!
//! h(p) = h_a + w (h_b - h_a),   w = smoothstep(tri-linear interpolation of a flag of the grid points)
//!
//! The better method b has cells that it must not answer in. None of the four corners of such a cell's face carries the flag, so
//! w = 0 on the face from both sides, and h_a is continuous there. Elsewhere w itself is continuous, as any tri-linear function of
//! node values is. Cost: one method alone where w is 0 or 1, both between.

use crate::flags::{INTERIOR, SMOOTH};
use crate::grid::Strides;
use crate::hermite::HermiteTable;
use crate::lanes::{Baseline, Machine};
use crate::tricubic;
use crate::trilinear;
use crate::vec3::{self, Vec3};

/// Hybrid estimate of the reaction force: tri-cubic where the super-cell is complete, tri-linear at the rim.
///
/// Source: Peterlik 2010, section 7. Deviation: the paper switches at the face, where the force would jump.
#[inline(always)]
pub fn hybrid(force: &[Vec3], flags: &[u8], strides: Strides, slot: usize, t: Vec3) -> Vec3 {
    let weight = share(flags, INTERIOR, strides, slot, t);
    let linear = if weight < 1.0 { trilinear::interpolate(force, strides, slot, t) } else { vec3::ZERO };
    if weight <= 0.0 {
        return linear;
    }
    blend(weight, linear, tricubic::interpolate(force, strides, slot, t))
}

/// The gradient of the energy, and cubic Hermite interpolants of the force in cells that a fold runs through.
///
/// Conservative wherever no corner of the cell touches such a cell.
#[inline(always)]
pub fn energy<M: Machine>(
    machine: M,
    table: &HermiteTable<'_>,
    flags: &[u8],
    strides: Strides,
    slot: usize,
    t: Vec3,
) -> Vec3 {
    let weight = share(flags, SMOOTH, strides, slot, t);
    let calm = if weight < 1.0 { table.force(machine, strides, slot, t) } else { vec3::ZERO };
    if weight <= 0.0 {
        return calm;
    }
    blend(weight, calm, table.energy_gradient(machine, strides, slot, t))
}

/// Slopes dh_i/dt_j of [`hybrid`] as rows i.
pub fn hybrid_slopes(force: &[Vec3], flags: &[u8], strides: Strides, slot: usize, t: Vec3) -> [Vec3; 3] {
    let linear =
        || (trilinear::interpolate(force, strides, slot, t), trilinear::slopes(force, strides, slot, t));
    let cubic =
        || (tricubic::interpolate(force, strides, slot, t), tricubic::slopes(force, strides, slot, t));
    blend_slopes(flags, INTERIOR, strides, slot, t, linear, cubic)
}

/// Slopes of [`energy`], and W if it is the energy's gradient alone that answers.
pub fn energy_slopes(
    table: &HermiteTable<'_>,
    flags: &[u8],
    strides: Strides,
    slot: usize,
    t: Vec3,
) -> ([Vec3; 3], Option<f32>) {
    let jet = table.energy_jet(strides, slot, t);
    let cubic = || (table.force(Baseline, strides, slot, t), table.force_slope(strides, slot, t));
    let slopes = blend_slopes(flags, SMOOTH, strides, slot, t, cubic, || (jet.gradient, jet.hessian));
    let alone = share(flags, SMOOTH, strides, slot, t) >= 1.0;
    (slopes, alone.then_some(jet.value))
}

/// [`energy_slopes`] without the turn of the shares, which jumps at faces: continuous.
pub fn energy_steady_slopes(
    table: &HermiteTable<'_>,
    flags: &[u8],
    strides: Strides,
    slot: usize,
    t: Vec3,
) -> [Vec3; 3] {
    let weight = share(flags, SMOOTH, strides, slot, t);
    mix(weight, table.force_slope(strides, slot, t), table.energy_jet(strides, slot, t).hessian)
}

/// a + w (b - a), row by row.
fn mix(weight: f32, a: [Vec3; 3], b: [Vec3; 3]) -> [Vec3; 3] {
    let mut rows = a;
    for (row, other) in rows.iter_mut().zip(b) {
        *row = blend(weight, *row, other);
    }
    rows
}

/// dh_a/dt + w (dh_b/dt - dh_a/dt) + (h_b - h_a) (dw/dt)^T
fn blend_slopes(
    flags: &[u8],
    flag: u8,
    strides: Strides,
    slot: usize,
    t: Vec3,
    a: impl FnOnce() -> (Vec3, [Vec3; 3]),
    b: impl FnOnce() -> (Vec3, [Vec3; 3]),
) -> [Vec3; 3] {
    let weight = share(flags, flag, strides, slot, t);
    if weight >= 1.0 {
        return b().1;
    }
    if weight <= 0.0 {
        return a().1;
    }
    let ((value_a, slopes_a), (value_b, slopes_b)) = (a(), b());
    let turn = share_slope(flags, flag, strides, slot, t);
    let mut rows = mix(weight, slopes_a, slopes_b);
    for (row, apart) in rows.iter_mut().zip(vec3::sub(value_b, value_a)) {
        *row = vec3::add(*row, vec3::scale(turn, apart));
    }
    rows
}

/// dw/dt of [`share`].
fn share_slope(flags: &[u8], flag: u8, strides: Strides, slot: usize, [tx, ty, tz]: Vec3) -> Vec3 {
    let raw = |t: Vec3| -> f32 {
        let corners = trilinear::corners(strides, slot, t);
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

/// a + weight (b - a): b itself, bit for bit, if weight is 1 and a is zero.
#[inline(always)]
fn blend(weight: f32, a: Vec3, b: Vec3) -> Vec3 {
    vec3::add(a, vec3::scale(vec3::sub(b, a), weight))
}

/// Share of the better method, 0 to 1: all of it where all corners carry the flag, nothing where none does, as in the cells
/// that it must not answer in.
#[inline(always)]
pub fn share(flags: &[u8], flag: u8, strides: Strides, slot: usize, t: Vec3) -> f32 {
    let Some(pairs) = corner_flags(flags, strides, slot) else { return 0.0 };
    let [a, b, c, d] = pairs.map(u16::from_le_bytes);
    let both = u16::from_le_bytes([flag; 2]);
    // Exactly 1 inside: the rounded sum of eight weights would evaluate both methods for nothing.
    if a & b & c & d & both == both {
        return 1.0;
    }
    if (a | b | c | d) & both == 0 {
        return 0.0;
    }
    partial_share(pairs, flag, t)
}

#[inline(never)]
fn partial_share(pairs: [[u8; 2]; 4], flag: u8, t: Vec3) -> f32 {
    let weights = trilinear::corner_weights(t);
    let carried = pairs.as_flattened().iter().zip(weights).filter(|(bits, _)| *bits & flag != 0);
    let share: f32 = carried.map(|(_, weight)| weight).sum();
    let share = share.min(1.0);
    share * share * (3.0 - 2.0 * share)
}

/// The flags of the eight corners of a cell, in pairs along z.
#[inline(always)]
fn corner_flags(flags: &[u8], strides: Strides, slot: usize) -> Option<[[u8; 2]; 4]> {
    let (side, sheet) = (strides.side as usize, strides.sheet as usize);
    // One check for all four: the compiler sees that the others follow.
    let flags = flags.get(slot..)?.get(..sheet.wrapping_add(side).wrapping_add(2))?;
    Some([
        *flags.first_chunk()?,
        *flags.get(side..)?.first_chunk()?,
        *flags.get(sheet..)?.first_chunk()?,
        *flags.get(sheet.wrapping_add(side)..)?.first_chunk()?,
    ])
}
