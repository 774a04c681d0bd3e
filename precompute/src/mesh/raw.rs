//! Unchecked content of a mesh file with tags and lines, and the checks that all formats share.

use std::collections::BTreeMap;
use std::path::PathBuf;

use super::cell_data::CellData;
use super::lines::DAMAGED;
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
    /// Position of the mid-edge node of each of `EDGES` in a ten-node tet, counted from the fifth node.
    /// `None` if the format defines no order.
    pub(crate) edge_order: Option<[usize; 6]>,
    /// Relative rounding error of the coordinates: that of f32 if the file stores f32, otherwise zero.
    pub(crate) rounding: f64,
    /// Unsorted and with repetitions; `finish` sorts and deduplicates.
    pub(crate) node_groups: BTreeMap<String, Vec<u32>>,
    pub(crate) tet_groups: BTreeMap<String, Vec<u32>>,
    /// Numbers of the cells, if the format has them and they are read.
    pub(crate) cell_data: Option<CellData>,
}

impl RawMesh {
    pub(crate) fn new(node_file: impl Into<PathBuf>, tet_file: impl Into<PathBuf>) -> Self {
        Self { node_file: node_file.into(), tet_file: tet_file.into(), ..Self::default() }
    }

    /// Adds a tet of four or ten nodes, and adds it and its vertices to each of its groups. All tets of a
    /// mesh have the same number of nodes.
    pub(crate) fn push_tet(
        &mut self,
        nodes: &[u32],
        origin: Origin,
        groups: &[String],
    ) -> Result<(), InputError> {
        let index = self.tets.len() as u32;
        let vertices = [nodes[0], nodes[1], nodes[2], nodes[3]];
        self.tets.push(vertices);
        self.tet_origins.push(origin);
        let has_mid_edges = nodes.len() == 10;
        if has_mid_edges {
            let order = self.edge_order.unwrap_or([0, 1, 2, 3, 4, 5]);
            self.mid_edges.push(order.map(|at| nodes[4 + at]));
        }
        if !self.mid_edges.is_empty() && self.mid_edges.len() != self.tets.len() {
            let (this, before) = if has_mid_edges { (10, 4) } else { (4, 10) };
            let what = format!("has {this} nodes, and the elements before it have {before}");
            return Err(self.at_tet(index, what, "save the whole mesh with one order, 1 or 2"));
        }
        for group in groups {
            self.tet_groups.entry(group.clone()).or_default().push(index);
            self.node_groups.entry(group.clone()).or_default().extend(vertices);
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
        mesh.check().map_err(|fault| self.explain(fault))?;
        Ok(mesh)
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
                DAMAGED,
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
