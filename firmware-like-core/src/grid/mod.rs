//! The uniform grid of one configuration space: the lattice points of a ball, and the box of slots that holds
//! them.
//!
//! The points are n (in cells) with |n| <= radius / spacing. With R the radius in cells, rounded up, tables
//! cover the box -E..=E per axis, E = R + 1: one layer more than the ball, so that all 64 points of every
//! cell's super-cell have a slot and no interpolant tests for an edge. Slots are numbered with the last index
//! (z) fastest.

mod cell;
pub mod flags;

pub use cell::CORNERS;
pub(crate) use cell::{Strides, corner_weights};

use core::num::NonZeroUsize;

use crate::num::lanes::F32x4;
use crate::num::math;
use crate::num::vec3::{self, Vec3};

/// Relative tolerance of radius / spacing: 0.1 / (0.1 / 7) in f32 has to count 7 cells. It is eight times the
/// rounding error of the quotient of two rounded f32, and less than the distance of two shells |n| = sqrt(k)
/// up to [`MAX_CELLS`].
const SLACK: f64 = 1e-6;

/// Largest radius in cells: 255^3 slots. Every index then fits in u32, and every offset of a blob in 32 bits.
pub const MAX_CELLS: i32 = 126;

/// Smallest spacing and largest radius, metres: far beyond any organ. Their squares, inverses and products
/// with forces neither overflow nor underflow.
const SMALLEST_M: f32 = 1e-6;
const LARGEST_M: f32 = 1e3;

/// Why a lattice was refused.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum LatticeError {
    /// Spacing or radius is not between a micrometre and a kilometre, or the radius is smaller than the
    /// spacing.
    #[error(
        "a grid needs 1e-6 m <= spacing <= radius <= 1e3 m, not spacing {spacing_m} m and radius {radius_m} m"
    )]
    Size {
        /// Spacing given, metres.
        spacing_m: f32,
        /// Radius given, metres.
        radius_m: f32,
    },
    /// More cells along the radius than [`MAX_CELLS`].
    #[error("{cells:.0} cells along the radius are more than {}: choose a wider spacing", MAX_CELLS)]
    TooFine {
        /// Cells along the radius.
        cells: f64,
    },
}

/// The lattice points of a ball round the active node at rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BallLattice {
    spacing_m: f32,
    radius_m: f32,
    /// Constants of the query, repeated in every lane: loads cost less than shuffles.
    query: QueryLanes,
    /// Largest |displacement|^2 inside the ball.
    radius_squared: f32,
    /// R, the radius in cells rounded up.
    reach: i32,
    strides: Strides,
    /// Slot of the rest point less what [`math::ROUNDING_SHIFT`] adds to the indices, modulo 2^32.
    shifted_rest_slot: u32,
    /// Slot of the rest point.
    rest_slot: u32,
    /// Largest |n|^2 inside the ball.
    reach_squared: i32,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct QueryLanes {
    cells_per_m: [f32; 4],
    low: [f32; 4],
    /// The largest f32 below R: no cell begins at R.
    high: [f32; 4],
}

/// Location of a query.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Location {
    /// Slot of the cell's low corner.
    pub slot: usize,
    /// Position in the cell, each component in [0, 1].
    pub t: Vec3,
    /// Position relative to the rest point, in cells.
    pub position: Vec3,
    /// False if the query was outside the ball or not finite; then the location is that of
    /// `BallLattice::rim`.
    pub inside: bool,
}

/// The point of the rim that stands for a query outside.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Rim<At> {
    /// The point.
    pub(crate) at: At,
    /// Unit vector from rest towards the query; zero for a query that is not finite.
    pub(crate) outward: Vec3,
    /// Distance of the query from the point, metres.
    pub(crate) beyond_m: f32,
}

