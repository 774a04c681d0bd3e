//! A body in discretised form: elements, material regions, fixed nodes, and the layout of its state vector.

mod derived;

use std::collections::HashMap;
use std::ops::Range;
use std::sync::OnceLock;

use crate::fem::element::{EDGES, LINEAR, Order, Point, QUADRATIC, Tetrahedron};
use crate::fem::material::Material;
use crate::fem::ordering::nested_dissection;
use crate::fem::pressure::{PressurePair, pressure_block};
use crate::mesh::surface::boundary;
use crate::mesh::{Edges, MeshFault, TetMesh};

/// Index of a value that is prescribed to zero or does not exist.
pub(crate) const ABSENT: u32 = u32::MAX;

/// Material of a part of the body.
#[derive(Debug, Clone, PartialEq)]
pub struct Region {
    /// The constitutive law.
    pub material: Material,
    /// Bulk modulus of a nearly incompressible law with a pressure, Pa; `None` means exactly incompressible
    /// (J = 1).
    pub bulk_modulus_pa: Option<f64>,
}

impl From<Material> for Region {
    fn from(material: Material) -> Self {
        Self { material, bulk_modulus_pa: None }
    }
}

/// Materials, discretisation and boundary conditions of a mesh.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// Order of the displacement shape functions.
    pub order: Order,
    /// Pressure field of the incompressible regions.
    pub pressure_pair: PressurePair,
    /// Materials.
    pub regions: Vec<Region>,
    /// Region of each tet; empty if there is only one.
    pub region_of_tet: Vec<u16>,
    /// Fixed mesh nodes. A mid-edge node is fixed if both ends of its edge are.
    pub fixed: Vec<u32>,
    /// Mesh nodes with some fixed components: symmetry planes and rollers. Mid-edge nodes as for `fixed`, per
    /// component.
    pub rollers: Vec<(u32, [bool; 3])>,
    /// Force per undeformed volume, N/m^3.
    pub body_force_n_m3: [f64; 3],
}

impl Model {
    /// A model with one material, first order and no body force.
    pub fn uniform(material: Material, fixed: &[u32]) -> Self {
        Self {
            order: Order::Linear,
            pressure_pair: PressurePair::Plain,
            regions: vec![material.into()],
            region_of_tet: Vec::new(),
            fixed: fixed.to_vec(),
            rollers: Vec::new(),
            body_force_n_m3: [0.0; 3],
        }
    }
}

/// One element.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Element {
    /// Undeformed geometry.
    pub tet: Tetrahedron,
    /// Index of the region.
    pub region: u16,
    /// Pressure unknowns of the four vertices; `ABSENT` if the law has no pressure.
    pub pressures: [u32; 4],
    /// Matrix of the pressure's quadratic form, m^3/Pa; zero for the unstabilised pairs.
    pub pressure_block: [[f64; 4]; 4],
    /// Which of the mid-edge nodes of a quadratic element follow the ends of their edge.
    pub follows: [bool; 6],
}

/// A mid-edge node without equations of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Follower {
    /// The node.
    pub node: u32,
    /// The ends of its edge; its displacement is their mean.
    pub ends: [u32; 2],
}

