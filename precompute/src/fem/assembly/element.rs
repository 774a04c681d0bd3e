//! Force, tangent and pressure coupling of one element.
//!
//! The sums run over the quadrature points of weight w in the volume V, with g_a = grad N_a, the first
//! Piola-Kirchhoff stress P and the elasticity A of [`crate::fem::material`], and the linear pressure
//! functions N_v:
//!
//! force on node a           sum w V P g_a
//! tangent, nodes a and b    sum w V g_a . A . g_b
//! coupling, pressure v      - sum w V N_v cof(F) g_a
//! constraint of pressure v  sum w V N_v (1 - J) + (B q)_v

use super::batch::{Batch, LocalState};
use crate::fem::body::Body;
use crate::fem::element::{EDGES, Point, field_gradient, shape_gradients};
use crate::fem::kinematics::Kinematics;
use crate::fem::material::{Law, Tangent, with_law};
use crate::num::lanes::Real;
use crate::num::tensor::Vec3;

/// Contribution of each element of a batch to the global system.
pub(super) struct ElementSystem<R, const N: usize> {
    pub(super) energy_j: R,
    pub(super) force: [Vec3<R>; N],
    pub(super) constraint: [R; 4],
    /// Blocks (a, b) with b <= a, each row-major.
    pub(super) stiffness: [[[R; 9]; N]; N],
    /// Coupling of each pressure vertex with each node.
    pub(super) coupling: [[Vec3<R>; N]; 4],
    pub(super) min_jacobian: R,
    pub(super) volume_m3: R,
}

impl<R: Real, const N: usize> ElementSystem<R, N> {
    pub(super) fn new(machine: R::Machine) -> Self {
        let zero = R::new(machine, |_| 0.0);
        let nothing = Vec3([zero; 3]);
        Self {
            energy_j: zero,
            force: [nothing; N],
            constraint: [zero; 4],
            stiffness: [[[zero; 9]; N]; N],
            coupling: [[nothing; N]; 4],
            min_jacobian: zero.constant(f64::INFINITY),
            volume_m3: zero,
        }
    }

    /// Resets to zero; skips the tangent if it is not needed.
    #[inline(always)]
    fn clear<const TANGENT: bool>(&mut self) {
        let zero = self.energy_j.constant(0.0);
        let nothing = Vec3([zero; 3]);
        self.energy_j = zero;
        self.force = [nothing; N];
        self.constraint = [zero; 4];
        self.min_jacobian = zero.constant(f64::INFINITY);
        self.volume_m3 = zero;
        if TANGENT {
            if N > 4 {
                self.stiffness = [[[zero; 9]; N]; N];
            }
            self.coupling = [[nothing; N]; 4];
        }
    }

    /// Computes the contributions of a batch; the tangent only with `TANGENT`.
    #[inline(always)]
    pub(super) fn compute<const TANGENT: bool>(
        &mut self,
        machine: R::Machine,
        body: &Body,
        batch: &Batch,
        rule: &[Point<N>],
        state: &[f64],
    ) {
        let local = LocalState::<R, N>::gather(machine, body, batch, state);
        let material = batch.material(body);
        if const { R::LANES > 1 } {
            with_law!(material, law => self.add_points::<_, TANGENT>(machine, law, body, batch, rule, &local));
        } else {
            // Loops over single elements are short or a fallback: one compiled loop for all laws is enough.
            self.add_points::<_, TANGENT>(machine, material.erased(), body, batch, rule, &local);
        }
        if N > 4 {
            self.fold::<TANGENT>(machine, body, batch);
        }
    }

    /// Adds what belongs to mid-edge nodes that follow the ends of their edge to these ends, half to each: the
    /// force T^T f and the tangent T^T K T of the map T from the independent nodes to all. The entries of the
    /// followers keep values that belong to no equation; their force is zero.
    #[inline(always)]
    fn fold<const TANGENT: bool>(&mut self, machine: R::Machine, body: &Body, batch: &Batch) {
        for (edge, ends) in EDGES.into_iter().enumerate() {
            let follows = |lane| batch.element(body, lane).follows[edge];
            if !(0..R::LANES).any(follows) {
                continue;
            }
            let half = R::new(machine, |lane| if follows(lane) { 0.5 } else { 0.0 });
            let middle = 4 + edge;
            let share = self.force[middle] * half;
            self.force[middle] = self.force[middle] * (half * -2.0 + 1.0);
            for end in ends {
                self.force[end] += share;
            }
            if !TANGENT {
                continue;
            }
            for row in &mut self.coupling {
                let share = row[middle] * half;
                for end in ends {
                    row[end] += share;
                }
            }
            // K_ij += (K_mj)/2 for the ends i, in the stored lower triangle; the row of an end itself receives
            // also the column.
            for end in ends {
                for other in (0..N).filter(|&other| other != middle) {
                    let block = scaled(self.block(middle, other), half);
                    self.add_block(end, other, &block);
                    if other == end {
                        self.add_block(end, end, &transposed(&block));
                    }
                }
            }
            let own = scaled(self.block(middle, middle), half * half);
            let [i, j] = ends;
            for (row, column) in [(i, i), (j, j), (i, j)] {
                self.add_block(row, column, &own);
            }
        }
    }

