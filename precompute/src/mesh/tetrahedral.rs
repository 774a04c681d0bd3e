//! The mesh: nodes, linear tetrahedra and named groups of both.
//!
//! [`TetMesh::new`] and the readers ensure these invariants: all coordinates are finite, all indices are in
//! range, all tets have positive volume, no tet occurs twice, and each node belongs to a tet. The solver
//! relies on them: a node without a tet gives a zero row, and a repeated tet counts its stiffness twice.

use std::collections::{BTreeMap, HashMap};

use crate::num::vector::{cross, difference, distance, dot};

/// A tetrahedral mesh in metres. Node i is the i-th node of the file, independent of its tag there.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TetMesh {
    /// Node positions in metres, in file order.
    pub nodes_m: Vec<[f64; 3]>,
    /// Vertices of each tet, in file order; det[x1-x0, x2-x0, x3-x0] > 0.
    pub tets: Vec<[u32; 4]>,
    /// Nodes of each named group of any dimension; sorted and unique.
    pub node_groups: BTreeMap<String, Vec<u32>>,
    /// Tets of each named group of volumes; sorted and unique.
    pub tet_groups: BTreeMap<String, Vec<u32>>,
}

/// A violated invariant of a mesh. Indices are 0-based, in file order.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum MeshFault {
    /// The mesh has no tet.
    #[error("the mesh holds no tetrahedra")]
    Empty,
    /// A coordinate is NaN or infinite.
    #[error("node {node} has a coordinate that is not finite")]
    NotFinite {
        /// The node.
        node: u32,
    },
    /// A tet refers to a node that does not exist.
    #[error("tet {tet} names node {node}, which does not exist")]
    NoSuchNode {
        /// The tet.
        tet: u32,
        /// The node index.
        node: u32,
    },
    /// A tet has no positive volume; from [`TetMesh::new`] exactly zero: two vertices coincide, or all four
    /// lie in a plane.
    #[error("tet {tet} has no positive volume")]
    Flat {
        /// The tet.
        tet: u32,
    },
    /// A tet has negative volume.
    #[error("tet {tet} has negative volume ({volume:e})")]
    Negative {
        /// The tet.
        tet: u32,
        /// Signed volume, m^3 (before scaling: in the cubed unit of the file).
        volume: f64,
        /// Number of tets with negative volume.
        of_all: u32,
    },
    /// Two tets have the same four vertices.
    #[error("tet {tet} has the same vertices as tet {first}")]
    Repeated {
        /// The second one.
        tet: u32,
        /// The first one.
        first: u32,
    },
    /// A node belongs to no tet.
    #[error("node {node} belongs to no tet")]
    Isolated {
        /// The node.
        node: u32,
        /// Number of nodes without a tet.
        of_all: u32,
    },
}

/// Below this share of (longest edge)^3, six times the volume is rounding error.
///
/// The determinant of three differences of f64 coordinates has an error of a few 1e-16 of (longest edge)^3 if
/// the body is near the origin. 1e-12 also allows a body 1000 edge lengths away from it. A tet of this volume
/// is far flatter (height over edge) than the tets of any mesh generator.
const FLAT_SHARE: f64 = 1e-12;

impl TetMesh {
    /// A checked mesh without groups; nodes in metres.
    pub fn new(nodes_m: Vec<[f64; 3]>, tets: Vec<[u32; 4]>) -> Result<Self, MeshFault> {
        let mesh = Self { nodes_m, tets, ..Self::default() };
        mesh.check()?;
        Ok(mesh)
    }

