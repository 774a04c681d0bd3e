//! The energy as a sum of Gaussians fitted to it, without a grid and without cells.
//!
//! W(x) = l [x . B x / 2 + sum_n E_n P_n(x - x_n) - g . x - e],   E_n = exp(-|x - x_n|^2 / 2),   x = p / l
//!
//! h = dW/dp = B x + sum_n E_n (grad P_n - r P_n) - g,   r = x - x_n
//!
//! p is the displacement, l the length of the kernel, B x the force of the linearised body at rest, and P_n a
//! polynomial of degree three: 20 coefficients per configuration. These are the weights of a Gaussian-process
//! (Hermite-Birkhoff) fit of W, h, S and the third derivatives (Wendland, Scattered Data Approximation, 2004,
//! chapter 16). The derivative of order b of the Gaussian is He_b(r) E, so the sum over b is E times a
//! polynomial, at a fifth of the operations. g and e are gradient and value of the sum at rest, so that force
//! and energy vanish there.
//!
//! The force is the exact gradient of a smooth W: it does no work on a closed path, and there are no faces of
//! cells.
//!
//! Far from data a sum of Gaussians tends to zero and may oscillate. Therefore the domain of the method ends
//! at its `Reach`; outside, the force is continued as for every method, and is `Extrapolated`.
//!
//! The terms are thousands of times larger than their sum, so all arithmetic is f64; f32 would cause errors
//! of newtons.

mod reach;
mod sum;

use reach::Reach;

use super::Coverage;
use super::interpolant::{Domain, Interpolant, Slopes};
use crate::grid::Rim;
use crate::num::lanes::{Baseline, Machine};
use crate::num::vec3::{self, Vec3};
use crate::plane::{PlaneError, PlaneProblem, check_len, check_values};

/// Configurations per block, evaluated side by side.
pub const LANES: usize = 4;

/// Numbers of a configuration: its position (x, y, z, in lengths l), then the derivatives of its polynomial
/// at that position, newtons, in the order 1, x, y, z, xx, xy, xz, yy, yz, zz, xxx, xxy, xxz, xyy, xyz, xzz,
/// yyy, yyz, yzz, zzz.
pub const NUMBERS: usize = 23;

/// Four configurations, number by number; a block that is not full ends with zeros.
pub type Block = [[f64; LANES]; NUMBERS];

/// Largest number of configurations: the time of a tick grows with them. The adaptive sampling stops at 160.
pub const MAX_CENTRES: usize = 256;

/// Number of scalars: l in metres, then xx, xy, xz, yy, yz, zz of B = l S(0), newtons.
pub const SCALARS: usize = 7;

/// Largest distance from rest of a configuration and of the rim of the ball, in lengths l: the range of the
/// exponential.
pub const MAX_DISTANCE: f64 = 16.0;

/// Points along an edge of the cube of directions.
pub const REACH_SIDE: usize = 9;

/// Points of the cube of directions; only those on its surface are used.
pub const REACH_POINTS: usize = REACH_SIDE * REACH_SIDE * REACH_SIDE;

/// Largest absolute coefficient of a polynomial or of B, newtons: far beyond any fit, and no sum overflows
/// f32.
const LARGEST_N: f64 = 1e15;

/// Smallest and largest l, metres.
const LENGTHS_M: core::ops::RangeInclusive<f64> = 1e-6..=1e3;

/// Planes of one kernel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KernelPlanes<'a> {
    /// [`SCALARS`] numbers.
    pub scalars: &'a [f64],
    /// The configurations.
    pub blocks: &'a [Block],
    /// [`REACH_POINTS`] fractions of the ball's radius in 255ths, by direction: point (a, b, c), c fastest,
    /// stands for the direction (a - 4, b - 4, c - 4). None on the surface of the cube is zero.
    pub reach: &'a [u8],
}

/// Checked planes of a kernel, ready for evaluation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KernelTable<'a> {
    scalars: &'a [f64],
    length_m: f64,
    blocks: &'a [Block],
    reach: Reach<'a>,
    lengths_per_m: f64,
    /// xx, xy, xz, yy, yz, zz of B, N.
    base_n: [f64; 6],
    /// Gradient and value of the sum at rest, N.
    rest_n: ([f64; 3], f64),
}

