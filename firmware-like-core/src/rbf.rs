//! Radial basis functions over the solved configurations, weights fitted offline.

use crate::math;
use crate::vec3::Vec3;

/// Centres per block: tables are padded to a multiple of it, so the lane loops have no tail.
pub const LANES: usize = 16;

/// Accumulators per component in the f64 sum: with 16 the registers of x86-64 and Cortex-M spill.
const LANES_F64: usize = 4;

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
        if len % LANES != 0 || planes().any(|plane| plane.len() != len) {
            return Err(RbfError::Length { len });
        }
        if planes().any(|plane| plane.iter().any(|&value| !value.into().is_finite())) {
            return Err(RbfError::NotFinite);
        }
        Ok(Self { centres, weights })
    }

    /// Number of centres, padding included.
    pub fn padded_len(&self) -> usize {
        self.centres.first().map_or(0, |plane| plane.len())
    }
}

/// Fixed pairwise order, so that the sum does not depend on how the compiler vectorised the loop.
fn sum_lanes<T: Copy + core::ops::Add<Output = T>, const N: usize>(lanes: [T; N], zero: T) -> T {
    let mut quads = [zero; 4];
    for chunk in lanes.as_chunks::<4>().0 {
        for (quad, &lane) in quads.iter_mut().zip(chunk) {
            *quad = *quad + lane;
        }
    }
    let [a, b, c, d] = quads;
    (a + b) + (c + d)
}

impl RbfTable<'_, f32> {
    /// Sum of w_i r_i: the reaction force by linear radial basis functions.
    ///
    /// h(x) = sum_i w_i |x - x_i|,   x in cell units
    ///
    /// f32 suffices: r is no larger than the table and the sum cancels little. On a centre r = 0 and its term
    /// vanishes; r is a square root, never r^2 / r, so nothing is divided by zero.
    /// Cost: one pass for all three components, phi shared; deterministic order.
    /// Source: Peterlik 2010, Eq. 12 (sum to N). Deviation: none, there is no polynomial tail in it.
    pub fn interpolate(&self, position: Vec3) -> Vec3 {
        let [x, y, z] = position;
        let [cx, cy, cz] = self.centres.map(|plane| plane.as_chunks::<LANES>().0);
        let [wx, wy, wz] = self.weights.map(|plane| plane.as_chunks::<LANES>().0);
        let mut sums = [[0.0_f32; LANES]; 3];
        let [sx, sy, sz] = &mut sums;
        let blocks = cx.iter().zip(cy).zip(cz).zip(wx).zip(wy).zip(wz);
        for (((((cx, cy), cz), wx), wy), wz) in blocks {
            let mut phi = [0.0_f32; LANES];
            for (((phi, cx), cy), cz) in phi.iter_mut().zip(cx).zip(cy).zip(cz) {
                let (dx, dy, dz) = (x - cx, y - cy, z - cz);
                *phi = math::sqrt(dx * dx + dy * dy + dz * dz);
            }
            accumulate(sx, wx, &phi);
            accumulate(sy, wy, &phi);
            accumulate(sz, wz, &phi);
        }
        sums.map(|lanes| sum_lanes(lanes, 0.0))
    }
}

#[inline]
fn accumulate<T: Copy + core::ops::Add<Output = T> + core::ops::Mul<Output = T>, const N: usize>(
    sums: &mut [T; N],
    weights: &[T; N],
    phi: &[T; N],
) {
    for ((sum, &weight), &phi) in sums.iter_mut().zip(weights).zip(phi) {
        *sum = *sum + weight * phi;
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
        let [x, y, z] = position.map(f64::from);
        let [cx, cy, cz] = self.centres.map(|plane| plane.as_chunks::<LANES_F64>().0);
        let [wx, wy, wz] = self.weights.map(|plane| plane.as_chunks::<LANES_F64>().0);
        let mut sums = [[0.0_f64; LANES_F64]; 3];
        let [sx, sy, sz] = &mut sums;
        let blocks = cx.iter().zip(cy).zip(cz).zip(wx).zip(wy).zip(wz);
        for (((((cx, cy), cz), wx), wy), wz) in blocks {
            let mut phi = [0.0_f64; LANES_F64];
            for (((phi, cx), cy), cz) in phi.iter_mut().zip(cx).zip(cy).zip(cz) {
                let (dx, dy, dz) = (x - cx, y - cy, z - cz);
                let squared = dx * dx + dy * dy + dz * dz;
                *phi = squared * math::sqrt_f64(squared);
            }
            accumulate(sx, wx, &phi);
            accumulate(sy, wy, &phi);
            accumulate(sz, wz, &phi);
        }
        sums.map(|lanes| sum_lanes(lanes, 0.0) as f32)
    }
}
