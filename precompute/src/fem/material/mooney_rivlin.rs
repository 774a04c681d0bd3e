//! Incompressible Mooney-Rivlin, with unreduced invariants (paper, Eq. 7) and with reduced ones.

use super::invariants::{Derivatives, I1, I2, Invariants, J, OfInvariants, Third, no_third};
use super::parameters::{BuiltIn, Key, ParameterError, Parameters, SmallStrain};
use super::{Describe, Lame, Value};
use crate::num::lanes::Real;

/// Poisson's ratio of a nearly incompressible material, for laws without a pressure, as in the paper.
pub(crate) const NEARLY_INCOMPRESSIBLE: f64 = 0.49;

/// W = C10 (I1 - 3) + C01 (I2 - 3), with C = I + 2 gamma, so that
///
/// I1 - 3 = 2 tr gamma,   I2 - 3 = 4 tr gamma + 2 (tr^2 gamma - tr gamma^2),
///
/// W = 2 [ (C10 + 2 C01) tr gamma + C01 (tr^2 gamma - tr gamma^2) ]
///
/// S = dW/dgamma = 2 (C10 + 2 C01) I + 4 C01 ((tr gamma) I - gamma) - (p0 + q) J C^-1
///
/// dS/dgamma = 4 C01 (I (x) I - Is) - (p0 + q) J (C^-1 (x) C^-1 - 2 C^-1 o C^-1).
///
/// In invariants: f = C10 i1 + C01 i2 - p0 j,   f1 = C10,   f2 = C01,   fJ = -p0.
///
/// The law requires J = 1, imposed by the multiplier (p0 + q)(1 - J). The rest pressure p0 = 2 C10 + 4 C01
/// makes the undeformed body free of stress.
///
/// Deviation: the paper prints 2 C01 before the bracket of Eq. (7). The standard form above gives the paper's
/// own E = 6 (C10 + C01) = 15.48 kPa, and its tool, GetFEM, computes this form.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MooneyRivlin {
    /// Coefficient of I1 - 3, Pa.
    pub c10_pa: f64,
    /// Coefficient of I2 - 3, Pa.
    pub c01_pa: f64,
}

impl Describe for MooneyRivlin {
    fn parameters(&self) -> Vec<(&'static str, Value)> {
        vec![("c10_pa", self.c10_pa.into()), ("c01_pa", self.c01_pa.into())]
    }

    fn shear_modulus_pa(&self) -> f64 {
        2.0 * (self.c10_pa + self.c01_pa)
    }

    /// p0 = 2 C10 + 4 C01.
    fn rest_pressure_pa(&self) -> Option<f64> {
        Some(2.0 * self.c10_pa + 4.0 * self.c01_pa)
    }
}

impl BuiltIn for MooneyRivlin {
    const KEYS: &'static [Key] = &[Key::Number("c10_pa"), Key::Number("c01_pa")];
    const WANTED: &'static str = "`c10_pa` and `c01_pa`";

    fn from_parameters(given: &Parameters<'_>) -> Result<Self, ParameterError> {
        given.only(&["c10_pa", "c01_pa"])?;
        let [c10_pa, c01_pa] = given.numbers(["c10_pa", "c01_pa"])?;
        if c10_pa + c01_pa <= 0.0 {
            let rule = "and `c01_pa` must have a positive sum (the shear modulus is twice it)";
            return Err(given.wrong("c10_pa", c10_pa, rule, "give positive constants in pascals"));
        }
        Ok(Self { c10_pa, c01_pa })
    }

    fn warnings(&self) -> Vec<String> {
        let negative =
            [("c10_pa", self.c10_pa), ("c01_pa", self.c01_pa)].into_iter().filter(|(_, c)| *c < 0.0);
        let warning = |(key, value)| {
            format!("`{key}` = {value} is negative: the material may lose its stability when strained")
        };
        negative.map(warning).collect()
    }

    /// E = 3 mu, and nu = 0.49 without a bulk modulus, as in the paper.
    fn small_strain(&self, bulk_modulus_pa: Option<f64>) -> Option<SmallStrain> {
        let mu_pa = self.shear_modulus_pa();
        let lame = match bulk_modulus_pa {
            None => Lame::from_young_poisson(3.0 * mu_pa, NEARLY_INCOMPRESSIBLE),
            Some(bulk_pa) => Lame { lambda_pa: bulk_pa - 2.0 / 3.0 * mu_pa, mu_pa },
        };
        Some(SmallStrain { lame, mooney_rivlin_pa: [self.c10_pa, self.c01_pa] })
    }

    fn with_small_strain(moduli: &SmallStrain) -> Option<Self> {
        let [c10_pa, c01_pa] = moduli.mooney_rivlin_pa;
        Some(Self { c10_pa, c01_pa })
    }

    fn derivative(&self, key: &str) -> Option<Self> {
        match key {
            "c10_pa" => Some(Self { c10_pa: 1.0, c01_pa: 0.0 }),
            "c01_pa" => Some(Self { c10_pa: 0.0, c01_pa: 1.0 }),
            _ => None,
        }
    }
}

impl OfInvariants for MooneyRivlin {
    #[inline(always)]
    fn derivatives<R: Real>(&self, at: &Invariants<R>) -> Derivatives<R> {
        let rest_pa = 2.0 * self.c10_pa + 4.0 * self.c01_pa;
        let energy = at.i1 * self.c10_pa + at.i2 * self.c01_pa - at.j * rest_pa;
        let mut d = Derivatives::of_energy(energy);
        d.first[I1] = energy.constant(self.c10_pa);
        d.first[I2] = energy.constant(self.c01_pa);
        d.first[J] = energy.constant(-rest_pa);
        d
    }
}

