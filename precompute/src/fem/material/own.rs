//! Laws behind dynamic dispatch: those from outside this crate, and any law outside the vectorised loops.

use std::sync::Arc;

use super::{Describe, Law, Tangent};
use crate::fem::kinematics::Kinematics;
use crate::num::lanes::{MAX_LANES, Real};
use crate::num::tensor::Mat3;

/// A user-defined law with its name, made by [`super::Material::own`].
///
/// Every evaluation is one dynamic call per element, while the built-in laws are compiled into the vectorised
/// loops of the assembly. Two such laws are equal if their names and parameters are equal.
#[derive(Debug, Clone)]
pub struct OwnLaw {
    pub(super) name: &'static str,
    pub(crate) law: Arc<dyn ErasedLaw>,
}

/// [`Law`] for a single f64, as a dyn-compatible trait.
pub(crate) trait ErasedLaw: Describe {
    fn stress_at(&self, k: &Kinematics, q_pa: f64) -> (f64, Mat3<f64>);
    fn response_at(&self, k: &Kinematics, q_pa: f64) -> (f64, Mat3<f64>, Tangent);
    fn third_at(&self, k: &Kinematics, q_pa: f64, gradients: &[Mat3<f64>; 3], dq_pa: &[f64; 3]) -> [f64; 10];
}

impl<L: Law> ErasedLaw for L {
    fn stress_at(&self, k: &Kinematics, q_pa: f64) -> (f64, Mat3<f64>) {
        self.stress(k, q_pa)
    }

    fn response_at(&self, k: &Kinematics, q_pa: f64) -> (f64, Mat3<f64>, Tangent) {
        self.response(k, q_pa)
    }

    fn third_at(&self, k: &Kinematics, q_pa: f64, gradients: &[Mat3<f64>; 3], dq_pa: &[f64; 3]) -> [f64; 10] {
        self.third_along(k, q_pa, gradients, dq_pa)
    }
}

impl PartialEq for OwnLaw {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name && self.law.parameters() == other.law.parameters()
    }
}

/// `at` evaluated for each lane of an `R`.
#[inline(always)]
fn each_lane<R: Real, T: Copy>(mut at: impl FnMut(usize) -> T) -> [T; MAX_LANES] {
    let mut all = [at(0); MAX_LANES];
    for (lane, value) in all.iter_mut().enumerate().take(R::LANES).skip(1) {
        *value = at(lane);
    }
    all
}

impl Law for dyn ErasedLaw {
    #[inline(always)]
    fn stress<R: Real>(&self, k: &Kinematics<R>, q_pa: R) -> (R, Mat3<R>) {
        let all = each_lane::<R, _>(|lane| self.stress_at(&k.lane(lane), q_pa.lane(lane)));
        (q_pa.with_lanes(|lane| all[lane].0), Mat3::from_lanes(q_pa, |lane| &all[lane].1))
    }

    #[inline(always)]
    fn response<R: Real>(&self, k: &Kinematics<R>, q_pa: R) -> (R, Mat3<R>, Tangent<R>) {
        let all = each_lane::<R, _>(|lane| self.response_at(&k.lane(lane), q_pa.lane(lane)));
        let energy = q_pa.with_lanes(|lane| all[lane].0);
        let stress = Mat3::from_lanes(q_pa, |lane| &all[lane].1);
        (energy, stress, Tangent::from_lanes(q_pa, |lane| &all[lane].2))
    }

    #[inline(always)]
    fn third_along<R: Real>(
        &self,
        k: &Kinematics<R>,
        q_pa: R,
        gradients: &[Mat3<R>; 3],
        dq_pa: &[R; 3],
    ) -> [R; 10] {
        let all = each_lane::<R, _>(|lane| {
            let gradients = gradients.map(|gradient| gradient.lane(lane));
            self.third_at(&k.lane(lane), q_pa.lane(lane), &gradients, &dq_pa.map(|dq| dq.lane(lane)))
        });
        let mut third = [q_pa; 10];
        for (index, value) in third.iter_mut().enumerate() {
            *value = q_pa.with_lanes(|lane| all[lane][index]);
        }
        third
    }
}
