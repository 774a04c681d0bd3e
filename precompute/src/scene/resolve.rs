//! Looking everything up: from the words of a scene to node and tet indices.

use std::collections::BTreeMap;
use std::ops::Range;

use palpate_core::blob::format::SCENE_NAME_LEN;
use palpate_core::table::SPACE_NAME_LEN;
use toml::Spanned;

use super::file::{
    ActiveTable, BodyForceTable, FixedTable, GridTable, Located, NeedsTable, Place, SolverTable, Tables,
};
use super::{
    ActiveNode, Constraints, GRID_POINTS, GridSpec, MaterialRegion, PressurePair, ResolvedScene, Scene,
    device, material,
};
use crate::configuration_space::Scattered;
use crate::error::{InputError, count, nearest_word};
use crate::fit::DisplacementBound;
use crate::mesh::tetrahedral::{cross, distance, norm, sub};
use crate::mesh::{self, LengthUnit, Surface, TetMesh, doubtful_for_pressure, surface};
use crate::scattered::Tolerance;

/// More cells along the radius than the core's tables can number, and than anybody can solve: 8 million points.
const MOST_CELLS: f64 = palpate_core::grid::MAX_CELLS as f64;

/// `kept`: mesh and fixed nodes, if they are known already.
pub(super) fn resolve(scene: &Scene, kept: Option<(TetMesh, Vec<u32>)>) -> Result<ResolvedScene, InputError> {
    let Scene { place, file } = scene;
    let name = scene.name();
    let name_span = file.name.as_ref().map_or(0..0, Spanned::span);
    check_name(place, name_span, &name, SCENE_NAME_LEN)?;
    let order = order(scene)?;
    let (mesh, known_fixed) = match kept {
        Some((mesh, fixed)) => (mesh, Some(fixed)),
        None => (load_mesh(scene)?, None),
    };
    let skin = Surface::of(&mesh);
    let mut lookup = Lookup { place, mesh: &mesh, skin: &skin, warnings: Vec::new() };
    let materials = lookup.materials(scene)?;
    let fixed = known_fixed.map_or_else(|| lookup.fixed(&file.fixed), Ok)?;
    let active = lookup.all_active(scene, &fixed)?;
    let max_force_n = device::max_force_n(place, file.device.as_ref())?;
    let only_push = only_push(place, &file.needs)?;
    let grid = file.grid.as_ref().map(|grid| lookup.grid(grid, only_push, max_force_n)).transpose()?;
    let body_force = file.body_force.as_ref().map(|table| body_force(place, table)).transpose()?;
    let (pressure_pair, constraints) = solver(place, &file.solver, order)?;
    lookup.check_support(file.fixed.span(), &fixed, &active)?;
    let mut warnings = lookup.warnings;
    if materials.iter().any(|region| region.material.rest_pressure_pa().is_some()) {
        let doubts = doubtful_for_pressure(&mesh, &fixed);
        // The paper's P1/P1 pair is not stable on any mesh; only shapes are worth a word there.
        if order == 2 || doubts.slivers_below_5_deg > 0 {
            warnings.extend(doubts.warning());
        }
    }
    let visual = file.needs.visual;
    let displacement_bound = displacement_bound(place, &file.needs)?;
    let text = place.canonical(max_force_n);
    Ok(ResolvedScene {
        name,
        mesh,
        order,
        materials,
        fixed,
        active,
        grid,
        max_force_n,
        body_force,
        pressure_pair,
        constraints,
        reject_inverted: file.solver.reject_inverted,
        visual,
        displacement_bound,
        text,
        warnings,
    })
}

/// Whether the tool only pushes.
fn only_push(place: &Place, table: &NeedsTable) -> Result<bool, InputError> {
    match table.contact.as_ref().map(|word| (word.get_ref().as_str(), word)) {
        None | Some(("any", _)) => Ok(false),
        Some(("push", _)) => Ok(true),
        Some((other, word)) => {
            let what = format!("unknown contact \"{other}\"");
            Err(place.error(
                word.span(),
                what,
                "use \"push\", or \"any\" for a tool that also holds and pulls",
            ))
        }
    }
}

