//! Parses the log of `hil/bench/run` into rows of the fault matrix. A row is one line: `run` or `host`, then
//! `name=value` pairs.

use super::BenchFault;
use crate::matrix::{Ended, FaultKind, Run};
use core::fmt;
use palpate_core::Fault;

/// Name of the rig in the table.
const RIG: &str = "falcon-qemu";

/// A run line that cannot be parsed or that failed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BadLine(String);

impl fmt::Display for BadLine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "not a passed run: {}", self.0)
    }
}

impl core::error::Error for BadLine {}

/// All runs with an injected fault, as the guest judged them. Their times are from the fault to zero force.
/// The guest's clock is not real time.
pub fn runs(log: &str) -> Result<Vec<Run>, BadLine> {
    let lines = log.lines().filter(|line| line.starts_with("run ") || line.starts_with("host "));
    let faulty = lines.filter(|line| !line.contains(" fault=none "));
    faulty.map(|line| run(line).ok_or_else(|| BadLine(line.into()))).collect()
}

fn run(line: &str) -> Option<Run> {
    let words: Vec<&str> = line.split(' ').collect();
    let value = |name: &str| words.iter().find_map(|word| word.strip_prefix(name)?.strip_prefix('='));
    let fault = fault_kind(value("fault")?)?;
    let seed = value("seed").map_or(Some(0), |seed| seed.parse().ok())?;
    let mut run = Run::empty(RIG, fault, seed, f32::INFINITY);
    run.ended = match value("end")? {
        "active" => Ended::Recovered,
        "guard" => Ended::Guard,
        "host" => Ended::Host,
        "latched:stale" => Ended::Latched(Fault::Stale),
        "latched:not-ready" => Ended::Latched(Fault::NotReady),
        end if end.starts_with("lost:") => Ended::Lost,
        _ => return None,
    };
    let zero_ms = value("zero_ms").filter(|ms| *ms != "-");
    run.zero_us = zero_ms.map(|ms| ms.parse().map(|ms: f32| (1e3 * ms) as u64)).transpose().ok()?;
    run.largest_n = value("largest_n")?.parse().ok()?;
    run.step_n = value("step_n")?.parse().ok()?;
    (words.last() == Some(&"PASS")).then_some(run)
}

fn fault_kind(name: &str) -> Option<FaultKind> {
    let kind_of = |fault| match fault {
        BenchFault::WrongEcho => FaultKind::WrongEcho,
        BenchFault::DropRequest | BenchFault::DropReply => FaultKind::Drop,
        BenchFault::UnplugMidFrame => FaultKind::UnplugMidFrame,
        BenchFault::Replug => FaultKind::Replug,
        BenchFault::UnplugPower => FaultKind::UnplugPower,
        BenchFault::PowerCycle => FaultKind::PowerCycle,
        BenchFault::StallIn | BenchFault::StallOut => FaultKind::TransferStall,
        BenchFault::Silence => FaultKind::Silence,
        BenchFault::Noise => FaultKind::Noise,
        BenchFault::Stall => FaultKind::Stall,
        BenchFault::Delay => FaultKind::Delay,
        BenchFault::Duplicate => FaultKind::Duplicate,
        BenchFault::Truncate => FaultKind::Truncate,
        BenchFault::Reorder => FaultKind::Reorder,
        BenchFault::CorruptReply => FaultKind::CorruptReply,
        BenchFault::RandomMix => FaultKind::RandomMix,
        BenchFault::HomingLost => FaultKind::HomingLost,
        BenchFault::EncoderJump => FaultKind::EncoderJump,
    };
    match name {
        "host-killed" => Some(FaultKind::HostKilled),
        "host-paused" => Some(FaultKind::HostPaused),
        "guard-killed" => Some(FaultKind::GuardKilled),
        "guard-paused" => Some(FaultKind::GuardPaused),
        name => BenchFault::ALL.into_iter().find(|fault| fault.name() == name).map(kind_of),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LOG: &str = "--- 11 seeds\n\
        run seed=0 fault=none end=active largest_n=1.71 step_n=0.20 zero_ms=- PASS\n\
        run seed=8 fault=silence end=latched:stale injected=11 largest_n=0.91 step_n=0.25 zero_ms=48 PASS\n\
        host fault=host-killed end=guard largest_n=1.50 step_n=0.00 zero_ms=21.5 PASS\n\
        summary PASS runs=2\n";

    #[test]
    fn runs_with_a_fault_become_rows() {
        let runs = runs(LOG).expect("both have passed");
        assert_eq!(runs.len(), 2);
        assert_eq!((runs[0].fault, runs[0].seed), (FaultKind::Silence, 8));
        assert_eq!((runs[0].ended, runs[0].zero_us), (Ended::Latched(Fault::Stale), Some(48_000)));
        assert_eq!((runs[0].largest_n, runs[0].step_n), (0.91, 0.25));
        assert_eq!((runs[1].fault, runs[1].zero_us), (FaultKind::HostKilled, Some(21_500)));
    }

    #[test]
    fn failed_and_malformed_runs_are_errors() {
        for line in
            ["run seed=3 FAIL nothing was felt", "host fault=host-paused FAIL no zero", "run seed=1 fault=x"]
        {
            assert_eq!(runs(line), Err(BadLine(line.into())));
        }
    }
    /// Each fault of the requirements has a row of its own name.
    #[test]
    fn each_fault_has_a_row() {
        let names = |faults: &[BenchFault]| -> Vec<&str> {
            faults
                .iter()
                .map(|fault| fault_kind(fault.name()).expect("a fault of the bench").name())
                .collect()
        };
        let all = names(&BenchFault::ALL);
        for name in [
            "drop",
            "silence",
            "delay",
            "duplicate",
            "truncate",
            "corrupt reply",
            "reorder",
            "noise",
            "transfer stalled",
            "unplug mid-frame",
            "unplug, replug",
            "power cycle",
            "wrong firmware echo",
            "encoder jump",
            "homing lost",
        ] {
            assert!(all.contains(&name), "{name}");
        }
    }
}
