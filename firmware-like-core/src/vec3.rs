//! Three-component vectors as plain arrays: no type of our own crosses the API.

use crate::math;

/// x, y, z. Units and frame are in the name of whatever holds it.
pub type Vec3 = [f32; 3];

/// The null vector.
pub const ZERO: Vec3 = [0.0; 3];

/// a + b
#[inline]
pub fn add([ax, ay, az]: Vec3, [bx, by, bz]: Vec3) -> Vec3 {
    [ax + bx, ay + by, az + bz]
}

/// a - b
#[inline]
pub fn sub([ax, ay, az]: Vec3, [bx, by, bz]: Vec3) -> Vec3 {
    [ax - bx, ay - by, az - bz]
}

/// s a
#[inline]
pub fn scale([x, y, z]: Vec3, s: f32) -> Vec3 {
    [x * s, y * s, z * s]
}

/// -a
#[inline]
pub fn neg([x, y, z]: Vec3) -> Vec3 {
    [-x, -y, -z]
}

/// Scalar product a . b
#[inline]
pub fn dot([ax, ay, az]: Vec3, [bx, by, bz]: Vec3) -> f32 {
    ax * bx + ay * by + az * bz
}

/// Vector product a x b
#[inline]
pub fn cross([ax, ay, az]: Vec3, [bx, by, bz]: Vec3) -> Vec3 {
    [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx]
}

/// Columns to rows.
#[inline]
pub fn transposed([[ax, ay, az], [bx, by, bz], [cx, cy, cz]]: [Vec3; 3]) -> [Vec3; 3] {
    [[ax, bx, cx], [ay, by, cy], [az, bz, cz]]
}

/// M a, M given by its rows.
#[inline]
pub fn transform([x, y, z]: &[Vec3; 3], a: Vec3) -> Vec3 {
    [dot(*x, a), dot(*y, a), dot(*z, a)]
}

/// |a|^2; overflows to infinity beyond about 1e19.
#[inline]
pub fn norm_squared(a: Vec3) -> f32 {
    dot(a, a)
}

/// Length |a|, right for every finite vector whose length is an f32: neither 1e30 nor 1e-30 over- or underflows.
#[inline]
pub fn norm(a: Vec3) -> f32 {
    let squared = norm_squared(a);
    // Squares of normal numbers in this range keep all their digits; outside it scale by the largest component.
    if (1e-30..=1e30).contains(&squared) {
        return math::sqrt(squared);
    }
    let largest = max_abs(a);
    if largest > 0.0 && largest < f32::INFINITY {
        largest * math::sqrt(norm_squared(a.map(|x| x / largest)))
    } else {
        largest
    }
}

/// a / |a|, or zero where a has no direction (null or not finite).
#[inline]
pub fn normalize_or_zero(a: Vec3) -> Vec3 {
    let largest = max_abs(a);
    if largest == 0.0 || !is_finite(a) {
        return ZERO;
    }
    let scaled = a.map(|x| x / largest);
    let length = math::sqrt(norm_squared(scaled));
    scaled.map(|x| x / length)
}

/// Largest |component|; NaN components are passed over.
#[inline]
pub fn max_abs(a: Vec3) -> f32 {
    let [x, y, z] = a;
    x.abs().max(y.abs()).max(z.abs())
}

/// Whether all three components are finite.
#[inline]
pub fn is_finite([x, y, z]: Vec3) -> bool {
    x.is_finite() & y.is_finite() & z.is_finite()
}

/// |a - b|
#[inline]
pub fn distance(a: Vec3, b: Vec3) -> f32 {
    norm(sub(a, b))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn norm_neither_overflows_nor_underflows() {
        assert_eq!(norm([3.0, 4.0, 0.0]), 5.0);
        assert!((norm([3e30, 4e30, 0.0]) / 5e30 - 1.0).abs() < 1e-6);
        assert!((norm([3e-30, 4e-30, 0.0]) / 5e-30 - 1.0).abs() < 1e-6);
        assert_eq!(norm(ZERO), 0.0);
    }

    #[test]
    fn cross_is_right_handed() {
        assert_eq!(cross([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]), [0.0, 0.0, 1.0]);
    }

    #[test]
    fn a_direction_is_found_at_every_scale() {
        for size in [1e-40, 1e-20, 1.0, 1e20, 3e38_f32] {
            assert!((norm(normalize_or_zero([size, -size, size])) - 1.0).abs() < 1e-6, "{size}");
        }
        for bad in [0.0, f32::NAN, f32::INFINITY] {
            assert_eq!(normalize_or_zero([bad, 0.0, 0.0]), ZERO);
        }
    }
}
