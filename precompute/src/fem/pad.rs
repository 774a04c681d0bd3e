//! The elastic pad of a fingertip: springs from a rigid finger to the skin.
//!
//! A finger displaced by d from the rest position of its contact point x_c carries springs of the stiffness
//! k w(|x - x_c|) per undeformed area. With the displacement v = u - u_rest of the skin from rest, the total
//! potential of body and pad is
//!
//! Pi(u; d) = E(u) + k/2 int w |v - d|^2 dA,      W(d) = min over u of Pi.
//!
//! With M_ij = int w phi_i phi_j dA, m_i = int w phi_i dA and A = int w dA, the pad adds k M_ij v_j - k m_i d to
//! the equations of the skin and k M to their tangent. At the solution
//!
//! h = dW/dd = k (A d - m^T v),   X = du/dd = K^-1 k m,   S = k A I - k m^T X,   W_ijk = D^3 E [X_i, X_j, X_k],
//!
//! because Pi is quadratic in (u, d) but for E. No displacement is prescribed: K is positive definite where the
//! tangent of the body is, and its pattern is that of the body without a tool, because the nodes of a triangle
//! of the skin are nodes of one tetrahedron. A force at a point has no limit under refinement of the mesh; this
//! force has one.
//!
//! The integrals run over the triangles of the skin that have a point within the radius, are connected to the
//! contact point by such triangles, and are not wholly fixed. Each is divided into four by the middles of its
//! edges; each quarter has the symmetric six-point rule of degree 4 (Dunavant 1985).

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use crate::fem::body::Body;
use crate::fem::elastic::ElasticState;
use crate::mesh::nearest_on_triangle;
use crate::num::vector::{cross, difference, distance, norm};

/// Distribution of the pad's stiffness over the distance r from the contact point, a being its radius.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PadProfile {
    /// w = (1 - r^2/a^2)^2: smooth at the rim, so that the contact point may slide.
    #[default]
    Quartic,
    /// w = sqrt(1 - r^2/a^2): the pressure of a round pad by Hertz. Its slope at the rim is infinite.
    Hertz,
}

impl PadProfile {
    /// w at a distance of `r` radii.
    fn weight(self, r: f64) -> f64 {
        let inside = (1.0 - r * r).max(0.0);
        match self {
            Self::Quartic => inside * inside,
            Self::Hertz => inside.sqrt(),
        }
    }
}

/// A fingertip with an elastic pad.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Fingertip {
    /// Radius a of the pad on the undeformed skin, m.
    pub radius_m: f64,
    /// Stiffness k per area where w = 1, Pa/m.
    pub stiffness_pa_m: f64,
    /// The profile w.
    pub profile: PadProfile,
}

impl Fingertip {
    /// Stiffness k A of the springs on a plane skin, N/m: k pi a^2 / 3 for the quartic profile, twice that for
    /// Hertz.
    pub fn stiffness_on_a_plane_n_m(&self) -> f64 {
        let share = match self.profile {
            PadProfile::Quartic => 1.0 / 3.0,
            PadProfile::Hertz => 2.0 / 3.0,
        };
        share * self.stiffness_pa_m * std::f64::consts::PI * self.radius_m * self.radius_m
    }
}

/// Couples two nodes of the skin: k M_ij.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PadPair {
    /// The nodes; the first is not the smaller one.
    pub nodes: [u32; 2],
    /// k M_ij, N/m.
    pub stiffness_n_m: f64,
}

/// Couples a node of the skin to the finger.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PadNode {
    /// The node.
    pub node: u32,
    /// k m_i, N/m.
    pub stiffness_n_m: f64,
    /// k int w phi_i (x - x_c) dA, N.
    pub moment_n: [f64; 3],
}

/// A fingertip at a contact point of a body.
#[derive(Debug, Clone, PartialEq)]
pub struct Pad {
    /// The fingertip.
    pub tip: Fingertip,
    /// The contact point x_c on the undeformed skin, m.
    pub centre_m: [f64; 3],
    /// Coupled pairs, each once, in ascending order.
    pub(crate) pairs: Vec<PadPair>,
    /// Nodes under the pad, ascending.
    pub(crate) nodes: Vec<PadNode>,
    /// k A, N/m.
    pub(crate) stiffness_n_m: f64,
}

