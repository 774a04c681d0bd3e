//! Holzapfel-Gasser-Ogden: an incompressible matrix with one family of stiffening fibres.

use super::invariants::{Derivatives, I1, I4, Invariants, J, OfInvariants, Third, no_third};
use super::parameters::{BuiltIn, Key, ParameterError, Parameters};
use super::{Describe, Value};
use crate::num::lanes::Real;

/// W = C10 (I1 - 3) + k1/(2 k2) [ exp(k2 s(E)^2) - 1 ] with the multiplier (p0 + q)(1 - J),
///
/// E = kappa (I1 - 3) + (1 - 3 kappa)(I4 - 1),   I4 = |F a|^2:
///
/// the fibre strain, with dispersion kappa in 0 ..= 1/3.
///
/// S = dW/dgamma = 2 C10 I + 2 g'(E) [ kappa I + (1 - 3 kappa) a (x) a ] - (p0 + q) J C^-1
///
/// dS/dgamma = 4 g''(E) M (x) M - (p0 + q) J (C^-1 (x) C^-1 - 2 C^-1 o C^-1),
///
/// M = kappa I + (1 - 3 kappa) a (x) a,
///
/// where g(E) = k1/(2 k2) [ exp(k2 s^2) - 1 ]:
///
/// g' = k1 e s s',   g'' = k1 e [ (1 + 2 k2 s^2) s'^2 + s s'' ],
///
/// g''' = k1 e [ (6 k2 s + 4 k2^2 s^3) s'^3 + 3 (1 + 2 k2 s^2) s' s'' + s s''' ],   e = exp(k2 s^2).
///
/// Fibres do not carry compression. The usual switch, s = max(E, 0), makes g'' discontinuous. Here s is
/// smooth: s = 0 for E < 0, s = E for E > w, and s = w t^4 (20 - 45 t + 36 t^2 - 10 t^3) with t = E / w in
/// between. Its first three derivatives are continuous at both ends. W is C3, so the third derivatives of the
/// condensed energy are continuous.
///
/// Source: Gasser, Ogden and Holzapfel 2006, Eqs. (3.2) and (4.3). Deviations: the smooth switch, and
/// unreduced invariants.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HolzapfelGasserOgden {
    /// Coefficient of I1 - 3 (the matrix), Pa.
    pub c10_pa: f64,
    /// Fibre stiffness, Pa.
    pub k1_pa: f64,
    /// Fibre stiffening, dimensionless, positive.
    pub k2: f64,
    /// Dispersion kappa: 0 for parallel fibres, 1/3 for isotropy.
    pub dispersion: f64,
    /// Fibre direction in the undeformed body, a unit vector.
    pub fibre: [f64; 3],
}

/// Width w of the smooth switch in terms of the fibre strain E.
const SWITCH_WIDTH: f64 = 0.02;

impl HolzapfelGasserOgden {
    /// Derivatives of E with respect to I1 and I4.
    #[inline(always)]
    fn strain_slopes(&self) -> [f64; 2] {
        [self.dispersion, 1.0 - 3.0 * self.dispersion]
    }

    /// g and its three derivatives at the fibre strain of `at`.
    #[inline(always)]
    fn fibre_energy<R: Real>(&self, at: &Invariants<R>) -> [R; 4] {
        let Self { k1_pa, k2, .. } = *self;
        let [by_i1, by_i4] = self.strain_slopes();
        let [s, s1, s2, s3] = smooth_switch(at.i1 * by_i1 + at.i4 * by_i4);
        let exponent = s * k2 * s;
        let scale = exponent.map(libm::exp) * k1_pa;
        let stiffening = exponent * 2.0 + 1.0;
        [
            exponent.map(libm::expm1) * (0.5 * k1_pa / k2),
            scale * s * s1,
            scale * (stiffening * s1 * s1 + s * s2),
            scale * (s * k2 * (exponent * 4.0 + 6.0) * s1 * s1 * s1 + stiffening * 3.0 * s1 * s2 + s * s3),
        ]
    }
}

impl Describe for HolzapfelGasserOgden {
    fn parameters(&self) -> Vec<(&'static str, Value)> {
        vec![
            ("c10_pa", self.c10_pa.into()),
            ("k1_pa", self.k1_pa.into()),
            ("k2", self.k2.into()),
            ("dispersion", self.dispersion.into()),
            ("fibre", self.fibre.into()),
        ]
    }

    fn shear_modulus_pa(&self) -> f64 {
        2.0 * self.c10_pa
    }

    /// p0 = 2 C10: the fibres have no stress at rest.
    fn rest_pressure_pa(&self) -> Option<f64> {
        Some(2.0 * self.c10_pa)
    }
}

