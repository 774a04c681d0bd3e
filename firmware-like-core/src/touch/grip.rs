//! Friction of a sphere: Coulomb's law with an elastic tangential spring.
//!
//! Where the sphere sticks, a spring joins its centre c to an anchor a in the tangent plane with the unit normal n:
//!
//! W_t = k_t |t|^2 / 2,   h_t = dW_t/dc = k_t t,   t = (c - a) - n n . (c - a)
//!
//! Its stiffness is 2 (1 - nu) / (2 - nu) of that along the normal (Mindlin 1949), 2/3 for an incompressible body. The
//! latter is |h|^2 / 2 W of the force h and the energy W without friction, exact for a linear body.
//!
//! a, n and k_t change only in slip. So in stick h + h_t is the exact gradient of W + W_t. With the force of the moment they
//! would need the slope of k_t too.
//!
//! The sphere slips where k_t |t| exceeds mu |h|, also because |h| falls. Then |t| becomes mu |h| / k_t and h_t is
//! continuous. n and k_t follow the present force over a slip of about |t|. k_t falls only as far as W_t does not rise:
//! the energy that the spring gives up is heat.

use crate::num::vec3::{self, Vec3};

/// Share of the normal stiffness that the spring has: 2 (1 - nu) / (2 - nu) at nu = 1/2.
const TANGENTIAL: f32 = 2.0 / 3.0;
/// Energy at which a spring begins, joules: some 10 mN. Before it the ratio |h|^2 / 2 W is one of rounding errors.
const LEAST_J: f32 = 1e-6;

/// The spring.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Grip {
    anchor_m: Vec3,
    normal: Vec3,
    stiffness_n_m: f32,
}

impl Grip {
    /// A spring without tension for the force and energy without friction; `None` where the sphere does not press.
    fn without_tension(centre_m: Vec3, (force_n, energy_j): (Vec3, f32)) -> Option<Self> {
        let normal = vec3::normalize_or_zero(force_n);
        let stiffness_n_m = TANGENTIAL * vec3::norm_squared(force_n) / (2.0 * energy_j);
        let presses = normal != vec3::ZERO && stiffness_n_m > 0.0 && stiffness_n_m.is_finite();
        presses.then_some(Self { anchor_m: centre_m, normal, stiffness_n_m })
    }

    /// Moves a spring to the present centre and force; h_t and the spring then, newtons.
    pub(crate) fn follow(
        before: Option<Self>,
        friction: f32,
        centre_m: Vec3,
        (force_n, energy_j): (Vec3, f32),
    ) -> (Vec3, Option<Self>) {
        let Some(fresh) = Self::without_tension(centre_m, (force_n, energy_j)) else {
            return (vec3::ZERO, None);
        };
        let Some(grip) = before else { return (vec3::ZERO, Some(fresh).filter(|_| energy_j >= LEAST_J)) };
        let stretch_m = grip.stretch_m(centre_m);
        let (length_m, most_n) = (vec3::norm(stretch_m), friction * vec3::norm(force_n));
        let tension_n = grip.stiffness_n_m * length_m;
        if tension_n <= most_n {
            return (vec3::scale(stretch_m, grip.stiffness_n_m), Some(grip));
        }
        // In (0, 1]; the energy W_t = tension^2 / 2 k does not rise.
        let share = most_n / tension_n;
        let stiffness_n_m = fresh.stiffness_n_m.max(grip.stiffness_n_m * share * share);
        let towards = vec3::sub(fresh.normal, grip.normal);
        let normal = vec3::normalize_or_zero(vec3::add(grip.normal, vec3::scale(towards, 1.0 - share)));
        let slipped = Self { anchor_m: grip.anchor_m, normal, stiffness_n_m };
        let along = vec3::normalize_or_zero(slipped.stretch_m(centre_m));
        let kept_m = vec3::scale(along, most_n / stiffness_n_m);
        let slipped = Self { anchor_m: vec3::sub(centre_m, kept_m), ..slipped };
        (vec3::scale(along, most_n), Some(slipped))
    }

