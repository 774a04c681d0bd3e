//! The energy as the sum of Gaussians that was fitted to it, evaluated as it is: no table, no cell.
//!
//! W(x) = l [x . B x / 2 + sum_n E_n P_n(x - x_n) - g . x - e],   E_n = exp(-|x - x_n|^2 / 2),   x = p / l
//!
//! h = dW/dp = B x + sum_n E_n (grad P_n - r P_n) - g,   r = x - x_n
//!
//! p is the displacement, l the kernel's length, B x the force of the body's stiffness at rest, and P_n a polynomial of the third degree: 20
//! numbers a configuration. They are the weights of a Hermite-Birkhoff fit of W, h, S and the third derivatives (Wendland, Scattered Data
//! Approximation, 2004, chapter 16), whose b-th derivative of the Gaussian is He_b(r) E: the sum over b is E times a polynomial, and
//! takes a fifth of the operations. g and e are what the sum is at rest, so that there is neither force nor energy there.
//!
//! The force is the exact gradient of W and W is smooth: no work on a closed path, whatever the error, and no face to cross.
//!
//! A sum of Gaussians goes to zero where it has no data, and may do anything on the way. So a kernel speaks within its [`Reach`] alone;
//! beyond it the force goes on as every method's does beyond the ball ([`crate::continuation`]), and is `Extrapolated`.
//!
//! Terms are thousands of times their sum, so all of it is f64: in f32 it costs newtons (docs/theory.md, section 12).

mod exponential;
mod reach;
mod sum;

pub use reach::{REACH_POINTS, REACH_SIDE, Reach};

use crate::lanes::{Baseline, Machine};
use crate::table::{TableError, check_len};
use crate::vec3::Vec3;

/// Configurations side by side in a block.
pub const LANES: usize = 4;

/// Numbers of a configuration: its position (x, y, z, in lengths), then the derivatives of its polynomial at the configuration, N, in the
/// order 1, x, y, z, xx, xy, xz, yy, yz, zz, xxx, xxy, xxz, xyy, xyz, xzz, yyy, yyz, yzz, zzz.
pub const NUMBERS: usize = 23;

/// Four configurations, number by number; a block that is not full ends with zeros.
pub type Block = [[f64; LANES]; NUMBERS];

/// Configurations of a kernel, at most: a tick's time grows with them. The search for them ends at 160.
pub const MOST_CENTRES: usize = 256;

/// l in metres, then xx, xy, xz, yy, yz, zz of B = l S(0), N.
pub const SCALARS: usize = 7;

/// How far a configuration or the ball's rim may be from rest, lengths: then every exponent is a normal number, see `exponential.rs`.
pub const FARTHEST: f64 = 16.0;

/// Largest number of a polynomial or of B, N: absurd, and its sums cannot overflow.
const LARGEST_N: f64 = 1e15;

/// Smallest and largest l, m.
const LENGTHS_M: core::ops::RangeInclusive<f64> = 1e-6..=1e3;

/// A kernel that was checked: see the module.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KernelTable<'a> {
    scalars: &'a [f64],
    blocks: &'a [Block],
    reach: Reach<'a>,
    lengths_per_m: f64,
    /// xx, xy, xz, yy, yz, zz of B, N.
    base_n: [f64; 6],
    /// What the sum is at rest: gradient and value, N.
    rest_n: ([f64; 3], f64),
}

/// W and its first two derivatives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KernelJet {
    /// W, J.
    pub energy_j: f64,
    /// h, N.
    pub force_n: [f64; 3],
    /// S, N/m, symmetric.
    pub stiffness_n_m: [[f64; 3]; 3],
}

