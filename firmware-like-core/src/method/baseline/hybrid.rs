//! Tri-cubic interpolation where the super-cell is complete, tri-linear at the rim.

use super::{Forces, Tricubic, Trilinear};
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
pub(crate) struct Hybrid<'s>(pub(crate) Forces<'s>);

impl<'s> Interpolant for Hybrid<'s> {
    type Domain = Ball<'s>;

    #[inline(always)]
    fn domain(self) -> Ball<'s> {
        self.0.ball
    }

    #[inline(always)]
    fn force<M: Machine>(self, machine: M, at: &Location) -> Vec3 {
        let Self(forces) = self;
        let weight = forces.ball.smooth(INTERIOR, at);
        let linear = if weight < 1.0 { Trilinear(forces).force(machine, at) } else { vec3::ZERO };
        if weight <= 0.0 {
            return linear;
        }
        blend(weight, linear, Tricubic(forces).force(machine, at))
    }

    fn slopes(self, at: &Location) -> Slopes {
        let (linear, cubic) = (Trilinear(self.0), Tricubic(self.0));
        let rows = blend_slopes(
            self.0.ball,
            INTERIOR,
            at,
            || (linear.force(Baseline, at), linear.rows(at)),
            || (cubic.force(Baseline, at), cubic.rows(at)),
        );
        Slopes { stiffness_n_m: self.0.ball.per_metre(rows), energy_j: None }
    }

    /// The slopes of the tri-cubic force, because the tri-linear ones jump at faces.
    fn rim_slopes(self, at: &Location) -> [Vec3; 3] {
        Tricubic(self.0).rim_slopes(at)
    }

    #[inline(always)]
    fn coverage(self, at: &Location) -> Coverage {
        let flags = self.0.ball.cell_flags(at);
        if flags & SUPERCELL != 0 {
            Coverage::SuperCell
        } else if flags & CELL != 0 {
            Coverage::Cell
        } else {
            Coverage::Extrapolated
        }
    }
}
