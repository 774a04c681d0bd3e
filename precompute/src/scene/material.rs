//! From a `[material]` table to a law with parameters that make sense.

use toml::Spanned;

use super::file::{Located, MaterialTable, Place};
use crate::error::{InputError, nearest_word};
use crate::fem::counterpart::LAWS;
use crate::fem::material::{
    HolzapfelGasserOgden, Lame, LinearElastic, Material, MooneyRivlin, NeoHookean, ReducedMooneyRivlin,
    StVenantKirchhoff,
};

/// The law of a table and its bulk modulus; odd but solvable parameters are added to `warnings`.
pub(super) fn law(
    place: &Place,
    material: &Located<'_, MaterialTable>,
    warnings: &mut Vec<String>,
) -> Result<(Material, Option<f64>), InputError> {
    let name = &material.table.law;
    let table = Parameters { place, material };
    let law = match name.get_ref().as_str() {
        "linear" => Material::LinearElastic(LinearElastic { lame: table.lame()? }),
        "st-venant-kirchhoff" => Material::StVenantKirchhoff(StVenantKirchhoff { lame: table.lame()? }),
        "modified-st-venant-kirchhoff" => {
            Material::ModifiedStVenantKirchhoff(StVenantKirchhoff { lame: table.lame()? })
        }
        "neo-hookean" => Material::NeoHookean(NeoHookean { lame: table.lame()? }),
        "mooney-rivlin" => {
            let (c10_pa, c01_pa) = table.mooney_rivlin(warnings)?;
            Material::MooneyRivlin(MooneyRivlin { c10_pa, c01_pa })
        }
        "mooney-rivlin-reduced" => {
            let (c10_pa, c01_pa) = table.mooney_rivlin(warnings)?;
            Material::ReducedMooneyRivlin(ReducedMooneyRivlin { c10_pa, c01_pa })
        }
        "holzapfel-gasser-ogden" => table.holzapfel()?,
        unknown => {
            let fix = match nearest_word(unknown, LAWS) {
                Some(guess) => format!("did you mean \"{guess}\"? (laws: {})", LAWS.join(", ")),
                None => format!("choose one of {}", LAWS.join(", ")),
            };
            return Err(place.error(name.span(), format!("unknown law \"{unknown}\""), fix));
        }
    };
    let bulk_modulus_pa = table.bulk(&law)?;
    Ok((law, bulk_modulus_pa))
}

/// What each family of laws wants.
const LAME: &str = "either `young_pa` and `poisson`, or `lambda_pa` and `mu_pa`";
const MOONEY_RIVLIN: &str = "`c10_pa` and `c01_pa`";
const HOLZAPFEL: &str = "`c10_pa`, `k1_pa`, `k2` and `fibre`, and `dispersion` if it is not 0";

struct Parameters<'a> {
    place: &'a Place,
    material: &'a Located<'a, MaterialTable>,
}

