//! The Python package: scenes, solves, blobs, controllers and recordings of Palpate with numpy arrays.
//!
//! ```text
//! dict, arrays, TOML -> Scene -> path | constants | .space -> blob -> Organ -> force, Controller
//!                         \-> Live (solver and controller, tick by tick)          recording -> columns
//! ```
//!
//! This module is `palpate._palpate`; the files in `palpate/` add what is easier in Python: dictionaries,
//! pictures and the progress bar.
//!
//! Invariants:
//! - The interpreter is released in every call that solves, fits or interpolates.
//! - Ctrl-C ends a long call with `KeyboardInterrupt`. What is solved by then is kept in the `.space` file.
//! - Errors are exceptions with the line of the command line (`failure.rs`).
//! - Arrays are SI units, positions (n, 3). Floats of the real-time side are float32, of the solver float64.
//! - The real-time thread is not here: Python steps controllers in virtual time, and reads recordings.
#![deny(unsafe_code)]

mod arrays;
mod command;
mod controller;
mod failure;
mod identify;
mod jets;
mod live;
mod organ;
mod pack;
mod path;
mod recording;
mod running;
mod scene;

use pyo3::prelude::*;

/// What `import palpate` uses.
#[pymodule]
fn _palpate(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<scene::Scene>()?;
    module.add_class::<organ::Organ>()?;
    module.add_class::<command::Command>()?;
    module.add_class::<controller::Controller>()?;
    module.add_class::<live::Live>()?;
    module.add_function(wrap_pyfunction!(identify::identify, module)?)?;
    module.add_function(wrap_pyfunction!(pack::pack, module)?)?;
    module.add_function(wrap_pyfunction!(recording::read_recording, module)?)?;
    Ok(())
}