    /// A box of `cells` cubes of edge `edge_m` with a corner at the origin. Each cube is divided into six
    /// tets that share its main diagonal (Kuhn). Node (i, j, k) has the index (i (ny + 1) + j)(nz + 1) + k.
    pub fn cuboid(cells: [usize; 3], edge_m: f64) -> Self {
        let [nx, ny, nz] = cells;
        let node = |[i, j, k]: [usize; 3]| ((i * (ny + 1) + j) * (nz + 1) + k) as u32;
        let mut mesh = Self::default();
        for i in 0..=nx {
            for j in 0..=ny {
                mesh.nodes_m.extend((0..=nz).map(|k| [i, j, k].map(|n| n as f64 * edge_m)));
            }
        }
        for cell in 0..nx * ny * nz {
            let low = [cell / (ny * nz), cell / nz % ny, cell % nz];
            for order in [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]] {
                // Paths from the low to the high corner along the axes; an odd permutation of the axes gives
                // a mirror image.
                let mut corner = low;
                let mut tet = [node(low); 4];
                for (step, axis) in order.into_iter().enumerate() {
                    corner[axis] += 1;
                    tet[step + 1] = node(corner);
                }
                if matches!(order, [0, 2, 1] | [2, 1, 0] | [1, 0, 2]) {
                    tet.swap(2, 3);
                }
                mesh.tets.push(tet);
            }
        }
        mesh
    }

    /// Signed volume of a tet, m^3: det[x1-x0, x2-x0, x3-x0] / 6.
    pub fn signed_volume_m3(&self, tet: usize) -> f64 {
        six_volume(&self.vertices_m(tet)) / 6.0
    }

    /// Volume of the body, m^3. The sum runs in file order, so that its bits are reproducible.
    pub fn volume_m3(&self) -> f64 {
        (0..self.tets.len()).map(|tet| self.signed_volume_m3(tet)).sum()
    }

    /// Positions of a tet's four vertices, m.
    pub(crate) fn vertices_m(&self, tet: usize) -> [[f64; 3]; 4] {
        self.tets[tet].map(|node| self.nodes_m[node as usize])
    }

    /// Low and high corner of the axis-aligned bounding box, m.
    pub fn bounding_box_m(&self) -> ([f64; 3], [f64; 3]) {
        let mut low = [f64::INFINITY; 3];
        let mut high = [f64::NEG_INFINITY; 3];
        for x in &self.nodes_m {
            for axis in 0..3 {
                low[axis] = low[axis].min(x[axis]);
                high[axis] = high[axis].max(x[axis]);
            }
        }
        (low, high)
    }

    /// Length of the bounding box's diagonal, m: a measure of the body's size.
    pub fn diagonal_m(&self) -> f64 {
        let (low, high) = self.bounding_box_m();
        distance(low, high)
    }

    /// BLAKE3 hash of coordinates (bit patterns) and connectivity. Groups are excluded, because they affect
    /// results only through the selections of the scene.
    pub fn content_hash(&self) -> [u8; 32] {
        let mut hasher = blake3::Hasher::new_derive_key("palpate tetrahedral mesh v1");
        hasher.update(&(self.nodes_m.len() as u64).to_le_bytes());
        for x in self.nodes_m.iter().flatten() {
            hasher.update(&x.to_bits().to_le_bytes());
        }
        hasher.update(&(self.tets.len() as u64).to_le_bytes());
        for node in self.tets.iter().flatten() {
            hasher.update(&node.to_le_bytes());
        }
        *hasher.finalize().as_bytes()
    }

    /// Checks the invariants of the module's doc comment; returns the first fault in file order.
    pub fn check(&self) -> Result<(), MeshFault> {
        if self.tets.is_empty() {
            return Err(MeshFault::Empty);
        }
        check_nodes(&self.nodes_m, &self.tets)?;
        self.check_volumes()?;
        self.check_repeats()?;
        self.check_isolated()
    }

    fn check_volumes(&self) -> Result<(), MeshFault> {
        let mut negative: Option<(u32, f64)> = None;
        let mut of_all = 0;
        for tet in 0..self.tets.len() {
            let vertices = self.vertices_m(tet);
            let six_v = six_volume(&vertices);
            if six_v.abs() <= FLAT_SHARE * longest_edge(&vertices).powi(3) {
                return Err(MeshFault::Flat { tet: tet as u32 });
            }
            if six_v < 0.0 {
                negative.get_or_insert((tet as u32, six_v / 6.0));
                of_all += 1;
            }
        }
        negative.map_or(Ok(()), |(tet, volume)| Err(MeshFault::Negative { tet, volume, of_all }))
    }

    fn check_repeats(&self) -> Result<(), MeshFault> {
        let mut seen = HashMap::with_capacity(self.tets.len());
        for (tet, nodes) in self.tets.iter().enumerate() {
            if let Some(first) = seen.insert(sorted(*nodes), tet as u32) {
                return Err(MeshFault::Repeated { tet: tet as u32, first });
            }
        }
        Ok(())
    }

    fn check_isolated(&self) -> Result<(), MeshFault> {
        let mut used = vec![false; self.nodes_m.len()];
        for &node in self.tets.iter().flatten() {
            used[node as usize] = true;
        }
        let of_all = used.iter().filter(|&&used| !used).count() as u32;
        match used.iter().position(|&used| !used) {
            Some(node) => Err(MeshFault::Isolated { node: node as u32, of_all }),
            None => Ok(()),
        }
    }
}