/// W and its first two derivatives at one displacement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KernelJet {
    /// W, joules.
    pub energy_j: f64,
    /// h, newtons.
    pub force_n: [f64; 3],
    /// S, newtons per metre; symmetric.
    pub stiffness_n_m: [[f64; 3]; 3],
}

impl<'a> KernelTable<'a> {
    /// Checks lengths and values. `radius_m` is the radius of the ball that the reach refers to.
    ///
    /// Errors: [`PlaneError`] with the name of the plane.
    pub fn new(radius_m: f32, planes: KernelPlanes<'a>) -> Result<Self, PlaneError> {
        let KernelPlanes { scalars, blocks, reach } = planes;
        let of_scalars = |index| PlaneProblem::Value { index }.of("kernel scalars");
        check_len("kernel scalars", scalars, SCALARS)?;
        let [length_m, base_n @ ..] = *scalars.first_chunk::<SCALARS>().ok_or(of_scalars(0))?;
        // NaN is in no range.
        if !LENGTHS_M.contains(&length_m) || f64::from(radius_m) > MAX_DISTANCE * length_m {
            return Err(of_scalars(0));
        }
        let is_number = |x: &f64| x.abs() <= LARGEST_N;
        if let Some(index) = base_n.iter().position(|x| !is_number(x)) {
            return Err(of_scalars(index.saturating_add(1)));
        }
        check_len("kernel blocks", blocks, blocks.len().clamp(1, MAX_CENTRES / LANES))?;
        check_values("kernel blocks", blocks, |block| {
            let [x, y, z, numbers @ ..] = block;
            let is_near =
                |((x, y), z): ((&f64, &f64), &f64)| x * x + y * y + z * z <= MAX_DISTANCE * MAX_DISTANCE;
            x.iter().zip(y).zip(z).all(is_near) && numbers.as_flattened().iter().all(is_number)
        })?;
        let reach = Reach::new(radius_m, reach)?;
        // Evaluated with the arithmetic of the tick, so that the force at rest is zero and not a rounding
        // error.
        let rest_n = (sum::gradient(Baseline, blocks, [0.0; 3]), sum::derivatives(blocks, [0.0; 3]).0);
        Ok(Self { scalars, length_m, blocks, reach, lengths_per_m: 1.0 / length_m, base_n, rest_n })
    }

