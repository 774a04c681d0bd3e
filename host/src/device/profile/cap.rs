//! The stiffness a device may render, what that stands on, and whether a session's timing bore it out.

use super::Profile;
use crate::rt::LatencyReport;
use core::fmt;
use palpate_core::stiffness::{passive_n_m, stable_n_m};

/// Cap where no damping is stated, N/m of the device.
pub const DEFAULT_CAP_N_M: f32 = 1_000.0;

/// No figure in a profile lifts the cap beyond this, N/m of the device.
pub const HARD_CAP_N_M: f32 = 3_000.0;

/// Lateness that a cap makes room for, as a share of the period: ticks are never quite punctual.
pub const LATENESS_ALLOWANCE: f32 = 0.1;

/// What the stiffness depends on beside the mechanism.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Timing {
    /// Between two samples, s.
    pub cycle_s: f32,
    /// From where the hand was to the force for it, without the half cycle for which the force is held, s.
    pub delay_s: f32,
}

/// Which of the limits is the lowest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CapReason {
    /// What the profile lists.
    Listed,
    /// No damping is stated.
    Default,
    /// [`HARD_CAP_N_M`].
    Hard,
    /// K < 2 b / T: beyond it the device can give the hand energy.
    Passivity,
    /// K < b / (T / 2 + d): beyond it the device shakes by itself.
    Stability,
    /// K <= 2 f_c / Delta: beyond it friction does not stop what the steps of the encoder start (Abbott and Okamura 2005).
    Quantisation,
}

impl CapReason {
    const fn text(self) -> &'static str {
        match self {
            Self::Listed => "listed for the device",
            Self::Default => "no damping is stated",
            Self::Hard => "never more",
            Self::Passivity => "passivity",
            Self::Stability => "stability with the delay",
            Self::Quantisation => "steps of the encoder",
        }
    }
}

/// Largest stiffness, and why.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StiffnessCap {
    /// N/m of the device.
    pub n_m: f32,
    /// The lowest limit.
    pub reason: CapReason,
    /// The timing it stands on.
    pub timing: Timing,
}

impl Profile {
    /// Timing as the profile states it: a cycle that may be late, and a force that leaves with the next exchange.
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

    /// The cap with another timing: the lowest of all that apply.
    #[must_use]
    pub fn cap_at(&self, timing: Timing) -> StiffnessCap {
        let Timing { cycle_s, delay_s } = timing;
        let damping = self.mechanism.damping.map(|damping| damping.n_s_m);
        let friction = self.mechanism.coulomb_n.zip(self.mechanism.encoder_quantum_m);
        let limits = [
            (Some(self.max_stiffness_n_m), CapReason::Listed),
            (damping.is_none().then_some(DEFAULT_CAP_N_M), CapReason::Default),
            (Some(HARD_CAP_N_M), CapReason::Hard),
            (damping.map(|b| passive_n_m(b, 0.0, cycle_s)), CapReason::Passivity),
            (damping.map(|b| stable_n_m(b, 0.0, cycle_s, delay_s)), CapReason::Stability),
            (friction.map(|(coulomb_n, quantum_m)| 2.0 * coulomb_n / quantum_m), CapReason::Quantisation),
        ];
        let highest = StiffnessCap { n_m: f32::INFINITY, reason: CapReason::Hard, timing };
        limits.into_iter().fold(highest, |lowest, (limit, reason)| match limit {
            Some(n_m) if n_m < lowest.n_m => StiffnessCap { n_m, reason, timing },
            _ => lowest,
        })
    }

    /// The timing of a session with this device: the cycle that 99 % of the ticks kept to, and the delay that goes with it.
    ///
    /// `report` knows lateness, exchange and compute time, not how long the link takes: that is the profile's.
    #[must_use]
    pub fn measured(&self, report: &LatencyReport) -> Timing {
        let ticks = report.wake.count.max(1);
        // One overrun in a hundred ticks is in the 99 %; then the cycle is longer by what such an overrun skips.
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

    /// Whether the cap still held with the timing of a session.
    #[must_use]
    pub fn verdict(&self, report: &LatencyReport) -> CapVerdict {
        let (cap, measured) = (self.cap(), self.measured(report));
        let as_stated = measured.cycle_s <= cap.timing.cycle_s && measured.delay_s <= cap.timing.delay_s;
        // A stated damping says what another timing allows; the default cap was only ever meant for its own.
        let at_measured = self.mechanism.damping.map(|_| self.cap_at(measured));
        let held = as_stated || at_measured.is_some_and(|at| at.n_m >= cap.n_m);
        CapVerdict { cap, measured, held, at_measured }
    }
}

/// A session's timing against what the cap stands on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CapVerdict {
    /// The cap that was used.
    pub cap: StiffnessCap,
    /// The timing there was.
    pub measured: Timing,
    /// Whether the cap was low enough for it.
    pub held: bool,
    /// The cap with that timing; `None` without a stated damping.
    pub at_measured: Option<StiffnessCap>,
}

