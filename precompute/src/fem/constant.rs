//! Derivative of the reaction with respect to a constant of a material.
//!
//! At an equilibrium the Lagrangian L(u, q; d, theta) of body and tool is stationary in displacement u and pressure
//! q, and the reaction is h = dL/dd. With the sensitivities X = d(u, q)/dd that an equilibrium stores,
//!
//! dh/dtheta = L_d,theta + L_d,u du/dtheta,   du/dtheta = -L_uu^-1 L_u,theta,   X = -L_uu^-1 L_u,d
//!
//! and L_uu is symmetric, so
//!
//! dh/dtheta = L_d,theta + X^T L_u,theta = X^T dr/dtheta,
//!
//! where r is the nodal force and X includes the unit motion of the held nodes. No further solve is needed. The
//! tool's own potential and a rigid sphere's conditions do not contain theta: their part is in X. dr/dtheta is the
//! nodal force of the law with the energy dW/dtheta ([`Material::derivative`]). The pressure's quadratic form
//! q^T B q / 2 contains the bulk modulus and, if it is stabilised, the shear modulus:
//!
//! dh/dtheta += X_q^T (dB/dtheta) q.

use crate::fem::assembly::Assembled;
use crate::fem::body::{ABSENT, Body, Element, Region};
use crate::fem::pressure::{PressurePair, pressure_block};
use crate::fem::solve::Seed;

/// Key of the bulk modulus of a law with a pressure, as in a scene.
pub(crate) const BULK: &str = "bulk_pa";

/// A constant of the material of one region of a body.
#[derive(Debug)]
pub(crate) struct Constant {
    /// The region's elements alone, with the law of the energy dW/dtheta and without pressures.
    elements: Body,
    /// Elements of the body with a pressure block, and dB/dtheta.
    blocks: Vec<(Element, [[f64; 4]; 4])>,
}

impl Constant {
    /// Whether a material has the constant `key` and a derivative by it.
    pub(crate) fn exists(region: &Region, key: &str) -> bool {
        if key == BULK { region.bulk_modulus_pa.is_some() } else { region.material.derivative(key).is_some() }
    }

    /// The constant `key` of region `region`. `None` if the region has no such constant or its energy is not linear
    /// in the constants behind it.
    pub(crate) fn of(body: &Body, region: u16, key: &str) -> Option<Self> {
        let own @ Region { material, bulk_modulus_pa } = &body.regions[usize::from(region)];
        if !Self::exists(own, key) {
            return None;
        }
        let law = material.derivative(key);
        let of_region = |&index: &usize| body.elements[index].region == region;
        let members = || (0..body.elements.len()).filter(of_region);
        let shear_pa = material.shear_modulus_pa();
        // B is linear in 1/kappa and 1/mu, whose derivatives are -1/kappa^2 and -mu'/mu^2.
        let by_bulk = bulk_modulus_pa.filter(|_| key == BULK).map(|bulk| -bulk * bulk);
        let by_shear =
            law.as_ref().map_or(f64::INFINITY, |law| -shear_pa * shear_pa / law.shear_modulus_pa());
        let block = |index: usize| {
            let Element { tet, pressures, pressure_block: now, .. } = &body.elements[index];
            if pressures[0] == ABSENT {
                return None;
            }
            let plain = pressure_block(tet.volume_m3, shear_pa, *bulk_modulus_pa, PressurePair::Plain);
            let pair = if *now == plain { PressurePair::Plain } else { PressurePair::Stabilised };
            let by = pressure_block(tet.volume_m3, by_shear, by_bulk, pair);
            (by != [[0.0; 4]; 4]).then_some((body.elements[index], by))
        };
        let blocks = members().filter_map(block).collect();
        let elements = match law {
            Some(law) => body.part(&members().collect::<Vec<_>>(), law),
            None => body.part(&[], material.clone()),
        };
        Some(Self { elements, blocks })
    }

    /// dh/dtheta at an equilibrium, N per unit of the constant.
    pub(crate) fn by_constant(&self, seed: &Seed) -> [f64; 3] {
        let part = &self.elements;
        let mut assembled = Assembled {
            nodal_force_n: vec![0.0; part.displacement_len()],
            constraint_m3: vec![0.0; part.pressure_sites.len()],
            ..Assembled::default()
        };
        assembled.assemble_residual(part, &seed.state);
        let pressures = &seed.state[part.displacement_len()..];
        seed.sensitivity.each_ref().map(|column| {
            let work: f64 = assembled.nodal_force_n.iter().zip(column).map(|(r, x)| r * x).sum();
            let columns = &column[part.displacement_len()..];
            let form = |(element, by): &(Element, [[f64; 4]; 4])| -> f64 {
                let at = |values: &[f64], v: usize| values[element.pressures[v] as usize];
                let row = |u: usize| (0..4).map(|v| by[u][v] * at(pressures, v)).sum::<f64>();
                (0..4).map(|u| at(columns, u) * row(u)).sum()
            };
            work + self.blocks.iter().map(form).sum::<f64>()
        })
    }
}
