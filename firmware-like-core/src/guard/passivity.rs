//! Time-domain passivity control: the hand gets back at most the energy that it has put in.
//!
//! E = sum F_hand . (x_k - x_k-1) / s
//!
//! is the work on the hand since the touch began, with F_hand the mean force at the motors from k-1 to k, and
//! s model metres per device metre. A body that was at rest has no energy to give, so E <= 0 for any path.
//! Sampling, delay and interpolants that are not conservative add energy, which appears as E > 0. Beyond a
//! margin virtual damping removes it:
//!
//! F = - a v,   a = min((E - margin) / (v^2 dt), a_max)
//!
//! The rate of change of a is limited, so that the force has no step. If E still exceeds a second limit, the
//! loop is unstable and shakes the hand, which is a fault. A positive E is not reset when a touch ends but
//! decays with a time constant of 1 s, so that a bouncing tool is detected too.
//!
//! **Storage.** The balance of a touch is bounded below by -(U + margin), where U = |h| |d| bounds the stored
//! energy if the force increases with |d|. Work against friction is dissipated and is no credit for later.
//!
//! **Delay.** A force is sent in the device transfer of the next tick, travels over the link, and
//! is held until the next one arrives; a sample carries the time at which it was taken. Therefore the path
//! between two samples is weighted with the one or two forces that were at the motors in that interval, not
//! with the last one computed or sent.
//!
//! Source: Hannaford and Ryu 2002, impedance type. Deviation: the rate limit of a, the margins and the bound
//! of storage.

use super::recent::Recent;
use super::velocity::AdaptiveWindow;
use crate::num::vec3::{self, Vec3};

/// Time in which a positive balance decays after a touch, s.
const DECAY_S: f32 = 1.0;
/// Additional margin as a share of the energy put in: at 1 kHz a fast stroke returns some per cent too much.
const SAMPLING_SHARE: f32 = 0.05;
/// Time in which the damping rises from zero to its maximum, s.
const RISE_S: f32 = 0.01;
/// Largest time between two samples for which a velocity is estimated, us.
const MAX_GAP_US: u64 = 5_000;
/// Number of forces kept: 24 ms at 1 kHz, over twice the default `stale_fault_us` (10 ms).
const SENT: usize = 24;

/// Margins and limits of the passivity control.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PassivityConfig {
    /// Work on the hand in one touch that is tolerated, joules.
    pub margin_j: f32,
    /// Largest virtual damping, newton seconds per metre; 0 for none.
    pub max_damping_n_s_m: f32,
    /// Work on the hand above which a fault is latched, joules; infinite for no fault.
    pub fault_j: f32,
    /// Metres of the model per metre of the device.
    pub workspace_scale: f32,
    /// Delay from sending a force to its effect at the motors, microseconds.
    pub force_delay_us: u32,
    /// Resolution of the positions, metres of the model; 0 if unlimited.
    pub position_step_m: f32,
}

impl Default for PassivityConfig {
    fn default() -> Self {
        Self {
            margin_j: 5e-3,
            max_damping_n_s_m: 2.0,
            fault_j: 0.25,
            workspace_scale: 1.0,
            force_delay_us: 0,
            position_step_m: 54e-6,
        }
    }
}

/// State of the passivity control.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Passivity {
    last: Option<(u64, Vec3)>,
    /// The forces sent last; zero before the first.
    sent: Recent<SENT>,
    window: AdaptiveWindow,
    /// Work on the hand in this touch.
    work_j: f32,
    /// The same, but at least -(`stored_j` + `margin_j`).
    balance_j: f32,
    /// Minimum of the balance: the energy that the hand has put in, negative.
    lowest_j: f32,
    /// The present virtual damping.
    damping_n_s_m: f32,
}

/// The loop has produced more energy than a passive body can.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct NotPassive;

impl Passivity {
    /// Work on the hand in this touch, J; negative while the hand presses.
    pub(crate) const fn work_j(&self) -> f32 {
        self.work_j
    }

    /// Records a force that was sent, in every tick, with or without a sample.
    pub(crate) fn sent(&mut self, now_us: u64, hand_force_n: Vec3) {
        self.sent.push(now_us, hand_force_n);
    }

