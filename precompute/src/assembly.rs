//! Residual and tangent stiffness of the body, on a sparsity pattern fixed once per active node.
//!
//! Only the lower triangle of the symmetric matrix is kept, by columns. Where each element entry lands is looked up
//! in a precomputed map, so assembling is a straight pass over the elements without a search.

use nalgebra::{Matrix3, Vector3};

use crate::body::Body;
use crate::boundary::{ABSENT, DofMap};
use crate::element::Tet4;
use crate::incompressibility::pressure_tangent;
use crate::kinematics::Kinematics;

/// Entries of one element in the lower triangle: 12 x 13 / 2 of the displacement block and 12 x 4 of the coupling.
const ELEMENT_ENTRIES: usize = 78 + 48;

/// Sparsity of the lower triangle and the scatter map into it.
#[derive(Debug)]
pub struct Pattern {
    /// Column starts, `unknowns + 1`.
    pub column_starts: Vec<usize>,
    /// Row of every entry, sorted in each column; the diagonal comes first.
    pub rows: Vec<usize>,
    /// Equations of each element's 16 local unknowns.
    element_dofs: Vec<[u32; 16]>,
    /// Place of each element entry in the values; entries that are eliminated point one past the end.
    scatter: Vec<[u32; ELEMENT_ENTRIES]>,
}

/// Local unknown pairs (row, column) in the order of the scatter map.
fn local_pairs(pressures: bool) -> impl Iterator<Item = (usize, usize)> {
    let displacement = (0..12).flat_map(|i| (0..=i).map(move |j| (i, j)));
    let coupling = (0..if pressures { 4 } else { 0 }).flat_map(|p| (0..12).map(move |j| (12 + p, j)));
    displacement.chain(coupling)
}

impl Pattern {
    /// Pattern of `body` with the unknowns of `dofs`.
    pub fn new(body: &Body, dofs: &DofMap) -> Self {
        let n = dofs.unknowns();
        let pressures = body.material.rest_pressure_pa().is_some();
        let element_dofs: Vec<[u32; 16]> = body.elements.iter().map(|e| dofs.element(e)).collect();
        // Every diagonal entry is present: the pressure block has none of its own but takes the regularisation.
        let mut columns: Vec<Vec<u32>> = (0..n).map(|i| vec![i as u32]).collect();
        for local in &element_dofs {
            for (i, j) in local_pairs(pressures) {
                let (row, column) = (local[i].max(local[j]), local[i].min(local[j]));
                if (row as usize) < n {
                    columns[column as usize].push(row);
                }
            }
        }
        let mut column_starts = Vec::with_capacity(n + 1);
        let mut rows = Vec::new();
        column_starts.push(0);
        for column in &mut columns {
            column.sort_unstable();
            column.dedup();
            rows.extend(column.iter().map(|&r| r as usize));
            column_starts.push(rows.len());
        }
        let nowhere = rows.len() as u32;
        let scatter = element_dofs
            .iter()
            .map(|local| {
                let mut places = [nowhere; ELEMENT_ENTRIES];
                for (place, (i, j)) in places.iter_mut().zip(local_pairs(pressures)) {
                    let (row, column) = (local[i].max(local[j]) as usize, local[i].min(local[j]) as usize);
                    if row < n {
                        let (start, end) = (column_starts[column], column_starts[column + 1]);
                        let offset =
                            rows[start..end].binary_search(&row).expect("every pair was entered above");
                        *place = (start + offset) as u32;
                    }
                }
                places
            })
            .collect();
        Self { column_starts, rows, element_dofs, scatter }
    }

    /// Number of equations.
    pub fn unknowns(&self) -> usize {
        self.column_starts.len() - 1
    }

    /// Number of stored entries.
    pub fn entries(&self) -> usize {
        self.rows.len()
    }

    /// The same entries as columns of the upper triangle: (column starts, sorted rows).
    pub fn upper_triangle(&self) -> (Vec<usize>, Vec<usize>) {
        let n = self.unknowns();
        let mut columns = vec![Vec::new(); n];
        for column in 0..n {
            for &row in &self.rows[self.column_starts[column]..self.column_starts[column + 1]] {
                columns[row].push(column);
            }
        }
        let starts = std::iter::once(0)
            .chain(columns.iter().scan(0, |total, column| {
                *total += column.len();
                Some(*total)
            }))
            .collect();
        (starts, columns.concat())
    }

    /// y = A x for the symmetric matrix whose lower triangle has the `values`.
    pub fn multiply(&self, values: &[f64], x: &[f64], y: &mut [f64]) {
        y.fill(0.0);
        for column in 0..self.unknowns() {
            let (start, end) = (self.column_starts[column], self.column_starts[column + 1]);
            let x_column = x[column];
            let mut sum = values[start] * x_column;
            for (&row, &value) in self.rows[start + 1..end].iter().zip(&values[start + 1..end]) {
                y[row] += value * x_column;
                sum += value * x[row];
            }
            y[column] += sum;
        }
    }
}

