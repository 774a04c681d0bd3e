//! Vectors of three components as plain arrays, so that the API needs no vector type of its own.

use super::math;

/// x, y, z. Unit and frame are in the name of the variable or field that holds it.
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

/// The transpose of a matrix.
#[inline]
pub(crate) fn transposed([[ax, ay, az], [bx, by, bz], [cx, cy, cz]]: [Vec3; 3]) -> [Vec3; 3] {
    [[ax, bx, cx], [ay, by, cy], [az, bz, cz]]
}

/// The product M a; M is given by its rows.
#[inline]
pub(crate) fn transform([x, y, z]: &[Vec3; 3], a: Vec3) -> Vec3 {
    [dot(*x, a), dot(*y, a), dot(*z, a)]
}

/// |a|^2; infinite where |a| exceeds about 1e19.
#[inline]
pub(crate) fn norm_squared(a: Vec3) -> f32 {
    dot(a, a)
}

/// Length |a|. Intermediate results do not overflow or underflow: components of 1e30 or 1e-30 are measured
/// correctly.
#[inline]
pub fn norm(a: Vec3) -> f32 {
    let squared = norm_squared(a);
    // In this range the squares keep all digits; outside it the largest component is factored out.
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

/// The unit vector a / |a|; zero where a has no direction, because it is null or not finite.
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

/// Largest absolute component; NaN components are ignored.
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

/// Distance |a - b|
#[inline]
pub fn distance(a: Vec3, b: Vec3) -> f32 {
    norm(sub(a, b))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_norm_neither_overflows_nor_underflows() {
        assert_eq!(norm([3.0, 4.0, 0.0]), 5.0);
        assert!((norm([3e30, 4e30, 0.0]) / 5e30 - 1.0).abs() < 1e-6);
        assert!((norm([3e-30, 4e-30, 0.0]) / 5e-30 - 1.0).abs() < 1e-6);
        assert_eq!(norm(ZERO), 0.0);
    }

    #[test]
    fn the_vector_product_is_right_handed() {
        assert_eq!(cross([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]), [0.0, 0.0, 1.0]);
    }

    #[test]
    fn vectors_of_every_size_are_normalized() {
        for size in [1e-40, 1e-20, 1.0, 1e20, 3e38_f32] {
            assert!((norm(normalize_or_zero([size, -size, size])) - 1.0).abs() < 1e-6, "{size}");
        }
        for bad in [0.0, f32::NAN, f32::INFINITY] {
            assert_eq!(normalize_or_zero([bad, 0.0, 0.0]), ZERO);
        }
    }
}
