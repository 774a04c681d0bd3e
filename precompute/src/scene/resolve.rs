//! Resolution of a scene: names, boxes and groups become node and tet indices.

use std::collections::BTreeMap;
use std::ops::Range;

use palpate_core::format::SCENE_NAME_LEN;
use toml::Spanned;

use super::file::{BodyForceTable, Contact, NeedsTable};
use super::lookup::Lookup;
use super::nodes::Touchable;
use super::place::{Place, check_name, finite, positive};
use super::plausible::doubt_of_size;
use super::refine::{self, Loaded};
use super::{
    ActiveNode, ElementOrder, ResolvedScene, Scene, SolverOptions, Tool, charts::charts, device, reach, tool,
};
use crate::error::{InputError, count};
use crate::fem::pressure::PressurePair;
use crate::mesh::{Surface, TetMesh, doubtful_for_pressure, surface};
use crate::num::vector::{cross, difference, norm};
use crate::spec::{DisplacementBound, Tolerance};

/// Where the mesh of a scene comes from.
pub(super) enum MeshSource {
    /// The file that the scene names.
    File,
    /// The memory of the caller, as a file would be read.
    Memory(TetMesh),
    /// A store, with the fixed nodes: the mesh may be refined already.
    Store(TetMesh, Vec<u32>),
}

impl MeshSource {
    fn load(self, scene: &Scene, order: ElementOrder) -> Result<Loaded, InputError> {
        match self {
            Self::File => refine::load(scene, order),
            Self::Memory(mesh) => refine::refined(scene, mesh, order),
            Self::Store(mesh, fixed) => Ok(Loaded { mesh, fixed: Some(fixed), unrefined: None }),
        }
    }
}

/// Resolves a scene.
pub(super) fn resolve(scene: &Scene, source: MeshSource) -> Result<ResolvedScene, InputError> {
    let Scene { place, file } = scene;
    let name = scene.name();
    let name_span = file.name.as_ref().map_or(0..0, Spanned::span);
    check_name(place, name_span, &name, SCENE_NAME_LEN)?;
    let order = scene.order()?;
    let has_file = matches!(source, MeshSource::File);
    let Loaded { mesh, fixed: known_fixed, unrefined } = source.load(scene, order)?;
    let skin = Surface::of(&mesh);
    let seen = skin.clone().seen(&mesh);
    let mut lookup = Lookup { place, mesh: &mesh, skin: &skin, seen: &seen, has_file, warnings: Vec::new() };
    let materials = lookup.materials(scene)?;
    let doubt_of_size =
        doubt_of_size(&mesh, file.mesh.get_ref().unit.as_ref().map(|unit| unit.get_ref().as_str()));
    lookup.warnings.extend(doubt_of_size.clone());
    // A tool or a place that does not fit a body of an unlikely size is most likely right, and the unit wrong.
    let doubt = |error: InputError| match &doubt_of_size {
        Some(doubt) => InputError { fix: format!("{doubt}; otherwise {}", error.fix), ..error },
        None => error,
    };
    lookup.warn_of_moduli(&materials);
    let fixed = known_fixed.map_or_else(|| lookup.fixed(&file.fixed), Ok)?;
    let grid_table = file.grid.as_ref().map(Spanned::get_ref);
    let workspace = grid_table.map_or(Ok(None), |table| reach::workspace(place, table))?;
    let tool = tool::tool(place, &mesh, file.tool.as_ref()).map_err(doubt)?;
    let Touchable { active, cover, unreachable } =
        lookup.all_active(scene, &tool, &fixed, workspace.as_ref()).map_err(doubt)?;
    let max_force_n = device::max_force_n(place, file.device.as_ref())?;
    let charted = tool.sphere().filter(|_| file.grid.is_some() && tool.half_axis_m().is_none());
    let found = charted.map(|it| charts(&mesh, &seen, &fixed, it, (place, file.tool.as_ref())));
    let (active, charts) = found.transpose()?.map_or((active, None), |(active, it)| (active, Some(it)));
    let only_push = file.needs.contact == Contact::Push;
    let grid = file.grid.as_ref();
    let grid = grid.map(|grid| lookup.grid(grid, only_push, max_force_n, workspace)).transpose()?;
    lookup.check_visited(file.active(), grid.as_ref())?;
    if let (Some(_), Some(force), Some(table)) = (workspace, &file.body_force, grid_table) {
        let what = "a workspace refers to the undeformed mesh and cannot be combined with [body_force]";
        let span = table.workspace_min_m.as_ref().map_or(force.span(), Spanned::span);
        return Err(place.error(span, what, "remove one of the two"));
    }
    let body_force = file.body_force.as_ref().map(|table| body_force(place, table)).transpose()?;
    check_tool(scene, order, &tool)?;
    lookup.check_support(file.fixed.span(), &fixed, &active)?;
    let mut warnings = lookup.warnings;
    if materials.iter().any(|region| region.material.rest_pressure_pa().is_some()) {
        let doubts = doubtful_for_pressure(&mesh, &fixed);
        // The paper's P1/P1 pair is unstable on every mesh, so its only warning is about slivers.
        if order != ElementOrder::Linear || doubts.slivers_below_5_deg > 0 {
            warnings.extend(doubts.warning());
        }
    }
    let displacement_bound = displacement_bound(place, &file.needs)?;
    let text = place.canonical(max_force_n);
    Ok(ResolvedScene {
        name,
        mesh,
        unrefined,
        order,
        materials,
        fixed,
        tool,
        active,
        cover,
        contact_triangles: Vec::new(),
        charts,
        unreachable,
        grid,
        max_force_n,
        body_force,
        solver: solver(scene, order)?,
        visual: file.needs.visual.unwrap_or(true),
        displacement_bound,
        discretisation: discretisation(place, &file.needs)?,
        text,
        warnings,
    })
}

