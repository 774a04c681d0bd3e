//! Arrays of Python: positions in, vectors out.

use numpy::{
    Element, IntoPyArray, PyArray1, PyArrayDescrMethods, PyArrayMethods, PyReadonlyArray2, PyUntypedArray,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::failure::Failure;

/// A float of an array: that of the caller, which the core gets as f32.
pub(crate) trait Float: Element + Copy + Sync {
    /// Its value for the core. Finite numbers stay finite: those beyond the range of f32 become its largest.
    fn to_core(self) -> f32;
    /// A value of the core.
    fn of_core(value: f32) -> Self;
}

impl Float for f32 {
    fn to_core(self) -> f32 {
        self
    }

    fn of_core(value: f32) -> Self {
        value
    }
}

impl Float for f64 {
    fn to_core(self) -> f32 {
        let single = self as f32;
        if single.is_infinite() && self.is_finite() { f32::MAX.copysign(single) } else { single }
    }

    fn of_core(value: f32) -> Self {
        f64::from(value)
    }
}

/// An array (n, 3) of float64 or float32, or one that numpy makes of a list.
pub(crate) enum Points<'py> {
    /// float32.
    Single(PyReadonlyArray2<'py, f32>),
    /// float64.
    Double(PyReadonlyArray2<'py, f64>),
}

/// The positions of an argument.
///
/// Arrays of float32 and float64 are used in place. Lists and whole numbers are converted to float64.
pub(crate) fn points<'py>(name: &str, given: &Bound<'py, PyAny>) -> Result<Points<'py>, Failure> {
    let py = given.py();
    let array = as_array(name, given)?;
    let (shape, kind) = (array.shape(), array.dtype());
    if shape.len() != 2 || shape[1] != 3 {
        return Err(shape_error(name, "(n, 3)", shape));
    }
    if kind.is_equiv_to(&numpy::dtype::<f32>(py)) {
        return Ok(Points::Single(borrow(name, &array)?));
    }
    if kind.is_equiv_to(&numpy::dtype::<f64>(py)) {
        return Ok(Points::Double(borrow(name, &array)?));
    }
    if !matches!(kind.kind(), b'i' | b'u' | b'f') {
        let fix = "give float64 or float32";
        return Err(Failure::input(format!(
            "{name}: an array of numbers is expected, not of dtype {kind}; {fix}"
        )));
    }
    let keywords = PyDict::new(py);
    keywords.set_item("dtype", numpy::dtype::<f64>(py))?;
    let converted = py.import("numpy")?.call_method("asarray", (&array,), Some(&keywords))?;
    let converted = converted.cast_into::<PyUntypedArray>().map_err(PyErr::from)?;
    Ok(Points::Double(borrow(name, &converted)?))
}

fn as_array<'py>(name: &str, given: &Bound<'py, PyAny>) -> Result<Bound<'py, PyUntypedArray>, Failure> {
    if let Ok(array) = given.cast::<PyUntypedArray>() {
        return Ok(array.clone());
    }
    let array = given.py().import("numpy")?.call_method1("asarray", (given,)).map_err(|error| {
        Failure::input(format!("{name}: an array of shape (n, 3) is expected ({error}); give a numpy array"))
    })?;
    Ok(array.cast_into::<PyUntypedArray>().map_err(PyErr::from)?)
}

fn borrow<'py, T: Element>(
    name: &str,
    array: &Bound<'py, PyUntypedArray>,
) -> Result<PyReadonlyArray2<'py, T>, Failure> {
    array.extract().map_err(|_| {
        Failure::input(format!("{name}: the array is in use elsewhere; give `out` memory of its own"))
    })
}

fn shape_error(name: &str, wanted: &str, shape: &[usize]) -> Failure {
    let shape: Vec<String> = shape.iter().map(ToString::to_string).collect();
    let comma = if shape.len() == 1 { "," } else { "" };
    let found = shape.join(", ");
    Failure::input(format!(
        "{name}: shape {wanted} is expected, not ({found}{comma}); give one row for each point"
    ))
}

/// The positions as f64, for the solver.
pub(crate) fn doubles(name: &str, given: &Bound<'_, PyAny>) -> Result<Vec<[f64; 3]>, Failure> {
    let rows = match points(name, given)? {
        Points::Single(array) => {
            array.as_array().rows().into_iter().map(|r| [r[0], r[1], r[2]].map(f64::from)).collect()
        }
        Points::Double(array) => {
            array.as_array().rows().into_iter().map(|r| [r[0], r[1], r[2]]).collect::<Vec<_>>()
        }
    };
    match rows.iter().position(|row: &[f64; 3]| row.iter().any(|x| !x.is_finite())) {
        None => Ok(rows),
        Some(row) => Err(Failure::input(format!("{name}: row {row} is not finite; give metres"))),
    }
}

/// One position: three numbers.
pub(crate) fn three(name: &str, given: &Bound<'_, PyAny>) -> Result<[f64; 3], Failure> {
    given.extract().map_err(|_| {
        let shown = given.repr().map_or_else(|_| "this".into(), |text| text.to_string());
        Failure::input(format!("{name}: three numbers are expected, not {shown}; give x, y, z in metres"))
    })
}

/// An array (n, 3).
pub(crate) fn vectors<T: Element>(py: Python<'_>, rows: Vec<[T; 3]>) -> PyResult<Bound<'_, PyAny>> {
    let count = rows.len();
    Ok(rows.into_flattened().into_pyarray(py).reshape([count, 3])?.into_any())
}

/// An array (3,) of float64.
pub(crate) fn vector<'py>(py: Python<'py>, components: [f32; 3]) -> Bound<'py, PyArray1<f64>> {
    PyArray1::from_slice(py, &components.map(f64::from))
}

/// An array (n, K) of whole numbers.
pub(crate) fn rows<const K: usize>(py: Python<'_>, rows: Vec<[u32; K]>) -> PyResult<Bound<'_, PyAny>> {
    let count = rows.len();
    Ok(rows.into_flattened().into_pyarray(py).reshape([count, K])?.into_any())
}
