//! The surface of a body: boundary triangles with outward orientation, nodes, normals and topology.

use std::collections::HashMap;

use serde::Serialize;

use super::TetMesh;
use super::tetrahedral::sorted;
use crate::error::count;
use crate::num::vector::{cross, difference, dot, norm};

/// The four faces of a tet of positive volume, counter-clockwise seen from outside.
pub(crate) const FACES: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];

/// Boundary of a tetrahedral mesh.
///
/// `triangles` contains mesh nodes. The order of the triangles follows the order of the tets and is thus
/// deterministic.
#[derive(Debug, Clone, PartialEq)]
pub struct Surface {
    /// Faces that belong to exactly one tet, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Nodes of the triangles, ascending.
    pub nodes: Vec<u32>,
    /// Unit outward normal at each of `nodes`: the area-weighted mean of the normals of its triangles.
    ///
    /// Zero if the weighted sum vanishes (a node where two parts of the surface touch back to back).
    pub normals: Vec<[f64; 3]>,
    /// Defects of the surface as a closed manifold.
    pub topology: Topology,
}

/// Counts that show whether the boundary is one closed surface around one body.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Topology {
    /// Number of edges with more than two boundary triangles: parts of the body can rotate about them.
    pub non_manifold_edges: usize,
    /// Number of nodes where parts of the boundary touch in one point only.
    pub non_manifold_nodes: usize,
    /// Number of faces with three or more tets: tets overlap there.
    pub overlapping_faces: usize,
    /// Vertices - edges + triangles: 2 for each closed surface without handles.
    pub euler_characteristic: i64,
    /// Number of connected pieces of the boundary (each cavity is one).
    pub pieces: usize,
}

impl Topology {
    /// Whether every edge has two triangles, every node one fan of triangles, and no face more than two tets.
    pub(crate) fn is_manifold(&self) -> bool {
        self.non_manifold_edges == 0 && self.non_manifold_nodes == 0 && self.overlapping_faces == 0
    }

    /// The warning in one line, or `None` for a manifold.
    pub(crate) fn warning(&self) -> Option<String> {
        (!self.is_manifold()).then(|| {
            format!(
                "the surface is not a closed manifold ({}, {}, {}): parts can rotate about shared edges, or overlap",
                count(self.non_manifold_edges, "bad edge"),
                count(self.non_manifold_nodes, "bad node"),
                count(self.overlapping_faces, "overlapping face")
            )
        })
    }
}

impl Surface {
    /// Extracts the boundary: the faces that belong to exactly one tet.
    pub fn of(mesh: &TetMesh) -> Self {
        let (faces, overlapping_faces) = boundary(mesh.tets.iter());
        let triangles = faces.into_iter().map(|(tet, face)| face.map(|v| mesh.tets[tet][v])).collect();
        Self::made_of(mesh, triangles, overlapping_faces)
    }

    fn made_of(mesh: &TetMesh, triangles: Vec<[u32; 3]>, overlapping_faces: usize) -> Self {
        let mut nodes: Vec<u32> = triangles.iter().flatten().copied().collect();
        nodes.sort_unstable();
        nodes.dedup();
        let normals = vertex_normals(mesh, &triangles, &nodes);
        let topology = topology(&triangles, &nodes, overlapping_faces);
        Self { triangles, nodes, normals, topology }
    }

    /// The surface without the walls of cavities.
    #[must_use]
    pub fn seen(self, mesh: &TetMesh) -> Self {
        let mut walls = UnionFind::new(self.triangles.len());
        let mut first_of: HashMap<[u32; 2], usize> = HashMap::with_capacity(2 * self.triangles.len());
        for (index, &[a, b, c]) in self.triangles.iter().enumerate() {
            for edge in [[a, b], [b, c], [c, a]] {
                walls.join(index, *first_of.entry(sorted(edge)).or_insert(index));
            }
        }
        // With outward orientation, the outer surface of a body encloses a positive volume and a cavity a
        // negative one.
        let mut volumes = vec![0.0; self.triangles.len()];
        for (index, triangle) in self.triangles.iter().enumerate() {
            let [a, b, c] = triangle.map(|node| mesh.nodes_m[node as usize]);
            volumes[walls.root(index)] += dot(a, cross(b, c));
        }
        if volumes.iter().all(|&volume| volume >= 0.0) {
            return self;
        }
        let keep: Vec<bool> = (0..self.triangles.len()).map(|n| volumes[walls.root(n)] > 0.0).collect();
        let seen = self.triangles.iter().zip(keep).filter(|(_, keep)| *keep);
        Self::made_of(mesh, seen.map(|(triangle, _)| *triangle).collect(), self.topology.overlapping_faces)
    }

    /// Whether a mesh node lies on the boundary.
    pub fn contains(&self, node: u32) -> bool {
        self.nodes.binary_search(&node).is_ok()
    }

    /// Unit outward normal at a mesh node; `None` off the boundary.
    pub fn normal(&self, node: u32) -> Option<[f64; 3]> {
        self.nodes.binary_search(&node).ok().map(|at| self.normals[at])
    }

