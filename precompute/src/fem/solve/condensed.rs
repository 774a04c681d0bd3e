//! Results of a converged state: reaction, condensed tangent, sensitivities and third derivatives.

use nalgebra::{Matrix3, Vector3};

use super::factor::{Accuracy, SENSITIVITY_ACCURACY};
use super::{Configuration, FailureReason, Problem, Seed, SolveFailure, Solver};
use crate::fem::boundary::{Contact, Pose};
use crate::num::jet::EnergyJet;
use crate::num::vector::inner;

/// Of a large body: the relative residual of X, of which the error of W_ijk is a multiple and that of S the square.
const LARGE_SENSITIVITY_ACCURACY: Accuracy = Accuracy::new(1e-7, 1e-5);

impl Solver {
    /// Prescribes the pose: in the state with elimination, otherwise as targets of the multipliers.
    pub(super) fn prescribe(&mut self, pose: &Pose) {
        let body = &self.problem.body;
        let displaced = |node: u32, centre: u32| -> [f64; 3] {
            let arm = Vector3::from(body.rest_position_m(node)) - Vector3::from(body.rest_position_m(centre));
            let moved = pose.displacement_of(&arm);
            std::array::from_fn(|axis| body.rest_state[3 * node as usize + axis] + moved[axis])
        };
        self.control_m = pose.displacement_m;
        let Some(handle) = self.problem.contact.as_ref().and_then(Contact::handle) else { return };
        let held = &self.problem.dofs.multipliers;
        if held.is_empty() {
            for &node in &handle.nodes {
                let base = 3 * node as usize;
                self.state[base..base + 3].copy_from_slice(&displaced(node, handle.centre));
            }
            return;
        }
        for (m, target) in held.iter().zip(&mut self.targets_m) {
            let moves = handle.nodes.binary_search(&m.node).is_ok();
            *target = if moves { displaced(m.node, handle.centre)[m.axis] } else { 0.0 };
        }
        // Multipliers that balance the guess, so that only the constraints have a residual.
        self.assembled.assemble_residual(body, &self.state);
        let scale = body.stiffness_scale_n_m();
        for (m, value) in held.iter().zip(&mut self.multipliers) {
            *value = self.assembled.nodal_force_n[3 * m.node as usize + m.axis] / scale;
        }
    }

    /// Computes the sensitivities, the last correction and the condensed quantities of the converged state.
    ///
    /// With the tangent K of the unknowns and its columns K_fA along a translation of the handle,
    ///
    /// X = -K^-1 K_fA (du/dd and dq/dd),   S = K_AA + K_Af X (symmetric).
    ///
    /// With multipliers, X = K^-1 (unit displacement in the constraints), and S is the multipliers' part of
    /// X. The last Newton correction uses the same factor as X.
    pub(super) fn condense(
        &mut self,
        pose: &Pose,
        residual_n: f64,
        iterations: u32,
    ) -> Result<Configuration, SolveFailure> {
        let fail = |reason, residual_n| Err(SolveFailure { reason, iterations, residual_n });
        self.evaluate(true);
        let problem = self.problem.clone();
        let body = &problem.body;
        self.translation_columns();
        self.factorisations += 1;
        let is_due = self.factor_at_m == Some(pose.displacement_m);
        let without = problem.is_large() && !is_due;
        let tangent = &self.assembled.tangent;
        let matrix = if without { problem.tangent(tangent, &self.state) } else { problem.matrix(tangent) };
        let accuracy = if without { LARGE_SENSITIVITY_ACCURACY } else { SENSITIVITY_ACCURACY };
        // The part near the tool is that of the solution, not of the guess.
        self.factor.follow_next_tangent();
        let solved = self.factor.factorise_and_solve(matrix, &self.right, &mut self.columns, accuracy);
        if solved.is_err() {
            return fail(FailureReason::SingularTangent, residual_n);
        }
        let unstable_modes = self.factor.unstable_modes(&problem.symbolic);
        let stiffness = self.condensed_stiffness(&problem);
        let sensitivity = self.sensitivity_of_state();
        let third_n_m2 = self.third(&sensitivity);
        let mut coupling = self.coupling(&sensitivity);
        self.complete(&mut coupling);
        let residual_n = self.final_correction(residual_n);
        let assembled = &self.assembled;
        if self.newton.reject_inverted && assembled.inverted > 0 {
            return fail(FailureReason::Inverted, residual_n);
        }
        if self.is_pierced() {
            return fail(FailureReason::Pierced, residual_n);
        }
        let energy_j = assembled.energy_j - body.rest_energy_j + self.elastic.energy_j + self.of_partner().0;
        let (force_n, torque_n_m) = self.resultants(pose);
        // S is symmetric by definition; rounding makes the computed S unsymmetric in its last digits.
        let stiffness_n_m = 0.5 * (stiffness + stiffness.transpose());
        let jet = EnergyJet { control_m: pose.displacement_m, energy_j, force_n, stiffness_n_m, third_n_m2 };
        if !jet.is_finite() {
            return fail(FailureReason::NotFinite, residual_n);
        }
        Ok(Configuration {
            seed: Seed { pose: *pose, state: self.state.clone(), sensitivity, jet, coupling },
            torque_n_m,
            residual_n,
            min_jacobian: assembled.min_jacobian,
            inverted: assembled.inverted,
            volume_m3: assembled.volume_m3,
            unstable_modes,
            iterations,
            factorisations: self.factorisations,
            increments: 1,
            switched: false,
        })
    }