/// The tolerance of the error of the discretisation.
fn discretisation(place: &Place, table: &NeedsTable) -> Result<Tolerance, InputError> {
    let Some(given) = &table.discretisation else { return Ok(Tolerance::OF_MESH) };
    let relative = positive(place, "discretisation", given)?;
    if relative > 1.0 {
        let what = format!("discretisation = {relative} is more than the force itself");
        return Err(place.error(given.span(), what, "give a share such as 0.08"));
    }
    Ok(Tolerance { relative, ..Tolerance::OF_MESH })
}

/// The error bound of the packed displacements.
fn displacement_bound(place: &Place, table: &NeedsTable) -> Result<DisplacementBound, InputError> {
    let metres = |key, given: &Option<Spanned<f64>>, default| {
        let Some(mm) = given else { return Ok(default) };
        let metres = 1e-3 * positive(place, key, mm)?;
        if metres < DisplacementBound::MIN_M {
            let what = format!("{key} = {} is below the resolution of packed displacements", mm.get_ref());
            return Err(place.error(mm.span(), what, "give 0.01 or more"));
        }
        Ok(metres)
    };
    let default = DisplacementBound::default();
    Ok(DisplacementBound {
        rms_m: metres("displacement_rms_mm", &table.displacement_rms_mm, default.rms_m)?,
        max_m: metres("displacement_max_mm", &table.displacement_max_mm, default.max_m)?,
    })
}

/// Body force per volume, N/m^3, given directly or as density and gravity.
fn body_force(place: &Place, table: &Spanned<BodyForceTable>) -> Result<[f64; 3], InputError> {
    let BodyForceTable { force_n_per_m3, density_kg_m3, gravity_m_s2 } = table.get_ref();
    match (force_n_per_m3, density_kg_m3, gravity_m_s2) {
        (Some(force), None, None) => finite(place, "force_n_per_m3", force),
        (None, Some(density), Some(gravity)) => {
            let density_kg_m3 = positive(place, "density_kg_m3", density)?;
            Ok(finite(place, "gravity_m_s2", gravity)?.map(|g| density_kg_m3 * g))
        }
        _ => Err(place.error(
            table.span(),
            "[body_force] does not define one force",
            "give `force_n_per_m3`, or `density_kg_m3` and `gravity_m_s2`",
        )),
    }
}

/// The options of the solver, checked against the order of the elements.
fn solver(scene: &Scene, order: ElementOrder) -> Result<SolverOptions, InputError> {
    let Some(table) = &scene.file.solver else { return Ok(SolverOptions::default()) };
    if order != ElementOrder::Linear && table.get_ref().pressure == PressurePair::Stabilised {
        let what = "`pressure` = \"stabilised\" is for `order` = 1: the pair of order 2 is stable by itself";
        let at = scene.place.key_in(table.span(), "pressure");
        return Err(scene.place.error(at, what, "leave `pressure` out"));
    }
    Ok(*table.get_ref())
}

/// Refuses what does not go with a sphere or capsule, or with quadratic elements near the tool only.
fn check_tool(scene: &Scene, order: ElementOrder, tool: &Tool) -> Result<(), InputError> {
    if let (Some(table), Some(_)) = (&scene.file.grid, tool.half_axis_m()) {
        let what = "a capsule has no precomputed field: its force depends on how it is turned";
        return Err(scene.place.error(table.span(), what, "remove [grid], and touch it with `palpate live`"));
    }
    if let (Some(table), Some(_)) = (&scene.file.grid, tool.sphere())
        && table.get_ref().adaptive_key().is_none()
    {
        let what = "the field of a sphere has no lattice";
        let fix = "give [grid] `cannot_be_felt = true` or a tolerance in place of `spacing_m`";
        return Err(scene.place.error(table.span(), what, fix));
    }
    let Some(key) = scene.file.mesh.get_ref().order.as_ref().filter(|_| order == ElementOrder::NearTool)
    else {
        return Ok(());
    };
    let error = |what: &str, fix: &str| Err(scene.place.error(key.span(), what, fix));
    if tool.fingertip().is_none() {
        let what = "`order` = \"tool\" needs a tool with a size, which says what is near";
        return error(what, "add [tool] with shape = \"fingertip\", or use `order = 2`");
    }
    if scene.file.body_force.is_some() {
        let what = "`order` = \"tool\" cannot be combined with [body_force]: the rest state would depend on the \
                    contact point";
        return error(what, "use `order = 2`");
    }
    Ok(())
}

