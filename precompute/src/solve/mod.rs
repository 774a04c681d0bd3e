//! Static equilibrium of a body whose active node is held at a prescribed displacement.
//!
//! [`Problem`] is built once per active node and shared by all threads; each thread owns a [`Solver`].
//! [`Solver::advance`] goes from a solved [`Configuration`] to a new position by incremental loading.

mod incremental_loading;
mod ldlt;
mod newton;
pub mod ordering;

use std::sync::Arc;

use nalgebra::Matrix3;

pub use incremental_loading::LoadingOptions;
pub use newton::{FailureReason, NewtonOptions, SolveFailure};

use crate::assembly::{Assembled, Pattern};
use crate::body::Body;
use crate::boundary::DofMap;
use ldlt::{Factor, RIGHT_SIDES, SymbolicFactor};

/// A body, one of its nodes chosen as active, and everything that does not change from solve to solve.
#[derive(Debug)]
pub struct Problem {
    /// The body.
    pub body: Arc<Body>,
    /// The node whose displacement is prescribed.
    pub active_node: u32,
    dofs: DofMap,
    pattern: Pattern,
    symbolic: SymbolicFactor,
}

impl Problem {
    /// Numbers the unknowns, builds the pattern and analyses it. `active_node` must not be fixed.
    pub fn new(body: Arc<Body>, active_node: u32) -> Self {
        let pressures = body.material.rest_pressure_pa().is_some();
        let dofs = DofMap::new(&body.elements, body.node_count, &body.fixed, active_node, pressures);
        let pattern = Pattern::new(&body, &dofs);
        let mut node_volume = vec![0.0; body.node_count];
        for element in &body.elements {
            for &node in &element.nodes {
                node_volume[node as usize] += 0.25 * element.volume_m3;
            }
        }
        let scale = body.pressure_scale();
        let diagonal: Vec<(usize, f64)> = (0..body.node_count)
            .filter_map(|node| {
                let equation = dofs.pressure(node as u32) as usize;
                let size = scale * scale * node_volume[node] / body.material.shear_modulus_pa();
                (equation < dofs.unknowns()).then_some((equation, size))
            })
            .collect();
        let symbolic = SymbolicFactor::new(&pattern, &diagonal);
        Self { body, active_node, dofs, pattern, symbolic }
    }

    /// Number of equations.
    pub fn unknowns(&self) -> usize {
        self.dofs.unknowns()
    }

    /// Entries of the matrix (lower triangle) and of its factor.
    pub fn entries(&self) -> (usize, usize) {
        (self.pattern.entries(), self.symbolic.factor_entries())
    }
}

/// Where a solve may start from: a solved position, its state, and how the state moves with the position.
#[derive(Debug, Clone)]
pub struct Seed {
    /// Displacement d of the active node, m.
    pub displacement_m: [f64; 3],
    /// State vector of [`Body`].
    pub state: Vec<f64>,
    /// d(state)/dd, one state vector per axis: the tangent predictor.
    pub sensitivity: [Vec<f64>; 3],
}

/// One solved configuration: the paper's C = (p, u, h), with its energy and its tangent.
#[derive(Debug, Clone)]
pub struct Configuration {
    /// Displacement, state and sensitivity: what the next solve starts from.
    pub seed: Seed,
    /// Stationary potential W, J; zero at rest.
    pub energy_j: f64,
    /// Reaction h = dW/dd: the force by the tool on the body at the active node, N.
    pub force_n: [f64; 3],
    /// Condensed tangent S = dh/dd, symmetric, N/m.
    pub stiffness_n_m: Matrix3<f64>,
    /// Norm of the residual over all equations (constraints scaled like forces), N.
    pub residual_n: f64,
    /// Smallest J over the elements.
    pub min_jacobian: f64,
    /// Elements with J <= 0: kept, but flagged.
    pub inverted: usize,
    /// Deformed volume, m^3.
    pub volume_m3: f64,
    /// Newton iterations, summed over increments and failed tries.
    pub iterations: u32,
    /// Load increments that the step was split into.
    pub increments: u32,
}

/// Solver of one thread: the problem's numbers and scratch memory.
#[derive(Debug)]
pub struct Solver {
    problem: Arc<Problem>,
    /// Convergence control.
    pub newton: NewtonOptions,
    /// Step control.
    pub loading: LoadingOptions,
    assembled: Assembled,
    factor: Factor,
    residual: Vec<f64>,
    step: Vec<f64>,
    columns: Vec<f64>,
    /// (equation, state position) of every unknown.
    positions: Vec<(usize, usize)>,
}

impl Solver {
    /// Solver of `problem` with default options.
    pub fn new(problem: Arc<Problem>) -> Self {
        let n = problem.unknowns();
        Self {
            newton: NewtonOptions::default(),
            loading: LoadingOptions::default(),
            assembled: Assembled::new(&problem.body, &problem.pattern),
            factor: Factor::new(&problem.symbolic, &problem.pattern),
            residual: vec![0.0; n],
            step: vec![0.0; n],
            columns: vec![0.0; RIGHT_SIDES * n],
            positions: problem.dofs.state_positions().collect(),
            problem,
        }
    }

    /// The problem solved here.
    pub fn problem(&self) -> &Arc<Problem> {
        &self.problem
    }

    /// The configuration at rest (the paper's C_000): zero displacement and force, with its tangent.
    pub fn rest(&mut self) -> Result<Configuration, SolveFailure> {
        let state = self.problem.body.rest_state();
        self.solve_at([0.0; 3], state)
    }

    /// Internal force on every node at the last residual, 3 per node, N: reactions where a node is held.
    pub fn nodal_force_n(&self) -> &[f64] {
        &self.assembled.nodal_force_n
    }
}
