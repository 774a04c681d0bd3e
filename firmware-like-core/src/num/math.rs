//! Square roots of single numbers; those of several lanes are in [`super::lanes`].
//!
//! `core` has no float functions. The feature `std` selects the hardware square root, otherwise `libm`
//! computes it. Both are correctly rounded, so their bits are equal; a test asserts it.

/// Square root, correctly rounded.
#[inline]
pub(crate) fn sqrt(x: f32) -> f32 {
    #[cfg(feature = "std")]
    return x.sqrt();
    #[cfg(not(feature = "std"))]
    libm::sqrtf(x)
}

/// Square root in f64, correctly rounded.
#[inline]
pub(crate) fn sqrt_f64(x: f64) -> f64 {
    #[cfg(feature = "std")]
    return x.sqrt();
    #[cfg(not(feature = "std"))]
    libm::sqrt(x)
}

/// 1.5 * 2^23: its sum with x, |x| < 2^22, is x rounded to the nearest integer, which then stands in the low
/// bits.
///
/// `core` has no floor, and `f32::floor` is a function call on baseline x86-64.
pub(crate) const ROUNDING_SHIFT: f32 = 12_582_912.0;

#[cfg(test)]
mod tests {
    /// The no_std and the std build must compute the same force, bit for bit.
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
