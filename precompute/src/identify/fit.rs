//! The least-squares fit by Levenberg and Marquardt's method (crate `levenberg-marquardt`, a port of MINPACK's LMDER).

use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt, TerminationReason};
// The version of the crate's own interface.
use nalgebra_of_levenberg_marquardt::{DMatrix, DVector, Dyn, Owned};

use super::bounds::Variable;
use super::data::{Data, Force, Measurement};
use super::error::IdentifyError;
use super::forward::{Forward, Reaction};
use super::loss::Loss;
use super::options::Progress;
use super::statistics::rms;
use crate::num::vector::dot;

/// Largest number of evaluations, for each variable and one more.
const PATIENCE: usize = 25;
/// The fit ends when the sum of squares, or the variables, change by less than this share.
const FTOL: f64 = 1e-10;
const XTOL: f64 = 1e-7;
/// Residuals of values that the law or the solver refuses, as a multiple of the last accepted ones: the step is then
/// shortened.
const REFUSED: f64 = 1e3;

/// Residuals and their derivatives at some values of the constants.
#[derive(Debug, Clone)]
pub(super) struct Evaluated {
    /// Values of the constants.
    pub values: Vec<f64>,
    /// Force of the model on the body, N, row by row.
    pub forces_n: Vec<[f64; 3]>,
    /// Model less measurement, N, component by component.
    pub residuals: Vec<f64>,
    /// Derivatives of the residuals by the constants, N per unit, one row for each residual.
    pub slopes: Vec<Vec<f64>>,
}

impl Evaluated {
    fn of(data: &Data, values: Vec<f64>, reactions: &[Reaction]) -> Self {
        let (mut residuals, mut slopes) = (Vec::new(), Vec::new());
        for (row, reaction) in data.rows.iter().zip(reactions) {
            residuals.extend(parts(data, row, reaction.force_n, true));
            let by: Vec<Vec<f64>> =
                reaction.by_constants.iter().map(|by| parts(data, row, *by, false)).collect();
            let components = by.first().map_or(0, Vec::len);
            slopes.extend((0..components).map(|i| by.iter().map(|by| by[i]).collect::<Vec<f64>>()));
        }
        let forces_n = reactions.iter().map(|reaction| reaction.force_n).collect();
        Self { values, forces_n, residuals, slopes }
    }
}

/// The measured components of a force of the model, less the measurement if asked for.
fn parts(data: &Data, row: &Measurement, force: [f64; 3], less_measured: bool) -> Vec<f64> {
    let share = f64::from(u8::from(less_measured));
    match row.force_n {
        Force::Vector(measured) => (0..3).map(|k| force[k] - share * measured[k]).collect(),
        Force::Along(measured) => vec![dot(force, data.direction.unwrap_or_default()) - share * measured],
    }
}

/// A fit.
pub(super) struct Fit<'f, 'a, P> {
    pub forward: &'f mut Forward<'a>,
    pub data: &'f Data,
    pub variables: &'f [Variable],
    pub loss: Loss,
    /// Scale of the loss, N.
    pub scale: f64,
    /// Number of evaluations.
    pub evaluations: &'f mut usize,
    pub progress: &'f P,
}

impl<P: Fn(&Progress) + Sync> Fit<'_, '_, P> {
    /// Evaluates the forward problem at values of the variables.
    fn evaluate(&mut self, t: &[f64], rms_n: Option<f64>) -> Result<Evaluated, IdentifyError> {
        let values: Vec<f64> = self.variables.iter().zip(t).map(|(variable, &t)| variable.at(t).0).collect();
        *self.evaluations += 1;
        let evaluation = *self.evaluations;
        let tick = |solved, places| (self.progress)(&Progress { evaluation, solved, places, rms_n });
        let reactions = self.forward.reactions(&values, &tick)?;
        Ok(Evaluated::of(self.data, values, &reactions))
    }

    /// The values with the smallest loss, from the variables `start`; and whether the fit has converged.
    pub(super) fn minimise(mut self, start: &[f64]) -> Result<(Evaluated, Vec<f64>, bool), IdentifyError> {
        let here = self.evaluate(start, None)?;
        self.data.check_sign(&here.forces_n)?;
        let t = DVector::from_column_slice(start);
        let best = (t.clone(), here.clone());
        let state = State { t, here, best, refused: false, failure: None, fit: self };
        let method =
            LevenbergMarquardt::new().with_ftol(FTOL).with_xtol(XTOL).with_gtol(FTOL).with_patience(PATIENCE);
        let (state, report) = method.minimize(state);
        match state.failure {
            Some(failure) => Err(failure),
            None => {
                // No progress is possible at the rounding of the forces: the same end as convergence.
                let is_rounding = matches!(report.termination, TerminationReason::NoImprovementPossible(_));
                let done = report.termination.was_successful() || is_rounding;
                let (t, best) = state.best;
                Ok((best, t.as_slice().to_vec(), done))
            }
        }
    }
}

/// The fit at the present variables.
struct State<'f, 'a, P> {
    fit: Fit<'f, 'a, P>,
    t: DVector<f64>,
    /// The last values that could be evaluated.
    here: Evaluated,
    /// The values with the smallest loss.
    best: (DVector<f64>, Evaluated),
    /// Whether the present values were refused, by the law or the solver.
    refused: bool,
    failure: Option<IdentifyError>,
}

impl<P: Fn(&Progress) + Sync> State<'_, '_, P> {
    fn transformed(&self, r: f64) -> (f64, f64) {
        self.fit.loss.transformed(r, self.fit.scale)
    }

    /// Twice the loss.
    fn loss(&self, of: &Evaluated) -> f64 {
        of.residuals.iter().map(|&r| self.transformed(r).0.powi(2)).sum()
    }
}

impl<P: Fn(&Progress) + Sync> LeastSquaresProblem<f64, Dyn, Dyn> for State<'_, '_, P> {
    type ParameterStorage = Owned<f64, Dyn>;
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, Dyn>;

    fn set_params(&mut self, t: &DVector<f64>) {
        if *t == self.t && !self.refused {
            return;
        }
        self.t.copy_from(t);
        // After a step that was not taken the method goes back.
        if *t == self.best.0 {
            (self.here, self.refused) = (self.best.1.clone(), false);
            return;
        }
        let rms_n = rms(self.best.1.residuals.iter().copied());
        match self.fit.evaluate(t.as_slice(), Some(rms_n)) {
            Ok(here) => {
                if self.loss(&here) < self.loss(&self.best.1) {
                    self.best = (t.clone(), here.clone());
                }
                (self.here, self.refused) = (here, false);
            }
            Err(failure) if failure.is_of_the_values() => self.refused = true,
            Err(failure) => self.failure = Some(failure),
        }
    }

    fn params(&self) -> DVector<f64> {
        self.t.clone()
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        let factor = if self.refused { REFUSED } else { 1.0 };
        let values = self.here.residuals.iter().map(|&r| factor * self.transformed(r).0);
        self.failure.is_none().then(|| DVector::from_iterator(self.here.residuals.len(), values))
    }

    fn jacobian(&self) -> Option<DMatrix<f64>> {
        let (m, p) = (self.here.residuals.len(), self.t.len());
        let slopes: Vec<f64> =
            self.fit.variables.iter().zip(self.t.iter()).map(|(variable, &t)| variable.at(t).1).collect();
        let weights: Vec<f64> = self.here.residuals.iter().map(|&r| self.transformed(r).1).collect();
        Some(DMatrix::from_fn(m, p, |i, k| weights[i] * self.here.slopes[i][k] * slopes[k]))
    }
}