impl BallLattice {
    /// The lattice of a spacing and a radius in metres.
    ///
    /// Errors: [`LatticeError`] where the sizes are out of range or give more than [`MAX_CELLS`] cells.
    pub fn new(spacing_m: f32, radius_m: f32) -> Result<Self, LatticeError> {
        let cells = f64::from(radius_m) / f64::from(spacing_m);
        let cells_per_m = 1.0 / spacing_m;
        // NaN fails every comparison.
        if !(spacing_m >= SMALLEST_M && radius_m <= LARGEST_M && cells >= 1.0 - SLACK) {
            return Err(LatticeError::Size { spacing_m, radius_m });
        }
        if cells > f64::from(MAX_CELLS) {
            return Err(LatticeError::TooFine { cells });
        }
        let low = cells * (1.0 - SLACK);
        let reach = low as i32 + i32::from(low > f64::from(low as i32));
        let high = cells * (1.0 + SLACK);
        let (extent, side) = (reach as u32 + 1, 2 * reach as u32 + 3);
        let sheet = side * side;
        let rest_slot = (extent * side + extent) * side + extent;
        let shift = (sheet + side + 1).wrapping_mul(math::ROUNDING_SHIFT.to_bits());
        Ok(Self {
            spacing_m,
            radius_m,
            query: QueryLanes {
                cells_per_m: [cells_per_m; 4],
                low: [-reach as f32; 4],
                high: [(reach as f32).next_down(); 4],
            },
            radius_squared: radius_m * radius_m,
            reach,
            strides: Strides { sheet, side },
            shifted_rest_slot: rest_slot.wrapping_sub(shift),
            rest_slot,
            reach_squared: (high * high) as i32,
        })
    }

    /// Distance of neighbouring lattice points, metres.
    pub const fn spacing_m(&self) -> f32 {
        self.spacing_m
    }

    /// Cells per metre.
    pub(crate) const fn cells_per_m(&self) -> f32 {
        let [cells_per_m, ..] = self.query.cells_per_m;
        cells_per_m
    }

    /// Radius of the ball, metres.
    pub const fn radius_m(&self) -> f32 {
        self.radius_m
    }

    /// R: the radius in cells, rounded up.
    pub const fn reach(&self) -> i32 {
        self.reach
    }

    /// E = R + 1: the indices of an axis are -E..=E.
    const fn extent(&self) -> i32 {
        self.reach + 1
    }

    /// Slots along one axis, 2 E + 1.
    const fn side(&self) -> usize {
        self.strides.side as usize
    }

    /// Distances in slots of neighbouring points.
    #[inline(always)]
    pub(crate) const fn strides(&self) -> Strides {
        self.strides
    }

    /// Slots of the box, side^3.
    pub const fn slots(&self) -> usize {
        self.side() * self.side() * self.side()
    }

    /// The side as a `NonZero`, by which a division has no panic path.
    const fn side_nonzero(&self) -> NonZeroUsize {
        NonZeroUsize::MIN.saturating_add(2 * self.extent() as usize)
    }

    /// Slot of a lattice point, or `None` outside the box.
    #[inline(always)]
    pub fn slot(&self, ijk: [i32; 3]) -> Option<usize> {
        let (extent, side, [i, j, k]) = (self.extent(), self.strides.side as i32, ijk);
        let inside = ijk.iter().all(|n| (-extent..=extent).contains(n));
        let from_rest = i.wrapping_mul(side).wrapping_add(j).wrapping_mul(side).wrapping_add(k);
        inside.then_some(self.rest_slot.wrapping_add_signed(from_rest) as usize)
    }

    /// Slot of the rest point.
    pub(crate) const fn rest_slot(&self) -> usize {
        self.rest_slot as usize
    }

    /// Lattice point of a slot of the box.
    pub fn ijk(&self, slot: usize) -> [i32; 3] {
        let side = self.side_nonzero();
        let sheet = slot / side;
        [sheet / side, sheet % side, slot % side].map(|n| (n as i32).wrapping_sub(self.extent()))
    }

    /// Displacement of a lattice point, metres.
    pub fn displacement_m(&self, ijk: [i32; 3]) -> Vec3 {
        ijk.map(|n| n as f32 * self.spacing_m)
    }

