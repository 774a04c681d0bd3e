//! The scene: body, materials, fixed nodes, active nodes and sampling.
//!
//! [`Scene::load`] reads the TOML file. [`Scene::resolve`] loads the mesh and converts names, boxes and
//! groups to node and tet indices. Both stop at the first error, with one line that names file, line and fix.
//! Unusual but solvable properties become warnings of the [`ResolvedScene`]. Unknown keys are errors, because
//! an ignored key would change the model unnoticed.

mod charts;
mod constants;
mod cover;
mod device;
mod edit;
mod file;
mod grid;
mod lookup;
mod material;
mod nodes;
mod place;
mod plausible;
mod problems;
pub(crate) mod reach;
mod refine;
mod regions;
mod resolve;
mod three;
mod tool;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::error::InputError;
use crate::fem::body::{Body, Model, Region};
use crate::fem::boundary::{Constraints, Contact};
use crate::fem::material::Material;
use crate::fem::pad::{Fingertip, PadProfile};
use crate::fem::pressure::PressurePair;
use crate::fem::solvability::PressureFault;
use crate::fem::solve::{Problem, SolveFailure, solve_body_force};
use crate::fem::sphere::{Layer, Sphere};
use crate::mesh::{BISECTIONS_A_LEVEL, MeshFault, Near, Refined, Surface, TetMesh};
pub use crate::spec::{ActiveNode, Tool};
use crate::spec::{Charts, ContactSurface, DisplacementBound, Lattice, Sampling, Scattered, Tolerance};
pub use constants::SceneConstant;
pub use cover::Cover;
pub(crate) use cover::choose as choose_contact_points;
pub use edit::{VisitedContact, VisitedPlace};
use file::SceneFile;
pub use file::SolverOptions;
use place::Place;
pub use plausible::doubt_of_size;
pub use problems::{ElementOrder, Problems, elements};
pub use reach::Unreachable;
pub use refine::{MAX_TETS, MeshSize};
use resolve::MeshSource;
pub use tool::PULP;

/// The grids of the paper: number of points, and number of cells along the radius.
pub(crate) const GRID_POINTS: [(u32, u32); 4] = [(514, 5), (1418, 7), (4168, 10), (14146, 15)];

/// A parsed scene file; the files that it names are not read yet.
#[derive(Debug)]
pub struct Scene {
    place: Place,
    file: SceneFile,
}

/// A scene with node and tet indices: the complete input of the solver.
#[derive(Debug, Clone, PartialEq)]
pub struct ResolvedScene {
    /// The scene's name.
    pub name: String,
    /// The body.
    pub mesh: TetMesh,
    /// Size of the mesh in its file, if it was refined near the tool; not known of a stored scene.
    pub unrefined: Option<MeshSize>,
    /// Order of the shape functions; mid-edge nodes are straight-sided.
    pub order: ElementOrder,
    /// Material of each region; the regions are disjoint and cover the body.
    pub materials: Vec<MaterialRegion>,
    /// Fixed nodes, ascending, unique, not empty.
    pub fixed: Vec<u32>,
    /// What touches the body.
    pub tool: Tool,
    /// Active nodes in the order of the scene; free surface nodes with unique names.
    pub active: Vec<ActiveNode>,
    /// The part of the skin that contact points are to cover; `None` once they are chosen.
    pub cover: Option<Cover>,
    /// Triangles of contact points, indices into `active`; empty if they are touched one by one.
    pub contact_triangles: Vec<[u32; 3]>,
    /// The charts of a sphere's field, one for each active node, if the scene has a grid.
    pub charts: Option<Charts>,
    /// Numbers of nodes of the scene's groups that are excluded because the tool cannot reach them.
    pub unreachable: Unreachable,
    /// The sampling of the displacements, if the scene has a `[grid]`.
    pub grid: Option<Sampling>,
    /// Force limit, N: configurations with a larger |h| are terminating. Infinite without a device.
    pub max_force_n: f64,
    /// Force per undeformed volume, N/m^3.
    pub body_force: Option<[f64; 3]>,
    /// Options of the solver.
    pub solver: SolverOptions,
    /// Whether the blob contains displacements for the display.
    pub visual: bool,
    /// Error bound of these displacements.
    pub displacement_bound: DisplacementBound,
    /// Tolerance of the error of the discretisation.
    pub discretisation: Tolerance,
    /// The scene as TOML with sorted keys and without comments, for the space and for display.
    pub text: String,
    /// Warnings about the scene, one line each.
    pub warnings: Vec<String>,
}

