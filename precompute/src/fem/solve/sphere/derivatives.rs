//! The derivatives of W at an equilibrium under a sphere, by the formulas of [`super`].

use nalgebra::{DMatrix, Matrix3, Vector3};

use super::super::factor::{RIGHT_SIDES, SENSITIVITY_ACCURACY};
use super::super::{Configuration, FailureReason, Seed, SolveFailure, Solver};
use super::linearised::Linearised;
use super::{Force, Pressed, SphereSolver};
use crate::fem::assembly::third_derivatives;
use crate::fem::boundary::Pose;
use crate::fem::sphere::{Gap, Variation};
use crate::num::jet::{EnergyJet, SymmetricThird, THIRD_INDICES};
use crate::num::vector::inner;

impl SphereSolver {
    /// The configuration of the equilibrium that was reached.
    pub(super) fn condense(
        &mut self,
        centre: Vector3<f64>,
        gaps: &[Gap],
        forces: Vec<Force>,
        residual_n: f64,
    ) -> Result<Pressed, SolveFailure> {
        let iterations = self.solver.iterations;
        let failed = |reason| SolveFailure { reason, iterations, residual_n };
        let (gaps, forces): (Vec<Gap>, Vec<Force>) =
            gaps.iter().copied().zip(forces).filter(|(_, force)| force.force_n > 0.0).unzip();
        let singular = |_| failed(FailureReason::SingularTangent);
        let contact = self.linearise(gaps, &forces).map_err(singular)?;
        let loads = self.centre_loads(&contact.gaps, &forces);
        let (changes, unstable) =
            self.respond(&contact, &loads).ok_or(failed(FailureReason::SingularTangent))?;
        let stiffness_n_m = stiffness(&contact.gaps, &forces, &loads, &self.solver.columns, &changes);
        let sensitivity = self.solver.sensitivity_of_state();
        let third_n_m2 = self.third(&contact.gaps, &forces, &sensitivity, &changes);
        let (body, assembled) = (&self.solver.problem.body, &self.solver.assembled);
        let force = contact.gaps.iter().zip(&forces).map(|(gap, force)| force.force_n * gap.normal);
        let jet = EnergyJet {
            control_m: centre.into(),
            energy_j: assembled.energy_j - body.rest_energy_j,
            force_n: force.sum::<Vector3<f64>>().into(),
            stiffness_n_m: 0.5 * (stiffness_n_m + stiffness_n_m.transpose()),
            third_n_m2,
        };
        if !jet.is_finite() {
            return Err(failed(FailureReason::NotFinite));
        }
        let pose = Pose::translation(centre.into());
        let configuration = Configuration {
            seed: Seed { pose, state: self.solver.state.clone(), sensitivity, jet, coupling: None },
            // The forces go through the centre.
            torque_n_m: [0.0; 3],
            residual_n,
            min_jacobian: assembled.min_jacobian,
            inverted: assembled.inverted,
            volume_m3: assembled.volume_m3,
            unstable_modes: unstable,
            iterations,
            factorisations: self.solver.factorisations,
            increments: 1,
            switched: false,
        };
        Ok(Pressed { configuration, forces })
    }

    /// B, a column for each axis of the centre.
    fn centre_loads(&self, gaps: &[Gap], forces: &[Force]) -> Vec<f64> {
        let problem = &self.solver.problem;
        let n = problem.unknowns();
        let mut loads = vec![0.0; RIGHT_SIDES * n];
        for (gap, force) in gaps.iter().zip(forces) {
            for (i, &corner) in gap.feature.corners().iter().enumerate() {
                let block = gap.second(Some(i), None);
                for (row, equation) in problem.dofs.displacement(corner).into_iter().enumerate() {
                    for axis in (0..3).filter(|_| (equation as usize) < n) {
                        loads[axis * n + equation as usize] -= force.force_n * block[(row, axis)];
                    }
                }
            }
        }
        loads
    }

