//! The contact of a sphere, linearised at a state of the body, and one Newton step.

use nalgebra::{DMatrix, DVector, Vector3};

use super::super::Solver;
use super::super::factor::{RIGHT_SIDES, STEP_ACCURACY, SingularMatrix};
use super::{Force, SphereSolver};
use crate::fem::sphere::{Gap, complementary};
use crate::num::vector::{inner, magnitude};

/// Features within this multiple of the radius from the centre are candidates.
const CANDIDATES: f64 = 1.3;
/// Every gap with a force, and every overlap, of an equilibrium is below this share of the radius.
const GAP_TOLERANCE: f64 = 1e-9;
/// Largest number of halvings of a step of the state that leads to no finite residual.
const MAX_HALVINGS: u32 = 5;

/// The linearised contact at a state.
pub(super) struct Linearised {
    pub(super) gaps: Vec<Gap>,
    /// g, m.
    values: Vec<f64>,
    /// N and Y, column after column.
    pub(super) gradients: Vec<f64>,
    responses: Vec<f64>,
    /// N^T Y.
    compliance: DMatrix<f64>,
}

impl SphereSolver {
    /// The gaps of the candidates at the current state.
    pub(super) fn gaps(&self, centre: Vector3<f64>) -> Vec<Gap> {
        let (body, state) = (&self.solver.problem.body, &self.solver.state);
        let place = |node: u32| {
            let at = 3 * node as usize;
            Vector3::from(body.nodes_m[node as usize]) + Vector3::from_column_slice(&state[at..at + 3])
        };
        self.skin.near(&place, centre, CANDIDATES * self.radius_m)
    }

    /// Leaves out the gaps that nothing can open; whether none of them overlaps.
    pub(super) fn keep_movable(&self, gaps: &mut Vec<Gap>) -> bool {
        let limit = GAP_TOLERANCE * self.radius_m;
        let n = self.solver.problem.unknowns();
        let is_fixed = |gap: &mut Gap| self.entries(gap).all(|(equation, _)| equation as usize >= n);
        gaps.extract_if(.., is_fixed).all(|gap| self.value(&gap) >= -limit)
    }

    pub(super) fn value(&self, gap: &Gap) -> f64 {
        gap.distance_m - self.radius_m
    }

    /// Whether no gap overlaps and those with a force are closed.
    pub(super) fn are_closed(&self, gaps: &[Gap], forces: &[Force]) -> bool {
        let limit = GAP_TOLERANCE * self.radius_m;
        gaps.iter().all(|gap| {
            let is_active = forces.iter().any(|force| force.feature == gap.feature && force.force_n > 0.0);
            let value = self.value(gap);
            value >= -limit && (!is_active || value <= limit)
        })
    }

    /// Equations of the corners of a gap, with the derivative of the gap by them.
    fn entries(&self, gap: &Gap) -> impl Iterator<Item = (u32, f64)> {
        let gap = *gap;
        let dofs = self.solver.problem.dofs.clone();
        (0..gap.feature.corners().len()).flat_map(move |i| {
            let equations = dofs.displacement(gap.feature.corners()[i]);
            (0..3).map(move |axis| (equations[axis], gap.weights[i] * gap.normal[axis]))
        })
    }

    /// E_u becomes E_u - N l, of which the steps have no error by the contact forces; returns its norm, N.
    pub(super) fn subtract_forces(&mut self, gaps: &[Gap], forces: &[Force]) -> f64 {
        let mut residual = std::mem::take(&mut self.solver.residual);
        for (gap, force) in gaps.iter().zip(forces) {
            for (equation, slope) in self.entries(gap) {
                if let Some(r) = residual.get_mut(equation as usize) {
                    *r -= force.force_n * slope;
                }
            }
        }
        self.solver.residual = residual;
        magnitude(&self.solver.residual)
    }

