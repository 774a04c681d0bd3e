//! Friction of a sphere: Coulomb's law with an elastic tangential spring.
//!
//! Where the sphere sticks, a spring joins its centre c to an anchor a in the tangent plane with the unit normal n:
//!
//! W_t = k_t |t|^2 / 2,   h_t = dW_t/dc = k_t t,   t = (c - a) - n n . (c - a)
//!
//! Its stiffness is 2 (1 - nu) / (2 - nu) of that along the normal (Mindlin 1949), 2/3 for an incompressible body. The
//! latter is |h|^2 / 2 W of the force h and the energy W without friction, exact for a linear body.
//!
//! In stick a and n are fixed, so h + h_t is the exact gradient of W + W_t while k_t is too. With the force of the moment the
//! gradient would need the slope of k_t. A body that stiffens as the sphere sinks in raises k_t at each new greatest |h|.
//! The tension k_t |t| does not change then: a moves towards c, and W_t = tension^2 / 2 k_t falls. In stick k_t never falls.
//!
//! The sphere slips where k_t |t| exceeds mu |h|, also because |h| falls. Then |t| becomes mu |h| / k_t and h_t is
//! continuous. n and k_t follow the present force over a slip of about |t|. k_t falls only as far as W_t does not rise:
//! the energy that the spring gives up is heat.

use crate::num::vec3::{self, Vec3};

/// Share of the normal stiffness that the spring has: 2 (1 - nu) / (2 - nu) at nu = 1/2.
const TANGENTIAL: f32 = 2.0 / 3.0;
/// Energy at which a spring begins, joules: some 10 mN. Before it the ratio |h|^2 / 2 W is one of rounding errors.
const LEAST_J: f32 = 1e-6;

/// The force h and the energy W without friction, newtons and joules, and the largest stiffness that a spring may have, N/m.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pressed {
    pub(crate) force_n: Vec3,
    pub(crate) energy_j: f32,
    pub(crate) stiffest_n_m: f32,
}

impl Pressed {
    /// 2/3 of |h|^2 / 2 W; `None` where this is not a stiffness.
    fn stiffness_n_m(&self) -> Option<f32> {
        let along_n_m = TANGENTIAL * vec3::norm_squared(self.force_n) / (2.0 * self.energy_j);
        let is_known = self.energy_j >= LEAST_J && along_n_m > 0.0;
        is_known.then_some(along_n_m.min(self.stiffest_n_m))
    }
}

/// The spring.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Grip {
    anchor_m: Vec3,
    normal: Vec3,
    stiffness_n_m: f32,
    /// Greatest |h| since the last slip.
    greatest_n: f32,
}

impl Grip {
    /// Moves a spring to the present centre and force; h_t and the spring then, newtons.
    pub(crate) fn follow(
        before: Option<Self>,
        friction: f32,
        centre_m: Vec3,
        by: Pressed,
    ) -> (Vec3, Option<Self>) {
        let (normal, pressing_n) = (vec3::normalize_or_zero(by.force_n), vec3::norm(by.force_n));
        if normal == vec3::ZERO {
            return (vec3::ZERO, None);
        }
        let Some(grip) = before else {
            let begin =
                |stiffness_n_m| Self { anchor_m: centre_m, normal, stiffness_n_m, greatest_n: pressing_n };
            return (vec3::ZERO, by.stiffness_n_m().map(begin));
        };
        let stretch_m = grip.stretch_m(centre_m);
        let (tension_n, most_n) = (grip.stiffness_n_m * vec3::norm(stretch_m), friction * pressing_n);
        let fresh_n_m = by.stiffness_n_m().unwrap_or(grip.stiffness_n_m);
        if tension_n <= most_n {
            let held = if pressing_n > grip.greatest_n { grip.stiffened(stretch_m, fresh_n_m) } else { grip };
            let greatest_n = held.greatest_n.max(pressing_n);
            return (vec3::scale(stretch_m, grip.stiffness_n_m), Some(Self { greatest_n, ..held }));
        }
        // In (0, 1]; the energy W_t = tension^2 / 2 k does not rise.
        let share = most_n / tension_n;
        let stiffness_n_m = fresh_n_m.max(grip.stiffness_n_m * share * share);
        let towards = vec3::sub(normal, grip.normal);
        let normal = vec3::normalize_or_zero(vec3::add(grip.normal, vec3::scale(towards, 1.0 - share)));
        let slipped = Self { normal, stiffness_n_m, greatest_n: pressing_n, ..grip };
        let along = vec3::normalize_or_zero(slipped.stretch_m(centre_m));
        let kept_m = vec3::scale(along, most_n / stiffness_n_m);
        let slipped = Self { anchor_m: vec3::sub(centre_m, kept_m), ..slipped };
        (vec3::scale(along, most_n), Some(slipped))
    }