    /// W_ijk.
    fn third(
        &self,
        gaps: &[Gap],
        forces: &[Force],
        sensitivity: &[Vec<f64>; 3],
        changes: &DMatrix<f64>,
    ) -> SymmetricThird {
        let mut third = third_derivatives(&self.solver.problem.body, &self.solver.state, sensitivity);
        for (k, (gap, force)) in gaps.iter().zip(forces).enumerate() {
            let along: [Variation; 3] = std::array::from_fn(|axis| {
                let mut corners = [Vector3::zeros(); 3];
                for (to, &node) in corners.iter_mut().zip(gap.feature.corners()) {
                    *to = Vector3::from_column_slice(&sensitivity[axis][3 * node as usize..][..3]);
                }
                Variation { corners, centre: Vector3::ith(axis, 1.0) }
            });
            for (value, &[i, j, l]) in third.iter_mut().zip(&THIRD_INDICES) {
                *value -= force.force_n * gap.along_three([&along[i], &along[j], &along[l]]);
                for (one, two, other) in [(i, j, l), (j, i, l), (l, i, j)] {
                    *value -= changes[(k, one)] * gap.along_two(&along[two], &along[other]);
                }
            }
        }
        third
    }

    /// U into the columns of the solver; returns dl, a row for each gap, and the number of unstable modes: the surplus
    /// negative pivots of H, less the negative values of D.
    fn respond(&mut self, contact: &Linearised, loads: &[f64]) -> Option<(DMatrix<f64>, Option<u32>)> {
        let (problem, n) = (self.solver.problem.clone(), self.solver.problem.unknowns());
        let Solver { factor, assembled, columns, right, .. } = &mut self.solver;
        let matrix = problem.matrix(&assembled.tangent);
        right.copy_from_slice(loads);
        factor.solve(matrix, right, columns, SENSITIVITY_ACCURACY);
        let mut responses = vec![0.0; contact.gradients.len()];
        for (x, b) in responses.chunks_mut(RIGHT_SIDES * n).zip(contact.gradients.chunks(RIGHT_SIDES * n)) {
            factor.solve(matrix, b, x, SENSITIVITY_ACCURACY);
        }
        let count = contact.gaps.len();
        let gradient = |k: usize| &contact.gradients[k * n..(k + 1) * n];
        let compliance =
            DMatrix::from_fn(count, count, |i, j| inner(gradient(i), &responses[j * n..(j + 1) * n]));
        let right = DMatrix::from_fn(count, 3, |k, axis| {
            inner(gradient(k), &columns[axis * n..(axis + 1) * n]) + contact.gaps[k].normal[axis]
        });
        let changes = if count == 0 { right } else { compliance.clone().lu().solve(&right)? };
        for axis in 0..3 {
            let column = &mut columns[axis * n..(axis + 1) * n];
            column.iter_mut().for_each(|x| *x = -*x);
            for (k, y) in responses.chunks(n).enumerate().take(count) {
                column.iter_mut().zip(y).for_each(|(x, y)| *x += changes[(k, axis)] * y);
            }
        }
        let negative = if count == 0 {
            0
        } else {
            compliance.symmetric_eigenvalues().iter().filter(|value| **value < 0.0).count() as u32
        };
        let unstable = factor.unstable_modes(&problem.symbolic).map(|modes| modes.saturating_sub(negative));
        Some((changes, unstable))
    }
}

/// S, from B, U and dl.
fn stiffness(
    gaps: &[Gap],
    forces: &[Force],
    loads: &[f64],
    u: &[f64],
    changes: &DMatrix<f64>,
) -> Matrix3<f64> {
    let n = u.len() / 3;
    let column = |all: &'_ [f64], axis: usize| -> Vec<f64> { all[axis * n..(axis + 1) * n].to_vec() };
    let mut sum = Matrix3::from_fn(|i, j| inner(&column(loads, i), &column(u, j)));
    for (k, (gap, force)) in gaps.iter().zip(forces).enumerate() {
        sum -= gap.second(None, None) * force.force_n;
        sum += Matrix3::from_fn(|i, j| gap.normal[i] * changes[(k, j)]);
    }
    sum
}