    /// Adds -sum l g_uu to the tangent, factorises it, and solves for the step with the same contact forces and for Y.
    pub(super) fn linearise(
        &mut self,
        gaps: Vec<Gap>,
        forces: &[Force],
    ) -> Result<Linearised, SingularMatrix> {
        for (gap, force) in gaps.iter().zip(forces).filter(|(_, force)| force.force_n > 0.0) {
            self.add_curvature(gap, force.force_n);
        }
        let n = self.solver.problem.unknowns();
        let mut gradients = vec![0.0; gaps.len() * n];
        for (gap, column) in gaps.iter().zip(gradients.chunks_mut(n)) {
            for (equation, slope) in self.entries(gap) {
                if let Some(entry) = column.get_mut(equation as usize) {
                    *entry += slope;
                }
            }
        }
        let Solver { problem, factor, assembled, right, step, residual, factorisations, .. } =
            &mut self.solver;
        let matrix = problem.matrix(&assembled.tangent);
        right.iter_mut().zip(&*residual).for_each(|(right, r)| *right = -r);
        *factorisations += 1;
        let mut responses = vec![0.0; gradients.len()];
        let mut loads = gradients.chunks(RIGHT_SIDES * n).zip(responses.chunks_mut(RIGHT_SIDES * n));
        // A factor is judged by the contact, because near the solution the residual is rounding.
        match loads.next() {
            Some((b, x)) => {
                factor.factorise_and_solve(matrix, b, x, STEP_ACCURACY)?;
                factor.solve(matrix, &right[..n], step, STEP_ACCURACY);
            }
            None => {
                factor.factorise_and_solve(matrix, &right[..n], step, STEP_ACCURACY)?;
            }
        }
        for (b, x) in loads {
            factor.solve(matrix, b, x, STEP_ACCURACY);
        }
        let column =
            |all: &[f64], k: usize| -> std::ops::Range<usize> { k * n..((k + 1) * n).min(all.len()) };
        let compliance = DMatrix::from_fn(gaps.len(), gaps.len(), |i, j| {
            inner(&gradients[column(&gradients, i)], &responses[column(&responses, j)])
        });
        let values = gaps.iter().map(|gap| gap.distance_m - self.radius_m).collect();
        Ok(Linearised { gaps, values, gradients, responses, compliance })
    }

    /// Adds -l g_uu to the tangent.
    fn add_curvature(&mut self, gap: &Gap, force_n: f64) {
        let corners = gap.feature.corners();
        let Solver { problem, assembled, .. } = &mut self.solver;
        for (i, &one) in corners.iter().enumerate() {
            for (j, &other) in corners[..=i].iter().enumerate() {
                let block = gap.second(Some(i), Some(j));
                let (rows, columns) = (problem.dofs.displacement(one), problem.dofs.displacement(other));
                for (a, row) in rows.into_iter().enumerate() {
                    for (b, column) in columns.into_iter().enumerate() {
                        if i == j && b > a {
                            continue;
                        }
                        let place = problem.pattern.place_or_nowhere(row, column);
                        assembled.tangent[place] -= force_n * block[(a, b)];
                    }
                }
            }
        }
    }

    /// The contact forces of the linearised problem; their part is added to the step.
    pub(super) fn contact_forces(&mut self, contact: &Linearised, forces: &[Force]) -> Option<Vec<f64>> {
        let n = self.solver.problem.unknowns();
        let step = &mut self.solver.step;
        let present = DVector::from_iterator(forces.len(), forces.iter().map(|force| force.force_n));
        let moved = contact.values.iter().zip(contact.gradients.chunks(n)).map(|(g, n)| g + inner(n, step));
        let open = DVector::from_iterator(contact.gaps.len(), moved) - &contact.compliance * &present;
        let warm: Vec<bool> = forces.iter().map(|force| force.force_n > 0.0).collect();
        let found = complementary(&contact.compliance, &open, &warm)?;
        for (change, column) in (&found - present).iter().zip(contact.responses.chunks(n)) {
            step.iter_mut().zip(column).for_each(|(s, y)| *s += change * y);
        }
        Some(found.iter().copied().collect())
    }

    /// Takes the step, or the largest part of it that leads to a finite residual; whether there is one.
    pub(super) fn step(&mut self, mut share: f64) -> bool {
        for _ in 0..=MAX_HALVINGS {
            if self.solver.try_step(share).is_finite() {
                return true;
            }
            self.solver.undo_step();
            share *= 0.5;
        }
        false
    }
}
