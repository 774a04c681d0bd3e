//! Regular refinement (Bey 1995): each tet is divided into eight of the same or nearly the same shape. The
//! domain does not change.
//!
//! Four children lie at the corners. The octahedron between them is divided along its shortest diagonal. The
//! mesh stays conforming for each choice of the diagonal, because the diagonal lies inside the parent.

use std::collections::BTreeMap;

use super::TetMesh;
use super::tetrahedral::{EDGES, Edges, six_volume};
use crate::num::vector::distance;

/// A refined mesh. Its nodes are the coarse nodes, followed by new nodes in the middle of edges.
#[derive(Debug, Clone)]
pub(crate) struct Refined {
    /// The fine mesh. The children of a tet follow each other, in the order of the coarse tets. A new node
    /// belongs to a node group if both ends of its edge do.
    pub mesh: TetMesh,
    /// Ends of the edge of each new node; they have smaller numbers than the node.
    edges: Vec<[u32; 2]>,
    coarse_nodes: u32,
    /// First child of each coarse tet, and the number of tets.
    first_child: Vec<u32>,
}

/// Pairs of opposite edges of [`EDGES`]: their midpoints are the ends of the octahedron's diagonals.
const DIAGONALS: [[usize; 2]; 3] = [[0, 5], [1, 4], [2, 3]];

impl Refined {
    /// Refines a mesh once: eight children for each tet, and a new node for each edge.
    pub(crate) fn of(coarse: &TetMesh) -> Self {
        let coarse_nodes = coarse.nodes_m.len() as u32;
        let edges = Edges::of(coarse, EDGES);
        let mut nodes_m = coarse.nodes_m.clone();
        nodes_m.extend(edges.midpoints_m(coarse));
        let middles = edges.of_tets.iter().map(|edges| edges.map(|edge| coarse_nodes + edge));
        let tets = coarse.tets.iter().zip(middles).flat_map(|(tet, middle)| children(tet, middle, &nodes_m));
        let tets = tets.collect();
        let first_child = (0..=coarse.tets.len() as u32).map(|tet| 8 * tet).collect();
        Self::new(coarse, nodes_m, tets, edges.ends, first_child)
    }

    /// The fine mesh with the groups of the coarse one.
    pub(super) fn new(
        coarse: &TetMesh,
        nodes_m: Vec<[f64; 3]>,
        tets: Vec<[u32; 4]>,
        edges: Vec<[u32; 2]>,
        first_child: Vec<u32>,
    ) -> Self {
        let mesh = TetMesh { nodes_m, tets, ..TetMesh::default() };
        let mut refined = Self { mesh, edges, coarse_nodes: coarse.nodes_m.len() as u32, first_child };
        refined.mesh.node_groups = named(&coarse.node_groups, |nodes| refined.nodes(nodes));
        refined.mesh.tet_groups = named(&coarse.tet_groups, |tets| refined.tets(tets));
        refined
    }

    /// These nodes and the new nodes between them, in ascending order.
    pub(crate) fn nodes(&self, coarse: &[u32]) -> Vec<u32> {
        let mut is_in = vec![false; self.mesh.nodes_m.len()];
        for &node in coarse {
            is_in[node as usize] = true;
        }
        for (middle, ends) in (self.coarse_nodes as usize..).zip(&self.edges) {
            is_in[middle] = ends.iter().all(|&end| is_in[end as usize]);
        }
        (0..).zip(is_in).filter(|(_, is_in)| *is_in).map(|(node, _)| node).collect()
    }

    /// The children of these tets.
    pub(crate) fn tets(&self, coarse: &[u32]) -> Vec<u32> {
        let children = |&tet: &u32| self.first_child[tet as usize]..self.first_child[tet as usize + 1];
        coarse.iter().flat_map(children).collect()
    }
}

fn named(
    groups: &BTreeMap<String, Vec<u32>>,
    finer: impl Fn(&[u32]) -> Vec<u32>,
) -> BTreeMap<String, Vec<u32>> {
    groups.iter().map(|(name, members)| (name.clone(), finer(members))).collect()
}

fn children(tet: &[u32; 4], middle: [u32; 6], nodes_m: &[[f64; 3]]) -> [[u32; 4]; 8] {
    let corner = |vertex: usize| {
        // The vertex and the midpoints of its edges.
        let mut child = [tet[vertex]; 4];
        let own = EDGES.iter().zip(middle).filter(|(ends, _)| ends.contains(&vertex));
        for (place, (_, middle)) in child[1..].iter_mut().zip(own) {
            *place = middle;
        }
        child
    };
    let length = |[a, b]: [usize; 2]| distance(nodes_m[middle[a] as usize], nodes_m[middle[b] as usize]);
    let diagonal =
        DIAGONALS.into_iter().min_by(|a, b| length(*a).total_cmp(&length(*b))).unwrap_or(DIAGONALS[0]);
    let others: Vec<[usize; 2]> = DIAGONALS.into_iter().filter(|d| *d != diagonal).collect();
    // The four tets around the diagonal: each contains it and one end of each of the other diagonals.
    let round = |one: usize, other: usize| {
        [diagonal[0], diagonal[1], others[0][one], others[1][other]].map(|edge| middle[edge])
    };
    [corner(0), corner(1), corner(2), corner(3), round(0, 0), round(0, 1), round(1, 0), round(1, 1)].map(
        |child| {
            if six_volume(&child.map(|node| nodes_m[node as usize])) > 0.0 {
                child
            } else {
                [child[0], child[1], child[3], child[2]]
            }
        },
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Surface;

    #[test]
    fn a_finer_mesh_is_the_same_body_with_the_same_shapes() {
        let mut coarse = TetMesh::cuboid([2, 1, 1], 0.1);
        // Perturb the nodes so that no tet is regular.
        for (n, node) in coarse.nodes_m.iter_mut().enumerate() {
            node[n % 3] += 0.003 * ((n * 7 % 5) as f64 - 2.0);
        }
        let low: Vec<u32> = (0..12).filter(|n| n % 2 == 0).collect();
        coarse.node_groups.insert("low".into(), low);
        coarse.tet_groups.insert("first".into(), vec![0, 3]);
        let finer = Refined::of(&coarse).mesh;
        assert_eq!(finer.tets.len(), 8 * coarse.tets.len());
        finer.check().expect("sound");
        assert!((finer.volume_m3() - coarse.volume_m3()).abs() < 1e-15);
        for (tet, children) in finer.tets.chunks(8).enumerate() {
            let volume = coarse.signed_volume_m3(tet);
            for n in 0..children.len() {
                assert!((finer.signed_volume_m3(8 * tet + n) - volume / 8.0).abs() < 1e-15 * volume.max(1.0));
            }
        }
        assert_eq!(finer.tet_groups["first"], (0..8).chain(24..32).collect::<Vec<u32>>());
        // Four triangles for each coarse triangle: no hanging node and no hole.
        assert_eq!(Surface::of(&finer).triangles.len(), 4 * Surface::of(&coarse).triangles.len());
        let on_low = |node: &u32| {
            let ends = |end: u32| coarse.node_groups["low"].contains(&end);
            let n = coarse.nodes_m.len() as u32;
            *node < n && ends(*node)
                || *node >= n && Refined::of(&coarse).edges[(*node - n) as usize].into_iter().all(ends)
        };
        let expected: Vec<u32> = (0..finer.nodes_m.len() as u32).filter(on_low).collect();
        assert_eq!(finer.node_groups["low"], expected);
        assert!(expected.len() > 12);
    }
}
