//! Surface displacements: a few modes of the whole surface, and the coefficients of each configuration.
//!
//! u(p) = sum_k c_k(p) phi_k + sum_corners w e
//!
//! c_k = s_k sum_corners (v a_k + g_x a_k,x + g_y a_k,y + g_z a_k,z)
//!
//! The modes phi_k, the coefficients a_k and their slopes along the axes of the grid are int16; s_k is the
//! product of both units. e is the residual of an outlier, a configuration that the modes do not represent
//! well; w are the tri-linear weights.
//!
//! - Without slopes v = w: tri-linear, with an error of order spacing^2.
//! - With slopes v = H L L + L H L + L L H - 2 w, g_x = G L L, and so on: cubic Hermite along each axis (H
//!   weights values, G slopes) and linear across it (L). Every cubic is reproduced, so the error is of order
//!   spacing^4, as for the tensor cubic, but without mixed derivatives. On a face everything depends on its
//!   four corners: u is continuous, though not C1. The slopes fade out towards a fold, as in the method
//!   `energy`.
//!
//! The modes are sorted by size; only the first [`DisplacementPlanes::slopes`] have slopes, a number that the
//! packer selects. The table is for pictures at 30 Hz; the tick does not evaluate it.

use crate::grid::flags::{BRANCH_JUMP, Ball, SMOOTH};
use crate::grid::{BallLattice, corner_weights};
use crate::num::vec3::{self, Vec3};
use crate::plane::{LARGEST_VALUE, PlaneError, PlaneProblem, check_len, check_range, check_values};

/// Planes of the surface displacements of one space.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct DisplacementPlanes<'a> {
    /// Number of modes, from the first, that have slopes.
    pub slopes: usize,
    /// Row of `coefficients` of each slot of the box.
    pub row: &'a [u32],
    /// `[mode][surface vertex][xyz]`.
    pub modes: &'a [i16],
    /// Metres per unit of a mode times unit of its coefficient, one per mode; not negative.
    pub scale: &'a [f32],
    /// Rows of the values of all modes, then of the slopes along x, along y and along z, per cell.
    pub coefficients: &'a [i16],
    /// Rows of the outliers, ascending.
    pub outlier_row: &'a [u32],
    /// Metres per unit, one per outlier; not negative.
    pub outlier_scale: &'a [f32],
    /// `[outlier][surface vertex][xyz]`: the residual.
    pub outliers: &'a [i16],
}

/// Surface displacement of each configuration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DisplacementTable<'a> {
    planes: DisplacementPlanes<'a>,
    vertices: usize,
    /// Numbers in a row of coefficients.
    per_row: usize,
    /// Number of modes whose slopes are used.
    used: usize,
}

/// Largest absolute value of an int16.
const UNITS: f32 = 32768.0;

/// Modes added in one pass over the surface, which is read and written once for all of them.
const BLOCK: usize = 4;

/// The contribution of one configuration.
struct Part<'a> {
    row: u32,
    values: &'a [i16],
    slopes: [&'a [i16]; 3],
    /// Weights of the values and of the slopes along x, y and z, for modes that have slopes.
    weights: [f32; 4],
    /// Tri-linear weight, of the other modes and of the residual of an outlier.
    linear: f32,
}

