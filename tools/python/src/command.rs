//! The result of a tick.

use numpy::PyArray1;
use palpate_core::{Command as Tick, Phase};
use pyo3::prelude::*;

use crate::arrays::vector;

/// Result of one tick. Vectors are arrays (3,) of float64 in the frame of the model.
#[pyclass(module = "palpate", frozen)]
pub(crate) struct Command(pub(crate) Tick);

/// The name of a phase; after a fault `safe-zero`.
pub(crate) const fn phase_name(phase: Phase) -> &'static str {
    match phase {
        Phase::Disarmed => "disarmed",
        Phase::Active => "active",
        Phase::SafeZero(_) => "safe-zero",
    }
}

#[pymethods]
impl Command {
    /// Force for the hand after every limit, N.
    #[getter]
    fn hand_force_n<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        vector(py, self.0.hand_force_n)
    }

    /// Force h of the tool on the body before any limit, N; zero without contact.
    #[getter]
    fn reaction_n<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        vector(py, self.0.reaction_n)
    }

    /// Displacement of the engaged node, m; zero without contact.
    #[getter]
    fn displacement_m<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        vector(py, self.0.displacement_m)
    }

    /// Position of the tool that the command refers to, m.
    #[getter]
    fn position_m<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        vector(py, self.0.hip_m)
    }

    /// Index of the engaged active node; None without contact.
    #[getter]
    fn engaged(&self) -> Option<u16> {
        self.0.engaged
    }

    /// The data behind the force: cell, supercell, scattered or extrapolated; None without contact.
    #[getter]
    fn coverage(&self) -> Option<&'static str> {
        self.0.coverage.map(|coverage| coverage.name())
    }

    /// disarmed, active or safe-zero.
    #[getter]
    fn phase(&self) -> &'static str {
        phase_name(self.0.phase)
    }

    /// The fault of the phase safe-zero; otherwise None.
    #[getter]
    fn fault(&self) -> Option<&'static str> {
        match self.0.phase {
            Phase::SafeZero(fault) => Some(fault.name()),
            Phase::Disarmed | Phase::Active => None,
        }
    }

    /// Whether the force limit reduced the force.
    #[getter]
    fn clamped(&self) -> bool {
        self.0.clamped
    }

    /// Whether the passivity control added damping.
    #[getter]
    fn damped(&self) -> bool {
        self.0.damped
    }

    /// Factor of the force after arming, 0 to 1.
    #[getter]
    fn ramp(&self) -> f32 {
        self.0.ramp
    }

    /// Work on the hand in this touch, J; negative while it presses.
    #[getter]
    fn hand_work_j(&self) -> f32 {
        self.0.hand_work_j
    }

    fn __repr__(&self) -> String {
        let Tick { hand_force_n: [x, y, z], engaged, .. } = self.0;
        let engaged = engaged.map_or("None".into(), |index| index.to_string());
        let phase = phase_name(self.0.phase);
        format!("Command(hand_force_n=[{x:.4}, {y:.4}, {z:.4}], engaged={engaged}, phase='{phase}')")
    }
}