    /// Area, m^2.
    pub(crate) fn area_m2(&self, mesh: &TetMesh) -> f64 {
        self.triangles.iter().map(|t| 0.5 * norm(twice_area(mesh, t))).sum()
    }
}

/// The faces that belong to exactly one tet, as index of the tet and of its corners, in the order of the tets; and
/// the number of faces of three or more tets. The first four nodes of a tet are its corners.
pub(crate) fn boundary<T: AsRef<[u32]>>(
    tets: impl Iterator<Item = T> + Clone,
) -> (Vec<(usize, [usize; 3])>, usize) {
    let key = |tet: &T, face: [usize; 3]| sorted(face.map(|v| tet.as_ref()[v]));
    let mut uses: HashMap<[u32; 3], u32> = HashMap::new();
    for tet in tets.clone() {
        for face in FACES {
            *uses.entry(key(&tet, face)).or_default() += 1;
        }
    }
    let alone =
        |(index, tet): (usize, T)| FACES.map(|face| (uses[&key(&tet, face)] == 1).then_some((index, face)));
    let faces = tets.enumerate().flat_map(alone).flatten().collect();
    (faces, uses.values().filter(|&&tets| tets > 2).count())
}

/// Twice the area vector. Its length weights the vertex normals by area.
fn twice_area(mesh: &TetMesh, triangle: &[u32; 3]) -> [f64; 3] {
    let [a, b, c] = triangle.map(|node| mesh.nodes_m[node as usize]);
    cross(difference(b, a), difference(c, a))
}

fn vertex_normals(mesh: &TetMesh, triangles: &[[u32; 3]], nodes: &[u32]) -> Vec<[f64; 3]> {
    let mut sums = vec![[0.0; 3]; mesh.nodes_m.len()];
    for triangle in triangles {
        let area = twice_area(mesh, triangle);
        for &node in triangle {
            for axis in 0..3 {
                sums[node as usize][axis] += area[axis];
            }
        }
    }
    nodes
        .iter()
        .map(|&node| {
            let sum = sums[node as usize];
            let length = norm(sum);
            if length > 0.0 { sum.map(|c| c / length) } else { [0.0; 3] }
        })
        .collect()
}

fn topology(triangles: &[[u32; 3]], nodes: &[u32], overlapping_faces: usize) -> Topology {
    let mut edges: HashMap<[u32; 2], Vec<u32>> = HashMap::with_capacity(2 * triangles.len());
    for (index, &[a, b, c]) in triangles.iter().enumerate() {
        for edge in [[a, b], [b, c], [c, a]] {
            edges.entry(sorted(edge)).or_default().push(index as u32);
        }
    }
    let mut pieces = UnionFind::new(triangles.len());
    // Fans: corner c of triangle t is item 3t + c. Corners at one node are joined across shared edges.
    let mut fans = UnionFind::new(3 * triangles.len());
    let corner = |triangle: u32, node: u32| {
        let at =
            triangles[triangle as usize].iter().position(|&n| n == node).expect("the edge is the triangle's");
        3 * triangle as usize + at
    };
    for (edge, sharing) in &edges {
        for pair in sharing.windows(2) {
            pieces.join(pair[0] as usize, pair[1] as usize);
            for &node in edge {
                fans.join(corner(pair[0], node), corner(pair[1], node));
            }
        }
    }
    let mut fans_of_node: HashMap<u32, Vec<usize>> = HashMap::with_capacity(nodes.len());
    for (index, &node) in triangles.iter().flatten().enumerate() {
        fans_of_node.entry(node).or_default().push(fans.root(index));
    }
    let one_fan = |roots: &Vec<usize>| roots.iter().all(|root| root == &roots[0]);
    Topology {
        non_manifold_edges: edges.values().filter(|sharing| sharing.len() != 2).count(),
        non_manifold_nodes: fans_of_node.values().filter(|roots| !one_fan(roots)).count(),
        overlapping_faces,
        euler_characteristic: nodes.len() as i64 - edges.len() as i64 + triangles.len() as i64,
        pieces: pieces.sets(),
    }
}

/// Connected pieces of the body: the piece index of each node. Pieces are numbered by their lowest node.
///
/// Tets with a shared node belong to one piece, because the node transmits force in the finite-element model.
pub(crate) fn pieces(mesh: &TetMesh) -> Vec<u32> {
    let mut sets = UnionFind::new(mesh.nodes_m.len());
    for tet in &mesh.tets {
        for &node in &tet[1..] {
            sets.join(tet[0] as usize, node as usize);
        }
    }
    let mut number = HashMap::new();
    (0..mesh.nodes_m.len())
        .map(|node| {
            let next = number.len() as u32;
            *number.entry(sets.root(node)).or_insert(next)
        })
        .collect()
}

/// Disjoint sets of items 0 .. n.
pub(crate) struct UnionFind {
    parent: Vec<usize>,
}

impl UnionFind {
    /// `n` sets of one item each.
    pub(crate) fn new(n: usize) -> Self {
        Self { parent: (0..n).collect() }
    }

    /// The representative item of the set that contains `item`.
    pub(crate) fn root(&mut self, mut item: usize) -> usize {
        while self.parent[item] != item {
            self.parent[item] = self.parent[self.parent[item]];
            item = self.parent[item];
        }
        item
    }

