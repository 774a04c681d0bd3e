//! Assembly of residual and tangent stiffness of the body.

mod batch;
mod element;
mod pattern;

#[cfg(test)]
mod tests;

pub(crate) use pattern::{Pattern, PlacedEntry, subtract_product};

use std::ops::Range;
use std::slice::ChunksExact;

use nalgebra::Matrix3;

use crate::fem::body::{ABSENT, Body};
use crate::fem::element::{LINEAR, Point, QUADRATIC};
use crate::num::jet::SymmetricThird;
use crate::num::lanes::{self, Lanes, Real};
use batch::Batch;
use element::ElementSystem;

/// Results of one assembly.
#[derive(Debug, Clone, Default)]
pub(crate) struct Assembled {
    /// Internal force minus body force on every node (pressure part included), 3 per node, N: the force that
    /// a tool or a fixation must apply to the node.
    pub(crate) nodal_force_n: Vec<f64>,
    /// Constraint of every pressure unknown, int N_v (1 - J) + (B q)_v, m^3.
    pub(crate) constraint_m3: Vec<f64>,
    /// Total potential, J: Lagrangian of the elements minus the work of the body force. Its value at rest is
    /// not subtracted.
    pub(crate) energy_j: f64,
    /// Smallest J over the quadrature points.
    pub(crate) min_jacobian: f64,
    /// Number of elements with J <= 0 at a quadrature point.
    pub(crate) inverted: usize,
    /// Deformed volume, m^3.
    pub(crate) volume_m3: f64,
    /// Tangent, lower triangle on the [`Pattern`]. One more slot than entries; eliminated entries are added
    /// to it.
    pub(crate) tangent: Vec<f64>,
    /// Load factor of the body force; 1 except during the solution of the rest state.
    pub(crate) load_factor: f64,
}

impl Assembled {
    /// Zero results of the size of `body` and `pattern`.
    pub(crate) fn new(body: &Body, pattern: &Pattern) -> Self {
        Self {
            nodal_force_n: vec![0.0; body.displacement_len()],
            constraint_m3: vec![0.0; body.pressure_sites.len()],
            tangent: vec![0.0; pattern.entries() + 1],
            load_factor: 1.0,
            ..Self::default()
        }
    }

    fn clear(&mut self) {
        self.nodal_force_n.fill(0.0);
        self.constraint_m3.fill(0.0);
        self.energy_j = 0.0;
        self.min_jacobian = f64::INFINITY;
        self.inverted = 0;
        self.volume_m3 = 0.0;
    }

    /// Computes forces, constraints, energy and tangent at `state`.
    pub(crate) fn assemble(&mut self, body: &Body, pattern: &Pattern, state: &[f64]) {
        self.tangent.fill(0.0);
        lanes::dispatch(Pass::<true> { to: self, body, pattern: Some(pattern), state });
        let tie = -body.stiffness_scale_n_m();
        for &place in &pattern.ties {
            self.tangent[place] = tie;
        }
    }

    /// Computes forces, constraints and energy at `state`, without the tangent.
    pub(crate) fn assemble_residual(&mut self, body: &Body, state: &[f64]) {
        lanes::dispatch(Pass::<false> { to: self, body, pattern: None, state });
    }

    /// Adds the elements of a range; `scatter` gives the places of their entries.
    #[inline(always)]
    fn pass<R: Real, const N: usize, const TANGENT: bool>(
        &mut self,
        machine: R::Machine,
        body: &Body,
        range: Range<usize>,
        mut scatter: Option<ChunksExact<'_, u32>>,
        rule: &[Point<N>],
        state: &[f64],
    ) {
        if range.is_empty() {
            return;
        }
        let mut system = ElementSystem::<R, N>::new(machine);
        for batch in Batch::all::<R>(body, range) {
            system.compute::<TANGENT>(machine, body, &batch, rule, state);
            // Lane by lane, so that every sum runs over the elements in their order for any number of lanes.
            for lane in 0..batch.count.min(R::LANES) {
                let element = batch.element(body, lane);
                self.energy_j += system.energy_j.lane(lane);
                let min_jacobian = system.min_jacobian.lane(lane);
                // `min` would ignore a NaN.
                if min_jacobian < self.min_jacobian || min_jacobian.is_nan() {
                    self.min_jacobian = min_jacobian;
                }
                self.inverted += usize::from(min_jacobian <= 0.0);
                self.volume_m3 += system.volume_m3.lane(lane);
                for (force, &node) in system.force.iter().zip(body.nodes_of(batch.first + lane)) {
                    let base = 3 * node as usize;
                    for axis in 0..3 {
                        self.nodal_force_n[base + axis] += force.0[axis].lane(lane);
                    }
                }
                if element.pressures[0] != ABSENT {
                    for (constraint, &pressure) in system.constraint.iter().zip(&element.pressures) {
                        self.constraint_m3[pressure as usize] += constraint.lane(lane);
                    }
                }
                if let Some(places) = scatter.as_mut().and_then(Iterator::next) {
                    self.scatter_tangent(body, &system, lane, &element.pressure_block, places);
                }
            }
        }
    }

