//! Properties of the system that a session cannot request; the report shows them next to what was granted.

use super::cpu::governor_of;
use super::kernel::{Preemption, release};
use super::probe::Probe;
use core::fmt;

/// Kernel and CPUs of a session.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SystemInfo {
    /// Release and preemption.
    pub kernel: String,
    /// Governor of the loop's CPU if it is pinned, otherwise of all CPUs.
    pub governor: String,
    /// CPUs isolated from the scheduler, as the kernel lists them; empty if there are none.
    pub isolated: String,
}

impl SystemInfo {
    /// Reads the properties of a PC.
    #[must_use]
    pub fn of(probe: &Probe, cpu: Option<usize>) -> Self {
        let preemption = Preemption::of(probe).map_or("preemption unknown", Preemption::name);
        let cpus = cpu.map_or_else(|| probe.online(), |cpu| vec![cpu]);
        let mut governors: Vec<String> = cpus.into_iter().filter_map(|cpu| governor_of(probe, cpu)).collect();
        governors.sort();
        governors.dedup();
        Self {
            kernel: format!("{}, {preemption}", release(probe)),
            governor: if governors.is_empty() { "unknown".into() } else { governors.join(", ") },
            isolated: probe.read("/sys/devices/system/cpu/isolated").unwrap_or_default(),
        }
    }
}

impl fmt::Display for SystemInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let isolated = if self.isolated.is_empty() { "none" } else { &self.isolated };
        write!(
            f,
            "kernel       {}\nCPUs         governor {}; isolated: {isolated}",
            self.kernel, self.governor
        )
    }
}