/// The bound of the packed displacements.
fn displacement_bound(place: &Place, table: &NeedsTable) -> Result<DisplacementBound, InputError> {
    let metres = |key, given: &Option<Spanned<f64>>, default| {
        let Some(mm) = given else { return Ok(default) };
        let metres = 1e-3 * positive(place, key, mm)?;
        if metres < DisplacementBound::LEAST_M {
            let what = format!("{key} = {} is finer than displacements are packed", mm.get_ref());
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

/// Force per volume, given as such or as weight.
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
            "[body_force] does not say one force",
            "give `force_n_per_m3`, or `density_kg_m3` and `gravity_m_s2`",
        )),
    }
}

fn solver(place: &Place, table: &SolverTable, order: u8) -> Result<(PressurePair, Constraints), InputError> {
    let pair = match table.pressure.as_ref().map(|word| (word.get_ref().as_str(), word)) {
        None | Some(("plain", _)) => PressurePair::Plain,
        Some(("stabilised", word)) if order == 2 => {
            let what =
                "`pressure` = \"stabilised\" is for `order` = 1: the pair of order 2 is stable by itself";
            return Err(place.error(word.span(), what, "leave `pressure` out"));
        }
        Some(("stabilised", _)) => PressurePair::Stabilised,
        Some((other, word)) => {
            let what = format!("unknown pressure field \"{other}\"");
            return Err(place.error(word.span(), what, "use \"plain\" or \"stabilised\""));
        }
    };
    let constraints = match table.constraints.as_ref().map(|word| (word.get_ref().as_str(), word)) {
        None | Some(("elimination", _)) => Constraints::Elimination,
        Some(("multipliers", _)) => Constraints::Multipliers,
        Some((other, word)) => {
            let what = format!("unknown kind of constraints \"{other}\"");
            return Err(place.error(word.span(), what, "use \"elimination\" or \"multipliers\""));
        }
    };
    Ok((pair, constraints))
}

fn load_mesh(scene: &Scene) -> Result<TetMesh, InputError> {
    let place = &scene.place;
    let table = scene.file.mesh.get_ref();
    let unit = match &table.unit {
        None => LengthUnit::Metre,
        Some(word) => LengthUnit::from_name(word.get_ref()).ok_or_else(|| {
            place.error(
                word.span(),
                format!("unknown unit \"{}\"", word.get_ref()),
                "use \"m\", \"cm\" or \"mm\"",
            )
        })?,
    };
    let path = scene.mesh_path();
    // A file that is not there is a slip of the scene; a file that cannot be understood is the mesh's own.
    if let Err(error) = std::fs::File::open(&path) {
        let what = format!("cannot open the mesh {} ({error})", path.display());
        return Err(place.error(
            table.file.span(),
            what,
            "correct `file` (it is relative to the scene file)",
        ));
    }
    mesh::read(&path, unit)
}

fn order(scene: &Scene) -> Result<u8, InputError> {
    let Some(order) = &scene.file.mesh.get_ref().order else { return Ok(1) };
    u8::try_from(*order.get_ref()).ok().filter(|order| (1..=2).contains(order)).ok_or_else(|| {
        scene.place.error(
            order.span(),
            format!("`order` = {} is neither 1 nor 2", order.get_ref()),
            "use `order = 1` or `order = 2`",
        )
    })
}

struct Lookup<'a> {
    place: &'a Place,
    mesh: &'a TetMesh,
    skin: &'a Surface,
    warnings: Vec<String>,
}

