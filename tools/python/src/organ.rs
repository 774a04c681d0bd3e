//! A blob: the force at many displacements, without the interpreter.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use numpy::{Element, IntoPyArray, PyArray2, PyArrayMethods, PyReadonlyArray2, PyUntypedArrayMethods};
use palpate_core::{AlignedBytes, Coverage, Method, Organ as View, Space};
use palpate_host::{BlobFile, Interpolator, PREFERENCE};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use self_cell::self_cell;

use crate::arrays::{self, Float, Points};
use crate::failure::Failure;
use crate::pack::method;

/// On the heap: a view of many spaces is large for a stack.
type Boxed<'a> = Box<View<'a>>;

self_cell!(
    /// The bytes of a blob with the view of them.
    pub(crate) struct Blob {
        owner: AlignedBytes,
        #[covariant]
        dependent: Boxed,
    }
);

impl Blob {
    /// Checks the bytes; `path` names them in an error.
    pub(crate) fn open(bytes: AlignedBytes, path: &std::path::Path) -> Result<Self, Failure> {
        Self::try_new(bytes, |bytes| View::read_boxed(bytes))
            .map_err(|error| Failure::input(format!("{}: {error}", path.display())))
    }

    /// The organ.
    pub(crate) fn organ(&self) -> &View<'_> {
        self.borrow_dependent()
    }
}

/// An organ that can be touched: the spaces of its active nodes. It reads a blob that `palpate.pack` or the
/// command line has written.
#[pyclass(module = "palpate", frozen)]
pub(crate) struct Organ {
    path: PathBuf,
    pub(crate) blob: Arc<Blob>,
    /// BLAKE3 of the file, by which a recording names it.
    pub(crate) blake3: String,
}

/// An active node: its name or its index.
#[derive(FromPyObject)]
enum Which {
    Index(usize),
    Name(String),
}

#[pymethods]
impl Organ {
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> Result<Self, Failure> {
        py.detach(|| {
            let file = BlobFile::load(&path).map_err(|error| Failure::file(&path, &error))?;
            let blob = Blob::open(AlignedBytes::from(file.bytes()), &path)?;
            Ok(Self { blake3: file.blake3(), blob: Arc::new(blob), path })
        })
    }

    /// Name of the scene.
    #[getter]
    fn scene(&self) -> &str {
        &self.organ().scene
    }

    /// Name of the material law; of the first one where regions differ.
    #[getter]
    fn law(&self) -> &str {
        &self.organ().law
    }

    /// Largest force of the device, N; infinite without a device.
    #[getter]
    fn max_force_n(&self) -> f32 {
        self.organ().max_force_n
    }

    /// Names of the active nodes.
    #[getter]
    fn active(&self) -> Vec<&str> {
        self.organ().spaces.iter().map(|space| space.active.name.as_str()).collect()
    }