/// W = C10 (I1 J^-2/3 - 3) + C01 (I2 J^-4/3 - 3) with the multiplier q (1 - J)
///
/// With a = J^-2/3 and b = J^-4/3:
///
/// S = dW/dgamma = 2 C10 a (I - I1/3 C^-1) + 2 C01 b (I1 I - C - 2 I2/3 C^-1) - q J C^-1
///
/// dS/dgamma by the chain rule of [`super`] with
///
/// f1 = C10 a,   f2 = C01 b,   fJ = -2/3 C10 I1 J^-5/3 - 4/3 C01 I2 J^-7/3
///
/// f1J = -2/3 C10 J^-5/3,   f2J = -4/3 C01 J^-7/3,   fJJ = 10/9 C10 I1 J^-8/3 + 28/9 C01 I2 J^-10/3
///
/// f1JJ = 10/9 C10 J^-8/3,   f2JJ = 28/9 C01 J^-10/3,   fJJJ = -80/27 C10 I1 J^-11/3 - 280/27 C01 I2 J^-13/3.
///
/// Equal to [`MooneyRivlin`] where J = 1 everywhere. The constraint holds weakly, so the forces of the two
/// differ by a few per mille on the paper's P1/P1 meshes. GetFEM 5 has this form built in. The rest pressure
/// is zero. For J <= 0 the energy is NaN, and Newton's line search shortens the step. Source: Holzapfel 2000,
/// section 6.5. Deviation: none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReducedMooneyRivlin(pub MooneyRivlin);

impl Describe for ReducedMooneyRivlin {
    fn parameters(&self) -> Vec<(&'static str, Value)> {
        self.0.parameters()
    }

    fn shear_modulus_pa(&self) -> f64 {
        self.0.shear_modulus_pa()
    }

    fn rest_pressure_pa(&self) -> Option<f64> {
        Some(0.0)
    }
}

/// Same parameters and moduli as [`MooneyRivlin`].
impl BuiltIn for ReducedMooneyRivlin {
    const KEYS: &'static [Key] = MooneyRivlin::KEYS;
    const WANTED: &'static str = MooneyRivlin::WANTED;

    fn from_parameters(given: &Parameters<'_>) -> Result<Self, ParameterError> {
        MooneyRivlin::from_parameters(given).map(Self)
    }

    fn warnings(&self) -> Vec<String> {
        self.0.warnings()
    }

    fn small_strain(&self, bulk_modulus_pa: Option<f64>) -> Option<SmallStrain> {
        self.0.small_strain(bulk_modulus_pa)
    }

    fn with_small_strain(moduli: &SmallStrain) -> Option<Self> {
        MooneyRivlin::with_small_strain(moduli).map(Self)
    }

    fn derivative(&self, key: &str) -> Option<Self> {
        self.0.derivative(key).map(Self)
    }
}

impl OfInvariants for ReducedMooneyRivlin {
    const CURVED: [bool; 4] = [true, true, true, false];
    const THIRD: bool = true;

    #[inline(always)]
    fn derivatives<R: Real>(&self, at: &Invariants<R>) -> Derivatives<R> {
        let MooneyRivlin { c10_pa, c01_pa } = self.0;
        let (i1, i2, jacobian) = (at.i1 + 3.0, at.i2 + 3.0, at.j + 1.0);
        // a - 1 without cancellation, so that the energy of a small strain keeps its precision.
        let less = at.j.map(|j| libm::expm1(-2.0 / 3.0 * libm::log1p(j)));
        let a = less + 1.0;
        let (b, inverse) = (a * a, jacobian.recip());
        let energy = (at.i1 * a + less * 3.0) * c10_pa + (at.i2 * b + less * 3.0 * (a + 1.0)) * c01_pa;
        let mut d = Derivatives::of_energy(energy);
        d.first[I1] = a * c10_pa;
        d.first[I2] = b * c01_pa;
        d.first[J] = (i1 * (-2.0 / 3.0 * c10_pa) * a - i2 * (4.0 / 3.0 * c01_pa) * b) * inverse;
        d.second[I1][J] = a * (-2.0 / 3.0 * c10_pa) * inverse;
        d.second[I2][J] = b * (-4.0 / 3.0 * c01_pa) * inverse;
        d.second[J][I1] = d.second[I1][J];
        d.second[J][I2] = d.second[I2][J];
        d.second[J][J] =
            (i1 * (10.0 / 9.0 * c10_pa) * a + i2 * (28.0 / 9.0 * c01_pa) * b) * inverse * inverse;
        d
    }

    #[inline(always)]
    fn third<R: Real>(&self, at: &Invariants<R>) -> Third<R> {
        let MooneyRivlin { c10_pa, c01_pa } = self.0;
        let inverse = (at.j + 1.0).recip();
        let inverse_squared = inverse * inverse;
        let a = at.j.map(|j| libm::exp(-2.0 / 3.0 * libm::log1p(j)));
        let b = a * a;
        let mut third = no_third(at.j);
        third[I1][J][J] = a * (10.0 / 9.0 * c10_pa) * inverse_squared;
        third[I2][J][J] = b * (28.0 / 9.0 * c01_pa) * inverse_squared;
        third[J][J][J] = ((at.i1 + 3.0) * (-80.0 / 27.0 * c10_pa) * a
            - (at.i2 + 3.0) * (280.0 / 27.0 * c01_pa) * b)
            * (inverse * inverse_squared);
        third
    }
}
