//! The largest stiffness that a device may render, its derivation, and the check of a session's timing
//! against it.

use super::Profile;
use crate::rt::latency::LatencyReport;
use core::fmt;

/// Cap for a device whose damping is not stated, N/m in device metres.
pub const DEFAULT_CAP_N_M: f32 = 1_000.0;

/// Upper bound of the cap whatever the profile states, N/m in device metres.
pub const HARD_CAP_N_M: f32 = 3_000.0;

/// Lateness that a cap allows for, as a share of the period.
pub const LATENESS_ALLOWANCE: f32 = 0.1;

/// The timing that limits the stiffness.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Timing {
    /// Time between two samples, s.
    pub cycle_s: f32,
    /// Delay from the measurement of a position to the force for it, without the half cycle for which the
    /// force is held, s.
    pub delay_s: f32,
}

/// The limit that determines the cap.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CapReason {
    /// The value listed in the profile.
    Listed,
    /// The default, because no damping is stated.
    Default,
    /// [`HARD_CAP_N_M`].
    Hard,
    /// K < 2 b / T: above it the device can give energy to the hand.
    Passivity,
    /// K < b / (T / 2 + d): above it the closed loop is unstable.
    Stability,
    /// K <= 2 f_c / Delta: above it friction does not stop a limit cycle excited by the encoder's
    /// quantisation (Abbott and Okamura 2005).
    Quantisation,
}

impl CapReason {
    const fn text(self) -> &'static str {
        match self {
            Self::Listed => "listed for the device",
            Self::Default => "no damping is stated",
            Self::Hard => "upper bound",
            Self::Passivity => "passivity",
            Self::Stability => "stability with the delay",
            Self::Quantisation => "encoder quantisation",
        }
    }
}

/// Largest stiffness and its reason.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StiffnessCap {
    /// N/m in device metres.
    pub n_m: f32,
    /// The limit that determines it.
    pub reason: CapReason,
    /// The timing that it assumes.
    pub timing: Timing,
}

impl Profile {
    /// Timing as the profile states it: a cycle with the allowed lateness, and a force that is sent with the
    /// next exchange.
    #[must_use]
    pub fn timing(&self) -> Timing {
        let cycle_s = (1.0 + LATENESS_ALLOWANCE) * self.period_us() as f32 * 1e-6;
        Timing { cycle_s, delay_s: cycle_s + self.link_delay_s() }
    }

    fn link_delay_s(&self) -> f32 {
        (self.position_delay_us + self.force_delay_us) as f32 * 1e-6
    }

    /// The cap of this device.
    #[must_use]
    pub fn cap(&self) -> StiffnessCap {
        self.cap_at(self.timing())
    }

    /// The cap at another timing: the minimum of all limits that apply.
    #[must_use]
    pub fn cap_at(&self, timing: Timing) -> StiffnessCap {
        let Timing { cycle_s, delay_s } = timing;
        let damping = self.mechanism.damping.map(|damping| damping.n_s_m);
        let friction = self.mechanism.coulomb_n.zip(self.mechanism.encoder_quantum_m);
        let limits = [
            (Some(self.max_stiffness_n_m), CapReason::Listed),
            (damping.is_none().then_some(DEFAULT_CAP_N_M), CapReason::Default),
            (Some(HARD_CAP_N_M), CapReason::Hard),
            // Colgate and Schenkel 1997, without virtual damping.
            (damping.map(|b| 2.0 * b / cycle_s), CapReason::Passivity),
            (damping.map(|b| b / (0.5 * cycle_s + delay_s)), CapReason::Stability),
            (friction.map(|(coulomb_n, quantum_m)| 2.0 * coulomb_n / quantum_m), CapReason::Quantisation),
        ];
        let highest = StiffnessCap { n_m: f32::INFINITY, reason: CapReason::Hard, timing };
        limits.into_iter().fold(highest, |lowest, (limit, reason)| match limit {
            Some(n_m) if n_m < lowest.n_m => StiffnessCap { n_m, reason, timing },
            _ => lowest,
        })
    }

