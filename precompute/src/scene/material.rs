//! From a `[material]` table to a law with parameters that make sense.

use toml::Spanned;

use super::MaterialLaw;
use super::file::{Located, MaterialTable, Place};
use crate::error::{InputError, nearest_word};

/// Every law of the scene format.
const LAWS: [&str; 5] =
    ["linear", "st-venant-kirchhoff", "modified-st-venant-kirchhoff", "mooney-rivlin", "neo-hookean"];

/// The laws this version can solve.
pub(super) const AVAILABLE: [&str; 2] = ["st-venant-kirchhoff", "mooney-rivlin"];

/// Whether the format knows the law at all.
pub(super) fn is_law(name: &str) -> bool {
    LAWS.contains(&name)
}

impl MaterialLaw {
    /// The word of the scene file.
    pub fn name(&self) -> &'static str {
        match self {
            Self::LinearElastic { .. } => "linear",
            Self::StVenantKirchhoff { .. } => "st-venant-kirchhoff",
            Self::ModifiedStVenantKirchhoff { .. } => "modified-st-venant-kirchhoff",
            Self::MooneyRivlin { .. } => "mooney-rivlin",
            Self::NeoHookean { .. } => "neo-hookean",
        }
    }

    /// The two parameters in the order of the variant's fields.
    pub fn parameters_pa(&self) -> [f64; 2] {
        match *self {
            Self::LinearElastic { lambda_pa, mu_pa }
            | Self::StVenantKirchhoff { lambda_pa, mu_pa }
            | Self::ModifiedStVenantKirchhoff { lambda_pa, mu_pa }
            | Self::NeoHookean { lambda_pa, mu_pa } => [lambda_pa, mu_pa],
            Self::MooneyRivlin { c10_pa, c01_pa } => [c10_pa, c01_pa],
        }
    }
}

/// The law of a table; odd but solvable parameters are added to `warnings`.
pub(super) fn law(
    place: &Place,
    material: &Located<'_, MaterialTable>,
    warnings: &mut Vec<String>,
) -> Result<MaterialLaw, InputError> {
    let name = &material.table.law;
    let table = Parameters { place, material };
    if name.get_ref() == "mooney-rivlin" {
        return table.mooney_rivlin(warnings);
    }
    if !is_law(name.get_ref()) {
        let mend = match nearest_word(name.get_ref(), LAWS) {
            Some(guess) => format!("did you mean \"{guess}\"? (laws: {})", LAWS.join(", ")),
            None => format!("choose one of {}", LAWS.join(", ")),
        };
        return Err(place.error(name.span(), format!("unknown law \"{}\"", name.get_ref()), mend));
    }
    let [lambda_pa, mu_pa] = table.lame()?;
    Ok(match name.get_ref().as_str() {
        "linear" => MaterialLaw::LinearElastic { lambda_pa, mu_pa },
        "st-venant-kirchhoff" => MaterialLaw::StVenantKirchhoff { lambda_pa, mu_pa },
        "modified-st-venant-kirchhoff" => MaterialLaw::ModifiedStVenantKirchhoff { lambda_pa, mu_pa },
        _ => MaterialLaw::NeoHookean { lambda_pa, mu_pa },
    })
}

struct Parameters<'a> {
    place: &'a Place,
    material: &'a Located<'a, MaterialTable>,
}

impl Parameters<'_> {
    /// Given keys of the table by name.
    fn given(&self) -> impl Iterator<Item = (&'static str, &Spanned<f64>)> {
        let t = self.material.table;
        [
            ("young_pa", &t.young_pa),
            ("poisson", &t.poisson),
            ("lambda_pa", &t.lambda_pa),
            ("mu_pa", &t.mu_pa),
            ("c10_pa", &t.c10_pa),
            ("c01_pa", &t.c01_pa),
        ]
        .into_iter()
        .filter_map(|(key, value)| Some((key, value.as_ref()?)))
    }

    /// The values of two keys, which must be the only ones given; both finite.
    fn pair(&self, keys: [&'static str; 2], wanted: &str) -> Result<[&Spanned<f64>; 2], InputError> {
        let law = self.material.table.law.get_ref();
        if let Some((key, value)) = self.given().find(|(key, _)| !keys.contains(key)) {
            let what = format!("`{key}` does not belong to the law \"{law}\" here");
            return Err(self.place.error(value.span(), what, format!("give {wanted}")));
        }
        let mut found = [None; 2];
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
        Ok(found.map(|value| value.expect("both keys were found above")))
    }

    fn wrong(&self, key: &str, value: &Spanned<f64>, rule: &str, mend: &str) -> InputError {
        self.place.error(value.span(), format!("`{key}` = {} {rule}", value.get_ref()), mend)
    }

    fn mooney_rivlin(&self, warnings: &mut Vec<String>) -> Result<MaterialLaw, InputError> {
        let [c10, c01] = self.pair(["c10_pa", "c01_pa"], "`c10_pa` and `c01_pa`")?;
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
        Ok(MaterialLaw::MooneyRivlin { c10_pa, c01_pa })
    }

    /// Lame's constants, from themselves or from Young's modulus and Poisson's ratio.
    fn lame(&self) -> Result<[f64; 2], InputError> {
        let wanted = "either `young_pa` and `poisson`, or `lambda_pa` and `mu_pa`";
        let t = self.material.table;
        if t.young_pa.is_some() || t.poisson.is_some() {
            let [young, poisson] = self.pair(["young_pa", "poisson"], wanted)?;
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
                let mend =
                    "give a ratio below 0.5 (0.49 is nearly incompressible), or take an incompressible law";
                return Err(self.wrong("poisson", poisson, "must be above -1 and below 0.5", mend));
            }
            return Ok([e * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), e / (2.0 * (1.0 + nu))]);
        }
        let [lambda, mu] = self.pair(["lambda_pa", "mu_pa"], wanted)?;
        if *mu.get_ref() <= 0.0 {
            return Err(self.wrong("mu_pa", mu, "must be positive", "give the shear modulus in pascals"));
        }
        if 3.0 * lambda.get_ref() + 2.0 * mu.get_ref() <= 0.0 {
            let rule = "makes the bulk modulus lambda + 2 mu / 3 negative or zero";
            return Err(self.wrong("lambda_pa", lambda, rule, "give a larger `lambda_pa`"));
        }
        Ok([*lambda.get_ref(), *mu.get_ref()])
    }
}
