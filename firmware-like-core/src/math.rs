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

/// Largest integer not above `x`; saturating, and 0 for NaN.
///
/// By truncation: at the x86-64 baseline `f32::floor` is a call, and the result is wanted as an integer anyway.
#[inline]
pub fn floor_to_i32(x: f32) -> i32 {
    let truncated = x as i32;
    if (truncated as f32) > x { truncated.saturating_sub(1) } else { truncated }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn floor_agrees_with_std() {
        for x in [-3.0, -2.5, -0.0, 0.0, 0.49, 0.999_999_94, 1.0, 7.5, -1e-40, 1e-40, 1e9, -1e9_f32] {
            assert_eq!(floor_to_i32(x), x.floor() as i32, "{x}");
        }
        assert_eq!(floor_to_i32(f32::NAN), 0);
        assert_eq!(floor_to_i32(f32::INFINITY), i32::MAX);
        assert_eq!(floor_to_i32(f32::NEG_INFINITY), i32::MIN);
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