impl Parameters<'_> {
    /// Given numbers of the table by key.
    fn given(&self) -> impl Iterator<Item = (&'static str, &Spanned<f64>)> {
        let t = self.material.table;
        [
            ("young_pa", &t.young_pa),
            ("poisson", &t.poisson),
            ("lambda_pa", &t.lambda_pa),
            ("mu_pa", &t.mu_pa),
            ("c10_pa", &t.c10_pa),
            ("c01_pa", &t.c01_pa),
            ("bulk_pa", &t.bulk_pa),
            ("k1_pa", &t.k1_pa),
            ("k2", &t.k2),
            ("dispersion", &t.dispersion),
        ]
        .into_iter()
        .filter_map(|(key, value)| Some((key, value.as_ref()?)))
    }

    /// Refuses keys of other laws.
    fn nothing_but(&self, keys: &[&str], wanted: &str) -> Result<(), InputError> {
        let law = self.material.table.law.get_ref();
        let fibre = self.material.table.fibre.as_ref().map(|f| ("fibre", f.span()));
        let all = self.given().map(|(key, value)| (key, value.span())).chain(fibre);
        match all.into_iter().find(|(key, _)| *key != "bulk_pa" && !keys.contains(key)) {
            None => Ok(()),
            Some((key, span)) => {
                let what = format!("`{key}` does not belong to the law \"{law}\" here");
                Err(self.place.error(span, what, format!("give {wanted}")))
            }
        }
    }

    /// The values of keys, all of which must be there and finite.
    fn values<const N: usize>(
        &self,
        keys: [&'static str; N],
        wanted: &str,
    ) -> Result<[&Spanned<f64>; N], InputError> {
        let law = self.material.table.law.get_ref();
        let mut found = [None; N];
        for (slot, key) in found.iter_mut().zip(keys) {
            let Some((_, value)) = self.given().find(|(given, _)| *given == key) else {
                let what = format!("the law \"{law}\" lacks `{key}`");
                return Err(self.place.error(self.material.table.law.span(), what, format!("give {wanted}")));
            };
            if !value.get_ref().is_finite() {
                return Err(self.wrong(key, value, "must be a finite number", "correct the value"));
            }
            *slot = Some(value);
        }
        Ok(found.map(|value| value.expect("every key was found above")))
    }

    fn wrong(&self, key: &str, value: &Spanned<f64>, rule: &str, fix: &str) -> InputError {
        self.place.error(value.span(), format!("`{key}` = {} {rule}", value.get_ref()), fix)
    }

    fn mooney_rivlin(&self, warnings: &mut Vec<String>) -> Result<(f64, f64), InputError> {
        self.nothing_but(&["c10_pa", "c01_pa"], MOONEY_RIVLIN)?;
        let [c10, c01] = self.values(["c10_pa", "c01_pa"], MOONEY_RIVLIN)?;
        let (c10_pa, c01_pa) = (*c10.get_ref(), *c01.get_ref());
        if c10_pa + c01_pa <= 0.0 {
            let rule = "and `c01_pa` must have a positive sum (the shear modulus is twice it)";
            return Err(self.wrong("c10_pa", c10, rule, "give positive constants in pascals"));
        }
        for (key, value) in [("c10_pa", c10_pa), ("c01_pa", c01_pa)] {
            if value < 0.0 {
                warnings.push(format!(
                    "`{key}` = {value} is negative: the material may lose its stability when strained"
                ));
            }
        }
        Ok((c10_pa, c01_pa))
    }

    fn holzapfel(&self) -> Result<Material, InputError> {
        self.nothing_but(&["c10_pa", "k1_pa", "k2", "dispersion", "fibre"], HOLZAPFEL)?;
        let [c10, k1, k2] = self.values(["c10_pa", "k1_pa", "k2"], HOLZAPFEL)?;
        for (key, value) in [("c10_pa", c10), ("k1_pa", k1), ("k2", k2)] {
            if *value.get_ref() <= 0.0 {
                return Err(self.wrong(key, value, "must be positive", "correct the value"));
            }
        }
        let dispersion = match &self.material.table.dispersion {
            None => 0.0,
            Some(value) if (0.0..=1.0 / 3.0).contains(value.get_ref()) => *value.get_ref(),
            Some(value) => {
                let fix = "0 is all fibres parallel, 0.3333 is isotropic";
                return Err(self.wrong("dispersion", value, "must be from 0 to 1/3", fix));
            }
        };
        let Some(fibre) = &self.material.table.fibre else {
            let what = "the law \"holzapfel-gasser-ogden\" lacks `fibre`";
            return Err(self.place.error(
                self.material.table.law.span(),
                what,
                "give the fibre direction, for example `fibre = [1.0, 0.0, 0.0]`",
            ));
        };
        let direction = nalgebra::Vector3::from(*fibre.get_ref());
        let Some(direction) = direction.try_normalize(0.0).filter(|d| d.iter().all(|c| c.is_finite())) else {
            let what = format!("`fibre` = {:?} is no direction", fibre.get_ref());
            return Err(self.place.error(fibre.span(), what, "give a vector that is not zero"));
        };
        Ok(Material::HolzapfelGasserOgden(HolzapfelGasserOgden {
            c10_pa: *c10.get_ref(),
            k1_pa: *k1.get_ref(),
            k2: *k2.get_ref(),
            dispersion,
            fibre: direction.into(),
        }))
    }

    /// The bulk modulus, which only a law with a pressure can have.
    fn bulk(&self, law: &Material) -> Result<Option<f64>, InputError> {
        let Some(value) = &self.material.table.bulk_pa else { return Ok(None) };
        if law.rest_pressure_pa().is_none() {
            let what =
                format!("`bulk_pa` does not belong to the law \"{}\", which has no pressure", law.name());
            return Err(self.place.error(value.span(), what, "remove it: `poisson` or `lambda_pa` says it"));
        }
        let bulk = *value.get_ref();
        if !(bulk.is_finite() && bulk > 0.0) {
            let fix = "give the bulk modulus in pascals, or leave it out for exact incompressibility";
            return Err(self.wrong("bulk_pa", value, "must be a positive number", fix));
        }
        Ok(Some(bulk))
    }

    /// Lame's constants, from themselves or from Young's modulus and Poisson's ratio.
    fn lame(&self) -> Result<Lame, InputError> {
        let t = self.material.table;
        if t.young_pa.is_some() || t.poisson.is_some() {
            let keys = ["young_pa", "poisson"];
            self.nothing_but(&keys, LAME)?;
            let [young, poisson] = self.values(keys, LAME)?;
            let (e, nu) = (*young.get_ref(), *poisson.get_ref());
            if e <= 0.0 {
                return Err(self.wrong(
                    "young_pa",
                    young,
                    "must be positive",
                    "give Young's modulus in pascals",
                ));
            }
            if !(-1.0 < nu && nu < 0.5) {
                let fix =
                    "give a ratio below 0.5 (0.49 is nearly incompressible), or take an incompressible law";
                return Err(self.wrong("poisson", poisson, "must be above -1 and below 0.5", fix));
            }
            return Ok(Lame::from_young_poisson(e, nu));
        }
        let keys = ["lambda_pa", "mu_pa"];
        self.nothing_but(&keys, LAME)?;
        let [lambda, mu] = self.values(keys, LAME)?;
        if *mu.get_ref() <= 0.0 {
            return Err(self.wrong("mu_pa", mu, "must be positive", "give the shear modulus in pascals"));
        }
        if 3.0 * lambda.get_ref() + 2.0 * mu.get_ref() <= 0.0 {
            let rule = "makes the bulk modulus lambda + 2 mu / 3 negative or zero";
            return Err(self.wrong("lambda_pa", lambda, rule, "give a larger `lambda_pa`"));
        }
        Ok(Lame { lambda_pa: *lambda.get_ref(), mu_pa: *mu.get_ref() })
    }
}
