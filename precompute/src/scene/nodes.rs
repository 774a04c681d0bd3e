//! Selection of mesh nodes by a scene: fixed nodes and active nodes.

use std::ops::Range;

use palpate_core::{Limits, SPACE_NAME_LEN};
use toml::Spanned;

use super::cover::Cover;
use super::file::{ActiveTable, BoxTable, FixedTable};
use super::lookup::Lookup;
use super::place::{Located, check_name, finite, positive};
use super::reach::is_blocked;
use super::three::Three;
use super::{Scene, Unreachable};
use crate::error::{InputError, count};
use crate::fem::PadProfile;
use crate::mesh::surface;
use crate::num::vector::distance;
use crate::spec::{ActiveNode, Tool, Workspace, is_within};

/// Name of the group of all surface nodes, unless the mesh has a group of this name.
const SURFACE: &str = "surface";

/// What the tool can touch.
pub(super) struct Touchable {
    pub(super) active: Vec<ActiveNode>,
    /// The part of the skin that contact points are to cover.
    pub(super) cover: Option<Cover>,
    pub(super) unreachable: Unreachable,
}

impl Lookup<'_> {
    fn node(&self, node: &Spanned<i64>) -> Result<u32, InputError> {
        let n = self.mesh.nodes_m.len();
        u32::try_from(*node.get_ref()).ok().filter(|&node| (node as usize) < n).ok_or_else(|| {
            let what = format!("node {} is out of range: the mesh has {}", node.get_ref(), count(n, "node"));
            let fix = format!("use 0 to {} (0-based, in file order)", n - 1);
            self.place.error(node.span(), what, fix)
        })
    }

    pub(super) fn fixed(&self, table: &Spanned<FixedTable>) -> Result<Vec<u32>, InputError> {
        let FixedTable { nodes, group, in_box, file, key } = table.get_ref();
        let ways = "`nodes`, `group`, `box`, or `file` with `key`";
        let (span, mut fixed) = match (nodes, group, in_box, (file, key)) {
            (Some(nodes), None, None, (None, None)) => {
                let nodes_of = nodes.get_ref().iter().map(|node| self.node(node));
                (nodes.span(), nodes_of.collect::<Result<Vec<_>, _>>()?)
            }
            (None, Some(group), None, (None, None)) => {
                (group.span(), self.group(&self.mesh.node_groups, "nodes", group)?.to_vec())
            }
            (None, None, Some(in_box), (None, None)) => (in_box.span(), self.in_box(in_box)?),
            (None, None, None, (Some(file), Some(key))) => (key.span(), self.fixed_from_json(file, key)?),
            (None, None, None, (None, None)) => {
                let what = "[fixed] selects no nodes";
                return Err(self.place.error(table.span(), what, format!("give one of {ways}")));
            }
            (None, None, None, _) => {
                let what = "[fixed] needs both `file` and `key`";
                return Err(self.place.error(table.span(), what, "add the other of the two"));
            }
            _ => {
                let what = "[fixed] selects nodes in several ways";
                return Err(self.place.error(table.span(), what, format!("keep one of {ways}")));
            }
        };
        fixed.sort_unstable();
        fixed.dedup();
        if fixed.is_empty() {
            let mut fix = "select at least three nodes".to_owned();
            if in_box.is_some() {
                let (low, high) = self.mesh.bounding_box_m();
                fix = format!("the body spans {low:?} to {high:?} in metres: enlarge or move the box");
            }
            return Err(self.place.error(span, "the fixed set is empty", fix));
        }
        Ok(fixed)
    }

    /// Nodes in a box, faces included.
    fn in_box(&self, in_box: &Spanned<BoxTable>) -> Result<Vec<u32>, InputError> {
        let &BoxTable { min: Three(min), max: Three(max) } = in_box.get_ref();
        // The negated comparison also refuses a NaN corner.
        if !(0..3).all(|axis| min[axis] <= max[axis]) {
            let what = format!("the box is empty: min {min:?} is not below max {max:?}");
            return Err(self.place.error(in_box.span(), what, "swap the corners (metres)"));
        }
        let inside = (0..).zip(&self.mesh.nodes_m).filter(|(_, x)| is_within(&[min, max], x));
        Ok(inside.map(|(node, _)| node).collect())
    }

    /// Node list `key` of a JSON object of named lists.
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

    /// The active nodes, and the number of excluded nodes of groups.
    pub(super) fn all_active(
        &mut self,
        scene: &Scene,
        tool: &Tool,
        fixed: &[u32],
        workspace: Option<&Workspace>,
    ) -> Result<Touchable, InputError> {
        let tables = scene.file.active();
        let span = scene.file.active.as_ref().map_or(0..0, Spanned::span);
        self.check_tables(&tables, span.clone(), tool)?;
        let (mut all, mut unreachable): (Vec<ActiveNode>, _) = (Vec::new(), Unreachable::default());
        let (pieces, mut edges_m, mut cover) = (surface::pieces(self.mesh), Vec::new(), None);
        let mut named: Vec<(String, u32)> = Vec::new();
        for table in &tables {
            let name = self.name(table)?;
            self.check_keys(table.table, name.get_ref(), tool)?;
            let mut found = self.active(table, name.get_ref(), fixed)?;
            self.keep_reachable(table, &mut found, workspace, &mut unreachable)?;
            if let (Tool::Fingertip(tip), Some(group)) = (tool, &table.table.group) {
                if tip.profile == PadProfile::Hertz {
                    let what = "a tool with `profile` = \"hertz\" cannot slide over a group: its stiffness ends \
                                abruptly at the rim";
                    return Err(self.place.error(
                        group.span(),
                        what,
                        "use `profile = \"quartic\"`, or touch places",
                    ));
                }
                let cover =
                    cover.get_or_insert_with(|| Cover { name: name.get_ref().clone(), nodes: Vec::new() });
                for active in &mut found {
                    active.contact.get_or_insert_with(|| self.contact_at(active.node));
                    edges_m.push(self.check_pad(table.span.clone(), tip, active, fixed, &pieces)?);
                }
                cover.nodes.extend(found.iter().map(|active| active.node));
                cover.nodes.sort_unstable();
                cover.nodes.dedup();
                continue;
            }
            if let Tool::Fingertip(tip) = tool {
                for active in &mut found {
                    active.contact.get_or_insert_with(|| self.contact_at(active.node));
                    edges_m.push(self.check_pad(table.span.clone(), tip, active, fixed, &pieces)?);
                }
            }
            for active in found {
                if table.table.group.is_none() {
                    named.push((active.name.clone(), active.node));
                }
                check_name(self.place, name.span(), &active.name, SPACE_NAME_LEN)?;
                if all.iter().any(|other| other.name == active.name) {
                    let what = format!("two active nodes are named \"{}\"", active.name);
                    return Err(self.place.error(name.span(), what, "give each its own name"));
                }
                let is_same =
                    |other: &&ActiveNode| other.node == active.node && other.contact == active.contact;
                if let Some(other) = all.iter().find(is_same) {
                    let (a, b, node) = (&other.name, &active.name, active.node);
                    self.warnings.push(format!(
                        "active nodes \"{a}\" and \"{b}\" are both node {node}: it is solved twice"
                    ));
                }
                all.push(active);
            }
        }
        if let Tool::Fingertip(tip) = tool {
            self.warn_of_coarse_skin(scene.order()?, tip, &edges_m);
        }
        self.warn_of_unequal_places(&named);
        let limit = Limits::PC.spaces;
        if all.len() > limit {
            let what = format!("the scene has {} active nodes, and a blob holds {limit}", all.len());
            let fix = "choose a smaller group, a workspace, or split the scene in two";
            return Err(self.place.error(span, what, fix));
        }
        Ok(Touchable { active: all, cover, unreachable })
    }

    /// Refuses active nodes of a sphere, and a scene of another tool without one.
    fn check_tables(
        &self,
        tables: &[Located<'_, ActiveTable>],
        span: Range<usize>,
        tool: &Tool,
    ) -> Result<(), InputError> {
        match (tool.sphere(), tables.is_empty()) {
            (Some(_), false) => {
                let what = "a sphere or capsule touches the whole skin and has no active node";
                Err(self.place.error(span, what, "remove [[active]]"))
            }
            (None, true) => {
                let what = "the scene has no active node";
                Err(self.place.error(span, what, "add an [[active]] table"))
            }
            _ => Ok(()),
        }
    }

    /// Excludes the unreachable nodes of a group; refuses an unreachable node that is named by itself.
    fn keep_reachable(
        &self,
        at: &Located<'_, ActiveTable>,
        found: &mut Vec<ActiveNode>,
        workspace: Option<&Workspace>,
        unreachable: &mut Unreachable,
    ) -> Result<(), InputError> {
        let is_outside = |node: u32| {
            workspace.is_some_and(|workspace| !is_within(workspace, &self.mesh.nodes_m[node as usize]))
        };
        let Some(group) = &at.table.group else {
            return match found.iter().find(|active| is_outside(active.node)) {
                None => Ok(()),
                Some(active) => {
                    let place = self.mesh.nodes_m[active.node as usize];
                    let what = format!(
                        "active node \"{}\" (node {}) at {place:?} is outside the workspace",
                        active.name, active.node
                    );
                    Err(self.place.error(
                        at.span.clone(),
                        what,
                        "choose a node in it, or enlarge it (metres)",
                    ))
                }
            };
        };
        found.retain(|active| {
            let (outside, hidden) = (is_outside(active.node), is_blocked(self.mesh, self.skin, active.node));
            unreachable.outside += usize::from(outside);
            unreachable.hidden += usize::from(hidden && !outside);
            !outside && !hidden
        });
        if found.is_empty() {
            let what = format!("the tool cannot reach any node of group \"{}\"", group.get_ref());
            return Err(self.place.error(
                group.span(),
                what,
                "enlarge the workspace, or choose another group",
            ));
        }
        Ok(())
    }

    /// Name of the node's space. Nodes of a group without a name get the group's name.
    pub(super) fn name<'t>(&self, at: &Located<'t, ActiveTable>) -> Result<&'t Spanned<String>, InputError> {
        let ActiveTable { name, group, .. } = at.table;
        name.as_ref().or(group.as_ref()).ok_or_else(|| {
            self.place.error(at.span.clone(), "an active node has no name", "add `name = \"A1\"`")
        })
    }

    pub(super) fn active(
        &self,
        at: &Located<'_, ActiveTable>,
        name: &str,
        fixed: &[u32],
    ) -> Result<Vec<ActiveNode>, InputError> {
        let mut found = self.placed(at, name, fixed)?;
        if let Some(visited) = &at.table.visited_m {
            if at.table.group.is_some() {
                let what = "`visited_m` belongs to one node, not to a `group`";
                return Err(self.place.error(visited.span(), what, "give the node by `node` or `point`"));
            }
            for Three(at_m) in visited.get_ref() {
                if !at_m.iter().all(|x| x.is_finite()) {
                    let what = format!("`visited_m` holds {at_m:?}");
                    return Err(self.place.error(visited.span(), what, "give displacements in metres"));
                }
            }
            let all_m: Vec<[f64; 3]> = visited.get_ref().iter().map(|at_m| at_m.0).collect();
            found.iter_mut().for_each(|node| node.visited_m.clone_from(&all_m));
        }
        Ok(found)
    }

    /// Like [`Self::active`], without displacements.
    fn placed(
        &self,
        at: &Located<'_, ActiveTable>,
        name: &str,
        fixed: &[u32],
    ) -> Result<Vec<ActiveNode>, InputError> {
        if let (Some(group), true) =
            (&at.table.group, at.table.patch.is_some() || at.table.patch_radius_m.is_some())
        {
            let what = "a patch rotates about one node, not about a `group`";
            return Err(self.place.error(group.span(), what, "give `node` or `nearest` with the patch"));
        }
        let ActiveTable { node, nearest, point, group, .. } = at.table;
        let (span, node) = match (node, nearest, point, group) {
            (Some(index), None, None, None) => (index.span(), self.node(index)?),
            (None, Some(point), None, None) => (point.span(), self.nearest(point)?),
            (None, None, Some(point), None) => {
                let contact = self.contact_point(name, point)?;
                return Ok(vec![ActiveNode::at(name.into(), contact)]);
            }
            (None, None, None, Some(group)) => return self.of_group(group, name, fixed),
            (None, None, None, None) => {
                let what = format!("active node \"{name}\" has no position");
                let fix = "give `node`, `nearest`, `point` or `group`";
                return Err(self.place.error(at.span.clone(), what, fix));
            }
            _ => {
                let what = format!("active node \"{name}\" has several positions");
                let fix = "keep one of `node`, `nearest`, `point` and `group`";
                return Err(self.place.error(at.span.clone(), what, fix));
            }
        };
        self.touchable(span, node, name, fixed)?;
        Ok(vec![self.handle(at.table, name, node, fixed)?])
    }

    /// The free surface nodes of a group.
    fn of_group(
        &self,
        group: &Spanned<String>,
        name: &str,
        fixed: &[u32],
    ) -> Result<Vec<ActiveNode>, InputError> {
        let groups = &self.mesh.node_groups;
        // Every mesh has a surface, even without a group of that name.
        let members = match group.get_ref().as_str() {
            SURFACE if !groups.contains_key(SURFACE) => &self.skin.nodes,
            _ => self.group(groups, "nodes", group)?,
        };
        let is_free = |node: &u32| self.skin.contains(*node) && fixed.binary_search(node).is_err();
        let active = |node| ActiveNode::node(format!("{name}-{node}"), node);
        let active: Vec<ActiveNode> = members.iter().copied().filter(is_free).map(active).collect();
        if active.is_empty() {
            let what = format!("group \"{}\" has no free surface node", group.get_ref());
            let fix = "choose a group on the surface that is not fixed";
            return Err(self.place.error(group.span(), what, fix));
        }
        Ok(active)
    }

    /// The active node with its rigid patch.
    fn handle(
        &self,
        table: &ActiveTable,
        name: &str,
        node: u32,
        fixed: &[u32],
    ) -> Result<ActiveNode, InputError> {
        let (span, mut patch) = match (&table.patch, &table.patch_radius_m) {
            (None, None) => {
                return Ok(ActiveNode::node(name.into(), node));
            }
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
                let near = |n: &&u32| distance(self.mesh.nodes_m[**n as usize], centre) <= radius_m;
                (radius.span(), self.skin.nodes.iter().filter(near).copied().collect())
            }
        };
        patch.push(node);
        patch.sort_unstable();
        patch.dedup();
        for &member in &patch {
            self.touchable(span.clone(), member, name, fixed)?;
        }
        Ok(ActiveNode { patch, ..ActiveNode::node(name.into(), node) })
    }

    /// The surface node nearest to a point in metres; of equally near nodes, the one with the lowest index.
    fn nearest(&self, point: &Spanned<Three>) -> Result<u32, InputError> {
        let target = finite(self.place, "nearest", point)?;
        let away = |node: u32| distance(self.mesh.nodes_m[node as usize], target);
        let nearest = self.seen.nodes.iter().copied().min_by(|&a, &b| away(a).total_cmp(&away(b)));
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
        if self.skin.contains(node) && !self.seen.contains(node) {
            let what = format!(
                "active node \"{name}\" (node {node}) is on the wall of a cavity, where the tool cannot reach it"
            );
            return Err(self.place.error(span, what, "choose a node on the outside"));
        }
        if !self.skin.contains(node) {
            let what = format!(
                "active node \"{name}\" (node {node}) is inside the body, where the tool cannot reach it"
            );
            let x = self.mesh.nodes_m[node as usize];
            return Err(self.place.error(
                span,
                what,
                format!("choose a surface node, for example with `nearest` = {x:?}"),
            ));
        }
        Ok(())
    }
}
