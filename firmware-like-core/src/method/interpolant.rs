//! The trait of all methods, and the functions defined on it: the force at any displacement, its derivatives,
//! and its continuation outside the domain.
//!
//! Outside the domain the force is continued from the rim, the nearest point q of the domain on the ray from
//! rest:
//!
//! h(p) = h(q) + phi(s) S(q) u,   u = p / |p|,   s = |p - q|
//!
//! phi(s) = s - s^2 / 2c up to s = c, and c / 2 beyond; c is the spacing of the grid. The force is therefore
//! continuous, C1 where the method is, and constant from s = c on. S must be continuous along the rim,
//! otherwise h would jump by an amount that grows with s: see [`Interpolant::rim_slopes`].

use super::{Coverage, Estimate, ForceSample};
use crate::grid::flags::Ball;
use crate::grid::{Location, Rim};
use crate::num::lanes::{Baseline, Machine};
use crate::num::vec3::{self, Vec3};

/// The displacements at which a method has data.
pub(crate) trait Domain: Copy {
    /// A point of the domain, prepared for evaluation.
    type At;

    /// The point of a displacement; outside the domain the error is the displacement, see
    /// [`crate::BallLattice::locate_inside`].
    fn inside(self, displacement_m: &Vec3) -> Result<Self::At, Vec3>;

    /// The point of the rim that is nearest on the ray through a displacement outside.
    fn rim(self, displacement_m: Vec3) -> Rim<Self::At>;

    /// The length c of the continuation, metres.
    fn spacing_m(self) -> f32;
}

/// dh/dd as rows, N/m, and the energy in joules where h is its gradient.
pub(crate) struct Slopes {
    pub(crate) stiffness_n_m: [Vec3; 3],
    pub(crate) energy_j: Option<f32>,
}

/// A method on checked tables. Every number it returns is finite.
///
/// Implementors are small views, passed by value so that the tick keeps them in registers.
pub(crate) trait Interpolant: Copy {
    /// Where the method has data.
    type Domain: Domain;

    /// h at a point of the domain, newtons.
    fn force<M: Machine>(self, machine: M, of: Self::Domain, at: &At<Self>) -> Vec3;

    /// The derivatives of [`Interpolant::force`].
    fn slopes(self, of: Self::Domain, at: &At<Self>) -> Slopes;

    /// W, joules, where the force is its gradient.
    fn energy_j(self, of: Self::Domain, at: &At<Self>) -> Option<f32> {
        let _ = (of, at);
        None
    }

    /// Approximate derivatives of the force that are continuous in the point, N/m.
    fn rim_slopes(self, of: Self::Domain, at: &At<Self>) -> [Vec3; 3] {
        self.slopes(of, at).stiffness_n_m
    }

    /// The data behind the force.
    fn coverage(self, of: Self::Domain, at: &At<Self>) -> Coverage;
}

/// A point of the domain of a method.
type At<I> = <<I as Interpolant>::Domain as Domain>::At;

impl Domain for Ball<'_> {
    type At = Location;

    #[inline(always)]
    fn inside(self, displacement_m: &Vec3) -> Result<Location, Vec3> {
        self.lattice.locate_inside(*displacement_m)
    }

    fn rim(self, displacement_m: Vec3) -> Rim<Location> {
        self.lattice.rim(displacement_m)
    }

    fn spacing_m(self) -> f32 {
        self.lattice.spacing_m()
    }
}

/// The force inside the domain; outside, the error is the displacement, the argument of [`force_outside`].
#[inline(always)]
pub(crate) fn force_inside<I: Interpolant, M: Machine>(
    method: I,
    of: I::Domain,
    machine: M,
    displacement_m: &Vec3,
) -> Result<ForceSample, Vec3> {
    let at = of.inside(displacement_m)?;
    Ok(ForceSample { force_n: method.force(machine, of, &at), coverage: method.coverage(of, &at) })
}

/// The continued force of a method outside its domain.
pub(crate) fn force_outside<I: Interpolant>(method: I, of: I::Domain, displacement_m: Vec3) -> ForceSample {
    let Rim { at, outward, beyond_m } = of.rim(displacement_m);
    let at_rim_n = method.force(Baseline, of, &at);
    let slope_n_m = vec3::transform(&method.rim_slopes(of, &at), outward);
    let force_n = vec3::add(at_rim_n, vec3::scale(slope_n_m, rise_m(beyond_m, of.spacing_m())));
    ForceSample { force_n, coverage: Coverage::Extrapolated }
}

/// phi(s).
fn rise_m(beyond_m: f32, spacing_m: f32) -> f32 {
    if beyond_m < spacing_m { beyond_m - 0.5 * beyond_m * beyond_m / spacing_m } else { 0.5 * spacing_m }
}

/// The energy of a method at any displacement, joules: outside the domain that at the rim and the work from
/// there along the ray.
pub(crate) fn energy_j<I: Interpolant>(method: I, of: I::Domain, displacement_m: &Vec3) -> Option<f32> {
    let outside_m = match of.inside(displacement_m) {
        Ok(at) => return method.energy_j(of, &at),
        Err(outside_m) => outside_m,
    };
    let Rim { at, outward, beyond_m } = of.rim(outside_m);
    let along_n = vec3::dot(method.force(Baseline, of, &at), outward);
    let slope_n_m = vec3::dot(vec3::transform(&method.rim_slopes(of, &at), outward), outward);
    let work_j = along_n * beyond_m + slope_n_m * risen_m2(beyond_m, of.spacing_m());
    Some(method.energy_j(of, &at)? + work_j)
}

/// The integral of phi from 0 to s.
fn risen_m2(beyond_m: f32, spacing_m: f32) -> f32 {
    let bent_m = beyond_m.min(spacing_m);
    0.5 * bent_m * bent_m * (1.0 - bent_m / (3.0 * spacing_m)) + 0.5 * spacing_m * (beyond_m - bent_m)
}

/// The force of a method at any displacement.
fn force<I: Interpolant>(method: I, of: I::Domain, displacement_m: Vec3) -> ForceSample {
    force_inside(method, of, Baseline, &displacement_m)
        .unwrap_or_else(|outside_m| force_outside(method, of, outside_m))
}

/// Force, stiffness and energy of a method at any displacement. Costs a few times as much as the force.
pub(crate) fn estimate<I: Interpolant>(method: I, of: I::Domain, displacement_m: Vec3) -> Estimate {
    let ForceSample { force_n, coverage } = force(method, of, displacement_m);
    let Slopes { stiffness_n_m, energy_j } = match of.inside(&displacement_m) {
        Ok(at) => method.slopes(of, &at),
        Err(_) => Slopes { stiffness_n_m: differences(method, of, displacement_m), energy_j: None },
    };
    Estimate { force_n, stiffness_n_m, energy_j, coverage }
}

/// dh_i/dd_j outside the domain, N/m, by central differences, because the continuation turns with the rim.
fn differences<I: Interpolant>(method: I, of: I::Domain, displacement_m: Vec3) -> [Vec3; 3] {
    // The rounding of 8 N contributes 0.1 N/m, curvature 1/1000 of its contribution over a cell.
    let step_m = 2e-3 * of.spacing_m();
    let column = |axis: usize| {
        let at = |sign: f32| {
            let mut at = displacement_m;
            if let Some(x) = at.get_mut(axis) {
                *x += sign * step_m;
            }
            force(method, of, at).force_n
        };
        vec3::scale(vec3::sub(at(1.0), at(-1.0)), 0.5 / step_m)
    };
    vec3::transposed([column(0), column(1), column(2)])
}
