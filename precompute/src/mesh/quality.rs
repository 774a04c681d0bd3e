//! Quality measures of a mesh for finite elements.

use std::collections::HashMap;

use serde::Serialize;

use super::surface::{FACES, Topology};
use super::tetrahedral::{EDGES, Edges, sorted};
use super::{Surface, TetMesh, surface};
use crate::num::vector::distance;
use shape::{aspect, dihedral_angles_deg};

pub use pressure::doubtful_for_pressure;

mod display;
mod pressure;
mod shape;

/// Width of a bin of [`MeshReport::dihedral_histogram`], degrees.
pub(crate) const BIN_DEG: f64 = 10.0;
const BINS: usize = 18;
/// Width of a bin of [`MeshReport::min_dihedral_histogram`], degrees.
pub(crate) const MIN_BIN_DEG: f64 = 5.0;
/// The smallest dihedral angle of a tet is at most 70.53 degrees, the angle of the regular tet.
const MIN_BINS: usize = 15;
/// A tet with a dihedral angle below this is a sliver.
pub(crate) const SLIVER_DEG: f64 = 5.0;
/// Neighbouring tets with a larger volume ratio form a size jump.
pub(crate) const SIZE_JUMP: f64 = 100.0;

/// Size, shape and topology of a mesh. `Display` is a table for users, `Serialize` gives JSON.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MeshReport {
    /// Number of nodes.
    pub nodes: usize,
    /// Number of tets.
    pub tets: usize,
    /// Number of edges, that is, of the mid-edge nodes that order 2 adds.
    pub edges: usize,
    /// Number of separate pieces; more than one is usually a mistake.
    pub pieces: usize,
    /// Share of the largest piece in the volume.
    pub largest_piece_share: f64,
    /// Low corner of the bounding box, m.
    pub low_m: [f64; 3],
    /// High corner of the bounding box, m.
    pub high_m: [f64; 3],
    /// Volume of the body, m^3.
    pub volume_m3: f64,
    /// Volumes of the tets, m^3.
    pub tet_volume_m3: Range,
    /// Lengths of the edges, each edge once, m.
    pub edge_m: Range,
    /// Dihedral angles, six per tet, degrees; 70.5 in a regular tet. Small angles make elements stiff and
    /// ill-conditioned, large angles increase the error of the gradients.
    pub dihedral_deg: Range,
    /// 0-based index of the tet with the smallest dihedral angle.
    pub worst_tet: usize,
    /// Number of dihedral angles in each bin of `BIN_DEG` from 0 to 180.
    pub dihedral_histogram: [usize; BINS],
    /// Smallest dihedral angle of each tet, degrees.
    pub min_dihedral_deg: Range,
    /// Number of tets by their smallest dihedral angle, in bins of `MIN_BIN_DEG` from 0 to 75.
    pub min_dihedral_histogram: [usize; MIN_BINS],
    /// Tets with a very small dihedral angle.
    pub slivers: Slivers,
    /// Ratio of the longest edge to the diameter of the inscribed sphere, scaled to 1 for a regular tet.
    pub aspect: Range,
    /// Neighbouring tets of very different volume.
    pub size_jumps: SizeJumps,
    /// Number of tets with 0, 1, 2, 3 and 4 faces on the surface. A tet with three such faces is connected by
    /// one face only.
    pub tets_by_free_faces: [usize; 5],
    /// Tets with all four vertices on the surface. Second-order elements with vertex pressures should have
    /// none.
    pub tets_without_interior_vertex: usize,
    /// Measures of the surface.
    pub surface: SurfaceReport,
    /// Named groups: number of nodes and, for groups of volumes, of tets.
    pub groups: Vec<GroupReport>,
}

/// Tets with a very small dihedral angle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Slivers {
    /// Number below 5 degrees, including those below 1 degree.
    pub below_5_deg: usize,
    /// Number below 1 degree.
    pub below_1_deg: usize,
}

/// Pairs of tets with a common face and very different volumes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SizeJumps {
    /// Number of pairs with a ratio above [`SIZE_JUMP`].
    pub pairs: usize,
    /// The largest volume ratio of neighbours; 1 without neighbours.
    pub worst_ratio: f64,
    /// 0-based indices of the two tets with that ratio.
    pub worst_pair: [usize; 2],
}

/// Statistics of a set of values.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Range {
    /// Minimum.
    pub min: f64,
    /// Median; the lower of the two middle values for an even number.
    pub median: f64,
    /// Arithmetic mean.
    pub mean: f64,
    /// Maximum.
    pub max: f64,
}

/// Measures of the surface.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SurfaceReport {
    /// Number of nodes.
    pub nodes: usize,
    /// Share of the body's nodes.
    pub node_share: f64,
    /// Number of triangles.
    pub triangles: usize,
    /// Area, m^2.
    pub area_m2: f64,
    /// Whether the surface is a closed manifold.
    pub manifold: bool,
    /// Defects of the surface as a closed manifold.
    #[serde(flatten)]
    pub topology: Topology,
}

/// Size of a named group.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct GroupReport {
    /// Its name.
    pub name: String,
    /// Number of nodes.
    pub nodes: usize,
    /// Number of tets.
    pub tets: usize,
}

