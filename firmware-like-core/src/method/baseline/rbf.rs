//! Radial basis functions centred on the solved configurations; the weights are fitted offline.

use core::ops::{Add, Mul, Sub};

use crate::grid::flags::CELL;
use crate::grid::{Location, MAX_CELLS};
use crate::method::Coverage;
use crate::method::interpolant::{Ball, Interpolant, Slopes};
use crate::num::lanes::{F32x4, Machine, sums};
use crate::num::math;
use crate::num::vec3::Vec3;
use crate::plane::{PlaneError, check_len, check_values};

/// Tables are padded to a multiple of this length, so that the lane loops have no remainder.
pub const LANES: usize = 16;

/// Largest coordinate of a centre, cells: twice that of any grid.
const LARGEST_CENTRE: f64 = 2.0 * MAX_CELLS as f64;

/// Largest weight, newtons per phi: far beyond any fit, and no sum of such terms overflows f32.
const LARGEST_WEIGHT: f64 = 1e15;

/// Planes of one fitted set of radial basis functions. `T` is f32 for phi = r and f64 for phi = r^3.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RbfPlanes<'a, T> {
    /// x, y, z of the centres, in cells (displacement / spacing); finite also in the padding.
    pub centres: [&'a [T]; 3],
    /// x, y, z of the weights, newtons per phi; zero in the padding.
    pub weights: [&'a [T]; 3],
}

/// Checked planes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RbfTable<'a, T> {
    planes: RbfPlanes<'a, T>,
}

impl<'a, T: Copy + Into<f64>> RbfTable<'a, T> {
    /// Checks lengths and values; `name` is that of the method.
    pub(crate) fn new(name: &'static str, planes: RbfPlanes<'a, T>) -> Result<Self, PlaneError> {
        let RbfPlanes { centres, weights } = planes;
        let len = centres.first().map_or(0, |plane| plane.len()).div_ceil(LANES).saturating_mul(LANES);
        let limits = [(centres, LARGEST_CENTRE), (weights, LARGEST_WEIGHT)];
        for (plane, largest) in limits.iter().flat_map(|(planes, largest)| planes.map(|p| (p, *largest))) {
            check_len(name, plane, len)?;
            // NaN fails the comparison.
            check_values(name, plane, |&value| value.into().abs() <= largest)?;
        }
        Ok(Self { planes })
    }

    /// The planes.
    pub(crate) const fn planes(&self) -> RbfPlanes<'a, T> {
        self.planes
    }
}

/// Coverage of scattered data: complete where the corners of the cell round the query are solved.
#[inline(always)]
fn coverage(ball: Ball<'_>, at: &Location) -> Coverage {
    if ball.cell_flags(at) & CELL != 0 { Coverage::Scattered } else { Coverage::Extrapolated }
}

/// h(x) = sum_i w_i |x - x_i|,   x in cells.
///
/// f32 suffices: r is at most the size of the table, and the terms cancel little. At a centre r = 0 and its
/// term vanishes; r is computed as a square root and never as r^2 / r, so there is no division by zero.
/// Cost: one root per centre, shared by the three components; the order of the sum is fixed.
/// Source: Peterlik 2010, Eq. 12 (sum to N). Deviation: none; the equation has no polynomial term.
#[derive(Clone, Copy)]
pub(crate) struct RbfLinear<'s> {
    pub(crate) ball: Ball<'s>,
    pub(crate) table: &'s RbfTable<'s, f32>,
}

/// h(x) = sum_i w_i |x - x_i|^3,   x in cells.
///
/// f64 is needed: the terms grow with r^3 and cancel; in f32 the added error reached 43 mN on a dense grid.
/// Cost, order and source as for [`RbfLinear`].
#[derive(Clone, Copy)]
pub(crate) struct RbfCubic<'s> {
    pub(crate) ball: Ball<'s>,
    pub(crate) table: &'s RbfTable<'s, f64>,
}

impl<'s> Interpolant for RbfLinear<'s> {
    type Domain = Ball<'s>;

    #[inline(always)]
    fn domain(self) -> Ball<'s> {
        self.ball
    }

    #[inline(always)]
    fn force<M: Machine>(self, machine: M, at: &Location) -> Vec3 {
        self.table.linear(machine, at.position)
    }

    fn slopes(self, at: &Location) -> Slopes {
        let rows = self.table.slopes(at.position, 0.0, |squared| 1.0 / math::sqrt(squared));
        Slopes { stiffness_n_m: self.ball.per_metre(rows), energy_j: None }
    }

    #[inline(always)]
    fn coverage(self, at: &Location) -> Coverage {
        coverage(self.ball, at)
    }
}

impl<'s> Interpolant for RbfCubic<'s> {
    type Domain = Ball<'s>;

    #[inline(always)]
    fn domain(self) -> Ball<'s> {
        self.ball
    }

    #[inline(always)]
    fn force<M: Machine>(self, machine: M, at: &Location) -> Vec3 {
        self.table.cubic(machine, at.position)
    }

    fn slopes(self, at: &Location) -> Slopes {
        let position = at.position.map(f64::from);
        let rows = self.table.slopes(position, 0.0, |squared| 3.0 * math::sqrt_f64(squared));
        let rows = rows.map(|row| row.map(|value| value as f32));
        Slopes { stiffness_n_m: self.ball.per_metre(rows), energy_j: None }
    }

    #[inline(always)]
    fn coverage(self, at: &Location) -> Coverage {
        coverage(self.ball, at)
    }
}

impl RbfTable<'_, f32> {
    #[inline(always)]
    fn linear<M: Machine>(&self, machine: M, position: Vec3) -> Vec3 {
        let [x, y, z] = position;
        let (x, y, z) = (machine.splat(x), machine.splat(y), machine.splat(z));
        let [mut sum_x, mut sum_y, mut sum_z] = [machine.splat(0.0); 3];
        let [cx, cy, cz] = self.planes.centres.map(|plane| plane.as_chunks().0);
        let [wx, wy, wz] = self.planes.weights.map(|plane| plane.as_chunks().0);
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
    #[inline(always)]
    fn cubic<M: Machine>(&self, machine: M, position: Vec3) -> Vec3 {
        let [x, y, z] = position.map(f64::from);
        let (x, y, z) = (machine.splat_f64(x), machine.splat_f64(y), machine.splat_f64(z));
        let [mut sum_x, mut sum_y, mut sum_z] = [machine.splat_f64(0.0); 3];
        let [cx, cy, cz] = self.planes.centres.map(|plane| plane.as_chunks().0);
        let [wx, wy, wz] = self.planes.weights.map(|plane| plane.as_chunks().0);
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
    /// dh_i/dx_j as rows i, x in cells: sum of w_i phi'(r) (x - x_i) / r, `slope(r^2)` = phi'(r) / r.
    ///
    /// A centre at the query contributes nothing: phi = r has no slope there, that of phi = r^3 is zero.
    /// Evaluated in the arithmetic of the table, because the tick needs it outside the ball and f64 is slow
    /// on a microcontroller.
    #[inline(always)]
    fn slopes(&self, [x, y, z]: [T; 3], zero: T, slope: impl Fn(T) -> T) -> [[T; 3]; 3] {
        let mut sums = [[zero; 3]; 3];
        let [cx, cy, cz] = self.planes.centres;
        let [wx, wy, wz] = self.planes.weights;
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

/// Eight consecutive numbers of a plane.
#[inline(always)]
fn eight<M: Machine>(machine: M, [a, b, c, d, e, f, g, h]: &[f32; 8]) -> M::F32x8 {
    machine.join([*a, *b, *c, *d], [*e, *f, *g, *h])
}
