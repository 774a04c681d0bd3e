//! Timing options of the loop, shared by `run` and `doctor`.

use clap::Args as ClapArgs;
use palpate_host::device::profile::Profile;
use palpate_host::rt::LoopConfig;
use palpate_host::sys::{DEFAULT_FIFO_PRIORITY, MAX_LOOP_FIFO_PRIORITY, RtRequest};

/// Longest period, us: after four periods a sample is a fault.
const MAX_PERIOD_US: u32 = 2_500;

const DEFAULT: LoopConfig = LoopConfig { period_us: 1_000, spin_us: 100, arm_button: 0 };

/// Timing of the loop and its requests to the operating system. A refused request is reported, and the loop
/// runs without it.
#[derive(Debug, Clone, Copy, ClapArgs)]
pub(crate) struct Timing {
    /// Pin the haptic thread to this CPU; if not given the kernel chooses
    #[arg(long, value_name = "N", help_heading = "Timing", hide_short_help = true)]
    pub cpu: Option<usize>,
    /// SCHED_FIFO priority of the haptic thread, 1 to 97 (the guard gets one more); 0 asks for ordinary
    /// scheduling
    #[arg(long, value_name = "PRIORITY", help_heading = "Timing", default_value_t = DEFAULT_FIFO_PRIORITY, hide_short_help = true,
          value_parser = clap::value_parser!(i32).range(0..=i64::from(MAX_LOOP_FIFO_PRIORITY)))]
    pub fifo: i32,
    /// Last part of every wait that spins instead of sleeping, us
    #[arg(long, value_name = "US", help_heading = "Timing", default_value_t = DEFAULT.spin_us, hide_short_help = true)]
    pub spin_us: u32,
    /// Time between two ticks, us, 100 to 2500; 1000, or the period of the profile, if not given. The
    /// stiffness cap of a profile is that of this period
    #[arg(long, value_name = "US", help_heading = "Timing", hide_short_help = true,
          value_parser = clap::value_parser!(u32).range(100..=i64::from(MAX_PERIOD_US)))]
    pub period_us: Option<u32>,
}

impl Default for Timing {
    fn default() -> Self {
        Self { cpu: None, fifo: DEFAULT_FIFO_PRIORITY, spin_us: DEFAULT.spin_us, period_us: None }
    }
}

impl Timing {
    /// The request to the operating system.
    pub(crate) fn request(&self) -> RtRequest {
        RtRequest {
            fifo_priority: Some(self.fifo).filter(|priority| *priority > 0),
            cpu: self.cpu,
            ..RtRequest::default()
        }
    }

    /// Period and spin; the profile's period if none is given.
    pub(crate) fn haptic(&self, profile: Option<&Profile>) -> LoopConfig {
        let period_us = self.period_us.or(profile.map(Profile::period_us)).unwrap_or(DEFAULT.period_us);
        LoopConfig { period_us, spin_us: self.spin_us, ..LoopConfig::default() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_options_it_is_what_the_host_does_by_itself() {
        assert_eq!(Timing::default().haptic(None), LoopConfig::default());
        assert_eq!(Timing::default().request(), RtRequest::default());
        assert_eq!(Timing { fifo: 0, ..Timing::default() }.request().fifo_priority, None);
    }
}
