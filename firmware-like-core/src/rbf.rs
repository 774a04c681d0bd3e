//! Radial basis functions over the solved configurations, weights fitted offline.

use core::ops::{Add, Mul, Sub};

use crate::math;
use crate::vec3::Vec3;

/// Centres per block: tables are padded to a multiple of it, so the lane loops have no tail.
pub const LANES: usize = 16;

/// Blocks whose phi is computed before the weights are applied: 512 bytes in f32, on the stack.
const BLOCKS: usize = 8;

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
    pub fn interpolate(&self, position: Vec3) -> Vec3 {
        sum_over_centres(self, position, math::sqrt)
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
    pub fn interpolate(&self, position: Vec3) -> Vec3 {
        let cubic = |squared: f64| squared * math::sqrt_f64(squared);
        sum_over_centres(self, position.map(f64::from), cubic).map(|force_n| force_n as f32)
    }
}

impl<T: Copy + Into<f64>> RbfTable<'_, T> {
    /// dh_i/dx_j as rows i, x in cell units: sum of w_i phi'(r) (x - x_i) / r, `slope(r)` = phi'(r) / r.
    ///
    /// A centre at the query itself gives nothing: phi = r has no slope there, phi = r^3 has slope zero. In f64: for stiffness, which
    /// no tick asks for.
    fn slopes(&self, position: Vec3, slope: impl Fn(f64) -> f64) -> [Vec3; 3] {
        let at = position.map(f64::from);
        let mut sums = [[0.0_f64; 3]; 3];
        let [cx, cy, cz] = self.centres;
        let [wx, wy, wz] = self.weights;
        for (((cx, cy), cz), ((wx, wy), wz)) in cx.iter().zip(cy).zip(cz).zip(wx.iter().zip(wy).zip(wz)) {
            let [x, y, z] = at;
            let d = [x - (*cx).into(), y - (*cy).into(), z - (*cz).into()];
            let [dx, dy, dz] = d;
            let squared = dx * dx + dy * dy + dz * dz;
            if squared > 0.0 {
                let factor = slope(math::sqrt_f64(squared));
                for (sums, weight) in sums.iter_mut().zip([wx, wy, wz]) {
                    for (sum, d) in sums.iter_mut().zip(d) {
                        *sum += (*weight).into() * factor * d;
                    }
                }
            }
        }
        sums.map(|row| row.map(|value| value as f32))
    }
}

impl RbfTable<'_, f32> {
    /// dh_i/dx_j as rows i, x in cell units.
    pub fn linear_slopes(&self, position: Vec3) -> [Vec3; 3] {
        self.slopes(position, |r| 1.0 / r)
    }
}

impl RbfTable<'_, f64> {
    /// dh_i/dx_j as rows i, x in cell units.
    pub fn cubic_slopes(&self, position: Vec3) -> [Vec3; 3] {
        self.slopes(position, |r| 3.0 * r)
    }
}

/// sum_i w_i phi(|x - x_i|^2) for the three components.
///
/// Why in two passes over small blocks: with phi and three weighted sums in one loop the compiler packs lanes of different
/// components into one vector and spends more on shuffles than on arithmetic (measured: 2.7 times slower).
#[inline]
fn sum_over_centres<T>(table: &RbfTable<'_, T>, position: [T; 3], phi: impl Fn(T) -> T) -> [T; 3]
where
    T: Copy + Default + Add<Output = T> + Sub<Output = T> + Mul<Output = T>,
{
    let [x, y, z] = position;
    let [cx, cy, cz] = table.centres.map(|plane| plane.as_chunks::<LANES>().0.chunks(BLOCKS));
    let [wx, wy, wz] = table.weights.map(|plane| plane.as_chunks::<LANES>().0.chunks(BLOCKS));
    let mut sums = [[T::default(); LANES]; 3];
    let mut values = [[T::default(); LANES]; BLOCKS];
    for (((cx, cy), cz), ((wx, wy), wz)) in cx.zip(cy).zip(cz).zip(wx.zip(wy).zip(wz)) {
        let centres = cx.as_flattened().iter().zip(cy.as_flattened()).zip(cz.as_flattened());
        for (value, ((&cx, &cy), &cz)) in values.as_flattened_mut().iter_mut().zip(centres) {
            let (dx, dy, dz) = (x - cx, y - cy, z - cz);
            *value = phi(dx * dx + dy * dy + dz * dz);
        }
        for (lanes, weights) in sums.iter_mut().zip([wx, wy, wz]) {
            accumulate(lanes, weights, &values);
        }
    }
    sums.map(sum_lanes)
}

/// lanes += weights * values, lane by lane. As a loop of its own it becomes plain vector code.
#[inline]
fn accumulate<T: Copy + Add<Output = T> + Mul<Output = T>>(
    lanes: &mut [T; LANES],
    weights: &[[T; LANES]],
    values: &[[T; LANES]; BLOCKS],
) {
    let mut sums = *lanes;
    for (weights, values) in weights.iter().zip(values) {
        for ((sum, &weight), &value) in sums.iter_mut().zip(weights).zip(values) {
            *sum = *sum + weight * value;
        }
    }
    *lanes = sums;
}

/// Fixed order, so that the sum does not depend on how the compiler vectorised the loop.
fn sum_lanes<T: Copy + Default + Add<Output = T>>(lanes: [T; LANES]) -> T {
    let mut quads = [T::default(); 4];
    for chunk in lanes.as_chunks::<4>().0 {
        for (quad, &lane) in quads.iter_mut().zip(chunk) {
            *quad = *quad + lane;
        }
    }
    let [a, b, c, d] = quads;
    (a + b) + (c + d)
}
