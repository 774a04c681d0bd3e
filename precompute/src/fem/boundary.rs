//! What is held: fixed nodes, the tool's handle on the body, and how either is imposed.
//!
//! Both of the paper's scripts, F (fixed nodes) and A (active node), prescribe displacements. By default they are eliminated:
//! the reaction is then the internal force where the body is held. With [`Constraints::Multipliers`] every prescribed
//! component keeps its equation and gets a Lagrange multiplier, as in the paper; the multiplier is the reaction. The two
//! agree to rounding; eliminating is faster, and spares a symmetric factorisation without pivoting the zero diagonal.

use nalgebra::{Matrix3, Rotation3, Vector3};

use serde::{Deserialize, Serialize};

use crate::fem::body::{ABSENT, Body};
use crate::fem::element::{EDGES, Order};
use crate::fem::ordering::nested_dissection;

/// How prescribed displacements are imposed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum Constraints {
    /// Taken out of the equations.
    #[default]
    Elimination,
    /// By Lagrange multipliers, as in the paper.
    Multipliers,
}

/// The nodes a tool holds: one active node, or a patch that moves as a rigid body.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Handle {
    /// The node whose displacement is meant; the patch turns about it.
    pub centre: u32,
    /// All nodes held, the centre among them, ascending.
    pub nodes: Vec<u32>,
}

impl Handle {
    /// A single active node.
    pub fn node(node: u32) -> Self {
        Self { centre: node, nodes: vec![node] }
    }

    /// A rigid patch of nodes round `centre`.
    pub fn patch(centre: u32, nodes: &[u32]) -> Self {
        let mut nodes = nodes.to_vec();
        nodes.push(centre);
        nodes.sort_unstable();
        nodes.dedup();
        Self { centre, nodes }
    }

    /// The same handle with the mid-edge nodes between its nodes: they move with their edge.
    pub(crate) fn on(self, body: &Body) -> Self {
        if body.order == Order::Linear || self.nodes.len() < 2 {
            return self;
        }
        let holds = |node: u32| self.nodes.binary_search(&node).is_ok();
        let mut nodes = self.nodes.clone();
        for element in body.connectivity.chunks(body.order.nodes()) {
            let between = EDGES.iter().zip(&element[4..]);
            nodes.extend(
                between
                    .filter(|([a, b], _)| holds(element[*a]) && holds(element[*b]))
                    .map(|(_, &middle)| middle),
            );
        }
        nodes.sort_unstable();
        nodes.dedup();
        Self { centre: self.centre, nodes }
    }
}

/// Prescribed motion of a handle from the body's rest.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Pose {
    /// Displacement of the centre, m.
    pub displacement_m: [f64; 3],
    /// Rotation vector of a patch about the centre, rad; means nothing for a single node.
    pub rotation_rad: [f64; 3],
}

impl Pose {
    /// A displacement without rotation.
    pub fn translation(displacement_m: [f64; 3]) -> Self {
        Self { displacement_m, rotation_rad: [0.0; 3] }
    }

    /// The pose a share of the way from here to `target`.
    pub fn towards(&self, target: &Self, share: f64) -> Self {
        let mix = |a: [f64; 3], b: [f64; 3]| std::array::from_fn(|i| a[i] + share * (b[i] - a[i]));
        Self {
            displacement_m: mix(self.displacement_m, target.displacement_m),
            rotation_rad: mix(self.rotation_rad, target.rotation_rad),
        }
    }

    /// Displacement from rest of a point at `arm_m` from the centre: t + (R - I) arm.
    pub fn displacement_of(&self, arm_m: &Vector3<f64>) -> Vector3<f64> {
        let turn = Rotation3::from_scaled_axis(Vector3::from(self.rotation_rad));
        Vector3::from(self.displacement_m) + (turn.matrix() - Matrix3::identity()) * arm_m
    }
}

/// A Lagrange multiplier that holds one component of one node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Multiplier {
    /// The node.
    pub node: u32,
    /// The component.
    pub axis: usize,
    /// The multiplier's equation.
    pub equation: u32,
}

