//! The force of one jet: a Taylor polynomial inside the trust radius, levelling off beyond it.
//!
//! Inside, with x = d - d_k:   h = h_k + S_k x + (T_k x) x / 2,   S = S_k + T_k x
//!
//! Beyond, with r = |x|, u = x / r and q = rho u:   h = h(q) + S(q) u phi(r - rho)
//!
//! phi(s) = s - s^2 / 2L up to s = L = max(rho, 5 mm), then L / 2
//!
//! The expansion of a root s = sqrt(2 W) goes straight on beyond, as the force of a contact rises with the depth, and
//! h = max(0, s) ds/dd, W = max(0, s)^2 / 2. A sphere far from where a jet was solved touches another place or nothing: beyond
//! rho + L both fall to zero, over 2 L more.
//!
//! With a second control q, the place of a partner or the half axis of a capsule, and y = q - q_k at most as long as the
//! radius, the gradient has M y in addition, with M = dh/dq, and the value (dW/dq) . y + x . M y + y . Q y / 2, with
//! Q = d2W/dq2. The derivative by q is dW/dq + x M + Q y, that of a root times s.
//!
//! T_k are the third derivatives of the energy. The force is continuous with its derivatives at the radius. It
//! is the gradient of the energy inside. Beyond, the polynomial would grow with the square of the distance; the
//! continuation is bounded, and softer than the body where that stiffens.

use super::frame::{Jet, JetCoupling};
use crate::method::{Coverage, ForceSample};
use crate::num::vec3::{self, Vec3};

/// Smallest distance over which the continuation levels off, metres.
const MIN_LEVELLING_M: f32 = 5e-3;
/// Largest component of a displacement that is used, metres: no square overflows.
const MAX_DISPLACEMENT_M: f32 = 1e3;

/// The displacement with components of at most 1 km; `None` if it is not finite.
pub(super) fn limited(displacement_m: Vec3) -> Option<Vec3> {
    let within = displacement_m.map(|x| x.clamp(-MAX_DISPLACEMENT_M, MAX_DISPLACEMENT_M));
    vec3::is_finite(displacement_m).then_some(within)
}

/// Distance above which its reciprocal is finite, metres.
const SMALLEST_M: f32 = 1e-30;

/// Where a displacement lies relative to a jet.
struct Place {
    /// The displacement from the control, at most as long as the trust radius.
    from_control_m: Vec3,
    /// Unit vector away from the control; zero inside.
    outward: Vec3,
    /// Distance beyond the trust radius; zero inside.
    beyond_m: f32,
}

impl Place {
    /// Share of the force of a root.
    fn nearness(&self, trust_m: f32) -> f32 {
        let length_m = trust_m.max(MIN_LEVELLING_M);
        (1.5 - 0.5 * self.beyond_m / length_m).clamp(0.0, 1.0)
    }

    /// The displacement from the control, no farther than where a root has faded.
    fn way_within(&self, trust_m: f32) -> Vec3 {
        let beyond_m = self.beyond_m.min(3.0 * trust_m.max(MIN_LEVELLING_M));
        vec3::add(self.from_control_m, vec3::scale(self.outward, beyond_m))
    }

    fn coverage(&self) -> Coverage {
        if self.beyond_m <= 0.0 { Coverage::Scattered } else { Coverage::Extrapolated }
    }
}

/// The expansion at a displacement and a second control.
struct Coupled {
    gradient: Vec3,
    value: f32,
    nearness: f32,
    coverage: Coverage,
    from_control_m: Vec3,
    /// y
    moved_m: Vec3,
}

impl Coupled {
    /// What the derivatives are multiplied with: that of a root by its value.
    fn factor(&self, of: &Jet) -> f32 {
        if of.flags.root { self.nearness * self.value.max(0.0) } else { 1.0 }
    }

    fn sample(&self, of: &Jet) -> ForceSample {
        ForceSample { force_n: vec3::scale(self.gradient, self.factor(of)), coverage: self.coverage }
    }
}

impl Jet {
    /// h at a displacement, newtons: `Scattered` inside the trust radius, `Extrapolated` beyond. A displacement
    /// that is not finite has the force at the control, or none of a root, and is `Extrapolated`.
    ///
    /// Needs a jet that [`Jet::decode`] returned; the force is then finite.
    pub fn force(&self, displacement_m: Vec3) -> ForceSample {
        if self.flags.root {
            return self.force_of_root(displacement_m);
        }
        let Some(displacement_m) = limited(displacement_m) else {
            return ForceSample { force_n: self.force_n, coverage: Coverage::Extrapolated };
        };
        let at = self.place(displacement_m);
        ForceSample { force_n: self.gradient(&at), coverage: at.coverage() }
    }

    /// The same of a root. On its own, so that it costs the search for contradictions nothing.
    #[inline(never)]
    fn force_of_root(&self, displacement_m: Vec3) -> ForceSample {
        let at = limited(displacement_m).map(|displacement_m| self.place(displacement_m));
        let (gradient, value, coverage) = match &at {
            Some(at) => {
                let slope = self.polynomial_n(at.from_control_m);
                (slope, self.value(at) * at.nearness(self.trust_m), at.coverage())
            }
            None => (self.force_n, 0.0, Coverage::Extrapolated),
        };
        ForceSample { force_n: vec3::scale(gradient, value.max(0.0)), coverage }
    }