    /// The spring with a higher stiffness and the same tension.
    fn stiffened(self, stretch_m: Vec3, stiffness_n_m: f32) -> Self {
        let stiffness_n_m = self.stiffness_n_m.max(stiffness_n_m);
        let given_up = 1.0 - self.stiffness_n_m / stiffness_n_m;
        let anchor_m = vec3::add(self.anchor_m, vec3::scale(stretch_m, given_up));
        Self { anchor_m, stiffness_n_m, ..self }
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
    fn press(centre_m: Vec3) -> Pressed {
        let up = vec3::normalize_or_zero([0.3, 0.1, 1.0]);
        let depth_m = (-vec3::dot(centre_m, up)).max(0.0);
        let root = depth_m.sqrt();
        let force_n = vec3::scale(up, -3e3 * depth_m * root);
        Pressed { force_n, energy_j: 3e3 * depth_m * depth_m * root / 2.5, stiffest_n_m: 1e3 }
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
            let whole_n = vec3::add(found.force_n, along_n);
            assert!(vec3::norm(along_n) <= 1.000_01 * friction * vec3::norm(found.force_n));
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

    /// Small circles deep in the body after an oblique press. Nothing slips. The first lap finds the greatest force, and k_t
    /// rises: the hand loses energy. From the second lap on no work is done.
    #[test]
    fn stick_is_conservative() {
        let at = |angle: f32| {
            let (back, side) = circle(angle);
            [2e-4 * back, 2e-4 * side, -0.01 - 1e-3 * back]
        };
        let mut grip = None;
        for n in 0..=1_000_u16 {
            let centre_m = vec3::scale(at(0.0), f32::from(n) * 1e-3);
            grip = Grip::follow(grip, 0.8, centre_m, press(centre_m)).1;
        }
        let [first, second] = [(); 2].map(|()| {
            let (started, mut sum_j, mut most_j, mut before) = (grip, 0.0_f64, 0.0_f64, None::<(Vec3, Vec3)>);
            for n in 0..=20_000_u16 {
                let centre_m = at(f32::from(n) / 20_000.0);
                let (along_n, next) = Grip::follow(grip, 0.8, centre_m, press(centre_m));
                grip = next;
                if let Some((at_m, force_n)) = before {
                    let mean_n = vec3::scale(vec3::add(force_n, along_n), 0.5);
                    sum_j += f64::from(vec3::dot(mean_n, vec3::sub(centre_m, at_m)));
                    most_j = most_j.max(sum_j.abs());
                }
                before = Some((centre_m, along_n));
            }
            (sum_j, most_j, grip == started)
        });
        assert!(first.0 > 1e-3 * first.1 && !first.2, "{first:?}");
        assert!(second.1 > 1e-5 && second.0.abs() < 1e-4 * second.1 && second.2, "{second:?}");
    }

    /// A press that first touches far from its greatest depth, then a slide: the spring has the stiffness of the deep contact.
    #[test]
    fn a_deep_press_raises_the_stiffness() {
        let slide = vec3::normalize_or_zero(vec3::cross([0.3, 0.1, 1.0], [0.0, 1.0, 0.0]));
        let down = vec3::normalize_or_zero([-0.3, -0.1, -1.0]);
        let mut grip = None;
        for n in 0..=800_u16 {
            let centre_m = vec3::scale(down, f32::from(n) * 1e-5);
            grip = Grip::follow(grip, 0.8, centre_m, press(centre_m)).1;
        }
        let centre_m = vec3::add(vec3::scale(down, 8e-3), vec3::scale(slide, 1e-3));
        let along_n = Grip::follow(grip, 0.8, centre_m, press(centre_m)).0;
        let expected_n_m = press(centre_m).stiffness_n_m().unwrap_or(0.0);
        assert!((vec3::norm(along_n) / 1e-3 / expected_n_m - 1.0).abs() < 1e-2, "{along_n:?} {expected_n_m}");
    }

    /// The energy of a live field may be wrong for a moment: the spring never exceeds the limit, and it does not end.
    #[test]
    fn a_wrong_energy_changes_little() {
        let deep = press([0.0, 0.0, -8e-3]);
        let grip = Grip::follow(None, 0.3, [0.0, 0.0, -8e-3], deep).1;
        for energy_j in [-1.0, 0.0, 1e-20, 1e-5, f32::NAN] {
            let by = Pressed { energy_j, force_n: vec3::scale(deep.force_n, 1.01), ..deep };
            let next = Grip::follow(grip, 0.3, [1e-4, 0.0, -8e-3], by).1;
            assert!(next.is_some_and(|grip| grip.stiffness_n_m <= 1e3), "{energy_j} {next:?}");
        }
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
        let normal_n = vec3::norm(press([0.0, 0.0, -8e-3]).force_n);
        let expected_n = vec3::scale(slide, 0.3 * normal_n);
        assert!(vec3::distance(along_n, expected_n) < 1e-3 * normal_n, "{along_n:?} {expected_n:?}");
        assert_eq!(Grip::follow(grip, 0.3, [0.0, 0.0, 1.0], press([0.0, 0.0, 1.0])), (vec3::ZERO, None));
    }
}
