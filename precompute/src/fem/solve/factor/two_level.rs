//! Solves without a factor of the present tangent, for bodies where one takes seconds.
//!
//! One factor of the whole body at rest serves all states, all contacts and all threads. What changes on the way to a
//! state is taken into account twice: the deformation near the tool by a factor of the present tangent of the equations
//! near it, and the rotation of the rest of the body by turning the forces back and the displacements forth. With
//! the tangent K, its part K_N of the equations near the tool, P their selection, M the tangent at rest without
//! a tool and R the rotations of the nodes (1 for pressures), the preconditioner z = B r is
//!
//! z = P K_N^-1 P^T r,   z += R M^-1 R^T (r - K z),   z += P K_N^-1 P^T (r - K z):
//!
//! two levels of a multiplicative Schwarz method (Smith, Bjorstad and Gropp 1996) with a corotated far field (Mueller
//! and Gross 2004). Both factors are made in single precision, and that of M is kept in 16 bits an entry. The residual
//! steps with it gain about a digit each, and the residual is that of K in double precision.

use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};

use super::super::{Problem, regularised_diagonal};
use super::{Matrix, PackedFactor, RIGHT_SIDES, SingleFactor, SingleScratch, SymbolicFactor};
use crate::fem::assembly::{Pattern, PlacedEntry, subtract_product};
use crate::fem::body::{ABSENT, Body};
use crate::fem::boundary::{Contact, DofMap};
use crate::num::vector::{difference, distance};

/// Regularisation of the pressures without a block near the tool, in units of the analysis (`pressure_share`): above the rounding of single precision.
const DELTA: f64 = 1e-5;
/// Iterations of the polar decomposition; they converge quadratically.
const POLAR_STEPS: usize = 8;

/// The equations nearest to the tool.
#[derive(Debug)]
pub(in crate::fem::solve) struct NearEquations {
    /// Ascending.
    equations: Vec<usize>,
    /// The places of their entries in the values of the whole matrix.
    places: Vec<usize>,
    /// The same with the entries that join them to others.
    joined: Vec<PlacedEntry>,
    pattern: Pattern,
    symbolic: SymbolicFactor,
}

impl NearEquations {
    /// Those of a problem whose tool has a place on the body: a held node or a fingertip. `None` if their share is zero.
    pub(in crate::fem::solve) fn of(problem: &Problem) -> Option<Self> {
        let (body, dofs) = (&*problem.body, &*problem.dofs);
        let centre_m = match problem.contact.as_ref()? {
            Contact::Held(handle) => body.rest_position_m(handle.centre),
            Contact::Pad(pad) => pad.centre_m,
            Contact::Sphere(_) => return None,
        };
        let nodes = body.displacement_len() / 3;
        let nodes_m: Vec<f64> =
            (0..nodes as u32).map(|node| distance(body.rest_position_m(node), centre_m)).collect();
        let place = |&(equation, position): &(usize, usize)| {
            let node = match position.checked_sub(body.displacement_len()) {
                Some(pressure) => body.pressure_sites[pressure].0 as usize,
                None => position / 3,
            };
            (nodes_m[node], equation, position >= body.displacement_len())
        };
        let mut by_distance: Vec<_> = dofs.state_positions().map(|at| place(&at)).collect();
        by_distance.sort_by(|a, b| a.0.total_cmp(&b.0));
        let count = (problem.newton.near_share * by_distance.len() as f64) as usize;
        let within_m = by_distance.get(count)?.0;
        let mut near: Vec<_> = by_distance.into_iter().take_while(|at| at.0 < within_m).collect();
        if near.is_empty() {
            return None;
        }
        near.sort_unstable_by_key(|at| at.1);
        let negative = near.iter().filter(|at| at.2).count();
        let equations: Vec<usize> = near.iter().map(|at| at.1).collect();
        let (pattern, places) = problem.pattern.restricted(&equations);
        let diagonal: Vec<(usize, f64)> = regularised_diagonal(body, dofs)
            .into_iter()
            .filter_map(|(equation, size)| Some((equations.binary_search(&equation).ok()?, size)))
            .collect();
        let symbolic = SymbolicFactor::new(&pattern, &diagonal, negative);
        let joined = problem.pattern.entries_of(&equations);
        Some(Self { equations, places, joined, pattern, symbolic })
    }
}