/// Weight and places of the six points of Dunavant's rule of degree 4; the two families have three points each.
const RULE: [(f64, f64); 2] = [
    (0.223_381_589_678_011_47, 0.445_948_490_915_964_9),
    (0.109_951_743_655_321_87, 0.091_576_213_509_770_74),
];

/// Barycentric coordinates and weights, of sum 1, of the 24 points of a triangle.
fn points() -> impl Iterator<Item = ([f64; 3], f64)> {
    let corner = |k: usize| -> [f64; 3] { std::array::from_fn(|i| f64::from(u8::from(i == k))) };
    let middle = |a: [f64; 3], b: [f64; 3]| -> [f64; 3] { std::array::from_fn(|i| 0.5 * (a[i] + b[i])) };
    let [a, b, c] = [0, 1, 2].map(corner);
    let [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
    let quarters = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]];
    quarters.into_iter().flat_map(|quarter| {
        RULE.into_iter().flat_map(move |(weight, side)| {
            (0..3).map(move |family| {
                let at = |k: usize| if k == family { 1.0 - 2.0 * side } else { side };
                let place = std::array::from_fn(|i| (0..3).map(|k| at(k) * quarter[k][i]).sum());
                (place, 0.25 * weight)
            })
        })
    })
}

/// Values of the shape functions of a face with three or six nodes.
pub(crate) fn shape_values(nodes: usize, [a, b, c]: [f64; 3]) -> [f64; 6] {
    if nodes == 3 {
        return [a, b, c, 0.0, 0.0, 0.0];
    }
    let corner = |l: f64| l * (2.0 * l - 1.0);
    [corner(a), corner(b), corner(c), 4.0 * a * b, 4.0 * b * c, 4.0 * c * a]
}

impl Pad {
    /// The pad at the contact point `centre_m` on the undeformed skin of `body`. `None` if no triangle of the
    /// skin that can move is within its radius.
    pub fn new(body: &Body, tip: Fingertip, centre_m: [f64; 3]) -> Option<Self> {
        let (mut pairs, mut nodes) = (BTreeMap::new(), BTreeMap::new());
        let mut area_m2 = 0.0;
        let is_free = |face: &&[u32]| face[..3].iter().any(|&node| body.fixed[node as usize] != [true; 3]);
        let (faces, _) = under(&body.nodes_m, body.skin().filter(is_free), centre_m, tip.radius_m);
        for face in faces {
            let corners = [0, 1, 2].map(|k| body.nodes_m[face[k] as usize]);
            let face_m2 =
                0.5 * norm(cross(difference(corners[1], corners[0]), difference(corners[2], corners[0])));
            for (place, share) in points() {
                let at: [f64; 3] =
                    std::array::from_fn(|axis| (0..3).map(|k| place[k] * corners[k][axis]).sum());
                let arm = difference(at, centre_m);
                let weight = share * face_m2 * tip.profile.weight(norm(arm) / tip.radius_m);
                if weight == 0.0 {
                    continue;
                }
                area_m2 += weight;
                let values = shape_values(face.len(), place);
                for (i, (&node, value)) in face.iter().zip(values).enumerate() {
                    let (load, moment): &mut (f64, [f64; 3]) = nodes.entry(node).or_default();
                    *load += weight * value;
                    for (moment, arm) in moment.iter_mut().zip(arm) {
                        *moment += weight * value * arm;
                    }
                    for (&other, other_value) in face[..=i].iter().zip(values) {
                        let pair = [node.max(other), node.min(other)];
                        *pairs.entry(pair).or_insert(0.0) += weight * value * other_value;
                    }
                }
            }
        }
        let k = tip.stiffness_pa_m;
        let node = |(node, (load, moment)): (u32, (f64, [f64; 3]))| PadNode {
            node,
            stiffness_n_m: k * load,
            moment_n: moment.map(|m| k * m),
        };
        let pair = |(nodes, mass): ([u32; 2], f64)| PadPair { nodes, stiffness_n_m: k * mass };
        (area_m2 > 0.0).then(|| Self {
            tip,
            centre_m,
            pairs: pairs.into_iter().map(pair).collect(),
            nodes: nodes.into_iter().map(node).collect(),
            stiffness_n_m: k * area_m2,
        })
    }

    /// Stiffness k A of the springs, N/m: what the hand feels of a rigid body.
    pub fn stiffness_n_m(&self) -> f64 {
        self.stiffness_n_m
    }
}

