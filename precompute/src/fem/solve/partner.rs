//! A second sphere on the same body: the partner.
//!
//! With both centres c and p the energy is W(c, p) = min over u of E(u) + Phi(u, c) + Phi(u, p). A jet expands it in c at a
//! fixed p. What a partner that moves does to the force h = dW/dc is, with X = du/dc and the potential of the partner,
//!
//! dh/dp = X^T Phi_up.
//!
//! It needs no further solve.

use nalgebra::{Matrix3, Vector3};

use super::{Contact, Solver};
use crate::fem::elastic::ElasticState;
use crate::fem::sphere::Posture;
use crate::num::jet::EnergyJet;

/// Relative residual of the columns by the axis and most sweeps, and the largest residual that serves.
const AXIS_GOAL: (f64, usize) = (1e-2, 8);
const WORST_AXIS: f64 = 0.3;

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

/// The second control of a solved tool.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Second {
    /// The displacement of the partner from the place where that of the tool is zero.
    Partner,
    /// The half axis of the tool, a capsule.
    Axis,
}

/// How the force of a solved tool depends on its second control q.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Coupling {
    /// What q is.
    pub of: Second,
    /// q, m.
    pub second_m: [f64; 3],
    /// dW/dq, N.
    pub force_n: [f64; 3],
    /// dh/dq: row i belongs to h_i, N/m.
    pub mixed_n_m: Matrix3<f64>,
    /// d2W/dq2 of an axis, N/m; zero of a partner.
    pub own_n_m: Matrix3<f64>,
}

impl Coupling {
    /// The changes of W and of h for another q, J and N, up to a distance, at a displacement from the control, m.
    pub fn change(&self, second_m: [f64; 3], within_m: f64, from_control_m: [f64; 3]) -> (f64, [f64; 3]) {
        let moved_m = (Vector3::from(second_m) - Vector3::from(self.second_m)).cap_magnitude(within_m);
        let change_n = self.mixed_n_m * moved_m;
        let bent_n = Vector3::from(self.force_n) + 0.5 * self.own_n_m * moved_m;
        let change_j = bent_n.dot(&moved_m) + change_n.dot(&Vector3::from(from_control_m));
        (change_j, change_n.into())
    }

    /// That of the root s = sqrt(2 W):
    ///
    /// s_q = (dW/dq) / s,   s_cq = (dh/dq - s_c s_q^T) / s,   s_qq = (d2W/dq2 - s_q s_q^T) / s.
    #[must_use]
    pub(crate) fn of_exact_root(&self, root: &EnergyJet) -> Self {
        let slope = Vector3::from(self.force_n) / root.energy_j;
        let own_n_m = (self.own_n_m - slope * slope.transpose()) / root.energy_j;
        Self { own_n_m, ..self.with_slope(root, slope) }
    }

    fn with_slope(&self, root: &EnergyJet, slope: Vector3<f64>) -> Self {
        let mixed = (self.mixed_n_m - Vector3::from(root.force_n) * slope.transpose()) / root.energy_j;
        Self { force_n: slope.into(), mixed_n_m: mixed, own_n_m: Matrix3::zeros(), ..*self }
    }

    /// That of the root s of h = s s_c where W depends on the depth along n = s_c / |s_c| alone, which the partner changes:
    ///
    /// s_q = (dh/dq)^T s_c / (n.S n),   n.S n = |s_c|^2 + s n.s_cc n,   and s_cq as of the exact one.
    #[must_use]
    pub(crate) fn of_root(&self, root: &EnergyJet) -> Self {
        let along = Vector3::from(root.force_n);
        let bent = (root.stiffness_n_m * along).dot(&along) / along.norm_squared();
        let stiffness_n_m = along.norm_squared() + root.energy_j * bent;
        self.with_slope(root, self.mixed_n_m.transpose() * along / stiffness_n_m)
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

    /// Whether the skin is too deep inside the tool or its partner, or one of them is inside the body.
    pub(super) fn is_pierced(&self) -> bool {
        let is_deep = |of: &Partner| of.elastic.is_pierced;
        if self.elastic.is_pierced || self.partner.as_ref().is_some_and(is_deep) {
            return true;
        }
        let Some(Contact::Sphere(sphere)) = &self.problem.contact else { return false };
        let postures = [Some(self.posture()), self.partner.as_ref().map(Partner::posture)];
        let is_inside = |posture: &Posture| sphere.is_inside(&self.problem.body, &self.state, posture);
        postures.iter().flatten().any(is_inside)
    }

    /// Where the tool is.
    pub(super) fn posture(&self) -> Posture {
        Posture { displacement_m: self.control_m, half_m: self.half_m.unwrap_or_default() }
    }

    /// d2W/da2 of a capsule, by one more solve of three columns with the factor at hand; zero if they are not solved well.
    ///
    /// W_aa = Phi_aa + Phi_au Y,   Y = du/da = -K^-1 Phi_ua.
    pub(super) fn complete(&mut self, coupling: &mut Option<Coupling>) {
        let Some(coupling) = coupling.as_mut().filter(|coupling| coupling.of == Second::Axis) else { return };
        self.axis_columns();
        self.columns.fill(0.0);
        let problem = self.problem.clone();
        let matrix = problem.matrix(&self.assembled.tangent);
        let (residual, _) = self.factor.refine(matrix, &self.right, &mut self.columns, AXIS_GOAL);
        if residual <= WORST_AXIS {
            let own_n_m = self.condensed(self.elastic.of_axis_n_m);
            coupling.own_n_m = 0.5 * (own_n_m + own_n_m.transpose());
        }
    }

    /// From now on the second control is this one, m.
    pub(crate) fn set_second(&mut self, of: Second, second_m: Option<[f64; 3]>) {
        match of {
            Second::Partner => self.set_partner(second_m),
            Second::Axis => self.set_half_axis(second_m),
        }
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
            return Some(Coupling {
                of: Second::Axis,
                second_m: half_m,
                force_n,
                mixed_n_m,
                own_n_m: Matrix3::zeros(),
            });
        }
        let partner = self.partner.as_ref()?;
        // These blocks are -Phi_up.
        let mixed_n_m = -through_body(&partner.elastic.coupling_n_m);
        let force_n = partner.elastic.force_n.into();
        Some(Coupling {
            of: Second::Partner,
            second_m: partner.displacement_m,
            force_n,
            mixed_n_m,
            own_n_m: Matrix3::zeros(),
        })
    }
}