impl SolverOptions {
    /// The equilibrium problem of a contact with this body.
    pub fn problem(self, body: Arc<Body>, contact: Contact) -> Problem {
        let mut problem = Problem::with(body, Some(contact), self.constraints);
        problem.newton.reject_inverted = self.reject_inverted;
        problem
    }
}

/// A part of the body and its material.
#[derive(Debug, Clone, PartialEq)]
pub struct MaterialRegion {
    /// The constitutive law with its parameters.
    pub material: Material,
    /// Bulk modulus of a law with a pressure, Pa; `None` means exactly incompressible.
    pub bulk_modulus_pa: Option<f64>,
    /// Tets of the part, ascending; `None` means the whole body.
    pub tets: Option<Vec<u32>>,
}

impl Scene {
    /// Reads and parses a scene file. The files that it names are not opened.
    pub fn load(path: &Path) -> Result<Self, InputError> {
        let bytes = std::fs::read(path).map_err(|e| InputError {
            fix: "check the path of the scene file".into(),
            ..InputError::unreadable(path, &e)
        })?;
        let text = String::from_utf8(bytes).map_err(|e| {
            let line =
                1 + e.as_bytes()[..e.utf8_error().valid_up_to()].iter().filter(|&&b| b == b'\n').count();
            InputError::at(path, line, "the scene is not UTF-8 text", "save it as plain UTF-8 text")
        })?;
        Self::parse(path, text)
    }

    /// Parses a scene. Error messages name `path`; file names in the scene are relative to its folder.
    pub fn parse(path: &Path, text: String) -> Result<Self, InputError> {
        let place = Place { path: path.to_path_buf(), text };
        let file = SceneFile::parse(&place)?;
        Ok(Self { place, file })
    }

    /// Name of the scene: the key `name`, or the file's stem.
    pub fn name(&self) -> String {
        let stem = || self.place.path.file_stem().map(|stem| stem.to_string_lossy().into_owned());
        self.file.name.as_ref().map(|name| name.get_ref().clone()).or_else(stem).unwrap_or_default()
    }

    /// Path of the mesh file.
    pub(crate) fn mesh_path(&self) -> PathBuf {
        self.place.relative(self.file.mesh.get_ref().file.get_ref())
    }

    /// All files of the scene: the scene file, the mesh (two files for TetGen), the node sets of `[fixed]`
    /// and the device profile.
    pub fn files(&self) -> Vec<PathBuf> {
        let mesh = self.mesh_path();
        let is_pair =
            mesh.extension().is_some_and(|e| e.eq_ignore_ascii_case("node") || e.eq_ignore_ascii_case("ele"));
        let meshes =
            if is_pair { ["node", "ele"].map(|e| mesh.with_extension(e)).to_vec() } else { vec![mesh] };
        let sets = self.file.fixed.get_ref().file.as_ref().map(|file| self.place.relative(file.get_ref()));
        let device = self.file.device.as_ref();
        let profile =
            device.and_then(|table| device::profile_file(&self.place, table.get_ref().profile.as_ref()?));
        [self.place.path.clone()].into_iter().chain(meshes).chain(sets).chain(profile).collect()
    }

    /// Loads the mesh and converts names, boxes and groups to indices.
    pub fn resolve(&self) -> Result<ResolvedScene, InputError> {
        resolve::resolve(self, MeshSource::File)
    }

    /// Resolves the scene with a mesh in memory in place of its mesh file, which is not read.
    pub fn resolve_on(&self, mesh: TetMesh) -> Result<ResolvedScene, InputError> {
        resolve::resolve(self, MeshSource::Memory(mesh))
    }

    /// Resolves the scene with a stored mesh and its stored fixed nodes; reads no file.
    pub fn resolve_in(&self, mesh: TetMesh, fixed: Vec<u32>) -> Result<ResolvedScene, InputError> {
        resolve::resolve(self, MeshSource::Store(mesh, fixed))
    }
}

/// Why a scene defines no solvable body.
#[derive(Debug, thiserror::Error)]
pub enum BodyError {
    /// An element has no positive volume.
    #[error("{0}; reorder its vertices or mesh the body again")]
    Degenerate(MeshFault),
    /// The pressures of an incompressible part are not unique with the tool on this active node.
    #[error("with the tool on \"{0}\", {1}")]
    Pressure(String, PressureFault),
    /// The body has no equilibrium under the body force.
    #[error("the body has no equilibrium under its [body_force] ({0}); reduce the force")]
    NoRest(SolveFailure),
}

