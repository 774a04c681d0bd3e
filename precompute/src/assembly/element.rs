//! Force, tangent and pressure coupling of one element.
//!
//! Over the quadrature points of weight w in the volume V, with g_a = grad N_a, P and A the stress and elasticity of
//! [`crate::material`] and N_v the linear pressure functions:
//!
//! force on node a           sum w V P g_a
//! tangent, nodes a and b    sum w V g_a . A . g_b
//! coupling, pressure v      - sum w V N_v cof(F) g_a
//! constraint of pressure v  sum w V N_v (1 - J) + (B q)_v

use nalgebra::{Matrix3, Vector3};

use crate::body::{Body, Element};
use crate::boundary::ABSENT;
use crate::element::{EDGES, Point, field_gradient};
use crate::kinematics::Kinematics;
use crate::material::{Law, Tangent, with_law};

/// Values of a state at the nodes of one element.
pub(super) struct LocalState<const N: usize> {
    pub(super) displacements: [Vector3<f64>; N],
    pub(super) pressures: [f64; 4],
}

impl<const N: usize> LocalState<N> {
    #[inline(always)]
    pub(super) fn gather(body: &Body, nodes: &[u32], element: &Element, state: &[f64]) -> Self {
        let displacements = std::array::from_fn(|a| {
            let base = 3 * nodes[a] as usize;
            Vector3::new(state[base], state[base + 1], state[base + 2])
        });
        let offset = body.displacement_len();
        let pressures = element.pressures.map(|p| if p == ABSENT { 0.0 } else { state[offset + p as usize] });
        Self { displacements, pressures }
    }

    #[inline(always)]
    pub(super) fn pressure_at(&self, point: &Point<N>) -> f64 {
        self.pressures.iter().zip(&point.barycentric).map(|(q, n)| q * n).sum()
    }
}

/// What one element adds to the whole.
pub(super) struct ElementSystem<const N: usize> {
    pub(super) energy_j: f64,
    pub(super) force: [Vector3<f64>; N],
    pub(super) constraint: [f64; 4],
    /// Blocks (a, b) with b <= a, each row-major.
    pub(super) stiffness: [[[f64; 9]; N]; N],
    /// Coupling of each pressure vertex with each node.
    pub(super) coupling: [[Vector3<f64>; N]; 4],
    pub(super) min_jacobian: f64,
    pub(super) volume_m3: f64,
}

impl<const N: usize> ElementSystem<N> {
    pub(super) fn new() -> Self {
        Self {
            energy_j: 0.0,
            force: [Vector3::zeros(); N],
            constraint: [0.0; 4],
            stiffness: [[[0.0; 9]; N]; N],
            coupling: [[Vector3::zeros(); N]; 4],
            min_jacobian: f64::INFINITY,
            volume_m3: 0.0,
        }
    }

    /// Back to zero without a pass over the tangent where it is not asked for.
    #[inline(always)]
    fn clear<const TANGENT: bool>(&mut self) {
        self.energy_j = 0.0;
        self.force = [Vector3::zeros(); N];
        self.constraint = [0.0; 4];
        self.min_jacobian = f64::INFINITY;
        self.volume_m3 = 0.0;
        if TANGENT {
            if N > 4 {
                self.stiffness = [[[0.0; 9]; N]; N];
            }
            self.coupling = [[Vector3::zeros(); N]; 4];
        }
    }

    /// Fills in the element's contribution; the tangent only with `TANGENT`.
    #[inline(always)]
    pub(super) fn compute<const TANGENT: bool>(
        &mut self,
        body: &Body,
        element: &Element,
        nodes: &[u32],
        rule: &[Point<N>],
        state: &[f64],
    ) {
        let local = LocalState::<N>::gather(body, nodes, element, state);
        let material = &body.regions[usize::from(element.region)].material;
        with_law!(material, law => self.add_points::<_, TANGENT>(law, body, element, rule, &local));
    }

    #[inline(always)]
    fn add_points<L: Law, const TANGENT: bool>(
        &mut self,
        law: &L,
        body: &Body,
        element: &Element,
        rule: &[Point<N>],
        local: &LocalState<N>,
    ) {
        let has_pressure = element.pressures[0] != ABSENT;
        self.clear::<TANGENT>();
        for point in rule {
            let gradients = element.tet.shape_gradients(point);
            let kinematics = Kinematics::new(&field_gradient(&local.displacements, &gradients));
            let q_pa = local.pressure_at(point);
            let volume = point.weight * element.tet.volume_m3;
            let (energy, stress) = if TANGENT {
                let (energy, stress, tangent) = law.response(&kinematics, q_pa);
                self.add_stiffness(element, point, &tangent, volume);
                (energy, stress)
            } else {
                law.stress(&kinematics, q_pa)
            };
            let weighted = stress * volume;
            for (force, g) in self.force.iter_mut().zip(&gradients) {
                *force += weighted * g;
            }
            let jacobian = kinematics.jacobian();
            self.energy_j += volume * energy;
            self.volume_m3 += volume * jacobian;
            // `min` would hide a NaN.
            if jacobian < self.min_jacobian || jacobian.is_nan() {
                self.min_jacobian = jacobian;
            }
            if has_pressure {
                self.add_pressure::<TANGENT>(point, &gradients, &kinematics, volume);
            }
        }
        if has_pressure && body.has_pressure_blocks {
            for (v, row) in element.pressure_block.iter().enumerate() {
                let product: f64 = row.iter().zip(&local.pressures).map(|(b, q)| b * q).sum();
                self.constraint[v] += product;
                self.energy_j += 0.5 * local.pressures[v] * product;
            }
        }
    }