impl BuiltIn for HolzapfelGasserOgden {
    const KEYS: &'static [Key] = &[
        Key::Number("c10_pa"),
        Key::Number("k1_pa"),
        Key::Number("k2"),
        Key::Number("dispersion"),
        Key::Vector("fibre"),
    ];
    const WANTED: &'static str = "`c10_pa`, `k1_pa`, `k2` and `fibre`, and `dispersion` if it is not 0";

    fn from_parameters(given: &Parameters<'_>) -> Result<Self, ParameterError> {
        given.only(&["c10_pa", "k1_pa", "k2", "dispersion", "fibre"])?;
        let keys = ["c10_pa", "k1_pa", "k2"];
        let numbers @ [c10_pa, k1_pa, k2] = given.numbers(keys)?;
        if let Some((key, number)) = keys.into_iter().zip(numbers).find(|(_, number)| *number <= 0.0) {
            return Err(given.wrong(key, number, "must be positive", "correct the value"));
        }
        let dispersion = given.number("dispersion")?.unwrap_or(0.0);
        if !(0.0..=1.0 / 3.0).contains(&dispersion) {
            let fix = "0 is all fibres parallel, 0.3333 is isotropic";
            return Err(given.wrong("dispersion", dispersion, "must be from 0 to 1/3", fix));
        }
        let fibre = given.direction("fibre", "[1.0, 0.0, 0.0]")?;
        Ok(Self { c10_pa, k1_pa, k2, dispersion, fibre })
    }

    /// The energy is linear in C10 and k1 only.
    fn derivative(&self, key: &str) -> Option<Self> {
        match key {
            "c10_pa" => Some(Self { c10_pa: 1.0, k1_pa: 0.0, ..*self }),
            "k1_pa" => Some(Self { c10_pa: 0.0, k1_pa: 1.0, ..*self }),
            _ => None,
        }
    }
}

impl OfInvariants for HolzapfelGasserOgden {
    const CURVED: [bool; 4] = [true, false, false, true];
    const THIRD: bool = true;
    const SECOND_INVARIANT: bool = false;
    const FIBRES: bool = true;

    #[inline(always)]
    fn fibre(&self) -> [f64; 3] {
        self.fibre
    }

    #[inline(always)]
    fn derivatives<R: Real>(&self, at: &Invariants<R>) -> Derivatives<R> {
        let rest_pa = 2.0 * self.c10_pa;
        let [by_i1, by_i4] = self.strain_slopes();
        let [g, g1, g2, _] = self.fibre_energy(at);
        let mut d = Derivatives::of_energy(at.i1 * self.c10_pa - at.j * rest_pa + g);
        d.first[I1] = g1 * by_i1 + self.c10_pa;
        d.first[J] = g.constant(-rest_pa);
        d.first[I4] = g1 * by_i4;
        d.second[I1][I1] = g2 * (by_i1 * by_i1);
        d.second[I1][I4] = g2 * (by_i1 * by_i4);
        d.second[I4][I1] = d.second[I1][I4];
        d.second[I4][I4] = g2 * (by_i4 * by_i4);
        d
    }

    #[inline(always)]
    fn third<R: Real>(&self, at: &Invariants<R>) -> Third<R> {
        let [by_i1, by_i4] = self.strain_slopes();
        let [.., g3] = self.fibre_energy(at);
        let mut third = no_third(at.j);
        third[I1][I1][I1] = g3 * by_i1.powi(3);
        third[I1][I1][I4] = g3 * (by_i1.powi(2) * by_i4);
        third[I1][I4][I4] = g3 * (by_i1 * by_i4.powi(2));
        third[I4][I4][I4] = g3 * by_i4.powi(3);
        third
    }
}

/// s(E) and its three derivatives.
#[inline(always)]
fn smooth_switch<R: Real>(strain: R) -> [R; 4] {
    let t = strain / SWITCH_WIDTH;
    let (t2, t3, w) = (t * t, t * t * t, SWITCH_WIDTH);
    let between = [
        t2 * w * t2 * (-(t * 45.0) + 20.0 + t2 * 36.0 - t3 * 10.0),
        t3 * (-(t * 225.0) + 80.0 + t2 * 216.0 - t3 * 70.0),
        t2 * (-(t * 900.0) + 240.0 + t2 * 1080.0 - t3 * 420.0) / w,
        t * (-(t * 2700.0) + 480.0 + t2 * 4320.0 - t3 * 2100.0) / (w * w),
    ];
    let (zero, one) = (t.constant(0.0), t.constant(1.0));
    let above = [strain, one, zero, zero];
    let mut switch = [zero; 4];
    for (value, (between, above)) in switch.iter_mut().zip(between.into_iter().zip(above)) {
        let above_zero = t.where_less(one, between, above);
        *value = t.where_less(zero, zero, above_zero);
    }
    switch
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_switch_meets_both_ends_with_three_derivatives() {
        let (low, high) = (1e-9 * SWITCH_WIDTH, (1.0 - 1e-9) * SWITCH_WIDTH);
        let [s, s1, s2, s3] = smooth_switch(low);
        assert!(s < 1e-30 && s1 < 1e-20 && s2.abs() < 1e-10 && s3.abs() * SWITCH_WIDTH * SWITCH_WIDTH < 1e-6);
        let [s, s1, s2, s3] = smooth_switch(high);
        assert!((s - high).abs() < 1e-15 && (s1 - 1.0).abs() < 1e-12);
        assert!(s2.abs() * SWITCH_WIDTH < 1e-9 && s3.abs() * SWITCH_WIDTH * SWITCH_WIDTH < 1e-5);
    }

    #[test]
    fn each_derivative_of_the_switch_is_the_slope_of_the_one_before() {
        let step = 1e-6 * SWITCH_WIDTH;
        for strain in [-0.01, 0.003, 0.011, 0.0197, 0.3] {
            let (here, plus, minus) =
                (smooth_switch(strain), smooth_switch(strain + step), smooth_switch(strain - step));
            for order in 0..3 {
                let slope = (plus[order] - minus[order]) / (2.0 * step);
                let scale = SWITCH_WIDTH.powi(-(order as i32));
                assert!((slope - here[order + 1]).abs() < 1e-5 * scale, "s({strain}), order {order}");
            }
        }
    }
}
