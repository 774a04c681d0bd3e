//! Boundary conditions: fixed nodes, the tool's handle on the body, and the method that imposes them.
//!
//! Both of the paper's conditions, F (fixed nodes) and A (active node), prescribe displacements. By default
//! the prescribed components are eliminated, and the reaction is the internal force at the prescribed nodes.
//! With [`Constraints::Multipliers`] every prescribed component keeps its equation and gets a Lagrange
//! multiplier, as in the paper; the multiplier is the reaction. Both methods agree to rounding. Elimination
//! is faster and avoids the zero diagonal in a symmetric factorisation without pivoting.

use nalgebra::{Matrix3, Rotation3, Vector3};
use serde::{Deserialize, Serialize};

use crate::fem::body::{ABSENT, Body};
use crate::fem::element::{EDGES, Order};
use crate::fem::ordering::nested_dissection;
use crate::fem::pad::Pad;
use crate::fem::sphere::CoatedSphere;

/// Method that imposes prescribed displacements.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Constraints {
    /// Elimination of the prescribed components.
    #[default]
    Elimination,
    /// Lagrange multipliers, as in the paper.
    Multipliers,
}

/// The grasp of a tool: the set of nodes with prescribed displacement. It is one active node, or a patch that
/// moves as a rigid body.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Handle {
    /// The node whose displacement is the control; the patch rotates about it.
    pub centre: u32,
    /// All prescribed nodes, including the centre, in ascending order.
    pub nodes: Vec<u32>,
}

impl Handle {
    /// A single active node.
    pub fn node(node: u32) -> Self {
        Self { centre: node, nodes: vec![node] }
    }

    /// A rigid patch of nodes around `centre`.
    pub fn patch(centre: u32, nodes: &[u32]) -> Self {
        let mut nodes = nodes.to_vec();
        nodes.push(centre);
        nodes.sort_unstable();
        nodes.dedup();
        Self { centre, nodes }
    }

    /// The same handle with the mid-edge nodes between its nodes, because they move with their edge.
    pub(crate) fn on(self, body: &Body) -> Self {
        if body.order == Order::Linear || self.nodes.len() < 2 {
            return self;
        }
        let holds = |node: u32| self.nodes.binary_search(&node).is_ok();
        let mut nodes = self.nodes.clone();
        for element in body.element_nodes() {
            let middles = EDGES.iter().zip(&element[4..]);
            let between = middles.filter(|([a, b], _)| holds(element[*a]) && holds(element[*b]));
            nodes.extend(between.map(|(_, &middle)| middle));
        }
        Self::patch(self.centre, &nodes)
    }
}

/// What the tool does to the body; its control is the displacement of the tool from rest.
#[derive(Debug, Clone, PartialEq)]
pub enum Contact {
    /// It prescribes the displacement of nodes.
    Held(Handle),
    /// It presses an elastic pad on the skin.
    Pad(Pad),
    /// It is a sphere with an elastic layer.
    Sphere(CoatedSphere),
}

impl From<Handle> for Contact {
    fn from(handle: Handle) -> Self {
        Self::Held(handle)
    }
}

impl From<Pad> for Contact {
    fn from(pad: Pad) -> Self {
        Self::Pad(pad)
    }
}

impl From<CoatedSphere> for Contact {
    fn from(sphere: CoatedSphere) -> Self {
        Self::Sphere(sphere)
    }
}

impl Contact {
    /// The prescribed nodes, if there are any.
    pub fn handle(&self) -> Option<&Handle> {
        match self {
            Self::Held(handle) => Some(handle),
            Self::Pad(_) | Self::Sphere(_) => None,
        }
    }

    /// The pad, if it is one.
    pub fn pad(&self) -> Option<&Pad> {
        match self {
            Self::Held(_) | Self::Sphere(_) => None,
            Self::Pad(pad) => Some(pad),
        }
    }
}

/// Prescribed motion of a tool relative to the body's rest state.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Pose {
    /// Displacement of the centre, m.
    pub displacement_m: [f64; 3],
    /// Rotation vector of a patch or capsule about the centre, rad; ignored for a single node.
    pub rotation_rad: [f64; 3],
}

impl Pose {
    /// A displacement without rotation.
    pub fn translation(displacement_m: [f64; 3]) -> Self {
        Self { displacement_m, rotation_rad: [0.0; 3] }
    }

    /// Interpolation from this pose (share 0) to `target` (share 1).
    pub(crate) fn towards(&self, target: &Self, share: f64) -> Self {
        let mix = |a: [f64; 3], b: [f64; 3]| std::array::from_fn(|i| a[i] + share * (b[i] - a[i]));
        Self {
            displacement_m: mix(self.displacement_m, target.displacement_m),
            rotation_rad: mix(self.rotation_rad, target.rotation_rad),
        }
    }

    /// Displacement from rest of a point at `arm_m` from the centre, m: t + (R - I) arm.
    pub(crate) fn displacement_of(&self, arm_m: &Vector3<f64>) -> Vector3<f64> {
        Vector3::from(self.displacement_m) + (self.rotation().matrix() - Matrix3::identity()) * arm_m
    }