/// Checks that all coordinates are finite and that the nodes of all elements exist.
pub(super) fn check_nodes<const N: usize>(
    nodes: &[[f64; 3]],
    elements: &[[u32; N]],
) -> Result<(), MeshFault> {
    if let Some(node) = nodes.iter().position(|x| x.iter().any(|c| !c.is_finite())) {
        return Err(MeshFault::NotFinite { node: node as u32 });
    }
    for (tet, members) in (0u32..).zip(elements) {
        if let Some(&node) = members.iter().find(|&&node| node as usize >= nodes.len()) {
            return Err(MeshFault::NoSuchNode { tet, node });
        }
    }
    Ok(())
}

/// The node indices in ascending order: identifies an element independent of its orientation.
pub(crate) fn sorted<const N: usize>(mut nodes: [u32; N]) -> [u32; N] {
    nodes.sort_unstable();
    nodes
}

/// Six times the signed volume: det[x1-x0, x2-x0, x3-x0].
pub(crate) fn six_volume(x: &[[f64; 3]; 4]) -> f64 {
    let a = difference(x[1], x[0]);
    let b = difference(x[2], x[0]);
    let c = difference(x[3], x[0]);
    dot(a, cross(b, c))
}

fn longest_edge(x: &[[f64; 3]; 4]) -> f64 {
    EDGES.iter().map(|&[i, j]| distance(x[i], x[j])).fold(0.0, f64::max)
}

/// The six edges of a tet as pairs of local vertices.
pub(crate) const EDGES: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];

/// The edges of a mesh, each once, in order of first use.
#[derive(Debug, Clone)]
pub(crate) struct Edges {
    /// The two nodes of each edge, in ascending order.
    pub(crate) ends: Vec<[u32; 2]>,
    /// The indices of the six edges of each tet.
    pub(crate) of_tets: Vec<[u32; 6]>,
}

impl Edges {
    /// The edges of a mesh; `pairs` gives the order of the edges of a tet.
    pub(crate) fn of(mesh: &TetMesh, pairs: [[usize; 2]; 6]) -> Self {
        let mut indices = HashMap::with_capacity(2 * mesh.tets.len());
        let mut ends = Vec::new();
        let mut index = |edge: [u32; 2]| {
            *indices.entry(edge).or_insert_with(|| {
                ends.push(edge);
                ends.len() as u32 - 1
            })
        };
        let of_tet = |tet: &[u32; 4]| pairs.map(|pair| index(sorted(pair.map(|v| tet[v]))));
        let of_tets = mesh.tets.iter().map(of_tet).collect();
        Self { ends, of_tets }
    }

