//! The boundaries between the materials of a body at rest, which a blob does not hold.

use glam::Vec3;

/// A triangulated boundary.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Regions {
    /// Its vertices at rest, m.
    pub position_m: Vec<[f32; 3]>,
    /// Vertices of each triangle, in any order; all in range.
    pub triangles: Vec<[u32; 3]>,
}

impl Regions {
    /// The vertices as vectors.
    pub(super) fn points_m(&self) -> Vec<Vec3> {
        self.position_m.iter().copied().map(Vec3::from_array).collect()
    }
}
