//! Static equilibrium of a body in contact with a tool at a prescribed pose.
//!
//! [`Problem`] is built once per contact and shared by all threads; each thread owns a [`Solver`].
//! [`Solver::advance`] computes the transition from a solved [`Configuration`] to a new position by
//! incremental loading.

mod body_force;
mod condensed;
mod elastic;
mod factor;
mod follow;
mod free_body;
mod held;
mod incremental_loading;
mod newton;
mod partner;
mod profile;
mod quasi_newton;
mod relax;
mod renewal;
mod sphere;
mod stability;

#[cfg(test)]
mod tests;

use std::sync::{Arc, OnceLock};

pub use body_force::solve_body_force;
pub use follow::{FollowCount, FollowOptions, Followed};
pub use free_body::FreeBody;
pub(crate) use incremental_loading::LoadingOptions;
pub use newton::{FailureReason, NewtonOptions, SolveFailure};
pub use partner::{Coupling, Second};
pub use profile::IterationProfile;
pub use relax::DESCENT_STEPS;
pub use renewal::Renewal;
pub use sphere::{Pressed, SphereSolver};

use crate::fem::assembly::{Assembled, HandleCoupling, Pattern};
use crate::fem::body::Body;
use crate::fem::boundary::{Constraints, Contact, DofMap, Handle, Pose};
use crate::fem::elastic::ElasticState;
use crate::fem::element::Order;
use crate::num::jet::EnergyJet;
use factor::{Factor, Matrix, NearEquations, PackedFactor, RIGHT_SIDES, SymbolicFactor};
use held::HeldEntries;
use partner::Partner;
use quasi_newton::StepHistory;

/// A body, the tool's handle on it, and all data that are constant for all solves.
#[derive(Debug)]
pub struct Problem {
    /// The body.
    pub body: Arc<Body>,
    /// The tool's contact; `None` for the rest state under the body force.
    pub contact: Option<Contact>,
    /// Initial convergence options of its solvers.
    pub newton: NewtonOptions,
    dofs: Arc<DofMap>,
    pattern: Arc<Pattern>,
    symbolic: Arc<SymbolicFactor>,
    /// (equation, state position) of every unknown of the state.
    positions: Arc<[(usize, usize)]>,
    /// Entries of a held node that was numbered like the others.
    held: Option<HeldEntries>,
    /// The factor of the body at rest without a tool, if it is large, made by the first solve.
    far: Arc<OnceLock<Option<Arc<PackedFactor>>>>,
    /// The equations near its tool.
    near: OnceLock<Option<Arc<NearEquations>>>,
}

/// Number of floating-point operations of a factorisation above which a body is large, about 14,000 equations. There
/// residual steps with one factor for all states take half to three quarters of the time of a factor for each. They gain
/// from a third of this on, but smaller bodies keep factors, which give the inertia and serve for the next states.
const LARGE_FLOPS: f64 = 4e9;

impl Problem {
    /// Problem of one active node with elimination. The node must not be fixed.
    pub fn new(body: Arc<Body>, active_node: u32) -> Self {
        Self::with(body, Some(Handle::node(active_node).into()), Constraints::Elimination)
    }

    /// Numbers the unknowns, builds the sparsity pattern and analyses it.
    pub fn with(body: Arc<Body>, contact: Option<Contact>, constraints: Constraints) -> Self {
        let contact = contact.map(|contact| match contact {
            Contact::Held(handle) => Contact::Held(handle.on(&body)),
            elastic => elastic,
        });
        let dofs = DofMap::new(&body, contact.as_ref().and_then(Contact::handle), constraints);
        let pattern = Pattern::new(&body, &dofs);
        let regularised = regularised_diagonal(&body, &dofs);
        let pressures = (0..body.pressure_sites.len() as u32)
            .filter(|&p| (dofs.pressure(p) as usize) < dofs.unknowns)
            .count();
        let negative = pressures + dofs.multipliers.len();
        let symbolic = SymbolicFactor::new(&pattern, &regularised, negative);
        let positions = dofs.state_positions().collect();
        let problem = Self {
            body,
            contact: None,
            newton: NewtonOptions::default(),
            dofs: Arc::new(dofs),
            pattern: Arc::new(pattern),
            symbolic: Arc::new(symbolic),
            positions,
            held: None,
            far: Arc::default(),
            near: OnceLock::new(),
        };
        problem.touched_by(contact)
    }