    /// h at a displacement, with a second control; the same as without where the jet or the touch has none.
    pub(super) fn force_beside(&self, displacement_m: Vec3, second_m: Option<Vec3>) -> ForceSample {
        match self.coupling.as_ref().zip(second_m) {
            None => self.force(displacement_m),
            Some((coupling, at_m)) => self.coupled(displacement_m, coupling, at_m).sample(self),
        }
    }

    /// dW/dq at a displacement and a second control q, newtons; zero where the jet has none.
    #[inline(never)]
    pub(super) fn slope_beside(&self, displacement_m: Vec3, second_m: Vec3) -> Vec3 {
        let Some(coupling) = &self.coupling else { return vec3::ZERO };
        let at = self.coupled(displacement_m, coupling, second_m);
        let bent_n = vec3::transform(&vec3::transposed(coupling.mixed_n_m), at.from_control_m);
        let own_n = product(&coupling.own_n_m, at.moved_m);
        vec3::scale(vec3::add(coupling.slope_n, vec3::add(bent_n, own_n)), at.factor(self))
    }

    /// The expansion with a second control.
    // On its own, so that it costs a tool without one nothing.
    #[inline(never)]
    fn coupled(&self, displacement_m: Vec3, coupling: &JetCoupling, second_m: Vec3) -> Coupled {
        let moved_m = vec3::sub(second_m, coupling.control_m);
        let moved_m = vec3::scale(moved_m, (self.trust_m / vec3::norm(moved_m).max(SMALLEST_M)).min(1.0));
        let change_n = vec3::transform(&coupling.mixed_n_m, moved_m);
        let slope_n = vec3::add(coupling.slope_n, vec3::scale(product(&coupling.own_n_m, moved_m), 0.5));
        let at = limited(displacement_m).map(|displacement_m| self.place(displacement_m));
        let (gradient, value, nearness, coverage, from_control_m) = match &at {
            Some(at) => {
                let from_m = at.way_within(self.trust_m);
                let slope =
                    if self.flags.root { self.polynomial_n(at.from_control_m) } else { self.gradient(at) };
                (slope, self.value(at), at.nearness(self.trust_m), at.coverage(), from_m)
            }
            None => (self.force_n, self.energy_j, 0.0, Coverage::Extrapolated, vec3::ZERO),
        };
        Coupled {
            gradient: vec3::add(gradient, change_n),
            value: value + vec3::dot(slope_n, moved_m) + vec3::dot(change_n, from_control_m),
            moved_m,
            nearness,
            coverage,
            from_control_m,
        }
    }

    /// |h| at the control, newtons.
    pub(super) fn force_size_n(&self) -> f32 {
        let size_n = vec3::norm(self.force_n);
        if self.flags.root { self.energy_j.max(0.0) * size_n } else { size_n }
    }

    /// |S| at the control, the root of the sum of squares of its components, N/m: at least its largest stiffness.
    /// Of a root the bound |ds/dd|^2 + s |d2s/dd2|.
    pub(super) fn stiffness_size_n_m(&self) -> f32 {
        let [xx, xy, xz, yy, yz, zz] = self.stiffness_n_m;
        let [diagonal, other] = [[xx, yy, zz], [xy, xz, yz]].map(vec3::norm);
        let size = vec3::norm([diagonal, other, other]);
        if self.flags.root { vec3::norm_squared(self.force_n) + self.energy_j.max(0.0) * size } else { size }
    }

    /// W at a displacement, with a second control, joules.
    pub(super) fn energy_beside_j(&self, displacement_m: Vec3, second_m: Option<Vec3>) -> f32 {
        match self.coupling.as_ref().zip(second_m) {
            None => self.energy_j(displacement_m),
            Some((coupling, at_m)) => {
                let at = self.coupled(displacement_m, coupling, at_m);
                if self.flags.root { 0.5 * at.factor(self) * at.value.max(0.0) } else { at.value }
            }
        }
    }

    /// W at a displacement, joules; beyond the trust radius continued along the ray from the control.
    pub fn energy_j(&self, displacement_m: Vec3) -> f32 {
        let at = limited(displacement_m).map(|displacement_m| self.place(displacement_m));
        let value = at.as_ref().map_or(self.energy_j, |at| self.value(at));
        let nearness = at.map_or(0.0, |at| at.nearness(self.trust_m));
        let root = value.max(0.0);
        if self.flags.root { 0.5 * nearness * root * root } else { value }
    }

    /// The gradient of the expansion of W.
    #[inline(always)]
    fn gradient(&self, at: &Place) -> Vec3 {
        let inside = self.polynomial_n(at.from_control_m);
        if at.beyond_m <= 0.0 {
            return inside;
        }
        let slope = self.stiffness_times(at.from_control_m, at.outward);
        vec3::add(inside, vec3::scale(slope, self.levelled_m(at.beyond_m)))
    }

