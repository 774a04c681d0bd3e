//! Static equilibrium of a body whose handle is held at a prescribed pose.
//!
//! [`Problem`] is built once per active node and shared by all threads; each thread owns a [`Solver`].
//! [`Solver::advance`] goes from a solved [`Configuration`] to a new position by incremental loading.

mod condensed;
mod factor;
mod incremental_loading;
mod newton;
mod profile;
mod quasi_newton;
mod settle;

use std::sync::Arc;

pub use incremental_loading::{Effort, LoadingOptions};
pub use newton::{FailureReason, NewtonOptions, SolveFailure};
pub use profile::IterationProfile;
pub use settle::settle;

use crate::fem::assembly::{Assembled, HandleCoupling, Pattern};
use crate::fem::body::Body;
use crate::fem::boundary::{Constraints, DofMap, Handle, Pose};
use crate::fem::element::Order;
use crate::num::jet::EnergyJet;
use factor::{Factor, RIGHT_SIDES, SymbolicFactor};
use quasi_newton::StepHistory;

/// A body, the handle a tool has on it, and everything that does not change from solve to solve.
#[derive(Debug)]
pub struct Problem {
    /// The body.
    pub body: Arc<Body>,
    /// The nodes whose displacement is prescribed; `None` while the free body settles under its body force.
    pub handle: Option<Handle>,
    /// Convergence control that its solvers begin with.
    pub newton: NewtonOptions,
    dofs: DofMap,
    pattern: Pattern,
    symbolic: SymbolicFactor,
    /// (equation, state position) of every unknown of the state.
    positions: Vec<(usize, usize)>,
}

impl Problem {
    /// Problem of one active node, by elimination. The node must not be fixed.
    pub fn new(body: Arc<Body>, active_node: u32) -> Self {
        Self::with(body, Some(Handle::node(active_node)), Constraints::Elimination)
    }

    /// Numbers the unknowns, builds the pattern and analyses it.
    pub fn with(body: Arc<Body>, handle: Option<Handle>, constraints: Constraints) -> Self {
        let handle = handle.map(|handle| handle.on(&body));
        let dofs = DofMap::new(&body, handle.as_ref(), constraints);
        let pattern = Pattern::new(&body, &dofs);
        let regularised = regularised_diagonal(&body, &dofs);
        let pressures = (0..body.pressure_sites.len() as u32)
            .filter(|&p| (dofs.pressure(p) as usize) < dofs.unknowns())
            .count();
        let negative = pressures + dofs.multipliers().len();
        let symbolic = SymbolicFactor::new(&pattern, &regularised, negative);
        let positions = dofs.state_positions().collect();
        let newton = NewtonOptions::default();
        Self { body, handle, newton, dofs, pattern, symbolic, positions }
    }

    /// Number of equations.
    pub fn unknowns(&self) -> usize {
        self.dofs.unknowns()
    }

    /// Entries of the matrix (lower triangle) and of its factor.
    pub fn entries(&self) -> (usize, usize) {
        (self.pattern.entries(), self.symbolic.factor_entries())
    }

    /// Floating-point operations of one factorisation.
    pub fn factor_flops(&self) -> f64 {
        self.symbolic.flops().0
    }

    fn handle_nodes(&self) -> &[u32] {
        self.handle.as_ref().map_or(&[], |handle| &handle.nodes)
    }
}

/// (equation, V_i / mu in scaled units) of every pressure without a block of its own.
fn regularised_diagonal(body: &Body, dofs: &DofMap) -> Vec<(usize, f64)> {
    let mut volume_m3 = vec![0.0; body.pressure_sites.len()];
    let mut own_block = vec![false; body.pressure_sites.len()];
    for element in &body.elements {
        for (v, &pressure) in element.pressures.iter().enumerate() {
            if let Some(volume) = volume_m3.get_mut(pressure as usize) {
                *volume += 0.25 * element.tet.volume_m3;
                own_block[pressure as usize] |= element.pressure_block[v][v] != 0.0;
            }
        }
    }
    // A stable pair bears a smaller regularisation, and then needs no refinement; with P1/P1 rounding, amplified by its inverse,
    // would cost more than it saves (measured: one sweep leaves 5e-12 with P2/P1, 3e-8 with P1/P1).
    let share = match body.order {
        Order::Linear => 1.0,
        Order::Quadratic => 1e-2,
    };
    let scale = body.pressure_scale() * f64::sqrt(share);
    (0..body.pressure_sites.len())
        .filter_map(|pressure| {
            let equation = dofs.pressure(pressure as u32) as usize;
            let (_, region) = body.pressure_sites[pressure];
            let shear_pa = body.regions[usize::from(region)].material.shear_modulus_pa();
            let size = scale * scale * volume_m3[pressure] / shear_pa;
            (equation < dofs.unknowns() && !own_block[pressure]).then_some((equation, size))
        })
        .collect()
}

