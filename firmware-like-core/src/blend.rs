//! The hybrid of section 7 of the paper: tri-cubic where the super-cell is complete, tri-linear elsewhere.

use crate::flags::{INTERIOR, SUPERCELL};
use crate::tricubic;
use crate::trilinear;
use crate::vec3::Vec3;

/// Hybrid estimate of the reaction force: tri-cubic deep inside, tri-linear at the rim, continuous between them.
///
/// h(p) = h_linear + w (h_cubic - h_linear),   w = smoothstep(tri-linear interpolation of the INTERIOR flags)
///
/// Why it is continuous: on a face shared with a cell whose super-cell is incomplete none of the four corners is
/// INTERIOR, so w = 0 there and both sides give the tri-linear force, which the face's four corners alone determine.
/// Between two complete cells w itself is continuous, as any tri-linear function of node values is.
/// Cost: one method alone where w is 0 or 1, both between.
/// Source: Peterlik 2010, section 7. Deviation: the paper switches at the face, where the force would jump.
#[inline]
pub fn interpolate(force: &[&[f32]; 3], flags: &[u8], side: usize, slot: usize, t: Vec3) -> Vec3 {
    let complete = flags.get(slot).is_some_and(|bits| bits & SUPERCELL != 0);
    let weight = if complete { cubic_weight(flags, side, slot, t) } else { 0.0 };
    if weight <= 0.0 {
        trilinear::interpolate(force, side, slot, t)
    } else if weight >= 1.0 {
        tricubic::interpolate(force, side, slot, t)
    } else {
        let [lx, ly, lz] = trilinear::interpolate(force, side, slot, t);
        let [cx, cy, cz] = tricubic::interpolate(force, side, slot, t);
        [lx + weight * (cx - lx), ly + weight * (cy - ly), lz + weight * (cz - lz)]
    }
}

/// Share of the tri-cubic force, 0 to 1.
fn cubic_weight(flags: &[u8], side: usize, slot: usize, t: Vec3) -> f32 {
    let corners = trilinear::corners(side, slot, t);
    let interior = |&(slot, _): &(usize, f32)| flags.get(slot).is_some_and(|bits| bits & INTERIOR != 0);
    // Exactly 1 inside: the rounded sum of eight weights would evaluate both methods for nothing.
    if corners.iter().all(interior) {
        return 1.0;
    }
    let share: f32 = corners.iter().filter(|corner| interior(corner)).map(|(_, weight)| weight).sum();
    let share = share.min(1.0);
    share * share * (3.0 - 2.0 * share)
}