/// The factor of the equations near the tool.
#[derive(Debug)]
struct Near {
    of: Arc<NearEquations>,
    values: Vec<f64>,
    factor: SingleFactor,
    scratch: SingleScratch,
    columns: Vec<f64>,
}

impl Near {
    fn new(of: Arc<NearEquations>) -> Self {
        let n = of.equations.len();
        Self {
            values: vec![0.0; of.places.len()],
            factor: SingleFactor::new(&of.symbolic, n),
            scratch: SingleScratch::new(&of.symbolic, n),
            columns: vec![0.0; RIGHT_SIDES * n],
            of,
        }
    }

    fn make(&mut self, values: &[f64]) -> bool {
        self.values.iter_mut().zip(&self.of.places).for_each(|(value, &place)| *value = values[place]);
        let Self { of, values, factor, scratch, .. } = self;
        let matrix = Matrix { symbolic: &of.symbolic, pattern: &of.pattern, values, at: None };
        factor.make(matrix, DELTA, scratch)
    }

    /// z += P K_N^-1 P^T r, column after column of `n`.
    fn add(&mut self, r: &[f64], z: &mut [f64], n: usize) {
        let Self { of, factor, scratch, columns, .. } = self;
        let own = of.equations.len();
        let columns = &mut columns[..r.len() / n * own];
        for (r, column) in r.chunks(n).zip(columns.chunks_mut(own)) {
            column.iter_mut().zip(&of.equations).for_each(|(value, &equation)| *value = r[equation]);
        }
        factor.solve(&of.symbolic, columns, scratch);
        for (z, column) in z.chunks_mut(n).zip(columns.chunks(own)) {
            of.equations.iter().zip(column).for_each(|(&equation, value)| z[equation] += value);
        }
    }
}

/// The preconditioner of one thread.
#[derive(Debug)]
pub(in crate::fem::solve) struct TwoLevel {
    far: Arc<PackedFactor>,
    scratch: Vec<f32>,
    near: Option<Near>,
    /// Equations and rotation of every node that can turn.
    turns: Vec<([u32; 3], Matrix3<f64>)>,
    right: Vec<f64>,
    left: Vec<f64>,
}

impl TwoLevel {
    /// That of a problem; `None` where its body at rest has no factor.
    pub(in crate::fem::solve) fn new(problem: &Problem) -> Option<Self> {
        let n = problem.unknowns();
        Some(Self {
            far: problem.far_factor()?,
            scratch: Vec::with_capacity(RIGHT_SIDES * (n + 1)),
            near: None,
            turns: Vec::new(),
            right: vec![0.0; RIGHT_SIDES * n],
            left: vec![0.0; RIGHT_SIDES * n],
        })
    }

    /// Follows the tangent and the state at hand; whether the tangent near the tool has a factor.
    pub(in crate::fem::solve) fn refresh(
        &mut self,
        values: &[f64],
        problem: &Problem,
        state: &[f64],
    ) -> bool {
        let near = problem.near_equations();
        if !near.zip(self.near.as_ref()).is_some_and(|(wanted, at_hand)| Arc::ptr_eq(wanted, &at_hand.of)) {
            self.near = near.cloned().map(Near::new);
        }
        self.turns.clear();
        if problem.newton.turns {
            rotations(&problem.body, &problem.dofs, state, &mut self.turns);
        }
        self.near.as_mut().is_none_or(|near| near.make(values))
    }

    /// Whether the factor near the tool is that of a tangent.
    #[cfg(test)]
    pub(in crate::fem::solve) fn is_near(&self, values: &[f64]) -> bool {
        let near = self.near.as_ref().expect("a tool with a place");
        near.values.iter().zip(&near.of.places).all(|(value, &place)| *value == values[place])
    }

