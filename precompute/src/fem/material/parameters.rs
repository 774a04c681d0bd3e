//! The parts of a law of the list besides its energy: input of its parameters, and comparison with other
//! laws.

use std::fmt::Debug;

use super::{Describe, Lame, Law, Value};

/// A parameter of a law in a scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Key {
    /// A number.
    Number(&'static str),
    /// Three numbers.
    Vector(&'static str),
}

impl Key {
    pub(crate) fn name(self) -> &'static str {
        let (Self::Number(name) | Self::Vector(name)) = self;
        name
    }
}

/// Why parameters are invalid.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{what}; {fix}")]
pub struct ParameterError {
    /// The parameter at fault; `None` if the law itself is.
    pub key: Option<String>,
    /// The error.
    pub what: String,
    /// The remedy.
    pub fix: String,
}

impl ParameterError {
    /// An error of the law itself.
    pub(crate) fn of_law(what: impl Into<String>, fix: impl Into<String>) -> Self {
        Self { key: None, what: what.into(), fix: fix.into() }
    }

    fn at(key: &str, what: impl Into<String>, fix: impl Into<String>) -> Self {
        Self { key: Some(key.into()), ..Self::of_law(what, fix) }
    }
}

/// A law of the list [`super::LAWS`].
pub(crate) trait BuiltIn: Law + Sized {
    /// Parameters that the law accepts.
    const KEYS: &'static [Key];
    /// Description of the required parameters.
    const WANTED: &'static str;

    /// The law with these parameters, from a scene or from [`super::Describe::parameters`].
    fn from_parameters(given: &Parameters<'_>) -> Result<Self, ParameterError>;

    /// Warnings about unusual but solvable parameters.
    fn warnings(&self) -> Vec<String> {
        Vec::new()
    }

    /// Moduli at small strain, with the bulk modulus if a law with a pressure has one. `None` if there is no
    /// isotropic law with these moduli.
    fn small_strain(&self, _bulk_modulus_pa: Option<f64>) -> Option<SmallStrain> {
        None
    }

    /// The law with these moduli at small strain.
    fn with_small_strain(_moduli: &SmallStrain) -> Option<Self> {
        None
    }

    /// The law whose energy is the derivative of the energy with respect to the number `key`, the other keys given
    /// with it held. `None` if the energy is not linear in the constants behind the key.
    fn derivative(&self, key: &str) -> Option<Self>;
}

/// Moduli of an isotropic law at small strain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SmallStrain {
    /// Lame's constants.
    pub(crate) lame: Lame,
    /// C10 and C01 of a Mooney-Rivlin law, Pa.
    pub(crate) mooney_rivlin_pa: [f64; 2],
}

impl Lame {
    /// Reads Lame's constants, or converts Young's modulus and Poisson's ratio.
    pub(super) fn from_parameters(given: &Parameters<'_>) -> Result<Self, ParameterError> {
        if given.has("young_pa") || given.has("poisson") {
            given.only(&["young_pa", "poisson"])?;
            let [young, poisson] = given.numbers(["young_pa", "poisson"])?;
            if young <= 0.0 {
                let fix = "give Young's modulus in pascals";
                return Err(given.wrong("young_pa", young, "must be positive", fix));
            }
            if !(-1.0 < poisson && poisson < 0.5) {
                let fix =
                    "give a ratio below 0.5 (0.49 is nearly incompressible), or take an incompressible law";
                return Err(given.wrong("poisson", poisson, "must be above -1 and below 0.5", fix));
            }
            return Ok(Self::from_young_poisson(young, poisson));
        }
        given.only(&["lambda_pa", "mu_pa"])?;
        let [lambda_pa, mu_pa] = given.numbers(["lambda_pa", "mu_pa"])?;
        if mu_pa <= 0.0 {
            return Err(given.wrong("mu_pa", mu_pa, "must be positive", "give the shear modulus in pascals"));
        }
        if 3.0 * lambda_pa + 2.0 * mu_pa <= 0.0 {
            let rule = "makes the bulk modulus lambda + 2 mu / 3 negative or zero";
            return Err(given.wrong("lambda_pa", lambda_pa, rule, "give a larger `lambda_pa`"));
        }
        Ok(Self { lambda_pa, mu_pa })
    }
}

/// A law with Lame's constants as its only parameters.
pub(crate) trait OfLame: Debug + Send + Sync + Sized + 'static {
    /// Pressure at rest, Pa; `None` for a compressible law.
    const REST_PRESSURE_PA: Option<f64> = None;

    fn lame(&self) -> Lame;
    fn with_lame(lame: Lame) -> Self;
}

impl<L: OfLame> Describe for L {
    fn parameters(&self) -> Vec<(&'static str, Value)> {
        let Lame { lambda_pa, mu_pa } = self.lame();
        vec![("lambda_pa", lambda_pa.into()), ("mu_pa", mu_pa.into())]
    }

    fn shear_modulus_pa(&self) -> f64 {
        self.lame().mu_pa
    }