/// What one pass over the elements yields.
#[derive(Debug, Clone, Default)]
pub struct Assembled {
    /// Internal force on every node (pressure part included), 3 per node, N.
    pub nodal_force_n: Vec<f64>,
    /// Constraint int N_i (1 - J) of every node, m^3.
    pub constraint_m3: Vec<f64>,
    /// Lagrangian: stored energy plus the constraint term, J.
    pub energy_j: f64,
    /// Smallest J over the elements.
    pub min_jacobian: f64,
    /// Elements with J <= 0.
    pub inverted: usize,
    /// Deformed volume, m^3.
    pub volume_m3: f64,
    /// Tangent, lower triangle on the [`Pattern`]; one slot more than entries, where eliminated ones fall.
    pub tangent: Vec<f64>,
}

/// Force and tangent of one element.
struct ElementTangent {
    force: [Vector3<f64>; 4],
    /// Blocks (a, b) with b <= a.
    stiffness: [[Matrix3<f64>; 4]; 4],
    /// Coupling of vertex a with each pressure vertex, per unit of pressure.
    coupling: [Vector3<f64>; 4],
}

/// Where an element stands in the body's state.
struct ElementState {
    kinematics: Kinematics,
    pressure_pa: f64,
}

impl ElementState {
    fn new(body: &Body, element: &Tet4, state: &[f64]) -> Self {
        let kinematics = Kinematics::new(&element.displacement_gradient(state));
        let pressures = &state[3 * body.node_count..];
        let pressure_pa = if pressures.is_empty() {
            0.0
        } else {
            0.25 * element.nodes.iter().map(|&n| pressures[n as usize]).sum::<f64>()
        };
        Self { kinematics, pressure_pa }
    }
}

/// Force, stiffness and pressure coupling of one tetrahedron.
///
/// With f_a = F grad N_a, S the second Piola stress and dS = alpha tr(dgamma) I + beta dgamma:
///
/// force_a = V (F S - p cof F) g_a
///
/// K_ab = V [ (g_a . S g_b) I + alpha f_a f_b^T + beta/2 (f_b f_a^T + (g_a . g_b) F F^T) ] + p V cross(F (g_a x g_b))
///
/// (dgamma of w at vertex b is sym(f_b-weighted w (x) g_b); contract with the tangent and with v at vertex a.)
#[inline]
fn element_tangent(body: &Body, element: &Tet4, at: &ElementState) -> ElementTangent {
    let k = &at.kinematics;
    let f = &k.deformation_gradient;
    let second_piola = body.material.second_piola(&k.green_strain);
    let first_piola = f * second_piola - k.cofactor * at.pressure_pa;
    let tangent = body.material.tangent();
    let volume = element.volume_m3;
    let g = &element.gradients;
    let fg = g.map(|g_a| f * g_a);
    let sg = g.map(|g_a| second_piola * g_a);
    let left_cauchy_green = f * f.transpose();
    let mut stiffness = [[Matrix3::zeros(); 4]; 4];
    for a in 0..4 {
        for b in 0..=a {
            let mut block = (fg[a] * fg[b].transpose()) * tangent.alpha_pa
                + (fg[b] * fg[a].transpose() + left_cauchy_green * g[a].dot(&g[b])) * (0.5 * tangent.beta_pa);
            let geometric = g[a].dot(&sg[b]);
            for axis in 0..3 {
                block[(axis, axis)] += geometric;
            }
            block *= volume;
            if a != b && at.pressure_pa != 0.0 {
                block += pressure_tangent(at.pressure_pa * volume, f, &g[a], &g[b]);
            }
            stiffness[a][b] = block;
        }
    }
    ElementTangent {
        force: g.map(|g_a| first_piola * g_a * volume),
        stiffness,
        coupling: g.map(|g_a| k.cofactor * g_a * (-0.25 * volume)),
    }
}

