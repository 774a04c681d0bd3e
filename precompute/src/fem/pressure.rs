//! The pressure field of incompressible regions and its quadratic form.
//!
//! Lagrangian of an incompressible region: int [ W(F) + (p0 + q)(1 - J) ] dV + 1/2 q^T B q. A positive
//! pressure p0 + q is compression. The constant p0 makes the undeformed state stress-free and is part of the
//! law. The unknown is the excess pressure q, linear in each tetrahedron and given at its vertices. A vertex
//! between two incompressible regions has one pressure for each, because the pressure is discontinuous where
//! the stiffness is.
//!
//! The constraint int N_v (1 - J) = 0 applies weakly to each pressure unknown and not to each element: single
//! elements can change their volume or even invert.
//!
//! B is zero for the unstabilised pairs. It contains
//!
//! - for a finite bulk modulus kappa: - int q^2 / (2 kappa), which gives the multiplier q = kappa (1 - J) in
//!   the mean, and
//! - the polynomial pressure projection of Bochev and Dohrmann (2004): - int (q - mean q)^2 / (4 mu), which
//!   stabilises equal orders: it acts on the part of q that the constraint does not determine.
//!
//! With int N_u N_v = V/20 (1 + d_uv) over a tetrahedron, both are one 4 x 4 matrix per element.

use serde::{Deserialize, Serialize};

/// The pressure field of incompressible regions: linear and continuous, for displacements of either order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PressurePair {
    /// Without stabilisation: P1/P1 (the paper's pair, not inf-sup stable: forces converge, pressures
    /// oscillate) or P2/P1 (Taylor-Hood).
    #[default]
    Plain,
    /// With polynomial pressure projection (Bochev and Dohrmann 2004), for equal orders.
    Stabilised,
}

/// Matrix of the pressure's quadratic form in one element of volume `volume_m3`, m^3/Pa; zero for an
/// unstabilised pair without a bulk modulus.
#[inline]
pub(crate) fn pressure_block(
    volume_m3: f64,
    shear_modulus_pa: f64,
    bulk_modulus_pa: Option<f64>,
    pair: PressurePair,
) -> [[f64; 4]; 4] {
    let mut block = [[0.0; 4]; 4];
    if bulk_modulus_pa.is_none() && pair == PressurePair::Plain {
        return block;
    }
    let bulk = bulk_modulus_pa.map_or(0.0, f64::recip);
    let projection = if pair == PressurePair::Stabilised { 0.5 / shear_modulus_pa } else { 0.0 };
    for (u, row) in block.iter_mut().enumerate() {
        for (v, entry) in row.iter_mut().enumerate() {
            let mass = volume_m3 / 20.0 * if u == v { 2.0 } else { 1.0 };
            *entry = -bulk * mass - projection * (mass - volume_m3 / 16.0);
        }
    }
    block
}
