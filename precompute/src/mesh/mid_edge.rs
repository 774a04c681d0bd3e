//! Checks the mid-edge nodes of ten-node tetrahedra and drops them.
//!
//! The solver's second-order elements are straight-sided and create their own mid-edge nodes, so mid-edge
//! nodes in the middle of their edges carry no information. A curved edge is refused, because the solver
//! would straighten it. The vertices remain, in file order. **Node indices count vertices only**: if mid-edge
//! nodes precede or separate vertices in the file, node 5 of a scene is the sixth vertex and not the sixth
//! node. A group keeps its vertices; a group that has only mid-edge nodes is removed.

use super::raw::RawMesh;
use super::tetrahedral::{EDGES, check_nodes};
use crate::error::InputError;
use crate::num::vector::distance;

/// Largest distance of a mid-edge node from the middle of its edge, as a share of the edge's length.
const STRAIGHT_SHARE: f64 = 1e-6;

const EXPORT_STRAIGHT: &str = "export it straight-sided (Gmsh: Mesh.SecondOrderLinear = 1 before setOrder(2), and no \
                               high-order optimisation) and with all digits, or with order 1";

/// The `edge_order` of VTK, which lists the edges 01 12 02 03 13 23.
pub(super) const VTK_ORDER: [usize; 6] = [0, 2, 3, 1, 4, 5];
/// That of Gmsh, which lists the edges 01 12 02 03 23 13.
pub(super) const GMSH_ORDER: [usize; 6] = [0, 2, 3, 1, 5, 4];

impl RawMesh {
    /// Checks the mid-edge nodes and removes them from nodes and groups. Does nothing for four-node tets.
    pub(super) fn drop_mid_edge_nodes(&mut self) -> Result<(), InputError> {
        if self.mid_edges.is_empty() {
            return Ok(());
        }
        check_nodes(&self.nodes, &self.tets)
            .and_then(|()| check_nodes(&self.nodes, &self.mid_edges))
            .map_err(|fault| self.explain(fault))?;
        let mut is_vertex = vec![false; self.nodes.len()];
        for &node in self.tets.iter().flatten() {
            is_vertex[node as usize] = true;
        }
        let mut dropped = vec![false; self.nodes.len()];
        for tet in 0..self.tets.len() {
            self.check_edges(tet, &is_vertex)?;
            for node in self.mid_edges[tet] {
                dropped[node as usize] = true;
            }
        }
        self.mid_edges.clear();
        self.keep_nodes(&dropped);
        Ok(())
    }

    fn check_edges(&self, tet: usize, is_vertex: &[bool]) -> Result<(), InputError> {
        let vertices = self.tets[tet];
        let middles = self.in_order_of_edges(tet);
        let tag = |node: u32| self.node_origins[node as usize].tag;
        let at = |what: String, fix: &str| Err(self.at_tet(tet as u32, what, fix));
        for (edge, &middle) in middles.iter().enumerate() {
            let ends = EDGES[edge].map(|v| vertices[v]);
            let name = format!("{}-{}", tag(ends[0]), tag(ends[1]));
            if is_vertex[middle as usize] {
                let what = format!(
                    "has node {} at the middle of edge {name}, which is a vertex as well",
                    tag(middle)
                );
                return at(what, "the mesh is not conforming or damaged: mesh the body again");
            }
            let [off, allowed, length] = self.off_middle(vertices, edge, middle);
            if off <= allowed {
                continue;
            }
            let elsewhere = (0..EDGES.len()).find(|&edge| {
                let [off, allowed, _] = self.off_middle(vertices, edge, middle);
                off <= allowed
            });
            if let Some(edge) = elsewhere {
                let [a, b] = EDGES[edge].map(|v| tag(vertices[v]));
                let what = format!(
                    "has node {} for the middle of edge {name}, but it is that of {a}-{b}",
                    tag(middle)
                );
                return at(
                    what,
                    "the mid-edge nodes are in the order of another format: convert it again, or with order 1",
                );
            }
            let share = off / length;
            let what = format!(
                "is not straight: edge {name} is curved, its node {} is {share:.1e} of its length off the middle",
                tag(middle)
            );
            return at(what, EXPORT_STRAIGHT);
        }
        Ok(())
    }

    /// The mid-edge nodes in the order of [`EDGES`]. If the format defines no order, each node is assigned to
    /// the edge with the nearest middle.
    fn in_order_of_edges(&self, tet: usize) -> [u32; 6] {
        let mut middles = self.mid_edges[tet];
        if self.edge_order.is_none() {
            for edge in 0..middles.len() {
                let off = |at: &usize| self.off_middle(self.tets[tet], edge, middles[*at])[0];
                let nearest = (edge..middles.len()).min_by(|a, b| off(a).total_cmp(&off(b)));
                middles.swap(edge, nearest.expect("the range holds `edge`"));
            }
        }
        middles
    }

    /// Distance of a node from the middle of an edge, the tolerance of this distance, and the length of the
    /// edge.
    ///
    /// The tolerance is [`STRAIGHT_SHARE`] of the edge plus the rounding error of three stored points: per
    /// axis, that of the node and of the mean of the two ends; a factor of sqrt(3) for the three axes.
    fn off_middle(&self, vertices: [u32; 4], edge: usize, node: u32) -> [f64; 3] {
        let [a, b] = EDGES[edge].map(|v| self.nodes[vertices[v] as usize]);
        let at = self.nodes[node as usize];
        let middle = std::array::from_fn(|axis| 0.5 * (a[axis] + b[axis]));
        let length = distance(a, b);
        let largest = [a, b, at].into_iter().flatten().fold(0.0, |m: f64, c| m.max(c.abs()));
        [distance(at, middle), STRAIGHT_SHARE * length + 4.0 * self.rounding * largest, length]
    }

    /// Removes nodes and renumbers all references to nodes.
    fn keep_nodes(&mut self, dropped: &[bool]) {
        let mut kept = 0;
        let new_index: Vec<Option<u32>> = dropped
            .iter()
            .map(|&dropped| {
                (!dropped).then(|| {
                    kept += 1;
                    kept - 1
                })
            })
            .collect();
        let keep = |index: usize| !dropped[index];
        let mut index = 0..;
        self.nodes.retain(|_| keep(index.next().expect("endless")));
        let mut index = 0..;
        self.node_origins.retain(|_| keep(index.next().expect("endless")));
        for node in self.tets.iter_mut().flatten() {
            *node = new_index[*node as usize].expect("no vertex is dropped");
        }
        self.node_groups.retain(|_, members| {
            *members = members.iter().filter_map(|&node| new_index[node as usize]).collect();
            !members.is_empty()
        });
    }
}

#[cfg(test)]
mod tests;
