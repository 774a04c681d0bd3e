//! Square root and floor, the only two functions the core needs beyond arithmetic.
//!
//! `core` has no float functions. With the feature `std` the hardware square root is used, which also vectorises in
//! the RBF lane loops; without it `libm`'s. Both are correctly rounded, so the bits are the same: a test asserts it.

/// Square root, correctly rounded.
#[inline]
pub fn sqrt(x: f32) -> f32 {
    #[cfg(feature = "std")]
    return x.sqrt();
    #[cfg(not(feature = "std"))]
    libm::sqrtf(x)
}

/// Square root in f64, correctly rounded.
#[inline]
pub fn sqrt_f64(x: f64) -> f64 {
    #[cfg(feature = "std")]
    return x.sqrt();
    #[cfg(not(feature = "std"))]
    libm::sqrt(x)
}

/// Largest integer not above `x`, for |x| < 2^22. Beyond that, and for NaN, some integer.
///
/// Adding 1.5 * 2^23 rounds to the nearest integer and leaves it in the low bits of the sum. A cast saturates and looks for
/// NaN, which the caller has excluded already, and `f32::floor` is a call at the x86-64 baseline.
#[inline]
pub fn floor_small(x: f32) -> i32 {
    const SHIFT: f32 = 12_582_912.0;
    let shifted = x + SHIFT;
    let nearest = (shifted.to_bits() as i32).wrapping_sub(SHIFT.to_bits() as i32);
    nearest.wrapping_sub(i32::from(shifted - SHIFT > x))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn floor_agrees_with_std() {
        for x in [
            -3.0,
            -2.5,
            -0.5,
            -0.0,
            0.0,
            0.49,
            0.5,
            1.5,
            0.999_999_94,
            1.0,
            7.5,
            -1e-40,
            1e-40,
            4e6,
            -4e6_f32,
        ] {
            assert_eq!(floor_small(x), x.floor() as i32, "{x}");
        }
        for step in -100_000..100_000 {
            let x = step as f32 * 1.27e-3;
            assert_eq!(floor_small(x), x.floor() as i32, "{x}");
        }
    }

    /// The no_std and the std build must give the same force, bit for bit.
    #[test]
    fn libm_and_hardware_roots_have_the_same_bits() {
        let mut bits = 1_u32;
        for _ in 0..200_000 {
            bits = bits.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let x = f32::from_bits(bits & 0x7fff_ffff);
            if x.is_finite() {
                assert_eq!(libm::sqrtf(x).to_bits(), x.sqrt().to_bits());
                let wide = f64::from(x) * 1.000_000_123;
                assert_eq!(libm::sqrt(wide).to_bits(), wide.sqrt().to_bits());
            }
        }
    }
}
