//! The incompressibility multiplier: the term p (1 - J) of the Lagrangian, P1 pressures on P1 displacements.
//!
//! Lagrangian: sum_e V_e [ W(gamma_e) + mean(p_e) (1 - J_e) ]; J is constant in a tet4, so the integral of the
//! linear pressure is its mean over the four vertices. p > 0 is compression. The constraint int q (1 - J) = 0 holds
//! weakly, per pressure node, not per element: single elements may exceed or even invert while it holds.
//!
//! Derivatives used by the assembly, for an element of volume V with gradients g_a:
//!
//! - force on node a:          -p V cof(F) g_a                   (dJ/dF = cof F)
//! - tangent, nodes a and b:   -p V d2J/du_a du_b = p V cross(m_ab),  m_ab = F (g_a x g_b)
//! - coupling, node a and any pressure vertex:  -V/4 cof(F) g_a
//! - constraint of each pressure vertex:         V/4 (1 - J)
//!
//! where cross(m) v = m x v. Derivation of the second line: cof(F) (x x y) = (F x) x (F y), so the second derivative of
//! det F along v (x) g_a and w (x) g_b is (v x w) . F (g_a x g_b) = -v . (m_ab x w). No inverse of F appears, so
//! everything stays finite through J = 0.
//!
//! P1/P1 is the paper's pair (its Table 1 counts one multiplier a node); it is not inf-sup stable, so pressures
//! oscillate while forces and displacements converge.

use nalgebra::{Matrix3, Vector3};

/// cross(m), the matrix of v -> m x v.
#[inline]
pub fn cross_matrix(m: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -m.z, m.y, m.z, 0.0, -m.x, -m.y, m.x, 0.0)
}

/// Tangent block of the pressure term between two vertices: p V cross(F (g_a x g_b)).
#[inline]
pub fn pressure_tangent(
    pressure_volume: f64,
    deformation_gradient: &Matrix3<f64>,
    g_a: &Vector3<f64>,
    g_b: &Vector3<f64>,
) -> Matrix3<f64> {
    cross_matrix(&(deformation_gradient * g_a.cross(g_b))) * pressure_volume
}