    /// The problem with another contact: an elastic tool, the pad at another contact point, or another held node. It shares
    /// numbering, pattern and analysis. An elastic tool adds no equation and no entry; the equations of a held node stay
    /// and have the solution zero.
    ///
    /// # Panics
    ///
    /// If this problem was built with a handle, which has fewer equations, or if the contact is a handle of
    /// several nodes or on a node with a fixed component.
    #[must_use]
    pub fn at(&self, contact: impl Into<Contact>) -> Self {
        assert!(
            self.held.is_some() || self.handle_nodes().is_empty(),
            "a problem of held nodes has fewer equations"
        );
        let contact = contact.into();
        let Self { body, contact: _, newton, dofs, pattern, symbolic, far, .. } = self;
        let held = contact.handle().map(|handle| {
            assert!(handle.nodes.len() == 1, "one held node");
            let equations = dofs.displacement(handle.centre);
            assert!(equations.iter().all(|&e| (e as usize) < dofs.unknowns), "the node is fixed");
            equations
        });
        let is_free =
            |&(equation, _): &(usize, usize)| !held.iter().flatten().any(|&e| e as usize == equation);
        let shared = Self {
            body: body.clone(),
            contact: None,
            newton: *newton,
            dofs: dofs.clone(),
            pattern: pattern.clone(),
            symbolic: symbolic.clone(),
            positions: dofs.state_positions().filter(is_free).collect(),
            held: held.map(|equations| HeldEntries::new(pattern, equations)),
            far: far.clone(),
            near: OnceLock::new(),
        };
        shared.touched_by(Some(contact))
    }

    fn touched_by(self, contact: Option<Contact>) -> Self {
        let follows = |node: u32| self.body.followers.iter().any(|follower| follower.node == node);
        debug_assert!(
            contact
                .as_ref()
                .and_then(Contact::pad)
                .is_none_or(|pad| !pad.nodes.iter().any(|n| follows(n.node)))
        );
        Self { contact, ..self }
    }

    /// Whether Lagrange multipliers prescribe displacements.
    pub(crate) fn has_multipliers(&self) -> bool {
        !self.dofs.multipliers.is_empty()
    }

    /// Number of equations.
    pub fn unknowns(&self) -> usize {
        self.dofs.unknowns
    }

    /// Numbers of entries of the matrix (lower triangle) and of its factor.
    pub fn entries(&self) -> (usize, usize) {
        (self.pattern.entries(), self.symbolic.factor_entries())
    }

    /// Number of floating-point operations of one factorisation.
    pub fn factor_flops(&self) -> f64 {
        self.symbolic.flops().0
    }

    /// The matrix with these values.
    fn matrix<'a>(&'a self, values: &'a [f64]) -> Matrix<'a> {
        Matrix { symbolic: &self.symbolic, pattern: &self.pattern, values, at: None }
    }

    /// The tangent at a state.
    fn tangent<'a>(&'a self, values: &'a [f64], state: &'a [f64]) -> Matrix<'a> {
        Matrix { at: Some((self, state)), ..self.matrix(values) }
    }

    /// Whether a factorisation costs more than the residual steps of a solve without one. A sphere has no place on the
    /// body for them.
    pub fn is_large(&self) -> bool {
        let has_place = !matches!(self.contact, Some(Contact::Sphere(_)));
        has_place && self.factor_flops() >= self.newton.large_flops && self.dofs.multipliers.is_empty()
    }

    /// Whether the body is large, and has a factor at rest that serves its states.
    pub(crate) fn needs_no_factor(&self) -> bool {
        self.is_large() && self.far_factor().is_some()
    }

    /// The factor of the body at rest without a tool; `None` if it is singular.
    fn far_factor(&self) -> Option<Arc<PackedFactor>> {
        let make = || PackedFactor::at_rest(self).map(Arc::new);
        self.far.get_or_init(make).clone()
    }

    /// The equations near the tool, if it has a place on the body.
    fn near_equations(&self) -> Option<&Arc<NearEquations>> {
        self.near.get_or_init(|| NearEquations::of(self).map(Arc::new)).as_ref()
    }

    fn handle_nodes(&self) -> &[u32] {
        self.contact.as_ref().and_then(Contact::handle).map_or(&[], |handle| &handle.nodes)
    }

    /// Whether the tool adds a potential and prescribes no displacement.
    fn is_elastic(&self) -> bool {
        self.contact.as_ref().is_some_and(|contact| contact.handle().is_none())
    }
}

