//! The places of the skin that the tool can touch.

use nalgebra::Vector3;
use palpate_core::Limits;

use super::error::LiveError;
use crate::fem::{Body, Capsule, CoatedSphere, Contact, Fingertip, Handle, Pad, Second, Sphere};
use crate::mesh::{Surface, TetMesh};
use crate::num::vector::{distance, norm};
use crate::pack::{PackError, Place, Untabled};
use crate::scene::ResolvedScene;
use crate::spec::{Sampling, Tool};

/// How far a tool is expected to press in a scene without a grid, m.
const REACH_M: f64 = 0.05;
/// Distance of a sphere from the body where its control is zero, m.
const CLEARANCE_M: f64 = 0.01;

/// What touches the skin.
#[derive(Debug, Clone)]
enum By {
    /// A point, which holds a node.
    Point,
    /// A fingertip at a vertex.
    Fingertip(Fingertip),
    /// A sphere or capsule, which has one contact: its control is the way of the centre from its start.
    Sphere(CoatedSphere),
}

/// The contacts of a body and the triangles between them.
#[derive(Debug, Clone)]
pub struct Skin {
    /// Vertices of the skin without a fixed component, in ascending order of their nodes.
    pub contacts: Vec<Place>,
    /// Corners of each triangle that has three contacts, counter-clockwise seen from outside.
    pub triangles: Vec<[u16; 3]>,
    /// Contacts that share a triangle with each contact, ascending.
    neighbours: Vec<Vec<u16>>,
    /// What touches it.
    touch: By,
    /// The half axis of a capsule in the frame of the grip, m.
    half_axis_m: Option<[f64; 3]>,
    /// Whether each contact is not fixed in the present model.
    is_free: Vec<bool>,
}

impl Skin {
    /// The skin of `mesh`, which is the undeformed shape of `body`.
    ///
    /// # Errors
    ///
    /// If no triangle can be touched, or more vertices than a command can name.
    pub(super) fn new(mesh: &TetMesh, body: &Body, tool: &Tool) -> Result<Self, LiveError> {
        let touch = match tool {
            Tool::Point => By::Point,
            Tool::Fingertip(tip) => By::Fingertip(*tip),
            Tool::Sphere(sphere) => return Ok(Self::of_sphere(body, *sphere, None)),
            Tool::Capsule(Capsule { sphere, half_axis_m }) => {
                return Ok(Self::of_sphere(body, *sphere, Some(*half_axis_m)));
            }
        };
        let surface = Surface::of(mesh).seen(mesh);
        let nodes: Vec<u32> =
            surface.nodes.iter().copied().filter(|&node| body.fixed[node as usize] == [false; 3]).collect();
        if nodes.len() > Limits::LIVE.spaces {
            return Err(LiveError::TooManyContacts(nodes.len()));
        }
        let contact = |node: u32| nodes.binary_search(&node).ok().map(|at| at as u16);
        let corners = |triangle: &[u32; 3]| -> Option<[u16; 3]> {
            let [a, b, c] = triangle.map(contact);
            Some([a?, b?, c?])
        };
        let triangles: Vec<[u16; 3]> = surface.triangles.iter().filter_map(corners).collect();
        if triangles.is_empty() {
            return Err(LiveError::NothingToTouch);
        }
        let mut neighbours = vec![Vec::new(); nodes.len()];
        for triangle in &triangles {
            for corner in triangle {
                neighbours[usize::from(*corner)].extend(triangle.iter().filter(|other| *other != corner));
            }
        }
        for around in &mut neighbours {
            around.sort_unstable();
            around.dedup();
        }
        let contacts = nodes
            .iter()
            .map(|&node| Place {
                node,
                rest_m: body.rest_position_m(node),
                normal: surface.normal(node).expect("a vertex of the skin"),
            })
            .collect();
        let is_free = vec![true; nodes.len()];
        Ok(Self { contacts, triangles, neighbours, touch, half_axis_m: None, is_free })
    }

    /// One contact, with the centre beside the body where the control is zero.
    fn of_sphere(body: &Body, sphere: Sphere, half_axis_m: Option<[f64; 3]>) -> Self {
        let places = (0..body.nodes_m.len() as u32).map(|node| Vector3::from(body.rest_position_m(node)));
        let (low, high) = places
            .map(|place| (place, place))
            .reduce(|(low, high), (place, _)| (low.inf(&place), high.sup(&place)))
            .expect("a body has nodes");
        let away_m = sphere.reach_m() + half_axis_m.map_or(0.0, norm) + CLEARANCE_M;
        let rest_m = [0.5 * (low.x + high.x), 0.5 * (low.y + high.y), high.z + away_m];
        let sphere = CoatedSphere::new(body, sphere.radius_m, sphere.layer, rest_m).with_wall(body);
        let sphere = sphere.turned(half_axis_m.unwrap_or_default());
        Self {
            half_axis_m,
            contacts: vec![Place { node: 0, rest_m, normal: [0.0, 0.0, 1.0] }],
            triangles: Vec::new(),
            neighbours: vec![Vec::new()],
            touch: By::Sphere(sphere),
            is_free: vec![true],
        }
    }

