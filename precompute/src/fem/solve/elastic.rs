//! The part of elastic tools in the equations, in the sensitivities and in the third derivatives.

use nalgebra::Matrix3;

use super::partner::Partner;
use super::{Problem, Solver};
use crate::fem::assembly::{Assembled, third_derivatives};
use crate::fem::boundary::Contact;
use crate::fem::elastic::ElasticState;
use crate::fem::sphere::Posture;
use crate::num::jet::SymmetricThird;

impl Solver {
    /// Adds the derivatives of the tool's potential at the state to the residual and to the tangent.
    pub(super) fn add_elastic(&mut self, with_tangent: bool) {
        let Self { problem, elastic, partner, half_m, state, control_m, residual, assembled, .. } = self;
        match &problem.contact {
            None | Some(Contact::Held(_)) => return,
            Some(Contact::Pad(pad)) => pad.compute(&problem.body, state, *control_m, with_tangent, elastic),
            Some(Contact::Sphere(sphere)) => {
                let posture = Posture { displacement_m: *control_m, half_m: half_m.unwrap_or_default() };
                sphere.compute(&problem.body, state, &posture, with_tangent, elastic);
            }
        }
        add(elastic, problem, residual, assembled);
        if let (Some(partner), Some(Contact::Sphere(sphere))) = (partner, &problem.contact) {
            sphere.compute(&problem.body, state, &partner.posture(), with_tangent, &mut partner.elastic);
            add(&partner.elastic, problem, residual, assembled);
        }
    }

    /// -Phi_ud at the last assembled tangent into the right-hand sides.
    pub(super) fn elastic_columns(&mut self) {
        fill(&mut self.right, &self.problem, &self.elastic.coupling_n_m, 1.0);
    }

    /// -Phi_ua of a capsule likewise.
    pub(super) fn axis_columns(&mut self) {
        fill(&mut self.right, &self.problem, &self.elastic.turned_n_m, -1.0);
    }

    /// W_ijk of the state with these sensitivities. The springs of a pad have no third derivative.
    pub(super) fn third(&self, sensitivity: &[Vec<f64>; 3]) -> SymmetricThird {
        let body = &self.problem.body;
        let mut third = third_derivatives(body, &self.state, sensitivity);
        if let Some(Contact::Sphere(sphere)) = &self.problem.contact {
            let own = sphere.third(body, &self.state, (&self.posture(), true), sensitivity);
            let beside = self.partner.as_ref().map(Partner::posture);
            let beside = beside
                .map(|posture| sphere.third(body, &self.state, (&posture, false), sensitivity))
                .unwrap_or_default();
            for (sum, (own, beside)) in third.iter_mut().zip(own.into_iter().zip(beside)) {
                *sum += own + beside;
            }
        }
        third
    }
}

/// Blocks at nodes, times a sign, as right-hand sides: one column for each of their columns.
fn fill(right: &mut [f64], problem: &Problem, blocks: &[(u32, Matrix3<f64>)], sign: f64) {
    let n = problem.unknowns();
    right.fill(0.0);
    for (node, block) in blocks {
        for (row, equation) in problem.dofs.displacement(*node).into_iter().enumerate() {
            for axis in (0..3).filter(|_| (equation as usize) < n) {
                right[axis * n + equation as usize] += sign * block[(row, axis)];
            }
        }
    }
}

/// Adds forces and stiffness of a tool to the equations.
fn add(elastic: &ElasticState, problem: &Problem, residual: &mut [f64], assembled: &mut Assembled) {
    for (node, force) in &elastic.nodal_n {
        for (equation, force) in problem.dofs.displacement(*node).into_iter().zip(force) {
            if let Some(residual) = residual.get_mut(equation as usize) {
                *residual += force;
            }
        }
    }
    for ([one, other], block) in &elastic.stiffness_n_m {
        let (rows, columns) = (problem.dofs.displacement(*one), problem.dofs.displacement(*other));
        for (a, row) in rows.into_iter().enumerate() {
            for (b, column) in columns.into_iter().enumerate() {
                if block[(a, b)] != 0.0 && !(one == other && b > a) {
                    assembled.tangent[problem.pattern.place_or_nowhere(row, column)] += block[(a, b)];
                }
            }
        }
    }
}
