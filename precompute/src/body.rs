//! A body ready to be solved: elements, material, fixed nodes, and the layout of its state.

use crate::element::Tet4;
use crate::material::Material;
use crate::mesh::TetMesh;

/// A meshed body of one material, held at its fixed nodes.
///
/// State vector: displacement u, 3 per node, node-major, in m; then for an incompressible law one pressure
/// multiplier per node, in Pa. Node order is file order, so states can be stored and compared across solvers.
#[derive(Debug)]
pub struct Body {
    /// One element per tetrahedron, file order.
    pub elements: Vec<Tet4>,
    /// Number of mesh nodes.
    pub node_count: usize,
    /// Constitutive law.
    pub material: Material,
    /// Whether each node is fixed.
    pub fixed: Vec<bool>,
    /// Mean edge length of the tetrahedra, m.
    pub edge_m: f64,
}

/// A tetrahedron without positive volume.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DegenerateElement {
    /// Index of the tetrahedron, file order.
    pub element: usize,
}

impl std::fmt::Display for DegenerateElement {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "tetrahedron {} has no positive volume; reorder its vertices or mend the mesh",
            self.element
        )
    }
}

impl std::error::Error for DegenerateElement {}

impl Body {
    /// Body of a checked mesh.
    pub fn new(mesh: &TetMesh, material: Material, fixed_nodes: &[u32]) -> Result<Self, DegenerateElement> {
        let elements = mesh
            .tets
            .iter()
            .enumerate()
            .map(|(element, &nodes)| {
                let corners = nodes.map(|n| mesh.nodes_m[n as usize]);
                Tet4::new(nodes, corners).ok_or(DegenerateElement { element })
            })
            .collect::<Result<Vec<_>, _>>()?;
        let mut fixed = vec![false; mesh.nodes_m.len()];
        for &node in fixed_nodes {
            fixed[node as usize] = true;
        }
        // A regular tetrahedron of edge l has the volume l^3 / (6 sqrt 2).
        let mean_volume = elements.iter().map(|e| e.volume_m3).sum::<f64>() / elements.len().max(1) as f64;
        let edge_m = (mean_volume * 6.0 * std::f64::consts::SQRT_2).cbrt();
        Ok(Self { elements, node_count: mesh.nodes_m.len(), material, fixed, edge_m })
    }

    /// Length of the state vector.
    pub fn state_len(&self) -> usize {
        let per_node = if self.material.rest_pressure_pa().is_some() { 4 } else { 3 };
        per_node * self.node_count
    }

    /// The stress-free state: no displacement, rest pressure.
    pub fn rest_state(&self) -> Vec<f64> {
        let mut state = vec![0.0; 3 * self.node_count];
        state.resize(self.state_len(), self.material.rest_pressure_pa().unwrap_or(0.0));
        state
    }

    /// Force by which the body's residual is called small: mu l^2, N.
    pub fn force_scale_n(&self) -> f64 {
        self.material.shear_modulus_pa() * self.edge_m * self.edge_m
    }

    /// Factor s between pressures in Pa and the scaled unknowns q = p / s in m: s = mu / l. It gives both halves of
    /// the saddle-point matrix the same size, so that one residual norm speaks for both.
    pub fn pressure_scale(&self) -> f64 {
        self.material.shear_modulus_pa() / self.edge_m
    }
}
