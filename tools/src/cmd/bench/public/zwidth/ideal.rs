//! The textbook case: a mass m with viscous damping b meets a wall with stiffness K and virtual damping B, whose
//! force is computed from sampled positions and held for the period T,
//!
//! F_k = -K x_k - B (x_k - x_k-1) / T.
//!
//! Colgate and Schenkel (1997): the wall is passive, whatever the person does, if and only if b > K T / 2 + |B|.
//!
//! *Any motion*: the energy of device and wall over whole cycles of sampled sinusoids, up to half of the sampling
//! rate. Between two samples the hand moves at constant speed: of all motions through the same samples that one
//! loses least to b. *On springs*: the mass is coupled to lossless springs and must come to rest. Such a partner
//! has one resonance, so virtual damping helps it at low frequencies.

use std::f64::consts::PI;

use nalgebra::{Matrix3, Vector2};

use super::largest;

/// An ideal device.
#[derive(Debug, Clone, Copy)]
pub(super) struct Device {
    /// Mass, kg.
    pub(super) mass_kg: f64,
    /// Viscous damping, N s/m.
    pub(super) damping_n_s_m: f64,
    /// Period of the loop, s.
    pub(super) period_s: f64,
}

/// Resonances of the partners, as shares of half of the sampling rate.
const RESONANCES: [f64; 6] = [0.02, 0.1, 0.3, 0.6, 0.9, 0.99];
/// Simulated time, s, in four windows.
const SECONDS: f64 = 4.0;
/// Range of stiffness, N/m.
const RANGE_N_M: [f64; 2] = [1.0, 1e6];

/// Ticks of a sampled sinusoid, after which every one of its frequencies repeats.
const CYCLE: usize = 200;

impl Device {
    /// The largest stiffness of a wall with this virtual damping that gives no energy in any motion, N/m; 0 if
    /// none does.
    pub(super) fn stiffness_in_any_motion(&self, virtual_n_s_m: f64) -> f64 {
        let [low, high] = RANGE_N_M;
        let is_passive =
            |stiffness| (1..=CYCLE / 2).all(|turns| self.given_j(turns, stiffness, virtual_n_s_m) <= 0.0);
        largest(low, high, 1.4, 2e-3, is_passive).unwrap_or(0.0)
    }

    /// Energy that device and wall give to a hand that makes so many turns of a sinusoid of 1 mm in a cycle, J.
    fn given_j(&self, turns: usize, stiffness_n_m: f64, virtual_n_s_m: f64) -> f64 {
        let place_m =
            |tick: usize| 1e-3 * libm::cos(2.0 * PI * (turns * (tick % CYCLE)) as f64 / CYCLE as f64);
        let mut given_j = 0.0;
        for tick in 1..=CYCLE {
            let (before_m, here_m, next_m) = (place_m(tick - 1), place_m(tick), place_m(tick + 1));
            let force_n = -stiffness_n_m * here_m - virtual_n_s_m * (here_m - before_m) / self.period_s;
            let moved_m = next_m - here_m;
            given_j += force_n * moved_m - self.damping_n_s_m * moved_m * moved_m / self.period_s;
        }
        given_j
    }

    /// The largest stiffness of a wall with this virtual damping on which the mass comes to rest in the hold of
    /// every spring, N/m; 0 if there is none.
    pub(super) fn stiffness_on_springs(&self, virtual_n_s_m: f64) -> f64 {
        let [low, high] = RANGE_N_M;
        let is_passive =
            |stiffness| RESONANCES.iter().all(|share| self.decays(*share, stiffness, virtual_n_s_m));
        largest(low, high, 1.4, 2e-3, is_passive).unwrap_or(0.0)
    }

    /// The largest passive stiffness by the condition of Colgate and Schenkel, N/m.
    pub(super) fn bound(&self, virtual_n_s_m: f64) -> f64 {
        (2.0 * (self.damping_n_s_m - virtual_n_s_m.abs()) / self.period_s).max(0.0)
    }

    /// Whether the oscillation on a lossless spring decays.
    fn decays(&self, share: f64, stiffness_n_m: f64, virtual_n_s_m: f64) -> bool {
        let Self { mass_kg, damping_n_s_m, period_s } = *self;
        let rad_per_s = share * PI / period_s;
        let spring_n_m = mass_kg * rad_per_s * rad_per_s;
        // Exact over a period: (x, v) under a constant force.
        let generator = Matrix3::new(
            0.0,
            1.0,
            0.0,
            -spring_n_m / mass_kg,
            -damping_n_s_m / mass_kg,
            1.0 / mass_kg,
            0.0,
            0.0,
            0.0,
        );
        let step = (generator * period_s).exp();
        let (transition, push) = (step.fixed_view::<2, 2>(0, 0), step.fixed_view::<2, 1>(0, 2));
        let ticks = (SECONDS / period_s) as usize;
        let mut state = Vector2::new(1e-4, 0.0);
        let mut before_m = state.x;
        let mut most_j = [0.0f64; 4];
        for tick in 0..ticks {
            let force_n = -stiffness_n_m * state.x - virtual_n_s_m * (state.x - before_m) / period_s;
            before_m = state.x;
            state = transition * state + push * force_n;
            // With the wall's own spring: at a low resonance it stores most of the energy.
            let energy_j =
                0.5 * mass_kg * state.y * state.y + 0.5 * (spring_n_m + stiffness_n_m) * state.x * state.x;
            if !energy_j.is_finite() || energy_j > 1e6 {
                return false;
            }
            let window = &mut most_j[4 * tick / ticks];
            *window = window.max(energy_j);
        }
        most_j[3] < most_j[1]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_simulated_wall_meets_the_condition_of_colgate_and_schenkel() {
        for rate_hz in [500.0, 1000.0, 4000.0] {
            let device = Device { mass_kg: 0.15, damping_n_s_m: 1.0, period_s: 1.0 / rate_hz };
            for virtual_n_s_m in [0.0, 0.3, 0.8] {
                let (found, bound) =
                    (device.stiffness_in_any_motion(virtual_n_s_m), device.bound(virtual_n_s_m));
                assert!(
                    (found / bound - 1.0).abs() < 5e-3,
                    "{rate_hz} Hz, B {virtual_n_s_m}: {found} N/m in any motion, {bound} by the condition"
                );
                // The condition suffices on springs; without virtual damping it is their limit.
                let coupled = device.stiffness_on_springs(virtual_n_s_m);
                assert!(
                    coupled > 0.98 * bound,
                    "{rate_hz} Hz, B {virtual_n_s_m}: {coupled} on springs, {bound}"
                );
                assert!(virtual_n_s_m > 0.0 || coupled < 1.02 * bound, "{rate_hz} Hz: {coupled}, {bound}");
            }
            assert_eq!(device.stiffness_in_any_motion(1.1), 0.0, "more virtual damping than the device has");
        }
    }

    #[test]
    fn a_device_without_damping_has_no_passive_wall() {
        let device = Device { mass_kg: 0.15, damping_n_s_m: 0.0, period_s: 1e-3 };
        assert_eq!((device.stiffness_in_any_motion(0.0), device.bound(0.0)), (0.0, 0.0));
        assert_eq!(device.stiffness_on_springs(0.0), 0.0);
    }
}