    /// Places of the active nodes at rest (a, 3), m.
    #[getter]
    fn active_m<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        arrays::vectors(py, self.organ().spaces.iter().map(|space| space.active.rest_position_m).collect())
    }

    /// Outward normals of the skin at the active nodes (a, 3).
    #[getter]
    fn normals<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        arrays::vectors(py, self.organ().spaces.iter().map(|space| space.active.outward_normal).collect())
    }

    /// Radii of the balls of displacements (a,), m.
    #[getter]
    fn radius_m<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        let radii: Vec<f32> = self.organ().spaces.iter().map(|space| space.lattice().radius_m()).collect();
        radii.into_pyarray(py).into_any()
    }

    /// Vertices of the surface at rest (v, 3), m.
    #[getter]
    fn surface_m<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let [x, y, z] = self.organ().surface.position_m;
        arrays::vectors(py, (0..x.len()).map(|vertex| [x[vertex], y[vertex], z[vertex]]).collect())
    }

    /// Triangles of the surface (t, 3), counter-clockwise seen from outside.
    #[getter]
    fn triangles<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        arrays::rows(py, self.organ().surface.triangles.to_vec())
    }

    /// Methods that every active node has, the most accurate first.
    #[getter]
    fn methods(&self) -> Vec<&'static str> {
        let spaces = &self.organ().spaces;
        let has = |method: &Method| spaces.iter().all(|space| space.has(*method));
        PREFERENCE.into_iter().filter(has).map(Method::name).collect()
    }

    /// The certificate as a dictionary: the measured errors of the blob; None if it was not measured.
    #[getter]
    fn certificate<'py>(&self, py: Python<'py>) -> Result<Option<Bound<'py, PyAny>>, Failure> {
        let Some(json) = self.organ().certificate else { return Ok(None) };
        Ok(Some(py.import("json")?.call_method1("loads", (json,))?))
    }

    /// Force h of the tool on the body at displacements of an active node, N.
    ///
    /// `displacements_m` (n, 3): displacements from rest, m; of a sphere the way of its centre. float32 and
    /// float64 are read in place. `active`: name or index. `method`: the most accurate of the blob if None.
    /// `out` (n, 3): memory for the result, C-contiguous, of the same dtype. Returns (n, 3) of the dtype of
    /// the displacements. Outside the data the force is continued from the rim; a position that is not finite
    /// has the force at rest. Other threads of Python run meanwhile.
    #[pyo3(signature = (displacements_m, active=None, method=None, out=None))]
    fn force<'py>(
        &self,
        py: Python<'py>,
        displacements_m: &Bound<'py, PyAny>,
        active: Option<Which>,
        method: Option<&str>,
        out: Option<Bound<'py, PyAny>>,
    ) -> Result<Bound<'py, PyAny>, Failure> {
        let (space, method) = (self.space(active)?, self.method(method)?);
        match arrays::points("displacements_m", displacements_m)? {
            Points::Single(at) => forces(py, space, method, &at, out),
            Points::Double(at) => forces(py, space, method, &at, out),
        }
    }

    /// Force, stiffness and energy at displacements of an active node; a few times slower than `force`.
    ///
    /// `displacements_m` (n, 3), m. Returns a dictionary of float32 arrays: `force_n` (n, 3), N;
    /// `stiffness_n_m` (n, 3, 3), dh_i/dd_j, N/m; `energy_j` (n,), J, NaN where the force is no gradient;
    /// `extrapolated` (n,), bool.
    #[pyo3(signature = (displacements_m, active=None, method=None))]
    fn estimate<'py>(
        &self,
        py: Python<'py>,
        displacements_m: &Bound<'py, PyAny>,
        active: Option<Which>,
        method: Option<&str>,
    ) -> Result<Bound<'py, PyDict>, Failure> {
        let (space, method) = (self.space(active)?, self.method(method)?);
        let at_m = match arrays::points("displacements_m", displacements_m)? {
            Points::Single(at) => core_rows(&at),
            Points::Double(at) => core_rows(&at),
        };
        let estimates: Option<Vec<_>> =
            py.detach(|| at_m.iter().map(|at| space.estimate(method, *at)).collect());
        let estimates = estimates.ok_or_else(|| self.not_packed(method))?;
        let all = PyDict::new(py);
        all.set_item("force_n", arrays::vectors(py, estimates.iter().map(|of| of.force_n).collect())?)?;
        let stiffness: Vec<f32> = estimates.iter().flat_map(|of| of.stiffness_n_m).flatten().collect();
        all.set_item("stiffness_n_m", stiffness.into_pyarray(py).reshape([estimates.len(), 3, 3])?)?;
        let energy: Vec<f32> = estimates.iter().map(|of| of.energy_j.unwrap_or(f32::NAN)).collect();
        all.set_item("energy_j", energy.into_pyarray(py))?;
        let beyond: Vec<bool> = estimates.iter().map(|of| of.coverage == Coverage::Extrapolated).collect();
        all.set_item("extrapolated", beyond.into_pyarray(py))?;
        Ok(all)
    }

    /// Displacements of the vertices of the surface (v, 3), m, at one displacement of an active node (3,), m.
    /// Zero if the blob holds none.
    #[pyo3(signature = (displacement_m, active=None))]
    fn surface_displacement<'py>(
        &self,
        py: Python<'py>,
        displacement_m: &Bound<'py, PyAny>,
        active: Option<Which>,
    ) -> Result<Bound<'py, PyAny>, Failure> {
        let at = arrays::three("displacement_m", displacement_m)?.map(Float::to_core);
        let mut moved = vec![[0.0; 3]; self.organ().surface.node.len()];
        self.space(active)?.displacement_into(at, &mut moved);
        Ok(arrays::vectors(py, moved)?)
    }

    /// The surface as `pyvista.PolyData`. Needs the package pyvista.
    fn mesh<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        slf.py().import("palpate._mesh")?.call_method1("surface", (slf,))
    }

    /// Seconds that the same loop takes in Rust for these positions, with the force in memory of its own: the
    /// measure for `force`.
    #[pyo3(signature = (displacements_m, method=None))]
    fn _seconds_in_rust(
        &self,
        py: Python<'_>,
        displacements_m: PyReadonlyArray2<'_, f32>,
        method: Option<&str>,
    ) -> Result<f64, Failure> {
        let (space, method) = (self.space(None)?, self.method(method)?);
        let at_m = core_rows(&displacements_m);
        // Not zero, so that its pages are there.
        let mut out = vec![[f32::NAN; 3]; at_m.len()];
        Ok(py.detach(|| {
            let (force, begun) = (Interpolator::new(method), Instant::now());
            for (force_n, at) in out.iter_mut().zip(&at_m) {
                *force_n = force.force(space, at).map_or([0.0; 3], |sample| sample.force_n);
            }
            std::hint::black_box(&out);
            begun.elapsed().as_secs_f64()
        }))
    }

    fn __repr__(&self) -> String {
        format!("Organ('{}', active={:?})", self.path.display(), self.active())
    }
}

