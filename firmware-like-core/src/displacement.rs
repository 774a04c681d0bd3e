//! Surface displacements for the eye: a few modes of the whole surface, and how much of each a configuration has.
//!
//! u(p) = sum_k c_k(p) phi_k + sum_corners w e,   c_k = s_k sum_corners (v a_k + g_x a_k,x + g_y a_k,y + g_z a_k,z)
//!
//! The modes phi_k, the coefficients a_k and their slopes along the grid's axes are int16; s_k is the product of both units. e is
//! what the modes miss of an outlier, a configuration unlike the others; w are the tri-linear weights.
//!
//! - Without slopes v = w: tri-linear, error h^2.
//! - With slopes v = H L L + L H L + L L H - 2 w,  g_x = G L L, and so on: cubic Hermite along each axis (H of values, G of slopes),
//!   linear across it (L). Every cubic is met, so the error is h^4 as that of the tensor cubic, and no mixed derivative is needed. On
//!   a face all depends on its four corners: continuous, though not C1. The slopes fade out towards a fold, as in [`crate::blend`].
//!
//! Modes come in the order of their size, and only as many of the first have slopes as the packer finds worth it.
//!
//! Drawn at 30 Hz, never asked for by the tick.

use crate::blend;
use crate::flags::{FOLD, SMOOTH};
use crate::grid::BallLattice;
use crate::table::{LARGEST_VALUE, TableError, check_len};
use crate::trilinear;
use crate::vec3::{self, Vec3};

/// The planes of a table, not yet checked.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct DisplacementPlanes<'a> {
    /// Modes that have slopes, the first ones.
    pub slopes: usize,
    /// Row of `coefficients` of each slot of the box.
    pub row: &'a [u32],
    /// `[mode][surface vertex][xyz]`.
    pub modes: &'a [i16],
    /// Metres per unit of a mode times unit of its coefficient, one a mode.
    pub scale: &'a [f32],
    /// Rows of the values of all modes, then of the slopes along x, along y and along z, per cell.
    pub coefficients: &'a [i16],
    /// Rows that are outliers, ascending.
    pub outlier_row: &'a [u32],
    /// Metres per unit, one an outlier.
    pub outlier_scale: &'a [f32],
    /// `[outlier][surface vertex][xyz]`: what the modes miss.
    pub outliers: &'a [i16],
}

/// Why planes are no table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DisplacementError {
    /// Which plane.
    pub plane: &'static str,
    /// What is wrong with it.
    pub error: TableError,
}

impl core::fmt::Display for DisplacementError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{}: {}", self.plane, self.error)
    }
}

impl core::error::Error for DisplacementError {}

/// Surface displacement of each configuration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DisplacementTable<'a> {
    planes: DisplacementPlanes<'a>,
    vertices: usize,
    /// Numbers in a row of coefficients.
    per_row: usize,
    /// Modes whose slopes are used.
    used: usize,
}

/// Largest |number| of an int16.
const UNITS: f32 = 32768.0;

/// Modes added in one pass over the surface: it is read and written once for all of them.
const BLOCK: usize = 4;

/// A configuration's part in a displacement.
struct Part<'a> {
    index: u32,
    values: &'a [i16],
    slopes: [&'a [i16]; 3],
    /// Of the values and the slopes along x, y, z of modes that have slopes.
    weights: [f32; 4],
    /// Of the other modes, and of what an outlier adds.
    share: f32,
}

impl<'a> DisplacementTable<'a> {
    /// Checks that every slot of the box has a row, that rows, modes and outliers are whole, and that nothing can overflow.
    pub fn new(
        lattice: &BallLattice,
        planes: DisplacementPlanes<'a>,
        vertices: usize,
    ) -> Result<Self, DisplacementError> {
        let of = |plane| move |error| DisplacementError { plane, error };
        let stride = vertices.saturating_mul(3);
        let DisplacementPlanes { row, scale, coefficients, outlier_row, outlier_scale, .. } = planes;

        check_scale(scale, UNITS * UNITS).map_err(of("displacement scale"))?;
        check_len(planes.modes, scale.len().saturating_mul(stride)).map_err(of("displacement modes"))?;
        let enough = TableError::Length { have: scale.len(), need: planes.slopes };
        let _ = scale.get(..planes.slopes).ok_or(enough).map_err(of("displacement scale"))?;
        let per_row = planes.slopes.saturating_mul(3).saturating_add(scale.len());
        let rows = coefficients.len().checked_div(per_row).unwrap_or(0);
        let whole = check_len(coefficients, rows.saturating_mul(per_row));
        whole.map_err(of("displacement coefficients"))?;
        let checked = check_len(row, lattice.slots()).and_then(|()| check_rows(row, rows));
        checked.map_err(of("displacement row"))?;

        let checked = check_rows(outlier_row, rows).and_then(|()| check_ascending(outlier_row));
        checked.map_err(of("displacement outlier row"))?;
        let checked = check_len(outlier_scale, outlier_row.len()).and_then(|()| {
            let bad = outlier_scale.chunks(1).position(|scale| check_scale(scale, UNITS).is_err());
            bad.map_or(Ok(()), |index| Err(TableError::NotFinite { index }))
        });
        checked.map_err(of("displacement outlier scale"))?;
        let whole = check_len(planes.outliers, outlier_row.len().saturating_mul(stride));
        whole.map_err(of("displacement outliers"))?;
        Ok(Self { planes, vertices, per_row, used: planes.slopes })
    }

    /// Number of surface vertices in a mode.
    pub const fn vertices(&self) -> usize {
        self.vertices
    }

