//! From a `.space` file to a certified blob.

use std::path::PathBuf;
use std::sync::atomic::Ordering;

use palpate_core::Method;
use palpate_precompute::pack::{PackOptions, pack as pack_tables};
use palpate_precompute::pipeline::{
    DISCRETISATION_POSITIONS, PipelineError, certified, solve_discretisation, solve_held_out_positions,
    unfinished,
};
use palpate_precompute::space::Store;
use palpate_precompute::write_atomically;
use pyo3::prelude::*;

use crate::failure::Failure;
use crate::running::{interruptible, threads};

/// The method of a name.
pub(crate) fn method(name: &str) -> Result<Method, Failure> {
    Method::from_name(name).ok_or_else(|| {
        let names: Vec<&str> = Method::ALL.iter().map(|method| method.name()).collect();
        Failure::input(format!("method \"{name}\": no such method; choose from {}", names.join(", ")))
    })
}

/// Fits and packs a `.space` file; returns the certificate as JSON, see `palpate.pack`.
#[pyfunction]
#[pyo3(signature = (space, blob, methods, held_out=None, discretisation=None, progress=None, threads=None))]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
pub(crate) fn pack(
    py: Python<'_>,
    space: PathBuf,
    blob: PathBuf,
    methods: Vec<String>,
    held_out: Option<u32>,
    discretisation: Option<usize>,
    progress: Option<Bound<'_, PyAny>>,
    threads: Option<usize>,
) -> Result<Option<String>, Failure> {
    let methods = methods.iter().map(|name| method(name)).collect::<Result<Vec<_>, _>>()?;
    std::fs::File::open(&space).map_err(|error| Failure::file(&space, &error))?;
    if let Some(first) = unfinished(&Store::open(&space)?)?.into_iter().next() {
        return Err(first.into());
    }
    let positions = discretisation.unwrap_or(DISCRETISATION_POSITIONS);
    interruptible(py, self::threads(threads)?, progress.as_ref(), |run, report| {
        let options = PackOptions { methods: &methods, use_intermediate_states: true, threads: run.threads };
        let (packed, certificate) = if held_out == Some(0) {
            report(("tables", 0, None));
            (pack_tables(&Store::open(&space)?, &options).map_err(PipelineError::from)?, None)
        } else {
            solve_held_out_positions(&space, held_out, run, |now| {
                report(("held-out positions", now.walks, Some(now.total)));
            })?;
            solve_discretisation(&space, positions, run, |done, all| {
                report(("more accurate elements", done, Some(all)));
            })?;
            report(("tables and certificate", 0, None));
            let (packed, certificate) = certified(&Store::open(&space)?, &options)?;
            (packed, Some(certificate))
        };
        let bytes = packed.bytes().map_err(PipelineError::from)?;
        if run.stop.load(Ordering::Relaxed) {
            return Err(PipelineError::Interrupted.into());
        }
        write_atomically(&blob, &bytes).map_err(|error| Failure::file(&blob, &error))?;
        Ok(certificate
            .map(|certificate| serde_json::to_string(&certificate).expect("a certificate is plain data")))
    })
}
