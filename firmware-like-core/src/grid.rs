//! The uniform grid of one configuration space: the integer points of a ball, and the box of slots that holds them.
//!
//! Points n (in cells) with |n| <= radius / spacing. With R the radius in cells, rounded up, tables live on the box
//! -E..=E per axis with E = R + 1: one ring more than the ball, so that all 64 points of every cell's super-cell
//! have a slot and no kernel ever tests for an edge. Slots run with the last index (z) fastest.

use core::num::NonZeroUsize;

use crate::lanes::F32x4;
use crate::math;
use crate::vec3::{self, Vec3};

/// Relative slack on radius / spacing: 0.1 / (0.1 / 7) in f32 must count 7 cells. Eight times the rounding of the
/// quotient of two rounded f32; the nearest shells |n| = sqrt(k) are further apart up to [`MAX_CELLS`].
const SLACK: f64 = 1e-6;

/// Largest radius in cells: 255^3 slots. Keeps every index in u32 and a blob in its 32-bit offsets.
pub const MAX_CELLS: i32 = 126;

/// Smallest spacing and largest radius, metres: far beyond any organ, and their squares, inverses and products with forces are ordinary
/// numbers.
const SMALLEST_M: f32 = 1e-6;
const LARGEST_M: f32 = 1e3;

/// Why a lattice was refused.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LatticeError {
    /// Spacing or radius is not a length between a micrometre and a kilometre, or the radius is below one cell.
    Size {
        /// Spacing given, metres.
        spacing_m: f32,
        /// Radius given, metres.
        radius_m: f32,
    },
    /// More cells along the radius than [`MAX_CELLS`].
    TooFine {
        /// Cells along the radius.
        cells: f64,
    },
}

impl core::fmt::Display for LatticeError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Size { spacing_m, radius_m } => {
                write!(
                    f,
                    "a grid needs 1e-6 m <= spacing <= radius <= 1e3 m, not spacing {spacing_m} m and radius {radius_m} m"
                )
            }
            Self::TooFine { cells } => {
                write!(
                    f,
                    "{cells:.0} cells along the radius are more than {MAX_CELLS}: choose a wider spacing"
                )
            }
        }
    }
}

impl core::error::Error for LatticeError {}

/// Ball of lattice points round the active node at rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BallLattice {
    spacing_m: f32,
    radius_m: f32,
    /// What the tick asks of vectors, in every lane: loads cost less than shuffles.
    tick: TickLanes,
    /// Largest |displacement|^2 inside the ball.
    radius_squared: f32,
    /// R, the radius in cells rounded up.
    reach: i32,
    strides: Strides,
    /// Slot of the rest point, less what the shift adds to indices, modulo 2^32.
    shifted_rest_slot: u32,
    /// Slot of the rest point.
    rest_slot: u32,
    /// Largest |n|^2 inside the ball.
    reach_squared: i32,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct TickLanes {
    cells_per_m: [f32; 4],
    low: [f32; 4],
    /// The number before the reach: no cell begins there.
    high: [f32; 4],
}

/// Slots from a lattice point to its neighbours along x and y; along z it is the next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Strides {
    /// Along x.
    pub sheet: u32,
    /// Along y.
    pub side: u32,
}

/// Where a query falls, after the out-of-table policy.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Location {
    /// Slot of the cell's low corner.
    pub slot: usize,
    /// Position inside the cell, each in [0, 1].
    pub t: Vec3,
    /// Position in cell units relative to the rest point.
    pub position: Vec3,
    /// False where the query was not finite or outside the ball and had to be pulled back.
    pub inside: bool,
    /// Where the query was pulled back: its direction from rest; zero inside and for a query that is not finite.
    pub outward: Vec3,
    /// How far it was pulled back, metres.
    pub pulled_m: f32,
}

