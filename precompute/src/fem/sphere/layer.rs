//! The elastic layer on a sphere.
//!
//! Contact of a rigid sphere with the triangles of a skin is only piecewise smooth, and can snap at their edges. A thin
//! layer round a rigid core makes the energy smooth. With the reference area A_q and the place y_q of a point q of
//! the skin, and its distance r_q = |y_q - c|, the layer of the thickness d from R - d/3 to R + 2d/3 stores
//!
//! Phi(u, c) = sum over q of A_q (k d / 4) max(0, t_q)^4,   t = (R + 2d/3 - r) / d,   pressure k t^3 per reference area,
//!
//! whose third derivatives are continuous. The layer is compliance of the tool and not of the body: where the pressure
//! is p, t is (p / k)^(1/3). The pressure grows with the overlap, but only up to the centre: a state in which the skin is
//! within half the radius from it counts as not solved. For a live hand the fixed part is a spring ([`super::wall`]).
//!
//! The points are the centres of k^2 equal parts of each face. With n = (y - c) / |y - c|, r = |y - c|, P = I - n n^T,
//! phi = Phi / A as a function of r, and changes z of y - c:
//!
//! D phi = phi' n.z,   D2 phi = phi'' (n.z)(n.w) + phi' z.P w / r,
//! D3 phi = phi''' (n.z)(n.w)(n.v) + (phi'' - phi' / r) / r  ((n.z) w.P v + (n.w) z.P v + (n.v) z.P w).
//!
//! **A capsule** is all within R of the segment from c - a to c + a, with the half axis a. The nearest place of the segment is
//! c + s a, s = (y - c).a / |a|^2 within -1 and 1; n and r are those from it. At an end s is constant and all is as above. Between
//! the ends s follows the changes: with a' = a / |a|
//!
//! P = I - n n^T - a' a'^T.
//!
//! So D2 phi jumps by phi' a' a'^T / r where a point passes from the cylinder to an end.
//!
//! A change e of the half axis moves y - c - s a by w = -s e, and (z, e) have
//!
//! Phi_a = sum of -s phi' n,   D2 phi (z, e) = phi'' (n.z)(n.w) + phi' (z.w - (n.z)(n.w) - (z.a)(b.e) / |a|^2) / r,   b = r n - s a,
//!
//! without the last product at an end. The moment of the tool about c is a x Phi_a: a turn t of the tool changes a by t x a.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use crate::fem::body::Body;
use crate::fem::elastic::ElasticState;
use crate::fem::pad::shape_values;
use crate::fem::sphere::overlap::{Overlap, is_near};
use crate::fem::sphere::{Posture, Sphere, wall};
use crate::num::jet::{SymmetricThird, THIRD_INDICES};
use crate::num::vector::{cross, difference, distance, norm};

/// The elastic layer on a sphere.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Layer {
    /// Thickness d, m.
    pub thickness_m: f64,
    /// Pressure k where the layer is wholly compressed, Pa.
    pub pressure_pa: f64,
}

impl Layer {
    /// The layer of a sphere of this radius, m: thin against the radius, and stiff against a soft organ.
    pub fn of(radius_m: f64) -> Self {
        Self { thickness_m: f64::min(2e-3, 0.2 * radius_m), pressure_pa: 1e5 }
    }
}

/// Skin within this share of the radius from the centre is pierced: the pressure there would fill the sphere.
const PIERCED: f64 = 0.5;
/// The same of a wall, whose points do not come nearer than they lie apart.
const PIERCED_WALL: f64 = 0.25;

/// A face of the skin.
#[derive(Debug, Clone, PartialEq)]
struct Face {
    /// Its nodes; of a linear face the first three.
    nodes: [u32; 6],
    is_quadratic: bool,
    /// Reference area of a point, m^2.
    area_m2: f64,
    /// Number k of parts of an edge.
    parts: u32,
}

impl Face {
    fn nodes(&self) -> &[u32] {
        &self.nodes[..if self.is_quadratic { 6 } else { 3 }]
    }