impl<'a> DisplacementTable<'a> {
    /// Checks that every slot has a row, that rows, modes and outliers are complete, and that no sum can
    /// overflow.
    ///
    /// Errors: [`PlaneError`] with the name of the plane.
    pub fn new(
        lattice: &BallLattice,
        planes: DisplacementPlanes<'a>,
        vertices: usize,
    ) -> Result<Self, PlaneError> {
        let stride = vertices.saturating_mul(3);
        let DisplacementPlanes { slopes, row, scale, coefficients, outlier_row, outlier_scale, .. } = planes;

        check_scales(scale)?;
        check_len("displacement modes", planes.modes, scale.len().saturating_mul(stride))?;
        if slopes > scale.len() {
            return Err(PlaneProblem::Length { have: scale.len(), need: slopes }.of("displacement scale"));
        }
        let per_row = slopes.saturating_mul(3).saturating_add(scale.len());
        let rows = coefficients.len().checked_div(per_row).unwrap_or(0);
        check_len("displacement coefficients", coefficients, rows.saturating_mul(per_row))?;
        check_len("displacement row", row, lattice.slots())?;
        let is_row = |row: &u32| (*row as usize) < rows;
        check_range("displacement row", row, is_row)?;

        check_range("displacement outlier row", outlier_row, is_row)?;
        if let Some(before) = outlier_row.iter().zip(outlier_row.iter().skip(1)).position(|(a, b)| a >= b) {
            let index = before.saturating_add(1);
            return Err(PlaneProblem::Order { index }.of("displacement outlier row"));
        }
        check_len("displacement outlier scale", outlier_scale, outlier_row.len())?;
        let is_scale = |s: &f32| (0.0..=LARGEST_VALUE).contains(&(s * UNITS));
        check_values("displacement outlier scale", outlier_scale, is_scale)?;
        check_len("displacement outliers", planes.outliers, outlier_row.len().saturating_mul(stride))?;
        Ok(Self { planes, vertices, per_row, used: slopes })
    }