    /// Block of the tangent for any order of two nodes.
    #[inline(always)]
    fn block(&self, row: usize, column: usize) -> [R; 9] {
        if column <= row { self.stiffness[row][column] } else { transposed(&self.stiffness[column][row]) }
    }

    /// Adds to the block of two nodes, in the stored triangle.
    #[inline(always)]
    fn add_block(&mut self, row: usize, column: usize, block: &[R; 9]) {
        if column <= row {
            add(&mut self.stiffness[row][column], block, 1.0);
        } else {
            add(&mut self.stiffness[column][row], &transposed(block), 1.0);
        }
    }

    #[inline(always)]
    fn add_points<L: Law + ?Sized, const TANGENT: bool>(
        &mut self,
        machine: R::Machine,
        law: &L,
        body: &Body,
        batch: &Batch,
        rule: &[Point<N>],
        local: &LocalState<R, N>,
    ) {
        let (element_volume, barycentric) = batch.geometry::<R>(machine, body);
        let has_pressure = batch.has_pressure(body);
        self.clear::<TANGENT>();
        for point in rule {
            let gradients = shape_gradients(&barycentric, point);
            let kinematics = Kinematics::new(field_gradient(&local.displacements, &gradients));
            let q_pa = local.pressure_at(point);
            let volume = element_volume * point.weight;
            let (energy, stress) = if TANGENT {
                let (energy, stress, tangent) = law.response(&kinematics, q_pa);
                self.add_stiffness(&barycentric, point, &tangent, volume);
                (energy, stress)
            } else {
                law.stress(&kinematics, q_pa)
            };
            let weighted = stress * volume;
            for (force, &g) in self.force.iter_mut().zip(&gradients) {
                *force += weighted * g;
            }
            let jacobian = kinematics.jacobian();
            self.energy_j += volume * energy;
            self.volume_m3 += volume * jacobian;
            self.min_jacobian = self.min_jacobian.lesser(jacobian);
            if has_pressure {
                self.add_pressure::<TANGENT>(point, &gradients, &kinematics, volume);
            }
        }
        if has_pressure && body.has_pressure_blocks {
            let zero = element_volume.constant(0.0);
            for v in 0..4 {
                let mut product = zero;
                for u in 0..4 {
                    let block = R::new(machine, |lane| batch.element(body, lane).pressure_block[v][u]);
                    product += block * local.pressures[u];
                }
                self.constraint[v] += product;
                self.energy_j += local.pressures[v] * 0.5 * product;
            }
        }
    }

    #[inline(always)]
    fn add_pressure<const TANGENT: bool>(
        &mut self,
        point: &Point<N>,
        gradients: &[Vec3<R>; N],
        kinematics: &Kinematics<R>,
        volume: R,
    ) {
        for (constraint, &shape) in self.constraint.iter_mut().zip(&point.barycentric) {
            *constraint -= volume * shape * kinematics.volume_change;
        }
        if TANGENT {
            for (a, &g) in gradients.iter().enumerate() {
                let slope = kinematics.cofactor * g * -volume;
                for (row, &shape) in self.coupling.iter_mut().zip(&point.barycentric) {
                    row[a] += slope * volume.constant(shape);
                }
            }
        }
    }

