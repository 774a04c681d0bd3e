//! exp(-q) of several lanes with the same bits on every system. Library exponentials differ in the last
//! digit.

use super::lanes::Machine;

/// 1.5 * 2^52: its sum with x, |x| < 2^51, is x rounded to the nearest integer, which then stands in the low
/// bits.
const SHIFT: f64 = 6_755_399_441_055_744.0;

/// ln 2 in two parts. The upper part ends with enough zero bits that its product with an integer below 2^11
/// is exact.
const LN2: [f64; 2] = [6.931_471_803_691_238e-1, 1.908_214_929_270_587_7e-10];

/// 1 / n! for n = 2 to 11: the truncation error of exp(r) is 7e-15 at |r| = ln 2 / 2.
const SERIES: [f64; 10] = [
    0.5,
    1.0 / 6.0,
    1.0 / 24.0,
    1.0 / 120.0,
    1.0 / 720.0,
    1.0 / 5_040.0,
    1.0 / 40_320.0,
    1.0 / 362_880.0,
    1.0 / 3_628_800.0,
    1.0 / 39_916_800.0,
];

/// exp(-q), 0 <= q <= 700: relative error below 2e-14.
///
/// exp(-q) = 2^k exp(r),   k = round(-q / ln 2),   r = -q - k ln 2
///
/// Source: Cody and Waite, Software Manual for the Elementary Functions, 1980, chapter 6. Deviation: a Taylor
/// series in place of their rational approximation.
#[inline(always)]
pub(crate) fn exp_of_minus<M: Machine>(machine: M, q: M::F64x4) -> M::F64x4 {
    let [c2, c3, c4, c5, c6, c7, c8, c9, c10, c11] = SERIES;
    let number = machine.splat_f64(0.0);
    let shifted = machine.splat_f64(SHIFT) - q * machine.splat_f64(core::f64::consts::LOG2_E);
    let k = shifted - machine.splat_f64(SHIFT);
    let [upper, lower] = LN2;
    let r = ((number - q) - k * machine.splat_f64(upper)) - k * machine.splat_f64(lower);
    // Even and odd powers are summed apart: two short dependency chains instead of a long one.
    let s = r * r;
    let even = machine.splat_f64(c8) + s * machine.splat_f64(c10);
    let even = machine.splat_f64(c4) + s * (machine.splat_f64(c6) + s * even);
    let even = machine.splat_f64(1.0) + s * (machine.splat_f64(c2) + s * even);
    let odd = machine.splat_f64(c9) + s * machine.splat_f64(c11);
    let odd = machine.splat_f64(c5) + s * (machine.splat_f64(c7) + s * odd);
    let odd = machine.splat_f64(1.0) + s * (machine.splat_f64(c3) + s * odd);
    let [a, b, c, d] = machine.to_array_f64(shifted);
    let powers = [power_of_two(a), power_of_two(b), power_of_two(c), power_of_two(d)];
    (even + r * odd) * machine.load_f64(&powers)
}

/// 2^k, -1022 <= k <= 1023, from k + [`SHIFT`].
#[inline(always)]
fn power_of_two(shifted: f64) -> f64 {
    f64::from_bits(shifted.to_bits().wrapping_add(1023) << 52)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::num::lanes::Baseline;

    #[test]
    fn exponentials_have_thirteen_correct_digits() {
        let mut worst = 0.0_f64;
        for n in 0..400_000_u32 {
            let q = f64::from(n) * 700.0 / 400_000.0 + f64::from(n % 7) * 1e-9;
            let lanes = [q, 0.0, q / 3.0, q / 100.0];
            let found = Baseline.to_array_f64(exp_of_minus(Baseline, Baseline.load_f64(&lanes)));
            for (q, found) in lanes.into_iter().zip(found) {
                worst = worst.max((found / (-q).exp() - 1.0).abs());
            }
        }
        assert!(worst < 2e-14, "{worst}");
        let one = Baseline.to_array_f64(exp_of_minus(Baseline, Baseline.load_f64(&[0.0; 4])));
        assert_eq!(one, [1.0; 4]);
    }
}