impl Lookup<'_> {
    /// Checks that the fixed nodes support every piece of the body; adds warnings about the mesh.
    ///
    /// Fixed nodes on one line permit a rotation about it. The tool at an active node prevents the rotation
    /// unless the node lies on the line or on another piece. In that case no equilibrium is unique, and the
    /// scene is refused.
    fn check_support(
        &mut self,
        fixed_span: Range<usize>,
        fixed: &[u32],
        active: &[ActiveNode],
    ) -> Result<(), InputError> {
        for a in active {
            let is_held = |n: u32| a.contact.is_none() && (n == a.node || a.patch.contains(&n));
            let held = |n: u32| is_held(n) || fixed.binary_search(&n).is_ok();
            // A mid-edge node is free unless both ends of its edge are prescribed, so at least one vertex
            // must be free.
            if (0..self.mesh.nodes_m.len() as u32).all(held) {
                let what =
                    format!("every node is fixed or held by active node \"{}\": nothing can deform", a.name);
                return Err(self.place.error(fixed_span, what, "fix fewer nodes"));
            }
        }
        let piece_of = surface::pieces(self.mesh);
        let mut held: BTreeMap<u32, Vec<[f64; 3]>> = BTreeMap::new();
        for &node in fixed {
            held.entry(piece_of[node as usize]).or_default().push(self.mesh.nodes_m[node as usize]);
        }
        let piece_count = piece_of.iter().max().map_or(0, |last| last + 1);
        for piece in 0..piece_count {
            let Some(points) = held.get(&piece) else {
                let lowest =
                    piece_of.iter().position(|&p| p == piece).expect("pieces are numbered from nodes");
                let size = piece_of.iter().filter(|&&p| p == piece).count();
                let what = format!(
                    "the mesh has {piece_count} separate pieces, and the one of node {lowest} ({}) has no fixed node",
                    count(size, "node")
                );
                return Err(self.place.error(
                    fixed_span,
                    what,
                    "fix nodes of it, or remove the piece from the mesh",
                ));
            };
            if on_a_line(points) {
                let turns_under = active.iter().find(|a| {
                    let handle = a.patch.iter().chain([&a.node]).filter(|n| piece_of[**n as usize] == piece);
                    let held_too = handle.map(|n| self.mesh.nodes_m[*n as usize]);
                    on_a_line(&points.iter().copied().chain(held_too).collect::<Vec<_>>())
                });
                if let Some(active) = turns_under {
                    let what = format!(
                        "the body can rotate about the line of its {}, also with the tool at active node \"{}\"",
                        count(points.len(), "fixed node"),
                        active.name
                    );
                    return Err(self.place.error(
                        fixed_span,
                        what,
                        "fix at least three nodes that are not on one line",
                    ));
                }
                self.warnings.push(format!(
                    "a piece of the body is held by {} on one line: it can rotate about the line",
                    count(points.len(), "fixed node")
                ));
            }
        }
        self.warn_of_mesh(piece_count, fixed);
        Ok(())
    }

    /// Warnings about separate pieces, rigid elements and the surface.
    fn warn_of_mesh(&mut self, piece_count: u32, fixed: &[u32]) {
        if piece_count > 1 {
            self.warnings.push(format!(
                "the mesh has {piece_count} separate pieces: a force on one does not move the others"
            ));
        }
        let all_fixed = |tet: &&[u32; 4]| tet.iter().all(|node| fixed.binary_search(node).is_ok());
        let rigid = self.mesh.tets.iter().filter(all_fixed).count();
        if rigid > 0 {
            let has = if rigid == 1 { "has" } else { "have" };
            self.warnings
                .push(format!("{} {has} all four vertices fixed and cannot deform", count(rigid, "tet")));
        }
        self.warnings.extend(self.skin.topology.warning());
    }
}

/// Whether all points lie on one line; a body that is fixed there can rotate.
fn on_a_line(points: &[[f64; 3]]) -> bool {
    let [first, rest @ ..] = points else { return true };
    let steps = || rest.iter().map(|x| difference(*x, *first));
    let Some(axis) = steps().max_by(|a, b| norm(*a).total_cmp(&norm(*b))) else { return true };
    steps().all(|step| norm(cross(axis, step)) <= 1e-9 * norm(axis).powi(2))
}
