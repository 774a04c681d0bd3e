//! What touches the body, and where.

use serde::{Deserialize, Serialize};

use crate::fem::{Body, Capsule, CoatedSphere, Contact, Fingertip, Handle, Pad, Sphere};
use crate::mesh::{SkinPoint, Surface, TetMesh};
use crate::num::vector::{dot, norm, unit};

/// What touches the body.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Tool {
    /// It holds a node, or a rigid patch of nodes. The force of a single node depends on the mesh: it goes to
    /// zero under refinement.
    Point,
    /// It presses an elastic pad on the skin.
    Fingertip(Fingertip),
    /// It is a rigid sphere without friction, which touches the skin anywhere.
    Sphere(Sphere),
    /// It is a rigid capsule without friction, which the grip turns.
    Capsule(Capsule),
}

impl Tool {
    /// The fingertip, if it is one.
    pub fn fingertip(&self) -> Option<&Fingertip> {
        match self {
            Self::Fingertip(tip) => Some(tip),
            Self::Point | Self::Sphere(_) | Self::Capsule(_) => None,
        }
    }

    /// The sphere, or that of which a capsule is made.
    pub fn sphere(&self) -> Option<&Sphere> {
        match self {
            Self::Sphere(sphere) | Self::Capsule(Capsule { sphere, .. }) => Some(sphere),
            Self::Point | Self::Fingertip(_) => None,
        }
    }

    /// The way from the centre of a capsule to one of its ends in the frame of the grip, m.
    pub fn half_axis_m(&self) -> Option<[f64; 3]> {
        match self {
            Self::Capsule(capsule) => Some(capsule.half_axis_m),
            Self::Point | Self::Fingertip(_) | Self::Sphere(_) => None,
        }
    }
}

/// An active node: a place of the skin that the tool can touch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ActiveNode {
    /// Unique name within the scene.
    pub name: String,
    /// Index of the mesh node; for a contact point the nearest corner of its triangle.
    pub node: u32,
    /// Nodes that move with the active node as a rigid patch, including itself; empty for a single node.
    pub patch: Vec<u32>,
    /// The contact point of a tool with a size; `None` for a point tool, which holds the node.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub contact: Option<SkinPoint>,
    /// Displacements that adaptive sampling solves before those that it chooses, m.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub visited_m: Vec<[f64; 3]>,
    /// Its chart, if the tool is a sphere.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub chart: Option<Chart>,
}

/// A part of a sphere's field: the displacements of the centre from a place where it touches the skin.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Chart {
    /// Place of the centre where the displacement is zero, m. The sphere touches the body there.
    pub centre_m: [f64; 3],
    /// Unit direction from the skin to the centre at the first touch, the axis of the column that the chart covers.
    pub normal: [f64; 3],
    /// The column.
    pub column: Column,
}

/// The displacements of a chart: a column along its normal, where no chart beside it is nearer. Round a rim, whose normals
/// meet in the body, it narrows with the depth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Column {
    /// Unit directions to the places of the charts beside it, and the displacements along them, m, half way there; zero for
    /// none.
    pub beside: [([f64; 3], f64); BESIDE],
    /// Radius of the part that this chart samples, m; its neighbours sample the rest.
    pub core_m: f64,
    /// Radius of the part in which its table is used, m.
    pub whole_m: f64,
    /// Largest displacement along the normal, m. Above it the sphere can only touch other parts of the skin.
    pub top_m: f64,
    /// Length of the kernel of its fits, m.
    pub length_m: f64,
}

/// Largest number of charts beside one that bound its column.
pub const BESIDE: usize = 12;

impl Column {
    /// Whether a displacement is in the column along a normal, or at most so far beyond its sides, m.
    pub(crate) fn contains(&self, normal: [f64; 3], displacement_m: [f64; 3], beyond_m: f64) -> bool {
        from_axis_m(&normal, displacement_m) <= self.core_m + beyond_m
            && self.beside.iter().all(|(to, limit_m)| dot(*to, displacement_m) <= limit_m + beyond_m)
    }

    /// Length of a ray from zero displacement in this unit direction to the end of the column, m.
    pub(crate) fn length_of_ray_m(&self, normal: [f64; 3], direction: [f64; 3]) -> f64 {
        let to = |limit_m: f64, share: f64| limit_m / share.max(f64::MIN_POSITIVE);
        let round_m =
            to(self.core_m, from_axis_m(&normal, direction)).min(to(self.top_m, dot(direction, normal)));
        let beside = self.beside.iter().filter(|(axis, _)| dot(*axis, direction) > 0.0);
        beside.map(|(axis, limit_m)| to(*limit_m, dot(*axis, direction))).fold(round_m, f64::min)
    }
}

/// Distance of a displacement from the axis of this direction, m.
pub(crate) fn from_axis_m(normal: &[f64; 3], displacement_m: [f64; 3]) -> f64 {
    let along_m = dot(displacement_m, *normal);
    norm(std::array::from_fn(|k| displacement_m[k] - along_m * normal[k]))
}