    /// The organ of a session as a blob without tables, and the mesh nodes of the vertices of its surface.
    pub(super) fn organ(&self, scene: &ResolvedScene, body: &Body) -> Result<(Vec<u8>, Vec<u32>), PackError> {
        let organ = Untabled {
            scene: &scene.name,
            law: &body.law_names(),
            max_force_n: scene.max_force_n,
            mesh: &scene.mesh,
            rest_m: body.rest_state.as_chunks::<3>().0,
            fixed: &scene.fixed,
            tool: &scene.tool,
            places: &self.contacts,
            triangles: &self.triangles,
            reach_m: scene.grid.as_ref().map_or(REACH_M, Sampling::radius_m),
        };
        organ.pack()
    }

    /// From now on contacts that are fixed in this body are not solved.
    pub(super) fn free_only(&mut self, body: &Body) {
        if self.sphere().is_some() {
            return;
        }
        for (is_free, contact) in self.is_free.iter_mut().zip(&self.contacts) {
            *is_free = body.fixed[contact.node as usize] == [false; 3];
        }
    }

    /// Whether a contact can be solved.
    pub fn is_free(&self, contact: u16) -> bool {
        self.is_free.get(usize::from(contact)).is_some_and(|is_free| *is_free)
    }

    /// A contact that can be solved.
    pub(super) fn first_free(&self) -> Option<u16> {
        (0..).zip(&self.is_free).find(|(_, is_free)| **is_free).map(|(contact, _)| contact)
    }

    /// The fingertip, if it is one.
    pub(super) fn tip(&self) -> Option<&Fingertip> {
        match &self.touch {
            By::Fingertip(tip) => Some(tip),
            By::Point | By::Sphere(_) => None,
        }
    }

    /// What the second control of the tool is.
    pub(super) fn second(&self) -> Second {
        if self.half_axis_m.is_some() { Second::Axis } else { Second::Partner }
    }

    /// The capsule is turned to this half axis, m.
    pub(super) fn turn(&mut self, half_m: [f64; 3]) {
        if let By::Sphere(sphere) = &mut self.touch {
            sphere.half_m = half_m;
        }
    }

    /// The sphere or capsule, if it is one.
    pub(super) fn sphere(&self) -> Option<&CoatedSphere> {
        match &self.touch {
            By::Sphere(sphere) => Some(sphere),
            By::Point | By::Fingertip(_) => None,
        }
    }

    /// Whether the tool is the same as another one.
    pub(super) fn is_touched_by(&self, tool: &Tool) -> bool {
        match (&self.touch, tool) {
            (By::Point, Tool::Point) => true,
            (By::Fingertip(tip), Tool::Fingertip(other)) => tip == other,
            (By::Sphere(sphere), _) => {
                let is_same =
                    |other: &Sphere| (sphere.radius_m, sphere.layer) == (other.radius_m, other.layer);
                tool.sphere().is_some_and(is_same) && tool.half_axis_m() == self.half_axis_m
            }
            _ => false,
        }
    }

    /// The stiffness to which jets are compared, N/m, if not that at rest: a sphere touches nothing there. That of a
    /// flat punch with its radius on an incompressible half-space of the mean shear modulus, 8 G R.
    pub(super) fn stiffness_n_m(&self, body: &Body) -> Option<f64> {
        self.sphere().map(|sphere| 8.0 * body.mean_shear_pa() * sphere.radius_m)
    }

    /// What the tool does to the body at a contact.
    pub(super) fn touch(&self, contact: u16, body: &Body) -> Contact {
        let node = self.contacts[usize::from(contact)].node;
        match &self.touch {
            By::Point => Handle::node(node).into(),
            By::Fingertip(tip) => {
                Pad::new(body, *tip, body.nodes_m[node as usize]).expect("a vertex of the skin").into()
            }
            By::Sphere(sphere) => sphere.clone().into(),
        }
    }

    /// Contacts that share a triangle with a contact.
    pub(super) fn around(&self, contact: u16) -> &[u16] {
        &self.neighbours[usize::from(contact)]
    }

    /// Contacts within a distance of a point, with their distances, nearest first.
    pub(super) fn near(&self, point_m: [f64; 3], within_m: f64, found: &mut Vec<(f64, u16)>) {
        found.clear();
        let all = self.contacts.iter().zip(0..);
        found.extend(
            all.map(|(contact, index)| (distance(contact.rest_m, point_m), index))
                .filter(|(distance_m, _)| *distance_m <= within_m),
        );
        found.sort_unstable_by(|(a, _), (b, _)| a.total_cmp(b));
    }

    /// Distance of two contacts at rest, m.
    pub(super) fn distance_m(&self, a: u16, b: u16) -> f64 {
        distance(self.contacts[usize::from(a)].rest_m, self.contacts[usize::from(b)].rest_m)
    }
}
