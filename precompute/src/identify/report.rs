//! The result of an identification, with what the data cannot tell.

use nalgebra::DMatrix;
use serde::Serialize;

use super::bounds::Variable;
use super::data::{Data, Force, Measurement};
use super::error::IdentifyError;
use super::fit::Evaluated;
use super::forward::Forward;
use super::options::Options;
use super::statistics::{Precision, Succession, rms};
use crate::scene::{Scene, SceneConstant};

/// Two constants with a larger correlation cannot be told apart if neither is precise.
const MERGED: f64 = 0.95;
/// A constant is imprecise above this relative standard error.
const IMPRECISE: f64 = 0.05;
/// Two constants with a larger correlation are told apart by the last digits of the forces only.
const EQUAL: f64 = 0.9995;

/// An identified constant.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Parameter {
    /// Name, as in the scene.
    pub name: String,
    /// Value, in the unit at the end of the name.
    pub value: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
    /// Standard error; zero at a bound.
    pub standard_error: f64,
    /// Value of the scene, where the fit began.
    pub initial: f64,
    /// Whether the value is at a bound; it then has no interval.
    pub is_at_bound: bool,
}

/// A measured and a computed force.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Line of the table.
    pub line: usize,
    /// Name of the test.
    pub test: String,
    /// Displacement from rest, or of a sphere from the first place of its test, m.
    pub displacement_m: [f64; 3],
    /// Measured force on the body, N; of a single component along the direction, that component.
    pub measured_n: Vec<f64>,
    /// The same components of the model, N.
    pub model_n: Vec<f64>,
}

/// The result.
#[derive(Debug, Clone, Serialize)]
pub struct Identified {
    /// The constants.
    pub parameters: Vec<Parameter>,
    /// Confidence of their intervals.
    pub confidence: f64,
    /// Correlations of the constants, row by row.
    pub correlation: Vec<Vec<f64>>,
    /// RMS residual of a force component, N.
    pub rms_residual_n: f64,
    /// The same over the RMS of the measured components.
    pub rms_share: f64,
    /// Correlation of each residual with the next one of its test.
    pub succession: f64,
    /// Whether the residuals are systematic, so that the model does not describe the data.
    pub is_misfit: bool,
    /// Evaluations of the forward problem.
    pub evaluations: usize,
    /// Solved equilibria.
    pub solves: usize,
    /// What the data cannot tell, one sentence each.
    pub warnings: Vec<String>,
    /// The rows.
    pub rows: Vec<Row>,
    /// The scene with the constants.
    #[serde(skip)]
    pub scene: SceneText,
}

/// A scene with the identified constants.
#[derive(Debug, Clone)]
pub struct SceneText(std::sync::Arc<Scene>);

impl std::ops::Deref for SceneText {
    type Target = Scene;

    fn deref(&self) -> &Scene {
        &self.0
    }
}

/// The result at the solution `here` of a fit whose loss has the scale `scale`.
#[expect(clippy::too_many_arguments, reason = "the parts of one fit")]
pub(super) fn report(
    scene: &Scene,
    data: &Data,
    options: &Options,
    free: &[SceneConstant],
    variables: &[Variable],
    forward: &Forward<'_>,
    here: Evaluated,
    scale: f64,
) -> Result<Identified, IdentifyError> {
    let inner: Vec<usize> = (0..free.len()).filter(|&k| !variables[k].is_at_bound(here.values[k])).collect();
    let jacobian = DMatrix::from_fn(here.residuals.len(), inner.len(), |i, k| here.slopes[i][inner[k]]);
    let precision = (!inner.is_empty())
        .then(|| Precision::of(&jacobian, &here.residuals, (options.loss, scale), options.confidence))
        .transpose()
        .map_err(|column| IdentifyError::Undetermined(free[inner[column]].name.clone()))?;
    let of = |k: usize| Some((inner.iter().position(|&other| other == k)?, precision.as_ref()?));
    let parameter = |(k, constant): (usize, &SceneConstant)| {
        let (value, found) = (here.values[k], of(k));
        let standard_error = found.map_or(0.0, |(own, precision)| precision.standard_errors[own]);
        let half = found.map_or(0.0, |(_, precision)| precision.t * standard_error);
        Parameter {
            name: constant.name.clone(),
            value,
            low: value - half,
            high: value + half,
            standard_error,
            initial: constant.value,
            is_at_bound: found.is_none(),
        }
    };
    let parameters: Vec<Parameter> = free.iter().enumerate().map(parameter).collect();
    let entry = |i: usize, k: usize| match (of(i), of(k)) {
        (Some((a, precision)), Some((b, _))) => precision.correlation[a][b],
        _ => f64::from(u8::from(i == k)),
    };
    let correlation: Vec<Vec<f64>> =
        (0..free.len()).map(|i| (0..free.len()).map(|k| entry(i, k)).collect()).collect();
    let rows = rows(data, forward, &here);
    let measured: Vec<f64> = rows.iter().flat_map(|row| row.measured_n.iter().copied()).collect();
    let rms_residual_n = rms(here.residuals.iter().copied());
    let rms_share = rms_residual_n / rms(measured.iter().copied()).max(f64::MIN_POSITIVE);
    let succession = Succession::of(&sequences(&rows));
    let is_misfit = succession.is_systematic(rms_share);
    let mut warnings = merged(&parameters, &inner, precision.as_ref());
    warnings.extend(parameters.iter().filter(|parameter| parameter.is_at_bound).map(|parameter| {
        let Parameter { name, value, .. } = parameter;
        format!("`{name}` = {} is at its bound and has no interval", short(*value))
    }));
    if is_misfit {
        warnings.push(format!(
            "the residuals are systematic (correlation {:.2} from row to row, RMS {:.1} % of the forces): the law, the mesh or \
             the fixed part does not describe the data, and the intervals do not contain that error",
            succession.correlation,
            100.0 * rms_share
        ));
    }
    warnings.extend(forward.doubt_of_direction(data));
    let values: Vec<(&SceneConstant, f64)> = free.iter().zip(here.values.iter().copied()).collect();
    let fitted = scene.with_constants(&values)?;
    warnings.extend(fitted.laws()?.iter().flat_map(|region| region.material.warnings()));
    Ok(Identified {
        parameters,
        confidence: options.confidence,
        correlation,
        rms_residual_n,
        rms_share,
        succession: succession.correlation,
        is_misfit,
        evaluations: 0,
        solves: 0,
        warnings,
        rows,
        scene: SceneText(std::sync::Arc::new(fitted)),
    })
}

