//! Where the domain of a kernel ends, by direction.

use super::{REACH_POINTS, REACH_SIDE};
use crate::num::vec3::{self, Vec3};
use crate::plane::{PlaneError, PlaneProblem, check_len};

/// Half the edge of the cube, in points.
const HALF: f32 = 4.0;

/// Distances from rest on the surface of a cube of directions, tri-linear between its points and therefore
/// continuous.
///
/// One lattice for the whole cube replaces six faces, so that two faces cannot differ on their common edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Reach<'a> {
    fractions: &'a [u8],
    unit_m: f32,
    min_m: f32,
}

impl<'a> Reach<'a> {
    /// Checks that there is a byte for every point and that none on the surface is zero.
    pub(super) fn new(radius_m: f32, fractions: &'a [u8]) -> Result<Self, PlaneError> {
        check_len("kernel reach", fractions, REACH_POINTS)?;
        let surface = || fractions.iter().enumerate().filter(|(index, _)| is_on_surface(*index));
        if let Some((index, _)) = surface().find(|(_, fraction)| **fraction == 0) {
            return Err(PlaneProblem::OutOfRange { index }.of("kernel reach"));
        }
        let least = surface().map(|(_, fraction)| *fraction).min().unwrap_or(1);
        let unit_m = radius_m / 255.0;
        // Reduced by the rounding error of the projection onto the cube.
        Ok(Self { fractions, unit_m, min_m: 0.9999 * unit_m * f32::from(least) })
    }

    /// The plane.
    pub(super) const fn fractions(&self) -> &'a [u8] {
        self.fractions
    }

    /// A lower bound of [`Reach::range_along_m`] over all directions, metres.
    #[inline(always)]
    pub(super) const fn min_m(&self) -> f32 {
        self.min_m
    }

    /// Whether a displacement is finite and within the reach.
    #[inline(never)]
    pub(super) fn contains(&self, displacement_m: Vec3) -> bool {
        vec3::is_finite(displacement_m) && vec3::norm(displacement_m) <= self.range_along_m(displacement_m)
    }

    /// The reach in the direction of a finite vector, metres.
    pub(super) fn range_along_m(&self, direction: Vec3) -> f32 {
        let largest = vec3::max_abs(direction);
        if largest <= 0.0 {
            return self.min_m;
        }
        // The division comes first, because four times the largest f32 would overflow.
        let [x, y, z] = direction.map(|x| (x / largest) * HALF + HALF);
        let ((i, x), (j, y), (k, z)) = (cell(x), cell(y), cell(z));
        let mut sum = 0.0;
        for (a, wx) in [(i, 1.0 - x), (i.wrapping_add(1), x)] {
            for (b, wy) in [(j, 1.0 - y), (j.wrapping_add(1), y)] {
                for (c, wz) in [(k, 1.0 - z), (k.wrapping_add(1), z)] {
                    let at =
                        a.wrapping_mul(REACH_SIDE).wrapping_add(b).wrapping_mul(REACH_SIDE).wrapping_add(c);
                    sum += wx * wy * wz * f32::from(self.fractions.get(at).copied().unwrap_or(0));
                }
            }
        }
        sum * self.unit_m
    }
}

/// The low point of the cell of a coordinate, and the position in the cell.
fn cell(x: f32) -> (usize, f32) {
    let low = (x as usize).min(REACH_SIDE - 2);
    (low, x - low as f32)
}

fn is_on_surface(index: usize) -> bool {
    let (ab, c) = (index / REACH_SIDE, index % REACH_SIDE);
    [ab / REACH_SIDE, ab % REACH_SIDE, c].iter().any(|n| *n == 0 || *n == REACH_SIDE - 1)
}
