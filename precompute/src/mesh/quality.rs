//! How good a mesh is for finite elements, in the figures an engineer looks at first.

use std::collections::HashSet;
use std::fmt;

use serde::Serialize;

use super::tetrahedral::{EDGES, cross, distance, dot, norm, sorted, sub};
use super::{Surface, TetMesh, surface};

/// Width of a bin of [`MeshReport::dihedral_histogram`] in degrees.
pub const BIN_DEG: f64 = 10.0;
const BINS: usize = 18;

/// Size, shape and topology of a mesh. `Display` is the human table, `Serialize` the JSON.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MeshReport {
    /// Number of nodes.
    pub nodes: usize,
    /// Number of tets.
    pub tets: usize,
    /// Separate pieces of the body; more than one is seldom meant.
    pub pieces: usize,
    /// Low corner of the bounding box.
    pub low_m: [f64; 3],
    /// High corner of the bounding box.
    pub high_m: [f64; 3],
    /// Volume of the body.
    pub volume_m3: f64,
    /// Volume of the smallest and the largest tet.
    pub tet_volume_m3: Range,
    /// Lengths of the edges, each edge once.
    pub edge_m: Range,
    /// Angles between the faces of each tet, six per tet; 70.5 in a regular one. Small ones make stiff, ill-conditioned
    /// elements, large ones spoil the gradients.
    pub dihedral_deg: Range,
    /// The tet with the smallest dihedral angle, 0-based.
    pub worst_tet: usize,
    /// Dihedral angles counted in bins of [`BIN_DEG`] from 0 to 180.
    pub dihedral_histogram: [usize; BINS],
    /// Tets with all four vertices on the surface. Second-order elements with a pressure at the vertices want none.
    pub tets_without_interior_vertex: usize,
    /// Figures of the surface.
    pub surface: SurfaceReport,
    /// Named groups: nodes and, for groups of volumes, tets.
    pub groups: Vec<GroupReport>,
}

/// Lowest, mean and highest value.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Range {
    /// Lowest.
    pub min: f64,
    /// Arithmetic mean.
    pub mean: f64,
    /// Highest.
    pub max: f64,
}

/// Figures of the surface.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SurfaceReport {
    /// Nodes on it.
    pub nodes: usize,
    /// Triangles.
    pub triangles: usize,
    /// Area.
    pub area_m2: f64,
    /// Whether it is a closed manifold.
    pub manifold: bool,
    /// 2 for a body without handles and cavities.
    pub euler_characteristic: i64,
    /// Closed surfaces: one, and one more for each cavity.
    pub pieces: usize,
}

/// Size of a named group.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct GroupReport {
    /// Its name.
    pub name: String,
    /// Its nodes.
    pub nodes: usize,
    /// Its tets.
    pub tets: usize,
}

impl MeshReport {
    /// Measures a mesh.
    pub fn of(mesh: &TetMesh) -> Self {
        let skin = Surface::of(mesh);
        let (low_m, high_m) = mesh.bounding_box_m();
        let angles: Vec<[f64; 6]> =
            (0..mesh.tets.len()).map(|tet| dihedral_angles_deg(&mesh.vertices_m(tet))).collect();
        let mut dihedral_histogram = [0; BINS];
        for angle in angles.iter().flatten() {
            dihedral_histogram[((angle / BIN_DEG) as usize).min(BINS - 1)] += 1;
        }
        let smallest = |tet: &usize| angles[*tet].iter().copied().fold(f64::INFINITY, f64::min);
        let worst_tet = (0..angles.len()).min_by(|a, b| smallest(a).total_cmp(&smallest(b))).unwrap_or(0);
        let on_surface = |tet: &&[u32; 4]| tet.iter().all(|&node| skin.contains(node));
        let group = |(name, nodes): (&String, &Vec<u32>)| GroupReport {
            name: name.clone(),
            nodes: nodes.len(),
            tets: mesh.tet_groups.get(name).map_or(0, Vec::len),
        };
        Self {
            nodes: mesh.nodes_m.len(),
            tets: mesh.tets.len(),
            pieces: surface::pieces(mesh).iter().max().map_or(0, |&last| last as usize + 1),
            low_m,
            high_m,
            volume_m3: mesh.volume_m3(),
            tet_volume_m3: Range::of((0..mesh.tets.len()).map(|tet| mesh.signed_volume_m3(tet))),
            edge_m: Range::of(edge_lengths(mesh).into_iter()),
            dihedral_deg: Range::of(angles.iter().flatten().copied()),
            worst_tet,
            dihedral_histogram,
            tets_without_interior_vertex: mesh.tets.iter().filter(on_surface).count(),
            surface: SurfaceReport {
                nodes: skin.nodes.len(),
                triangles: skin.triangles.len(),
                area_m2: skin.area_m2(mesh),
                manifold: skin.topology.is_manifold(),
                euler_characteristic: skin.topology.euler_characteristic,
                pieces: skin.topology.pieces,
            },
            groups: mesh.node_groups.iter().map(group).collect(),
        }
    }
}