    /// Processes one sample; returns the damping force to add for the hand, usually zero. `stored_j` is the
    /// largest energy that the body can have stored, joules; `None` without contact.
    pub(crate) fn observe(
        &mut self,
        config: &PassivityConfig,
        (t_us, hip_m): (u64, Vec3),
        stored_j: Option<f32>,
    ) -> Result<Vec3, NotPassive> {
        let before = self.last.replace((t_us, hip_m));
        if before.is_none_or(|(then_us, _)| t_us.saturating_sub(then_us) > MAX_GAP_US) {
            self.window = AdaptiveWindow::default();
        }
        self.window.push(t_us, hip_m);
        let Some((then_us, then_m)) = before else { return Ok(vec3::ZERO) };
        let dt_s = t_us.saturating_sub(then_us) as f32 * 1e-6;
        let device_per_model = config.workspace_scale.recip();
        let path_m = vec3::scale(vec3::sub(hip_m, then_m), device_per_model);
        let given_j = vec3::dot(mean_n(&self.sent, config.force_delay_us, then_us, t_us), path_m);
        self.work_j += given_j;
        self.balance_j += given_j;
        let Some(stored_j) = stored_j else {
            // The body has come to rest; a positive balance decays.
            self.balance_j = self.balance_j.max(0.0) * (1.0 - dt_s / DECAY_S).max(0.0);
            self.work_j = self.balance_j;
            self.lowest_j = 0.0;
            self.damping_n_s_m = 0.0;
            return Ok(vec3::ZERO);
        };
        self.balance_j = self.balance_j.max(-stored_j - config.margin_j);
        self.lowest_j = self.lowest_j.min(self.balance_j);
        let beyond_j = self.balance_j - config.margin_j + SAMPLING_SHARE * self.lowest_j;
        if beyond_j > config.fault_j {
            return Err(NotPassive);
        }
        if dt_s <= 0.0 || (beyond_j <= 0.0 && self.damping_n_s_m == 0.0) {
            return Ok(vec3::ZERO);
        }
        // Half a step is the error of a count. With a whole step the window is longer and lags more, and the
        // unstable loop in host/tests/stability.rs oscillates with three times the amplitude.
        let noise_m = 0.5 * config.position_step_m;
        let velocity_m_s = vec3::scale(self.window.velocity_m_s(noise_m), device_per_model);
        let most_n_s_m = config.max_damping_n_s_m;
        // At rest there is no energy to remove, and the quotient would be 0 / 0.
        let wanted_n_s_m = if beyond_j > 0.0 {
            (beyond_j / (vec3::norm_squared(velocity_m_s) * dt_s)).min(most_n_s_m)
        } else {
            0.0
        };
        let change = most_n_s_m * dt_s / RISE_S;
        self.damping_n_s_m += (wanted_n_s_m - self.damping_n_s_m).max(-change).min(change);
        let force_n = vec3::scale(velocity_m_s, -self.damping_n_s_m);
        Ok(if vec3::is_finite(force_n) { force_n } else { vec3::ZERO })
    }
}

/// Mean force at the motors over an interval; each force is held from `delay_us` after it was sent. Times
/// before the oldest force in the buffer count with that force.
fn mean_n(sent: &Recent<SENT>, delay_us: u32, from_us: u64, to_us: u64) -> Vec3 {
    let span_us = to_us.saturating_sub(from_us) as f32;
    let (mut mean_n, mut until_us) = (vec3::ZERO, span_us);
    for (age, (sent_us, force_n)) in sent.iter().enumerate() {
        // Relative to `from_us`; negative before it.
        let since_us = sent_us.wrapping_add(delay_us).wrapping_sub(from_us as u32).cast_signed() as f32;
        let since_us = if age + 1 == SENT { 0.0 } else { since_us.max(0.0) };
        if since_us < until_us {
            mean_n = vec3::add(mean_n, vec3::scale(force_n, (until_us - since_us) / span_us));
            until_us = since_us;
        }
        if until_us <= 0.0 {
            break;
        }
    }
    mean_n
}

