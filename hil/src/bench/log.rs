//! The runs of `hil/bench/run` as rows of the fault matrix: a line each of its log, `run` or `host` and then `name=value`.

use super::Strike;
use crate::matrix::{Ended, Run, Wrong};
use core::fmt;
use palpate_core::Fault;

/// Name of the rig in the table.
const RIG: &str = "falcon-qemu";

/// A line that says it is a run and is none that has passed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BadLine(String);

impl fmt::Display for BadLine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "no run that has passed: {}", self.0)
    }
}

impl core::error::Error for BadLine {}

/// All runs with a fault, as the guest judged them. Their times are from the fault to zero; the guest's time is not real.
pub fn runs(log: &str) -> Result<Vec<Run>, BadLine> {
    let lines = log.lines().filter(|line| line.starts_with("run ") || line.starts_with("host "));
    let faulty = lines.filter(|line| !line.contains(" fault=none "));
    faulty.map(|line| run(line).ok_or_else(|| BadLine(line.into()))).collect()
}

fn run(line: &str) -> Option<Run> {
    let words: Vec<&str> = line.split(' ').collect();
    let value = |name: &str| words.iter().find_map(|word| word.strip_prefix(name)?.strip_prefix('='));
    let wrong = wrong(value("fault")?)?;
    let seed = value("seed").map_or(Some(0), |seed| seed.parse().ok())?;
    let mut run = Run::with_nothing(RIG, wrong, seed, f32::INFINITY);
    run.ended = match value("end")? {
        "active" => Ended::RodeOn,
        "supervisor" => Ended::Supervisor,
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

fn wrong(name: &str) -> Option<Wrong> {
    let struck = |strike| match strike {
        Strike::WrongEcho => Wrong::WrongEcho,
        Strike::DropRequest | Strike::DropReply => Wrong::Drop,
        Strike::UnplugMidFrame => Wrong::UnplugMidFrame,
        Strike::Replug => Wrong::Replug,
        Strike::UnplugPower => Wrong::UnplugPower,
        Strike::PowerCycle => Wrong::PowerCycle,
        Strike::StallIn | Strike::StallOut => Wrong::TransferStall,
        Strike::Silence => Wrong::Silence,
        Strike::Babble => Wrong::Babble,
        Strike::Stall => Wrong::Stall,
        Strike::Delay => Wrong::Delay,
        Strike::Duplicate => Wrong::Duplicate,
        Strike::Truncate => Wrong::Truncate,
        Strike::Reorder => Wrong::Reorder,
        Strike::CorruptReply => Wrong::CorruptReply,
        Strike::Noise => Wrong::Noise,
        Strike::Homing => Wrong::HomingLost,
        Strike::EncoderJump => Wrong::EncoderJump,
    };
    match name {
        "host-killed" => Some(Wrong::HostKilled),
        "host-paused" => Some(Wrong::HostPaused),
        name => Strike::ALL.into_iter().find(|strike| strike.name() == name).map(struck),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LOG: &str = "--- 11 seeds\n\
        run seed=0 fault=none end=active largest_n=1.71 step_n=0.20 zero_ms=- PASS\n\
        run seed=8 fault=silence end=latched:stale struck=11 largest_n=0.91 step_n=0.25 zero_ms=48 PASS\n\
        host fault=host-killed end=supervisor largest_n=1.50 step_n=0.00 zero_ms=21.5 PASS\n\
        summary PASS runs=2\n";

    #[test]
    fn runs_with_a_fault_become_rows() {
        let runs = runs(LOG).expect("both have passed");
        assert_eq!(runs.len(), 2);
        assert_eq!((runs[0].wrong, runs[0].seed), (Wrong::Silence, 8));
        assert_eq!((runs[0].ended, runs[0].zero_us), (Ended::Latched(Fault::Stale), Some(48_000)));
        assert_eq!((runs[0].largest_n, runs[0].step_n), (0.91, 0.25));
        assert_eq!((runs[1].wrong, runs[1].zero_us), (Wrong::HostKilled, Some(21_500)));
    }

    #[test]
    fn what_failed_is_no_row_and_is_not_passed_over() {
        for line in
            ["run seed=3 FAIL nothing was felt", "host fault=host-paused FAIL no zero", "run seed=1 fault=x"]
        {
            assert_eq!(runs(line), Err(BadLine(line.into())));
        }
    }
    /// Whoever looks for a fault of the issue finds it by its name.
    #[test]
    fn each_fault_has_a_row() {
        let names = |strikes: &[Strike]| -> Vec<&str> {
            strikes.iter().map(|strike| wrong(strike.name()).expect("a fault of the bench").name()).collect()
        };
        let all = names(&Strike::ALL);
        for name in [
            "drop",
            "silence",
            "delay",
            "duplicate",
            "truncate",
            "corrupt reply",
            "reorder",
            "babble",
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
