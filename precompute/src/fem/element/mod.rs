//! Finite elements: straight-sided tetrahedra with linear or quadratic shape functions.
//!
//! In a straight-sided tetrahedron the barycentric coordinates lambda_k are linear in X, so their gradients
//! G_k are constant and a shape function N_a(lambda) has the gradient
//!
//! grad N_a = sum_k (dN_a/dlambda_k) G_k.
//!
//! An element of either order therefore stores four vectors and a volume. The table of dN_a/dlambda_k at the
//! quadrature points ([`Point`]) depends on the order and is the same for all elements.

mod quadrature;

pub(crate) use quadrature::{LINEAR, Point, QUADRATIC};

use nalgebra::{Matrix3, Vector3};

use crate::num::lanes::Real;
use crate::num::tensor::{Mat3, Vec3};

/// Order of the shape functions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Order {
    /// Four nodes, constant strain.
    Linear,
    /// Ten nodes, linear strain.
    Quadratic,
}

impl Order {
    /// Number of nodes of an element.
    pub(crate) const fn nodes(self) -> usize {
        match self {
            Self::Linear => 4,
            Self::Quadratic => 10,
        }
    }
}

/// Vertex pairs of the mid-edge nodes 4 to 9, in VTK's order of the ten-node tetrahedron.
pub(crate) const EDGES: [[usize; 2]; 6] = [[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]];

/// Undeformed geometry of a straight-sided tetrahedron.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tetrahedron {
    /// Volume, m^3, positive.
    pub volume_m3: f64,
    /// Gradients G_k of the barycentric coordinates, 1/m; their sum is zero.
    pub gradients: [Vector3<f64>; 4],
}

impl Tetrahedron {
    /// Tetrahedron of four vertices; `None` if its volume is not positive.
    ///
    /// With the edge matrix D = [X1-X0, X2-X0, X3-X0], the rows of D^-1 are G_1..3, and the volume is det D /
    /// 6.
    pub(crate) fn new(corners_m: [[f64; 3]; 4]) -> Option<Self> {
        let x = corners_m.map(Vector3::from);
        let edges = Matrix3::from_columns(&[x[1] - x[0], x[2] - x[0], x[3] - x[0]]);
        let volume_m3 = edges.determinant() / 6.0;
        if !(volume_m3 > 0.0 && volume_m3.is_finite()) {
            return None;
        }
        let inverse = edges.try_inverse()?;
        let g = [0, 1, 2].map(|row| inverse.row(row).transpose());
        Some(Self { volume_m3, gradients: [-(g[0] + g[1] + g[2]), g[0], g[1], g[2]] })
    }
}

/// Gradients of the N shape functions at a quadrature point, from the gradients of the barycentric
/// coordinates.
#[inline(always)]
pub(crate) fn shape_gradients<R: Real, const N: usize>(
    barycentric: &[Vec3<R>; 4],
    point: &Point<N>,
) -> [Vec3<R>; N] {
    let like = barycentric[0].0[0];
    let mut gradients = [Vec3::constant(like, [0.0; 3]); N];
    if N == 4 {
        // Linear shape functions are the barycentric coordinates.
        gradients.copy_from_slice(barycentric);
        return gradients;
    }
    for (gradient, slopes) in gradients.iter_mut().zip(&point.slopes) {
        for (&g, &slope) in barycentric.iter().zip(slopes) {
            *gradient += g * like.constant(slope);
        }
    }
    gradients
}

/// H = sum_a u_a (x) grad N_a, the gradient of a nodal vector field.
#[inline(always)]
pub(crate) fn field_gradient<R: Real, const N: usize>(
    values: &[Vec3<R>; N],
    shape_gradients: &[Vec3<R>; N],
) -> Mat3<R> {
    let mut h = Mat3::zeros(values[0].0[0]);
    for (&u, &g) in values.iter().zip(shape_gradients) {
        h += u.outer(g);
    }
    h
}

#[cfg(test)]
mod tests {
    use super::*;

    const CORNERS: [[f64; 3]; 4] = [[0.1, 0.0, 0.2], [1.3, 0.1, 0.0], [0.2, 0.9, 0.1], [0.0, 0.3, 1.1]];

    fn nodes<const N: usize>() -> [Vector3<f64>; N] {
        std::array::from_fn(|a| match a {
            0..4 => Vector3::from(CORNERS[a]),
            _ => EDGES[a - 4].iter().map(|&k| Vector3::from(CORNERS[k]) * 0.5).sum(),
        })
    }

    /// Compares the gradient of a field given at the nodes with the exact gradient at each quadrature point.
    fn check<const N: usize>(
        rule: &[Point<N>],
        field: impl Fn(Vector3<f64>) -> (Vector3<f64>, Matrix3<f64>),
    ) {
        let tet = Tetrahedron::new(CORNERS).unwrap();
        let values = nodes::<N>().map(|x| field(x).0);
        for point in rule {
            let x: Vector3<f64> =
                point.barycentric.iter().zip(&CORNERS).map(|(l, c)| Vector3::from(*c) * *l).sum();
            let gradients = shape_gradients(&tet.gradients.map(Vec3::from), point);
            let found = Matrix3::from(field_gradient(&values.map(Vec3::from), &gradients));
            assert!((found - field(x).1).norm() < 1e-13);
            let value: Vector3<f64> = values.iter().zip(&point.values).map(|(u, n)| u * *n).sum();
            assert!((value - field(x).0).norm() < 1e-14);
        }
    }

    #[test]
    fn gradients_reproduce_fields_of_the_element_s_order() {
        let m = Matrix3::new(0.3, -1.0, 0.2, 0.7, 0.1, -0.4, 2.0, 0.5, -0.6);
        check(&LINEAR, |x| (m * x, m));
        check(&QUADRATIC, |x| (m * x, m));
        // u = (m x)(v . x), du/dX = m (v . x) + (m x) v^T.
        let v = Vector3::new(0.4, -0.3, 0.9);
        check(&QUADRATIC, |x| (m * x * v.dot(&x), m * v.dot(&x) + (m * x) * v.transpose()));
    }

    #[test]
    fn a_flat_or_turned_tet_is_no_element() {
        let mut turned = CORNERS;
        turned.swap(0, 1);
        assert!(Tetrahedron::new(turned).is_none());
        assert!(Tetrahedron::new([CORNERS[0], CORNERS[1], CORNERS[2], CORNERS[0]]).is_none());
    }
}