    /// Adds volume g_a . A . g_b.
    ///
    /// With grad N_a = sum_k D_ak G_k, the block of two nodes is sum_kl D_ak D_bl (G_k . A . G_l). The ten
    /// blocks of the barycentric gradients are computed once. A mid-edge node has two non-zero slopes, so its
    /// block is a sum of two of them.
    #[inline(always)]
    fn add_stiffness(&mut self, gradients: &[Vec3<R>; 4], point: &Point<N>, tangent: &Tangent<R>, volume: R) {
        if N == 4 {
            tangent.blocks(
                gradients,
                #[inline(always)]
                |k, l, block| self.stiffness[k][l] = scaled(block, volume),
            );
            return;
        }
        let zero = volume.constant(0.0);
        let mut vertex = [[[zero; 9]; 4]; 4];
        tangent.blocks(
            gradients,
            #[inline(always)]
            |k, l, block| {
                let block = scaled(block, volume);
                vertex[k][l] = block;
                vertex[l][k] = transposed(&block);
            },
        );
        for k in 0..4 {
            for l in 0..=k {
                add(&mut self.stiffness[k][l], &vertex[k][l], point.slopes[k][k] * point.slopes[l][l]);
            }
        }
        // Rows of the mid-edge nodes: first with the barycentric columns, then with the nodes.
        let mut edge = [[[zero; 9]; 4]; 6];
        for (e, [i, j]) in EDGES.into_iter().enumerate() {
            for l in 0..4 {
                add(&mut edge[e][l], &vertex[i][l], point.slopes[4 + e][i]);
                add(&mut edge[e][l], &vertex[j][l], point.slopes[4 + e][j]);
            }
        }
        for e in 0..6 {
            let row = &mut self.stiffness[4 + e];
            for l in 0..4 {
                add(&mut row[l], &edge[e][l], point.slopes[l][l]);
            }
            for (f, [i, j]) in EDGES.into_iter().enumerate().take(e + 1) {
                add(&mut row[4 + f], &edge[e][i], point.slopes[4 + f][i]);
                add(&mut row[4 + f], &edge[e][j], point.slopes[4 + f][j]);
            }
        }
    }

    /// Entry of the displacement block for any order of the local indices.
    #[inline(always)]
    pub(super) fn stiffness_at(&self, i: usize, j: usize) -> R {
        let (row, column) = (i.max(j), i.min(j));
        // The diagonal blocks are complete; of the others only the lower triangle is stored.
        self.stiffness[row / 3][column / 3][3 * (row % 3) + column % 3]
    }
}

#[inline(always)]
fn add<R: Real>(sum: &mut [R; 9], block: &[R; 9], factor: f64) {
    for (sum, &value) in sum.iter_mut().zip(block) {
        *sum += value * factor;
    }
}

#[inline(always)]
fn scaled<R: Real>(mut block: [R; 9], factor: R) -> [R; 9] {
    for value in &mut block {
        *value = factor * *value;
    }
    block
}

#[inline(always)]
fn transposed<R: Real>(block: &[R; 9]) -> [R; 9] {
    let [a, b, c, d, e, f, g, h, i] = *block;
    [a, d, g, b, e, h, c, f, i]
}

/// Third derivatives of the Lagrangian of each element of a batch along three state directions, in the order
/// of [`crate::num::jet::THIRD_INDICES`].
#[inline(always)]
pub(super) fn third_along<R: Real, const N: usize>(
    machine: R::Machine,
    body: &Body,
    batch: &Batch,
    rule: &[Point<N>],
    state: &[f64],
    directions: &[Vec<f64>; 3],
) -> [R; 10] {
    let here = LocalState::<R, N>::gather(machine, body, batch, state);
    let [x, y, z] = directions;
    let along = [
        LocalState::<R, N>::gather(machine, body, batch, x),
        LocalState::<R, N>::gather(machine, body, batch, y),
        LocalState::<R, N>::gather(machine, body, batch, z),
    ];
    let geometry = batch.geometry::<R>(machine, body);
    let material = batch.material(body);
    if const { R::LANES > 1 } {
        with_law!(material, law => third_at_points(law, &geometry, rule, &here, &along))
    } else {
        third_at_points(material.erased(), &geometry, rule, &here, &along)
    }
}

#[inline(always)]
fn third_at_points<R: Real, L: Law + ?Sized, const N: usize>(
    law: &L,
    (element_volume, barycentric): &(R, [Vec3<R>; 4]),
    rule: &[Point<N>],
    here: &LocalState<R, N>,
    along: &[LocalState<R, N>; 3],
) -> [R; 10] {
    let mut sum = [element_volume.constant(0.0); 10];
    for point in rule {
        let gradients = shape_gradients(barycentric, point);
        let kinematics = Kinematics::new(field_gradient(&here.displacements, &gradients));
        let [x, y, z] = along;
        let slopes = [
            field_gradient(&x.displacements, &gradients),
            field_gradient(&y.displacements, &gradients),
            field_gradient(&z.displacements, &gradients),
        ];
        let dq_pa = [x.pressure_at(point), y.pressure_at(point), z.pressure_at(point)];
        let third = law.third_along(&kinematics, here.pressure_at(point), &slopes, &dq_pa);
        let volume = *element_volume * point.weight;
        for (total, value) in sum.iter_mut().zip(third) {
            *total += volume * value;
        }
    }
    sum
}
