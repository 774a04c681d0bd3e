//! Square root, the only function the core needs beyond arithmetic; that of several lanes is in [`crate::lanes`].
//!
//! `core` has no float functions. With the feature `std` the hardware square root is used, without it `libm`'s. Both are correctly
//! rounded, so the bits are the same: a test asserts it.

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

/// 1.5 * 2^23: adding it to x, |x| < 2^22, rounds to the nearest integer and leaves that in the low bits of the sum.
///
/// `core` has no floor, and `f32::floor` is a call at the x86-64 baseline.
pub(crate) const ROUNDING_SHIFT: f32 = 12_582_912.0;

#[cfg(test)]
mod tests {

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
