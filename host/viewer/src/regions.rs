//! The boundaries of regions inside a body. A blob holds neither them nor their displacements, so these are
//! estimated from the skin's.

use glam::Vec3;

/// A triangulated boundary that follows the skin.
///
/// Its vertex i is at o_i + sum_j w_ij x_j, with x_j the present position of vertex j of the skin.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Regions {
    /// o_i, m.
    pub offset_m: Vec<[f32; 3]>,
    /// (j, w_ij) of each vertex; the weights of a vertex have sum 1.
    pub weights: Vec<Vec<(u32, f32)>>,
    /// Vertices of each triangle, in any order; all in range.
    pub triangles: Vec<[u32; 3]>,
}

impl Regions {
    /// The vertices for these positions of the skin, m. A vertex of the skin that does not exist has no weight.
    pub(super) fn position_into(&self, skin_m: &[Vec3], position_m: &mut Vec<Vec3>) {
        position_m.clear();
        position_m.extend(self.offset_m.iter().zip(&self.weights).map(|(offset_m, weights)| {
            let places =
                weights.iter().filter_map(|(vertex, weight)| Some((skin_m.get(*vertex as usize)?, weight)));
            places.fold(Vec3::from_array(*offset_m), |sum, (place_m, weight)| sum + *place_m * *weight)
        }));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_boundary_follows_the_mean_of_the_skin() {
        let regions = Regions {
            offset_m: vec![[0.0, 0.0, -0.01]],
            weights: vec![vec![(0, 0.25), (2, 0.75), (99, 0.5)]],
            triangles: Vec::new(),
        };
        let (mut found, rest) = (Vec::new(), [Vec3::ZERO, Vec3::ONE, Vec3::X]);
        regions.position_into(&rest, &mut found);
        assert_eq!(found, [Vec3::new(0.75, 0.0, -0.01)]);
        regions.position_into(&rest.map(|place| place + Vec3::Y), &mut found);
        assert_eq!(found, [Vec3::new(0.75, 1.0, -0.01)]);
    }
}
