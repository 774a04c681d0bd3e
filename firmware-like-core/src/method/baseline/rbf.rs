//! Radial basis functions centred on the solved configurations; the weights are fitted offline.

use crate::grid::flags::{Ball, CELL};
use crate::grid::{Location, MAX_CELLS};
use crate::method::Coverage;
use crate::method::interpolant::{Interpolant, Slopes};
use crate::num::lanes::{F32x4, Lanes, Machine, sums};
use crate::num::math;
use crate::num::vec3::Vec3;
use crate::plane::{PlaneError, check_len, check_values};

/// Tables are padded to a multiple of this length, so that the lane loops have no remainder.
pub const RBF_LANES: usize = 16;

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

impl<T: Copy + Into<f64>> RbfPlanes<'_, T> {
    /// Checks lengths and values; `name` is that of the method.
    pub(crate) fn check(&self, name: &'static str) -> Result<(), PlaneError> {
        let len =
            self.centres.first().map_or(0, |plane| plane.len()).div_ceil(RBF_LANES).saturating_mul(RBF_LANES);
        for (planes, largest) in [(self.centres, LARGEST_CENTRE), (self.weights, LARGEST_WEIGHT)] {
            for plane in planes {
                check_len(name, plane, len)?;
                // NaN fails the comparison.
                check_values(name, plane, |&value| value.into().abs() <= largest)?;
            }
        }
        Ok(())
    }
}

/// The methods `rbf-linear` (f32) and `rbf-cubic` (f64).
///
/// h(x) = sum_i w_i phi(|x - x_i|),   x in cells
///
/// Cost: one root per centre, shared by the three components; the order of the sum is fixed.
/// Source: Peterlik 2010, Eq. 12 (sum to N). Deviation: none; the equation has no polynomial term.
#[derive(Clone, Copy)]
pub(crate) struct Rbf<'s, T>(pub(crate) &'s RbfPlanes<'s, T>);

/// Numbers of a table and the function phi that belongs to them.
pub(crate) trait Radial: Lanes + PartialOrd {
    /// h at a position in cells.
    fn force<M: Machine>(planes: &RbfPlanes<'_, Self>, machine: M, position: Vec3) -> Vec3;

    /// dh_i/dx_j as rows i, x in cells.
    fn rows(planes: &RbfPlanes<'_, Self>, position: Vec3) -> [Vec3; 3];
}

impl<'s, T: Radial> Interpolant for Rbf<'s, T> {
    type Domain = Ball<'s>;

    #[inline(always)]
    fn force<M: Machine>(self, machine: M, _: Ball<'s>, at: &Location) -> Vec3 {
        T::force(self.0, machine, at.position)
    }

    fn slopes(self, ball: Ball<'s>, at: &Location) -> Slopes {
        let rows = T::rows(self.0, at.position);
        Slopes { stiffness_n_m: ball.per_metre(rows), energy_j: None }
    }

    /// Complete where the corners of the cell round the query are solved.
    #[inline(always)]
    fn coverage(self, ball: Ball<'s>, at: &Location) -> Coverage {
        if ball.cell_flags(at) & CELL != 0 { Coverage::Scattered } else { Coverage::Extrapolated }
    }
}

/// phi = r.
///
/// f32 suffices: r is at most the size of the table, and the terms cancel little. At a centre r = 0 and its
/// term vanishes; r is computed as a square root and never as r^2 / r, so there is no division by zero.
impl Radial for f32 {
    #[inline(always)]
    fn force<M: Machine>(planes: &RbfPlanes<'_, f32>, machine: M, position: Vec3) -> Vec3 {
        let [x, y, z] = position;
        let (x, y, z) = (machine.splat(x), machine.splat(y), machine.splat(z));
        let [mut sum_x, mut sum_y, mut sum_z] = [machine.splat(0.0); 3];
        let [cx, cy, cz] = planes.centres.map(|plane| plane.as_chunks().0);
        let [wx, wy, wz] = planes.weights.map(|plane| plane.as_chunks().0);
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

    #[inline(always)]
    fn rows(planes: &RbfPlanes<'_, f32>, position: Vec3) -> [Vec3; 3] {
        rows(planes, position, 0.0, |squared| 1.0 / math::sqrt(squared))
    }
}

/// phi = r^3.
///
/// f64 is needed: the terms grow with r^3 and cancel; in f32 the added error reached 43 mN on a dense grid.
impl Radial for f64 {
    #[inline(always)]
    fn force<M: Machine>(planes: &RbfPlanes<'_, f64>, machine: M, position: Vec3) -> Vec3 {
        let [x, y, z] = position.map(f64::from);
        let (x, y, z) = (machine.splat_f64(x), machine.splat_f64(y), machine.splat_f64(z));
        let [mut sum_x, mut sum_y, mut sum_z] = [machine.splat_f64(0.0); 3];
        let [cx, cy, cz] = planes.centres.map(|plane| plane.as_chunks().0);
        let [wx, wy, wz] = planes.weights.map(|plane| plane.as_chunks().0);
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

    #[inline(always)]
    fn rows(planes: &RbfPlanes<'_, f64>, position: Vec3) -> [Vec3; 3] {
        let rows = rows(planes, position.map(f64::from), 0.0, |squared| 3.0 * math::sqrt_f64(squared));
        rows.map(|row| row.map(|value| value as f32))
    }
}

/// dh_i/dx_j as rows i, x in cells: sum of w_i phi'(r) (x - x_i) / r, `slope(r^2)` = phi'(r) / r.
///
/// A centre at the query contributes nothing: phi = r has no slope there, that of phi = r^3 is zero.
/// Evaluated in the arithmetic of the table, because the tick needs it outside the ball and f64 is slow
/// on a microcontroller.
#[inline(always)]
fn rows<T: Radial>(
    planes: &RbfPlanes<'_, T>,
    [x, y, z]: [T; 3],
    zero: T,
    slope: impl Fn(T) -> T,
) -> [[T; 3]; 3] {
    let mut sums = [[zero; 3]; 3];
    let [cx, cy, cz] = planes.centres;
    let [wx, wy, wz] = planes.weights;
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

/// Eight consecutive numbers of a plane.
#[inline(always)]
fn eight<M: Machine>(machine: M, [a, b, c, d, e, f, g, h]: &[f32; 8]) -> M::F32x8 {
    machine.join([*a, *b, *c, *d], [*e, *f, *g, *h])
}