    /// Right-hand sides of the sensitivities, one column per axis, at the last assembled tangent.
    pub(super) fn translation_columns(&mut self) {
        let problem = &*self.problem;
        let n = problem.unknowns();
        let held = &problem.dofs.multipliers;
        if problem.is_elastic() {
            self.elastic_columns();
            return;
        }
        if held.is_empty() {
            if problem.held.is_none() {
                self.coupling.assemble(&problem.body, &problem.pattern, &self.state);
            }
            for (right, k) in self.right.iter_mut().zip(&self.coupling.free) {
                *right = -k;
            }
            return;
        }
        self.right.fill(0.0);
        let tie = -problem.body.stiffness_scale_n_m();
        for m in held.iter().filter(|m| problem.handle_nodes().binary_search(&m.node).is_ok()) {
            self.right[m.axis * n + m.equation as usize] = tie;
        }
    }

    /// du/dd and dp/dd of every node along each axis, from the solved columns.
    pub(super) fn sensitivity_of_state(&self) -> [Vec<f64>; 3] {
        let mut sensitivity = [(); 3].map(|()| vec![0.0; self.problem.body.state_len()]);
        self.sensitivity_into(&mut sensitivity);
        sensitivity
    }

    /// The same into vectors of zeros or of earlier sensitivities.
    pub(super) fn sensitivity_into(&self, sensitivity: &mut [Vec<f64>; 3]) {
        let (problem, body) = (&*self.problem, &self.problem.body);
        let n = problem.unknowns();
        let (displacement_len, pressure_scale) = (body.displacement_len(), body.pressure_scale());
        for (axis, state_column) in sensitivity.iter_mut().enumerate() {
            let x = &self.columns[axis * n..(axis + 1) * n];
            for &(equation, position) in problem.positions.iter() {
                let unit = if position < displacement_len { 1.0 } else { pressure_scale };
                state_column[position] = unit * x[equation];
            }
            for &node in problem.handle_nodes() {
                for (component, value) in state_column[3 * node as usize..][..3].iter_mut().enumerate() {
                    *value = f64::from(u8::from(component == axis));
                }
            }
            body.let_follow(state_column);
        }
    }

    /// S from the solved columns x_j of the right-hand sides b_j and their residuals r_j = b_j - K x_j.
    ///
    /// S_ij = (K_AA)_ij - b_i . x_j - x_i . r_j, with Phi_dd for K_AA and b = -Phi_ud for an elastic tool. With the last term
    /// the error of S is of the order of the square of the error of x, so one solve without refinement
    /// suffices. With multipliers K_AA is zero.
    pub(super) fn condensed_stiffness(&self, problem: &Problem) -> Matrix3<f64> {
        let own = match problem.dofs.multipliers.is_empty() {
            _ if problem.is_elastic() => self.elastic.own_n_m,
            true => self.coupling.own,
            false => Matrix3::zeros(),
        };
        self.condensed(own)
    }

    /// The same from another own part, with the columns of another control.
    pub(super) fn condensed(&self, own: Matrix3<f64>) -> Matrix3<f64> {
        let n = self.problem.unknowns();
        let column = |axis: usize| axis * n..(axis + 1) * n;
        let (right, x, residuals) = (&self.right, &self.columns, self.factor.residuals());
        own - Matrix3::from_fn(|i, j| {
            inner(&right[column(i)], &x[column(j)]) + inner(&x[column(i)], &residuals[column(j)])
        })
    }

    /// Force on the handle, and moment about the current position of its centre.
    pub(super) fn resultants(&self, pose: &Pose) -> ([f64; 3], [f64; 3]) {
        let (problem, body) = (&*self.problem, &self.problem.body);
        if problem.is_elastic() {
            return (self.elastic.force_n.into(), self.elastic.torque_n_m.into());
        }
        let Some(handle) = problem.contact.as_ref().and_then(Contact::handle) else {
            return ([0.0; 3], [0.0; 3]);
        };
        let centre = Vector3::from(body.rest_position_m(handle.centre));
        let scale = body.stiffness_scale_n_m();
        let (mut force, mut torque) = (Vector3::zeros(), Vector3::zeros());
        for &node in &handle.nodes {
            let mut here = Vector3::from(self.assembled.force_on(&[node]));
            for (m, value) in problem.dofs.multipliers.iter().zip(&self.multipliers) {
                if m.node == node {
                    here[m.axis] = value * scale;
                }
            }
            let arm = Vector3::from(body.rest_position_m(node)) - centre;
            let arm_now = arm + pose.displacement_of(&arm) - Vector3::from(pose.displacement_m);
            force += here;
            torque += arm_now.cross(&here);
        }
        (force.into(), torque.into())
    }
}