impl Assembled {
    /// Empty result with room for `body` and `pattern`.
    pub fn new(body: &Body, pattern: &Pattern) -> Self {
        Self {
            nodal_force_n: vec![0.0; 3 * body.node_count],
            constraint_m3: vec![0.0; body.state_len() - 3 * body.node_count],
            tangent: vec![0.0; pattern.entries() + 1],
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

    fn add_scalars(&mut self, body: &Body, element: &Tet4, at: &ElementState) {
        let volume = element.volume_m3;
        let jacobian = at.kinematics.jacobian();
        let deficit = -at.kinematics.volume_change;
        self.energy_j += volume
            * (body.material.strain_energy_density(&at.kinematics.green_strain) + at.pressure_pa * deficit);
        // `min` would hide a NaN.
        if jacobian < self.min_jacobian || jacobian.is_nan() {
            self.min_jacobian = jacobian;
        }
        self.inverted += usize::from(jacobian <= 0.0);
        self.volume_m3 += volume * jacobian;
        if !self.constraint_m3.is_empty() {
            for &node in &element.nodes {
                self.constraint_m3[node as usize] += 0.25 * volume * deficit;
            }
        }
    }

    /// Forces, constraints, energy and tangent at `state`.
    pub fn assemble(&mut self, body: &Body, pattern: &Pattern, state: &[f64]) {
        self.clear();
        self.tangent.fill(0.0);
        let pressures = !self.constraint_m3.is_empty();
        let scale = body.pressure_scale();
        for (element, places) in body.elements.iter().zip(&pattern.scatter) {
            let at = ElementState::new(body, element, state);
            self.add_scalars(body, element, &at);
            let local = element_tangent(body, element, &at);
            for (a, &node) in element.nodes.iter().enumerate() {
                for axis in 0..3 {
                    self.nodal_force_n[3 * node as usize + axis] += local.force[a][axis];
                }
            }
            let mut place = places.iter();
            let mut add = |value: f64| {
                if let Some(&at) = place.next() {
                    self.tangent[at as usize] += value;
                }
            };
            for a in 0..4 {
                for i in 0..3 {
                    for b in 0..=a {
                        for j in 0..if a == b { i + 1 } else { 3 } {
                            add(local.stiffness[a][b][(i, j)]);
                        }
                    }
                }
            }
            if pressures {
                for _ in 0..4 {
                    for coupling in &local.coupling {
                        for i in 0..3 {
                            add(scale * coupling[i]);
                        }
                    }
                }
            }
        }
    }

    /// Forces, constraints and energy at `state`, without the tangent.
    pub fn assemble_residual(&mut self, body: &Body, state: &[f64]) {
        self.clear();
        for element in &body.elements {
            let at = ElementState::new(body, element, state);
            self.add_scalars(body, element, &at);
            let k = &at.kinematics;
            let first_piola = k.deformation_gradient * body.material.second_piola(&k.green_strain)
                - k.cofactor * at.pressure_pa;
            for (&node, g) in element.nodes.iter().zip(&element.gradients) {
                let force = first_piola * g * element.volume_m3;
                for axis in 0..3 {
                    self.nodal_force_n[3 * node as usize + axis] += force[axis];
                }
            }
        }
    }

    /// Internal force at `node`, N. At the active node this is h, the force by the tool on the body.
    pub fn force_at(&self, node: u32) -> [f64; 3] {
        let base = 3 * node as usize;
        [self.nodal_force_n[base], self.nodal_force_n[base + 1], self.nodal_force_n[base + 2]]
    }

    /// Residual in the order of the equations; constraints scaled like forces, N.
    pub fn residual_into(&self, body: &Body, dofs: &DofMap, residual: &mut [f64]) {
        let scale = body.pressure_scale();
        let forces = self.nodal_force_n.len();
        for (dof, position) in dofs.state_positions() {
            residual[dof] = if position < forces {
                self.nodal_force_n[position]
            } else {
                scale * self.constraint_m3[position - forces]
            };
        }
    }
}

/// Rows of the tangent that elimination removed: the active node against the unknowns and against itself.
#[derive(Debug, Clone)]
pub struct ActiveCoupling {
    /// K_fA, one column of length `unknowns` per axis, N/m.
    pub free: [Vec<f64>; 3],
    /// K_AA, N/m.
    pub own: Matrix3<f64>,
}

impl ActiveCoupling {
    /// Coupling of the active node at `state`, from the few elements that touch it.
    pub fn assemble(body: &Body, pattern: &Pattern, active_node: u32, state: &[f64]) -> Self {
        let n = pattern.unknowns();
        let mut free = [vec![0.0; n], vec![0.0; n], vec![0.0; n]];
        let mut own = Matrix3::zeros();
        let scale = body.pressure_scale();
        for (element, dofs) in body.elements.iter().zip(&pattern.element_dofs) {
            let Some(a) = element.nodes.iter().position(|&n| n == active_node) else { continue };
            let local = element_tangent(body, element, &ElementState::new(body, element, state));
            for b in 0..4 {
                // Block (row vertex b, column vertex a); only b <= a or its transpose is stored.
                let block = if b >= a { local.stiffness[b][a] } else { local.stiffness[a][b].transpose() };
                if b == a {
                    own += block;
                    continue;
                }
                for i in 0..3 {
                    let row = dofs[3 * b + i] as usize;
                    if row < n {
                        for (axis, column) in free.iter_mut().enumerate() {
                            column[row] += block[(i, axis)];
                        }
                    }
                }
            }
            for &row in dofs[12..].iter().filter(|&&row| row != ABSENT) {
                for (axis, column) in free.iter_mut().enumerate() {
                    column[row as usize] += scale * local.coupling[a][axis];
                }
            }
        }
        Self { free, own }
    }
}