impl fmt::Display for CapVerdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let StiffnessCap { n_m, reason, timing } = self.cap;
        let ms = |seconds: f32| 1e3 * seconds;
        write!(
            f,
            "the cap of {n_m:.0} N/m at the hand ({}) stands on a cycle of {:.2} ms and a delay of {:.2} ms; measured p99 \
             {:.2} and {:.2} ms: ",
            reason.text(),
            ms(timing.cycle_s),
            ms(timing.delay_s),
            ms(self.measured.cycle_s),
            ms(self.measured.delay_s)
        )?;
        match (self.held, self.at_measured) {
            (true, _) => f.write_str("it held"),
            (false, Some(at)) => write!(f, "IT DID NOT HOLD, {:.0} N/m would have", at.n_m),
            (false, None) => f.write_str("IT DID NOT HOLD, the loop was slower than it supposes"),
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
    fn the_lowest_limit_is_the_cap_and_is_named() {
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
        // Known friction counts without a damping too, and a finer encoder lifts it.
        let friction = |p: &mut Profile| (p.mechanism.damping, p.mechanism.coulomb_n) = (None, Some(9e-3));
        close(with(&friction), 600.0, CapReason::Quantisation);
        // Without a delay and with a long cycle it is the half cycle that counts: passivity and stability meet.
        let mut profile = simulated();
        profile.mechanism.coulomb_n = None;
        close(profile.cap_at(Timing { cycle_s: 4e-3, delay_s: 0.0 }), 1000.0, CapReason::Passivity);
    }

    /// A slower loop is another device: the cap is lower, and its own timing is what is judged.
    #[test]
    fn the_cap_falls_with_the_period_that_runs() {
        let (nominal, slow) = (simulated(), simulated().at_period(2_500));
        assert_eq!((slow.period_us(), slow.timing().cycle_s), (2_500, 2.75e-3));
        assert!(slow.cap().n_m < 0.5 * nominal.cap().n_m, "{:?} and {:?}", slow.cap(), nominal.cap());
        let verdict = slow.verdict(&report(40_000, 20_000, 0));
        assert!((verdict.measured.cycle_s - 2.54e-3).abs() < 1e-8 && verdict.held, "{verdict}");
    }

    fn report(late_ns: u64, compute_ns: u64, overruns: u64) -> LatencyReport {
        let at = |p99_ns| Percentiles { count: 10_000, p99_ns, ..Percentiles::default() };
        let empty = LatencyRecorder::new().report();
        LatencyReport {
            wake: at(late_ns),
            // Half of it the device's.
            device: at(compute_ns / 2),
            compute: at(compute_ns / 2),
            overruns,
            skipped_periods: 2 * overruns,
            ..empty
        }
    }

    #[test]
    fn the_measured_timing_judges_the_cap() {
        let profile = simulated();
        let punctual = profile.verdict(&report(40_000, 20_000, 0));
        assert!(punctual.held, "{punctual}");
        assert!((punctual.measured.cycle_s - 1.04e-3).abs() < 1e-8, "{punctual:?}");
        assert!((punctual.measured.delay_s - 1.06e-3).abs() < 1e-8, "{punctual:?}");

        let late = profile.verdict(&report(500_000, 20_000, 0));
        let would = late.at_measured.expect("its damping is stated").n_m;
        assert!(!late.held && would < 0.8 * late.cap.n_m, "{late}");
        assert!(late.to_string().contains("DID NOT HOLD"), "{late}");
        // Overruns count as soon as they are more than one tick in a hundred.
        assert!(profile.verdict(&report(40_000, 20_000, 99)).held);
        let skipping = profile.verdict(&report(40_000, 20_000, 101));
        assert!(!skipping.held && (skipping.measured.cycle_s - 3.04e-3).abs() < 1e-8, "{skipping}");

        // A default cap stands on nothing that would say how much is still right.
        let falcon = Profile::bundled("falcon").expect("bundled");
        let late = falcon.verdict(&report(500_000, 20_000, 0));
        assert!(!late.held && late.at_measured.is_none(), "{late}");
        assert!(falcon.verdict(&report(40_000, 20_000, 0)).held);
        // A listed limit far below what the damping bears holds with a late loop too.
        let soft = Profile { max_stiffness_n_m: 300.0, ..profile };
        assert!(soft.verdict(&report(500_000, 20_000, 0)).held);
    }
}
