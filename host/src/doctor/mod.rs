//! `palpate doctor`: checks this PC for 1 kHz operation and says how to fix what is missing.
//!
//! It only reads; it changes nothing. Every check is a function of a [`Probe`], so tests can use simulated
//! PCs. The decisive result is the [measurement](measure()): the schedule of the loop itself, with the rights
//! of this user.

mod cpu;
mod kernel;
mod makers;
mod measure;
mod ports;
mod probe;
mod rights;
mod system_info;
#[cfg(all(test, unix))]
mod tests;

pub use makers::makers;
pub use measure::{Measurement, measure};
pub use probe::Probe;
pub use system_info::SystemInfo;

use core::fmt;
use serde::Serialize;

/// Result of a check.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Nothing to fix.
    #[serde(rename = "ok")]
    Good,
    /// The loop runs, but this setting makes it less reliable.
    Better,
    /// Prevents 1 kHz operation, or the use of the device.
    Bad,
    /// The source cannot be read.
    Unknown,
}

impl Verdict {
    /// The displayed name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Good => "ok",
            Self::Better => "better",
            Self::Bad => "bad",
            Self::Unknown => "unknown",
        }
    }
}

/// One check.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Check {
    /// Short name.
    pub name: &'static str,
    /// Its result.
    pub verdict: Verdict,
    /// The finding.
    pub found: String,
    /// The fix, line by line. A line that starts with `$ ` is a command (as root, unless stated otherwise), a
    /// line with `+ ` belongs into a file.
    pub fix: Vec<String>,
}

impl Check {
    fn new(name: &'static str, verdict: Verdict, found: impl Into<String>) -> Self {
        Self { name, verdict, found: found.into(), fix: Vec::new() }
    }

    fn unknown(name: &'static str, path: &str) -> Self {
        Self::new(name, Verdict::Unknown, format!("{path} cannot be read"))
    }

    fn fix<const N: usize>(mut self, lines: [&str; N]) -> Self {
        self.fix.extend(lines.map(str::to_string));
        self
    }
}

/// Width of the table, characters.
const WIDTH: usize = 100;
/// Column of the findings.
const INDENT: usize = 24;

impl fmt::Display for Check {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut lines = wrapped(&self.found, WIDTH - INDENT).into_iter();
        let first = lines.next().unwrap_or_default();
        write!(f, "{:<9} {:<13} {first}", self.verdict.name(), self.name)?;
        for line in lines {
            write!(f, "\n{:INDENT$}{line}", "")?;
        }
        for line in &self.fix {
            if line.starts_with("$ ") || line.starts_with("+ ") {
                write!(f, "\n{:INDENT$}{line}", "")?;
                continue;
            }
            for (index, line) in wrapped(line, WIDTH - INDENT).into_iter().enumerate() {
                let mark = if index == 0 { "->" } else { "" };
                write!(f, "\n{mark:>width$} {line}", width = INDENT - 1)?;
            }
        }
        Ok(())
    }
}

/// Breaks text into lines of at most `width` characters.
#[must_use]
pub fn wrapped(text: &str, width: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        let last = lines.last_mut().expect("never empty");
        if !last.is_empty() && last.chars().count() + 1 + word.chars().count() > width {
            lines.push(word.into());
            continue;
        }
        if !last.is_empty() {
            last.push(' ');
        }
        last.push_str(word);
    }
    lines
}

/// The CPU for the advice: the requested one, else an isolated one, else the last allowed one, which the
/// kernel loads least.
#[must_use]
pub fn loop_cpu(probe: &Probe, requested: Option<usize>) -> usize {
    let isolated = probe::cpus(&probe.read("/sys/devices/system/cpu/isolated").unwrap_or_default());
    let allowed = probe.value("/proc/self/status", "Cpus_allowed_list");
    let allowed = allowed.map_or_else(|| probe.online(), |list| probe::cpus(&list));
    let online = probe.online();
    let usable = || allowed.iter().filter(|cpu| online.is_empty() || online.contains(cpu));
    requested.or_else(|| isolated.first().copied()).or_else(|| usable().next_back().copied()).unwrap_or(0)
}

/// All checks in order of importance, for a loop on `cpu` with this priority.
#[must_use]
pub fn examine(probe: &Probe, cpu: usize, fifo_priority: i32) -> Vec<Check> {
    let mut checks = vec![
        kernel::preemption(probe),
        rights::priority(probe, fifo_priority),
        rights::memory(probe),
        kernel::virtual_machine(probe),
        cpu::governor(probe, cpu),
        cpu::idle(probe, cpu),
        cpu::isolation(probe, cpu),
        cpu::interrupts(probe, cpu),
        cpu::siblings(probe, cpu),
        kernel::timers(probe),
        kernel::throttling(probe),
        rights::swap(probe),
        cpu::load(probe),
    ];
    checks.push(ports::group(probe));
    checks.extend(ports::usb(probe));
    checks.extend(ports::serial(probe));
    checks
}