#[cfg(test)]
mod tests {
    use super::*;

    /// No bound on the stored energy.
    const FULL: Option<f32> = Some(f32::INFINITY);

    /// Strokes in and out of a spring; a force that leads the position by `lead_m` generates energy.
    fn stroke(config: &PassivityConfig, stiffness_n_m: f32, lead_m: f32) -> (Passivity, f32, bool) {
        let (mut guard, mut most_n, mut active) = (Passivity::default(), 0.0_f32, false);
        for tick in 0..4_000_u64 {
            let phase = tick as f32 * 0.004;
            let (depth_m, inward) = (0.01 * (1.0 - phase.cos()), phase.sin() > 0.0);
            let z = -depth_m;
            let now_us = tick * 1_000;
            let verdict = guard.observe(config, (now_us, [0.0, 0.0, z]), FULL);
            match verdict {
                Ok([_, _, damping_n]) => most_n = most_n.max(damping_n.abs()),
                Err(NotPassive) => active = true,
            }
            let force_n = stiffness_n_m * (depth_m + if inward { -lead_m } else { lead_m }).max(0.0);
            guard.sent(now_us, [0.0, 0.0, force_n]);
        }
        (guard, most_n, active)
    }

    #[test]
    fn a_spring_needs_no_damping() {
        let (guard, most_n, active) = stroke(&PassivityConfig::default(), 500.0, 0.0);
        assert!(most_n == 0.0 && !active && guard.work_j() < 5e-3, "{guard:?} {most_n}");
    }

    #[test]
    fn generated_energy_is_damped_and_then_a_fault() {
        let config = PassivityConfig { fault_j: f32::INFINITY, ..PassivityConfig::default() };
        let (_, most_n, _) = stroke(&config, 500.0, 0.002);
        assert!(most_n > 0.02 && most_n < 2.0 * 0.05, "at most 2 N s/m at 40 mm/s: {most_n}");
        assert!(stroke(&PassivityConfig { fault_j: 0.02, ..config }, 500.0, 0.002).2);
    }

    /// One metre against 1 N of friction, then a force that gives energy.
    #[test]
    fn dissipated_energy_is_no_credit() {
        let config = PassivityConfig { fault_j: f32::INFINITY, ..PassivityConfig::default() };
        let damped_after_j = |stored_j| {
            let mut guard = Passivity::default();
            let mut begun_j = None;
            for tick in 0..12_000_u64 {
                let (now_us, x_m) = (tick * 1_000, 1e-4 * tick as f32);
                let verdict = guard.observe(&config, (now_us, [x_m, 0.0, 0.0]), stored_j);
                guard.sent(now_us, [if tick < 10_000 { -1.0 } else { 1.0 }, 0.0, 0.0]);
                if tick == 10_000 {
                    assert!(
                        (guard.work_j() + 1.0).abs() < 1e-2,
                        "the work itself is not bounded: {}",
                        guard.work_j()
                    );
                    begun_j = Some(guard.work_j());
                }
                if verdict != Ok(vec3::ZERO) {
                    return begun_j.map(|begun_j| guard.work_j() - begun_j);
                }
            }
            None
        };
        let given_j = damped_after_j(Some(2e-3)).expect("it damps");
        // The stored energy, twice the margin, and 5 %.
        assert!((0.011..0.014).contains(&given_j), "{given_j}");
        assert_eq!(damped_after_j(FULL), None, "the test must be able to fail");
    }

    /// A hand pushed along at 0.1 m/s, and then against its motion.
    #[test]
    fn damping_comes_and_goes_without_a_step() {
        let config = PassivityConfig { margin_j: 1e-3, fault_j: f32::INFINITY, ..PassivityConfig::default() };
        let (mut guard, mut before_n, mut most_n) = (Passivity::default(), 0.0, 0.0_f32);
        for tick in 0..120_u64 {
            let verdict = guard.observe(&config, (tick * 1_000, [1e-4 * tick as f32, 0.0, 0.0]), FULL);
            let [damping_n, ..] = verdict.expect("passive");
            guard.sent(tick * 1_000, [if tick < 40 { 5.0 } else { -5.0 }, 0.0, 0.0]);
            // 2 N s/m at 0.1 m/s, a tenth of that per tick.
            assert!(
                (damping_n - before_n).abs() < 0.021 && damping_n <= 0.0,
                "{tick}: {damping_n} after {before_n}"
            );
            before_n = damping_n;
            most_n = most_n.max(-damping_n);
        }
        assert!((most_n - 0.2).abs() < 1e-3 && before_n == 0.0, "{most_n}, {before_n} at the end");
    }