impl Range {
    fn of(values: impl Iterator<Item = f64>) -> Self {
        let (mut min, mut sum, mut max, mut n) = (f64::INFINITY, 0.0, f64::NEG_INFINITY, 0u64);
        for value in values {
            min = min.min(value);
            max = max.max(value);
            sum += value;
            n += 1;
        }
        Self { min, mean: sum / n as f64, max }
    }
}

/// The angles between faces at the six edges, in the order of [`EDGES`].
///
/// At the edge from a to b with the other vertices c, d: the angle between (b-a) x (c-a) and (b-a) x (d-a), by
/// atan2, which is good near 0 and 180 degrees where acos loses half its digits.
fn dihedral_angles_deg(x: &[[f64; 3]; 4]) -> [f64; 6] {
    // EDGES[5 - e] is the edge opposite to EDGES[e].
    std::array::from_fn(|e| {
        let ((a, b), (c, d)) = (EDGES[e], EDGES[5 - e]);
        let edge = sub(&x[b], &x[a]);
        let first = cross(&edge, &sub(&x[c], &x[a]));
        let second = cross(&edge, &sub(&x[d], &x[a]));
        norm(&cross(&first, &second)).atan2(dot(&first, &second)).to_degrees()
    })
}

/// Length of each edge once, in order of first appearance.
fn edge_lengths(mesh: &TetMesh) -> Vec<f64> {
    let mut seen = HashSet::with_capacity(2 * mesh.tets.len());
    let mut lengths = Vec::new();
    for tet in &mesh.tets {
        for (a, b) in EDGES {
            if seen.insert(sorted([tet[a], tet[b]])) {
                lengths.push(distance(&mesh.nodes_m[tet[a] as usize], &mesh.nodes_m[tet[b] as usize]));
            }
        }
    }
    lengths
}

