//! Refinement of a scene's mesh near its tool: `[mesh] refine = "tool"`.

use std::fmt;

use toml::Spanned;

use super::file::Refine;
use super::lookup::Lookup;
use super::place::positive;
use super::{ElementOrder, ResolvedScene, Scene, reach, regions, tool};
use crate::error::InputError;
use crate::fem::Fingertip;
use crate::mesh::{Near, Refined, Surface, TetMesh, mean_edge_m};
use crate::spec::is_within;

/// The refined part of the body, in radii of the pad round its centre. A mesh that is fine there has the force of
/// one that is fine everywhere.
const REACH: f64 = 2.0;
/// Largest mean edge of a tet there, in radii of the pad, by order. Quadratic elements of 0.8 radii give a force
/// within 5 %. Linear ones would need a fraction of 0.4, which is too many.
const EDGE: [f64; 2] = [0.4, 0.8];
/// Largest number of tets of a refined mesh.
pub const MAX_TETS: usize = 2_000_000;

/// Number of nodes and tets of a mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub struct MeshSize {
    /// Number of nodes.
    pub nodes: usize,
    /// Number of tets.
    pub tets: usize,
}

impl fmt::Display for MeshSize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} nodes, {} tets", grouped(self.nodes), grouped(self.tets))
    }
}

/// A number with commas between thousands.
fn grouped(number: usize) -> String {
    let digits = number.to_string();
    let head = digits.len() % 3;
    let groups = digits.as_bytes()[head..].chunks(3).map(|group| String::from_utf8_lossy(group));
    let head = (head > 0).then(|| digits[..head].into());
    head.into_iter().chain(groups).collect::<Vec<_>>().join(",")
}

impl ResolvedScene {
    /// The size of the mesh in words, and of a mesh refined near the tool also the size before.
    pub fn size_in_words(&self) -> String {
        let size = MeshSize { nodes: self.mesh.nodes_m.len(), tets: self.mesh.tets.len() };
        match self.unrefined {
            Some(before) => format!("{before}; refined near the tool: {size}"),
            None => size.to_string(),
        }
    }
}

/// The mesh of a scene.
pub(super) struct Loaded {
    pub(super) mesh: TetMesh,
    /// The fixed nodes, if they are known.
    pub(super) fixed: Option<Vec<u32>>,
    /// Size before refinement, if it is refined.
    pub(super) unrefined: Option<MeshSize>,
}

/// Reads the mesh of a scene and refines it near the tool, if the scene asks for it.
pub(super) fn load(scene: &Scene, order: ElementOrder) -> Result<Loaded, InputError> {
    refined(scene, regions::load_mesh(scene)?, order)
}

/// Refines a mesh near the tool, if the scene asks for it.
pub(super) fn refined(scene: &Scene, mesh: TetMesh, order: ElementOrder) -> Result<Loaded, InputError> {
    let Scene { place, file } = scene;
    let table = file.mesh.get_ref();
    let given_edge = &table.refine_edge_m;
    let Some(key) = &table.refine else {
        return match given_edge {
            None => Ok(Loaded { mesh, fixed: None, unrefined: None }),
            Some(edge) => {
                let what = "`refine_edge_m` has no effect without `refine`";
                Err(place.error(edge.span(), what, "add `refine = \"tool\"`, or remove it"))
            }
        };
    };
    let Refine::Tool = key.get_ref();
    let found = tool::tool(place, &mesh, file.tool.as_ref())?;
    let Some(tip) = found.fingertip() else {
        let what = "`refine` = \"tool\" needs a tool with a size: the force of a point has no limit under refinement";
        return Err(place.error(
            key.span(),
            what,
            "add [tool] with shape = \"fingertip\", or remove `refine`",
        ));
    };
    let edge_m = match given_edge {
        Some(edge) => positive(place, "refine_edge_m", edge)?,
        None => EDGE[usize::from(order != ElementOrder::Linear)] * tip.radius_m,
    };
    let size = MeshSize { nodes: mesh.nodes_m.len(), tets: mesh.tets.len() };
    let (mesh, fixed) = near_tool(scene, mesh, tip, edge_m)?.ok_or_else(|| {
        let span = given_edge.as_ref().map_or(key.span(), Spanned::span);
        let what = format!("edges of {edge_m} m near the tool need more than {} tets", grouped(MAX_TETS));
        place.error(span, what, "give a larger `refine_edge_m` in metres, or touch a smaller part")
    })?;
    Ok(Loaded { mesh, fixed: Some(fixed), unrefined: Some(size) })
}

/// The refined mesh, and its fixed nodes: those of the mesh as read, and the new ones between them, so that the
/// same part of the body is fixed. `None` if the mesh becomes too large.
fn near_tool(
    scene: &Scene,
    mut mesh: TetMesh,
    tip: &Fingertip,
    edge_m: f64,
) -> Result<Option<(TetMesh, Vec<u32>)>, InputError> {
    let mut known_fixed: Option<Vec<u32>> = None;
    // A group has new nodes after a refinement, whose surroundings can be coarse still.
    loop {
        let skin = Surface::of(&mesh);
        let seen = skin.clone().seen(&mesh);
        let lookup = Lookup {
            place: &scene.place,
            mesh: &mesh,
            skin: &skin,
            seen: &seen,
            has_file: true,
            warnings: Vec::new(),
        };
        let fixed = known_fixed.take().map_or_else(|| lookup.fixed(&scene.file.fixed), Ok)?;
        let near = Near::new(&lookup.touched_m(scene, &fixed)?, REACH * tip.radius_m);
        let is_coarse =
            |vertices_m: &[[f64; 3]; 4], _| mean_edge_m(vertices_m) > edge_m && near.reaches(vertices_m);
        let Some(finer) = Refined::locally(&mesh, MAX_TETS, is_coarse) else { return Ok(None) };
        if finer.mesh.tets.len() == mesh.tets.len() {
            return Ok(Some((mesh, fixed)));
        }
        known_fixed = Some(finer.nodes(&fixed));
        mesh = finer.mesh;
    }
}

impl Lookup<'_> {
    /// The places that the tool may touch, m: of groups, the nodes in the workspace.
    fn touched_m(&self, scene: &Scene, fixed: &[u32]) -> Result<Vec<[f64; 3]>, InputError> {
        let grid = scene.file.grid.as_ref().map(Spanned::get_ref);
        let workspace = grid.map_or(Ok(None), |table| reach::workspace(self.place, table))?;
        let mut places_m = Vec::new();
        for table in scene.file.active() {
            let name = self.name(&table)?;
            let active = self.active(&table, name.get_ref(), fixed)?;
            let at = active.iter().map(|active| active.place_m(self.mesh));
            let is_out = |place_m: &[f64; 3]| workspace.is_some_and(|box_m| !is_within(&box_m, place_m));
            places_m.extend(at.filter(|place_m| table.table.group.is_none() || !is_out(place_m)));
        }
        Ok(places_m)
    }
}