impl BallLattice {
    /// Checks the sizes and fixes the extent.
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
            tick: TickLanes {
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

    /// Distance of neighbouring points, metres.
    pub const fn spacing_m(&self) -> f32 {
        self.spacing_m
    }

    /// Cells a metre.
    pub const fn cells_per_m(&self) -> f32 {
        let [cells_per_m, ..] = self.tick.cells_per_m;
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

    /// E = R + 1: indices run over -E..=E on each axis.
    pub const fn extent(&self) -> i32 {
        self.reach + 1
    }

    /// Slots along one axis, 2 E + 1.
    pub const fn side(&self) -> usize {
        self.strides.side as usize
    }

    /// Steps from slot to slot.
    #[inline(always)]
    pub const fn strides(&self) -> Strides {
        self.strides
    }

    /// Slots of the box, side^3.
    pub const fn slots(&self) -> usize {
        self.side() * self.side() * self.side()
    }

    /// As a `NonZero`, division by the side has no panic path.
    const fn side_nonzero(&self) -> NonZeroUsize {
        NonZeroUsize::MIN.saturating_add(2 * self.extent() as usize)
    }

    /// Slot of a lattice point, or `None` outside the box.
    #[inline(always)]
    pub fn slot(&self, ijk: [i32; 3]) -> Option<usize> {
        let extent = self.extent();
        let inside = ijk.iter().all(|n| (-extent..=extent).contains(n));
        inside.then(|| self.slot_in_box(ijk))
    }

    /// Slot of the rest point.
    pub const fn rest_slot(&self) -> usize {
        self.rest_slot as usize
    }

    /// Slot of a point known to be in the box.
    #[inline(always)]
    fn slot_in_box(&self, [i, j, k]: [i32; 3]) -> usize {
        let side = self.strides.side as i32;
        let from_rest = i.wrapping_mul(side).wrapping_add(j).wrapping_mul(side).wrapping_add(k);
        self.rest_slot.wrapping_add_signed(from_rest) as usize
    }

    /// Lattice point of a slot; meaningless for a slot outside the box.
    pub fn ijk(&self, slot: usize) -> [i32; 3] {
        let side = self.side_nonzero();
        let sheet = slot / side;
        [sheet / side, sheet % side, slot % side].map(|n| (n as i32).wrapping_sub(self.extent()))
    }

    /// Displacement of a lattice point, metres.
    pub fn displacement_m(&self, ijk: [i32; 3]) -> Vec3 {
        ijk.map(|n| n as f32 * self.spacing_m)
    }

    /// Whether a lattice point is in the ball.
    pub fn contains(&self, ijk: [i32; 3]) -> bool {
        let squared: i64 = ijk.iter().map(|&n| i64::from(n) * i64::from(n)).fold(0, i64::saturating_add);
        squared <= i64::from(self.reach_squared)
    }

    /// Lattice points of the ball in slot order, without the rest point.
    pub fn points(&self) -> impl Iterator<Item = [i32; 3]> + '_ {
        (0..self.slots()).map(|slot| self.ijk(slot)).filter(|&ijk| ijk != [0; 3] && self.contains(ijk))
    }

    /// Number of [`BallLattice::points`]: 514, 1418, 4168, 14146 for 5, 7, 10, 15 cells (the paper's four grids).
    pub fn count(&self) -> usize {
        self.points().count()
    }

    /// Low corner of the cell that holds a displacement, and the position inside it.
    ///
    /// On the outermost face t is the number before 1, so every cell returned has its super-cell in the box. Beyond the ball's bounding cube
    /// the nearest cell, t clamped; a NaN component gives the lowest cell, t = 0.
    pub fn cell(&self, displacement_m: Vec3) -> ([i32; 3], Vec3) {
        let position = F32x4::point(vec3::scale(displacement_m, self.cells_per_m()));
        let (low, t) = self.cell_of(position);
        let unshifted = |index: u32| index.wrapping_sub(math::ROUNDING_SHIFT.to_bits()) as i32;
        (low.map(unshifted), t)
    }

    /// The cell, its indices as [`F32x4::floor`] gives them.
    #[inline(always)]
    fn cell_of(&self, position: F32x4) -> ([u32; 3], Vec3) {
        let position = position.at_least(F32x4::load(&self.tick.low)).at_most(F32x4::load(&self.tick.high));
        let (low, indices) = position.floor();
        let t = position - low;
        (indices, [t.get::<0>(), t.get::<1>(), t.get::<2>()])
    }

    /// Finds the cell for any query at all, by the out-of-table policy.
    ///
    /// Beyond the ball the query is pulled back along the radius, and what continues it from there is told. A query that is not
    /// finite is answered at the rest point: the controller has faulted before, and a force of
    /// zero is the safe answer to a question without sense.
    #[inline(always)]
    pub fn locate(&self, displacement_m: Vec3) -> Location {
        self.locate_inside(displacement_m).unwrap_or_else(|[x, y, z]| self.locate_outside([x, y, z]))
    }

    /// [`BallLattice::locate`] where nothing needs to be pulled back; otherwise the displacement, to ask again with.
    ///
    /// Not the caller's displacement: with two uses it would be loaded into integers first, and the vector made of those.
    #[inline(always)]
    pub(crate) fn locate_inside(&self, displacement_m: Vec3) -> Result<Location, [f32; 3]> {
        let along = F32x4::point(displacement_m);
        let squared = along * along;
        let norm_squared = squared.get::<0>() + squared.get::<1>() + squared.get::<2>();
        // The comparison is false for NaN too.
        if norm_squared <= self.radius_squared {
            Ok(self.place(along))
        } else {
            Err([along.get::<0>(), along.get::<1>(), along.get::<2>()])
        }
    }

    #[cold]
    #[inline(never)]
    pub(crate) fn locate_outside(&self, displacement_m: Vec3) -> Location {
        let outward = vec3::normalize_or_zero(displacement_m);
        let length = vec3::norm(displacement_m);
        let pulled_m = if length > self.radius_m { length - self.radius_m } else { 0.0 };
        let at_rim_m = F32x4::point(vec3::scale(outward, self.radius_m));
        Location { inside: false, outward, pulled_m, ..self.place(at_rim_m) }
    }

    #[inline(always)]
    fn place(&self, displacement_m: F32x4) -> Location {
        let position = displacement_m * F32x4::load(&self.tick.cells_per_m);
        let ([i, j, k], t) = self.cell_of(position);
        let along_x = i.wrapping_mul(self.strides.sheet).wrapping_add(self.shifted_rest_slot);
        let slot = along_x.wrapping_add(j.wrapping_mul(self.strides.side).wrapping_add(k)) as usize;
        let position = [position.get::<0>(), position.get::<1>(), position.get::<2>()];
        Location { slot, t, position, inside: true, outward: vec3::ZERO, pulled_m: 0.0 }
    }
}