/// A meshed body with its fixed nodes.
///
/// State vector: first the displacement u from the mesh, 3 per node, node-major, in m (mesh nodes in file
/// order, then mid-edge nodes). Then the excess pressures q in Pa, one per vertex of each incompressible
/// region.
#[derive(Debug)]
pub struct Body {
    /// Order of the shape functions.
    pub order: Order,
    /// One element per tetrahedron: first those with linear shape functions, then those with quadratic ones, each
    /// in file order.
    pub(crate) elements: Vec<Element>,
    /// Number of elements with linear shape functions: all of a body of first order; of one of second order none,
    /// or those far from the tool ([`Body::quadratic_near`]).
    pub(crate) linear: usize,
    /// Mid-edge nodes of linear elements.
    pub(crate) followers: Vec<Follower>,
    /// Node indices, `Order::nodes` per element.
    pub connectivity: Vec<u32>,
    /// Undeformed node positions, m.
    pub nodes_m: Vec<[f64; 3]>,
    /// Materials.
    pub regions: Vec<Region>,
    /// (vertex, region) of each pressure unknown.
    pub(crate) pressure_sites: Vec<(u32, u16)>,
    /// Whether any element has a non-zero pressure block.
    pub(crate) has_pressure_blocks: bool,
    /// Which components of each node are fixed.
    pub fixed: Vec<[bool; 3]>,
    /// Consistent nodal force of the body force, 3 per node, N.
    pub external_force_n: Vec<f64>,
    /// Mean edge length of the tetrahedra, m.
    pub edge_m: f64,
    /// State vector of the equilibrium without a tool, the reference of displacements; zero without body
    /// force.
    pub rest_state: Vec<f64>,
    /// Total potential of this state, J.
    pub(crate) rest_energy_j: f64,
    /// Volume-weighted geometric mean of the regions' shear moduli, Pa. The geometric mean gives one scale
    /// for a body with parts of very different stiffness.
    mean_shear_pa: f64,
    /// See [`Body::elimination_order`].
    elimination_order: OnceLock<Vec<usize>>,
    /// See [`Body::skin`].
    skin: OnceLock<Vec<u32>>,
}

impl Body {
    /// Builds the body of a checked mesh. If it has a body force, [`crate::fem::solve_body_force`] must
    /// then solve its rest state.
    pub fn new(mesh: &TetMesh, model: &Model) -> Result<Self, MeshFault> {
        let mut nodes_m = mesh.nodes_m.clone();
        let mut fixed = vec![[false; 3]; nodes_m.len()];
        for &node in &model.fixed {
            fixed[node as usize] = [true; 3];
        }
        for &(node, held) in &model.rollers {
            for (fixed, held) in fixed[node as usize].iter_mut().zip(held) {
                *fixed |= held;
            }
        }
        let connectivity = match model.order {
            Order::Linear => mesh.tets.concat(),
            Order::Quadratic => add_mid_edge_nodes(mesh, &mut nodes_m, &mut fixed),
        };
        let mut pressure_sites = Vec::new();
        let mut site_indices = HashMap::new();
        let mut site = |vertex: u32, region: u16| {
            *site_indices.entry((vertex, region)).or_insert_with(|| {
                pressure_sites.push((vertex, region));
                pressure_sites.len() as u32 - 1
            })
        };
        let mut elements = Vec::with_capacity(mesh.tets.len());
        let (mut volume, mut log_shear) = (0.0, 0.0);
        for (index, &vertices) in mesh.tets.iter().enumerate() {
            let tet =
                Tetrahedron::new(mesh.vertices_m(index)).ok_or(MeshFault::Flat { tet: index as u32 })?;
            let region = model.region_of_tet.get(index).copied().unwrap_or(0);
            let Region { material, bulk_modulus_pa } = &model.regions[usize::from(region)];
            let shear_pa = material.shear_modulus_pa();
            let mut element = Element {
                tet,
                region,
                pressures: [ABSENT; 4],
                pressure_block: [[0.0; 4]; 4],
                follows: [false; 6],
            };
            if material.rest_pressure_pa().is_some() {
                element.pressures = vertices.map(|vertex| site(vertex, region));
                element.pressure_block =
                    pressure_block(tet.volume_m3, shear_pa, *bulk_modulus_pa, model.pressure_pair);
            }
            volume += tet.volume_m3;
            log_shear += tet.volume_m3 * libm::log(shear_pa);
            elements.push(element);
        }
        // A regular tetrahedron of edge l has the volume l^3 / (6 sqrt 2).
        let mean_volume = volume / elements.len().max(1) as f64;
        let mut body = Self {
            order: model.order,
            has_pressure_blocks: elements.iter().any(|element| element.pressure_block[0][0] != 0.0),
            linear: match model.order {
                Order::Linear => elements.len(),
                Order::Quadratic => 0,
            },
            elements,
            followers: Vec::new(),
            connectivity,
            regions: model.regions.clone(),
            fixed,
            external_force_n: vec![0.0; 3 * nodes_m.len()],
            edge_m: libm::cbrt(mean_volume * 6.0 * std::f64::consts::SQRT_2),
            rest_state: vec![0.0; 3 * nodes_m.len() + pressure_sites.len()],
            rest_energy_j: 0.0,
            mean_shear_pa: libm::exp(log_shear / volume),
            elimination_order: OnceLock::new(),
            skin: OnceLock::new(),
            nodes_m,
            pressure_sites,
        };
        if model.body_force_n_m3 != [0.0; 3] {
            match model.order {
                Order::Linear => body.load(&LINEAR, model.body_force_n_m3),
                Order::Quadratic => body.load(&QUADRATIC, model.body_force_n_m3),
            }
        }
        Ok(body)
    }