    /// t
    fn stretch_m(&self, centre_m: Vec3) -> Vec3 {
        let from_m = vec3::sub(centre_m, self.anchor_m);
        vec3::sub(from_m, vec3::scale(self.normal, vec3::dot(from_m, self.normal)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A half space under a round probe: h = k z^(3/2), so that its stiffness changes with the depth; tilted.
    fn press(centre_m: Vec3) -> (Vec3, f32) {
        let up = vec3::normalize_or_zero([0.3, 0.1, 1.0]);
        let depth_m = -vec3::dot(centre_m, up);
        if depth_m <= 0.0 {
            return (vec3::ZERO, 0.0);
        }
        let root = depth_m.sqrt();
        (vec3::scale(up, -3e3 * depth_m * root), 3e3 * depth_m * depth_m * root / 2.5)
    }

    /// Moves the centre over a path and returns the work of the hand, J, and the largest step of h_t, N.
    fn work_j(friction: f32, path: impl Fn(f32) -> Vec3) -> (f32, f32) {
        let (mut grip, mut sum_j, mut step_n) = (None, 0.0_f64, 0.0_f32);
        let mut before: Option<(Vec3, Vec3, Vec3)> = None;
        let count = 20_000;
        for n in 0..=count {
            let centre_m = path(n as f32 / count as f32);
            let found = press(centre_m);
            let (along_n, next) = Grip::follow(grip, friction, centre_m, found);
            grip = next;
            let whole_n = vec3::add(found.0, along_n);
            assert!(vec3::norm(along_n) <= 1.000_01 * friction * vec3::norm(found.0));
            if let Some((at_m, force_n, before_n)) = before {
                let mean_n = vec3::scale(vec3::add(force_n, whole_n), 0.5);
                sum_j += f64::from(vec3::dot(mean_n, vec3::sub(centre_m, at_m)));
                step_n = step_n.max(vec3::distance(before_n, along_n));
            }
            before = Some((centre_m, whole_n, along_n));
        }
        (sum_j as f32, step_n)
    }

    fn circle(at: f32) -> (f32, f32) {
        let (sin, cos) = (at * core::f32::consts::TAU).sin_cos();
        (1.0 - cos, sin)
    }

    /// Small circles deep in the body after an oblique press: nothing slips, and no work is done.
    #[test]
    fn stick_is_conservative() {
        let mut grip = None;
        let at = |angle: f32| {
            let (back, side) = circle(angle);
            [2e-4 * back, 2e-4 * side, -0.01 - 1e-3 * back]
        };
        for n in 0..=1_000_u16 {
            let centre_m = vec3::scale(at(0.0), f32::from(n) * 1e-3);
            grip = Grip::follow(grip, 0.8, centre_m, press(centre_m)).1;
        }
        let (stuck, mut sum_j, mut most_j, mut before) = (grip, 0.0_f64, 0.0_f64, None::<(Vec3, Vec3)>);
        for n in 0..=20_000_u16 {
            let centre_m = at(f32::from(n) / 20_000.0);
            let (along_n, next) = Grip::follow(grip, 0.8, centre_m, press(centre_m));
            grip = next;
            assert_eq!(grip, stuck);
            if let Some((at_m, force_n)) = before {
                let mean_n = vec3::scale(vec3::add(force_n, along_n), 0.5);
                sum_j += f64::from(vec3::dot(mean_n, vec3::sub(centre_m, at_m)));
                most_j = most_j.max(sum_j.abs());
            }
            before = Some((centre_m, along_n));
        }
        assert!(most_j > 1e-5 && sum_j.abs() < 1e-4 * most_j, "{sum_j} of {most_j}");
    }

    /// Loops over first contact, slide and release: the hand never receives energy, and a slide costs mu |h| times its way.
    #[test]
    fn slip_only_dissipates() {
        for friction in [0.0, 0.1, 0.3, 1.0] {
            for turns in [1.0_f32, 3.0] {
                let (work_j, step_n) = work_j(friction, |at| {
                    let (back, side) = circle((at * turns).fract());
                    [0.01 * side, 4e-3 * side, 2e-3 - 6e-3 * back]
                });
                assert!(work_j > -1e-6, "{friction} {turns}: {work_j}");
                assert!(friction == 0.0 || work_j > 1e-4 * friction, "{friction} {turns}: {work_j}");
                // 0.06 N/mm and 4 um a step along; the cap changes with the depth.
                assert!(step_n < 0.02 * friction + 1e-6, "{friction} {turns}: a step of {step_n} N");
            }
        }
    }

    /// A hand that presses with a lasting slide feels mu |h| against its motion.
    #[test]
    fn a_slide_feels_the_friction_of_coulomb() {
        let slide = vec3::normalize_or_zero(vec3::cross([0.3, 0.1, 1.0], [0.0, 1.0, 0.0]));
        let (mut grip, mut along_n) = (None, vec3::ZERO);
        for n in 0..400_u16 {
            let centre_m = vec3::add([0.0, 0.0, -8e-3], vec3::scale(slide, f32::from(n) * 1e-4));
            (along_n, grip) = Grip::follow(grip, 0.3, centre_m, press(centre_m));
        }
        let normal_n = vec3::norm(press([0.0, 0.0, -8e-3]).0);
        let expected_n = vec3::scale(slide, 0.3 * normal_n);
        assert!(vec3::distance(along_n, expected_n) < 1e-3 * normal_n, "{along_n:?} {expected_n:?}");
        assert_eq!(Grip::follow(grip, 0.3, [0.0, 0.0, 1.0], (vec3::ZERO, 0.0)), (vec3::ZERO, None));
    }
}