    /// Joins the sets of `a` and `b`.
    pub(crate) fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        // The lower index becomes the root, so that the result is independent of the order of the joins.
        self.parent[a.max(b)] = a.min(b);
    }

    fn sets(&mut self) -> usize {
        (0..self.parent.len()).filter(|&item| self.root(item) == item).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::testing::{cube, unit_tet};
    use crate::mesh::tetrahedral::six_volume;

    #[test]
    fn every_triangle_looks_outward() {
        // Divergence theorem: the integral of x . n / 3 is the volume for outward normals, minus the volume
        // for inward ones.
        let mesh = cube(3, 0.5);
        let surface = Surface::of(&mesh);
        let flux: f64 = surface
            .triangles
            .iter()
            .map(|t| dot(mesh.nodes_m[t[0] as usize], twice_area(&mesh, t)) / 6.0)
            .sum();
        assert!((flux - mesh.volume_m3()).abs() < 1e-14, "{flux}");
        let centre = [0.25; 3];
        for triangle in &surface.triangles {
            let outward = difference(mesh.nodes_m[triangle[0] as usize], centre);
            assert!(dot(outward, twice_area(&mesh, triangle)) > 0.0);
        }
        assert!((surface.area_m2(&mesh) - 6.0 * 0.25).abs() < 1e-14);
    }

    #[test]
    fn a_cube_is_a_sphere_to_topology() {
        let mesh = cube(4, 1.0);
        let surface = Surface::of(&mesh);
        assert_eq!(surface.triangles.len(), 6 * 16 * 2);
        assert_eq!(surface.nodes.len(), 125 - 27);
        assert!(surface.topology.is_manifold());
        assert_eq!(surface.topology.euler_characteristic, 2);
        assert_eq!(surface.topology.pieces, 1);
        assert!(pieces(&mesh).iter().all(|&piece| piece == 0));
        assert!(surface.nodes.is_sorted());
        assert!(!surface.contains(62), "the centre of 5^3 nodes is inside");
        assert_eq!(surface.normal(62), None);
        assert_eq!(surface.normal(2 * 5 + 2), Some([-1.0, 0.0, 0.0]), "the middle of the low x side");
    }

    #[test]
    fn normals_are_weighted_by_area() {
        let (nodes, tets) = unit_tet();
        let surface = Surface::of(&TetMesh::new(nodes, tets).expect("sound"));
        // Three right triangles of equal area meet at the origin.
        let third = -(1.0 / 3.0f64).sqrt();
        for c in surface.normal(0).expect("on the surface") {
            assert!((c - third).abs() < 1e-15);
        }
        // At (1,0,0), the area vectors (1,1,1)/2, (0,-1,0)/2 and (0,0,-1)/2 add up to (1,0,0)/2.
        assert_eq!(surface.normal(1), Some([1.0, 0.0, 0.0]));
    }

    /// Two tets that share the given number of vertices.
    fn pair(shared: usize) -> TetMesh {
        let mut nodes = unit_tet().0;
        let mirrored = [[-1.0, -1.0, -1.0], [-2.0, -1.0, -1.0], [-1.0, -2.0, -1.0], [-1.0, -1.0, -2.0]];
        nodes.extend(&mirrored[shared..]);
        let mut second = match shared {
            0 => [4, 5, 6, 7],
            1 => [0, 4, 5, 6],
            _ => [0, 1, 4, 5],
        };
        if six_volume(&second.map(|n: u32| nodes[n as usize])) < 0.0 {
            second.swap(0, 1);
        }
        TetMesh::new(nodes, vec![[0, 1, 2, 3], second]).expect("sound")
    }

    #[test]
    fn touching_and_separate_parts_are_told_apart() {
        let separate = pair(0);
        assert_eq!(pieces(&separate), [0, 0, 0, 0, 1, 1, 1, 1]);
        let apart = Surface::of(&separate).topology;
        assert!(apart.is_manifold());
        assert_eq!((apart.pieces, apart.euler_characteristic), (2, 4));

        let at_node = pair(1);
        assert!(pieces(&at_node).iter().all(|&p| p == 0), "force passes through the node");
        let topology = Surface::of(&at_node).topology;
        assert_eq!((topology.non_manifold_nodes, topology.non_manifold_edges), (1, 0));
        assert!(!topology.is_manifold());

        let at_edge = Surface::of(&pair(2)).topology;
        assert_eq!(at_edge.non_manifold_edges, 1);
        assert!(!at_edge.is_manifold());
    }

    #[test]
    fn overlapping_tets_are_counted() {
        let (mut nodes, mut tets) = unit_tet();
        nodes.push([0.1, 0.1, 2.0]);
        nodes.push([0.2, 0.1, 3.0]);
        tets.push([0, 1, 2, 4]);
        tets.push([0, 1, 2, 5]);
        let topology = Surface::of(&TetMesh::new(nodes, tets).expect("sound")).topology;
        assert_eq!(topology.overlapping_faces, 1);
        assert!(!topology.is_manifold());
    }
}