    /// f_a = int N_a b dV.
    fn load<const N: usize>(&mut self, rule: &[Point<N>], force_n_m3: [f64; 3]) {
        let shares: [f64; N] = std::array::from_fn(|a| rule.iter().map(|p| p.weight * p.values[a]).sum());
        for (element, nodes) in self.elements.iter().zip(self.connectivity.chunks(N)) {
            for (&node, share) in nodes.iter().zip(&shares) {
                for axis in 0..3 {
                    self.external_force_n[3 * node as usize + axis] +=
                        share * element.tet.volume_m3 * force_n_m3[axis];
                }
            }
        }
    }

    /// Gives the mid-edge nodes without equations the mean of the ends of their edge.
    pub(crate) fn let_follow(&self, state: &mut [f64]) {
        for &Follower { node, ends } in &self.followers {
            for axis in 0..3 {
                let [a, b] = ends.map(|end| state[3 * end as usize + axis]);
                state[3 * node as usize + axis] = 0.5 * (a + b);
            }
        }
    }

    /// Whether each node has equations of its own where it is not prescribed.
    pub(crate) fn independent(&self) -> Vec<bool> {
        let mut independent = vec![true; self.nodes_m.len()];
        for follower in &self.followers {
            independent[follower.node as usize] = false;
        }
        independent
    }

    /// Whether the body has a body force.
    pub(crate) fn is_loaded(&self) -> bool {
        self.external_force_n.iter().any(|&f| f != 0.0)
    }

    /// Nodes of an element.
    #[inline]
    pub fn nodes_of(&self, element: usize) -> &[u32] {
        let n = self.order.nodes();
        &self.connectivity[n * element..n * (element + 1)]
    }

    /// The elements with linear and those with quadratic shape functions.
    pub(crate) fn ranges(&self) -> [Range<usize>; 2] {
        [0..self.linear, self.linear..self.elements.len()]
    }

    /// Nodes of every element's shape functions.
    pub(crate) fn shape_nodes(&self) -> impl Iterator<Item = &[u32]> {
        let (linear, quadratic) = (Order::Linear.nodes(), Order::Quadratic.nodes());
        let nodes = move |index| if index < self.linear { linear } else { quadratic };
        (0..self.elements.len()).map(move |index| &self.nodes_of(index)[..nodes(index)])
    }

