//! The leading modes of the surface displacements in the core's form: int16 numbers and a scale.

use crate::num::vector::inner;
use palpate_core::DisplacementPlanes;

/// Largest packed number; a value is stored in units of 1/32767 of its range.
pub(crate) const UNITS: f64 = 32767.0;

/// A mode before packing.
pub(crate) struct Mode {
    /// Shape, orthonormal to the other modes.
    pub(crate) shape: Vec<f64>,
    /// Largest absolute coefficient.
    pub(crate) range: f64,
}

/// Packed modes.
pub(crate) struct PackedModes {
    /// `[mode][surface vertex][xyz]`.
    pub(crate) numbers: Vec<i16>,
    /// Metres per unit of the mode and unit of the coefficient.
    pub(crate) scale: Vec<f32>,
    /// The modes as the core decodes them, for the coefficient 1, m.
    pub(crate) unpacked: Vec<Vec<f64>>,
    /// |unpacked|^2.
    squared: Vec<f64>,
}

impl PackedModes {
    pub(crate) fn pack(modes: &[Mode]) -> Self {
        let (mut all, mut scales): (Vec<i16>, Vec<f32>) = Default::default();
        for Mode { shape, range } in modes {
            let top = shape.iter().fold(0.0, |top: f64, x| top.max(x.abs())).max(f64::MIN_POSITIVE);
            let numbers: Vec<i16> = shape.iter().map(|x| (UNITS * x / top).round() as i16).collect();
            // Packed modes are only nearly orthogonal, so a coefficient can exceed the range of the mode
            // slightly.
            let scale = (top / UNITS * 1.01 * range / UNITS).max(f64::from(f32::MIN_POSITIVE)) as f32;
            all.extend(numbers);
            scales.push(scale);
        }
        Self::of(all, scales)
    }

    /// The modes of an existing table.
    pub(crate) fn of_planes(planes: &DisplacementPlanes<'_>) -> Self {
        Self::of(planes.modes.to_vec(), planes.scale.to_vec())
    }

    fn of(numbers: Vec<i16>, scale: Vec<f32>) -> Self {
        let length = numbers.len() / scale.len().max(1);
        let whole = |(numbers, &scale): (&[i16], &f32)| -> Vec<f64> {
            numbers.iter().map(|&n| f64::from(n) * f64::from(scale)).collect()
        };
        let unpacked: Vec<Vec<f64>> = numbers.chunks(length.max(1)).zip(&scale).map(whole).collect();
        let squared = unpacked.iter().map(|mode| inner(mode, mode).max(f64::MIN_POSITIVE)).collect();
        Self { numbers, scale, unpacked, squared }
    }

    /// Coefficients of a displacement, and the remainder of the displacement, m.
    pub(crate) fn coefficients(&self, displacement_m: &[f32]) -> (Vec<i16>, Vec<f64>) {
        let mut left: Vec<f64> = displacement_m.iter().map(|&x| f64::from(x)).collect();
        let mut packed = Vec::with_capacity(self.scale.len());
        for (mode, squared) in self.unpacked.iter().zip(&self.squared) {
            let number = (inner(mode, &left) / squared).round().clamp(-UNITS, UNITS);
            left.iter_mut().zip(mode).for_each(|(x, m)| *x -= number * m);
            packed.push(number as i16);
        }
        (packed, left)
    }

    /// Coefficients of a slope times `step`, not rounded.
    pub(crate) fn project(&self, slope: &[f32], step: f64) -> Vec<f64> {
        let along = |mode: &[f64]| slope.iter().zip(mode).map(|(s, m)| f64::from(*s) * m).sum::<f64>();
        self.unpacked.iter().zip(&self.squared).map(|(mode, squared)| step * along(mode) / squared).collect()
    }

    /// Remainder of a displacement without these modes, m, and the change of the remainder by rounding the
    /// coefficients, m.
    pub(crate) fn left_and_rounded(&self, displacement_m: &[f32]) -> [Vec<f64>; 2] {
        let mut left: Vec<f64> = displacement_m.iter().map(|&x| f64::from(x)).collect();
        for (mode, squared) in self.unpacked.iter().zip(&self.squared) {
            let along = inner(mode, &left) / squared;
            left.iter_mut().zip(mode).for_each(|(x, m)| *x -= along * m);
        }
        let (_, rounded) = self.coefficients(displacement_m);
        let apart = rounded.iter().zip(&left).map(|(rounded, left)| rounded - left).collect();
        [left, apart]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_modes_leave_and_what_digits_change_are_apart() {
        let mode = |shape: [f64; 4], range| Mode { shape: shape.to_vec(), range };
        let modes = PackedModes::pack(&[mode([1.0, 0.0, 0.0, 0.0], 0.01), mode([0.0, 0.8, 0.6, 0.0], 0.02)]);
        let [left, rounded] = modes.left_and_rounded(&[0.004_321, 0.008, 0.006, 0.003]);
        assert!((left[3] - 0.003).abs() < 1e-9 && left[..3].iter().all(|x| x.abs() < 1e-7), "{left:?}");
        // The rounding error is half a unit of a coefficient, whose range has 32,767 units.
        let largest = rounded.iter().fold(0.0f64, |top, x| top.max(x.abs()));
        assert!(largest > 1e-9 && largest < 0.51 * 1.01 * 0.02 / UNITS, "{rounded:?}");
        let again = PackedModes::of(modes.numbers.clone(), modes.scale.clone());
        assert_eq!(again.unpacked, modes.unpacked);
    }

    /// Read as the core reads it, a mode is within half a unit of its largest value.
    #[test]
    fn a_mode_is_rounded_by_at_most_half_a_unit() {
        let shape: Vec<f64> = (1..500).map(|n| 0.07 * (f64::from(n) * 1.7).sin()).collect();
        let range = 0.02;
        let PackedModes { numbers, scale, .. } = PackedModes::pack(&[Mode { shape: shape.clone(), range }]);
        let top = shape.iter().fold(0.0, |top: f64, x| top.max(x.abs()));
        let unit = 1.01 * range / UNITS;
        let apart = |(n, x): (&i16, &f64)| (f64::from(*n) * f64::from(scale[0]) / unit - x).abs();
        let largest = numbers.iter().zip(&shape).map(apart).fold(0.0, f64::max);
        // The scale as f32 adds at most 6e-8 of the value, 0.004 units.
        assert!(largest <= 1.004 * top / 65_534.0 && largest > 0.9 * top / 65_534.0, "{largest}");
    }
}
