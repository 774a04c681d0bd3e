//! A second sphere on the same body: the partner.
//!
//! With both centres c and p the energy is W(c, p) = min over u of E(u) + Phi(u, c) + Phi(u, p). A jet expands it in c at a
//! fixed p. What a partner that moves does to the force h = dW/dc is, with X = du/dc and the potential of the partner,
//!
//! dh/dp = X^T Phi_up.
//!
//! It needs no further solve.

use nalgebra::{Matrix3, Vector3};

use super::Solver;
use crate::fem::elastic::ElasticState;
use crate::fem::sphere::Posture;
use crate::num::jet::EnergyJet;

/// The partner at the current state.
#[derive(Debug, Clone)]
pub(super) struct Partner {
    /// Its displacement from the place where that of the tool is zero, m.
    pub(super) displacement_m: [f64; 3],
    pub(super) elastic: ElasticState,
}

impl Partner {
    pub(super) fn posture(&self) -> Posture {
        Posture { displacement_m: self.displacement_m, half_m: [0.0; 3] }
    }
}

/// How the force of a solved tool depends on its partner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Coupling {
    /// Displacement of the partner from the place where that of the tool is zero, m.
    pub partner_m: [f64; 3],
    /// dW/dp: the force of the partner on the body, N.
    pub force_n: [f64; 3],
    /// dh/dp: row i belongs to h_i, N/m.
    pub mixed_n_m: Matrix3<f64>,
}

impl Coupling {
    /// The changes of W and of h for another place of the partner, J and N, up to a distance.
    pub fn change(&self, partner_m: [f64; 3], within_m: f64) -> (f64, [f64; 3]) {
        let moved_m = (Vector3::from(partner_m) - Vector3::from(self.partner_m)).cap_magnitude(within_m);
        (Vector3::from(self.force_n).dot(&moved_m), (self.mixed_n_m * moved_m).into())
    }

    /// That of the root s of h = s s_c where W depends on the depth along n = s_c / |s_c| alone, which the partner changes:
    ///
    /// s_p = (dh/dp)^T s_c / (n.S n),   s_cp = (dh/dp - s_c s_p^T) / s,   n.S n = |s_c|^2 + s n.s_cc n.
    #[must_use]
    pub(crate) fn of_root(&self, root: &EnergyJet) -> Self {
        let along = Vector3::from(root.force_n);
        let bent = (root.stiffness_n_m * along).dot(&along) / along.norm_squared();
        let stiffness_n_m = along.norm_squared() + root.energy_j * bent;
        let slope = self.mixed_n_m.transpose() * along / stiffness_n_m;
        let mixed = (self.mixed_n_m - along * slope.transpose()) / root.energy_j;
        Self { force_n: slope.into(), mixed_n_m: mixed, ..*self }
    }
}

impl Solver {
    /// From now on a partner like the sphere of the problem touches the body too, with this displacement from the place where
    /// that of the sphere is zero; or none does.
    pub fn set_partner(&mut self, displacement_m: Option<[f64; 3]>) {
        let mut elastic = self.partner.take().map(|partner| partner.elastic).unwrap_or_default();
        elastic.clear();
        self.partner = displacement_m.map(|displacement_m| Partner { displacement_m, elastic });
    }

    /// Energy and size of the force of the partner, J and N.
    pub(super) fn of_partner(&self) -> (f64, f64) {
        self.partner
            .as_ref()
            .map_or((0.0, 0.0), |partner| (partner.elastic.energy_j, partner.elastic.force_n.norm()))
    }

    /// Whether the skin is too deep inside the tool or its partner.
    pub(super) fn is_pierced(&self) -> bool {
        self.elastic.is_pierced || self.partner.as_ref().is_some_and(|partner| partner.elastic.is_pierced)
    }

    /// From now on the tool is a capsule with this half axis, m; or a sphere.
    pub fn set_half_axis(&mut self, half_m: Option<[f64; 3]>) {
        self.half_m = half_m;
    }

    /// The coupling at the last assembled tangent, with the changes of the state for each axis of the tool: to the partner, or
    /// of a capsule to its half axis.
    pub(super) fn coupling(&self, sensitivity: &[Vec<f64>; 3]) -> Option<Coupling> {
        // The change of h by X^T, with the sign of the blocks.
        let through_body = |blocks: &[(u32, Matrix3<f64>)]| {
            let mut sum = Matrix3::zeros();
            for (node, block) in blocks {
                for (axis, column) in sensitivity.iter().enumerate() {
                    let moved = Vector3::from_column_slice(&column[3 * *node as usize..][..3]);
                    let row = sum.row(axis) + moved.transpose() * block;
                    sum.set_row(axis, &row);
                }
            }
            sum
        };
        if let Some(half_m) = self.half_m {
            let mixed_n_m = through_body(&self.elastic.turned_n_m) + self.elastic.axis_n_m;
            let force_n = self.elastic.of_axis_n.into();
            return Some(Coupling { partner_m: half_m, force_n, mixed_n_m });
        }
        let partner = self.partner.as_ref()?;
        // These blocks are -Phi_up.
        let mixed_n_m = -through_body(&partner.elastic.coupling_n_m);
        let force_n = partner.elastic.force_n.into();
        Some(Coupling { partner_m: partner.displacement_m, force_n, mixed_n_m })
    }
}
