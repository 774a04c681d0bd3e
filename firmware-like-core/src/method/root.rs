//! The energy of a sphere by its root: h = max(0, s) ds/dp, W = max(0, s)^2 / 2.
//!
//! s = sqrt(2 W) is interpolated by the quintics of [`super::energy`], in whose table it takes the place of W. It rises
//! linearly from the first touch, where W has no third derivatives, and is continued below zero beside the body. The
//! force is the exact gradient of the energy and continuous; beside the body it is exactly zero.

use super::Coverage;
use super::energy::{Energy, value_and_gradient};
use super::hermite::{Hermite, HermitePlanes};
use super::interpolant::{Domain, Interpolant, Slopes};
use crate::grid::flags::{Ball, CELL};
use crate::grid::{BallLattice, Location, Rim};
use crate::num::lanes::{Baseline, Machine};
use crate::num::vec3::{self, Vec3};

impl HermitePlanes<'_> {
    /// h of the interpolated root at a location, newtons.
    pub fn root_force(&self, lattice: &BallLattice, at: &Location) -> Vec3 {
        Root(Hermite(self)).force(Baseline, Known(Ball { lattice, flags: &[] }), at)
    }
}

/// Steps from outside towards the origin until a cell is known, of half a cell, and halvings of the last one.
const STEPS: u8 = 64;
const HALVINGS: u8 = 6;

/// The cells of a chart whose corners are all known: a column, and not the ball of its lattice.
#[derive(Clone, Copy)]
pub(crate) struct Known<'s>(pub(crate) Ball<'s>);

impl Known<'_> {
    fn place(self, displacement_m: Vec3) -> Option<Location> {
        let at = self.0.lattice.locate_inside(displacement_m).ok()?;
        (self.0.cell_flags(&at) & CELL != 0).then_some(at)
    }
}

impl Domain for Known<'_> {
    type At = Location;

    #[inline(always)]
    fn inside(self, displacement_m: &Vec3) -> Result<Location, Vec3> {
        self.place(*displacement_m).ok_or(*displacement_m)
    }

    /// The last known point on the way from the origin; the origin if none is.
    fn rim(self, displacement_m: Vec3) -> Rim<Location> {
        let lattice = self.0.lattice;
        let (outward, length_m) = (vec3::normalize_or_zero(displacement_m), vec3::norm(displacement_m));
        let at = |way_m: f32| self.place(vec3::scale(outward, way_m));
        let mut outer_m = length_m.min(lattice.radius_m());
        let mut inner_m = outer_m;
        for _ in 0..STEPS {
            if inner_m <= 0.0 || at(inner_m).is_some() {
                break;
            }
            outer_m = inner_m;
            inner_m = (inner_m - 0.5 * lattice.spacing_m()).max(0.0);
        }
        for _ in 0..HALVINGS {
            let middle_m = 0.5 * (inner_m + outer_m);
            if at(middle_m).is_some() { inner_m = middle_m } else { outer_m = middle_m }
        }
        let rim_m = vec3::scale(outward, inner_m);
        let found = lattice.locate_inside(rim_m).unwrap_or_else(|rim_m| lattice.rim(rim_m).at);
        let beyond_m = if length_m > inner_m { length_m - inner_m } else { 0.0 };
        Rim { at: found, outward, beyond_m }
    }

    fn spacing_m(self) -> f32 {
        self.0.lattice.spacing_m()
    }
}

/// The method `energy` of a sphere.
#[derive(Clone, Copy)]
pub(crate) struct Root<'s>(pub(crate) Hermite<'s>);

impl Root<'_> {
    /// s and ds/dp; zero beyond the end of the box.
    #[inline(always)]
    fn root<M: Machine>(self, machine: M, ball: Ball<'_>, at: &Location) -> (f32, Vec3) {
        let Some(corners) = self.0.corners(ball, at) else { return (0.0, vec3::ZERO) };
        let (value, gradient) = value_and_gradient(machine, &corners, at.t);
        (value * ball.lattice.spacing_m(), gradient)
    }
}

impl<'s> Interpolant for Root<'s> {
    type Domain = Known<'s>;

    #[inline(always)]
    fn force<M: Machine>(self, machine: M, Known(ball): Known<'s>, at: &Location) -> Vec3 {
        let (root, slope) = self.root(machine, ball, at);
        vec3::scale(slope, root.max(0.0))
    }

    fn slopes(self, Known(ball): Known<'s>, at: &Location) -> Slopes {
        let found = Energy(self.0).derivatives(ball, at);
        let root = found.value * ball.lattice.spacing_m();
        if root <= 0.0 {
            return Slopes { stiffness_n_m: [vec3::ZERO; 3], energy_j: Some(0.0) };
        }
        let bent = ball.per_metre(found.hessian.map(|row| vec3::scale(row, root)));
        let mut stiffness_n_m = bent;
        for (row, along) in stiffness_n_m.iter_mut().zip(found.gradient) {
            *row = vec3::add(*row, vec3::scale(found.gradient, along));
        }
        Slopes { stiffness_n_m, energy_j: Some(0.5 * root * root) }
    }

    fn energy_j(self, Known(ball): Known<'s>, at: &Location) -> Option<f32> {
        let root = self.root(Baseline, ball, at).0.max(0.0);
        Some(0.5 * root * root)
    }

    #[inline(always)]
    fn coverage(self, Known(ball): Known<'s>, at: &Location) -> Coverage {
        self.0.coverage(ball, at)
    }
}
