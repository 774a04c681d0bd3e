//! `palpate doctor`: what of this PC stands in the way of 1 kHz, and how to mend it.
//!
//! Looks only; changes nothing. Every check is a function of a [`Probe`], so that tests ask about PCs that are made up. What counts in the
//! end is the [measurement](measure()): the pace of the loop itself, with what this user is granted.

mod cpu;
mod kernel;
mod measure;
mod ports;
mod probe;
mod rights;
mod surroundings;
#[cfg(all(test, unix))]
mod tests;

pub use measure::{Measurement, measure};
pub use probe::Probe;
pub use surroundings::Surroundings;

use core::fmt;
use serde::Serialize;

/// What a check came to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Nothing to do.
    #[serde(rename = "ok")]
    Good,
    /// The loop runs, but would run better.
    Better,
    /// In the way of 1 kHz, or of the device.
    Bad,
    /// Nothing to read it from.
    Unknown,
}

impl Verdict {
    /// As it is shown.
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

/// One thing that was looked at.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Check {
    /// Short name.
    pub name: &'static str,
    /// What it came to.
    pub verdict: Verdict,
    /// What was found.
    pub found: String,
    /// How to mend it, line by line. A line that starts with `$ ` is a command (as root, unless it says otherwise), one with `+ ` a
    /// line for a file.
    pub mend: Vec<String>,
}

impl Check {
    fn new(name: &'static str, verdict: Verdict, found: impl Into<String>) -> Self {
        Self { name, verdict, found: found.into(), mend: Vec::new() }
    }

    fn unknown(name: &'static str, path: &str) -> Self {
        Self::new(name, Verdict::Unknown, format!("{path} cannot be read"))
    }

    fn mend<const N: usize>(mut self, lines: [&str; N]) -> Self {
        self.mend.extend(lines.map(str::to_string));
        self
    }
}

/// Width of the table, characters.
const WIDTH: usize = 100;
/// Where the findings begin.
const INDENT: usize = 24;

impl fmt::Display for Check {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut lines = wrapped(&self.found).into_iter();
        let first = lines.next().unwrap_or_default();
        write!(f, "{:<9} {:<13} {first}", self.verdict.name(), self.name)?;
        for line in lines {
            write!(f, "\n{:INDENT$}{line}", "")?;
        }
        for line in &self.mend {
            if line.starts_with("$ ") || line.starts_with("+ ") {
                write!(f, "\n{:INDENT$}{line}", "")?;
                continue;
            }
            for (index, line) in wrapped(line).into_iter().enumerate() {
                let mark = if index == 0 { "->" } else { "" };
                write!(f, "\n{mark:>width$} {line}", width = INDENT - 1)?;
            }
        }
        Ok(())
    }
}

/// Lines that fit right of the indent.
fn wrapped(text: &str) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        let last = lines.last_mut().expect("never empty");
        if !last.is_empty() && last.chars().count() + 1 + word.chars().count() > WIDTH - INDENT {
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

/// The CPU the advice is for: the one asked for, an isolated one, or else the last one, where the kernel puts the least.
#[must_use]
pub fn loop_cpu(probe: &Probe, asked: Option<usize>) -> usize {
    let isolated = probe::cpus(&probe.read("/sys/devices/system/cpu/isolated").unwrap_or_default());
    let allowed = probe.value("/proc/self/status", "Cpus_allowed_list");
    let allowed = allowed.map_or_else(|| probe.online(), |list| probe::cpus(&list));
    let online = probe.online();
    let usable = || allowed.iter().filter(|cpu| online.is_empty() || online.contains(cpu));
    asked.or_else(|| isolated.first().copied()).or_else(|| usable().next_back().copied()).unwrap_or(0)
}

/// Every check, in order of importance, for a loop on `cpu` with this priority.
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
    checks.extend(ports::usb(probe));
    checks.extend(ports::serial(probe));
    checks
}