    /// The middle of each edge, m.
    pub(crate) fn midpoints_m<'m>(&'m self, mesh: &'m TetMesh) -> impl Iterator<Item = [f64; 3]> + 'm {
        self.ends.iter().map(|ends| {
            let [a, b] = ends.map(|end| mesh.nodes_m[end as usize]);
            std::array::from_fn(|axis| 0.5 * (a[axis] + b[axis]))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::testing::{cube, unit_tet};

    #[test]
    fn volumes_are_signed_and_sum_to_the_body() {
        let (nodes, tets) = unit_tet();
        let mesh = TetMesh::new(nodes.clone(), tets).expect("the unit tet is sound");
        assert_eq!(mesh.signed_volume_m3(0), 1.0 / 6.0);
        let mirrored = TetMesh { nodes_m: nodes, tets: vec![[1, 0, 2, 3]], ..TetMesh::default() };
        assert_eq!(mirrored.signed_volume_m3(0), -1.0 / 6.0);
        let block = cube(3, 0.02);
        assert!((block.volume_m3() - 8e-6).abs() < 1e-18);
        assert!((block.diagonal_m() - 0.02 * 3f64.sqrt()).abs() < 1e-15);
    }

    #[test]
    fn each_fault_is_found_and_names_its_place() {
        let (nodes, tets) = unit_tet();
        let fault = |nodes: &[[f64; 3]], tets: &[[u32; 4]]| {
            TetMesh::new(nodes.to_vec(), tets.to_vec()).expect_err("planted fault")
        };
        assert_eq!(fault(&nodes, &[]), MeshFault::Empty);
        assert_eq!(fault(&nodes, &[[0, 1, 2, 4]]), MeshFault::NoSuchNode { tet: 0, node: 4 });
        assert_eq!(fault(&nodes, &[[0, 1, 2, 2]]), MeshFault::Flat { tet: 0 });
        let volume = -1.0 / 6.0;
        assert_eq!(fault(&nodes, &[[1, 0, 2, 3]]), MeshFault::Negative { tet: 0, volume, of_all: 1 });
        assert_eq!(fault(&nodes, &[tets[0], [1, 2, 0, 3]]), MeshFault::Repeated { tet: 1, first: 0 });
        let mut more = nodes.clone();
        more.push([2.0, 0.0, 0.0]);
        assert_eq!(fault(&more, &tets), MeshFault::Isolated { node: 4, of_all: 1 });
        for bad in [f64::NAN, f64::INFINITY] {
            let mut broken = nodes.clone();
            broken[2][1] = bad;
            assert_eq!(fault(&broken, &tets), MeshFault::NotFinite { node: 2 });
        }
    }

    #[test]
    fn flatness_is_judged_by_shape_not_by_size() {
        // A tet with edges of a micrometre has a volume of 1e-19 m^3 and is valid.
        let (nodes, tets) = unit_tet();
        let small: Vec<_> = nodes.iter().map(|x| x.map(|c| c * 1e-6)).collect();
        assert!(TetMesh::new(small, tets.clone()).is_ok());
        let mut squashed = nodes;
        squashed[3] = [0.3, 0.3, 1e-14];
        assert_eq!(TetMesh::new(squashed, tets).unwrap_err(), MeshFault::Flat { tet: 0 });
    }

    #[test]
    fn hash_sees_every_coordinate_and_every_vertex_and_no_group() {
        let mesh = cube(2, 0.1);
        let hash = mesh.content_hash();
        assert_eq!(hash, mesh.clone().content_hash());
        let mut moved = mesh.clone();
        moved.nodes_m[5][2] = f64::from_bits(moved.nodes_m[5][2].to_bits() + 1);
        assert_ne!(hash, moved.content_hash());
        let mut turned = mesh.clone();
        turned.tets[3].rotate_left(1);
        assert_ne!(hash, turned.content_hash());
        let mut grouped = mesh;
        grouped.node_groups.insert("F1".into(), vec![0]);
        assert_eq!(hash, grouped.content_hash());
    }
}