impl fmt::Display for MeshReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mm = |c: f64| 1e3 * c;
        let [x, y, z] = [0, 1, 2].map(|axis| mm(self.high_m[axis] - self.low_m[axis]));
        let s = &self.surface;
        writeln!(f, "nodes                 {} ({} on the surface)", self.nodes, s.nodes)?;
        writeln!(f, "tets                  {} in {} piece(s)", self.tets, self.pieces)?;
        writeln!(
            f,
            "size                  {x:.1} x {y:.1} x {z:.1} mm, volume {:.3} ml",
            1e6 * self.volume_m3
        )?;
        let manifold = if s.manifold { "closed manifold" } else { "NOT a closed manifold" };
        let area = 1e4 * s.area_m2;
        writeln!(f, "surface               {} triangles, {area:.1} cm2, {} piece(s)", s.triangles, s.pieces)?;
        writeln!(f, "                      {manifold}, Euler characteristic {}", s.euler_characteristic)?;
        let Range { min, mean, max } = self.edge_m;
        writeln!(f, "edges                 {:.2} to {:.2} mm, mean {:.2} mm", mm(min), mm(max), mm(mean))?;
        let Range { min, max, .. } = self.tet_volume_m3;
        writeln!(f, "tet volumes           {:.3e} to {:.3e} mm3", 1e9 * min, 1e9 * max)?;
        let Range { min, mean, max } = self.dihedral_deg;
        let worst = self.worst_tet;
        writeln!(
            f,
            "dihedral angles       {min:.1} to {max:.1} degrees, mean {mean:.1}; smallest in tet {worst}"
        )?;
        let most = self.dihedral_histogram.iter().copied().max().unwrap_or(1).max(1);
        for (bin, &n) in self.dihedral_histogram.iter().enumerate() {
            let from = BIN_DEG * bin as f64;
            // A bin with anything in it shows at least one mark: the rare bad angles are what one looks for.
            let bar = "#".repeat((40 * n).div_ceil(most));
            writeln!(
                f,
                "    {from:>3.0} to {:>3.0}        {n:>7}{}{bar}",
                from + BIN_DEG,
                if n > 0 { " " } else { "" }
            )?;
        }
        write!(f, "no interior vertex    {} tets", self.tets_without_interior_vertex)?;
        for group in &self.groups {
            write!(f, "\ngroup \"{}\": {} nodes, {} tets", group.name, group.nodes, group.tets)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::testing::{cube, unit_tet};

    #[test]
    fn dihedral_angles_of_known_tets() {
        let (nodes, _) = unit_tet();
        let corner = dihedral_angles_deg(&[nodes[0], nodes[1], nodes[2], nodes[3]]);
        let slant = 3f64.sqrt().recip().acos().to_degrees();
        for (angle, expected) in corner.iter().zip([90.0, 90.0, 90.0, slant, slant, slant]) {
            assert!((angle - expected).abs() < 1e-12, "{corner:?}");
        }
        let regular = [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]];
        for angle in dihedral_angles_deg(&regular) {
            assert!((angle - (1.0f64 / 3.0).acos().to_degrees()).abs() < 1e-12);
        }
    }

    #[test]
    fn a_cube_reports_what_can_be_counted_by_hand() {
        let mut mesh = cube(2, 0.2);
        mesh.node_groups.insert("base".into(), vec![0, 1]);
        let report = MeshReport::of(&mesh);
        assert_eq!((report.nodes, report.tets, report.pieces), (27, 48, 1));
        assert_eq!((report.surface.nodes, report.surface.triangles), (26, 48));
        assert!(report.surface.manifold);
        assert!((report.volume_m3 - 8e-3).abs() < 1e-17);
        assert!((report.tet_volume_m3.min - 1e-3 / 6.0).abs() < 1e-17);
        assert!((report.edge_m.min - 0.1).abs() < 1e-16);
        assert!((report.edge_m.max - 0.1 * 3f64.sqrt()).abs() < 1e-16);
        // Kuhn's tets have two dihedral angles of 45 degrees, one of 60 and three of 90.
        assert!((report.dihedral_deg.min - 45.0).abs() < 1e-10);
        assert!((report.dihedral_deg.max - 90.0).abs() < 1e-10);
        assert_eq!(report.dihedral_histogram.iter().sum::<usize>(), 6 * 48);
        // Every cell's main diagonal either ends in the one interior node or joins two surface nodes.
        let centre = 13;
        let without = mesh.tets.iter().filter(|tet| !tet.contains(&centre)).count();
        assert_eq!(report.tets_without_interior_vertex, without);
        assert_eq!(report.groups, [GroupReport { name: "base".into(), nodes: 2, tets: 0 }]);
        let text = report.to_string();
        assert!(text.contains("nodes                 27 (26 on the surface)"), "{text}");
        assert!(text.contains("group \"base\": 2 nodes, 0 tets"), "{text}");
    }
}
