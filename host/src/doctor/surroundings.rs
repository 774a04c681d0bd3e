//! What a session runs in and cannot ask for: shown beside what it was granted.

use super::cpu::governor_of;
use super::kernel::{Preemption, release};
use super::probe::Probe;
use core::fmt;

/// Kernel and CPUs of a session.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Surroundings {
    /// Release and preemption.
    pub kernel: String,
    /// Governor of the CPU the loop is pinned to, or of all of them.
    pub governor: String,
    /// CPUs that the scheduler leaves alone, as the kernel lists them; empty if there are none.
    pub isolated: String,
}

impl Surroundings {
    /// Looks at a PC.
    #[must_use]
    pub fn of(probe: &Probe, cpu: Option<usize>) -> Self {
        let preemption = Preemption::of(probe).map_or("preemption unknown", Preemption::name);
        let cpus = cpu.map_or_else(|| probe.online(), |cpu| vec![cpu]);
        let mut governors: Vec<String> = cpus.into_iter().filter_map(|cpu| governor_of(probe, cpu)).collect();
        governors.sort();
        governors.dedup();
        Self {
            kernel: format!("{}, {preemption}", release(probe)),
            governor: if governors.is_empty() { "not known".into() } else { governors.join(", ") },
            isolated: probe.read("/sys/devices/system/cpu/isolated").unwrap_or_default(),
        }
    }
}

impl fmt::Display for Surroundings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let isolated = if self.isolated.is_empty() { "none" } else { &self.isolated };
        write!(
            f,
            "kernel       {}\nCPUs         governor {}; isolated: {isolated}",
            self.kernel, self.governor
        )
    }
}