    /// Subtracts the body force.
    fn load(&mut self, body: &Body, state: &[f64]) {
        if body.is_loaded() {
            for ((force, external), u) in self.nodal_force_n.iter_mut().zip(&body.external_force_n).zip(state)
            {
                *force -= self.load_factor * external;
                self.energy_j -= self.load_factor * external * u;
            }
        }
    }

    /// Adds the element's entries in the order of the pattern's local pairs.
    #[inline(always)]
    fn scatter_tangent<R: Real, const N: usize>(
        &mut self,
        body: &Body,
        system: &ElementSystem<R, N>,
        lane: usize,
        pressure_block: &[[f64; 4]; 4],
        places: &[u32],
    ) {
        let tangent = &mut self.tangent;
        let mut places = places.iter();
        // `zip` ends with the values, so that the iterator of places does not advance too far.
        for (a, row) in system.stiffness.iter().enumerate() {
            for block in &row[..a] {
                for (value, &place) in block.iter().zip(places.by_ref()) {
                    tangent[place as usize] += value.lane(lane);
                }
            }
            let [xx, _, _, yx, yy, _, zx, zy, zz] = row[a];
            for (value, &place) in [xx, yx, yy, zx, zy, zz].iter().zip(places.by_ref()) {
                tangent[place as usize] += value.lane(lane);
            }
        }
        if body.has_pressure() {
            let scale = body.pressure_scale();
            for coupling in system.coupling.iter().flatten() {
                for (value, &place) in coupling.0.iter().zip(places.by_ref()) {
                    tangent[place as usize] += scale * value.lane(lane);
                }
            }
            if body.has_pressure_blocks {
                for (u, row) in pressure_block.iter().enumerate() {
                    for (value, &place) in row[..=u].iter().zip(places.by_ref()) {
                        tangent[place as usize] += scale * scale * value;
                    }
                }
            }
        }
    }

    /// Net force on a set of nodes, N. For the handle this is h, the force of the tool on the body.
    pub(crate) fn force_on(&self, nodes: &[u32]) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for &node in nodes {
            for (axis, total) in sum.iter_mut().enumerate() {
                *total += self.nodal_force_n[3 * node as usize + axis];
            }
        }
        sum
    }

    /// Residual of the state's equations, N; constraints are scaled like forces. Multiplier equations are not
    /// changed.
    pub(crate) fn residual_into(&self, body: &Body, positions: &[(usize, usize)], residual: &mut [f64]) {
        let scale = body.pressure_scale();
        let displacement_len = self.nodal_force_n.len();
        for &(dof, position) in positions {
            residual[dof] = if position < displacement_len {
                self.nodal_force_n[position]
            } else {
                scale * self.constraint_m3[position - displacement_len]
            };
        }
    }
}

/// Rows of the tangent that elimination removed: the coupling of a translation of the handle with the
/// unknowns and with itself.
#[derive(Debug, Clone)]
pub(crate) struct HandleCoupling {
    /// K_fA, one column of length `unknowns` per axis, column after column, N/m.
    pub free: Vec<f64>,
    /// K_AA, N/m.
    pub own: Matrix3<f64>,
}

impl HandleCoupling {
    /// Zero blocks for `unknowns` equations.
    pub(crate) fn new(unknowns: usize) -> Self {
        Self { free: vec![0.0; 3 * unknowns], own: Matrix3::zeros() }
    }

    /// Computes the blocks at `state` from the elements of the handle's nodes.
    pub(crate) fn assemble(&mut self, body: &Body, pattern: &Pattern, state: &[f64]) {
        self.free.fill(0.0);
        self.own = Matrix3::zeros();
        let (linear, quadratic) = pattern
            .handle_elements
            .split_at(pattern.handle_elements.partition_point(|&e| (e as usize) < body.linear));
        self.pass::<4>(body, pattern, linear, &LINEAR, state);
        self.pass::<10>(body, pattern, quadratic, &QUADRATIC, state);
    }