    /// The value of the expansion.
    fn value(&self, at: &Place) -> f32 {
        let x = at.from_control_m;
        let bent_n_m = self.third_times(x);
        let linear = vec3::dot(self.force_n, x);
        let quadratic = 0.5 * vec3::dot(product(&self.stiffness_n_m, x), x);
        let cubic = vec3::dot(product(&bent_n_m, x), x) / 6.0;
        let inside_j = self.energy_j + linear + quadratic + cubic;
        if at.beyond_m <= 0.0 {
            return inside_j;
        }
        let along_n = vec3::dot(self.polynomial_n(x), at.outward);
        if self.flags.root {
            return inside_j + along_n * at.beyond_m;
        }
        let slope_n_m = vec3::dot(self.stiffness_times(x, at.outward), at.outward);
        inside_j + along_n * at.beyond_m + slope_n_m * self.risen_m2(at.beyond_m)
    }

    /// The distance from the control in trust radii, squared, for a trust radius of at least a micrometre.
    pub(super) fn per_trust2(&self) -> f32 {
        let trust_m = self.trust_m.max(1e-6);
        1.0 / (trust_m * trust_m)
    }

    fn place(&self, displacement_m: Vec3) -> Place {
        let from_control_m = vec3::sub(displacement_m, self.control_m);
        let distance_m = vec3::norm(from_control_m);
        if distance_m <= self.trust_m {
            return Place { from_control_m, outward: vec3::ZERO, beyond_m: 0.0 };
        }
        let outward = if distance_m > SMALLEST_M {
            vec3::scale(from_control_m, 1.0 / distance_m)
        } else {
            vec3::normalize_or_zero(from_control_m)
        };
        let beyond_m = distance_m - self.trust_m;
        Place { from_control_m: vec3::scale(outward, self.trust_m), outward, beyond_m }
    }

    /// h_k + S_k x + (T_k x) x / 2
    // The search for contradictions calls it for every jet.
    #[inline(always)]
    fn polynomial_n(&self, x: Vec3) -> Vec3 {
        let bent_n_m = self.third_times(x);
        let mut mean_n_m = self.stiffness_n_m;
        for (s, bent) in mean_n_m.iter_mut().zip(bent_n_m) {
            *s += 0.5 * bent;
        }
        vec3::add(self.force_n, product(&mean_n_m, x))
    }

    /// (S_k + T_k x) a
    fn stiffness_times(&self, x: Vec3, a: Vec3) -> Vec3 {
        vec3::add(product(&self.stiffness_n_m, a), product(&self.third_times(x), a))
    }

    /// T_k x: xx, xy, xz, yy, yz, zz.
    fn third_times(&self, [x, y, z]: Vec3) -> [f32; 6] {
        let [xxx, xxy, xxz, xyy, xyz, xzz, yyy, yyz, yzz, zzz] = self.third_n_m2;
        [
            xxx * x + xxy * y + xxz * z,
            xxy * x + xyy * y + xyz * z,
            xxz * x + xyz * y + xzz * z,
            xyy * x + yyy * y + yyz * z,
            xyz * x + yyz * y + yzz * z,
            xzz * x + yzz * y + zzz * z,
        ]
    }

    /// phi
    fn levelled_m(&self, beyond_m: f32) -> f32 {
        let length_m = self.trust_m.max(MIN_LEVELLING_M);
        let bent_m = beyond_m.min(length_m);
        bent_m - bent_m * bent_m / (2.0 * length_m)
    }

    /// The integral of phi from 0 to s.
    fn risen_m2(&self, beyond_m: f32) -> f32 {
        let length_m = self.trust_m.max(MIN_LEVELLING_M);
        let bent_m = beyond_m.min(length_m);
        0.5 * bent_m * bent_m * (1.0 - bent_m / (3.0 * length_m)) + 0.5 * length_m * (beyond_m - bent_m)
    }
}

/// The product of a symmetric matrix (xx, xy, xz, yy, yz, zz) and a vector.
fn product([xx, xy, xz, yy, yz, zz]: &[f32; 6], [x, y, z]: Vec3) -> Vec3 {
    [xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_continuation_levels_off_over_the_trust_radius_or_five_millimetres() {
        for (trust_m, length_m) in [(1e-3, 5e-3), (8e-3, 8e-3)] {
            let jet = Jet { trust_m, ..Jet::default() };
            assert_eq!(jet.levelled_m(0.0), 0.0);
            assert!((jet.levelled_m(length_m) - 0.5 * length_m).abs() < 1e-9);
            assert_eq!(jet.levelled_m(1.0), jet.levelled_m(length_m));
            let (step_m, mut sum_m2) = (1e-5, 0.0);
            for n in 0..2_000 {
                sum_m2 += step_m * jet.levelled_m((n as f32 + 0.5) * step_m);
            }
            assert!((jet.risen_m2(0.02) / sum_m2 - 1.0).abs() < 1e-4, "{} {sum_m2}", jet.risen_m2(0.02));
        }
    }
}