/// Of these faces of the skin, those that have a point within a distance of a point of the skin: first the
/// ones that are connected to it by each other's corners, then the rest. The first three nodes of a face are its
/// corners.
pub(crate) fn under<'f>(
    nodes_m: &[[f64; 3]],
    faces: impl Iterator<Item = &'f [u32]>,
    centre_m: [f64; 3],
    radius_m: f64,
) -> (Vec<&'f [u32]>, Vec<&'f [u32]>) {
    let away = |face: &[u32]| {
        let corners = [0, 1, 2].map(|k| nodes_m[face[k] as usize]);
        distance(nearest_on_triangle(corners, centre_m).0, centre_m)
    };
    let mut apart: Vec<(f64, &[u32])> =
        faces.map(|face| (away(face), face)).filter(|(away, _)| *away < radius_m).collect();
    let least = apart.iter().map(|(away, _)| *away).fold(f64::INFINITY, f64::min);
    // The faces that touch at the point are at the same distance, up to rounding.
    let mut corners: BTreeSet<u32> = BTreeSet::new();
    let begin = apart.iter().filter(|(away, _)| *away <= least + 1e-9 * radius_m);
    corners.extend(begin.flat_map(|(_, face)| &face[..3]));
    let mut connected = Vec::new();
    loop {
        let touches = |(_, face): &mut (f64, &[u32])| face[..3].iter().any(|node| corners.contains(node));
        let next: Vec<&[u32]> = apart.extract_if(.., touches).map(|(_, face)| face).collect();
        if next.is_empty() {
            return (connected, apart.into_iter().map(|(_, face)| face).collect());
        }
        corners.extend(next.iter().flat_map(|face| &face[..3]));
        connected.extend(next);
    }
}

