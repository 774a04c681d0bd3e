//! Radial basis functions over the solved configurations, weights fitted offline.

use core::ops::{Add, Mul, Sub};

use crate::lanes::{F32x4, Machine, sums};
use crate::math;
use crate::vec3::Vec3;

/// Tables are padded to a multiple of it, so the lane loops have no tail.
pub const LANES: usize = 16;

/// Why a set of planes is no RBF table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RbfError {
    /// The six planes are not equally long, or not a multiple of [`LANES`].
    Length {
        /// Length of the first plane.
        len: usize,
    },
    /// A centre or a weight is NaN or infinite.
    NotFinite,
}

impl core::fmt::Display for RbfError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Length { len } => {
                write!(f, "RBF planes must be equally long and a multiple of {LANES}; the first has {len}")
            }
            Self::NotFinite => f.write_str("an RBF centre or weight is not finite"),
        }
    }
}

impl core::error::Error for RbfError {}

/// Planes of one fitted set of radial basis functions. `T` is f32 for phi = r and f64 for phi = r^3.
///
/// Centres are in cell units (displacement / spacing). Padding has zero weights and finite centres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RbfTable<'a, T> {
    centres: [&'a [T]; 3],
    weights: [&'a [T]; 3],
}

impl<'a, T: Copy + Into<f64>> RbfTable<'a, T> {
    /// Checks lengths and values. Planes are x, y, z of the centres and of the weights (newtons per phi).
    pub fn new(centres: [&'a [T]; 3], weights: [&'a [T]; 3]) -> Result<Self, RbfError> {
        let len = centres.first().map_or(0, |plane| plane.len());
        let planes = || centres.iter().chain(weights.iter());
        if !len.is_multiple_of(LANES) || planes().any(|plane| plane.len() != len) {
            return Err(RbfError::Length { len });
        }
        if planes().any(|plane| plane.iter().any(|&value| !value.into().is_finite())) {
            return Err(RbfError::NotFinite);
        }
        Ok(Self { centres, weights })
    }

    /// The planes x, y, z of the centres, in cells.
    pub const fn centres(&self) -> &[&'a [T]; 3] {
        &self.centres
    }

    /// The planes x, y, z of the weights.
    pub const fn weights(&self) -> &[&'a [T]; 3] {
        &self.weights
    }

    /// Number of centres, padding included.
    pub fn padded_len(&self) -> usize {
        self.centres.first().map_or(0, |plane| plane.len())
    }
}

impl RbfTable<'_, f32> {
    /// Sum of w_i r_i: the reaction force by linear radial basis functions.
    ///
    /// h(x) = sum_i w_i |x - x_i|,   x in cell units
    ///
    /// f32 suffices: r is no larger than the table and the sum cancels little. On a centre r = 0 and its term
    /// vanishes; r is a square root, never r^2 / r, so nothing is divided by zero.
    /// Cost: one root per centre, shared by the three components; the order of the sum is fixed.
    /// Source: Peterlik 2010, Eq. 12 (sum to N). Deviation: none, there is no polynomial tail in it.
    #[inline(always)]
    pub fn interpolate<M: Machine>(&self, machine: M, position: Vec3) -> Vec3 {
        let [x, y, z] = position;
        let (x, y, z) = (machine.splat(x), machine.splat(y), machine.splat(z));
        let [mut sum_x, mut sum_y, mut sum_z] = [machine.splat(0.0); 3];
        let [cx, cy, cz] = self.centres.map(|plane| plane.as_chunks().0);
        let [wx, wy, wz] = self.weights.map(|plane| plane.as_chunks().0);
        for (((cx, cy), cz), ((wx, wy), wz)) in cx.iter().zip(cy).zip(cz).zip(wx.iter().zip(wy).zip(wz)) {
            let [dx, dy, dz] = [x - eight(machine, cx), y - eight(machine, cy), z - eight(machine, cz)];
            let r = machine.sqrt(dx * dx + dy * dy + dz * dz);
            sum_x = sum_x + eight(machine, wx) * r;
            sum_y = sum_y + eight(machine, wy) * r;
            sum_z = sum_z + eight(machine, wz) * r;
        }
        let sum = |lanes: M::F32x8| {
            let [low, high] = machine.halves(lanes).map(F32x4::new);
            low + high
        };
        sums(sum(sum_x), sum(sum_y), sum(sum_z))
    }
}