    /// The planes.
    pub const fn planes(&self) -> &DisplacementPlanes<'a> {
        &self.planes
    }

    /// The same table, interpolated without its slopes: the reference that shows their benefit.
    #[must_use]
    pub const fn without_slopes(mut self) -> Self {
        self.used = 0;
        self
    }

    /// Displacement of the surface where the active node is displaced by `displacement_m`; both in metres.
    ///
    /// Shapes: `out` has one entry per surface vertex; surplus entries are set to zero, missing ones are
    /// skipped. `flags` are those of the space. Outside the ball the result equals that at the rim. A
    /// displacement that is not finite gives the result at rest.
    pub fn displacement_into(
        &self,
        lattice: &BallLattice,
        flags: &[u8],
        displacement_m: Vec3,
        out: &mut [Vec3],
    ) {
        let (ball, at) = (Ball { lattice, flags }, lattice.locate(displacement_m));
        let corners = lattice.corners(at.slot).into_iter().zip(corner_weights(at.t));
        let is_smooth = self.used > 0 && ball.cell_flags(&at) & BRANCH_JUMP == 0;
        let hermite = if is_smooth { ball.smooth(SMOOTH, &at) } else { 0.0 };
        let mut parts = corners.zip(hermite_weights(at.t)).map(|((slot, linear), weights)| {
            let [value, x, y, z] = weights;
            let value = linear + hermite * (value - linear);
            self.part(slot, [value, hermite * x, hermite * y, hermite * z], linear)
        });
        let parts: [Option<Part<'_>>; 8] = core::array::from_fn(|_| parts.next().flatten());
        self.sum_parts(&parts, out);
    }

    /// Displacement of the configuration at a slot as it was packed, metres; zero for a slot outside the box.
    pub fn configuration_into(&self, slot: usize, out: &mut [Vec3]) {
        self.sum_parts(&[self.part(slot, [1.0, 0.0, 0.0, 0.0], 1.0)], out);
    }

    fn part(&self, slot: usize, weights: [f32; 4], linear: f32) -> Option<Part<'a>> {
        let index = *self.planes.row.get(slot)?;
        let start = (index as usize).saturating_mul(self.per_row);
        let row = self.planes.coefficients.get(start..start.saturating_add(self.per_row))?;
        let (values, slopes) = row.split_at_checked(self.planes.scale.len())?;
        let (x, slopes) = slopes.split_at_checked(self.planes.slopes)?;
        let (y, z) = slopes.split_at_checked(self.planes.slopes)?;
        Some(Part { row: index, values, slopes: [x, y, z], weights, linear })
    }

    /// Coefficient of mode `k`, in its units.
    fn coefficient(&self, parts: &[Option<Part<'_>>], k: usize) -> f32 {
        let mut sum = 0.0;
        for part in parts.iter().flatten() {
            let value = part.values.get(k).map_or(0.0, |&value| f32::from(value));
            if k >= self.used {
                sum += part.linear * value;
                continue;
            }
            let [weight, along @ ..] = part.weights;
            sum += weight * value;
            for (slopes, weight) in part.slopes.iter().zip(along) {
                sum += weight * slopes.get(k).map_or(0.0, |&slope| f32::from(slope));
            }
        }
        sum
    }

    fn sum_parts(&self, parts: &[Option<Part<'_>>], out: &mut [Vec3]) {
        out.fill(vec3::ZERO);
        let out = out.as_flattened_mut();
        let stride = self.vertices.saturating_mul(3);
        let plane = |planes: &'a [i16], index: usize| -> &'a [i16] {
            let start = index.saturating_mul(stride);
            planes.get(start..start.saturating_add(stride)).unwrap_or_default()
        };
        for (block, scales) in self.planes.scale.chunks(BLOCK).enumerate() {
            let first = block.saturating_mul(BLOCK);
            // An incomplete block repeats its first mode with a factor of zero.
            let mut factors = [0.0; BLOCK];
            let mut modes = [plane(self.planes.modes, first); BLOCK];
            for (k, ((factor, mode), scale)) in (first..).zip(factors.iter_mut().zip(&mut modes).zip(scales))
            {
                *factor = scale * self.coefficient(parts, k);
                *mode = plane(self.planes.modes, k);
            }
            add_block(out, modes, factors);
        }
        for part in parts.iter().flatten() {
            let Ok(index) = self.planes.outlier_row.binary_search(&part.row) else { continue };
            let scale = self.planes.outlier_scale.get(index).copied().unwrap_or(0.0);
            let residual = plane(self.planes.outliers, index);
            for (value, residual) in out.iter_mut().zip(residual) {
                *value += part.linear * scale * f32::from(*residual);
            }
        }
    }
}

#[inline]
fn add_block(out: &mut [f32], [a, b, c, d]: [&[i16]; BLOCK], [fa, fb, fc, fd]: [f32; BLOCK]) {
    for ((((value, a), b), c), d) in out.iter_mut().zip(a).zip(b).zip(c).zip(d) {
        *value += fa * f32::from(*a) + fb * f32::from(*b) + (fc * f32::from(*c) + fd * f32::from(*d));
    }
}

/// Weights of the values and slopes at the corners, in the order of [`crate::CORNERS`].
fn hermite_weights(t: Vec3) -> [[f32; 4]; 8] {
    // For the low and the high end of an axis: linear weight, cubic weight of the value, cubic weight of the
    // slope.
    let [x, y, z] = t.map(|t| {
        let s = 1.0 - t;
        [(s, (1.0 + 2.0 * t) * s * s, t * s * s), (t, (3.0 - 2.0 * t) * t * t, -s * t * t)]
    });
    let mut weights = [[0.0; 4]; 8];
    let mut corners = weights.iter_mut();
    for (lx, hx, gx) in x {
        for (ly, hy, gy) in y {
            for ((lz, hz, gz), corner) in z.into_iter().zip(corners.by_ref().take(2)) {
                let value = hx * ly * lz + lx * hy * lz + lx * ly * hz - 2.0 * (lx * ly * lz);
                *corner = [value, gx * ly * lz, lx * gy * lz, lx * ly * gz];
            }
        }
    }
    weights
}

/// Checks that no scale is negative or NaN, and that no sum over the modes exceeds [`LARGEST_VALUE`].
fn check_scales(scale: &[f32]) -> Result<(), PlaneError> {
    let mut sum = 0.0;
    for (index, scale) in scale.iter().enumerate() {
        sum += scale * (UNITS * UNITS);
        // The sum is NaN if the scale is.
        if *scale < 0.0 || sum.is_nan() || sum > LARGEST_VALUE {
            return Err(PlaneProblem::Value { index }.of("displacement scale"));
        }
    }
    Ok(())
}