impl Pad {
    /// The derivatives of the springs' energy at the state of a body with the finger displaced by `control_m`; those
    /// of second order if `with_tangent`.
    pub(crate) fn compute(
        &self,
        body: &Body,
        state: &[f64],
        control_m: [f64; 3],
        with_tangent: bool,
        to: &mut ElasticState,
    ) {
        let from_rest = |node: u32| {
            let at = 3 * node as usize;
            Vector3::from_fn(|axis, _| state[at + axis] - body.rest_state[at + axis])
        };
        let d = Vector3::from(control_m);
        to.clear();
        to.nodal_n.extend(self.nodes.iter().map(|node| (node.node, -node.stiffness_n_m * d)));
        let slot = |node: u32| self.nodes.binary_search_by_key(&node, |n| n.node).expect("a node of the pad");
        // E = k/2 (v.M v - 2 d.m^T v + A d.d)
        let mut energy_j = 0.5 * self.stiffness_n_m * d.norm_squared();
        for pair in &self.pairs {
            let [i, j] = pair.nodes;
            let (vi, vj) = (from_rest(i), from_rest(j));
            let twice = if i == j { 1.0 } else { 2.0 };
            energy_j += 0.5 * twice * pair.stiffness_n_m * vi.dot(&vj);
            to.nodal_n[slot(i)].1 += pair.stiffness_n_m * vj;
            if i != j {
                to.nodal_n[slot(j)].1 += pair.stiffness_n_m * vi;
            }
        }
        to.force_n = self.stiffness_n_m * d;
        for node in &self.nodes {
            let v = from_rest(node.node);
            to.force_n -= node.stiffness_n_m * v;
            // The springs act along d - v, so the arm may end at either end: arm x (d - v).
            to.torque_n_m += Vector3::from(node.moment_n).cross(&(d - v));
            energy_j -= node.stiffness_n_m * d.dot(&v);
        }
        to.energy_j = energy_j;
        if with_tangent {
            let spring = Matrix3::from_diagonal_element;
            to.own_n_m = spring(self.stiffness_n_m);
            to.coupling_n_m.extend(self.nodes.iter().map(|node| (node.node, spring(node.stiffness_n_m))));
            to.stiffness_n_m.extend(self.pairs.iter().map(|pair| (pair.nodes, spring(pair.stiffness_n_m))));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fem::material::{Material, NeoHookean};
    use crate::fem::{Model, Order};
    use crate::mesh::TetMesh;
    use crate::mesh::testing::nodes_where;

    fn body(mesh: &TetMesh, order: Order) -> Body {
        let lame = crate::fem::material::Lame::from_young_poisson(1e4, 0.4);
        let fixed = nodes_where(mesh, |x| x[0] == 0.0);
        let model = Model { order, ..Model::uniform(Material::NeoHookean(NeoHookean { lame }), &fixed) };
        Body::new(mesh, &model).expect("every element has volume")
    }

    fn tip(profile: PadProfile) -> Fingertip {
        Fingertip { radius_m: 0.035, stiffness_pa_m: 1e6, profile }
    }

    /// On a plane k A is known; the quadrature is that of the check against the independent implementation.
    #[test]
    fn the_stiffness_on_a_plane_is_that_of_the_profile() {
        let mesh = TetMesh::cuboid([10, 10, 2], 0.01);
        for (profile, error) in [(PadProfile::Quartic, 1e-3), (PadProfile::Hertz, 1e-2)] {
            for order in [Order::Linear, Order::Quadratic] {
                let body = body(&mesh, order);
                let pad = Pad::new(&body, tip(profile), [0.047, 0.052, 0.02]).expect("on the skin");
                let share = pad.stiffness_n_m() / pad.tip.stiffness_on_a_plane_n_m();
                assert!((share - 1.0).abs() < error, "{profile:?} {order:?}: {share}");
                // The shape functions sum to one: the loads to k A, the pairs too.
                let loads: f64 = pad.nodes.iter().map(|node| node.stiffness_n_m).sum();
                let twice = |pair: &PadPair| if pair.nodes[0] == pair.nodes[1] { 1.0 } else { 2.0 };
                let pairs: f64 = pad.pairs.iter().map(|pair| twice(pair) * pair.stiffness_n_m).sum();
                assert!((loads / pad.stiffness_n_m() - 1.0).abs() < 1e-13);
                assert!((pairs / pad.stiffness_n_m() - 1.0).abs() < 1e-13);
            }
        }
    }

    /// A rigid displacement of the finger and the skin alike stores nothing and needs no force.
    #[test]
    fn a_finger_that_moves_with_the_skin_feels_nothing() {
        let mesh = TetMesh::cuboid([6, 6, 2], 0.01);
        let body = body(&mesh, Order::Quadratic);
        let pad = Pad::new(&body, tip(PadProfile::Quartic), [0.03, 0.03, 0.02]).expect("on the skin");
        let d = [1e-3, -2e-3, 3e-3];
        let state: Vec<f64> = body.nodes_m.iter().flat_map(|_| d).collect();
        let mut found = ElasticState::default();
        pad.compute(&body, &state, d, false, &mut found);
        assert!(found.force_n.norm() < 1e-12 && found.energy_j.abs() < 1e-15, "{found:?}");
        assert!(found.nodal_n.iter().all(|(_, force)| force.norm() < 1e-12));
        pad.compute(&body, &body.rest_state, d, false, &mut found);
        let stiffness = pad.stiffness_n_m();
        assert!((found.force_n.norm() / (stiffness * norm(d)) - 1.0).abs() < 1e-13);
        assert!((found.energy_j / (0.5 * stiffness * norm(d).powi(2)) - 1.0).abs() < 1e-13);
    }

    /// A triangle of fixed nodes only has no springs, though it is within the radius.
    #[test]
    fn fixed_skin_is_not_touched() {
        let mesh = TetMesh::cuboid([6, 12, 3], 0.01);
        let body = body(&mesh, Order::Linear);
        let pad = Pad::new(&body, tip(PadProfile::Quartic), [0.012, 0.06, 0.03]).expect("on the skin");
        let at = |node: &PadNode| body.nodes_m[node.node as usize];
        assert!(pad.nodes.iter().any(|node| at(node)[0] == 0.0), "the edge of the fixed face is touched");
        assert!(pad.nodes.iter().all(|node| at(node)[2] == 0.03), "the rest of it is not");
    }

    /// The other side of a thin plate is near, but not connected within the radius.
    #[test]
    fn only_the_skin_round_the_contact_point_is_touched() {
        let mesh = TetMesh::cuboid([12, 12, 1], 0.01);
        let body = body(&mesh, Order::Linear);
        let pad = Pad::new(&body, tip(PadProfile::Quartic), [0.06, 0.06, 0.01]).expect("on the skin");
        assert!(pad.nodes.iter().all(|node| body.nodes_m[node.node as usize][2] == 0.01));
        assert!(Pad::new(&body, tip(PadProfile::Quartic), [0.06, 0.06, 0.09]).is_none(), "off the skin");
    }
}
