//! The eight corners of a cell: their order and their tri-linear weights.

use crate::num::vec3::Vec3;

/// The corners of a cell as offsets from its low corner, in the order used everywhere: z fastest, as slots
/// are.
pub const CORNERS: [[i32; 3]; 8] =
    [[0, 0, 0], [0, 0, 1], [0, 1, 0], [0, 1, 1], [1, 0, 0], [1, 0, 1], [1, 1, 0], [1, 1, 1]];

/// Distance in slots from a lattice point to its neighbours along x and y; along z it is 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Strides {
    /// Along x.
    pub(crate) sheet: u32,
    /// Along y.
    pub(crate) side: u32,
}

/// Tri-linear weights of the corners at the position t in the cell, in the order of [`CORNERS`].
#[inline(always)]
pub(crate) fn corner_weights([tx, ty, tz]: Vec3) -> [f32; 8] {
    let (sx, sy, sz) = (1.0 - tx, 1.0 - ty, 1.0 - tz);
    [
        sx * sy * sz,
        sx * sy * tz,
        sx * ty * sz,
        sx * ty * tz,
        tx * sy * sz,
        tx * sy * tz,
        tx * ty * sz,
        tx * ty * tz,
    ]
}