    fn rest_pressure_pa(&self) -> Option<f64> {
        L::REST_PRESSURE_PA
    }
}

impl<L: OfLame + Law> BuiltIn for L {
    const KEYS: &'static [Key] =
        &[Key::Number("young_pa"), Key::Number("poisson"), Key::Number("lambda_pa"), Key::Number("mu_pa")];
    const WANTED: &'static str = "either `young_pa` and `poisson`, or `lambda_pa` and `mu_pa`";

    fn from_parameters(given: &Parameters<'_>) -> Result<Self, ParameterError> {
        Ok(Self::with_lame(Lame::from_parameters(given)?))
    }

    fn small_strain(&self, _: Option<f64>) -> Option<SmallStrain> {
        let lame = self.lame();
        Some(SmallStrain { lame, mooney_rivlin_pa: [0.25 * lame.mu_pa; 2] })
    }

    fn with_small_strain(moduli: &SmallStrain) -> Option<Self> {
        Some(Self::with_lame(moduli.lame))
    }

    /// The energy is linear in lambda and mu.
    fn derivative(&self, key: &str) -> Option<Self> {
        let lame = self.lame();
        let by = match key {
            "lambda_pa" => Lame { lambda_pa: 1.0, mu_pa: 0.0 },
            "mu_pa" => Lame { lambda_pa: 0.0, mu_pa: 1.0 },
            "young_pa" => lame.by_young(),
            "poisson" => lame.by_poisson(),
            _ => return None,
        };
        Some(Self::with_lame(by))
    }
}

/// Parameters given for a law.
#[derive(Debug)]
pub(crate) struct Parameters<'a> {
    law: &'a str,
    wanted: &'static str,
    given: &'a [(&'a str, Value)],
}

impl<'a> Parameters<'a> {
    /// The parameters `given` for the law `L` of this name.
    pub(crate) fn of<L: BuiltIn>(law: &'a str, given: &'a [(&'a str, Value)]) -> Self {
        Self { law, wanted: L::WANTED, given }
    }

    /// Whether `key` is given.
    pub(crate) fn has(&self, key: &str) -> bool {
        self.value(key).is_some()
    }

    /// Refuses all keys except these.
    pub(crate) fn only(&self, keys: &[&str]) -> Result<(), ParameterError> {
        let Some((key, _)) = self.given.iter().find(|(given, _)| !keys.contains(given)) else {
            return Ok(());
        };
        let what = format!("`{key}` does not belong to the law \"{}\" here", self.law);
        Err(ParameterError::at(key, what, format!("give {}", self.wanted)))
    }

    /// Numbers that are required and must be finite.
    pub(crate) fn numbers<const N: usize>(&self, keys: [&str; N]) -> Result<[f64; N], ParameterError> {
        let mut numbers = [0.0; N];
        for (number, key) in numbers.iter_mut().zip(keys) {
            *number = self.number(key)?.ok_or_else(|| self.lacks(key, format!("give {}", self.wanted)))?;
        }
        Ok(numbers)
    }

    /// An optional number, which must be finite.
    pub(crate) fn number(&self, key: &str) -> Result<Option<f64>, ParameterError> {
        match self.value(key) {
            None => Ok(None),
            Some(Value::Number(number)) if number.is_finite() => Ok(Some(number)),
            Some(Value::Number(number)) => {
                Err(self.wrong(key, number, "must be a finite number", "correct the value"))
            }
            Some(vector) => {
                let what = format!("`{key}` = {:?} is not one number", vector.numbers());
                Err(ParameterError::at(key, what, "give a number"))
            }
        }
    }

    /// The unit vector along a required direction; `example` is a value for the message.
    pub(crate) fn direction(&self, key: &str, example: &str) -> Result<[f64; 3], ParameterError> {
        let fix = format!("give the {key} direction, for example `{key} = {example}`");
        let value = self.value(key).ok_or_else(|| self.lacks(key, fix))?;
        let vector = match value {
            Value::Vector(vector) => nalgebra::Vector3::from(vector),
            Value::Number(_) => nalgebra::Vector3::zeros(),
        };
        let unit = vector.try_normalize(0.0).filter(|unit| unit.iter().all(|c| c.is_finite()));
        unit.map(Into::into).ok_or_else(|| {
            let what = format!("`{key}` = {:?} is not a direction", value.numbers());
            ParameterError::at(key, what, "give a vector that is not zero")
        })
    }

    /// Error for a number that is out of range for the law.
    pub(crate) fn wrong(&self, key: &str, number: f64, rule: &str, fix: &str) -> ParameterError {
        ParameterError::at(key, format!("`{key}` = {number} {rule}"), fix)
    }

    fn value(&self, key: &str) -> Option<Value> {
        self.given.iter().find(|(given, _)| *given == key).map(|(_, value)| *value)
    }

    fn lacks(&self, key: &str, fix: String) -> ParameterError {
        ParameterError::of_law(format!("the law \"{}\" lacks `{key}`", self.law), fix)
    }
}
