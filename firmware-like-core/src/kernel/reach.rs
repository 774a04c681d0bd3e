//! How far from rest a kernel speaks, by direction.

use crate::table::{TableError, check_len};
use crate::vec3::{self, Vec3};

/// Points along an edge of the cube.
pub const REACH_SIDE: usize = 9;

/// Points of the cube; those inside it are not asked.
pub const REACH_POINTS: usize = REACH_SIDE * REACH_SIDE * REACH_SIDE;

/// Half the cube's edge, in its points.
const HALF: f32 = 4.0;

/// Distances from rest on the surface of a cube, tri-linear between its points: continuous in the direction.
///
/// One byte a point (a, b, c in 0..9, c fastest), a share of the ball's radius in 255ths, for the direction (a - 4, b - 4, c - 4). A cube
/// and not its six faces: two faces that share an edge cannot contradict each other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reach<'a> {
    shares: &'a [u8],
    unit_m: f32,
    least_m: f32,
}

impl<'a> Reach<'a> {
    /// Checks that there is a byte for every point and none on the surface is zero.
    pub(super) fn new(radius_m: f32, shares: &'a [u8]) -> Result<Self, TableError> {
        check_len(shares, REACH_POINTS)?;
        let surface = || shares.iter().enumerate().filter(|(index, _)| is_on_surface(*index));
        if let Some((index, _)) = surface().find(|(_, share)| **share == 0) {
            return Err(TableError::OutOfRange { index });
        }
        let least = surface().map(|(_, share)| *share).min().unwrap_or(1);
        let unit_m = radius_m / 255.0;
        // Less what rounding of the projection on the cube may take.
        Ok(Self { shares, unit_m, least_m: 0.9999 * unit_m * f32::from(least) })
    }

    /// No direction reaches less far, m.
    #[inline(always)]
    pub const fn least_m(&self) -> f32 {
        self.least_m
    }

    /// How far the direction of a finite vector reaches, m.
    pub fn towards_m(&self, direction: Vec3) -> f32 {
        let largest = vec3::max_abs(direction);
        if largest <= 0.0 {
            return self.least_m;
        }
        // Divided first: the largest f32 times four is none.
        let [x, y, z] = direction.map(|x| (x / largest) * HALF + HALF);
        let ((i, x), (j, y), (k, z)) = (cell(x), cell(y), cell(z));
        let mut share = 0.0;
        for (a, wx) in [(i, 1.0 - x), (i.wrapping_add(1), x)] {
            for (b, wy) in [(j, 1.0 - y), (j.wrapping_add(1), y)] {
                for (c, wz) in [(k, 1.0 - z), (k.wrapping_add(1), z)] {
                    let at =
                        a.wrapping_mul(REACH_SIDE).wrapping_add(b).wrapping_mul(REACH_SIDE).wrapping_add(c);
                    share += wx * wy * wz * f32::from(self.shares.get(at).copied().unwrap_or(0));
                }
            }
        }
        share * self.unit_m
    }
}

/// The low point of the cell and the place in it.
fn cell(x: f32) -> (usize, f32) {
    let low = (x as usize).min(REACH_SIDE - 2);
    (low, x - low as f32)
}

fn is_on_surface(index: usize) -> bool {
    let (ab, c) = (index / REACH_SIDE, index % REACH_SIDE);
    [ab / REACH_SIDE, ab % REACH_SIDE, c].iter().any(|n| *n == 0 || *n == REACH_SIDE - 1)
}