    /// The timing of a session with this device: the cycle that 99 % of the ticks kept, and the corresponding
    /// delay.
    ///
    /// `report` has lateness, exchange and compute times. The delay of the link is taken from the profile.
    #[must_use]
    pub fn measured(&self, report: &LatencyReport) -> Timing {
        let ticks = report.wake.count.max(1);
        // With more than one overrun in a hundred ticks the 99 % cycle includes the periods that an overrun
        // skips.
        let skips = if 100 * report.overruns > ticks {
            report.skipped_periods.div_ceil(report.overruns.max(1)) as f32
        } else {
            0.0
        };
        let late_s = report.wake.p99_ns as f32 * 1e-9;
        let cycle_s = (1.0 + skips) * self.period_us() as f32 * 1e-6 + late_s;
        let busy_ns = report.device.p99_ns + report.compute.p99_ns;
        let delay_s = cycle_s + busy_ns as f32 * 1e-9 + self.link_delay_s();
        Timing { cycle_s, delay_s }
    }

    /// Checks the cap against the timing of a session.
    #[must_use]
    pub fn verdict(&self, report: &LatencyReport) -> CapVerdict {
        let (cap, measured) = (self.cap(), self.measured(report));
        let as_stated = measured.cycle_s <= cap.timing.cycle_s && measured.delay_s <= cap.timing.delay_s;
        // A stated damping gives the cap at another timing. The default cap is valid only at its own timing.
        let at_measured = self.mechanism.damping.map(|_| self.cap_at(measured));
        let held = as_stated || at_measured.is_some_and(|at| at.n_m >= cap.n_m);
        CapVerdict { cap, measured, held, at_measured }
    }
}

/// Result of the check of a session's timing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CapVerdict {
    /// The cap that was used.
    pub cap: StiffnessCap,
    /// The measured timing.
    pub measured: Timing,
    /// Whether the cap was low enough for it.
    pub held: bool,
    /// The cap at the measured timing; `None` without a stated damping.
    pub at_measured: Option<StiffnessCap>,
}

