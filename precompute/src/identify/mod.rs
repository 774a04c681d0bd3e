//! Constants of materials from measured forces: the inverse problem of an indentation.
//!
//! Input: a scene, and a table of places and forces ([`Data`]). The free constants theta minimise
//!
//! sum_i c^2 rho((h(d_i; theta) - f_i)^2 / c^2) / 2
//!
//! with the reaction h of the finite-element solution at the measured place d_i, the measured force f_i and the
//! [`Loss`] rho. dh/dtheta comes with each solution (`fem::constant`), so the fit solves each place once for
//! each value of the constants. The result has standard errors, intervals and correlations, and says what the data
//! cannot tell. An interval contains the errors of the forces, not those of the model: mesh, fixed nodes and law.
//!
//! Source of the method: Peterlik 2010, section 3; Levenberg 1944, Marquardt 1963, More 1978.

mod bounds;
mod data;
mod error;
mod fit;
mod forward;
mod loss;
mod options;
mod report;
mod statistics;

#[cfg(test)]
mod tests;

pub use bounds::Bounds;
pub use data::{Data, Force, Measurement, Places};
pub use error::IdentifyError;
pub use loss::Loss;
pub use options::{Options, Progress};
pub use report::{Identified, Parameter, Row};

use bounds::Variable;
use fit::Fit;
use forward::Forward;
use statistics::rms;

use crate::error::InputError;
use crate::pipeline::Run;
use crate::scene::{ResolvedScene, Scene, SceneConstant};

/// Constants that a law accepts only above zero.
const POSITIVE: [&str; 4] = ["young_pa", "mu_pa", "k1_pa", "bulk_pa"];
/// Bounds of Poisson's ratio of a compressible law.
const POISSON: Bounds = Bounds { low: 0.0, high: 0.4999 };
/// Scale of a robust loss: this multiple of the standard deviation that the median residual shows, as for 95 %
/// efficiency with Gaussian noise.
const ROBUST_SCALE: f64 = 1.345 * 1.4826;
/// Fits with a robust loss, each with the scale of the last one.
const ROBUST_FITS: usize = 3;

/// The free constants that are named.
fn free_constants(
    scene: &Scene,
    data: &Data,
    options: &Options,
) -> Result<Vec<SceneConstant>, IdentifyError> {
    let constants = scene.constants();
    let regions = scene.laws()?;
    let refused = |what: String, fix: String| InputError::new(scene.path(), what, fix);
    let can = || {
        let named = constants.iter().filter(|constant| forward::has_derivative(&regions, constant));
        named.map(|constant| constant.name.as_str()).collect::<Vec<_>>().join(", ")
    };
    let mut free: Vec<SceneConstant> = Vec::new();
    for name in &options.free {
        let known = constants.iter().find(|constant| constant.name == *name);
        let constant = known.ok_or_else(|| {
            refused(format!("no material has the constant `{name}`"), format!("the scene states {}", can()))
        })?;
        if !forward::has_derivative(&regions, constant) {
            let law = regions[constant.region].material.name();
            let what =
                format!("`{name}` of the law \"{law}\" cannot be identified: its energy is not linear in it");
            return Err(refused(what, format!("choose from {}", can())).into());
        }
        if free.contains(constant) {
            return Err(refused(format!("`{name}` is named twice"), "name it once".into()).into());
        }
        free.push(constant.clone());
    }
    if free.is_empty() {
        return Err(refused("no constant is free".into(), format!("choose from {}", can())).into());
    }
    let (measured, wanted) = (data.components(), free.len());
    if measured <= wanted {
        let what = format!("{measured} measured force components for {wanted} constants");
        return Err(
            InputError::new(&data.path, what, "measure at more places, or free fewer constants").into()
        );
    }
    Ok(free)
}

