//! What an elastic tool does at a state of the skin: the derivatives of its potential.
//!
//! A pad ([`crate::fem::pad`]) and the layer of a sphere ([`crate::fem::sphere::Layer`]) add a potential Phi(u, d) to
//! the energy of the body, with d the displacement of the tool. At an equilibrium, with the tangent K = E_uu + Phi_uu,
//!
//! h = Phi_d,   X = du/dd = -K^-1 Phi_ud,   S = Phi_dd + Phi_du X,
//! W_ijk = D3 E [X_i, X_j, X_k] + D3 Phi [(X_i, e_i), (X_j, e_j), (X_k, e_k)].

use nalgebra::{Matrix3, Vector3};

/// The derivatives of the potential of a tool. A node or a pair of nodes can occur several times: the entries add up.
#[derive(Debug, Clone, Default)]
pub(crate) struct ElasticState {
    /// Phi, J.
    pub energy_j: f64,
    /// Phi_d: force of the tool on the body, N.
    pub force_n: Vector3<f64>,
    /// Moment of the tool on the body about the current place of the tool's centre, N m.
    pub torque_n_m: Vector3<f64>,
    /// Phi_u at nodes, N.
    pub nodal_n: Vec<(u32, Vector3<f64>)>,
    /// Phi_uu between pairs of nodes, N/m. A pair is given in one order only.
    pub stiffness_n_m: Vec<([u32; 2], Matrix3<f64>)>,
    /// -Phi_ud at nodes, N/m.
    pub coupling_n_m: Vec<(u32, Matrix3<f64>)>,
    /// Phi_dd, N/m.
    pub own_n_m: Matrix3<f64>,
    /// Phi_a with the half axis a of a capsule, N.
    pub of_axis_n: Vector3<f64>,
    /// Phi_da, N/m.
    pub axis_n_m: Matrix3<f64>,
    /// Phi_aa, N/m.
    pub of_axis_n_m: Matrix3<f64>,
    /// Phi_ua at nodes, N/m.
    pub turned_n_m: Vec<(u32, Matrix3<f64>)>,
    /// Whether the skin is so deep inside the tool that it may come out on the other side.
    pub is_pierced: bool,
}

impl ElasticState {
    /// The state without a tool; keeps its memory.
    pub(crate) fn clear(&mut self) {
        (self.energy_j, self.is_pierced) = (0.0, false);
        (self.force_n, self.torque_n_m) = (Vector3::zeros(), Vector3::zeros());
        self.of_axis_n = Vector3::zeros();
        (self.own_n_m, self.axis_n_m, self.of_axis_n_m) = Default::default();
        self.turned_n_m.clear();
        self.nodal_n.clear();
        self.stiffness_n_m.clear();
        self.coupling_n_m.clear();
    }
}
