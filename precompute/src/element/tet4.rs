//! Four-node tetrahedron with linear shape functions.

use nalgebra::{Matrix3, Vector3};

/// Constant-gradient tetrahedron in its undeformed place.
///
/// N_a(X) = a-th barycentric coordinate, a = 0..3;  grad N_a is constant, sum_a grad N_a = 0.
/// With the edge matrix D = [X1-X0, X2-X0, X3-X0]:  rows of D^-1 are grad N_1..3,  volume = det D / 6.
///
/// One quadrature point is exact for every law here, because F is constant in the element.
#[derive(Debug, Clone, Copy)]
pub struct Tet4 {
    /// Node indices, 0-based file order, positively oriented.
    pub nodes: [u32; 4],
    /// Undeformed volume, m^3, positive.
    pub volume_m3: f64,
    /// grad N_a, 1/m.
    pub gradients: [Vector3<f64>; 4],
}

impl Tet4 {
    /// Element of `nodes` at the positions `corners_m`; `None` if the volume is not positive.
    pub fn new(nodes: [u32; 4], corners_m: [[f64; 3]; 4]) -> Option<Self> {
        let x = corners_m.map(Vector3::from);
        let edges = Matrix3::from_columns(&[x[1] - x[0], x[2] - x[0], x[3] - x[0]]);
        let volume_m3 = edges.determinant() / 6.0;
        if !(volume_m3 > 0.0 && volume_m3.is_finite()) {
            return None;
        }
        let inverse = edges.try_inverse()?;
        let g = [0, 1, 2].map(|row| inverse.row(row).transpose());
        let gradients = [-(g[0] + g[1] + g[2]), g[0], g[1], g[2]];
        Some(Self { nodes, volume_m3, gradients })
    }

    /// Displacement gradient H = sum_a u_a (x) grad N_a of nodal displacements `u` (3 per node, node-major), 1.
    #[inline]
    pub fn displacement_gradient(&self, u: &[f64]) -> Matrix3<f64> {
        let mut h = Matrix3::zeros();
        for (node, g) in self.nodes.iter().zip(&self.gradients) {
            let base = 3 * *node as usize;
            h += Vector3::new(u[base], u[base + 1], u[base + 2]) * g.transpose();
        }
        h
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CORNERS: [[f64; 3]; 4] = [[0.1, 0.0, 0.2], [1.3, 0.1, 0.0], [0.2, 0.9, 0.1], [0.0, 0.3, 1.1]];

    #[test]
    fn gradients_reproduce_any_linear_field() {
        let tet = Tet4::new([0, 1, 2, 3], CORNERS).unwrap();
        let gradient = Matrix3::new(0.3, -1.0, 0.2, 0.7, 0.1, -0.4, 2.0, 0.5, -0.6);
        let u: Vec<f64> =
            CORNERS.iter().flat_map(|x| (gradient * Vector3::from(*x)).as_slice().to_vec()).collect();
        assert!((tet.displacement_gradient(&u) - gradient).norm() < 1e-13);
    }

    #[test]
    fn a_flat_or_turned_tet_is_no_element() {
        let mut turned = CORNERS;
        turned.swap(0, 1);
        assert!(Tet4::new([0, 1, 2, 3], turned).is_none());
        assert!(Tet4::new([0, 1, 2, 3], [CORNERS[0], CORNERS[1], CORNERS[2], CORNERS[0]]).is_none());
    }
}