/// The variable of each free constant.
fn variables(
    scene: &Scene,
    free: &[SceneConstant],
    options: &Options,
) -> Result<Vec<Variable>, IdentifyError> {
    if let Some((name, _)) = options.bounds.iter().find(|(name, _)| !free.iter().any(|c| c.name == *name)) {
        let names = free.iter().map(|constant| constant.name.as_str()).collect::<Vec<_>>().join(", ");
        let what = format!("the bounds of `{name}` belong to no free constant");
        return Err(InputError::new(scene.path(), what, format!("free are {names}")).into());
    }
    let variable = |constant: &SceneConstant| {
        let given = options.bounds.iter().find(|(name, _)| *name == constant.name).map(|(_, bounds)| *bounds);
        let usual = match constant.key {
            key if POSITIVE.contains(&key) => Bounds { low: 0.0, ..Bounds::default() },
            "poisson" if constant.value >= 0.0 => POISSON,
            _ => Bounds::default(),
        };
        let bounds = given.unwrap_or(usual);
        let Bounds { low, high } = bounds;
        let (name, value) = (&constant.name, constant.value);
        if low.is_nan() || high.is_nan() || low >= high {
            let what = format!("the bounds {low} to {high} of `{name}` are no interval");
            return Err(InputError::new(scene.path(), what, "give the lower one first").into());
        }
        if !(low..=high).contains(&value) {
            let what = format!("`{name}` = {value} of the scene is not within its bounds {low} to {high}");
            return Err(InputError::new(scene.path(), what, "begin within them").into());
        }
        // A constant that is zero may become as large as a tenth of the largest one of its unit.
        let same = |other: &&SceneConstant| other.key.ends_with("_pa") == constant.key.ends_with("_pa");
        let largest = free.iter().filter(same).map(|other| other.value.abs()).fold(0.0, f64::max);
        let scale = value.abs().max(0.1 * largest);
        let is_positive = POSITIVE.contains(&constant.key);
        Ok(Variable::new(value, bounds, if scale > 0.0 { scale } else { 1.0 }, is_positive))
    };
    free.iter().map(variable).collect()
}

/// Identifies constants of a scene's materials from measured forces. `resolved` is the scene with its mesh.
///
/// `progress` is called from the threads that solve.
///
/// # Errors
///
/// [`IdentifyError`] if scene and table do not fit, a place has no equilibrium with the scene's own constants, the
/// forces do not determine a constant, or the stop flag is raised.
pub fn identify(
    scene: &Scene,
    resolved: &ResolvedScene,
    data: &Data,
    options: &Options,
    run: Run<'_>,
    progress: impl Fn(&Progress) + Sync,
) -> Result<Identified, IdentifyError> {
    let free = free_constants(scene, data, options)?;
    let variables = variables(scene, &free, options)?;
    let mut forward = Forward::new((scene, resolved), &free, data, options.active.as_deref(), run)?;
    if forward.places() < free.len() {
        let what = format!("{} measured places for {} constants", forward.places(), free.len());
        return Err(
            InputError::new(&data.path, what, "measure at more places, or free fewer constants").into()
        );
    }
    data.check_size()?;
    let mut evaluations = 0;
    let start: Vec<f64> = variables.iter().map(Variable::start).collect();
    let mut minimise = |loss, scale, start: &[f64]| {
        let (forward, evaluations, variables) = (&mut forward, &mut evaluations, variables.as_slice());
        let fit = Fit { forward, data, variables, loss, scale, evaluations, progress: &progress };
        fit.minimise(start)
    };
    let mut scale = 1.0;
    let (mut here, mut t, mut is_converged) = minimise(Loss::Linear, scale, &start)?;
    if options.loss != Loss::Linear {
        for _ in 0..ROBUST_FITS {
            scale = robust_scale(&here.residuals);
            (here, t, is_converged) = minimise(options.loss, scale, &t)?;
        }
    }
    let solves = forward.solves;
    let identified = report::report(scene, data, options, &free, &variables, &forward, here, scale)?;
    if !is_converged {
        return Err(IdentifyError::NotConverged { evaluations, rms_share: identified.rms_share });
    }
    Ok(Identified { evaluations, solves, ..identified })
}

/// Scale of a robust loss for these residuals, N.
fn robust_scale(residuals: &[f64]) -> f64 {
    let mut sizes: Vec<f64> = residuals.iter().map(|r| r.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let median = sizes[sizes.len() / 2];
    // Data without noise: any positive scale gives the linear loss.
    let scale = ROBUST_SCALE * median;
    if scale > 0.0 { scale } else { rms(residuals.iter().copied()).max(f64::MIN_POSITIVE) }
}
