//! Deterministic sequences: low-discrepancy points (Roberts 2018) and pseudo-random numbers.

/// Point `n` of the low-discrepancy sequence R2 in the unit square, shifted by `shift` along both axes.
pub(crate) fn r2(n: u32, shift: f64) -> [f64; 2] {
    const STEP: [f64; 2] = [0.754_877_666_246_692_7, 0.569_840_290_998_053_2];
    STEP.map(|step| (shift + f64::from(n) * step).fract())
}

/// Point `n` of the low-discrepancy sequence R3 in the unit cube, shifted by `shift` along all axes.
pub(crate) fn r3(n: u32, shift: f64) -> [f64; 3] {
    const STEP: [f64; 3] = [0.819_172_513_396_164_4, 0.671_043_606_703_789_2, 0.549_700_477_901_902_5];
    STEP.map(|step| (shift + f64::from(n) * step).fract())
}

/// The unit vector at the height `z`, -1 to 1, and the azimuth with this sine and cosine.
pub(crate) fn on_sphere(z: f64, (sin, cos): (f64, f64)) -> [f64; 3] {
    let across = (1.0 - z * z).sqrt();
    [across * cos, across * sin, z]
}

/// Point `n` of an even distribution in the ball of this radius about the origin.
pub fn in_ball(n: u32, shift: f64, radius_m: f64) -> [f64; 3] {
    let [r, z, turn] = r3(n, shift);
    let azimuth = std::f64::consts::TAU * turn;
    on_sphere(2.0 * z - 1.0, (libm::sin(azimuth), libm::cos(azimuth))).map(|x| radius_m * libm::cbrt(r) * x)
}

/// Step of the state of SplitMix64.
pub const SPLIT_MIX_STEP: u64 = 0x9e37_79b9_7f4a_7c15;

/// The number that SplitMix64 (Steele, Lea and Flood 2014) gives in this state; also a hash of 64 bits.
pub fn split_mix(state: u64) -> u64 {
    let mut z = state.wrapping_add(SPLIT_MIX_STEP);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// The upper 53 bits of `random` as a number in [0, 1).
pub fn unit_interval(random: u64) -> f64 {
    (random >> 11) as f64 / (1_u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first numbers of the reference implementation with the seed 1234567.
    #[test]
    fn split_mix_gives_the_published_numbers() {
        let state = |n: u64| 1_234_567_u64.wrapping_add(n.wrapping_mul(SPLIT_MIX_STEP));
        let found = [0, 1, 2].map(|n| split_mix(state(n)));
        assert_eq!(found, [6_457_827_717_110_365_317, 3_203_168_211_198_807_973, 9_817_491_932_198_370_423]);
    }
}
