//! The same tissue with another law of equal moduli at small strain, so that only the law differs.

use super::material::{LAWS, Material, ParameterError};
use crate::fem::body::Region;

impl Region {
    /// The law called `name` with this region's moduli at small strain; the region itself if that is its law.
    /// A law with fibres and a user-defined law have no counterpart.
    ///
    /// An incompressible law gives E = 3 mu (6 (C10 + C01) for Mooney-Rivlin) and nu = 0.49, as in the paper.
    /// With a bulk modulus K it gives nu = (3 K - 2 mu) / (6 K + 2 mu) and E = 2 mu (1 + nu). Between
    /// compressible laws Lame's constants do not change. An incompressible law uses only mu of them, with
    /// C10 = C01 = mu / 4.
    pub fn counterpart(&self, name: &str) -> Result<Self, ParameterError> {
        if !LAWS.contains(&name) {
            return Err(ParameterError::of_law("no such law", format!("choose from {}", LAWS.join(", "))));
        }
        if name == self.material.name() {
            return Ok(self.clone());
        }
        let fibres =
            || ParameterError::of_law("fibres have no counterpart in an isotropic law", "leave it out");
        let moduli = self.material.small_strain(self.bulk_modulus_pa).ok_or_else(|| match self.material {
            Material::Own(_) => ParameterError::of_law(
                "the moduli of a user-defined law are not known",
                "give the other law itself",
            ),
            _ => fibres(),
        })?;
        let material = Material::with_small_strain(name, &moduli).ok_or_else(fibres)?;
        let bulk_modulus_pa = self.bulk_modulus_pa.filter(|_| material.rest_pressure_pa().is_some());
        Ok(Self { material, bulk_modulus_pa })
    }
}

#[cfg(test)]
mod tests {
    use super::super::material::{Lame, MooneyRivlin, StVenantKirchhoff};
    use super::*;

    const PAPER: MooneyRivlin = MooneyRivlin { c10_pa: 1300.0, c01_pa: 1280.0 };

    fn region(material: Material) -> Region {
        material.into()
    }

    #[test]
    fn the_papers_liver_has_the_papers_young_modulus() {
        let linear = region(Material::MooneyRivlin(PAPER)).counterpart("linear").expect("isotropic");
        let Material::LinearElastic(law) = linear.material else { panic!("{:?}", linear.material) };
        assert_eq!(law.lame, Lame::from_young_poisson(6.0 * 2580.0, 0.49));
    }

    #[test]
    fn shear_moduli_agree_and_a_bulk_modulus_is_kept() {
        let lame = Lame::from_young_poisson(9000.0, 0.4);
        let from = region(Material::StVenantKirchhoff(StVenantKirchhoff { lame }));
        for name in LAWS.iter().copied().filter(|name| *name != "holzapfel-gasser-ogden") {
            let found = from.counterpart(name).expect("isotropic");
            assert_eq!(found.material.name(), name);
            assert!((found.material.shear_modulus_pa() / lame.mu_pa - 1.0).abs() < 1e-12, "{name}");
        }
        let from = Region { material: Material::MooneyRivlin(PAPER), bulk_modulus_pa: Some(50_000.0) };
        let Material::NeoHookean(law) = from.counterpart("neo-hookean").expect("isotropic").material else {
            panic!("another law")
        };
        assert!((law.lame.lambda_pa + 2.0 / 3.0 * law.lame.mu_pa - 50_000.0).abs() < 1e-9);
        assert_eq!(
            from.counterpart("mooney-rivlin-reduced").expect("isotropic").bulk_modulus_pa,
            Some(50_000.0)
        );
        assert_eq!(from.counterpart("linear").expect("isotropic").bulk_modulus_pa, None);
    }

    #[test]
    fn what_cannot_be_carried_over_is_said() {
        let from = region(Material::MooneyRivlin(PAPER));
        let refused = |name: &str| from.counterpart(name).expect_err("no counterpart").to_string();
        assert!(refused("hooke").starts_with("no such law; choose from linear"));
        assert!(refused("holzapfel-gasser-ogden").contains("fibres have no counterpart"));
        assert_eq!(from.counterpart("mooney-rivlin"), Ok(from));
    }
}
