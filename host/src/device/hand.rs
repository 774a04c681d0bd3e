//! Model of the user's hand: a mass on a spring and damper with a moving neutral point, plus tremor.
//!
//! It is independent of encoders, motors and links; [`super::impedance`] models the device that it holds.

use super::script::SplitMix;
use palpate_core::{Vec3, vec3};

/// Parameters of a hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandConfig {
    /// Seed of the tremor.
    pub seed: u64,
    /// Effective mass of the hand and, without a mechanism, of the handle, kg.
    pub mass_kg: f32,
    /// Stiffness of the arm, N/m.
    pub stiffness_n_m: f32,
    /// Damping ratio of the arm with this mass; 1 is critical.
    pub damping_ratio: f32,
    /// Share of a lasting resistance that the hand compensates by pushing harder; below 1.
    ///
    /// A person instructed to press 15 mm deep presses harder in stiffer tissue. 0 is a purely passive arm.
    pub persistence: f32,
    /// Largest force of this compensation, N.
    pub max_effort_n: f32,
    /// Amplitude of the tremor (8 to 11 Hz), m.
    pub tremor_m: f32,
}

impl Default for HandConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            mass_kg: 0.2,
            stiffness_n_m: 450.0,
            damping_ratio: 1.0,
            persistence: 0.8,
            max_effort_n: 6.0,
            tremor_m: 1.0e-4,
        }
    }
}

impl HandConfig {
    /// A light grip with two fingers: the damping of the loop then comes mainly from the device.
    ///
    /// A firm grip has a damping of 5 to 20 N s/m; this one has 1.1, without compensation and without tremor.
    pub const LIGHT: Self = Self {
        seed: 1,
        mass_kg: 0.05,
        stiffness_n_m: 150.0,
        damping_ratio: 0.2,
        persistence: 0.0,
        max_effort_n: 0.0,
        tremor_m: 0.0,
    };
}

/// Inertia, damping and friction that a mechanism adds to the hand. All zero is an ideal mechanism.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Drag {
    /// Effective mass, kg.
    pub mass_kg: f32,
    /// Viscous damping, N s/m.
    pub damping_n_s_m: f32,
    /// Coulomb friction, N.
    pub coulomb_n: f32,
}

/// Time constant of the compensation of a resistance, s: the order of a voluntary reaction.
const REACTION_TIME_S: f32 = 0.2;
/// Number of sines of the tremor per axis.
const TREMOR_SINES: usize = 3;

/// One sine of the tremor.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Sine {
    rad_per_s: f32,
    phase_rad: f32,
}

/// State of the hand with the mechanism that it moves.
#[derive(Debug, Clone)]
pub struct Hand {
    config: HandConfig,
    position_m: Vec3,
    velocity_m_s: Vec3,
    /// Force that compensates a lasting resistance.
    effort_n: Vec3,
    tremor: [[Sine; TREMOR_SINES]; 3],
}

impl Hand {
    /// A hand at rest.
    #[must_use]
    pub fn new(config: HandConfig, position_m: Vec3) -> Self {
        let mut random = SplitMix::new(config.seed);
        let tremor = core::array::from_fn(|_| {
            core::array::from_fn(|_| Sine {
                rad_per_s: core::f32::consts::TAU * (8.0 + 3.0 * random.unit()),
                phase_rad: core::f32::consts::TAU * random.unit(),
            })
        });
        Self { config, position_m, velocity_m_s: vec3::ZERO, effort_n: vec3::ZERO, tremor }
    }

    /// Its parameters.
    #[must_use]
    pub const fn config(&self) -> &HandConfig {
        &self.config
    }

    /// Position without tremor.
    #[must_use]
    pub const fn position_m(&self) -> Vec3 {
        self.position_m
    }

    /// Velocity.
    #[must_use]
    pub const fn velocity_m_s(&self) -> Vec3 {
        self.velocity_m_s
    }