impl Lookup<'_> {
    fn materials(&mut self, scene: &Scene) -> Result<Vec<MaterialRegion>, InputError> {
        let tables = scene.file.material.tables();
        let mut owner: Vec<Option<usize>> = vec![None; self.mesh.tets.len()];
        let mut regions = Vec::new();
        for (index, table) in tables.iter().enumerate() {
            let (law, bulk_modulus_pa) = material::law(self.place, table, &mut self.warnings)?;
            let tets = match &table.table.group {
                Some(group) => Some(self.group(&self.mesh.tet_groups, "volumes", group)?.to_vec()),
                None if tables.len() > 1 => {
                    let what = "one of several [[material]] tables has no `group`";
                    return Err(self.place.error(table.span.clone(), what, "name the group of each region"));
                }
                None => None,
            };
            for &tet in tets.iter().flatten() {
                if owner[tet as usize].replace(index).is_some() {
                    let what =
                        format!("tet {tet} (0-based) already has a material from another [[material]]");
                    return Err(self.place.error(
                        table.span.clone(),
                        what,
                        "let the groups share no element",
                    ));
                }
            }
            regions.push(MaterialRegion { material: law, bulk_modulus_pa, tets });
        }
        let Some(last) = tables.last() else {
            return Err(self.place.error(
                scene.file.material.span(),
                "[[material]] is empty",
                "add a [material]",
            ));
        };
        let bare = owner.iter().filter(|owner| owner.is_none()).count();
        if regions.iter().all(|region| region.tets.is_some()) && bare > 0 {
            let what = format!("{} of the mesh in no material's group", count(bare, "tet"));
            return Err(self.place.error(last.span.clone(), what, "add a [[material]] for the rest"));
        }
        Ok(regions)
    }

    /// Members of a named group, with what there is in the error.
    fn group<'g>(
        &self,
        groups: &'g BTreeMap<String, Vec<u32>>,
        of: &str,
        name: &Spanned<String>,
    ) -> Result<&'g [u32], InputError> {
        if let Some(members) = groups.get(name.get_ref()) {
            return Ok(members);
        }
        let known: Vec<&str> = groups.keys().map(String::as_str).collect();
        let mend = match nearest_word(name.get_ref(), known.iter().copied()) {
            _ if known.is_empty() => "the mesh has none: add a physical group in the mesh generator".into(),
            Some(guess) => format!("did you mean \"{guess}\"? (groups: {})", known.join(", ")),
            None => format!("use one of: {}", known.join(", ")),
        };
        let what = format!("the mesh has no group of {of} named \"{}\"", name.get_ref());
        Err(self.place.error(name.span(), what, mend))
    }

    fn node(&self, node: &Spanned<i64>) -> Result<u32, InputError> {
        let n = self.mesh.nodes_m.len();
        u32::try_from(*node.get_ref()).ok().filter(|&node| (node as usize) < n).ok_or_else(|| {
            let what = format!("node {} is out of range: the mesh has {}", node.get_ref(), count(n, "node"));
            let mend = format!("use 0 to {} (0-based, in file order)", n - 1);
            self.place.error(node.span(), what, mend)
        })
    }

    fn fixed(&self, table: &Spanned<FixedTable>) -> Result<Vec<u32>, InputError> {
        let FixedTable { nodes, group, in_box, file, key } = table.get_ref();
        let ways = "`nodes`, `group`, `box`, or `file` with `key`";
        let given = [nodes.is_some(), group.is_some(), in_box.is_some(), file.is_some() || key.is_some()];
        match given.iter().filter(|&&given| given).count() {
            0 => {
                let what = "[fixed] does not say which nodes";
                return Err(self.place.error(table.span(), what, format!("give one of {ways}")));
            }
            1 => {}
            _ => {
                let what = "[fixed] says which nodes in several ways";
                return Err(self.place.error(table.span(), what, format!("keep one of {ways}")));
            }
        }
        let (span, mut fixed) = if let Some(nodes) = nodes {
            (nodes.span(), nodes.get_ref().iter().map(|node| self.node(node)).collect::<Result<Vec<_>, _>>()?)
        } else if let Some(group) = group {
            (group.span(), self.group(&self.mesh.node_groups, "nodes", group)?.to_vec())
        } else if let Some(in_box) = in_box {
            let (min, max) = (in_box.get_ref().min, in_box.get_ref().max);
            // Written so that a NaN corner is refused too.
            if !(0..3).all(|axis| min[axis] <= max[axis]) {
                let what = format!("the box is empty: min {min:?} is not below max {max:?}");
                return Err(self.place.error(in_box.span(), what, "swap the corners (metres)"));
            }
            let inside = |x: &[f64; 3]| (0..3).all(|axis| (min[axis]..=max[axis]).contains(&x[axis]));
            let nodes = (0u32..).zip(&self.mesh.nodes_m).filter(|(_, x)| inside(x)).map(|(node, _)| node);
            (in_box.span(), nodes.collect())
        } else {
            let (Some(file), Some(key)) = (file, key) else {
                let what = "[fixed] needs both `file` and `key`";
                return Err(self.place.error(table.span(), what, "add the other of the two"));
            };
            (key.span(), self.fixed_from_json(file, key)?)
        };
        fixed.sort_unstable();
        fixed.dedup();
        if fixed.is_empty() {
            let mut mend = "select at least three nodes".to_owned();
            if in_box.is_some() {
                let (low, high) = self.mesh.bounding_box_m();
                mend = format!("the body spans {low:?} to {high:?} in metres: enlarge or move the box");
            }
            return Err(self.place.error(span, "the fixed set is empty", mend));
        }
        Ok(fixed)
    }

    /// A JSON object of named index lists.
    fn fixed_from_json(&self, file: &Spanned<String>, key: &Spanned<String>) -> Result<Vec<u32>, InputError> {
        let path = self.place.relative(file.get_ref());
        let bytes = std::fs::read(&path).map_err(|error| {
            let what = format!("cannot read the sets {} ({error})", path.display());
            self.place.error(file.span(), what, "correct `file` (it is relative to the scene file)")
        })?;
        let json: serde_json::Value = serde_json::from_slice(&bytes).map_err(|e| {
            InputError::at(&path, e.line().max(1), format!("not valid JSON ({e})"), "correct the syntax")
        })?;
        let Some(object) = json.as_object() else {
            let what = "the file is not a JSON object of named node lists";
            return Err(InputError::at(&path, 1, what, "write {\"F1\": [0, 1, 2]}"));
        };
        let Some(list) = object.get(key.get_ref()).and_then(serde_json::Value::as_array) else {
            let lists: Vec<&str> =
                object.iter().filter(|(_, v)| v.is_array()).map(|(k, _)| k.as_str()).collect();
            let what = format!("{} has no list named \"{}\"", path.display(), key.get_ref());
            return Err(self.place.error(key.span(), what, format!("use one of: {}", lists.join(", "))));
        };
        let n = self.mesh.nodes_m.len();
        list.iter()
            .enumerate()
            .map(|(at, value)| {
                let node = value
                    .as_u64()
                    .and_then(|node| u32::try_from(node).ok())
                    .filter(|&node| (node as usize) < n);
                node.ok_or_else(|| {
                    let what =
                        format!("entry {at} of \"{}\" ({value}) is not a node of the mesh", key.get_ref());
                    InputError::new(&path, what, format!("use 0 to {} (0-based, in file order)", n - 1))
                })
            })
            .collect()
    }

    fn all_active(&mut self, scene: &Scene, fixed: &[u32]) -> Result<Vec<ActiveNode>, InputError> {
        let tables = scene.file.active.tables();
        if tables.is_empty() {
            let what = "the scene has no active node";
            return Err(self.place.error(scene.file.active.span(), what, "add an [[active]] table"));
        }
        let mut all: Vec<ActiveNode> = Vec::new();
        for table in &tables {
            let name_span = table.table.name.span();
            for active in self.active(table, fixed)? {
                check_name(self.place, name_span.clone(), &active.name, SPACE_NAME_LEN)?;
                if all.iter().any(|other| other.name == active.name) {
                    let what = format!("two active nodes are named \"{}\"", active.name);
                    return Err(self.place.error(name_span, what, "give each its own name"));
                }
                if let Some(other) = all.iter().find(|other| other.node == active.node) {
                    let (a, b, node) = (&other.name, &active.name, active.node);
                    self.warnings
                        .push(format!("active nodes \"{a}\" and \"{b}\" are both node {node}: solved twice"));
                }
                all.push(active);
            }
        }
        Ok(all)
    }

    fn active(&self, at: &Located<'_, ActiveTable>, fixed: &[u32]) -> Result<Vec<ActiveNode>, InputError> {
        let name = at.table.name.get_ref();
        if let (Some(group), true) =
            (&at.table.group, at.table.patch.is_some() || at.table.patch_radius_m.is_some())
        {
            let what = "a patch needs one node to turn about, not a `group`";
            return Err(self.place.error(group.span(), what, "give `node` or `nearest` with the patch"));
        }
        match (&at.table.node, &at.table.nearest, &at.table.group) {
            (Some(index), None, None) => {
                let node = self.node(index)?;
                self.touchable(index.span(), node, name, fixed)?;
                Ok(vec![self.handle(at.table, name, node, fixed)?])
            }
            (None, Some(point), None) => {
                let node = self.nearest(point)?;
                self.touchable(point.span(), node, name, fixed)?;
                Ok(vec![self.handle(at.table, name, node, fixed)?])
            }
            (None, None, Some(group)) => {
                let members = self.group(&self.mesh.node_groups, "nodes", group)?;
                let free = |node: &&u32| self.skin.contains(**node) && fixed.binary_search(node).is_err();
                let nodes: Vec<u32> = members.iter().filter(free).copied().collect();
                if nodes.is_empty() {
                    let what = format!("group \"{}\" has no free surface node", group.get_ref());
                    return Err(self.place.error(
                        group.span(),
                        what,
                        "choose a group on the surface that is not fixed",
                    ));
                }
                Ok(nodes
                    .into_iter()
                    .map(|node| ActiveNode { name: format!("{name}-{node}"), node, patch: Vec::new() })
                    .collect())
            }
            (None, None, None) => {
                let what = format!("active node \"{name}\" does not say where it is");
                Err(self.place.error(at.span.clone(), what, "give `node`, `nearest` or `group`"))
            }
            _ => {
                let what = format!("active node \"{name}\" says in several ways where it is");
                Err(self.place.error(at.span.clone(), what, "keep one of `node`, `nearest` and `group`"))
            }
        }
    }

    /// The active node with the patch of nodes that moves with it.
    fn handle(
        &self,
        table: &ActiveTable,
        name: &str,
        node: u32,
        fixed: &[u32],
    ) -> Result<ActiveNode, InputError> {
        let (span, mut patch) = match (&table.patch, &table.patch_radius_m) {
            (None, None) => return Ok(ActiveNode { name: name.into(), node, patch: Vec::new() }),
            (Some(patch), Some(_)) => {
                let what = "both `patch` and `patch_radius_m` are given";
                return Err(self.place.error(patch.span(), what, "keep one of the two"));
            }
            (Some(patch), None) => {
                let nodes = patch.get_ref().iter().map(|n| self.node(n)).collect::<Result<Vec<_>, _>>()?;
                (patch.span(), nodes)
            }
            (None, Some(radius)) => {
                let radius_m = positive(self.place, "patch_radius_m", radius)?;
                let centre = self.mesh.nodes_m[node as usize];
                let near = |n: &&u32| distance(&self.mesh.nodes_m[**n as usize], &centre) <= radius_m;
                (radius.span(), self.skin.nodes.iter().filter(near).copied().collect())
            }
        };
        patch.push(node);
        patch.sort_unstable();
        patch.dedup();
        for &member in &patch {
            self.touchable(span.clone(), member, name, fixed)?;
        }
        Ok(ActiveNode { name: name.into(), node, patch })
    }

    /// The surface node nearest to a point in metres; the lowest index of equally near ones.
    fn nearest(&self, point: &Spanned<[f64; 3]>) -> Result<u32, InputError> {
        let target = finite(self.place, "nearest", point)?;
        let away = |node: u32| distance(&self.mesh.nodes_m[node as usize], &target);
        let nearest = self.skin.nodes.iter().copied().min_by(|&a, &b| away(a).total_cmp(&away(b)));
        let node = nearest.expect("a mesh with a tet has a surface");
        let size = self.mesh.diagonal_m();
        if away(node) > size {
            let what =
                format!("`nearest` lies {:.3} m from the body, which is {size:.3} m across", away(node));
            return Err(self.place.error(
                point.span(),
                what,
                "give the point in metres, in the mesh's frame",
            ));
        }
        Ok(node)
    }

    fn touchable(&self, span: Range<usize>, node: u32, name: &str, fixed: &[u32]) -> Result<(), InputError> {
        if fixed.binary_search(&node).is_ok() {
            let what = format!("active node \"{name}\" (node {node}) is in the fixed set");
            return Err(self.place.error(span, what, "choose a free node, or take it out of [fixed]"));
        }
        if !self.skin.contains(node) {
            let what =
                format!("active node \"{name}\" (node {node}) is inside the body, where no tool touches it");
            let x = self.mesh.nodes_m[node as usize];
            return Err(self.place.error(
                span,
                what,
                format!("choose a surface node, for example with `nearest` = {x:?}"),
            ));
        }
        Ok(())
    }

    fn grid(
        &mut self,
        grid: &Spanned<GridTable>,
        only_push: bool,
        max_force_n: f64,
    ) -> Result<GridSpec, InputError> {
        let table = grid.get_ref();
        let radius_m = positive(self.place, "radius_m", &table.radius_m)?;
        let size = self.mesh.diagonal_m();
        if radius_m > size {
            self.warnings
                .push(format!("the grid's radius {radius_m} m is larger than the body, {size:.3} m across"));
        }
        if let Some(tolerance) = self.tolerance(table)? {
            if !max_force_n.is_finite() {
                let what = "sampling driven by the error needs the largest force of the device";
                return Err(self.place.error(
                    grid.span(),
                    what,
                    "add [device] with `max_force_n` or `profile`",
                ));
            }
            return Ok(GridSpec::Scattered(Scattered { radius_m, tolerance, only_push }));
        }
        let spacing_m = match (&table.spacing_m, &table.points) {
            (Some(spacing), None) => {
                let spacing_m = positive(self.place, "spacing_m", spacing)?;
                if spacing_m > radius_m {
                    let what = format!(
                        "`spacing_m` = {spacing_m} is larger than `radius_m` = {radius_m}: no grid point"
                    );
                    return Err(self.place.error(
                        spacing.span(),
                        what,
                        "give a spacing of a fifth of the radius or so",
                    ));
                }
                if radius_m / spacing_m > MOST_CELLS {
                    let what =
                        format!("`spacing_m` = {spacing_m} puts over {MOST_CELLS} cells along the radius");
                    return Err(self.place.error(
                        spacing.span(),
                        what,
                        "give the spacing in metres, and a coarser one",
                    ));
                }
                spacing_m
            }
            (None, Some(points)) => {
                let known = GRID_POINTS.iter().find(|(n, _)| i64::from(*n) == *points.get_ref());
                let Some((_, cells)) = known else {
                    let what = format!("`points` = {} is no grid of the paper", points.get_ref());
                    return Err(self.place.error(
                        points.span(),
                        what,
                        "use 514, 1418, 4168 or 14146, or `spacing_m`",
                    ));
                };
                radius_m / f64::from(*cells)
            }
            (Some(_), Some(points)) => {
                let what = "[grid] has both `spacing_m` and `points`";
                return Err(self.place.error(points.span(), what, "keep one of the two"));
            }
            (None, None) => {
                let what = "[grid] does not say how fine it is";
                return Err(self.place.error(grid.span(), what, "give `spacing_m` or `points`"));
            }
        };
        let increments = match &table.increments {
            None => None,
            Some(n) if (2..=100).contains(n.get_ref()) => Some(*n.get_ref() as u32),
            Some(n) => {
                let what = format!("`increments` = {} is not from 2 to 100", n.get_ref());
                return Err(self.place.error(
                    n.span(),
                    what,
                    "5 is the paper's; leave it out to keep no states",
                ));
            }
        };
        let complete_cells = table.complete_cells.unwrap_or(true);
        Ok(GridSpec::Lattice { radius_m, spacing_m, complete_cells, increments })
    }

    /// What an error may be, if sampling is driven by it.
    fn tolerance(&self, table: &GridTable) -> Result<Option<Tolerance>, InputError> {
        let GridTable { tolerance_n, tolerance_relative, cannot_be_felt, .. } = table;
        let felt = cannot_be_felt.as_ref().filter(|felt| *felt.get_ref());
        let Some((span, key)) = table.error_driven() else { return Ok(None) };
        let lattice = [
            table.spacing_m.as_ref().map(|v| (v.span(), "spacing_m")),
            table.points.as_ref().map(|v| (v.span(), "points")),
            table.increments.as_ref().map(|v| (v.span(), "increments")),
        ];
        if let Some((span, other)) = lattice.into_iter().flatten().next() {
            let what = format!("[grid] has both `{other}` and `{key}`");
            let mend = format!("keep `{other}` for a lattice, or `{key}` for as few positions as it takes");
            return Err(self.place.error(span, what, mend));
        }
        let other = tolerance_n.as_ref().or(tolerance_relative.as_ref());
        match (felt, other) {
            (Some(_), None) => Ok(Some(Tolerance::CANNOT_BE_FELT)),
            (Some(felt), Some(_)) => {
                let what = "`cannot_be_felt` is a tolerance of its own";
                Err(self.place.error(felt.span(), what, "keep it, or `tolerance_n` and `tolerance_relative`"))
            }
            (None, None) => {
                let what = format!("`{key}` = false says nothing");
                Err(self.place.error(span, what, "say true, or give `spacing_m`, `points` or a tolerance"))
            }
            (None, Some(_)) => {
                let given = |key, value: &Option<Spanned<f64>>| {
                    value.as_ref().map_or(Ok(0.0), |value| positive(self.place, key, value))
                };
                let relative = given("tolerance_relative", tolerance_relative)?;
                Ok(Some(Tolerance { relative, absolute_n: given("tolerance_n", tolerance_n)? }))
            }
        }
    }

    /// Whether the fixed nodes hold every piece of the body, and what of the mesh is odd.
    ///
    /// A tool that holds an active node stops the body from turning about a line of fixed nodes, unless the node is
    /// on that line or on another piece: then no equilibrium is unique, and the scene is refused.
    fn check_support(
        &mut self,
        fixed_span: Range<usize>,
        fixed: &[u32],
        active: &[ActiveNode],
    ) -> Result<(), InputError> {
        for a in active {
            let held = |n: u32| n == a.node || a.patch.contains(&n) || fixed.binary_search(&n).is_ok();
            // A mid-edge node is free unless both ends of its edge are held alike: one free vertex is needed either way.
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
                        "the {} on one line do not hold the body, and holding active node \"{}\" does not stop the body from turning about it",
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
                    "a piece of the body is held by {} on one line: it can turn about it",
                    count(points.len(), "fixed node")
                ));
            }
        }
        if piece_count > 1 {
            self.warnings.push(format!(
                "the mesh has {piece_count} separate pieces: touching one never moves another"
            ));
        }
        let all_fixed = |tet: &&[u32; 4]| tet.iter().all(|node| fixed.binary_search(node).is_ok());
        let rigid = self.mesh.tets.iter().filter(all_fixed).count();
        if rigid > 0 {
            let has = if rigid == 1 { "has" } else { "have" };
            self.warnings
                .push(format!("{} {has} all four vertices fixed and cannot deform", count(rigid, "tet")));
        }
        let topology = self.skin.topology;
        if !topology.is_manifold() {
            self.warnings.push(format!(
                "the surface is not a closed manifold ({}, {}, {}): parts may hinge or overlap",
                count(topology.non_manifold_edges, "bad edge"),
                count(topology.non_manifold_nodes, "bad node"),
                count(topology.overlapping_faces, "overlapping face")
            ));
        }
        Ok(())
    }
}

