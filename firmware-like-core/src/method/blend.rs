//! Two methods in one table, blended without a jump.
//!
//! h(p) = h_a + w (h_b - h_a),   w = smoothstep of the tri-linear interpolation of a flag ([`Ball::smooth`])
//!
//! Method b must not be used in some cells. No corner of such a cell has the flag, so w = 0 on its faces from
//! both sides, and h is continuous there; elsewhere w is continuous, as any tri-linear function of nodal
//! values is. Where w is 0 or 1, only one method is evaluated.

use crate::grid::Location;
use crate::grid::flags::Ball;
use crate::num::vec3::{self, Vec3};

/// a + w (b - a): b itself, bit for bit, if w is 1 and a is zero.
#[inline(always)]
pub(super) fn blend(weight: f32, a: Vec3, b: Vec3) -> Vec3 {
    vec3::add(a, vec3::scale(vec3::sub(b, a), weight))
}

/// [`blend`] of each row.
pub(super) fn blend_rows(weight: f32, a: [Vec3; 3], b: [Vec3; 3]) -> [Vec3; 3] {
    let mut rows = a;
    for (row, other) in rows.iter_mut().zip(b) {
        *row = blend(weight, *row, other);
    }
    rows
}

/// dh_a/dt + w (dh_b/dt - dh_a/dt) + (h_b - h_a) (dw/dt)^T, from value and slopes of a and of b.
pub(super) fn blend_slopes(
    ball: Ball<'_>,
    flag: u8,
    at: &Location,
    a: impl FnOnce() -> (Vec3, [Vec3; 3]),
    b: impl FnOnce() -> (Vec3, [Vec3; 3]),
) -> [Vec3; 3] {
    let weight = ball.smooth(flag, at);
    if weight >= 1.0 {
        return b().1;
    }
    if weight <= 0.0 {
        return a().1;
    }
    let ((value_a, slopes_a), (value_b, slopes_b)) = (a(), b());
    let weight_slope = ball.smooth_slope(flag, at);
    let mut rows = blend_rows(weight, slopes_a, slopes_b);
    for (row, difference) in rows.iter_mut().zip(vec3::sub(value_b, value_a)) {
        *row = vec3::add(*row, vec3::scale(weight_slope, difference));
    }
    rows
}
