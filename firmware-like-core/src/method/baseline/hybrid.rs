//! Tri-cubic interpolation where the super-cell is complete, tri-linear at the rim.

use super::{Tricubic, Trilinear};
use crate::grid::Location;
use crate::grid::flags::{Ball, CELL, INTERIOR, SUPERCELL};
use crate::method::Coverage;
use crate::method::blend::{blend, blend_slopes};
use crate::method::interpolant::{Interpolant, Slopes};
use crate::num::lanes::{Baseline, Machine};
use crate::num::vec3::{self, Vec3};

/// Hybrid estimate of the reaction force.
///
/// Source: Peterlik 2010, section 7. Deviation: the paper switches at the face, where the force would jump;
/// here the two are blended, see `blend`.
#[derive(Clone, Copy)]
pub(crate) struct Hybrid<'s>(pub(crate) &'s [Vec3]);

impl<'s> Interpolant for Hybrid<'s> {
    type Domain = Ball<'s>;

    #[inline(always)]
    fn force<M: Machine>(self, machine: M, ball: Ball<'s>, at: &Location) -> Vec3 {
        let weight = ball.smooth(INTERIOR, at);
        let linear = if weight < 1.0 { Trilinear(self.0).force(machine, ball, at) } else { vec3::ZERO };
        if weight <= 0.0 {
            return linear;
        }
        blend(weight, linear, Tricubic(self.0).force(machine, ball, at))
    }

    fn slopes(self, ball: Ball<'s>, at: &Location) -> Slopes {
        let (linear, cubic) = (Trilinear(self.0), Tricubic(self.0));
        let rows = blend_slopes(
            ball,
            INTERIOR,
            at,
            || (linear.force(Baseline, ball, at), linear.rows(ball, at)),
            || (cubic.force(Baseline, ball, at), cubic.rows(ball, at)),
        );
        Slopes { stiffness_n_m: ball.per_metre(rows), energy_j: None }
    }

    /// The slopes of the tri-cubic force, because the tri-linear ones jump at faces.
    fn rim_slopes(self, ball: Ball<'s>, at: &Location) -> [Vec3; 3] {
        Tricubic(self.0).rim_slopes(ball, at)
    }

    #[inline(always)]
    fn coverage(self, ball: Ball<'s>, at: &Location) -> Coverage {
        let flags = ball.cell_flags(at);
        if flags & SUPERCELL != 0 {
            Coverage::SuperCell
        } else if flags & CELL != 0 {
            Coverage::Cell
        } else {
            Coverage::Extrapolated
        }
    }
}
