//! The summary of a session, as the caller prints it.

use super::statistics::TouchStatistics;
use crate::device::DeviceInfo;
use crate::doctor::SystemInfo;
use crate::instructions::Instructions;
use crate::live::LiveCounts;
use crate::rt::{LatencyReport, LoopEnd};
use crate::sys::RtReport;
use core::fmt;
use palpate_core::{Coverage, Phase};

/// Summary of a session.
#[derive(Debug, Clone, PartialEq)]
pub struct SessionSummary {
    /// The device.
    pub device: DeviceInfo,
    /// The instructions that evaluated the force.
    pub instructions: Instructions,
    /// Largest stiffness of the organ at the hand, N/m.
    pub stiffest_n_m: f32,
    /// Factor on every force that keeps the stiffness within the device's limit; 1 if no reduction is
    /// necessary.
    pub force_share: f32,
    /// What the operating system granted.
    pub real_time: RtReport,
    /// Kernel and CPUs.
    pub system: SystemInfo,
    /// Reason of the end.
    pub end: LoopEnd,
    /// Phase at the end.
    pub phase: Phase,
    /// Number of ticks.
    pub ticks: u64,
    /// Timing.
    pub latency: LatencyReport,
    /// Records missing from the statistics because the session's queue was full.
    pub dropped_records: u64,
    /// Records missing from the recording because its queue was full; 0 without a recording.
    pub dropped_by_recorder: u64,
    /// Device exchanges that failed.
    pub device_errors: u64,
    /// Forces, displacements, contacts.
    pub touch: TouchStatistics,
    /// What a live solver has sent; `None` where tables gave the force.
    pub live: Option<LiveCounts>,
}

impl SessionSummary {
    /// Writes the share of the contact ticks by coverage.
    fn write_coverage(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "\ncoverage    ")?;
        for (kind, ticks) in Coverage::ALL.iter().zip(self.touch.coverage_ticks) {
            if ticks > 0 {
                let share = 100.0 * ticks as f64 / self.touch.engaged_ticks as f64;
                write!(f, " {} {share:.1} %", kind.name())?;
            }
        }
        Ok(())
    }

    /// Writes what the solver has sent and how the force went from jet to jet.
    fn write_live(&self, live: LiveCounts, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let touch = &self.touch;
        write!(f, "\nlive         {} jets taken", live.taken)?;
        if live.refused > 0 {
            write!(f, ", {} of them refused", live.refused)?;
        }
        if let Some(first_us) = touch.first_force_us {
            write!(f, "; first force {:.2} s after the loop began", first_us as f64 * 1e-6)?;
        }
        write!(
            f,
            "; {:.2} % of the ticks in touch extrapolated; {} changes of the jet, with a step of {:.0} mN at most",
            100.0 * touch.extrapolated_share(),
            touch.hand_overs,
            touch.largest_hand_over_n * 1e3
        )
    }
}

impl fmt::Display for SessionSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "device       {}", self.device.name)?;
        writeln!(f, "instructions {}", self.instructions)?;
        match self.live {
            None => write!(f, "stiffness    up to {:.0} N/m", self.stiffest_n_m)?,
            Some(_) => write!(f, "stiffness    that of the jets, limited to the device's")?,
        }
        if self.force_share < 1.0 {
            let cap_n_m = self.force_share * self.stiffest_n_m;
            write!(
                f,
                ", limited to {cap_n_m:.0} N/m: all forces are multiplied by {:.2}, the organ feels softer",
                self.force_share
            )?;
        }
        writeln!(f)?;
        writeln!(f, "{}", self.real_time)?;
        writeln!(f, "{}", self.system)?;
        writeln!(f, "{}", self.latency)?;
        let touch = &self.touch;
        write!(f, "touch        {}", touch.in_words(self.ticks))?;
        if touch.engaged_ticks > 0 {
            self.write_coverage(f)?;
            write!(
                f,
                "\nsmoothness   largest step of the force {:.0} mN a tick; work on the hand at most {:+.1} mJ in a touch",
                touch.largest_step_n * 1e3,
                touch.largest_work_j * 1e3
            )?;
            if touch.damped_ticks > 0 {
                write!(f, ", {} ticks damped", touch.damped_ticks)?;
            }
        }
        if let Some(live) = self.live {
            self.write_live(live, f)?;
        }
        match self.end {
            LoopEnd::Completed => {}
            LoopEnd::Stopped => write!(f, "\nend          stopped")?,
            LoopEnd::DeviceLost(error) => write!(f, "\nend          {error}")?,
        }
        if let Phase::SafeZero(fault) = self.phase {
            write!(f, "\nfault        {} (force zero, latched)", fault.name())?;
        }
        if self.dropped_records + self.device_errors > 0 {
            let (dropped, errors) = (self.dropped_records, self.device_errors);
            write!(f, "\nlosses       {dropped} records dropped, {errors} device exchanges failed")?;
        }
        Ok(())
    }
}