    /// What it is made of.
    pub const fn planes(&self) -> &DisplacementPlanes<'a> {
        &self.planes
    }

    /// Number of modes.
    pub const fn modes(&self) -> usize {
        self.planes.scale.len()
    }

    /// Number of configurations that are stored beside the modes.
    pub const fn outliers(&self) -> usize {
        self.planes.outlier_row.len()
    }

    /// Number of modes that are interpolated from their slopes too; without any it is all tri-linear.
    pub const fn slopes(&self) -> usize {
        self.used
    }

    /// Bytes of all planes.
    pub const fn bytes(&self) -> usize {
        let DisplacementPlanes {
            row, modes, scale, coefficients, outlier_row, outlier_scale, outliers, ..
        } = self.planes;
        let of_modes = size_of_val(modes) + size_of_val(scale) + size_of_val(row) + size_of_val(coefficients);
        of_modes + size_of_val(outlier_row) + size_of_val(outlier_scale) + size_of_val(outliers)
    }

    /// The same table without the use of its slopes: what they are worth is measured against it.
    #[must_use]
    pub const fn without_slopes(mut self) -> Self {
        self.used = 0;
        self
    }

    /// Displacement of the surface at `displacement_m` of the active node, metres.
    ///
    /// `out` has one entry per surface vertex; what is longer stays zero, what is missing is not computed. Beyond the ball the
    /// displacement at the rim; of what is not finite, that at rest. `flags` are the space's.
    pub fn displacement_into(
        &self,
        lattice: &BallLattice,
        flags: &[u8],
        displacement_m: Vec3,
        out: &mut [Vec3],
    ) {
        let at = lattice.locate(displacement_m);
        let corners = trilinear::corners(lattice.strides(), at.slot, at.t);
        let folded = flags.get(at.slot).is_none_or(|bits| bits & FOLD != 0);
        let hermite = if self.used == 0 || folded {
            0.0
        } else {
            blend::share(flags, SMOOTH, lattice.strides(), at.slot, at.t)
        };
        let mut parts = corners.iter().zip(hermite_weights(at.t)).map(|(&(slot, share), weights)| {
            let [value, x, y, z] = weights;
            let value = share + hermite * (value - share);
            self.part(slot, [value, hermite * x, hermite * y, hermite * z], share)
        });
        let parts: [Option<Part<'_>>; 8] = core::array::from_fn(|_| parts.next().flatten());
        self.add_up(&parts, out);
    }

    /// Displacement of the configuration at a slot, as it was packed, metres; zero for a slot outside the box.
    pub fn configuration_into(&self, slot: usize, out: &mut [Vec3]) {
        self.add_up(&[self.part(slot, [1.0, 0.0, 0.0, 0.0], 1.0)], out);
    }

    fn part(&self, slot: usize, weights: [f32; 4], share: f32) -> Option<Part<'a>> {
        let index = *self.planes.row.get(slot)?;
        let start = (index as usize).saturating_mul(self.per_row);
        let row = self.planes.coefficients.get(start..start.saturating_add(self.per_row))?;
        let (values, slopes) = row.split_at_checked(self.modes())?;
        let (x, slopes) = slopes.split_at_checked(self.planes.slopes)?;
        let (y, z) = slopes.split_at_checked(self.planes.slopes)?;
        Some(Part { index, values, slopes: [x, y, z], weights, share })
    }

    /// Coefficient of mode `k`, in its units.
    fn coefficient(&self, parts: &[Option<Part<'_>>], k: usize) -> f32 {
        let mut sum = 0.0;
        for part in parts.iter().flatten() {
            let value = part.values.get(k).map_or(0.0, |&value| f32::from(value));
            if k >= self.used {
                sum += part.share * value;
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

    fn add_up(&self, parts: &[Option<Part<'_>>], out: &mut [Vec3]) {
        out.fill(vec3::ZERO);
        let out = out.as_flattened_mut();
        let stride = self.vertices.saturating_mul(3);
        let plane = |planes: &'a [i16], index: usize| -> &'a [i16] {
            let start = index.saturating_mul(stride);
            planes.get(start..start.saturating_add(stride)).unwrap_or_default()
        };
        for (block, scales) in self.planes.scale.chunks(BLOCK).enumerate() {
            let first = block.saturating_mul(BLOCK);
            // A block that is not full repeats its first mode with a factor of zero.
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
            let Ok(index) = self.planes.outlier_row.binary_search(&part.index) else { continue };
            let scale = self.planes.outlier_scale.get(index).copied().unwrap_or(0.0);
            let missed = plane(self.planes.outliers, index);
            for (value, missed) in out.iter_mut().zip(missed) {
                *value += part.share * scale * f32::from(*missed);
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

/// Weights of the values and slopes at the corners, in the order of [`trilinear::corners`].
fn hermite_weights(t: Vec3) -> [[f32; 4]; 8] {
    // Of the low and the high end of an axis: linear, cubic of the values, cubic of the slopes.
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

/// No sum of `units` of each can be absurd.
fn check_scale(scale: &[f32], units: f32) -> Result<(), TableError> {
    let mut sum = 0.0;
    for (index, scale) in scale.iter().enumerate() {
        sum += scale.abs() * units;
        if sum.is_nan() || sum > LARGEST_VALUE {
            return Err(TableError::NotFinite { index });
        }
    }
    Ok(())
}

fn check_rows(row: &[u32], rows: usize) -> Result<(), TableError> {
    match row.iter().position(|&row| row as usize >= rows) {
        None => Ok(()),
        Some(index) => Err(TableError::OutOfRange { index }),
    }
}

fn check_ascending(row: &[u32]) -> Result<(), TableError> {
    match row.iter().zip(row.iter().skip(1)).position(|(a, b)| a >= b) {
        None => Ok(()),
        Some(before) => Err(TableError::Order { index: before.saturating_add(1) }),
    }
}