/// Numbers the unknowns of a body held at its fixed nodes and at a handle.
///
/// Free nodes are ordered by nested dissection of the mesh graph; each gives its displacement components and its pressures
/// one after the other, so that the factorisation sees dense blocks. With elimination the three prescribed components of the
/// handle get the indices `unknowns() + axis`, shared by all its nodes: a translation moves them alike.
#[derive(Debug)]
pub struct DofMap {
    displacement: Vec<[u32; 3]>,
    pressure: Vec<u32>,
    /// Empty with elimination.
    multipliers: Vec<Multiplier>,
    unknowns: usize,
}

impl DofMap {
    /// Unknowns of `body`. A pressure all of whose elements are held on every node would leave a zero row and gets none.
    pub fn new(body: &Body, handle: Option<&Handle>, constraints: Constraints) -> Self {
        let handle_nodes: &[u32] = handle.map_or(&[], |h| &h.nodes);
        let mut held = body.fixed.clone();
        for &node in handle_nodes {
            held[node as usize] = [true; 3];
        }
        let keep_held = constraints == Constraints::Multipliers;
        let mut has_pressure = vec![false; body.pressure_sites.len()];
        for (index, element) in body.elements.iter().enumerate() {
            let moves = keep_held || body.nodes_of(index).iter().any(|&n| held[n as usize] != [true; 3]);
            for &pressure in element.pressures.iter().filter(|&&p| moves && p != ABSENT) {
                has_pressure[pressure as usize] = true;
            }
        }
        let mut pressures_at = vec![Vec::new(); body.node_count()];
        for (pressure, &(vertex, _)) in body.pressure_sites.iter().enumerate() {
            if has_pressure[pressure] {
                pressures_at[vertex as usize].push(pressure);
            }
        }
        let kept = |node: usize| held[node] != [true; 3] || !pressures_at[node].is_empty();
        let order: Vec<usize> = if keep_held {
            nested_dissection(body.node_count(), body.element_nodes(), |_| true)
        } else {
            body.elimination_order().iter().copied().filter(|&node| kept(node)).collect()
        };
        let mut dofs = Self {
            displacement: vec![[ABSENT; 3]; body.node_count()],
            pressure: vec![ABSENT; body.pressure_sites.len()],
            multipliers: Vec::new(),
            unknowns: 0,
        };
        let mut next = 0u32;
        for &node in &order {
            for axis in 0..3 {
                if keep_held || !held[node][axis] {
                    dofs.displacement[node][axis] = next;
                    next += 1;
                }
            }
            for &pressure in &pressures_at[node] {
                dofs.pressure[pressure] = next;
                next += 1;
            }
            for axis in 0..3 {
                if keep_held && held[node][axis] {
                    dofs.multipliers.push(Multiplier { node: node as u32, axis, equation: next });
                    next += 1;
                }
            }
        }
        dofs.unknowns = next as usize;
        if !keep_held {
            let n = dofs.unknowns as u32;
            for &node in handle_nodes {
                dofs.displacement[node as usize] = [n, n + 1, n + 2];
            }
        }
        dofs
    }
}

impl DofMap {
    /// Number of equations.
    pub fn unknowns(&self) -> usize {
        self.unknowns
    }

    /// Equation of each displacement component of `node`; `>= unknowns()` where the handle holds it, [`ABSENT`] if fixed.
    #[inline]
    pub fn displacement(&self, node: u32) -> [u32; 3] {
        self.displacement[node as usize]
    }

    /// Equation of a pressure unknown, or [`ABSENT`].
    #[inline]
    pub fn pressure(&self, pressure: u32) -> u32 {
        if pressure == ABSENT { ABSENT } else { self.pressure[pressure as usize] }
    }

    /// Multipliers of the held components; empty with elimination.
    pub fn multipliers(&self) -> &[Multiplier] {
        &self.multipliers
    }

    /// Pairs (equation, position in the state vector) of every unknown of the state; see [`Body`] for the state.
    pub fn state_positions(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let displacements = self.displacement.iter().enumerate().flat_map(|(node, dofs)| {
            dofs.iter().enumerate().map(move |(axis, &dof)| (dof as usize, 3 * node + axis))
        });
        let offset = 3 * self.displacement.len();
        let pressures = self.pressure.iter().enumerate().map(move |(p, &dof)| (dof as usize, offset + p));
        displacements.chain(pressures).filter(|&(dof, _)| dof < self.unknowns)
    }
}