/// Share of V_i / mu that is the unit of a regularisation.
///
/// A stable pair permits a smaller regularisation and then needs no refinement. With P1/P1 the rounding error, amplified by
/// the inverse of the regularisation, would cost more than it saves (measured: one sweep leaves 5e-12 with P2/P1, 3e-8 with
/// P1/P1).
fn pressure_share(order: Order) -> f64 {
    match order {
        Order::Linear => 1.0,
        Order::Quadratic => 1e-2,
    }
}

/// (equation, share of V_i / mu in scaled units) of every pressure without a block.
fn regularised_diagonal(body: &Body, dofs: &DofMap) -> Vec<(usize, f64)> {
    let mut volume_m3 = vec![0.0; body.pressure_sites.len()];
    let mut own_block = vec![true; body.pressure_sites.len()];
    for element in &body.elements {
        for (v, &pressure) in element.pressures.iter().enumerate() {
            if let Some(volume) = volume_m3.get_mut(pressure as usize) {
                *volume += 0.25 * element.tet.volume_m3;
                own_block[pressure as usize] &= element.pressure_block[v][v] != 0.0;
            }
        }
    }
    let scale = body.pressure_scale() * f64::sqrt(pressure_share(body.order));
    (0..body.pressure_sites.len())
        .filter_map(|pressure| {
            let equation = dofs.pressure(pressure as u32) as usize;
            let (_, region) = body.pressure_sites[pressure];
            let shear_pa = body.regions[usize::from(region)].material.shear_modulus_pa();
            let size = scale * scale * volume_m3[pressure] / shear_pa;
            (equation < dofs.unknowns && !own_block[pressure]).then_some((equation, size))
        })
        .collect()
}

/// Start of a solve: a solved pose, its state, and the derivative of the state with respect to the control.
#[derive(Debug, Clone)]
pub struct Seed {
    /// Pose of the handle, relative to rest.
    pub pose: Pose,
    /// State vector of [`Body`].
    pub state: Vec<f64>,
    /// d(state)/dd along a translation of the handle, one state vector per axis: the tangent predictor.
    pub sensitivity: [Vec<f64>; 3],
    /// Condensed energy of the state, for the test whether the next solution lies on the same branch.
    pub jet: EnergyJet,
    /// The partner, if there is one.
    pub coupling: Option<Coupling>,
}

impl Seed {
    /// The body at rest, with neither sensitivities nor a tangent.
    pub fn at_rest(body: &Body) -> Self {
        let sensitivity = [(); 3].map(|()| vec![0.0; body.state_len()]);
        let jet = EnergyJet::from_numbers([0.0; 3], &[0.0; 20]);
        Self { pose: Pose::default(), state: body.rest_state.clone(), sensitivity, jet, coupling: None }
    }

    /// Becomes [`Seed::at_rest`] in the same memory, with the tool at a displacement where it touches nothing, or at zero.
    pub fn become_rest(&mut self, body: &Body, displacement_m: [f64; 3]) {
        self.pose = Pose::translation(displacement_m);
        self.state.copy_from_slice(&body.rest_state);
        self.sensitivity.iter_mut().for_each(|column| column.fill(0.0));
        self.jet = EnergyJet::from_numbers(displacement_m, &[0.0; 20]);
        self.coupling = None;
    }
}

/// One solved configuration: the paper's C = (p, u, h), with its energy and the derivatives of the energy.
#[derive(Debug, Clone)]
pub struct Configuration {
    /// Pose, state, sensitivity and condensed energy: the start of the next solve.
    pub seed: Seed,
    /// Moment of the tool on the body about the current position of the centre of a patch or of the finger,
    /// N m; zero for a single node.
    pub torque_n_m: [f64; 3],
    /// Norm of the residual over all equations (constraints scaled like forces), N.
    pub residual_n: f64,
    /// Smallest J over the quadrature points.
    pub min_jacobian: f64,
    /// Number of elements with J <= 0; such a configuration is kept and flagged.
    pub inverted: usize,
    /// Deformed volume, m^3.
    pub volume_m3: f64,
    /// Number of directions in which the energy decreases (surplus negative pivots of the tangent); `None` if
    /// the factorisation does not give the inertia, or if none was made: [`Solver::unstable_modes_at`] makes one.
    pub unstable_modes: Option<u32>,
    /// Newton iterations, including those of failed attempts, summed over all increments.
    pub iterations: u32,
    /// Factorisations, counted in the same way. Of a large body, tangents that were solved.
    pub factorisations: u32,
    /// Number of load increments of the transition.
    pub increments: u32,
    /// Whether the transition changed its branch: W, h and S do not join smoothly even with the smallest
    /// steps.
    pub switched: bool,
}

