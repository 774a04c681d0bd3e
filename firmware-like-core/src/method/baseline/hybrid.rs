//! Tri-cubic interpolation where the super-cell is complete, tri-linear at the rim.

use super::{Forces, Tricubic, tricubic, trilinear};
use crate::grid::Location;
use crate::grid::flags::{self, CELL, INTERIOR, SUPERCELL};
use crate::method::Coverage;
use crate::method::blend::{blend, blend_slopes};
use crate::method::interpolant::{Ball, Interpolant, Slopes};
use crate::num::lanes::Machine;
use crate::num::vec3::{self, Vec3};

/// Hybrid estimate of the reaction force.
///
/// Source: Peterlik 2010, section 7. Deviation: the paper switches at the face, where the force would jump;
/// here the two are blended, see [`crate::method::blend`].
#[derive(Clone, Copy)]
pub(crate) struct Hybrid<'s>(pub(crate) Forces<'s>);

impl<'s> Interpolant for Hybrid<'s> {
    type Domain = Ball<'s>;

    #[inline(always)]
    fn domain(self) -> Ball<'s> {
        self.0.ball
    }

    #[inline(always)]
    fn force<M: Machine>(self, _: M, at: &Location) -> Vec3 {
        let Self(Forces { ball, force_n }) = self;
        let strides = ball.lattice.strides();
        let weight = flags::share(ball.flags, INTERIOR, strides, at.slot, at.t);
        let linear =
            if weight < 1.0 { trilinear::interpolate(force_n, strides, at.slot, at.t) } else { vec3::ZERO };
        if weight <= 0.0 {
            return linear;
        }
        blend(weight, linear, tricubic::interpolate(force_n, strides, at.slot, at.t))
    }

    fn slopes(self, at: &Location) -> Slopes {
        let Self(Forces { ball, force_n }) = self;
        let strides = ball.lattice.strides();
        let linear = || {
            let value = trilinear::interpolate(force_n, strides, at.slot, at.t);
            (value, trilinear::slopes(force_n, strides, at.slot, at.t))
        };
        let cubic = || {
            let value = tricubic::interpolate(force_n, strides, at.slot, at.t);
            (value, tricubic::slopes(force_n, strides, at.slot, at.t))
        };
        let rows = blend_slopes(ball, INTERIOR, at, linear, cubic);
        Slopes { stiffness_n_m: ball.per_metre(rows), energy_j: None }
    }

    /// The slopes of the tri-cubic force, because the tri-linear ones jump at faces.
    fn rim_slopes(self, at: &Location) -> [Vec3; 3] {
        Tricubic(self.0).slopes(at).stiffness_n_m
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
