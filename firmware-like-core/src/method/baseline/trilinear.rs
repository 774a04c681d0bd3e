//! Tri-linear interpolation in one cell.

use super::run;
use crate::grid::flags::{Ball, CELL};
use crate::grid::{Location, Strides};
use crate::method::Coverage;
use crate::method::baseline::Tricubic;
use crate::method::interpolant::{Interpolant, Slopes};
use crate::num::lanes::{Baseline, F32x4, Machine};
use crate::num::vec3::{self, Vec3};

/// Tri-linear estimate of the reaction force; C0.
///
/// h(p) = sum_c w_c(t) h_c,   c over the 8 corners of the cell
///
/// Cost: 8 loads of three components, 7 linear interpolations, one bounds check.
/// Source: Peterlik 2010, section 4.4, Fig. 1(a). Deviation: unsolved corners have extrapolated forces, so
/// that the force never jumps.
#[derive(Clone, Copy)]
pub(crate) struct Trilinear<'s>(pub(crate) &'s [Vec3]);

impl<'s> Trilinear<'s> {
    /// dh_i/dt_j as rows i.
    pub(super) fn rows(self, ball: Ball<'s>, at: &Location) -> [Vec3; 3] {
        // The force is linear along each axis: its slope is the difference of the two ends.
        let rise = |axis: fn(f32, Vec3) -> Vec3| {
            let [low, high] =
                [0.0, 1.0].map(|end| self.force(Baseline, ball, &Location { t: axis(end, at.t), ..*at }));
            vec3::sub(high, low)
        };
        vec3::transposed([
            rise(|t, [_, y, z]| [t, y, z]),
            rise(|t, [x, _, z]| [x, t, z]),
            rise(|t, [x, y, _]| [x, y, t]),
        ])
    }
}

impl<'s> Interpolant for Trilinear<'s> {
    type Domain = Ball<'s>;

    #[inline(always)]
    fn force<M: Machine>(self, _: M, ball: Ball<'s>, at: &Location) -> Vec3 {
        checked(self.0, ball.lattice.strides(), at.slot as u32, at.t).unwrap_or(vec3::ZERO)
    }

    fn slopes(self, ball: Ball<'s>, at: &Location) -> Slopes {
        Slopes { stiffness_n_m: ball.per_metre(self.rows(ball, at)), energy_j: None }
    }

    /// The slopes of the tri-cubic force, because the tri-linear ones jump at faces.
    fn rim_slopes(self, ball: Ball<'s>, at: &Location) -> [Vec3; 3] {
        Tricubic(self.0).rim_slopes(ball, at)
    }

    #[inline(always)]
    fn coverage(self, ball: Ball<'s>, at: &Location) -> Coverage {
        if ball.cell_flags(at) & CELL != 0 { Coverage::Cell } else { Coverage::Extrapolated }
    }
}

/// `None` beyond the end of the table, which a checked table never reaches.
#[inline(always)]
fn checked(force: &[Vec3], strides: Strides, slot: u32, t: Vec3) -> Option<Vec3> {
    // The last edge is checked first: if it is in the table, so are the others, and the compiler drops their
    // checks.
    let (slot, side, sheet) = (slot as usize, strides.side as usize, strides.sheet as usize);
    let d = edge(force, slot.wrapping_add(sheet).wrapping_add(side))?;
    let c = edge(force, slot.wrapping_add(sheet))?;
    let b = edge(force, slot.wrapping_add(side))?;
    let a = edge(force, slot)?;
    let [tx, ty, tz] = t;
    let t = F32x4::new([tx, ty, tz, tz]);
    let s = F32x4::splat(1.0) - t;
    let (x, y, z) = (
        (s.spread::<0>(), t.spread::<0>()),
        (s.spread::<1>(), t.spread::<1>()),
        (s.spread::<2>(), t.spread::<2>()),
    );
    let near = mix([mix(a, z), mix(b, z)], y);
    let far = mix([mix(c, z), mix(d, z)], y);
    let h = mix([near, far], x);
    Some([h.get::<0>(), h.get::<1>(), h.get::<2>()])
}

/// The two ends of an edge along z. The fourth lane holds the next value of the table and is not used.
#[inline(always)]
fn edge(force: &[Vec3], at: usize) -> Option<[F32x4; 2]> {
    let values = run::<3>(force, at)?.as_flattened();
    Some([F32x4::load(values.first_chunk()?), F32x4::load(values.get(3..)?.first_chunk()?)])
}

/// (1 - t) a + t b
#[inline(always)]
fn mix([a, b]: [F32x4; 2], (s, t): (F32x4, F32x4)) -> F32x4 {
    s * a + t * b
}