/// Whether points span less than a plane: then a body held there can turn.
fn on_a_line(points: &[[f64; 3]]) -> bool {
    let [first, rest @ ..] = points else { return true };
    let far = rest.iter().map(|x| sub(x, first)).max_by(|a, b| norm(a).total_cmp(&norm(b)));
    let Some(axis) = far else { return true };
    rest.iter().all(|x| norm(&cross(&axis, &sub(x, first))) <= 1e-9 * norm(&axis).powi(2))
}

fn check_name(place: &Place, span: Range<usize>, name: &str, limit: usize) -> Result<(), InputError> {
    let fault = if name.is_empty() {
        "is empty".to_owned()
    } else if name.len() > limit {
        format!("is {} bytes long", name.len())
    } else if name.contains(|c: char| c.is_control() || c == ',' || c == '"') {
        "holds a comma, a quote or a control character".to_owned()
    } else {
        return Ok(());
    };
    let what = format!("the name \"{}\" {fault}", name.escape_debug());
    Err(place.error(span, what, format!("use 1 to {limit} bytes without commas and quotes")))
}

pub(super) fn positive(place: &Place, key: &str, value: &Spanned<f64>) -> Result<f64, InputError> {
    let number = *value.get_ref();
    if number.is_finite() && number > 0.0 {
        return Ok(number);
    }
    Err(place.error(
        value.span(),
        format!("`{key}` = {number} is not a positive number"),
        "correct the value",
    ))
}

fn finite(place: &Place, key: &str, value: &Spanned<[f64; 3]>) -> Result<[f64; 3], InputError> {
    let point = *value.get_ref();
    if point.iter().all(|c| c.is_finite()) {
        return Ok(point);
    }
    Err(place.error(value.span(), format!("`{key}` = {point:?} is not finite"), "correct the value"))
}