    /// Two forces, sent at 1 and 2 ms: each is weighted by the time that it was at the motors.
    #[test]
    fn a_path_is_weighted_with_the_forces_at_the_motors() {
        // The 32 bits of microseconds overflow in between.
        let begin_us = u64::from(u32::MAX) - 1_500;
        let work_j = |force_delay_us, from_us, to_us| {
            let mut guard = Passivity::default();
            guard.sent(begin_us + 1_000, [2.0, 0.0, 0.0]);
            guard.sent(begin_us + 2_000, [5.0, 0.0, 0.0]);
            let config = PassivityConfig { force_delay_us, ..PassivityConfig::default() };
            let _ = guard.observe(&config, (begin_us + from_us, vec3::ZERO), FULL);
            let _ = guard.observe(&config, (begin_us + to_us, [1.0, 0.0, 0.0]), FULL);
            guard.work_j()
        };
        for (delay_us, from_us, to_us, mean_n) in [
            (0, 0, 1_000, 0.0),
            (0, 1_000, 2_000, 2.0),
            (0, 2_000, 3_000, 5.0),
            (0, 500, 1_500, 1.0),
            (250, 1_000, 2_000, 1.5),
            (250, 2_000, 3_000, 4.25),
            (1_250, 2_000, 3_000, 1.5),
            (0, 0, 4_000, 3.0),
        ] {
            let found = work_j(delay_us, from_us, to_us);
            assert!((found - mean_n).abs() < 1e-5, "{delay_us} {from_us} {to_us}: {found}, not {mean_n}");
        }
    }

    #[test]
    fn the_oldest_force_stands_for_all_before_it() {
        let mut sent = Recent::default();
        for tick in 0..100_u16 {
            sent.push(u64::from(tick) * 1_000, [f32::from(tick), 0.0, 0.0]);
        }
        assert_eq!(mean_n(&sent, 0, 99_000, 100_000), [99.0, 0.0, 0.0]);
        assert_eq!(mean_n(&sent, 0, 77_000, 78_000), [77.0, 0.0, 0.0]);
        assert_eq!(mean_n(&sent, 0, 3_000, 4_000), [76.0, 0.0, 0.0], "100 - 24");
        assert_eq!(mean_n(&sent, 0, 4_000, 4_000), vec3::ZERO);
    }

    #[test]
    fn the_margin_counts_in_device_metres() {
        let half = PassivityConfig { workspace_scale: 2.0, ..PassivityConfig::default() };
        let (device, model) =
            (stroke(&half, 500.0, 0.002).0, stroke(&PassivityConfig::default(), 500.0, 0.002).0);
        assert!((2.0 * device.work_j() / model.work_j() - 1.0).abs() < 1e-3);
    }

    #[test]
    fn a_positive_balance_decays_after_the_touch() {
        let config = PassivityConfig::default();
        let mut guard =
            Passivity { last: Some((0, vec3::ZERO)), balance_j: 0.1, lowest_j: -0.2, ..Passivity::default() };
        let _ = guard.observe(&config, (100_000, vec3::ZERO), None);
        assert!((guard.work_j() - 0.09).abs() < 1e-6 && guard.lowest_j == 0.0);
        let mut guard = Passivity {
            last: Some((0, vec3::ZERO)),
            balance_j: -0.1,
            lowest_j: -0.2,
            ..Passivity::default()
        };
        let _ = guard.observe(&config, (1_000, vec3::ZERO), None);
        assert_eq!(guard.work_j(), 0.0, "a negative balance is dropped");
    }
}
