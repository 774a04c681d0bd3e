//! Unchecked content of a mesh file with tags and lines, and the checks that all formats share.

use std::collections::BTreeMap;
use std::path::PathBuf;

use super::{LengthUnit, MeshFault, TetMesh};
use crate::error::{InputError, count};

/// Position of a node or element in the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Origin {
    /// Its tag in the file.
    pub(crate) tag: u64,
    /// 1-based line, if the format has lines.
    pub(crate) line: Option<usize>,
}

/// Nodes, tets and groups of a file before the checks, in the file's unit.
#[derive(Debug, Default)]
pub(crate) struct RawMesh {
    /// The file with the nodes.
    pub(crate) node_file: PathBuf,
    /// The file with the tets (TetGen has two files).
    pub(crate) tet_file: PathBuf,
    pub(crate) nodes: Vec<[f64; 3]>,
    pub(crate) node_origins: Vec<Origin>,
    pub(crate) tets: Vec<[u32; 4]>,
    pub(crate) tet_origins: Vec<Origin>,
    /// Mid-edge nodes of ten-node tets in the order of `EDGES`, one row per tet; empty for four-node tets.
    pub(crate) mid_edges: Vec<[u32; 6]>,
    /// Whether the order of the rows of `mid_edges` is undefined (TetGen's versions differ).
    pub(crate) mid_edges_in_any_order: bool,
    /// Relative rounding error of the coordinates: that of f32 if the file stores f32, otherwise zero.
    pub(crate) rounding: f64,
    /// Unsorted and with repetitions; `finish` sorts and deduplicates.
    pub(crate) node_groups: BTreeMap<String, Vec<u32>>,
    pub(crate) tet_groups: BTreeMap<String, Vec<u32>>,
}

impl RawMesh {
    pub(crate) fn new(node_file: impl Into<PathBuf>, tet_file: impl Into<PathBuf>) -> Self {
        Self { node_file: node_file.into(), tet_file: tet_file.into(), ..Self::default() }
    }

    /// Adds a tet, and adds it and its nodes to each of its groups.
    ///
    /// All tets of a mesh have four nodes, or all have ten; `mid_edges` is in the order of `EDGES`.
    pub(crate) fn push_tet(
        &mut self,
        nodes: [u32; 4],
        mid_edges: Option<[u32; 6]>,
        origin: Origin,
        groups: &[String],
    ) -> Result<(), InputError> {
        let index = self.tets.len() as u32;
        self.tets.push(nodes);
        self.tet_origins.push(origin);
        self.mid_edges.extend(mid_edges);
        if !self.mid_edges.is_empty() && self.mid_edges.len() != self.tets.len() {
            let (this, before) = if mid_edges.is_some() { (10, 4) } else { (4, 10) };
            let what = format!("has {this} nodes, and the elements before it have {before}");
            return Err(self.at_tet(index, what, "save the whole mesh with one order, 1 or 2"));
        }
        for group in groups {
            self.tet_groups.entry(group.clone()).or_default().push(index);
            self.node_groups.entry(group.clone()).or_default().extend(nodes);
        }
        Ok(())
    }

    /// Drops mid-edge nodes, converts to metres, sorts the groups and checks the mesh.
    pub(crate) fn finish(mut self, unit: LengthUnit) -> Result<TetMesh, InputError> {
        self.drop_mid_edge_nodes()?;
        for x in self.nodes.iter_mut().flatten() {
            *x /= unit.per_metre();
        }
        for members in self.node_groups.values_mut().chain(self.tet_groups.values_mut()) {
            members.sort_unstable();
            members.dedup();
        }
        let mesh = TetMesh {
            nodes_m: std::mem::take(&mut self.nodes),
            tets: std::mem::take(&mut self.tets),
            node_groups: std::mem::take(&mut self.node_groups),
            tet_groups: std::mem::take(&mut self.tet_groups),
        };
        match mesh.check() {
            Ok(()) => Ok(mesh),
            Err(fault) => Err(self.explain(fault)),
        }
    }

    /// Converts a fault to an input error with the tags and lines of the file.
    pub(super) fn explain(&self, fault: MeshFault) -> InputError {
        match fault {
            MeshFault::Empty => InputError::new(
                &self.tet_file,
                "the mesh holds no tetrahedra",
                "mesh the volume, not only its surface, and export 3-D elements",
            ),
            MeshFault::NotFinite { node } => self.at_node(
                node,
                "has a coordinate that is not finite",
                "repair the coordinate and export again",
            ),
            MeshFault::NoSuchNode { tet, node } => self.at_tet(
                tet,
                format!(
                    "names node {node} (0-based), but there are {}",
                    count(self.node_origins.len(), "node")
                ),
                "the file is damaged or its counts do not match: export it again",
            ),
            MeshFault::Flat { tet } => self.at_tet(
                tet,
                "has zero volume".into(),
                "remove it or move a vertex out of the plane of the others, or mesh the body again",
            ),
            MeshFault::Negative { tet, volume, of_all } => {
                let fix = "reorder its vertices (swap any two) or export the mesh again";
                let volume = format!("has negative volume {volume:.3e} m3");
                match of_all {
                    1 => self.at_tet(tet, volume, fix),
                    _ if of_all as usize == self.tet_origins.len() => self.at_tet(
                        tet,
                        format!("{volume}, and so has every other tet"),
                        "the file uses the opposite vertex order: swap the first two vertices of every tet",
                    ),
                    _ => self.at_tet(tet, format!("{volume} (as have {} others)", of_all - 1), fix),
                }
            }
            MeshFault::Repeated { tet, first } => self.at_tet(
                tet,
                format!("has the same four vertices as element {}", self.tet_origins[first as usize].tag),
                "remove one of the two",
            ),
            MeshFault::Isolated { node, of_all } => {
                let others = match of_all {
                    1 => String::new(),
                    _ => format!(" (as do {} others)", of_all - 1),
                };
                self.at_node(
                    node,
                    format!("belongs to no tetrahedron{others}"),
                    "remove it; in Gmsh give the volume a physical group and export without \"Save all elements\"",
                )
            }
        }
    }

    fn at_node(&self, node: u32, what: impl AsRef<str>, fix: &str) -> InputError {
        let Origin { tag, line } = self.node_origins[node as usize];
        let what = format!("node {tag} {}", what.as_ref());
        InputError { file: self.node_file.clone(), line, what, fix: fix.into() }
    }

    pub(super) fn at_tet(&self, tet: u32, what: String, fix: &str) -> InputError {
        let Origin { tag, line } = self.tet_origins[tet as usize];
        InputError {
            file: self.tet_file.clone(),
            line,
            what: format!("element {tag} {what}"),
            fix: fix.into(),
        }
    }
}