    /// Whether a point follows fixed nodes more than others.
    fn is_fixed(&self, values: &[f64; 6], body: &Body) -> bool {
        let of =
            |(node, value): (&u32, &f64)| if body.fixed[*node as usize] == [true; 3] { *value } else { 0.0 };
        self.nodes().iter().zip(values).map(of).sum::<f64>() > 0.5
    }
}

/// The skin of a body as a sphere with a layer touches it.
#[derive(Debug, PartialEq)]
struct Points {
    faces: Vec<Face>,
    /// Values of the shape functions at the points, by order and number of parts.
    shapes: BTreeMap<(bool, u32), Vec<[f64; 6]>>,
}

/// A sphere with an elastic layer, beside a body.
#[derive(Debug, Clone, PartialEq)]
pub struct CoatedSphere {
    /// Radius R of the rigid sphere, m.
    pub radius_m: f64,
    /// The layer round it.
    pub layer: Layer,
    /// Place of the centre where the displacement is zero, m.
    pub start_m: [f64; 3],
    /// Half axis where its way to the body is asked for, m; zero of a sphere.
    pub(crate) half_m: [f64; 3],
    points: Arc<Points>,
    /// Whether the fixed part is a spring.
    has_wall: bool,
}

/// Values of the shape functions of a face at the centres of `parts`^2 parts.
fn shapes(is_quadratic: bool, parts: u32) -> Vec<[f64; 6]> {
    let nodes = if is_quadratic { 6 } else { 3 };
    let size = f64::from(parts);
    let at = |i: u32, j: u32, third: f64| {
        let (a, b) = ((f64::from(i) + third) / size, (f64::from(j) + third) / size);
        shape_values(nodes, [1.0 - a - b, a, b])
    };
    let upright = (0..parts).flat_map(|i| (0..parts - i).map(move |j| at(i, j, 1.0 / 3.0)));
    let inverse = (1..parts).flat_map(|i| (1..=parts - i).map(move |j| at(i - 1, j - 1, 2.0 / 3.0)));
    upright.chain(inverse).collect()
}

impl CoatedSphere {
    /// Against the skin of a body. Faces that are wholly fixed push back too: they are a wall behind the layer. Points
    /// are closer than half the length sqrt(2 R d) over which the layer is in touch with a plane.
    pub fn new(body: &Body, radius_m: f64, layer: Layer, start_m: [f64; 3]) -> Self {
        let spacing_m = 0.5 * (2.0 * radius_m * layer.thickness_m).sqrt();
        let mut table = BTreeMap::new();
        let face = |face: &[u32]| {
            let [a, b, c] = [0, 1, 2].map(|k| body.nodes_m[face[k] as usize]);
            let longest_m = distance(a, b).max(distance(b, c)).max(distance(c, a));
            let parts = (longest_m / spacing_m).ceil().max(1.0) as u32;
            let is_quadratic = face.len() == 6;
            table.entry((is_quadratic, parts)).or_insert_with(|| shapes(is_quadratic, parts));
            let mut nodes = [face[0]; 6];
            nodes[..face.len()].copy_from_slice(face);
            let face_m2 = 0.5 * norm(cross(difference(b, a), difference(c, a)));
            Face { nodes, is_quadratic, area_m2: face_m2 / f64::from(parts * parts), parts }
        };
        let faces = body.skin().map(face).collect();
        let points = Arc::new(Points { faces, shapes: table });
        Self { radius_m, layer, start_m, half_m: [0.0; 3], points, has_wall: false }
    }

    /// The same with the fixed part as a spring, which a hand can feel whole.
    #[must_use]
    pub(crate) fn with_wall(self) -> Self {
        Self { has_wall: true, ..self }
    }

    /// Whether a point is one of the spring.
    fn is_wall(&self, face: &Face, values: &[f64; 6], body: &Body) -> bool {
        self.has_wall && face.is_fixed(values, body)
    }

    /// Radius at which the layer begins, m.
    pub(super) fn outer_m(&self) -> f64 {
        Sphere { radius_m: self.radius_m, layer: self.layer }.reach_m()
    }