    fn pass<const N: usize>(
        &mut self,
        body: &Body,
        pattern: &Pattern,
        elements: &[u32],
        rule: &[Point<N>],
        state: &[f64],
    ) {
        let n = pattern.unknowns();
        let scale = body.pressure_scale();
        let mut system = ElementSystem::<f64, N>::new(());
        for &index in elements {
            let index = index as usize;
            system.compute::<true>((), body, &Batch::single(index), rule, state);
            let dofs = pattern.dofs_of(index);
            for (c, &column) in dofs[..3 * N].iter().enumerate() {
                let column = column as usize;
                if !(n..n + 3).contains(&column) {
                    continue;
                }
                let axis = column - n;
                for (r, &row) in dofs[..3 * N].iter().enumerate() {
                    let row = row as usize;
                    let value = system.stiffness_at(r, c);
                    if row < n {
                        self.free[axis * n + row] += value;
                    } else if row < n + 3 {
                        self.own[(row - n, axis)] += value;
                    }
                }
                for (v, &row) in dofs[3 * N..].iter().enumerate() {
                    if row != ABSENT {
                        self.free[axis * n + row as usize] += scale * system.coupling[v][c / 3].0[c % 3];
                    }
                }
            }
        }
    }
}

/// Third derivatives of the total potential along three state directions, in the order of
/// [`crate::num::jet::THIRD_INDICES`].
///
/// Along the sensitivities X_i = d(u, q)/dd_i of a stationary state they are the exact third derivatives of
/// the condensed potential W(d). By the 2n + 1 theorem the first derivatives of the state suffice: in D3 L
/// [X, X, X] + 3 D2 L [X, X'] the second term vanishes, because D2 L X is non-zero only in the handle's
/// equations, where X' = 0. The body force and the pressure's quadratic form have no third derivative.
pub(crate) fn third_derivatives(body: &Body, state: &[f64], directions: &[Vec<f64>; 3]) -> SymmetricThird {
    struct Work<'a> {
        body: &'a Body,
        state: &'a [f64],
        directions: &'a [Vec<f64>; 3],
    }

    impl Work<'_> {
        #[inline(always)]
        fn pass<R: Real, const N: usize>(
            &self,
            machine: R::Machine,
            range: Range<usize>,
            rule: &[Point<N>],
            mut sum: SymmetricThird,
        ) -> SymmetricThird {
            for batch in Batch::all::<R>(self.body, range) {
                let third = element::third_along::<R, N>(
                    machine,
                    self.body,
                    &batch,
                    rule,
                    self.state,
                    self.directions,
                );
                for lane in 0..batch.count.min(R::LANES) {
                    for (total, value) in sum.iter_mut().zip(&third) {
                        *total += value.lane(lane);
                    }
                }
            }
            sum
        }
    }

    impl pulp::WithSimd for Work<'_> {
        type Output = SymmetricThird;

        #[inline(always)]
        fn with_simd<S: pulp::Simd>(self, simd: S) -> SymmetricThird {
            let [linear, quadratic] = self.body.ranges();
            let sum = self.pass::<Lanes<S>, 4>(simd, linear, &LINEAR, [0.0; 10]);
            self.pass::<Lanes<S>, 10>(simd, quadratic, &QUADRATIC, sum)
        }
    }

    lanes::dispatch(Work { body, state, directions })
}

/// Ratio of deformed to undeformed volume of every element of the body.
pub fn volume_ratios(body: &Body, state: &[f64]) -> Vec<f64> {
    fn pass<const N: usize>(
        body: &Body,
        range: Range<usize>,
        rule: &[Point<N>],
        state: &[f64],
    ) -> impl Iterator<Item = f64> {
        let mut system = ElementSystem::<f64, N>::new(());
        range.map(move |index| {
            system.compute::<false>((), body, &Batch::single(index), rule, state);
            system.volume_m3 / body.elements[index].tet.volume_m3
        })
    }
    let [linear, quadratic] = body.ranges();
    pass::<4>(body, linear, &LINEAR, state).chain(pass::<10>(body, quadratic, &QUADRATIC, state)).collect()
}

/// A loop over the elements, compiled for the widest vectors of this machine. The bits are independent of the
/// vector width, because no operations are fused and the order of each sum is fixed.
struct Pass<'a, const TANGENT: bool> {
    to: &'a mut Assembled,
    body: &'a Body,
    pattern: Option<&'a Pattern>,
    state: &'a [f64],
}

impl<const TANGENT: bool> pulp::WithSimd for Pass<'_, TANGENT> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        let Self { to, body, pattern, state } = self;
        let [linear, quadratic] = body.ranges();
        to.clear();
        let [of_linear, of_quadratic] = pattern.map(Pattern::scatter).map_or([None, None], |of| of.map(Some));
        to.pass::<Lanes<S>, 4, TANGENT>(simd, body, linear, of_linear, &LINEAR, state);
        to.pass::<Lanes<S>, 10, TANGENT>(simd, body, quadratic, of_quadratic, &QUADRATIC, state);
        to.load(body, state);
    }
}
