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
use crate::element::{Point, field_gradient};
use crate::kinematics::Kinematics;
use crate::material::Elasticity;

/// Values of a state at the nodes of one element.
pub(super) struct LocalState<const N: usize> {
    pub(super) displacements: [Vector3<f64>; N],
    pub(super) pressures: [f64; 4],
}

impl<const N: usize> LocalState<N> {
    #[inline]
    pub(super) fn gather(body: &Body, nodes: &[u32], element: &Element, state: &[f64]) -> Self {
        let displacements = std::array::from_fn(|a| {
            let base = 3 * nodes[a] as usize;
            Vector3::new(state[base], state[base + 1], state[base + 2])
        });
        let offset = body.displacement_len();
        let pressures = element.pressures.map(|p| if p == ABSENT { 0.0 } else { state[offset + p as usize] });
        Self { displacements, pressures }
    }

    #[inline]
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
    #[inline]
    fn clear<const TANGENT: bool>(&mut self) {
        self.energy_j = 0.0;
        self.force = [Vector3::zeros(); N];
        self.constraint = [0.0; 4];
        self.min_jacobian = f64::INFINITY;
        self.volume_m3 = 0.0;
        if TANGENT {
            self.stiffness = [[[0.0; 9]; N]; N];
            self.coupling = [[Vector3::zeros(); N]; 4];
        }
    }

    /// Fills in the element's contribution; the tangent only with `TANGENT`.
    #[inline]
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
        let has_pressure = element.pressures[0] != ABSENT;
        self.clear::<TANGENT>();
        for point in rule {
            let gradients = element.tet.shape_gradients(point);
            let kinematics = Kinematics::new(&field_gradient(&local.displacements, &gradients));
            let q_pa = local.pressure_at(point);
            let volume = point.weight * element.tet.volume_m3;
            let (energy, stress) = if TANGENT {
                let (energy, stress, elasticity) = material.response(&kinematics, q_pa);
                self.add_stiffness(&gradients, &elasticity, volume);
                (energy, stress)
            } else {
                material.stress(&kinematics, q_pa)
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

    #[inline]
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

    /// Adds volume g_a . A . g_b. The elasticity is laid out so that both contractions run along contiguous numbers:
    /// 27 for A . g_b, nine for g_a . (A g_b).
    #[inline]
    fn add_stiffness(&mut self, gradients: &[Vector3<f64>; N], elasticity: &Elasticity, volume: f64) {
        // by_column[L][3 (3 K + i) + j] = volume A_iKjL.
        let mut by_column = [[0.0; 27]; 3];
        for (row, entries) in elasticity.iter().enumerate() {
            for (large_l, column) in by_column.iter_mut().enumerate() {
                for j in 0..3 {
                    column[3 * row + j] = volume * entries[3 * large_l + j];
                }
            }
        }
        for b in 0..N {
            let g = &gradients[b];
            let mut traction = [0.0; 27];
            for (r, t) in traction.iter_mut().enumerate() {
                *t = g[0] * by_column[0][r] + g[1] * by_column[1][r] + g[2] * by_column[2][r];
            }
            for a in b..N {
                let g = &gradients[a];
                let block = &mut self.stiffness[a][b];
                for (r, entry) in block.iter_mut().enumerate() {
                    *entry += g[0] * traction[r] + g[1] * traction[9 + r] + g[2] * traction[18 + r];
                }
            }
        }
    }

    /// Entry of the displacement block, any order of the local indices.
    #[inline]
    pub(super) fn stiffness_at(&self, i: usize, j: usize) -> f64 {
        let (row, column) = (i.max(j), i.min(j));
        // The diagonal blocks are whole; of the others only the lower triangle is there.
        self.stiffness[row / 3][column / 3][3 * (row % 3) + column % 3]
    }
}

/// Third derivatives of the Lagrangian along three state directions, in the order of
/// [`crate::material::THIRD_INDICES`].
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
    let mut sum = [0.0; 10];
    for point in rule {
        let gradients = element.tet.shape_gradients(point);
        let kinematics = Kinematics::new(&field_gradient(&here.displacements, &gradients));
        let slopes: [Matrix3<f64>; 3] =
            std::array::from_fn(|d| field_gradient(&along[d].displacements, &gradients));
        let dq_pa = std::array::from_fn(|d| along[d].pressure_at(point));
        let third = material.third_along(&kinematics, here.pressure_at(point), &slopes, &dq_pa);
        let volume = point.weight * element.tet.volume_m3;
        for (total, value) in sum.iter_mut().zip(third) {
            *total += volume * value;
        }
    }
    sum
}
