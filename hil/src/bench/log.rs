//! The log of `hil/bench/run`: a run that has passed is one line, `run PASS` or `host PASS` and a [`BenchRun`] in
//! JSON.

use crate::fault::FaultKind;
use crate::matrix::{Ended, Run};
use core::fmt;
use serde::{Deserialize, Serialize};

/// Name of the rig in the table.
const RIG: &str = "falcon-qemu";

/// One run as the guest judged it. The guest's clock is not real time.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct BenchRun {
    /// Seed of the run.
    pub seed: u64,
    /// The injected fault; `None` in a run without.
    pub fault: Option<FaultKind>,
    /// How it ended.
    pub ended: Ended,
    /// Exchanges with and without a sample. A run without a fault counts only those in touch.
    pub exchanges: u64,
    /// Exchanges of a homed device without a sample in time.
    pub lost: u64,
    /// Exchanges without a sample while the device was disarmed and closed. A zero command is sent at once
    /// and may cost the reply to an earlier request.
    pub lost_closing: u64,
    /// Mean time of an exchange, us.
    pub mean_us: u64,
    /// Longest time of an exchange, us.
    pub longest_us: u64,
    /// How often the fault was injected.
    pub injected: u64,
    /// Force at the first touch, N.
    pub touch_n: f32,
    /// Largest force, N.
    pub largest_n: f32,
    /// Largest change of the force by one non-zero command, N.
    pub step_n: f32,
    /// Largest force while not homed, N.
    pub unhomed_n: f32,
    /// Ticks from the first one without a sample to a zero command.
    pub zero_ticks: u64,
    /// Time from the fault to zero force, ms.
    pub zero_ms: Option<f32>,
    /// Force at the touch after the fault, N.
    pub again_n: f32,
    /// Time from plugging in to an open driver, ms.
    pub ready_ms: u64,
    /// Firmware loads.
    pub loads: u32,
    /// Duration of the run, s.
    pub seconds: f32,
}

impl BenchRun {
    /// Exchanges per second.
    #[must_use]
    pub fn rate_hz(&self) -> f64 {
        1e6 / self.mean_us.max(1) as f64
    }

    /// The row of the fault matrix; `None` without a fault.
    fn row(&self) -> Option<Run> {
        let mut run = Run::empty(RIG, self.fault?, self.seed, f32::INFINITY);
        run.ended = self.ended;
        run.zero_us = self.zero_ms.map(|ms| (1e3 * ms) as u64);
        (run.largest_n, run.step_n) = (self.largest_n, self.step_n);
        Some(run)
    }
}

/// A run line that cannot be parsed or that failed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BadLine(String);

impl fmt::Display for BadLine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "not a passed run: {}", self.0)
    }
}

impl core::error::Error for BadLine {}

/// All runs with an injected fault, as rows of the fault matrix.
pub fn runs(log: &str) -> Result<Vec<Run>, BadLine> {
    let lines = log.lines().filter(|line| line.starts_with("run ") || line.starts_with("host "));
    let parsed = lines.map(|line| {
        let json = line.strip_prefix("run PASS ").or(line.strip_prefix("host PASS "));
        json.and_then(|json| serde_json::from_str::<BenchRun>(json).ok()).ok_or_else(|| BadLine(line.into()))
    });
    parsed.filter_map(|run| run.map(|run| run.row()).transpose()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate_core::Fault;

    #[test]
    fn runs_with_a_fault_become_rows() {
        let (clean, silent) = (
            BenchRun::default(),
            BenchRun {
                seed: 8,
                fault: Some(FaultKind::Silence),
                ended: Ended::Latched(Fault::Stale),
                largest_n: 0.91,
                step_n: 0.25,
                zero_ms: Some(48.0),
                ..BenchRun::default()
            },
        );
        let json = |run: &BenchRun| serde_json::to_string(run).expect("plain data");
        let log = format!(
            "--- 11 seeds\nrun PASS {}\nrun PASS {}\nhost PASS {}\nsummary PASS runs=2\n",
            json(&clean),
            json(&silent),
            r#"{"fault":"host-killed","ended":"guard","zero_ms":21.5}"#
        );
        let runs = runs(&log).expect("both have passed");
        assert_eq!(runs.len(), 2);
        assert_eq!((runs[0].fault, runs[0].seed), (FaultKind::Silence, 8));
        assert_eq!((runs[0].ended, runs[0].zero_us), (Ended::Latched(Fault::Stale), Some(48_000)));
        assert_eq!((runs[0].largest_n, runs[0].step_n), (0.91, 0.25));
        assert_eq!((runs[1].fault, runs[1].zero_us), (FaultKind::HostKilled, Some(21_500)));
    }

    #[test]
    fn failed_and_malformed_runs_are_errors() {
        for line in
            ["run FAIL seed=3 nothing was felt", "host FAIL host-paused no zero", "run PASS {\"fault\":1}"]
        {
            assert_eq!(runs(line), Err(BadLine(line.into())));
        }
    }
}
