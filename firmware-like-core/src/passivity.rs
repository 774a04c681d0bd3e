//! The live guard on energy: an organ gives back at most what the hand has put in.
//!
//! E = sum F_hand . (x_k - x_k-1) / s          F_hand: the force given over that way; s: metres of the model to one of the device
//!
//! is the work done on the hand since it touched. A body that began at rest has nothing to give, so E <= 0, whatever the way; what
//! the sampling, a delay or a table that is not conservative add shows as E > 0. Beyond a margin virtual damping takes it back
//!
//! F = - a v,   a = min((E - margin) / (v^2 dt), a_max)
//!
//! (time-domain passivity control of impedance type; Hannaford and Ryu 2002), and where that is not enough the force is taken away: a
//! loop that shakes the hand is a fault. What is above zero when a touch ends is not forgotten but fades within about a second, so that a tool
//! that bounces is seen too.

use crate::vec3::{self, Vec3};

/// Time in which a hand takes up the energy of one touch, s.
const FORGET_S: f32 = 1.0;
/// Share of the most the hand had put in that may come back beyond it: sampled at 1 kHz, a quick stroke gives some per cent too much.
const SAMPLING_SHARE: f32 = 0.05;

/// When the guard acts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PassivityConfig {
    /// Work on the hand in one touch that nobody minds, joules.
    pub margin_j: f32,
    /// Largest virtual damping, newtons per metre a second; 0 for none.
    pub max_damping_n_s_m: f32,
    /// Work on the hand that is a fault, joules; infinite for never.
    pub fault_j: f32,
    /// Metres of the model to one of the device.
    pub workspace_scale: f32,
}

impl Default for PassivityConfig {
    fn default() -> Self {
        Self { margin_j: 5e-3, max_damping_n_s_m: 2.0, fault_j: 0.25, workspace_scale: 1.0 }
    }
}

/// Work since the touch began.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Passivity {
    last: Option<(u64, Vec3)>,
    work_j: f32,
    /// The lowest it was: what the hand has put in.
    lowest_j: f32,
}

/// What the guard says to one sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Verdict {
    /// Add this force for the hand; usually zero.
    Damp(Vec3),
    /// More energy than a body can have given.
    Active,
}

impl Passivity {
    /// Nothing seen yet.
    pub const fn new() -> Self {
        Self { last: None, work_j: 0.0, lowest_j: 0.0 }
    }

    /// Work on the hand since the touch began, J; below 0 while the hand presses.
    pub const fn work_j(&self) -> f32 {
        self.work_j
    }

    /// Takes one sample and the force that was given until then.
    pub fn observe(
        &mut self,
        config: &PassivityConfig,
        (t_us, hip_m): (u64, Vec3),
        hand_force_n: Vec3,
        touching: bool,
    ) -> Verdict {
        let still = Verdict::Damp(vec3::ZERO);
        let Some((then_us, then_m)) = self.last.replace((t_us, hip_m)) else { return still };
        let dt_s = t_us.saturating_sub(then_us) as f32 * 1e-6;
        let way_m = vec3::scale(vec3::sub(hip_m, then_m), config.workspace_scale.recip());
        self.work_j += vec3::dot(hand_force_n, way_m);
        if !touching {
            // The body has come to rest; what it gave too much fades.
            self.work_j = self.work_j.max(0.0) * (1.0 - dt_s / FORGET_S).max(0.0);
            self.lowest_j = 0.0;
            return still;
        }
        self.lowest_j = self.lowest_j.min(self.work_j);
        let beyond_j = self.work_j - config.margin_j + SAMPLING_SHARE * self.lowest_j;
        if beyond_j <= 0.0 || dt_s <= 0.0 {
            return still;
        }
        if beyond_j > config.fault_j {
            return Verdict::Active;
        }
        let speed_squared = vec3::norm_squared(way_m) / (dt_s * dt_s);
        let wanted_n_s_m = beyond_j / (speed_squared * dt_s);
        let damping_n_s_m = wanted_n_s_m.min(config.max_damping_n_s_m);
        let force_n = vec3::scale(way_m, -damping_n_s_m / dt_s);
        Verdict::Damp(if vec3::is_finite(force_n) { force_n } else { vec3::ZERO })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Strokes in and out of a spring of K N/m; `lead_m` moves the force ahead of the position, which makes energy.
    fn stroke(config: &PassivityConfig, stiffness_n_m: f32, lead_m: f32) -> (Passivity, f32, bool) {
        let (mut guard, mut force_n, mut most_n, mut active) = (Passivity::new(), 0.0_f32, 0.0_f32, false);
        for tick in 0..4_000_u64 {
            let phase = tick as f32 * 0.004;
            let (depth_m, inward) = (0.01 * (1.0 - phase.cos()), phase.sin() > 0.0);
            let z = -depth_m;
            let verdict = guard.observe(config, (tick * 1_000, [0.0, 0.0, z]), [0.0, 0.0, force_n], true);
            match verdict {
                Verdict::Damp([_, _, damping_n]) => most_n = most_n.max(damping_n.abs()),
                Verdict::Active => active = true,
            }
            force_n = stiffness_n_m * (depth_m + if inward { -lead_m } else { lead_m }).max(0.0);
        }
        (guard, most_n, active)
    }

    #[test]
    fn a_spring_is_left_alone() {
        let (guard, most_n, active) = stroke(&PassivityConfig::default(), 500.0, 0.0);
        assert!(most_n == 0.0 && !active && guard.work_j() < 5e-3, "{guard:?} {most_n}");
    }

    #[test]
    fn what_makes_energy_is_damped_and_then_a_fault() {
        let config = PassivityConfig { fault_j: f32::INFINITY, ..PassivityConfig::default() };
        let (_, most_n, _) = stroke(&config, 500.0, 0.002);
        assert!(most_n > 0.02 && most_n < 2.0 * 0.05, "at most 2 N s/m at 40 mm/s: {most_n}");
        assert!(stroke(&PassivityConfig { fault_j: 0.02, ..config }, 500.0, 0.002).2);
    }

    #[test]
    fn the_margin_counts_in_device_metres() {
        let half = PassivityConfig { workspace_scale: 2.0, ..PassivityConfig::default() };
        let (device, model) =
            (stroke(&half, 500.0, 0.002).0, stroke(&PassivityConfig::default(), 500.0, 0.002).0);
        assert!((2.0 * device.work_j() / model.work_j() - 1.0).abs() < 1e-3);
    }

    #[test]
    fn a_touch_that_ended_is_forgotten_slowly_if_it_gave() {
        let config = PassivityConfig::default();
        let mut guard = Passivity { last: Some((0, vec3::ZERO)), work_j: 0.1, lowest_j: -0.2 };
        guard.observe(&config, (100_000, vec3::ZERO), vec3::ZERO, false);
        assert!((guard.work_j() - 0.09).abs() < 1e-6 && guard.lowest_j == 0.0);
        let mut guard = Passivity { last: Some((0, vec3::ZERO)), work_j: -0.1, lowest_j: -0.2 };
        guard.observe(&config, (1_000, vec3::ZERO), vec3::ZERO, false);
        assert_eq!(guard.work_j(), 0.0, "what the body kept is lost");
    }
}