/// Where a solve may start from: a solved pose, its state, and how the state moves with the handle.
#[derive(Debug, Clone)]
pub struct Seed {
    /// Pose of the handle, from rest.
    pub pose: Pose,
    /// State vector of [`Body`].
    pub state: Vec<f64>,
    /// d(state)/dd along a translation of the handle, one state vector per axis: the tangent predictor.
    pub sensitivity: [Vec<f64>; 3],
    /// The condensed energy there: what the next solution must join smoothly.
    pub jet: EnergyJet,
}

/// One solved configuration: the paper's C = (p, u, h), with its energy and the derivatives of it.
#[derive(Debug, Clone)]
pub struct Configuration {
    /// Pose, state, sensitivity and condensed energy: what the next solve starts from.
    pub seed: Seed,
    /// Moment by the tool on the body about the handle's centre where it is now, N m; zero for a single node.
    pub torque_n_m: [f64; 3],
    /// Norm of the residual over all equations (constraints scaled like forces), N.
    pub residual_n: f64,
    /// Smallest J over the quadrature points.
    pub min_jacobian: f64,
    /// Elements with J <= 0: kept, but flagged.
    pub inverted: usize,
    /// Deformed volume, m^3.
    pub volume_m3: f64,
    /// Directions in which the energy falls (negative pivots of the tangent too many); `None` if the factorisation that
    /// solved it tells no inertia.
    pub unstable_modes: Option<u32>,
    /// Newton iterations, summed over increments and failed tries.
    pub iterations: u32,
    /// Factorisations, counted alike.
    pub factorisations: u32,
    /// Load increments that the step was split into.
    pub increments: u32,
    /// Whether the transition left the branch it started on: however small the steps, W, h and S do not join.
    pub switched: bool,
}

/// Solver of one thread: the problem's numbers and scratch memory. Nothing is allocated in an iteration.
#[derive(Debug)]
pub struct Solver {
    problem: Arc<Problem>,
    /// Convergence control.
    pub newton: NewtonOptions,
    /// Step control.
    pub loading: LoadingOptions,
    assembled: Assembled,
    coupling: HandleCoupling,
    factor: Factor,
    history: StepHistory,
    /// The state being solved for, and the one tried next.
    state: Vec<f64>,
    trial: Vec<f64>,
    /// Multipliers of the held components over the stiffness scale, m; empty with elimination.
    multipliers: Vec<f64>,
    /// Prescribed displacement of each multiplier's component, m.
    targets_m: Vec<f64>,
    residual: Vec<f64>,
    step: Vec<f64>,
    columns: Vec<f64>,
    right: Vec<f64>,
    /// Share of `step` that the last move took.
    moved_by: f64,
    factorisations: u32,
}

impl Solver {
    /// Solver of `problem` with default options.
    pub fn new(problem: Arc<Problem>) -> Self {
        let n = problem.unknowns();
        let held = problem.dofs.multipliers().len();
        Self {
            newton: problem.newton,
            loading: LoadingOptions::default(),
            assembled: Assembled::new(&problem.body, &problem.pattern),
            coupling: HandleCoupling::new(n),
            factor: Factor::new(&problem.symbolic, &problem.pattern),
            history: StepHistory::new(n),
            state: vec![0.0; problem.body.state_len()],
            trial: vec![0.0; problem.body.state_len()],
            multipliers: vec![0.0; held],
            targets_m: vec![0.0; held],
            residual: vec![0.0; n],
            step: vec![0.0; n],
            columns: vec![0.0; RIGHT_SIDES * n],
            right: vec![0.0; RIGHT_SIDES * n],
            moved_by: 0.0,
            factorisations: 0,
            problem,
        }
    }

    /// The problem solved here.
    pub fn problem(&self) -> &Arc<Problem> {
        &self.problem
    }

    /// The configuration at rest (the paper's C_000): zero displacement and force, with its tangent.
    pub fn rest(&mut self) -> Result<Configuration, SolveFailure> {
        let state = self.problem.body.rest.state.clone();
        self.solve_at(&Pose::default(), &state)
    }

    /// Force on every node at the last residual, 3 per node, N: reactions where a node is held.
    pub fn nodal_force_n(&self) -> &[f64] {
        &self.assembled.nodal_force_n
    }
}

impl Configuration {
    /// W (stationary potential, zero at rest), h (force by the tool on the body, summed over the handle), S and W_ijk.
    pub fn jet(&self) -> &EnergyJet {
        &self.seed.jet
    }
}