fn rows(data: &Data, forward: &Forward<'_>, here: &Evaluated) -> Vec<Row> {
    let mut residuals = here.residuals.iter();
    let row = |(row, moved): (&Measurement, &[f64; 3])| {
        let measured_n = match row.force_n {
            Force::Vector(force) => force.to_vec(),
            Force::Along(force) => vec![force],
        };
        let model_n = measured_n.iter().zip(residuals.by_ref()).map(|(f, r)| f + r).collect();
        Row { line: row.line, test: row.test.clone(), displacement_m: *moved, measured_n, model_n }
    };
    data.rows.iter().zip(forward.moved_m()).map(row).collect()
}

/// The residuals of each component of each test, in the order of the rows.
fn sequences(rows: &[Row]) -> Vec<Vec<f64>> {
    let mut tests: Vec<&str> = rows.iter().map(|row| row.test.as_str()).collect();
    tests.sort_unstable();
    tests.dedup();
    let mut sequences = Vec::new();
    for test in tests {
        for component in 0..3 {
            let of_test = rows.iter().filter(|row| row.test == test);
            let residual = |row: &Row| Some(row.model_n.get(component)? - row.measured_n[component]);
            sequences.push(of_test.filter_map(residual).collect());
        }
    }
    sequences
}

/// Pairs of constants that the data cannot tell apart, with the combination that they determine.
fn merged(parameters: &[Parameter], inner: &[usize], precision: Option<&Precision>) -> Vec<String> {
    let Some(precision) = precision else { return Vec::new() };
    let mut warnings = Vec::new();
    for (a, &i) in inner.iter().enumerate() {
        for (b, &k) in inner.iter().enumerate().skip(a + 1) {
            let correlation = precision.correlation[a][b];
            let (one, other) = (&parameters[i], &parameters[k]);
            let relative = |p: &Parameter| p.standard_error / p.value.abs().max(f64::MIN_POSITIVE);
            let is_precise = relative(one).max(relative(other)) < IMPRECISE && correlation.abs() < EQUAL;
            if correlation.abs() < MERGED || is_precise {
                continue;
            }
            let (weight, error) = precision.combination(a, b);
            let sum = one.value + weight * other.value;
            warnings.push(format!(
                "the data hardly tell `{}` and `{}` apart (correlation {correlation:.3}): only {} {} {:.3} {} = {} +- {} \
                 is known well; press deeper, add another direction, or fix one of them",
                one.name,
                other.name,
                one.name,
                if weight < 0.0 { "-" } else { "+" },
                weight.abs(),
                other.name,
                short(sum),
                short(precision.t * error)
            ));
        }
    }
    warnings
}

/// A number with five significant digits.
fn short(value: f64) -> String {
    let digits = format!("{value:.4e}");
    if value != 0.0 && !(1e-3..1e7).contains(&value.abs()) {
        return digits;
    }
    digits.parse::<f64>().unwrap_or(value).to_string()
}