    #[inline(always)]
    fn add_pressure<const TANGENT: bool>(
        &mut self,
        point: &Point<N>,
        gradients: &[Vector3<f64>; N],
        kinematics: &Kinematics,
        volume: f64,
    ) {
        for (constraint, shape) in self.constraint.iter_mut().zip(&point.barycentric) {
            *constraint -= volume * shape * kinematics.volume_change;
        }
        if TANGENT {
            for (a, g) in gradients.iter().enumerate() {
                let slope: Vector3<f64> = kinematics.cofactor * g * -volume;
                for (row, shape) in self.coupling.iter_mut().zip(&point.barycentric) {
                    row[a] += slope * *shape;
                }
            }
        }
    }

    /// Adds volume g_a . A . g_b.
    ///
    /// With grad N_a = sum_k D_ak G_k the block of two nodes is sum_kl D_ak D_bl (G_k . A . G_l): the ten blocks of the
    /// barycentric gradients are made once, and a mid-edge node, which has two slopes, sums two of them.
    #[inline(always)]
    fn add_stiffness(&mut self, element: &Element, point: &Point<N>, tangent: &Tangent, volume: f64) {
        let nodes = element.tet.gradients.map(|g| tangent.node(&g));
        if N == 4 {
            for a in 0..4 {
                for b in 0..=a {
                    self.stiffness[a][b] = tangent.block(&nodes[a], &nodes[b]).map(|value| volume * value);
                }
            }
            return;
        }
        let mut vertex = [[[0.0; 9]; 4]; 4];
        for k in 0..4 {
            for l in 0..=k {
                let block = tangent.block(&nodes[k], &nodes[l]).map(|value| volume * value);
                vertex[k][l] = block;
                vertex[l][k] = transposed(&block);
            }
        }
        for k in 0..4 {
            for l in 0..=k {
                add(&mut self.stiffness[k][l], &vertex[k][l], point.slopes[k][k] * point.slopes[l][l]);
            }
        }
        // Rows of the mid-edge nodes against the barycentric columns, then against the nodes.
        let mut edge = [[[0.0; 9]; 4]; 6];
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

    /// Entry of the displacement block, any order of the local indices.
    #[inline(always)]
    pub(super) fn stiffness_at(&self, i: usize, j: usize) -> f64 {
        let (row, column) = (i.max(j), i.min(j));
        // The diagonal blocks are whole; of the others only the lower triangle is there.
        self.stiffness[row / 3][column / 3][3 * (row % 3) + column % 3]
    }
}

#[inline(always)]
fn add(sum: &mut [f64; 9], block: &[f64; 9], factor: f64) {
    for (sum, value) in sum.iter_mut().zip(block) {
        *sum += factor * value;
    }
}

#[inline(always)]
fn transposed(block: &[f64; 9]) -> [f64; 9] {
    let [a, b, c, d, e, f, g, h, i] = *block;
    [a, d, g, b, e, h, c, f, i]
}

/// Third derivatives of the Lagrangian along three state directions, in the order of
/// [`crate::material::THIRD_INDICES`].
#[inline(always)]
pub(super) fn third_along<const N: usize>(
    body: &Body,
    element: &Element,
    nodes: &[u32],
    rule: &[Point<N>],
    state: &[f64],
    directions: &[Vec<f64>; 3],
) -> [f64; 10] {
    let material = &body.regions[usize::from(element.region)].material;
    let here = LocalState::<N>::gather(body, nodes, element, state);
    let along = [0, 1, 2].map(|d| LocalState::<N>::gather(body, nodes, element, &directions[d]));
    with_law!(material, law => third_at_points(law, element, rule, &here, &along))
}

#[inline(always)]
fn third_at_points<L: Law, const N: usize>(
    law: &L,
    element: &Element,
    rule: &[Point<N>],
    here: &LocalState<N>,
    along: &[LocalState<N>; 3],
) -> [f64; 10] {
    let mut sum = [0.0; 10];
    for point in rule {
        let gradients = element.tet.shape_gradients(point);
        let kinematics = Kinematics::new(&field_gradient(&here.displacements, &gradients));
        let slopes: [Matrix3<f64>; 3] =
            std::array::from_fn(|d| field_gradient(&along[d].displacements, &gradients));
        let dq_pa = std::array::from_fn(|d| along[d].pressure_at(point));
        let third = law.third_along(&kinematics, here.pressure_at(point), &slopes, &dq_pa);
        let volume = point.weight * element.tet.volume_m3;
        for (total, value) in sum.iter_mut().zip(third) {
            *total += volume * value;
        }
    }
    sum
}
