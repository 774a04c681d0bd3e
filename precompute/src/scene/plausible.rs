//! Warnings about values that can be solved but are probably slips: units, and places on unequal meshes.

use super::MaterialRegion;
use super::lookup::Lookup;
use crate::mesh::{LengthUnit, TetMesh};
use crate::num::vector::distance;

/// Diagonal of a plausible body, m.
const SIZES_M: [f64; 2] = [0.005, 2.0];
/// Shear modulus of a plausible material, Pa.
const MODULI_PA: [f64; 2] = [10.0, 1e9];
/// Size of a typical organ, m: of several units that give a plausible body, the one nearest to it is named.
const TYPICAL_M: f64 = 0.2;
/// Largest ratio of edge lengths at places that are compared.
const MAX_RATIO: f64 = 1.5;
const UNITS: [&str; 3] = ["mm", "cm", "m"];

fn is_within([low, high]: [f64; 2], value: f64) -> bool {
    (low..=high).contains(&value)
}

/// The doubt about a body that is too large or too small; `unit` is that of its file, if it is given.
pub fn doubt_of_size(mesh: &TetMesh, unit: Option<&str>) -> Option<String> {
    let size_m = mesh.diagonal_m();
    if is_within(SIZES_M, size_m) {
        return None;
    }
    let per_metre = |unit: &str| unit.parse().map_or(1.0, LengthUnit::per_metre);
    let in_file = size_m * per_metre(unit.unwrap_or("m"));
    let size_with = |candidate: &str| in_file / per_metre(candidate);
    let away = |candidate: &str| libm::log(size_with(candidate) / TYPICAL_M).abs();
    let likely = UNITS.into_iter().filter(|candidate| is_within(SIZES_M, size_with(candidate)));
    let likely = likely.min_by(|a, b| away(a).total_cmp(&away(b)));
    let cause = match (likely, unit) {
        (Some(likely), None) => format!("is the mesh in {likely}? add `unit = \"{likely}\"` to [mesh]"),
        (Some(likely), Some(_)) => format!("is the mesh in {likely}? correct `unit` in [mesh]"),
        (None, _) => "check the scale of the mesh".into(),
    };
    let read_as = unit.map_or(String::new(), |unit| format!(" with `unit = \"{unit}\"`"));
    Some(format!("the body is {} across{read_as}: {cause}", length(size_m)))
}

impl Lookup<'_> {
    /// Warns of materials that are too soft or too stiff.
    pub(super) fn warn_of_moduli(&mut self, regions: &[MaterialRegion]) {
        let moduli_pa: Vec<f64> = regions.iter().map(|region| region.material.shear_modulus_pa()).collect();
        let Some(&modulus_pa) = moduli_pa.iter().find(|modulus_pa| !is_within(MODULI_PA, **modulus_pa))
        else {
            return;
        };
        let cause =
            if modulus_pa < MODULI_PA[0] { "is it in kPa or MPa?" } else { "is a power of ten wrong?" };
        self.warnings.push(format!(
            "a material (law \"{}\") has a shear modulus of {} Pa at rest: {cause} moduli are in Pa",
            regions[moduli_pa.iter().position(|of| *of == modulus_pa).unwrap_or_default()].material.name(),
            three_digits(modulus_pa)
        ));
    }

    /// Warns once if the elements at active nodes that are named one by one have different sizes.
    pub(super) fn warn_of_unequal_places(&mut self, named: &[(String, u32)]) {
        let edges = named.iter().filter_map(|(name, node)| Some((name, self.mean_edge_m(*node)?)));
        let edges: Vec<(&String, f64)> = edges.collect();
        let finest = edges.iter().min_by(|a, b| a.1.total_cmp(&b.1));
        let coarsest = edges.iter().max_by(|a, b| a.1.total_cmp(&b.1));
        let (Some((fine, fine_m)), Some((coarse, coarse_m))) = (finest, coarsest) else { return };
        if *coarse_m > MAX_RATIO * fine_m {
            self.warnings.push(format!(
                "the forces at \"{fine}\" and \"{coarse}\" cannot be compared, because the mesh differs (edges of {} and \
                 {}): the finer place feels softer",
                length(*fine_m),
                length(*coarse_m)
            ));
        }
    }

    /// Mean length of the edges of the skin triangles at a node.
    fn mean_edge_m(&self, node: u32) -> Option<f64> {
        let around = self.skin.triangles.iter().filter(|triangle| triangle.contains(&node));
        let mut lengths_m = Vec::new();
        for [a, b, c] in around {
            for ends in [[a, b], [b, c], [c, a]] {
                let [from, to] = ends.map(|node| self.mesh.nodes_m[*node as usize]);
                lengths_m.push(distance(from, to));
            }
        }
        (!lengths_m.is_empty()).then(|| lengths_m.iter().sum::<f64>() / lengths_m.len() as f64)
    }
}

/// A length in metres from 1 m on, otherwise in millimetres.
fn length(metres: f64) -> String {
    if metres >= 1.0 { three_digits(metres) + " m" } else { three_digits(1e3 * metres) + " mm" }
}

fn three_digits(value: f64) -> String {
    let digits = (2 - libm::log10(value).floor() as i32).clamp(0, 6) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').into() } else { text }
}