impl fmt::Display for CapVerdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let StiffnessCap { n_m, reason, timing } = self.cap;
        let ms = |seconds: f32| 1e3 * seconds;
        write!(
            f,
            "the cap of {n_m:.0} N/m at the hand ({}) assumes a cycle of {:.2} ms and a delay of {:.2} ms; measured p99 \
             {:.2} and {:.2} ms: ",
            reason.text(),
            ms(timing.cycle_s),
            ms(timing.delay_s),
            ms(self.measured.cycle_s),
            ms(self.measured.delay_s)
        )?;
        match (self.held, self.at_measured) {
            (true, _) => f.write_str("the cap was valid"),
            (false, Some(at)) => write!(f, "THE CAP WAS TOO HIGH, at most {:.0} N/m is valid", at.n_m),
            (false, None) => f.write_str("THE CAP IS NOT VALID, the loop was slower than it assumes"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::profile::Damping;
    use crate::rt::{LatencyRecorder, Percentiles};

    fn simulated() -> Profile {
        Profile::bundled("simulated").expect("bundled")
    }

    #[test]
    fn the_lowest_limit_determines_the_cap_and_is_named() {
        let timing = Timing { cycle_s: 1e-3, delay_s: 2e-3 };
        let with = |change: &dyn Fn(&mut Profile)| {
            let mut profile = simulated();
            profile.mechanism.coulomb_n = None;
            change(&mut profile);
            profile.cap_at(timing)
        };
        let damping = |n_s_m| Some(Damping { n_s_m, measured: false });
        let close = |cap: StiffnessCap, n_m: f32, reason| {
            assert!(
                (cap.n_m - n_m).abs() < 1e-3 * n_m && cap.reason == reason,
                "{cap:?}, not {n_m} {reason:?}"
            );
        };
        // b / (T / 2 + d) = 2 / 2.5 ms.
        close(with(&|_| ()), 800.0, CapReason::Stability);
        close(with(&|p| p.mechanism.damping = damping(100.0)), 3000.0, CapReason::Listed);
        let strong = |p: &mut Profile| (p.mechanism.damping, p.max_stiffness_n_m) = (damping(100.0), 5000.0);
        close(with(&strong), 3000.0, CapReason::Hard);
        close(with(&|p| p.mechanism.damping = None), 1000.0, CapReason::Default);
        close(with(&|p| p.max_stiffness_n_m = 400.0), 400.0, CapReason::Listed);
        close(with(&|p| p.mechanism.coulomb_n = Some(9e-3)), 600.0, CapReason::Quantisation);
        // Known friction limits the stiffness without a damping too, and a finer encoder raises this limit.
        let friction = |p: &mut Profile| (p.mechanism.damping, p.mechanism.coulomb_n) = (None, Some(9e-3));
        close(with(&friction), 600.0, CapReason::Quantisation);
        // Without a delay and with a long cycle, passivity and stability give the same limit.
        let mut profile = simulated();
        profile.mechanism.coulomb_n = None;
        close(profile.cap_at(Timing { cycle_s: 4e-3, delay_s: 0.0 }), 1000.0, CapReason::Passivity);
    }

    /// A slower loop has a lower cap, and its session is checked against its own timing.
    #[test]
    fn the_cap_decreases_with_the_period() {
        let (nominal, slow) = (simulated(), simulated().at_period(2_500));
        assert_eq!((slow.period_us(), slow.timing().cycle_s), (2_500, 2.75e-3));
        assert!(slow.cap().n_m < 0.5 * nominal.cap().n_m, "{:?} and {:?}", slow.cap(), nominal.cap());
        let verdict = slow.verdict(&report(40_000, 20_000, 0));
        assert!((verdict.measured.cycle_s - 2.54e-3).abs() < 1e-8 && verdict.held, "{verdict}");
    }

    /// A process between loop and device would deliver each sample one tick later: with b = 2 N s/m the stability
    /// bound b / (T/2 + d) of a Polhem falls from 930 to 635 N/m.
    #[test]
    fn a_tick_of_delay_costs_a_third_of_the_cap() {
        let mut profile = Profile::bundled("polhem").expect("bundled");
        profile.mechanism.damping = Some(Damping { n_s_m: 2.0, measured: true });
        let direct_n_m = profile.cap().n_m;
        profile.position_delay_us += profile.period_us();
        let detour_n_m = profile.cap().n_m;
        assert!(
            (direct_n_m - 930.2).abs() < 1.0 && (detour_n_m - 634.9).abs() < 1.0,
            "{direct_n_m} {detour_n_m}"
        );
    }

    fn report(late_ns: u64, compute_ns: u64, overruns: u64) -> LatencyReport {
        let at = |p99_ns| Percentiles { count: 10_000, p99_ns, ..Percentiles::default() };
        let empty = LatencyRecorder::new().report();
        LatencyReport {
            wake: at(late_ns),
            // Half of it is the device's.
            device: at(compute_ns / 2),
            compute: at(compute_ns / 2),
            overruns,
            skipped_periods: 2 * overruns,
            ..empty
        }
    }

    #[test]
    fn the_measured_timing_is_checked_against_the_cap() {
        let profile = simulated();
        let punctual = profile.verdict(&report(40_000, 20_000, 0));
        assert!(punctual.held, "{punctual}");
        assert!((punctual.measured.cycle_s - 1.04e-3).abs() < 1e-8, "{punctual:?}");
        assert!((punctual.measured.delay_s - 1.06e-3).abs() < 1e-8, "{punctual:?}");

        let late = profile.verdict(&report(500_000, 20_000, 0));
        let would = late.at_measured.expect("its damping is stated").n_m;
        assert!(!late.held && would < 0.8 * late.cap.n_m, "{late}");
        assert!(late.to_string().contains("TOO HIGH"), "{late}");
        // Overruns matter above one tick in a hundred.
        assert!(profile.verdict(&report(40_000, 20_000, 99)).held);
        let skipping = profile.verdict(&report(40_000, 20_000, 101));
        assert!(!skipping.held && (skipping.measured.cycle_s - 3.04e-3).abs() < 1e-8, "{skipping}");

        // The default cap has no damping from which a cap at another timing could be computed.
        let falcon = Profile::bundled("falcon").expect("bundled");
        let late = falcon.verdict(&report(500_000, 20_000, 0));
        assert!(!late.held && late.at_measured.is_none(), "{late}");
        assert!(falcon.verdict(&report(40_000, 20_000, 0)).held);
        // A listed limit far below the limits by damping is valid with a late loop too.
        let soft = Profile { max_stiffness_n_m: 300.0, ..profile };
        assert!(soft.verdict(&report(500_000, 20_000, 0)).held);
    }
}
