//! The live solver with its controller, stepped from Python.

use std::collections::HashMap;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use palpate_core::{AlignedBytes, Command as Tick, Sample, State};
use palpate_host::live::LiveField;
use palpate_host::settings::controller_config;
use palpate_precompute::live::{LiveSolver, Step, Totals};
use palpate_precompute::scene::ResolvedScene;
use pyo3::prelude::*;

use crate::arrays;
use crate::command::Command;
use crate::controller::{Owned, sample, set, simulated_device};
use crate::failure::Failure;
use crate::jets::Way;
use crate::organ::Blob;
use crate::scene::Scene;

/// The solver and the controller of one touch.
struct Touching {
    solver: LiveSolver,
    owned: Owned,
    field: LiveField,
    way: Way,
    state: State,
    ticks: u64,
    sequence: u32,
}

/// A scene that is solved where the tool goes, in virtual time.
///
/// `tick` is one tick of the haptic loop with the jets that have arrived; `step` is one piece of work of the
/// solver. In a session a process of its own makes the steps. Here Python chooses how many follow a tick.
#[pyclass(module = "palpate._palpate", frozen, subclass)]
pub(crate) struct Live {
    touching: Mutex<Touching>,
    nodes: Vec<u32>,
}

#[pymethods]
impl Live {
    #[new]
    #[pyo3(signature = (scene, **settings))]
    fn new(
        py: Python<'_>,
        scene: PyRef<'_, Scene>,
        settings: Option<HashMap<String, f32>>,
    ) -> Result<Self, Failure> {
        let resolved = scene.resolved.clone();
        let name = scene.name().to_owned();
        drop(scene);
        let touching = py.detach(|| Touching::new(&resolved, Path::new(&name), settings))?;
        Ok(Self { touching: Mutex::new(touching), nodes: (0..resolved.mesh.nodes_m.len() as u32).collect() })
    }

    /// One tick: the force of the jets that are known. At most one jet is taken.
    ///
    /// `t_us`: time, us; the haptic loop has a tick every 1000 us. `position_m` (3,): position of the tool,
    /// m. `orientation`: quaternion w, x, y, z of the grip, for a capsule.
    #[pyo3(signature = (t_us, position_m=None, orientation=None))]
    fn tick(
        &self,
        py: Python<'_>,
        t_us: u64,
        position_m: Option<&Bound<'_, PyAny>>,
        orientation: Option<[f32; 4]>,
    ) -> Result<Command, Failure> {
        let sample = sample(t_us, position_m, 0, orientation)?;
        // A step on another thread may last.
        Ok(Command(py.detach(|| self.with(|touching| touching.tick(t_us, sample.as_ref())))))
    }

    /// One piece of work of the solver where the last tick was: `solved`, `renewing`, `followed`, `lost`, or
    /// `idle` if everything near the hand is known.
    ///
    /// `seconds`: how long the step took, for the prediction of the hand; measured if None.
    #[pyo3(signature = (seconds=None))]
    fn step(&self, py: Python<'_>, seconds: Option<f64>) -> &'static str {
        py.detach(|| self.with(|touching| touching.step(seconds)))
    }

    /// Steps until everything near the hand is known, at most `max_steps` times. Returns the number of steps.
    /// The ticks that follow take the jets, one each.
    #[pyo3(signature = (max_steps=100))]
    fn solve(&self, py: Python<'_>, max_steps: usize) -> PyResult<usize> {
        for step in 0..max_steps {
            py.check_signals()?;
            if py.detach(|| self.with(|touching| touching.step(None))) == "idle" {
                return Ok(step);
            }
        }
        Ok(max_steps)
    }

    /// Number of jets that no tick has taken yet.
    #[getter]
    fn waiting(&self, py: Python<'_>) -> usize {
        py.detach(|| self.with(|touching| touching.way.waiting()))
    }

    /// Work since the start: jets, factorisations, landings, lost.
    #[getter]
    fn totals(&self, py: Python<'_>) -> HashMap<&'static str, u64> {
        let totals = py.detach(|| self.with(|touching| touching.solver.totals()));
        let Totals { jets, factorisations, landings, lost } = totals;
        HashMap::from([
            ("jets", jets),
            ("factorisations", factorisations),
            ("landings", landings),
            ("lost", lost),
        ])
    }

    /// Goes on with a changed scene: other materials, body force or fixed nodes of the same mesh.
    fn change(&self, py: Python<'_>, scene: PyRef<'_, Scene>) -> Result<(), Failure> {
        let resolved = scene.resolved.clone();
        drop(scene);
        py.detach(|| self.with(|touching| touching.solver.change(&resolved))).map_err(Failure::input)
    }

    /// Displacements of the nodes of the mesh (n, 3), m, float32, in the solved state nearest to the last
    /// tick.
    fn displacements<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let mut moved = vec![[0.0; 3]; self.nodes.len()];
        py.detach(|| {
            self.with(|touching| {
                touching.solver.displacements_into(&touching.way.seen(), &self.nodes, &mut moved);
            });
        });
        arrays::vectors(py, moved)
    }
}

impl Live {
    fn with<T>(&self, work: impl FnOnce(&mut Touching) -> T) -> T {
        work(&mut self.touching.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Touching {
    fn new(
        scene: &ResolvedScene,
        path: &Path,
        settings: Option<HashMap<String, f32>>,
    ) -> Result<Self, Failure> {
        let refused = |error: &dyn std::fmt::Display| Failure::input(format!("{}: {error}", path.display()));
        let solver = LiveSolver::new(scene).map_err(|error| refused(&error))?;
        let (bytes, _) = solver.organ(scene).map_err(|error| refused(&error))?;
        let blob = Arc::new(Blob::open(AlignedBytes::from(&bytes), path)?);
        let mut config = controller_config(&[blob.organ()], None, &simulated_device(), None);
        set(&mut config, settings)?;
        let owned = Owned::of_blob(blob, config)?;
        let way = Way::default();
        let field =
            LiveField::new(way.clone()).map_err(|error| Failure::work(format!("no memory: {error}")))?;
        let mut state = State::new();
        state.arm();
        Ok(Self { solver, owned, field, way, state, ticks: 0, sequence: 0 })
    }

    fn tick(&mut self, t_us: u64, sample: Option<&Sample>) -> Tick {
        let at = (self.ticks, t_us.saturating_mul(1_000), t_us);
        self.ticks += 1;
        self.field.tick(self.owned.controller(), &mut self.state, at, sample).0
    }

    fn step(&mut self, seconds: Option<f64>) -> &'static str {
        let begun = Instant::now();
        let step = self.solver.step(&self.way.seen());
        if step != Step::Idle {
            self.solver.took(seconds.unwrap_or_else(|| begun.elapsed().as_secs_f64()));
        }
        while let Some(published) = self.solver.published() {
            self.sequence += 1;
            self.way.send(published.jet(self.sequence).encode());
        }
        match step {
            Step::Idle => "idle",
            Step::Solved => "solved",
            Step::Renewing => "renewing",
            Step::Followed => "followed",
            Step::Lost { .. } => "lost",
        }
    }
}