    /// The planes.
    pub(crate) fn planes(&self) -> KernelPlanes<'a> {
        KernelPlanes { scalars: self.scalars, blocks: self.blocks, reach: self.reach.fractions() }
    }

    /// Distance from rest at which the domain ends in the direction of a finite vector, metres.
    pub fn reach_m(&self, direction: Vec3) -> f32 {
        self.reach.range_along_m(direction)
    }

    /// h at a displacement inside the reach, newtons; exactly zero at rest.
    ///
    /// Cost: about 80 products, as many sums and one exponential per configuration, four configurations side
    /// by side.
    #[inline(always)]
    pub fn force<M: Machine>(&self, machine: M, displacement_m: Vec3) -> Vec3 {
        let at = self.in_lengths(displacement_m);
        let [sx, sy, sz] = sum::gradient(machine, self.blocks, at);
        let [bx, by, bz] = self.base(at);
        let ([gx, gy, gz], _) = self.rest_n;
        [(bx + (sx - gx)) as f32, (by + (sy - gy)) as f32, (bz + (sz - gz)) as f32]
    }

    /// W at a displacement inside the reach, joules. Costs as much as the force.
    fn energy_j(&self, displacement_m: Vec3) -> f32 {
        let at = self.in_lengths(displacement_m);
        let (_, value) = sum::gradient_and_value(Baseline, self.blocks, at);
        let ([bx, by, bz], [x, y, z], ([gx, gy, gz], rest)) = (self.base(at), at, self.rest_n);
        let quadratic = 0.5 * (bx * x + by * y + bz * z);
        (self.length_m * (quadratic + (value - rest) - (gx * x + gy * y + gz * z))) as f32
    }

    /// W, h and S at a displacement inside the reach.
    pub fn jet(&self, displacement_m: Vec3) -> KernelJet {
        let at = self.in_lengths(displacement_m);
        let (value, [sx, sy, sz], [[sxx, sxy, sxz], [_, syy, syz], [_, _, szz]]) =
            sum::derivatives(self.blocks, at);
        let ([bx, by, bz], [x, y, z]) = (self.base(at), at);
        let ([gx, gy, gz], e) = self.rest_n;
        let [xx, xy, xz, yy, yz, zz] = self.base_n;
        let (quadratic, linear) = (0.5 * (bx * x + by * y + bz * z), gx * x + gy * y + gz * z);
        let upper = [xx + sxx, xy + sxy, xz + sxz, yy + syy, yz + syz, zz + szz];
        let [xx, xy, xz, yy, yz, zz] = upper.map(|s| s * self.lengths_per_m);
        KernelJet {
            energy_j: self.length_m * (quadratic + (value - e) - linear),
            force_n: [bx + (sx - gx), by + (sy - gy), bz + (sz - gz)],
            stiffness_n_m: [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]],
        }
    }

    #[inline(always)]
    fn in_lengths(&self, [x, y, z]: Vec3) -> [f64; 3] {
        let per_m = self.lengths_per_m;
        [f64::from(x) * per_m, f64::from(y) * per_m, f64::from(z) * per_m]
    }

    /// B x, N.
    #[inline(always)]
    fn base(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let [xx, xy, xz, yy, yz, zz] = self.base_n;
        [xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z]
    }
}

/// The method `kernel`.
#[derive(Clone, Copy)]
pub(crate) struct Kernel<'s> {
    pub(crate) table: &'s KernelTable<'s>,
    /// Spacing of the grid, which determines the continuation.
    pub(crate) spacing_m: f32,
}

impl<'s> Interpolant for Kernel<'s> {
    type Domain = Self;

    #[inline(always)]
    fn force<M: Machine>(self, machine: M, _: Self, displacement_m: &Vec3) -> Vec3 {
        self.table.force(machine, *displacement_m)
    }

    fn slopes(self, _: Self, displacement_m: &Vec3) -> Slopes {
        let jet = self.table.jet(*displacement_m);
        let stiffness_n_m = jet.stiffness_n_m.map(|row| row.map(|s| s as f32));
        Slopes { stiffness_n_m, energy_j: Some(jet.energy_j as f32) }
    }

    fn energy_j(self, _: Self, displacement_m: &Vec3) -> Option<f32> {
        Some(self.table.energy_j(*displacement_m))
    }

    #[inline(always)]
    fn coverage(self, _: Self, _: &Vec3) -> Coverage {
        Coverage::Scattered
    }
}

impl Domain for Kernel<'_> {
    type At = Vec3;

    #[inline(always)]
    fn inside(self, displacement_m: &Vec3) -> Result<Vec3, Vec3> {
        let displacement_m = *displacement_m;
        let reach = &self.table.reach;
        let min_m = reach.min_m();
        // NaN and overflow fail the comparison; a length would ignore a NaN component.
        let is_near = vec3::norm_squared(displacement_m) <= min_m * min_m;
        if is_near || reach.contains(displacement_m) { Ok(displacement_m) } else { Err(displacement_m) }
    }

    fn rim(self, displacement_m: Vec3) -> Rim<Vec3> {
        if !vec3::is_finite(displacement_m) {
            return Rim { at: vec3::ZERO, outward: vec3::ZERO, beyond_m: 0.0 };
        }
        let outward = vec3::normalize_or_zero(displacement_m);
        let reach_m = self.table.reach_m(displacement_m);
        let beyond_m = (vec3::norm(displacement_m) - reach_m).max(0.0);
        Rim { at: vec3::scale(outward, reach_m), outward, beyond_m }
    }

    fn spacing_m(self) -> f32 {
        self.spacing_m
    }
}