impl ResolvedScene {
    /// Builds the body of the scene, checks its pressures for every active node, and solves its rest state
    /// under the body force.
    pub fn body(&self) -> Result<Body, BodyError> {
        let body = Body::new(&self.mesh, &self.model()).map_err(BodyError::Degenerate)?;
        for active in &self.active {
            let held = active.contact.is_none().then(|| active.handle());
            body.check_pressures(held.as_ref())
                .map_err(|fault| BodyError::Pressure(active.name.clone(), fault))?;
        }
        solve_body_force(body).map_err(BodyError::NoRest)
    }

    /// The equilibrium problem of an active node's contact with the body of this scene.
    pub fn problem(&self, body: &Arc<Body>, active: &ActiveNode) -> Arc<Problem> {
        self.problems(body).of(active)
    }

    /// Name of the elements.
    pub fn elements(&self) -> &'static str {
        let has_pressure = self.materials.iter().any(|region| region.material.rest_pressure_pa().is_some());
        elements(self.order, self.solver.pressure, has_pressure)
    }

    /// The problems of all contacts with this body.
    pub fn problems(&self, body: &Arc<Body>) -> Problems {
        Problems::new(self.order, self.solver, self.tool, body)
    }

    /// Adds contact points, and the triangles between them as indices into these.
    pub(crate) fn add_contacts(&mut self, points: Vec<ActiveNode>, triangles: &[[u32; 3]]) {
        let first = self.active.len() as u32;
        self.active.extend(points);
        self.contact_triangles.extend(triangles.iter().map(|corners| corners.map(|corner| first + corner)));
    }

    /// The contact points of a tool with a size.
    pub fn contacts(&self) -> Option<ContactSurface> {
        let fingertip = *self.tool.fingertip()?;
        let points: Option<Vec<_>> = self.active.iter().map(|active| active.contact).collect();
        points.map(|points| ContactSurface { fingertip, points, triangles: self.contact_triangles.clone() })
    }

    /// The same scene on a mesh with eight times as many tets ([`Refined`]).
    #[must_use]
    pub(crate) fn refined(&self) -> Self {
        self.on(Refined::of(&self.mesh))
    }

    /// The same scene with smaller tets near places of the undeformed body: those with a part within `reach_m` of
    /// one of them are bisected until each has 1/8^levels of its volume, so 1/2^levels of its size. `None` if the
    /// mesh would have more than [`MAX_TETS`] tets.
    pub fn refined_near(&self, places_m: &[[f64; 3]], reach_m: f64, levels: u32) -> Option<Self> {
        let near = Near::new(places_m, reach_m);
        let is_coarse = |vertices_m: &[[f64; 3]; 4], bisections: u32| {
            bisections < levels * BISECTIONS_A_LEVEL && near.reaches(vertices_m)
        };
        Some(self.on(Refined::locally(&self.mesh, MAX_TETS, is_coarse)?))
    }

    /// The same scene on a finer mesh. Active nodes are the same; patches and fixed parts have the same size, and
    /// contact points the same place.
    fn on(&self, finer: Refined) -> Self {
        let mut scene = self.clone();
        scene.fixed = finer.nodes(&self.fixed);
        for region in &mut scene.materials {
            region.tets = region.tets.as_deref().map(|tets| finer.tets(tets));
        }
        let skin = Surface::of(&finer.mesh);
        for active in &mut scene.active {
            let place_m = active.place_m(&self.mesh);
            active.patch = finer.nodes(&active.patch);
            active.contact = active.contact.and_then(|_| skin.nearest(&finer.mesh, place_m));
        }
        if let Some(cover) = &mut scene.cover {
            cover.nodes = finer.nodes(&cover.nodes);
        }
        scene.mesh = finer.mesh;
        scene
    }

    /// The model of the scene, for [`Body::new`].
    pub fn model(&self) -> Model {
        let mut region_of_tet = Vec::new();
        for (index, region) in (0_u16..).zip(&self.materials) {
            for &tet in region.tets.iter().flatten() {
                region_of_tet.resize(self.mesh.tets.len(), 0);
                region_of_tet[tet as usize] = index;
            }
        }
        let region =
            |r: &MaterialRegion| Region { material: r.material.clone(), bulk_modulus_pa: r.bulk_modulus_pa };
        Model {
            order: self.order.of_nodes(),
            pressure_pair: self.solver.pressure,
            regions: self.materials.iter().map(region).collect(),
            region_of_tet,
            fixed: self.fixed.clone(),
            rollers: Vec::new(),
            body_force_n_m3: self.body_force.unwrap_or_default(),
        }
    }

    /// BLAKE3 hash of all data that affect a solution: model, active nodes, grid and force limit.
    ///
    /// It includes the names of the active nodes, because the space stores configurations under them. It
    /// excludes the scene's own name, `visual`, the bound of the packed displacements and the warnings.
    pub fn content_hash(&self) -> blake3::Hash {
        let mut digest = Digest::new("palpate scene v3");
        digest.bytes(self.model_hash().as_bytes());
        digest.count(self.active.len());
        for active in &self.active {
            digest.text(&active.name);
            digest.indices(&[active.node]);
            digest.indices(&active.patch);
            if let Some(at) = active.contact {
                digest.indices(&at.triangle);
                digest.numbers(&at.weights);
            }
            if !active.visited_m.is_empty() {
                digest.numbers(active.visited_m.as_flattened());
            }
        }
        match self.grid {
            Some(Sampling::Scattered(Scattered { radius_m, tolerance, only_push, workspace_m })) => {
                digest.numbers(&[2.0, radius_m, tolerance.relative, tolerance.absolute_n]);
                digest.count(usize::from(only_push));
                if let Some(corners) = workspace_m {
                    digest.numbers(corners.as_flattened());
                }
            }
            Some(Sampling::Lattice(Lattice { grid, complete_cells, increments })) => {
                digest.numbers(&[1.0, grid.radius_m, grid.spacing_m]);
                digest.count(usize::from(complete_cells));
                digest.count(increments.unwrap_or(0) as usize);
            }
            None => digest.numbers(&[0.0]),
        }
        digest.numbers(&[self.max_force_n]);
        digest.count(usize::from(self.solver.reject_inverted));
        digest.finish()
    }

    /// BLAKE3 hash of body and tool: mesh, order, materials, fixed nodes, body force, fingertip. Two scenes with
    /// the same model hash have the same force at the same displacement of the same node.
    pub fn model_hash(&self) -> blake3::Hash {
        let mut digest = Digest::new("palpate model v2");
        digest.bytes(&self.mesh.content_hash());
        digest.count(match self.order {
            ElementOrder::Linear => 1,
            ElementOrder::Quadratic => 2,
            ElementOrder::NearTool => 3,
        });
        digest.count(self.materials.len());
        for region in &self.materials {
            digest.text(region.material.name());
            digest.numbers(&region.material.numbers());
            digest.numbers(region.bulk_modulus_pa.as_slice());
            match &region.tets {
                Some(tets) => {
                    digest.count(1);
                    digest.indices(tets);
                }
                None => digest.count(0),
            }
        }
        digest.indices(&self.fixed);
        digest.numbers(self.body_force.as_ref().map_or(&[][..], |force| &force[..]));
        // A new key must be handled here or in `content_hash`, at its default without an effect on the hash.
        let SolverOptions { pressure, constraints, reject_inverted: _ } = self.solver;
        digest.text(match pressure {
            PressurePair::Plain => "plain",
            PressurePair::Stabilised => "stabilised",
        });
        digest.text(match constraints {
            Constraints::Elimination => "elimination",
            Constraints::Multipliers => "multipliers",
        });
        if let Some(Fingertip { radius_m, stiffness_pa_m, profile }) = self.tool.fingertip() {
            digest.text(match profile {
                PadProfile::Quartic => "quartic",
                PadProfile::Hertz => "hertz",
            });
            digest.numbers(&[*radius_m, *stiffness_pa_m]);
        }
        if let Some(Sphere { radius_m, layer: Layer { thickness_m, pressure_pa } }) = self.tool.sphere() {
            digest.text("sphere");
            digest.numbers(&[*radius_m, *thickness_m, *pressure_pa]);
        }
        if let Some(half_axis_m) = self.tool.half_axis_m() {
            digest.text("capsule");
            digest.numbers(&half_axis_m);
        }
        digest.finish()
    }
}

/// BLAKE3 hash of length-prefixed values, so that different sequences have different input bytes.
struct Digest(blake3::Hasher);

impl Digest {
    fn new(context: &str) -> Self {
        Self(blake3::Hasher::new_derive_key(context))
    }

    fn bytes(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }

    fn count(&mut self, n: usize) {
        self.bytes(&(n as u64).to_le_bytes());
    }

    fn text(&mut self, text: &str) {
        self.count(text.len());
        self.bytes(text.as_bytes());
    }

    fn numbers(&mut self, numbers: &[f64]) {
        self.count(numbers.len());
        for number in numbers {
            self.bytes(&number.to_bits().to_le_bytes());
        }
    }

    fn indices(&mut self, indices: &[u32]) {
        self.count(indices.len());
        for index in indices {
            self.bytes(&index.to_le_bytes());
        }
    }

    fn finish(self) -> blake3::Hash {
        self.0.finalize()
    }
}

#[cfg(test)]
mod tests;
