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
use crate::fem::sphere::wall::Wall;
use crate::fem::sphere::{Posture, Sphere};
use crate::num::jet::SymmetricThird;
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
    /// Faces with points of the fixed part, where that is a spring.
    of_wall: Arc<[u32]>,
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
        Self { radius_m, layer, start_m, half_m: [0.0; 3], points, of_wall: [].into() }
    }

    /// The same with the fixed part as a spring, which a hand can feel whole.
    #[must_use]
    pub(crate) fn with_wall(self, body: &Body) -> Self {
        let is_of_wall =
            |face: &Face| face.nodes().iter().any(|node| body.fixed[*node as usize] == [true; 3]);
        let faces = self.points.faces.iter().zip(0..);
        let of_wall = faces.filter(|(face, _)| is_of_wall(face)).map(|(_, number)| number).collect();
        Self { of_wall, ..self }
    }

    /// Radius at which the layer begins, m.
    pub(super) fn outer_m(&self) -> f64 {
        Sphere { radius_m: self.radius_m, layer: self.layer }.reach_m()
    }

    /// The corners of the faces at a state of the body, m.
    pub(super) fn corners_m(&self, body: &Body, state: &[f64]) -> impl Iterator<Item = [[f64; 3]; 3]> {
        let place = |node: u32| -> [f64; 3] {
            std::array::from_fn(|axis| body.nodes_m[node as usize][axis] + state[3 * node as usize + axis])
        };
        self.points.faces.iter().map(move |face| [0, 1, 2].map(|k| place(face.nodes[k])))
    }

    /// Those of some faces that can reach the layer, with the places of their nodes relative to the centre.
    fn near<'a>(
        &self,
        faces: impl Iterator<Item = &'a Face>,
        (body, state): (&Body, &[f64]),
        posture: &Posture,
    ) -> impl Iterator<Item = (&'a Face, [Vector3<f64>; 6])> {
        let centre = Vector3::from(self.start_m) + Vector3::from(posture.displacement_m);
        let reach = Vector3::from(posture.half_m).abs().add_scalar(self.outer_m());
        let placed = move |face: &'a Face| {
            let mut places = [Vector3::zeros(); 6];
            for (place, &node) in places.iter_mut().zip(face.nodes()) {
                let moved = Vector3::from_column_slice(&state[3 * node as usize..][..3]);
                *place = Vector3::from(body.nodes_m[node as usize]) + moved - centre;
            }
            (face, places)
        };
        faces.map(placed).filter(move |(face, places)| is_near(places, face.is_quadratic, &reach))
    }

    /// The points of a face that overlap the layer: those of the spring, or the others.
    fn touched<'a>(
        &'a self,
        (body, face, is_spring): (&'a Body, &'a Face, bool),
        places: &'a [Vector3<f64>; 6],
        half: Vector3<f64>,
    ) -> impl Iterator<Item = Overlap<'a>> {
        let all = self.points.shapes[&(face.is_quadratic, face.parts)].iter();
        let wanted = all.filter(move |values| {
            let is_of_spring = !self.of_wall.is_empty() && face.is_fixed(values, body);
            is_of_spring == is_spring
        });
        wanted.filter_map(move |values| {
            let from_centre: Vector3<f64> =
                places.iter().zip(values).map(|(place, value)| place * *value).sum();
            Overlap::of(values, from_centre, half).filter(|overlap| overlap.distance_m < self.outer_m())
        })
    }

    /// The fixed part under the tool, where it is a spring.
    fn wall(&self, body: &Body, posture: &Posture) -> Wall {
        let mut wall = Wall::default();
        let (half, outer_m) = (Vector3::from(posture.half_m), self.outer_m());
        let layer = (self.layer.thickness_m, self.layer.pressure_pa);
        let faces = self.of_wall.iter().map(|face| &self.points.faces[*face as usize]);
        for (face, places) in self.near(faces, (body, &body.rest_state), posture) {
            for point in self.touched((body, face, true), &places, half) {
                wall.add(face.area_m2, &point, half, (layer, self.radius_m, outer_m));
            }
        }
        wall.sprung(layer, outer_m)
    }

    /// phi and its first three derivatives by r, per area, at the distance r.
    fn potential(&self, r: f64) -> [f64; 4] {
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
        for (face, places) in self.near(self.points.faces.iter(), (body, state), posture) {
            let mut nodal = [Vector3::zeros(); 6];
            let (mut coupling, mut pairs) = ([Matrix3::zeros(); 6], [[Matrix3::zeros(); 6]; 6]);
            let mut turned = [Matrix3::zeros(); 6];
            for overlap in self.touched((body, face, false), &places, half) {
                let Overlap { values, distance_m, normal, share, .. } = overlap;
                let [energy, slope, curvature, _] = self.potential(distance_m);
                to.energy_j += face.area_m2 * energy;
                to.is_pierced |= distance_m < PIERCED * self.radius_m;
                let push = face.area_m2 * slope * normal;
                to.force_n -= push;
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
        self.wall(body, posture).add_to(to);
        to.torque_n_m = half.cross(&to.of_axis_n);
    }

    /// Size of the force on the fixed part, where it is a spring, N.
    pub(crate) fn wall_n(&self, body: &Body, posture: &Posture) -> f64 {
        self.wall(body, posture).norm_n()
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
        let mut sum = if moves { self.wall(body, posture).third_n_m2() } else { SymmetricThird::default() };
        let half = Vector3::from(posture.half_m);
        for (face, places) in self.near(self.points.faces.iter(), (body, state), posture) {
            let of = |axis: usize, node: u32| {
                Vector3::from_column_slice(&sensitivity[axis][3 * node as usize..][..3])
            };
            for overlap in self.touched((body, face, false), &places, half) {
                let changes: [Vector3<f64>; 3] = std::array::from_fn(|axis| {
                    let nodes = face.nodes().iter().zip(overlap.values);
                    let moved: Vector3<f64> = nodes.map(|(&node, value)| of(axis, node) * *value).sum();
                    moved - Vector3::ith(axis, own)
                });
                let [_, slope, curvature, third] = self.potential(overlap.distance_m);
                let of_point = overlap.third(&changes, [slope, curvature, third]);
                sum.iter_mut().zip(of_point).for_each(|(sum, value)| *sum += face.area_m2 * value);
            }
        }
        sum
    }
}
