//! Checks of the kernel: preemption, timers, throttling, and virtualisation.

use super::Check;
use super::Verdict::{Bad, Better, Good};
use super::probe::Probe;

/// Preemption model of the kernel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Preemption {
    RealTime,
    Full,
    Voluntary,
}

impl Preemption {
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::RealTime => "PREEMPT_RT",
            Self::Full => "PREEMPT, not PREEMPT_RT",
            Self::Voluntary => "neither PREEMPT nor PREEMPT_RT",
        }
    }

    pub(super) fn of(probe: &Probe) -> Option<Self> {
        let version = probe.read("/proc/version");
        if probe.read("/sys/kernel/realtime").as_deref() == Some("1") {
            return Some(Self::RealTime);
        }
        let has = |word: &str| version.as_ref().map(|v| v.split_whitespace().any(|found| found == word));
        Some(match (has("PREEMPT_RT")?, has("PREEMPT")? || has("PREEMPT_DYNAMIC")?) {
            (true, _) => Self::RealTime,
            (_, true) => Self::Full,
            _ => Self::Voluntary,
        })
    }
}

/// The release, `3.2.1-name`, from `/proc/version`.
pub(super) fn release(probe: &Probe) -> String {
    let version = probe.read("/proc/version").unwrap_or_default();
    version.split_whitespace().nth(2).unwrap_or("unknown release").into()
}

pub(super) fn preemption(probe: &Probe) -> Check {
    const NAME: &str = "kernel";
    let Some(preemption) = Preemption::of(probe) else { return Check::unknown(NAME, "/proc/version") };
    let found = format!("{} ({})", preemption.name(), release(probe));
    let architecture = match std::env::consts::ARCH {
        "x86_64" => "amd64",
        "aarch64" => "arm64",
        "arm" => "armmp",
        other => other,
    };
    let install = format!("$ apt install linux-image-rt-{architecture} && reboot");
    let with_fix = |check: Check, why| check.fix([why, &install]);
    match preemption {
        Preemption::RealTime => Check::new(NAME, Good, found),
        Preemption::Full => with_fix(
            Check::new(NAME, Better, found),
            "a real-time kernel limits rare long delays (on Debian):",
        ),
        Preemption::Voluntary => with_fix(
            Check::new(NAME, Bad, found),
            "delays of milliseconds are normal on this kernel; on Debian:",
        ),
    }
}

pub(super) fn virtual_machine(probe: &Probe) -> Check {
    const NAME: &str = "machine";
    let Some(cpuinfo) = probe.read("/proc/cpuinfo") else { return Check::unknown(NAME, "/proc/cpuinfo") };
    let is_guest = cpuinfo.lines().any(|line| {
        (line.starts_with("flags") || line.starts_with("Features"))
            && line.split_whitespace().any(|flag| flag == "hypervisor")
    });
    if is_guest {
        let check = Check::new(NAME, Better, "a virtual machine: its host schedules this kernel");
        return check.fix([
            "run the loop on the bare PC; settings of this system do not limit the delays by the host",
        ]);
    }
    Check::new(NAME, Good, "no hypervisor")
}

pub(super) fn timers(probe: &Probe) -> Check {
    const NAME: &str = "timers";
    const SOURCE: &str = "/sys/devices/system/clocksource/clocksource0/current_clocksource";
    let Some(resolution_ns) = probe.timer_resolution_ns() else {
        return Check::unknown(NAME, "the resolution of the clock");
    };
    let source = probe.read(SOURCE).unwrap_or_else(|| "unknown".into());
    let found = format!("resolution {resolution_ns} ns, clock source {source}");
    if resolution_ns > 1_000 {
        return Check::new(NAME, Bad, found)
            .fix(["timers have the resolution of kernel ticks; boot without highres=off, with CONFIG_HIGH_RES_TIMERS"]);
    }
    match source.as_str() {
        "hpet" | "acpi_pm" | "jiffies" | "refined-jiffies" => Check::new(NAME, Better, found).fix([
            "reading this clock takes microseconds; find out why the kernel rejected the TSC:",
            "$ dmesg | grep -i -e tsc -e clocksource",
        ]),
        _ => Check::new(NAME, Good, found),
    }
}

pub(super) fn throttling(probe: &Probe) -> Check {
    const NAME: &str = "throttling";
    const PATH: &str = "/proc/sys/kernel/sched_rt_runtime_us";
    let Some(runtime_us) = probe.number::<i64>(PATH) else { return Check::unknown(NAME, PATH) };
    let period_us = probe.number::<i64>("/proc/sys/kernel/sched_rt_period_us").unwrap_or(1_000_000).max(1);
    if runtime_us < 0 {
        return Check::new(NAME, Good, "off: a runaway loop occupies its CPU for ever");
    }
    let share = runtime_us as f64 / period_us as f64;
    let found = format!("real-time threads get at most {:.0} % of a CPU", 100.0 * share);
    if share < 0.5 {
        return Check::new(NAME, Bad, found).fix(["$ sysctl -w kernel.sched_rt_runtime_us=950000"]);
    }
    Check::new(NAME, Good, format!("{found}; the loop needs a tenth; the limit is a safeguard"))
}