    /// Unstable modes of the part near the tool with its surroundings fixed. Without pressures the body has at least as many;
    /// with them it may have fewer, and a factor of the whole tangent then only takes longer.
    pub(in crate::fem::solve) fn unstable_near(&self) -> Option<u32> {
        self.near.as_ref().and_then(|near| near.factor.unstable_modes(&near.of.symbolic))
    }

    /// Replaces the columns r by B r.
    pub(in crate::fem::solve) fn apply(&mut self, matrix: Matrix<'_>, columns: &mut [f64]) {
        let n = matrix.pattern.unknowns();
        let Self { far, scratch, near, turns, right, left } = self;
        let (right, left) = (&mut right[..columns.len()], &mut left[..columns.len()]);
        right.copy_from_slice(columns);
        left.copy_from_slice(columns);
        columns.fill(0.0);
        if let Some(near) = near {
            near.add(right, columns, n);
            // The columns are zero elsewhere.
            subtract_product(&near.of.joined, matrix.values, columns, left, n);
        }
        turned(turns, left, n, Matrix3::tr_mul);
        far.solve(left, scratch);
        turned(turns, left, n, |turn, vector| turn * vector);
        columns.iter_mut().zip(&*left).for_each(|(z, y)| *z += y);
        if let Some(near) = near {
            // What is left elsewhere is not read.
            left.copy_from_slice(right);
            subtract_product(&near.of.joined, matrix.values, columns, left, n);
            near.add(left, columns, n);
        }
    }
}

/// Turns the displacements or forces of all nodes.
fn turned(
    turns: &[([u32; 3], Matrix3<f64>)],
    columns: &mut [f64],
    n: usize,
    turn: impl Fn(&Matrix3<f64>, &Vector3<f64>) -> Vector3<f64>,
) {
    for column in columns.chunks_mut(n) {
        for (equations, rotation) in turns {
            let vector = Vector3::from(equations.map(|equation| column[equation as usize]));
            let vector = turn(rotation, &vector);
            equations.iter().zip(vector.iter()).for_each(|(&equation, &x)| column[equation as usize] = x);
        }
    }
}

/// Appends the rotations of the nodes from rest: those of the mean deformation gradient of their elements.
fn rotations(body: &Body, dofs: &DofMap, state: &[f64], turns: &mut Vec<([u32; 3], Matrix3<f64>)>) {
    let count = body.displacement_len() / 3;
    let mut gradients = vec![Matrix3::zeros(); count];
    let moved = |node: u32, axis: usize| {
        let place = 3 * node as usize + axis;
        state[place] - body.rest_state[place]
    };
    for (element, nodes) in body.elements.iter().zip(body.element_nodes()) {
        let corner = |k: usize| body.rest_position_m(nodes[k]);
        let edges = Matrix3::from_fn(|axis, k| difference(corner(k + 1), corner(0))[axis]);
        let slopes = Matrix3::from_fn(|axis, k| moved(nodes[k + 1], axis) - moved(nodes[0], axis));
        let Some(inverse) = edges.try_inverse() else { continue };
        let gradient = (Matrix3::identity() + slopes * inverse) * element.tet.volume_m3;
        for &node in nodes.iter().filter(|&&node| node != ABSENT) {
            gradients[node as usize] += gradient;
        }
    }
    turns.extend((0..count as u32).filter_map(|node| {
        let equations = dofs.displacement(node);
        let can_turn = equations.iter().all(|&equation| (equation as usize) < dofs.unknowns);
        can_turn.then_some(()).and_then(|()| Some((equations, rotation(gradients[node as usize])?)))
    }));
}

/// The rotation of the polar decomposition, by Newton's iteration R = (R + R^-T) / 2; `None` without a positive determinant.
fn rotation(gradient: Matrix3<f64>) -> Option<Matrix3<f64>> {
    let determinant = gradient.determinant();
    if determinant.is_nan() || determinant <= 0.0 {
        return None;
    }
    let mut rotation = gradient / libm::cbrt(determinant);
    for _ in 0..POLAR_STEPS {
        rotation = 0.5 * (rotation + rotation.try_inverse()?.transpose());
    }
    let is_rotation = (rotation.tr_mul(&rotation) - Matrix3::identity()).norm() < 1e-6;
    is_rotation.then_some(rotation)
}