impl<'a> KernelTable<'a> {
    /// Checks lengths and values. `reach` has [`REACH_POINTS`] bytes, shares of `radius_m`.
    pub fn new(
        radius_m: f32,
        scalars: &'a [f64],
        blocks: &'a [Block],
        reach: &'a [u8],
    ) -> Result<Self, TableError> {
        check_len(scalars, SCALARS)?;
        let wrong = |index| TableError::NotFinite { index };
        let [length_m, base_n @ ..] = *scalars.first_chunk::<SCALARS>().ok_or(wrong(0))?;
        // NaN is in no range.
        if !LENGTHS_M.contains(&length_m) || f64::from(radius_m) > FARTHEST * length_m {
            return Err(wrong(0));
        }
        let is_number = |x: &f64| x.abs() <= LARGEST_N;
        if let Some(index) = base_n.iter().position(|x| !is_number(x)) {
            return Err(wrong(index.saturating_add(1)));
        }
        let need = blocks.len().clamp(1, MOST_CENTRES / LANES);
        check_len(blocks, need)?;
        let is_sound = |block: &Block| {
            let [x, y, z, numbers @ ..] = block;
            let near = x.iter().zip(y).zip(z).all(|((x, y), z)| x * x + y * y + z * z <= FARTHEST * FARTHEST);
            near && numbers.as_flattened().iter().all(is_number)
        };
        if let Some(index) = blocks.iter().position(|block| !is_sound(block)) {
            return Err(wrong(index));
        }
        let reach = Reach::new(radius_m, reach)?;
        // By the very arithmetic of the tick, so that the force at rest is zero and not its rounding.
        let rest_n = (sum::gradient(Baseline, blocks, [0.0; 3]), sum::jet(blocks, [0.0; 3]).0);
        Ok(Self { scalars, blocks, reach, lengths_per_m: 1.0 / length_m, base_n, rest_n })
    }

    /// The kernel's length l, m.
    pub fn length_m(&self) -> f64 {
        self.scalars.first().copied().unwrap_or(1.0)
    }

    /// xx, xy, xz, yy, yz, zz of B = l S(0), N.
    pub const fn base_n(&self) -> &[f64; 6] {
        &self.base_n
    }

    /// The configurations.
    pub const fn blocks(&self) -> &'a [Block] {
        self.blocks
    }

    /// Where it speaks.
    pub const fn reach(&self) -> &Reach<'a> {
        &self.reach
    }

    /// Size of its planes.
    pub const fn bytes(&self) -> usize {
        size_of_val(self.scalars) + size_of_val(self.blocks) + REACH_POINTS
    }

    /// h at a displacement within the ball, N; exactly zero at rest.
    ///
    /// Cost: a configuration takes some 80 products, as many sums and one exponential, four of them side by side.
    #[inline(always)]
    pub fn force<M: Machine>(&self, machine: M, displacement_m: Vec3) -> Vec3 {
        let at = self.in_lengths(displacement_m);
        let [sx, sy, sz] = sum::gradient(machine, self.blocks, at);
        let [bx, by, bz] = self.base(at);
        let ([gx, gy, gz], _) = self.rest_n;
        [(bx + (sx - gx)) as f32, (by + (sy - gy)) as f32, (bz + (sz - gz)) as f32]
    }

    /// W, h and S there: what no tick asks for within reach.
    pub fn jet(&self, displacement_m: Vec3) -> KernelJet {
        let at = self.in_lengths(displacement_m);
        let (value, [sx, sy, sz], [[sxx, sxy, sxz], [_, syy, syz], [_, _, szz]]) = sum::jet(self.blocks, at);
        let ([bx, by, bz], [x, y, z]) = (self.base(at), at);
        let ([gx, gy, gz], e) = self.rest_n;
        let [xx, xy, xz, yy, yz, zz] = self.base_n;
        let (quadratic, linear) = (0.5 * (bx * x + by * y + bz * z), gx * x + gy * y + gz * z);
        let upper = [xx + sxx, xy + sxy, xz + sxz, yy + syy, yz + syz, zz + szz];
        let [xx, xy, xz, yy, yz, zz] = upper.map(|s| s * self.lengths_per_m);
        KernelJet {
            energy_j: self.length_m() * (quadratic + (value - e) - linear),
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