    /// Integrates one step under a constant force while the neutral point moves from `from_m` to `to_m`.
    ///
    /// m a = k (target - x) + c (target' - x') + effort + F - b x' - f_c x' / |x'|
    ///
    /// Semi-implicit Euler: v first, then x with the new v. It is stable for k dt^2 / m far below 4. At 0.1
    /// ms the value is 2e-5, and 2e-4 with an organ of 3000 N/m in parallel. The drag is fully implicit:
    /// damping divides the speed, and friction reduces it at most to zero, so a hand slower than one step of
    /// friction stops and does not reverse.
    /// Returns the energy dissipated by the drag, J.
    pub fn integrate(&mut self, from_m: Vec3, to_m: Vec3, force_n: Vec3, drag: &Drag, dt_s: f32) -> f32 {
        let HandConfig { mass_kg, stiffness_n_m, damping_ratio, .. } = self.config;
        let damping_n_s_m = 2.0 * damping_ratio * (stiffness_n_m * mass_kg).sqrt();
        let moved_kg = mass_kg + drag.mass_kg;
        let target_m_s = vec3::scale(vec3::sub(to_m, from_m), dt_s.recip());
        let spring_n = vec3::scale(vec3::sub(to_m, self.position_m), stiffness_n_m);
        let damper_n = vec3::scale(vec3::sub(target_m_s, self.velocity_m_s), damping_n_s_m);
        let hand_n = vec3::add(vec3::add(spring_n, damper_n), self.effort_n);
        let push = vec3::scale(vec3::add(hand_n, force_n), dt_s / moved_kg);
        let free_m_s = vec3::add(self.velocity_m_s, push);
        self.velocity_m_s = velocity_after_drag(free_m_s, drag, dt_s / moved_kg);
        self.position_m = vec3::add(self.position_m, vec3::scale(self.velocity_m_s, dt_s));
        self.adapt_effort(force_n, dt_s);
        moved_kg * vec3::dot(vec3::sub(free_m_s, self.velocity_m_s), self.velocity_m_s)
    }

    /// Moves the hand to a hard stop at `held_m` and removes the velocity component into the stop.
    pub fn stop_at(&mut self, held_m: Vec3) {
        let wall = vec3::normalize_or_zero(vec3::sub(held_m, self.position_m));
        let into_m_s = vec3::dot(self.velocity_m_s, wall).min(0.0);
        self.velocity_m_s = vec3::sub(self.velocity_m_s, vec3::scale(wall, into_m_s));
        self.position_m = held_m;
    }

    /// First-order low-pass of the resistance, bounded. It is slow, so that it does not take part in an
    /// oscillation.
    fn adapt_effort(&mut self, force_n: Vec3, dt_s: f32) {
        let compensation_n = vec3::scale(force_n, -self.config.persistence);
        let change = vec3::scale(vec3::sub(compensation_n, self.effort_n), dt_s / REACTION_TIME_S);
        self.effort_n = vec3::add(self.effort_n, change);
        let size_n = vec3::norm(self.effort_n);
        if size_n > self.config.max_effort_n {
            self.effort_n = vec3::scale(self.effort_n, self.config.max_effort_n / size_n);
        }
    }

    /// Offset of the position by tremor at a time.
    #[must_use]
    pub fn tremor_m(&self, time_s: f64) -> Vec3 {
        // f64 time: in f32 the phase of an hour-long run would advance in steps.
        self.tremor.map(|sines| {
            let sum: f32 = sines
                .iter()
                .map(|sine| (f64::from(sine.rad_per_s) * time_s + f64::from(sine.phase_rad)).sin() as f32)
                .sum();
            sum * self.config.tremor_m / TREMOR_SINES as f32
        })
    }
}