impl MeshReport {
    /// Computes the measures of a mesh.
    pub fn of(mesh: &TetMesh) -> Self {
        let skin = Surface::of(mesh);
        let (low_m, high_m) = mesh.bounding_box_m();
        let angles: Vec<[f64; 6]> =
            (0..mesh.tets.len()).map(|tet| dihedral_angles_deg(&mesh.vertices_m(tet))).collect();
        let mut dihedral_histogram = [0; BINS];
        for angle in angles.iter().flatten() {
            dihedral_histogram[((angle / BIN_DEG) as usize).min(BINS - 1)] += 1;
        }
        let smallest: Vec<f64> =
            angles.iter().map(|angles| angles.iter().copied().fold(f64::INFINITY, f64::min)).collect();
        let mut min_dihedral_histogram = [0; MIN_BINS];
        for angle in &smallest {
            min_dihedral_histogram[((angle / MIN_BIN_DEG) as usize).min(MIN_BINS - 1)] += 1;
        }
        let worst_tet = (0..angles.len()).min_by(|&a, &b| smallest[a].total_cmp(&smallest[b])).unwrap_or(0);
        let below = |bound: f64| smallest.iter().filter(|&&angle| angle < bound).count();
        let edge_m: Vec<f64> = Edges::of(mesh, EDGES)
            .ends
            .iter()
            .map(|ends| {
                let [a, b] = ends.map(|end| mesh.nodes_m[end as usize]);
                distance(a, b)
            })
            .collect();
        let (pieces, largest_piece_share) = pieces(mesh);
        let (size_jumps, tets_by_free_faces) = neighbours(mesh);
        let on_surface = |tet: &&[u32; 4]| tet.iter().all(|&node| skin.contains(node));
        let group = |(name, nodes): (&String, &Vec<u32>)| GroupReport {
            name: name.clone(),
            nodes: nodes.len(),
            tets: mesh.tet_groups.get(name).map_or(0, Vec::len),
        };
        Self {
            nodes: mesh.nodes_m.len(),
            tets: mesh.tets.len(),
            edges: edge_m.len(),
            pieces,
            largest_piece_share,
            low_m,
            high_m,
            volume_m3: mesh.volume_m3(),
            tet_volume_m3: Range::of((0..mesh.tets.len()).map(|tet| mesh.signed_volume_m3(tet))),
            edge_m: Range::of(edge_m.into_iter()),
            dihedral_deg: Range::of(angles.iter().flatten().copied()),
            worst_tet,
            dihedral_histogram,
            slivers: Slivers { below_5_deg: below(SLIVER_DEG), below_1_deg: below(1.0) },
            min_dihedral_deg: Range::of(smallest.into_iter()),
            min_dihedral_histogram,
            aspect: Range::of((0..mesh.tets.len()).map(|tet| aspect(&mesh.vertices_m(tet)))),
            size_jumps,
            tets_by_free_faces,
            tets_without_interior_vertex: mesh.tets.iter().filter(on_surface).count(),
            surface: SurfaceReport {
                nodes: skin.nodes.len(),
                node_share: skin.nodes.len() as f64 / mesh.nodes_m.len() as f64,
                triangles: skin.triangles.len(),
                area_m2: skin.area_m2(mesh),
                manifold: skin.topology.is_manifold(),
                topology: skin.topology,
            },
            groups: mesh.node_groups.iter().map(group).collect(),
        }
    }
}

impl Range {
    fn of(values: impl Iterator<Item = f64>) -> Self {
        let mut values: Vec<f64> = values.collect();
        // Summed in file order, before the sort.
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        values.sort_unstable_by(f64::total_cmp);
        let at = |index: usize| values.get(index).copied().unwrap_or(f64::NAN);
        let last = values.len().saturating_sub(1);
        Self { min: at(0), median: at(last / 2), mean, max: at(last) }
    }
}

/// Number of pieces, and the share of the largest in the volume.
fn pieces(mesh: &TetMesh) -> (usize, f64) {
    let piece_of = surface::pieces(mesh);
    let mut volumes = vec![0.0; piece_of.iter().max().map_or(0, |&last| last as usize + 1)];
    for (tet, nodes) in mesh.tets.iter().enumerate() {
        volumes[piece_of[nodes[0] as usize] as usize] += mesh.signed_volume_m3(tet);
    }
    (volumes.len(), volumes.iter().copied().fold(0.0, f64::max) / volumes.iter().sum::<f64>())
}

/// Size jumps across the inner faces, and the number of tets by their number of free faces.
fn neighbours(mesh: &TetMesh) -> (SizeJumps, [usize; 5]) {
    let mut other: HashMap<[u32; 3], usize> = HashMap::with_capacity(2 * mesh.tets.len() + 2);
    let mut free = vec![4usize; mesh.tets.len()];
    let mut jumps = SizeJumps { pairs: 0, worst_ratio: 1.0, worst_pair: [0, 0] };
    for (tet, nodes) in mesh.tets.iter().enumerate() {
        for face in FACES {
            let Some(before) = other.insert(sorted(face.map(|v| nodes[v])), tet) else { continue };
            free[before] = free[before].saturating_sub(1);
            free[tet] = free[tet].saturating_sub(1);
            let ratio = mesh.signed_volume_m3(before) / mesh.signed_volume_m3(tet);
            let ratio = ratio.max(ratio.recip());
            jumps.pairs += usize::from(ratio > SIZE_JUMP);
            if ratio > jumps.worst_ratio {
                (jumps.worst_ratio, jumps.worst_pair) = (ratio, [before, tet]);
            }
        }
    }
    let mut by_free_faces = [0; 5];
    for n in free {
        by_free_faces[n] += 1;
    }
    (jumps, by_free_faces)
}

#[cfg(test)]
mod tests;
