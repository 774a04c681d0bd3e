//! Tri-cubic interpolation on the 64 points of the super-cell: tensor product of Catmull-Rom splines.
//!
//! The slopes of this cubic at a node are the central differences of its neighbours on the axis, for every
//! cell that contains the node. Therefore the force is C1, and the hand feels no kink at a face. The
//! tri-cubic of Lekien and Marsden, to which the paper refers, is the same polynomial if its derivatives are
//! central differences; the paper does not state which it used. The tensor Lagrange cubic is slightly more
//! accurate, but only C0: its slope jumps at every face.

use super::run;
use crate::grid::flags::{Ball, SUPERCELL};
use crate::grid::{Location, Strides};
use crate::method::Coverage;
use crate::method::interpolant::{Interpolant, Slopes};
use crate::num::lanes::{F32x4, Machine};
use crate::num::vec3::{self, Vec3};

/// Tri-cubic estimate of the reaction force; C1.
///
/// h(p) = sum_abc w_a(tx) w_b(ty) w_c(tz) h_abc,   a, b, c in -1..=2 round the low corner of the cell
///
/// Cost: 16 rows of 12 values, contracted along z last so that rows stay whole vectors. One bounds check.
/// Source: Peterlik 2010, section 4.4, Fig. 1(b). Deviation: unsolved points have extrapolated forces, so
/// that the force never jumps.
#[derive(Clone, Copy)]
pub(crate) struct Tricubic<'s>(pub(crate) &'s [Vec3]);

impl Tricubic<'_> {
    /// dh_i/dt_j as rows i.
    pub(super) fn rows(self, ball: Ball<'_>, at: &Location) -> [Vec3; 3] {
        let (values, slopes) = (weights(at.t), weight_slopes(at.t));
        let along = |axis: usize| {
            let mut lanes = values;
            for (value, slope) in lanes.iter_mut().zip(slopes) {
                let pick = |lane: usize, value: f32, slope: f32| if lane == axis { slope } else { value };
                *value = F32x4::new([
                    pick(0, value.get::<0>(), slope.get::<0>()),
                    pick(1, value.get::<1>(), slope.get::<1>()),
                    pick(2, value.get::<2>(), slope.get::<2>()),
                    0.0,
                ]);
            }
            checked(self.0, ball.lattice.strides(), at.slot as u32, &lanes).unwrap_or(vec3::ZERO)
        };
        vec3::transposed([along(0), along(1), along(2)])
    }
}

impl<'s> Interpolant for Tricubic<'s> {
    type Domain = Ball<'s>;

    #[inline(always)]
    fn force<M: Machine>(self, _: M, ball: Ball<'s>, at: &Location) -> Vec3 {
        checked(self.0, ball.lattice.strides(), at.slot as u32, &weights(at.t)).unwrap_or(vec3::ZERO)
    }

    fn slopes(self, ball: Ball<'s>, at: &Location) -> Slopes {
        Slopes { stiffness_n_m: ball.per_metre(self.rows(ball, at)), energy_j: None }
    }

    #[inline(always)]
    fn coverage(self, ball: Ball<'s>, at: &Location) -> Coverage {
        let is_complete = ball.cell_flags(at) & SUPERCELL != 0;
        if is_complete { Coverage::SuperCell } else { Coverage::Extrapolated }
    }
}

/// Catmull-Rom weights of the points -1, 0, 1, 2 at t in [0, 1], one lane per axis. Their sum is 1;
/// quadratics are reproduced.
#[inline(always)]
fn weights([tx, ty, tz]: Vec3) -> [F32x4; 4] {
    let t = F32x4::new([tx, ty, tz, tz]);
    let s = F32x4::splat(1.0) - t;
    let outer = F32x4::splat(-0.5) * t * s;
    let middle = |t: F32x4| F32x4::splat(1.0) + t * t * (F32x4::splat(1.5) * t - F32x4::splat(2.5));
    [outer * s, middle(t), middle(s), outer * t]
}

/// Derivatives of [`weights`].
fn weight_slopes([tx, ty, tz]: Vec3) -> [F32x4; 4] {
    let t = F32x4::new([tx, ty, tz, tz]);
    let [one, half, three] = [1.0, 0.5, 3.0].map(F32x4::splat);
    let s = one - t;
    let middle = |t: F32x4| t * (F32x4::splat(4.5) * t - F32x4::splat(5.0));
    let outer = |t: F32x4, s: F32x4| half * s * (three * t - one);
    [outer(t, s), middle(t), F32x4::splat(0.0) - middle(s), F32x4::splat(0.0) - outer(s, t)]
}

/// Contracts rows of twelve values (four points along z) along x and y, then along z.
///
/// `None` beyond the end of the table, which a checked table never reaches.
#[inline(always)]
fn checked(force: &[Vec3], strides: Strides, slot: u32, weights: &[F32x4; 4]) -> Option<Vec3> {
    let (side, sheet) = (strides.side as usize, strides.sheet as usize);
    let first = slot.wrapping_sub(strides.sheet.wrapping_add(strides.side).wrapping_add(1)) as usize;
    let [x0, x1, x2, x3] = weights.map(F32x4::spread::<0>);
    let wy = weights.map(F32x4::spread::<1>);
    let [z0, z1, z2, z3] = weights.map(F32x4::spread::<2>);
    // One bounds check: the compiler derives the others from it.
    let force = force.get(first..)?.get(..3 * sheet + 3 * side + 4)?;
    let [a0, a1, a2] = contract_y(force, side, 0, &wy)?;
    let [b0, b1, b2] = contract_y(force, side, sheet, &wy)?;
    let [c0, c1, c2] = contract_y(force, side, 2 * sheet, &wy)?;
    let [d0, d1, d2] = contract_y(force, side, 3 * sheet, &wy)?;
    let wx = [x0, x1, x2, x3];
    let twelve = [sum(wx, [a0, b0, c0, d0]), sum(wx, [a1, b1, c1, d1]), sum(wx, [a2, b2, c2, d2])];
    let h = sum([z0, z1, z2, z3], F32x4::points(twelve));
    Some([h.get::<0>(), h.get::<1>(), h.get::<2>()])
}

/// Twelve values along z of one sheet, contracted along y.
#[inline(always)]
fn contract_y(force: &[Vec3], side: usize, at: usize, wy: &[F32x4; 4]) -> Option<[F32x4; 3]> {
    let ([a0, a1, a2], [b0, b1, b2]) = (twelve(force, at)?, twelve(force, at + side)?);
    let ([c0, c1, c2], [d0, d1, d2]) = (twelve(force, at + 2 * side)?, twelve(force, at + 3 * side)?);
    Some([sum(*wy, [a0, b0, c0, d0]), sum(*wy, [a1, b1, c1, d1]), sum(*wy, [a2, b2, c2, d2])])
}

/// x, y and z at four points along z.
#[inline(always)]
fn twelve(force: &[Vec3], at: usize) -> Option<[F32x4; 3]> {
    let [a, b, c] = run::<4>(force, at)?.as_flattened().as_chunks::<4>().0.first_chunk()?;
    Some([F32x4::load(a), F32x4::load(b), F32x4::load(c)])
}

#[inline(always)]
fn sum([w0, w1, w2, w3]: [F32x4; 4], [a, b, c, d]: [F32x4; 4]) -> F32x4 {
    (w0 * a + w1 * b) + (w2 * c + w3 * d)
}