/// Velocity after a step with drag. `step` is its duration divided by the mass.
fn velocity_after_drag(free_m_s: Vec3, drag: &Drag, step: f32) -> Vec3 {
    let viscous_m_s = vec3::scale(free_m_s, (1.0 + drag.damping_n_s_m * step).recip());
    if drag.coulomb_n <= 0.0 {
        return viscous_m_s;
    }
    let speed_m_s = vec3::norm(viscous_m_s);
    let friction_m_s = drag.coulomb_n * step;
    if speed_m_s <= friction_m_s {
        return vec3::ZERO;
    }
    vec3::scale(viscous_m_s, 1.0 - friction_m_s / speed_m_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT_S: f32 = 1e-4;

    /// Moves a hand whose target is its own position.
    fn slide(hand: &mut Hand, force_n: f32, drag: &Drag, seconds: f32) -> f32 {
        let before_m = hand.position_m()[0];
        for _ in 0..(seconds / DT_S) as usize {
            hand.integrate(vec3::ZERO, vec3::ZERO, [force_n, 0.0, 0.0], drag, DT_S);
        }
        hand.position_m()[0] - before_m
    }

    fn without_arm() -> Hand {
        Hand::new(HandConfig { stiffness_n_m: 0.0, persistence: 0.0, ..HandConfig::default() }, vec3::ZERO)
    }

    #[test]
    fn friction_sticks_below_its_force_and_slides_above_it() {
        let drag = Drag { mass_kg: 0.1, damping_n_s_m: 0.0, coulomb_n: 0.5 };
        let mut hand = without_arm();
        assert_eq!(slide(&mut hand, 0.49, &drag, 1.0), 0.0, "it sticks and does not creep");
        let moved_m = slide(&mut hand, 0.8, &drag, 0.1);
        // 0.3 N on 0.3 kg for 0.1 s: 5 mm.
        assert!((moved_m - 0.005).abs() < 5e-5, "{moved_m}");
        // It coasts to a stop: 0.1 m/s against 0.5 N is 3 mm in 60 ms. Then it neither advances nor reverses.
        let moved_m = slide(&mut hand, 0.0, &drag, 0.1);
        assert!((moved_m - 0.003).abs() < 3e-5 && hand.velocity_m_s() == vec3::ZERO, "{moved_m}");
        assert_eq!(slide(&mut hand, 0.0, &drag, 1.0), 0.0);
    }

    #[test]
    fn damping_gives_the_terminal_speed_and_any_drag_is_stable() {
        let drag = Drag { mass_kg: 0.0, damping_n_s_m: 2.0, coulomb_n: 0.0 };
        let mut hand = without_arm();
        slide(&mut hand, 1.0, &drag, 2.0);
        assert!((hand.velocity_m_s()[0] - 0.5).abs() < 1e-3, "1 N against 2 N s/m");
        // A thousand times the drag at which an explicit step is unstable.
        let stiff = Drag { mass_kg: 0.0, damping_n_s_m: 4e6, coulomb_n: 1e6 };
        slide(&mut hand, 1.0, &stiff, 0.01);
        assert_eq!(hand.velocity_m_s(), vec3::ZERO);
    }

    #[test]
    fn a_hard_stop_removes_only_the_speed_into_it() {
        let mut hand = without_arm();
        for _ in 0..100 {
            hand.integrate(vec3::ZERO, vec3::ZERO, [2.0, 1.0, 0.0], &Drag::default(), DT_S);
        }
        let [along, across, _] = hand.velocity_m_s();
        assert!(along > 0.0);
        let at_m = hand.position_m();
        hand.stop_at([at_m[0] - 1e-6, at_m[1], at_m[2]]);
        assert_eq!(hand.velocity_m_s()[0], 0.0);
        assert!((hand.velocity_m_s()[1] - across).abs() < 1e-7);
        // Away from the stop it is free.
        let before = hand.velocity_m_s();
        let at_m = hand.position_m();
        hand.stop_at([at_m[0], at_m[1] + 1e-6, at_m[2]]);
        assert_eq!(hand.velocity_m_s(), before);
    }
}