    /// Nodes of every element.
    pub(crate) fn element_nodes(&self) -> std::slice::Chunks<'_, u32> {
        self.connectivity.chunks(self.order.nodes())
    }

    /// Length of the displacement part of the state.
    pub fn displacement_len(&self) -> usize {
        3 * self.nodes_m.len()
    }

    /// Length of the state vector.
    pub(crate) fn state_len(&self) -> usize {
        self.displacement_len() + self.pressure_sites.len()
    }

    /// Whether any region has a pressure field.
    pub fn has_pressure(&self) -> bool {
        !self.pressure_sites.is_empty()
    }

    /// Position of a node at rest, m.
    pub fn rest_position_m(&self, node: u32) -> [f64; 3] {
        let base = 3 * node as usize;
        std::array::from_fn(|axis| self.nodes_m[node as usize][axis] + self.rest_state[base + axis])
    }

    /// Scale of the residual: mu l^2, N.
    pub(crate) fn force_scale_n(&self) -> f64 {
        self.mean_shear_pa * self.edge_m * self.edge_m
    }

    /// The mean shear modulus, Pa.
    pub(crate) fn mean_shear_pa(&self) -> f64 {
        self.mean_shear_pa
    }

    /// Factor s between pressures in Pa and the scaled unknowns q / s in m: s = mu / l. With it both blocks
    /// of the saddle-point matrix have the same magnitude, so that one residual norm measures both.
    pub(crate) fn pressure_scale(&self) -> f64 {
        self.mean_shear_pa / self.edge_m
    }

    /// Stiffness of a typical element, mu l, N/m: the scale of the multiplier equations.
    pub(crate) fn stiffness_scale_n_m(&self) -> f64 {
        self.mean_shear_pa * self.edge_m
    }

    /// Nodes with a free displacement component or a pressure, in elimination order. The order is independent
    /// of the handle and is therefore computed once for all active nodes of a scene.
    pub(crate) fn elimination_order(&self) -> &[usize] {
        self.elimination_order.get_or_init(|| {
            let mut has_pressure = vec![false; self.nodes_m.len()];
            for &(vertex, _) in &self.pressure_sites {
                has_pressure[vertex as usize] = true;
            }
            let independent = self.independent();
            nested_dissection(self.nodes_m.len(), self.shape_nodes(), |node| {
                independent[node] && (self.fixed[node] != [true; 3] || has_pressure[node])
            })
        })
    }

    /// Faces of the boundary: three corners, and with second order the nodes between the first and the second,
    /// the second and the third, the third and the first.
    pub(crate) fn skin(&self) -> std::slice::Chunks<'_, u32> {
        let faces = self.skin.get_or_init(|| {
            let mut faces = Vec::new();
            for (element, face) in boundary(self.element_nodes()).0 {
                let nodes = self.nodes_of(element);
                faces.extend(face.map(|v| nodes[v]));
                if self.order == Order::Quadratic {
                    let [a, b, c] = face;
                    let middle = |ends: [usize; 2]| {
                        let edge = EDGES.iter().position(|edge| ends.iter().all(|end| edge.contains(end)));
                        nodes[4 + edge.expect("an edge of the tet")]
                    };
                    faces.extend([[a, b], [b, c], [c, a]].map(middle));
                }
            }
            faces
        });
        faces.chunks(match self.order {
            Order::Linear => 3,
            Order::Quadratic => 6,
        })
    }

    /// Names of the laws without repetitions, for messages.
    pub fn law_names(&self) -> String {
        let mut names: Vec<&str> = self.regions.iter().map(|r| r.material.name()).collect();
        names.dedup();
        names.join(" + ")
    }
}

/// Adds a node at the middle of every edge, numbered in order of first use. Returns the ten nodes of each
/// tet.
fn add_mid_edge_nodes(mesh: &TetMesh, nodes_m: &mut Vec<[f64; 3]>, fixed: &mut Vec<[bool; 3]>) -> Vec<u32> {
    let first = mesh.nodes_m.len() as u32;
    let edges = Edges::of(mesh, EDGES);
    nodes_m.extend(edges.midpoints_m(mesh));
    for ends in &edges.ends {
        let [a, b] = ends.map(|end| fixed[end as usize]);
        fixed.push(std::array::from_fn(|axis| a[axis] && b[axis]));
    }
    let middles = edges.of_tets.iter().map(|edges| edges.map(|edge| first + edge));
    mesh.tets
        .iter()
        .zip(middles)
        .flat_map(|(vertices, middles)| vertices.iter().copied().chain(middles))
        .collect()
}