/// The charts of a sphere's field, and the surface that they cover: the places of the centre where the sphere just touches
/// the skin.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Charts {
    /// The sphere.
    pub sphere: Sphere,
    /// One for each active node.
    pub charts: Vec<Chart>,
    /// The vertices of the surface, m.
    pub places_m: Vec<[f64; 3]>,
    /// The chart of each vertex.
    pub owners: Vec<u32>,
    /// Vertices at the corners of each triangle, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

/// The contact points of a tool with a size, and the triangles between them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ContactSurface {
    /// The tool.
    pub fingertip: Fingertip,
    /// One for each active node.
    pub points: Vec<SkinPoint>,
    /// Active nodes at the corners of each triangle, counter-clockwise seen from outside. Within a triangle the
    /// energies of its corners are blended.
    pub triangles: Vec<[u32; 3]>,
}

impl ActiveNode {
    /// A single node.
    pub fn node(name: String, node: u32) -> Self {
        Self { name, node, patch: Vec::new(), contact: None, visited_m: Vec::new(), chart: None }
    }

    /// A contact point.
    pub(crate) fn at(name: String, place: SkinPoint) -> Self {
        Self { contact: Some(place), ..Self::node(name, place.nearest_node()) }
    }

    /// Contact of the tool on this body.
    ///
    /// # Panics
    ///
    /// If the pad touches nothing of the body; resolving a scene refuses such a contact point.
    pub fn on(&self, tool: &Tool, body: &Body) -> Contact {
        match (tool, &self.contact) {
            (Tool::Fingertip(tip), Some(at)) => {
                let centre_m = at.interpolate(|node| body.nodes_m[node as usize]);
                Pad::new(body, *tip, centre_m).expect("the scene was checked").into()
            }
            (
                Tool::Sphere(Sphere { radius_m, layer })
                | Tool::Capsule(Capsule { sphere: Sphere { radius_m, layer }, .. }),
                _,
            ) => {
                let start_m = self.chart.expect("an active node of a sphere has a chart").centre_m;
                CoatedSphere::new(body, *radius_m, *layer, start_m).into()
            }
            _ => self.handle().into(),
        }
    }

    /// The nodes that a point tool holds.
    pub fn handle(&self) -> Handle {
        Handle::patch(self.node, &self.patch)
    }

    /// Position on the undeformed mesh, m.
    pub fn place_m(&self, mesh: &TetMesh) -> [f64; 3] {
        self.interpolate(|node| mesh.nodes_m[node as usize])
    }

    /// Position on the body at rest, m.
    pub fn rest_position_m(&self, body: &Body) -> [f64; 3] {
        self.interpolate(|node| body.rest_position_m(node))
    }

    /// Outward unit normal of the surface there; `None` off the surface.
    pub fn normal(&self, surface: &Surface) -> Option<[f64; 3]> {
        let nodes = self.contact.map_or([self.node; 3], |at| at.triangle);
        nodes.iter().all(|&node| surface.contains(node)).then(|| {
            let sum = self.interpolate(|node| surface.normal(node).unwrap_or_default());
            if self.contact.is_some() { unit(sum) } else { sum }
        })
    }

    fn interpolate(&self, field: impl Fn(u32) -> [f64; 3]) -> [f64; 3] {
        self.contact.map_or_else(|| field(self.node), |at| at.interpolate(&field))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Round a rim a column narrows with the depth; every ray ends at its side.
    #[test]
    fn a_column_ends_half_way_to_the_charts_beside_it() {
        let normal = [0.0, 0.0, 1.0];
        let tilted = unit([1.0, 0.0, -1.0]);
        let mut beside = [([0.0; 3], 0.0); BESIDE];
        beside[0] = (tilted, 6e-3);
        let column = Column { beside, core_m: 8e-3, whole_m: 0.01, top_m: 3e-3, length_m: 0.01 };
        let width = |z: f64| {
            let at = |n: &i32| column.contains(normal, [1e-4 * f64::from(*n), 0.0, -z], 0.0);
            (0..100).filter(at).count()
        };
        let [high, low] = [1e-3, 6e-3].map(width);
        assert_eq!((high, low), (75, 25));
        assert!(column.contains(normal, [5e-3, 0.0, -6e-3], 2e-3));
        for direction in [[1.0, 0.0, 0.0], [0.6, 0.0, -0.8], [0.0, 0.8, 0.6], [-0.6, 0.0, -0.8], normal] {
            let ray_m = column.length_of_ray_m(normal, direction);
            let is_in = |share: f64| {
                let at = direction.map(|x| share * ray_m * x);
                column.contains(normal, at, 0.0) && dot(at, normal) <= column.top_m
            };
            assert!(is_in(0.999) && !is_in(1.001), "{direction:?}: {ray_m}");
        }
    }
}
