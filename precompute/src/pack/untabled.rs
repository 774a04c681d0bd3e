//! The organ of a live session: surface, contacts and their triangles, without tables of forces.

use palpate_core::format::{Preamble, SpaceHeader, SurfaceHeader};
use palpate_core::{BallLattice, flags};

use super::{PackError, PlaneArea, assemble, short_text, stated, surface};
use crate::mesh::{Surface, TetMesh};
use crate::spec::Tool;

/// A place that the tool can touch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// The mesh node.
    pub node: u32,
    /// Its position on the body at rest, m.
    pub rest_m: [f64; 3],
    /// Outward unit normal there.
    pub normal: [f64; 3],
}

/// What an organ without tables consists of.
#[derive(Debug, Clone, Copy)]
pub struct Untabled<'s> {
    /// Name of the scene.
    pub scene: &'s str,
    /// Name of the law.
    pub law: &'s str,
    /// Largest force of the device, N.
    pub max_force_n: f64,
    /// The mesh, undeformed.
    pub mesh: &'s TetMesh,
    /// Displacement of every node at rest, m.
    pub rest_m: &'s [[f64; 3]],
    /// Fixed nodes, ascending.
    pub fixed: &'s [u32],
    /// The tool.
    pub tool: &'s Tool,
    /// What it can touch.
    pub places: &'s [Place],
    /// Places at the corners of each triangle.
    pub triangles: &'s [[u16; 3]],
    /// How far the tool is expected to press, m.
    pub reach_m: f64,
}

impl Untabled<'_> {
    /// The blob, and the mesh nodes of the vertices of its surface.
    ///
    /// # Errors
    ///
    /// [`PackError`]: a name is too long, or the core refuses a number.
    pub fn pack(&self) -> Result<(Vec<u8>, Vec<u32>), PackError> {
        let mut mesh = self.mesh.clone();
        for (x, moved) in mesh.nodes_m.iter_mut().zip(self.rest_m) {
            *x = std::array::from_fn(|axis| x[axis] + moved[axis]);
        }
        let skin = Surface::of(&mesh).seen(&mesh);
        let mut planes = PlaneArea::default();
        let surface = surface(&mut planes, &skin, &mesh, self.fixed)?;
        let position =
            |axis: usize| -> Vec<f32> { self.places.iter().map(|place| place.rest_m[axis] as f32).collect() };
        let count = self.places.len();
        let triangles: Vec<[u32; 3]> = self.triangles.iter().map(|corners| corners.map(u32::from)).collect();
        let contact = SurfaceHeader {
            node: planes.push(&(0..count as u32).collect::<Vec<u32>>())?,
            position_m: planes.push3(&[position(0), position(1), position(2)])?,
            triangles: planes.push(&triangles)?,
            fixed: planes.push(&vec![0_u8; count])?,
        };
        // The smallest grid: one cell along the radius, of which only the rest point is solved.
        let reach_m = self.reach_m as f32;
        let lattice = BallLattice::new(reach_m, reach_m)
            .map_err(|error| PackError::Lattice { active: self.scene.into(), error })?;
        let mut bits = vec![0_u8; lattice.slots()];
        bits[lattice.slot([0; 3]).expect("the rest point is in the ball")] = flags::SOLVED;
        flags::derive(&lattice, &mut bits);
        let flags = planes.push(&bits)?;
        let space = |place: &Place| -> Result<SpaceHeader, PackError> {
            Ok(SpaceHeader {
                name: short_text(&format!("node {}", place.node), "an active node's name")?,
                node: place.node,
                rest_position_m: place.rest_m.map(|x| x as f32),
                outward_normal: place.normal.map(|x| x as f32),
                spacing_m: reach_m,
                radius_m: reach_m,
                flags,
                force_n: None,
                rbf_linear: None,
                rbf_cubic: None,
                hermite: None,
                displacement: None,
                kernel: None,
            })
        };
        let spaces = self.places.iter().map(space).collect::<Result<Vec<_>, PackError>>()?;
        let preamble = Preamble {
            scene: short_text(self.scene, "the scene's name")?,
            law: short_text(self.law, "the law's name")?,
            max_force_n: self.max_force_n as f32,
            mesh_hash: self.mesh.content_hash(),
            surface,
            contact,
            tool: stated(self.tool),
            certificate: None,
            space_count: count as u32,
        };
        Ok((assemble(&preamble, &spaces, &planes)?, skin.nodes))
    }
}