    /// Whether a lattice point lies in the ball.
    pub fn contains(&self, ijk: [i32; 3]) -> bool {
        let squared: i64 = ijk.iter().map(|&n| i64::from(n) * i64::from(n)).fold(0, i64::saturating_add);
        squared <= i64::from(self.reach_squared)
    }

    /// The lattice points of the ball in the order of their slots, without the rest point: 514, 1418, 4168
    /// and 14146 for 5, 7, 10 and 15 cells, the paper's four grids.
    pub fn points(&self) -> impl Iterator<Item = [i32; 3]> + '_ {
        (0..self.slots()).map(|slot| self.ijk(slot)).filter(|&ijk| ijk != [0; 3] && self.contains(ijk))
    }

    /// Slots of the corners of the cell whose low corner is `slot`, in the order of [`CORNERS`].
    pub fn corners(&self, slot: usize) -> [usize; 8] {
        let (side, sheet) = (self.strides.side as usize, self.strides.sheet as usize);
        let [a, c] = [slot, slot.wrapping_add(side)];
        let [e, g] = [a.wrapping_add(sheet), c.wrapping_add(sheet)];
        [a, a.wrapping_add(1), c, c.wrapping_add(1), e, e.wrapping_add(1), g, g.wrapping_add(1)]
    }

    /// Location of a displacement; outside the ball, that of the nearest point of the rim.
    ///
    /// A displacement that is not finite is located at rest, where the force is zero. The controller detects
    /// it as a fault before it gets here.
    pub fn locate(&self, displacement_m: Vec3) -> Location {
        self.locate_inside(displacement_m).unwrap_or_else(|displacement_m| self.rim(displacement_m).at)
    }

    /// The location of a displacement inside the ball; otherwise the displacement, for [`BallLattice::rim`].
    ///
    /// The caller must not use its own copy of the displacement afterwards: with two uses the compiler loads
    /// it into integer registers first and assembles the vector from those.
    #[inline(always)]
    pub(crate) fn locate_inside(&self, displacement_m: Vec3) -> Result<Location, Vec3> {
        let along = F32x4::point(displacement_m);
        let squared = along * along;
        let norm_squared = squared.get::<0>() + squared.get::<1>() + squared.get::<2>();
        // NaN fails the comparison.
        if norm_squared <= self.radius_squared {
            Ok(self.place(along))
        } else {
            Err([along.get::<0>(), along.get::<1>(), along.get::<2>()])
        }
    }

    /// The point of the rim on the ray from rest through a displacement outside the ball.
    pub(crate) fn rim(&self, displacement_m: Vec3) -> Rim<Location> {
        let outward = vec3::normalize_or_zero(displacement_m);
        let length = vec3::norm(displacement_m);
        let beyond_m = if length > self.radius_m { length - self.radius_m } else { 0.0 };
        let at_rim_m = F32x4::point(vec3::scale(outward, self.radius_m));
        Rim { at: Location { inside: false, ..self.place(at_rim_m) }, outward, beyond_m }
    }

    /// The cell of a displacement in the ball. On the outermost face t is the largest f32 below 1, so that
    /// the super-cell is in the box.
    #[inline(always)]
    fn place(&self, displacement_m: F32x4) -> Location {
        let position = displacement_m * F32x4::load(&self.query.cells_per_m);
        let clamped = position.at_least(F32x4::load(&self.query.low)).at_most(F32x4::load(&self.query.high));
        let (low, [i, j, k]) = clamped.floor();
        let t = clamped - low;
        let t = [t.get::<0>(), t.get::<1>(), t.get::<2>()];
        let along_x = i.wrapping_mul(self.strides.sheet).wrapping_add(self.shifted_rest_slot);
        let slot = along_x.wrapping_add(j.wrapping_mul(self.strides.side).wrapping_add(k)) as usize;
        let position = [position.get::<0>(), position.get::<1>(), position.get::<2>()];
        Location { slot, t, position, inside: true }
    }
}