impl Organ {
    /// The view of the blob.
    pub(crate) fn organ(&self) -> &View<'_> {
        self.blob.organ()
    }

    /// The method of an argument, which every active node has.
    pub(crate) fn method(&self, given: Option<&str>) -> Result<Method, Failure> {
        let method = match given {
            Some(name) => method(name)?,
            None => self.methods().first().map_or(Ok(Method::Energy), |name| method(name))?,
        };
        let has_all = self.organ().spaces.iter().all(|space| space.has(method));
        if has_all { Ok(method) } else { Err(self.not_packed(method)) }
    }

    fn not_packed(&self, method: Method) -> Failure {
        let (path, name) = (self.path.display(), method.name());
        Failure::input(format!("{path}: {name} was not packed; give pack methods=[\"{name}\"]"))
    }

    fn space(&self, which: Option<Which>) -> Result<&Space<'_>, Failure> {
        let spaces = &self.organ().spaces;
        let (found, shown) = match which {
            None => (spaces.first(), "0".to_owned()),
            Some(Which::Index(index)) => (spaces.get(index), index.to_string()),
            Some(Which::Name(name)) => (spaces.iter().find(|space| *space.active.name == *name), name),
        };
        found.ok_or_else(|| {
            let known = self.active().join(", ");
            Failure::input(format!("{}: no active node {shown}; it has {known}", self.path.display()))
        })
    }
}

/// Rows for the core.
fn core_rows<T: Float>(at: &PyReadonlyArray2<'_, T>) -> Vec<[f32; 3]> {
    at.as_array().rows().into_iter().map(|row| [row[0], row[1], row[2]].map(Float::to_core)).collect()
}

/// The forces in new memory, or in `out`.
fn forces<'py, T: Float + Element>(
    py: Python<'py>,
    space: &Space<'_>,
    method: Method,
    at: &PyReadonlyArray2<'py, T>,
    out: Option<Bound<'py, PyAny>>,
) -> Result<Bound<'py, PyAny>, Failure> {
    let shape = [at.as_array().nrows(), 3];
    let to = match out {
        // Not zeroed: every row is written below.
        None => {
            let empty = py.import("numpy")?.call_method1("empty", (shape, numpy::dtype::<T>(py)))?;
            empty.cast_into::<PyArray2<T>>().map_err(PyErr::from)?
        }
        Some(out) => out
            .cast_into::<PyArray2<T>>()
            .ok()
            .filter(|out| out.as_untyped().shape() == shape && out.is_c_contiguous())
            .ok_or_else(|| {
                let what =
                    format!("out: a C-contiguous array ({}, 3) of the same dtype is expected", shape[0]);
                Failure::input(format!("{what}; give numpy.empty_like(displacements_m)"))
            })?,
    };
    let mut writable = to
        .try_readwrite()
        .map_err(|error| Failure::input(format!("out: {error}; give `out` memory of its own")))?;
    let result = writable.as_slice_mut().map_err(|error| Failure::input(format!("out: {error}")))?;
    let (rows, view) = (result.as_chunks_mut::<3>().0, at.as_array());
    py.detach(|| match view.as_slice() {
        Some(flat) => evaluate(space, method, flat.as_chunks::<3>().0.iter().copied(), rows),
        None => evaluate(space, method, view.rows().into_iter().map(|at| [at[0], at[1], at[2]]), rows),
    });
    drop(writable);
    Ok(to.into_any())
}

/// Positions that are converted at a time: conversions of a block take vector instructions, those between two queries
/// do not.
const BLOCK: usize = 256;

/// The force at each position.
fn evaluate<T: Float>(
    space: &Space<'_>,
    method: Method,
    mut at: impl Iterator<Item = [T; 3]>,
    to: &mut [[T; 3]],
) {
    let force = Interpolator::new(method);
    let mut block = [[0.0; 3]; BLOCK];
    for to in to.chunks_mut(BLOCK) {
        let block = &mut block[..to.len()];
        for (value, at) in block.iter_mut().zip(at.by_ref()) {
            *value = at.map(Float::to_core);
        }
        for value in block.iter_mut() {
            // The tables were checked before.
            *value = force.force(space, value).map_or([0.0; 3], |sample| sample.force_n);
        }
        for (to, value) in to.iter_mut().zip(block) {
            *to = value.map(Float::of_core);
        }
    }
}
