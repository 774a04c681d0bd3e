//! Constants of a scene's materials from measured forces, as `palpate identify` finds them.

use std::path::PathBuf;

use palpate_precompute::identify::{Bounds, Data, IdentifyError, Loss, Options, identify as fit};
use pyo3::prelude::*;

use crate::failure::Failure;
use crate::running::{interruptible, threads};
use crate::scene::Scene;

impl From<IdentifyError> for Failure {
    fn from(error: IdentifyError) -> Self {
        if error.is_bad_input() { Self::input(error) } else { Self::work(error) }
    }
}

/// The loss of this name.
fn loss(name: &str) -> Result<Loss, Failure> {
    match name {
        "linear" => Ok(Loss::Linear),
        "soft-l1" => Ok(Loss::SoftL1),
        "huber" => Ok(Loss::Huber),
        _ => Err(Failure::input(format!("loss = \"{name}\"; use \"linear\", \"soft-l1\" or \"huber\""))),
    }
}

/// Identifies constants, see `palpate.Scene.identify`. Returns the result as JSON, and the scene with the
/// constants.
///
/// The table is the file at `path`, or `table` with the name `path` in errors.
#[pyfunction]
#[pyo3(signature = (scene, path, table, free, bounds, loss, confidence, active=None, direction=None, progress=None, threads=None))]
#[expect(clippy::too_many_arguments, reason = "the keywords of a function in Python")]
pub(crate) fn identify(
    py: Python<'_>,
    scene: &Scene,
    path: PathBuf,
    table: Option<&str>,
    free: Vec<String>,
    bounds: Vec<(String, f64, f64)>,
    loss: &str,
    confidence: f64,
    active: Option<String>,
    direction: Option<[f64; 3]>,
    progress: Option<Bound<'_, PyAny>>,
    threads: Option<usize>,
) -> Result<(String, Scene), Failure> {
    let threads = self::threads(threads)?;
    if !(confidence > 0.0 && confidence < 1.0) {
        return Err(Failure::input(format!("confidence = {confidence}; give a share between 0 and 1")));
    }
    let direction = direction.map(unit).transpose()?;
    let data = match table {
        Some(table) => Data::parse(&path, table.as_bytes(), direction)?,
        None => Data::read(&path, direction)?,
    };
    let bounds = bounds.into_iter().map(|(name, low, high)| (name, Bounds { low, high })).collect();
    let options = Options { free, bounds, loss: self::loss(loss)?, confidence, active };
    let found = interruptible(py, threads, progress.as_ref(), |run, report| {
        let told = |at: &palpate_precompute::identify::Progress| {
            report(("places of an evaluation", at.solved, Some(at.places)));
        };
        Ok(fit(&scene.file, &scene.resolved, &data, &options, run, told)?)
    })?;
    let fitted = py.detach(|| scene.with_text(found.scene.text()))?;
    Ok((serde_json::to_string(&found).map_err(Failure::work)?, fitted))
}

/// The unit vector along a direction.
fn unit(direction: [f64; 3]) -> Result<[f64; 3], Failure> {
    let length = direction.iter().map(|x| x * x).sum::<f64>().sqrt();
    if length > 0.0 && length.is_finite() {
        return Ok(direction.map(|x| x / length));
    }
    Err(Failure::input(format!("direction = {direction:?}; give three finite numbers that are not all zero")))
}