impl RbfTable<'_, f64> {
    /// Sum of w_i r_i^3: the reaction force by cubic radial basis functions.
    ///
    /// h(x) = sum_i w_i |x - x_i|^3,   x in cell units
    ///
    /// f64 is needed: the terms grow with r^3 and cancel; in f32 the added error reached 43 mN on a dense grid.
    /// Cost and order as in the linear case.
    /// Source: Peterlik 2010, Eq. 12 (sum to N). Deviation: none, there is no polynomial tail in it.
    #[inline(always)]
    pub fn interpolate<M: Machine>(&self, machine: M, position: Vec3) -> Vec3 {
        let [x, y, z] = position.map(f64::from);
        let (x, y, z) = (machine.splat_f64(x), machine.splat_f64(y), machine.splat_f64(z));
        let [mut sum_x, mut sum_y, mut sum_z] = [machine.splat_f64(0.0); 3];
        let [cx, cy, cz] = self.centres.map(|plane| plane.as_chunks().0);
        let [wx, wy, wz] = self.weights.map(|plane| plane.as_chunks().0);
        for (((cx, cy), cz), ((wx, wy), wz)) in cx.iter().zip(cy).zip(cz).zip(wx.iter().zip(wy).zip(wz)) {
            let [dx, dy, dz] = [x - machine.load_f64(cx), y - machine.load_f64(cy), z - machine.load_f64(cz)];
            let squared = dx * dx + dy * dy + dz * dz;
            let cube = squared * machine.sqrt_f64(squared);
            sum_x = sum_x + machine.load_f64(wx) * cube;
            sum_y = sum_y + machine.load_f64(wy) * cube;
            sum_z = sum_z + machine.load_f64(wz) * cube;
        }
        let sum = |lanes: M::F64x4| {
            let [a, b, c, d] = machine.to_array_f64(lanes);
            ((a + c) + (b + d)) as f32
        };
        [sum(sum_x), sum(sum_y), sum(sum_z)]
    }
}

impl<T> RbfTable<'_, T>
where
    T: Copy + PartialOrd + Add<Output = T> + Sub<Output = T> + Mul<Output = T>,
{
    /// dh_i/dx_j as rows i, x in cell units: sum of w_i phi'(r) (x - x_i) / r, `slope(r^2)` = phi'(r) / r.
    ///
    /// A centre at the query itself gives nothing: phi = r has no slope there, phi = r^3 has slope zero. In the table's own kind of
    /// number: beyond the rim the tick asks for it, and a microcontroller computes in f32 alone at speed.
    #[inline(always)]
    fn slopes(&self, [x, y, z]: [T; 3], zero: T, slope: impl Fn(T) -> T) -> [[T; 3]; 3] {
        let mut sums = [[zero; 3]; 3];
        let [cx, cy, cz] = self.centres;
        let [wx, wy, wz] = self.weights;
        for (((cx, cy), cz), ((wx, wy), wz)) in cx.iter().zip(cy).zip(cz).zip(wx.iter().zip(wy).zip(wz)) {
            let d = [x - *cx, y - *cy, z - *cz];
            let [dx, dy, dz] = d;
            let squared = dx * dx + dy * dy + dz * dz;
            if squared > zero {
                let factor = slope(squared);
                for (sums, weight) in sums.iter_mut().zip([wx, wy, wz]) {
                    let factor = *weight * factor;
                    for (sum, d) in sums.iter_mut().zip(d) {
                        *sum = *sum + factor * d;
                    }
                }
            }
        }
        sums
    }
}

impl RbfTable<'_, f32> {
    /// dh_i/dx_j as rows i, x in cell units.
    pub fn linear_slopes(&self, position: Vec3) -> [Vec3; 3] {
        self.slopes(position, 0.0, |squared| 1.0 / math::sqrt(squared))
    }
}

impl RbfTable<'_, f64> {
    /// dh_i/dx_j as rows i, x in cell units.
    pub fn cubic_slopes(&self, position: Vec3) -> [Vec3; 3] {
        let slopes = self.slopes(position.map(f64::from), 0.0, |squared| 3.0 * math::sqrt_f64(squared));
        slopes.map(|row| row.map(|value| value as f32))
    }
}

/// Eight neighbours of a plane.
#[inline(always)]
fn eight<M: Machine>(machine: M, [a, b, c, d, e, f, g, h]: &[f32; 8]) -> M::F32x8 {
    machine.join([*a, *b, *c, *d], [*e, *f, *g, *h])
}