    /// A vector after the rotation.
    pub fn turned(&self, vector: [f64; 3]) -> [f64; 3] {
        (self.rotation() * Vector3::from(vector)).into()
    }

    fn rotation(&self) -> Rotation3<f64> {
        Rotation3::from_scaled_axis(Vector3::from(self.rotation_rad))
    }
}

/// Which components of each node are prescribed, as fixed or by the handle.
pub(crate) fn prescribed(body: &Body, handle: Option<&Handle>) -> Vec<[bool; 3]> {
    let mut held = body.fixed.clone();
    for &node in handle.iter().flat_map(|h| &h.nodes) {
        held[node as usize] = [true; 3];
    }
    held
}

/// A Lagrange multiplier that prescribes one component of one node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Multiplier {
    /// The node.
    pub node: u32,
    /// The component.
    pub axis: usize,
    /// Index of the multiplier's equation.
    pub equation: u32,
}

/// Numbering of the unknowns of a body with fixed nodes and a handle.
///
/// Free nodes are ordered by nested dissection of the mesh graph. The displacement components and the
/// pressures of a node have consecutive indices, which gives the factorisation dense blocks. With elimination
/// the three prescribed components of the handle have the indices `unknowns + axis`, shared by all its
/// nodes: a translation moves all of them alike.
#[derive(Debug)]
pub(crate) struct DofMap {
    displacement: Vec<[u32; 3]>,
    pressure: Vec<u32>,
    /// Multipliers of the prescribed components; empty with elimination.
    pub(crate) multipliers: Vec<Multiplier>,
    /// Number of equations.
    pub(crate) unknowns: usize,
}

impl DofMap {
    /// Numbers the unknowns of `body`. A pressure whose elements have only prescribed nodes gets no unknown,
    /// because its row would be zero.
    pub(crate) fn new(body: &Body, handle: Option<&Handle>, constraints: Constraints) -> Self {
        let held = prescribed(body, handle);
        let keep_prescribed = constraints == Constraints::Multipliers;
        let mut has_pressure = vec![false; body.pressure_sites.len()];
        for (index, element) in body.elements.iter().enumerate() {
            let moves =
                keep_prescribed || body.nodes_of(index).iter().any(|&n| held[n as usize] != [true; 3]);
            for &pressure in element.pressures.iter().filter(|&&p| moves && p != ABSENT) {
                has_pressure[pressure as usize] = true;
            }
        }
        let mut pressures_at = vec![Vec::new(); body.nodes_m.len()];
        for (pressure, &(vertex, _)) in body.pressure_sites.iter().enumerate() {
            if has_pressure[pressure] {
                pressures_at[vertex as usize].push(pressure);
            }
        }
        let kept = |node: usize| held[node] != [true; 3] || !pressures_at[node].is_empty();
        let order: Vec<usize> = if keep_prescribed {
            let independent = body.independent();
            nested_dissection(body.nodes_m.len(), body.shape_nodes(), |node| independent[node])
        } else {
            body.elimination_order().iter().copied().filter(|&node| kept(node)).collect()
        };
        let mut dofs = Self {
            displacement: vec![[ABSENT; 3]; body.nodes_m.len()],
            pressure: vec![ABSENT; body.pressure_sites.len()],
            multipliers: Vec::new(),
            unknowns: 0,
        };
        let mut next = 0u32;
        for &node in &order {
            for axis in 0..3 {
                if keep_prescribed || !held[node][axis] {
                    dofs.displacement[node][axis] = next;
                    next += 1;
                }
            }
            for &pressure in &pressures_at[node] {
                dofs.pressure[pressure] = next;
                next += 1;
            }
            for axis in 0..3 {
                if keep_prescribed && held[node][axis] {
                    dofs.multipliers.push(Multiplier { node: node as u32, axis, equation: next });
                    next += 1;
                }
            }
        }
        dofs.unknowns = next as usize;
        if !keep_prescribed {
            let n = dofs.unknowns as u32;
            for &node in handle.iter().flat_map(|h| &h.nodes) {
                dofs.displacement[node as usize] = [n, n + 1, n + 2];
            }
        }
        dofs
    }

    /// Equation of each displacement component of `node`: `>= unknowns` if the handle prescribes it,
    /// [`ABSENT`] if it is fixed.
    #[inline]
    pub(crate) fn displacement(&self, node: u32) -> [u32; 3] {
        self.displacement[node as usize]
    }

    /// Equation of a pressure unknown, or [`ABSENT`].
    #[inline]
    pub(crate) fn pressure(&self, pressure: u32) -> u32 {
        if pressure == ABSENT { ABSENT } else { self.pressure[pressure as usize] }
    }

    /// Pairs (equation, position in the state vector) of all unknowns of the state; see [`Body`] for the
    /// state.
    pub(crate) fn state_positions(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let displacements = self.displacement.iter().enumerate().flat_map(|(node, dofs)| {
            dofs.iter().enumerate().map(move |(axis, &dof)| (dof as usize, 3 * node + axis))
        });
        let offset = 3 * self.displacement.len();
        let pressures = self.pressure.iter().enumerate().map(move |(p, &dof)| (dof as usize, offset + p));
        displacements.chain(pressures).filter(|&(dof, _)| dof < self.unknowns)
    }
}