    /// The corners of the faces at rest, m.
    pub(super) fn corners_m(&self, body: &Body) -> impl Iterator<Item = [[f64; 3]; 3]> {
        self.points.faces.iter().map(|face| [0, 1, 2].map(|k| body.rest_position_m(face.nodes[k])))
    }

    /// The faces that can reach the layer, with the places of their nodes relative to the centre.
    fn near(
        &self,
        body: &Body,
        state: &[f64],
        posture: &Posture,
    ) -> impl Iterator<Item = (&Face, [Vector3<f64>; 6])> {
        let centre = Vector3::from(self.start_m) + Vector3::from(posture.displacement_m);
        let reach = Vector3::from(posture.half_m).abs().add_scalar(self.outer_m());
        let placed = move |face: &'_ Face| {
            let mut places = [Vector3::zeros(); 6];
            for (place, &node) in places.iter_mut().zip(face.nodes()) {
                let moved = Vector3::from_column_slice(&state[3 * node as usize..][..3]);
                *place = Vector3::from(body.nodes_m[node as usize]) + moved - centre;
            }
            places
        };
        let placed = self.points.faces.iter().map(move |face| (face, placed(face)));
        placed.filter(move |(face, places)| is_near(places, face.is_quadratic, &reach))
    }

    /// The points of a face that overlap the layer.
    fn touched<'a>(
        &'a self,
        face: &Face,
        places: &'a [Vector3<f64>; 6],
        half: Vector3<f64>,
    ) -> impl Iterator<Item = Overlap<'a>> {
        let all = self.points.shapes[&(face.is_quadratic, face.parts)].iter();
        all.filter_map(move |values| {
            let from_centre: Vector3<f64> =
                places.iter().zip(values).map(|(place, value)| place * *value).sum();
            Overlap::of(values, from_centre, half).filter(|overlap| overlap.distance_m < self.outer_m())
        })
    }

    /// phi and its first three derivatives by r, per area, at the distance r; against the fixed part if it `is_wall`.
    fn potential(&self, r: f64, is_wall: bool) -> [f64; 4] {
        if is_wall {
            let Layer { thickness_m, pressure_pa } = self.layer;
            return wall::potential((thickness_m, pressure_pa), self.outer_m(), r);
        }
        let (d, k) = (self.layer.thickness_m, self.layer.pressure_pa);
        let t = (self.outer_m() - r) / d;
        [0.25 * k * d * t.powi(4), -k * t.powi(3), 3.0 * k * t * t / d, -6.0 * k * t / (d * d)]
    }

    /// The derivatives of the potential at the state of a body; those of second order if `with_tangent`.
    pub(crate) fn compute(
        &self,
        body: &Body,
        state: &[f64],
        posture: &Posture,
        with_tangent: bool,
        to: &mut ElasticState,
    ) {
        to.clear();
        let half = Vector3::from(posture.half_m);
        let turns = posture.half_m != [0.0; 3];
        let mut from_outside_n = 0.0;
        for (face, places) in self.near(body, state, posture) {
            let mut nodal = [Vector3::zeros(); 6];
            let (mut coupling, mut pairs) = ([Matrix3::zeros(); 6], [[Matrix3::zeros(); 6]; 6]);
            let mut turned = [Matrix3::zeros(); 6];
            let outward = (places[1] - places[0]).cross(&(places[2] - places[0])).normalize();
            for overlap in self.touched(face, &places, half) {
                let Overlap { values, distance_m, normal, share, .. } = overlap;
                let is_wall = self.is_wall(face, values, body);
                let [energy, slope, curvature, _] = self.potential(distance_m, is_wall);
                to.energy_j += face.area_m2 * energy;
                let least = if is_wall { PIERCED_WALL } else { PIERCED };
                to.is_pierced |= distance_m < least * self.radius_m;
                let push = face.area_m2 * slope * normal;
                to.force_n -= push;
                from_outside_n += if is_wall { push.dot(&outward) } else { 0.0 };
                to.of_axis_n -= share * push;
                nodal.iter_mut().zip(values).for_each(|(sum, value)| *sum += push * *value);
                if with_tangent {
                    let block = face.area_m2 * overlap.second(curvature, slope);
                    to.own_n_m += block;
                    for (i, value) in values[..face.nodes().len()].iter().enumerate() {
                        let part = block * *value;
                        coupling[i] += part;
                        pairs[i][..=i].iter_mut().zip(values).for_each(|(sum, other)| *sum += part * *other);
                    }
                    if turns {
                        let block = face.area_m2 * overlap.turned(curvature, slope, half);
                        to.axis_n_m -= block;
                        to.of_axis_n_m += face.area_m2 * overlap.of_axis(curvature, slope, half);
                        turned.iter_mut().zip(values).for_each(|(sum, value)| *sum += block * *value);
                    }
                }
            }
            let nodes = face.nodes();
            to.nodal_n.extend(nodes.iter().copied().zip(nodal));
            if with_tangent {
                to.coupling_n_m.extend(nodes.iter().copied().zip(coupling));
                if turns {
                    to.turned_n_m.extend(nodes.iter().copied().zip(turned));
                }
                for (i, row) in pairs[..nodes.len()].iter().enumerate() {
                    to.stiffness_n_m.extend((0..=i).map(|j| ([nodes[i], nodes[j]], row[j])));
                }
            }
        }
        // The centre is behind the wall.
        to.is_pierced |= from_outside_n < 0.0;
        to.torque_n_m = half.cross(&to.of_axis_n);
    }

    /// The share of the fixed part in the forces of the layer at a state of a body; zero without a force.
    pub(crate) fn wall_share(&self, body: &Body, state: &[f64], posture: &Posture) -> f64 {
        let half = Vector3::from(posture.half_m);
        let (mut all_n, mut wall_n) = (0.0, 0.0);
        for (face, places) in self.near(body, state, posture) {
            for Overlap { values, distance_m, .. } in self.touched(face, &places, half) {
                let is_wall = self.is_wall(face, values, body);
                let push_n = -face.area_m2 * self.potential(distance_m, is_wall)[1];
                all_n += push_n;
                wall_n += if is_wall { push_n } else { 0.0 };
            }
        }
        if all_n > 0.0 { wall_n / all_n } else { 0.0 }
    }

    /// The third derivatives of the potential along the changes of the state for each axis of the displacement of a tool:
    /// of this one if it `moves`, or of another one while this one stays.
    pub(crate) fn third(
        &self,
        body: &Body,
        state: &[f64],
        (posture, moves): (&Posture, bool),
        sensitivity: &[Vec<f64>; 3],
    ) -> SymmetricThird {
        let own = if moves { 1.0 } else { 0.0 };
        let mut sum = SymmetricThird::default();
        let half = Vector3::from(posture.half_m);
        for (face, places) in self.near(body, state, posture) {
            let of = |axis: usize, node: u32| {
                Vector3::from_column_slice(&sensitivity[axis][3 * node as usize..][..3])
            };
            for Overlap { values, distance_m, normal, axis, .. } in self.touched(face, &places, half) {
                let is_wall = self.is_wall(face, values, body);
                let [_, slope, curvature, third] = self.potential(distance_m, is_wall);
                let changes: [Vector3<f64>; 3] = std::array::from_fn(|axis| {
                    let nodes = face.nodes().iter().zip(values);
                    let moved: Vector3<f64> = nodes.map(|(&node, value)| of(axis, node) * *value).sum();
                    moved - Vector3::ith(axis, own)
                });
                let along = changes.map(|change| normal.dot(&change));
                let on_axis = changes.map(|change| axis.dot(&change));
                let across = |i: usize, j: usize| {
                    changes[i].dot(&changes[j]) - along[i] * along[j] - on_axis[i] * on_axis[j]
                };
                let turn = (curvature - slope / distance_m) / distance_m;
                for (value, [i, j, k]) in sum.iter_mut().zip(THIRD_INDICES) {
                    let turned = along[i] * across(j, k) + along[j] * across(i, k) + along[k] * across(i, j);
                    *value += face.area_m2 * (third * along[i] * along[j] * along[k] + turn * turned);
                }
            }
        }
        sum
    }
}
