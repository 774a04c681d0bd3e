//! The reaction along a loading path, as `palpate path` solves it.

use numpy::{IntoPyArray, PyArrayMethods};
use palpate_precompute::fem::{Configuration, Pose};
use palpate_precompute::pipeline::{Analysis, Loading};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays;
use crate::failure::Failure;

/// The solved steps.
#[derive(Default)]
struct Steps {
    force_n: Vec<[f64; 3]>,
    energy_j: Vec<f64>,
    stiffness_n_m: Vec<[[f64; 3]; 3]>,
    torque_n_m: Vec<[f64; 3]>,
    volume_m3: Vec<f64>,
    min_jacobian: Vec<f64>,
    iterations: Vec<u32>,
    switched: Vec<bool>,
    nodes_m: Vec<f64>,
}

impl Steps {
    fn push(&mut self, at: &Configuration, nodes: usize, keep_nodes: bool) {
        let jet = at.jet();
        self.force_n.push(jet.force_n);
        self.energy_j.push(jet.energy_j);
        let stiffness = jet.stiffness_n_m;
        self.stiffness_n_m.push([0, 1, 2].map(|i| [0, 1, 2].map(|j| stiffness[(i, j)])));
        self.torque_n_m.push(at.torque_n_m);
        self.volume_m3.push(at.volume_m3);
        self.min_jacobian.push(at.min_jacobian);
        self.iterations.push(at.iterations);
        self.switched.push(at.switched);
        if keep_nodes {
            self.nodes_m.extend(&at.seed.state[..3 * nodes]);
        }
    }

    fn columns<'py>(self, py: Python<'py>, nodes: usize) -> PyResult<Bound<'py, PyDict>> {
        let (count, all) = (self.force_n.len(), PyDict::new(py));
        all.set_item("force_n", arrays::vectors(py, self.force_n)?)?;
        all.set_item("energy_j", self.energy_j.into_pyarray(py))?;
        let stiffness = self.stiffness_n_m.into_flattened().into_flattened().into_pyarray(py);
        all.set_item("stiffness_n_m", stiffness.reshape([count, 3, 3])?)?;
        all.set_item("torque_n_m", arrays::vectors(py, self.torque_n_m)?)?;
        all.set_item("volume_m3", self.volume_m3.into_pyarray(py))?;
        all.set_item("min_jacobian", self.min_jacobian.into_pyarray(py))?;
        all.set_item("iterations", self.iterations.into_pyarray(py))?;
        all.set_item("switched", self.switched.into_pyarray(py))?;
        if nodes > 0 {
            all.set_item("nodes_m", self.nodes_m.into_pyarray(py).reshape([count, nodes, 3])?)?;
        }
        Ok(all)
    }
}

/// Solves the path. The dictionary has the steps up to a failure, whose line is `failure`.
///
/// A signal is looked for between two steps.
pub(crate) fn solve<'py>(
    py: Python<'py>,
    analysis: &Analysis,
    path_m: &[[f64; 3]],
    active: Option<&str>,
    layer: bool,
    keep_nodes: bool,
) -> Result<Bound<'py, PyDict>, Failure> {
    if path_m.is_empty() {
        return Err(Failure::input("displacements_m: no row; give one for each step"));
    }
    let is_sphere = analysis.scene.tool.sphere().is_some();
    if is_sphere && active.is_some() {
        return Err(Failure::input("active: a sphere or capsule has no active node; leave it out"));
    }
    if layer && !is_sphere {
        return Err(Failure::input("layer: only a sphere has a layer; leave it out"));
    }
    let mut loading = py.detach(|| Loading::begin(analysis, active, path_m[0], layer))?;
    let (mut steps, nodes, mut failure) = (Steps::default(), analysis.scene.mesh.nodes_m.len(), None);
    for (step, to_m) in path_m.iter().enumerate() {
        py.check_signals()?;
        match py.detach(|| loading.advance(&Pose::translation(*to_m))) {
            Ok(()) => steps.push(loading.here(), nodes, keep_nodes),
            Err(error) => {
                failure = Some(format!("step {step} of {}: {error}", path_m.len()));
                break;
            }
        }
    }
    let columns = steps.columns(py, if keep_nodes { nodes } else { 0 })?;
    columns.set_item("failure", failure)?;
    Ok(columns)
}
