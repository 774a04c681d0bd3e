//! Incompressible Mooney-Rivlin, with unreduced invariants (paper, Eq. 7) and with reduced ones.

use serde::{Deserialize, Serialize};

use super::{Derivatives, I1, I2, Invariants, J, OfInvariants, Third};

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
/// The law is meant with J = 1, kept by the multiplier (p0 + q)(1 - J). Without the rest pressure p0 = 2 C10 + 4 C01 the
/// undeformed body would not be at rest.
///
/// Deviation: the paper prints 2 C01 before the bracket of Eq. (7); the standard form above is what gives its
/// own E = 6 (C10 + C01) = 15.48 kPa and what its tool, GetFEM, computes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MooneyRivlin {
    /// Coefficient of I1 - 3, Pa.
    pub c10_pa: f64,
    /// Coefficient of I2 - 3, Pa.
    pub c01_pa: f64,
}

impl MooneyRivlin {
    /// p0 = 2 C10 + 4 C01, Pa.
    #[inline(always)]
    pub fn rest_pressure_pa(&self) -> f64 {
        2.0 * self.c10_pa + 4.0 * self.c01_pa
    }
}

impl OfInvariants for MooneyRivlin {
    #[inline(always)]
    fn derivatives(&self, at: &Invariants) -> Derivatives {
        let rest_pa = self.rest_pressure_pa();
        let mut d = Derivatives {
            energy: self.c10_pa * at.i1 + self.c01_pa * at.i2 - rest_pa * at.j,
            ..Derivatives::default()
        };
        d.first[I1] = self.c10_pa;
        d.first[I2] = self.c01_pa;
        d.first[J] = -rest_pa;
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
/// Equal to [`MooneyRivlin`] where J = 1 everywhere; since the constraint holds weakly, the two differ by a few per mille of
/// the force on the paper's P1/P1 meshes. GetFEM 5 has this form built in. The rest pressure is zero. NaN for J <= 0, which
/// Newton's line search steps back from. Source: Holzapfel 2000, section 6.5. Deviation: none.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ReducedMooneyRivlin {
    /// Coefficient of the reduced I1 - 3, Pa.
    pub c10_pa: f64,
    /// Coefficient of the reduced I2 - 3, Pa.
    pub c01_pa: f64,
}

impl OfInvariants for ReducedMooneyRivlin {
    const CURVED: [bool; 4] = [true, true, true, false];
    const THIRD: bool = true;

    #[inline(always)]
    fn derivatives(&self, at: &Invariants) -> Derivatives {
        let Self { c10_pa, c01_pa } = *self;
        let (i1, i2, jacobian) = (at.i1 + 3.0, at.i2 + 3.0, 1.0 + at.j);
        // a - 1 without cancellation, so that the energy of a small strain keeps its digits.
        let less = (-2.0 / 3.0 * at.j.ln_1p()).exp_m1();
        let a = 1.0 + less;
        let (b, inverse) = (a * a, jacobian.recip());
        let mut d = Derivatives {
            energy: c10_pa * (at.i1 * a + 3.0 * less) + c01_pa * (at.i2 * b + 3.0 * less * (a + 1.0)),
            ..Derivatives::default()
        };
        d.first = [
            c10_pa * a,
            c01_pa * b,
            (-2.0 / 3.0 * c10_pa * i1 * a - 4.0 / 3.0 * c01_pa * i2 * b) * inverse,
            0.0,
        ];
        d.second[I1][J] = -2.0 / 3.0 * c10_pa * a * inverse;
        d.second[I2][J] = -4.0 / 3.0 * c01_pa * b * inverse;
        d.second[J][I1] = d.second[I1][J];
        d.second[J][I2] = d.second[I2][J];
        d.second[J][J] = (10.0 / 9.0 * c10_pa * i1 * a + 28.0 / 9.0 * c01_pa * i2 * b) * inverse * inverse;
        d
    }

    #[inline(always)]
    fn third(&self, at: &Invariants) -> Third {
        let Self { c10_pa, c01_pa } = *self;
        let inverse = (1.0 + at.j).recip();
        let a = (-2.0 / 3.0 * at.j.ln_1p()).exp();
        let b = a * a;
        let mut third = Third::default();
        third[I1][J][J] = 10.0 / 9.0 * c10_pa * a * inverse.powi(2);
        third[I2][J][J] = 28.0 / 9.0 * c01_pa * b * inverse.powi(2);
        third[J][J][J] = (-80.0 / 27.0 * c10_pa * (at.i1 + 3.0) * a
            - 280.0 / 27.0 * c01_pa * (at.i2 + 3.0) * b)
            * inverse.powi(3);
        third
    }
}