/// Solver of one thread: options and scratch memory of a problem. The iterations allocate only for a large body, for its
/// preconditioner.
#[derive(Debug)]
pub struct Solver {
    problem: Arc<Problem>,
    /// Convergence control.
    pub newton: NewtonOptions,
    /// Step control.
    pub(crate) loading: LoadingOptions,
    assembled: Assembled,
    coupling: HandleCoupling,
    factor: Factor,
    history: StepHistory,
    /// The current state, and the state before the last step.
    state: Vec<f64>,
    previous: Vec<f64>,
    /// Multipliers of the prescribed components, divided by the stiffness scale, m; empty with elimination.
    multipliers: Vec<f64>,
    /// Prescribed displacement of each multiplier's component, m.
    targets_m: Vec<f64>,
    residual: Vec<f64>,
    step: Vec<f64>,
    columns: Vec<f64>,
    right: Vec<f64>,
    /// An elastic tool at the current state, and the displacement of the tool, m.
    elastic: ElasticState,
    control_m: [f64; 3],
    /// Another sphere on the body.
    partner: Option<Partner>,
    /// Half axis of a capsule, m.
    half_m: Option<[f64; 3]>,
    /// Share of `step` in the last move of the state.
    moved_by: f64,
    /// Control at which the configuration of a large body gets a factor, so that its stability is known.
    factor_at_m: Option<[f64; 3]>,
    /// Numbers of iterations and factorisations since the start of the transition.
    iterations: u32,
    factorisations: u32,
}

impl Solver {
    /// Solver of `problem` with default options.
    pub fn new(problem: Arc<Problem>) -> Self {
        let n = problem.unknowns();
        let held = problem.dofs.multipliers.len();
        Self {
            newton: problem.newton,
            loading: LoadingOptions::default(),
            assembled: Assembled::new(&problem.body, &problem.pattern),
            coupling: HandleCoupling::new(n),
            factor: Factor::new(&problem.symbolic, &problem.pattern),
            history: StepHistory::new(n),
            state: vec![0.0; problem.body.state_len()],
            previous: vec![0.0; problem.body.state_len()],
            multipliers: vec![0.0; held],
            targets_m: vec![0.0; held],
            residual: vec![0.0; n],
            step: vec![0.0; n],
            columns: vec![0.0; RIGHT_SIDES * n],
            right: vec![0.0; RIGHT_SIDES * n],
            elastic: ElasticState::default(),
            control_m: [0.0; 3],
            partner: None,
            half_m: None,
            moved_by: 0.0,
            factor_at_m: None,
            iterations: 0,
            factorisations: 0,
            problem,
        }
    }

    /// Goes on with another contact on the same body, of [`Problem::at`]. The factor is kept: that of a
    /// neighbouring contact can serve for steps.
    ///
    /// # Panics
    ///
    /// If the problem has another numbering.
    pub fn touch(&mut self, problem: Arc<Problem>) {
        assert!(Arc::ptr_eq(&self.problem.dofs, &problem.dofs), "another numbering");
        self.problem = problem;
        self.history.clear();
        // The components of a held node have no residual and no step.
        self.residual.fill(0.0);
        self.step.fill(0.0);
        self.elastic.clear();
    }

    /// The problem solved here.
    pub fn problem(&self) -> &Arc<Problem> {
        &self.problem
    }

    /// The configuration at zero displacement: at rest (the paper's C_000), with zero force and its tangent. A sphere that
    /// overlaps the body at rest comes in from beside it, away from the nearest point of the skin.
    pub fn rest(&mut self) -> Result<Configuration, SolveFailure> {
        let state = self.problem.body.rest_state.clone();
        let beside = self.problem.contact.as_ref().and_then(|contact| match contact {
            Contact::Sphere(sphere) => {
                Some(sphere.beside_m(&self.problem.body, [0.0; 3])).filter(|&beside_m| beside_m != [0.0; 3])
            }
            Contact::Held(_) | Contact::Pad(_) => None,
        });
        let Some(beside_m) = beside else { return self.solve_at(&Pose::default(), &state) };
        let free = self.solve_at(&Pose::translation(beside_m), &state)?;
        self.advance(&free.seed, [0.0; 3])
    }

    /// Force on every node at the last residual, 3 per node, N; the reactions at the prescribed nodes.
    pub fn nodal_force_n(&self) -> &[f64] {
        &self.assembled.nodal_force_n
    }
}

impl Configuration {
    /// W (stationary potential, zero at rest), h (force of the tool on the body, summed over the handle), S
    /// and W_ijk.
    pub fn jet(&self) -> &EnergyJet {
        &self.seed.jet
    }
}
