//! `palpate doctor`: checks this PC for 1 kHz operation and prints how to fix what it finds.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args as ClapArgs;
use palpate_host::doctor::{
    Check, Measurement, Probe, SystemInfo, Verdict, examine, loop_cpu, makers, measure,
};
use palpate_host::guard::{DEFAULT_LIMIT_MS, GuardOptions};
use palpate_host::rt::LatencyReport;
use palpate_host::sys::Policy;
use serde_json::json;

use crate::failure::Failure;
use crate::files::{FileKind, Files, Replace};
use crate::interrupt::stop_flag;
use crate::summary::percentiles;
use crate::timing::Timing;
use crate::{hardware, output};

/// Check this PC for 1 kHz operation and print the fixes.
///
/// Checks kernel, rights, CPUs and ports in order of importance, starts a guard without a device, and
/// measures the wake-up lateness with the rights of this user. It changes nothing. Exit code 1 only if 1 kHz
/// is not possible: a measured p99 of the lateness above 1 ms.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// Seconds to measure; 0 does not measure
    #[arg(long, value_name = "S", default_value_t = 2.0)]
    seconds: f64,
    /// Only measure, for this many seconds
    #[arg(long, value_name = "S", conflicts_with = "seconds")]
    measure: Option<f64>,
    /// Write the histogram of the measurement to this file
    #[arg(long, value_name = "FILE.csv")]
    histograms: Option<PathBuf>,
    /// Print every check and setting, also those that are ok
    #[arg(long)]
    verbose: bool,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    timing: Timing,
    #[command(flatten)]
    replace: Replace,
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let seconds = args.measure.unwrap_or(args.seconds);
    if !(0.0..=1e6).contains(&seconds) {
        return Err(Failure::input(format!("{seconds}: give the seconds to measure, 0 to 1e6")));
    }
    let mut files = Files::new(args.replace);
    let histograms = args.histograms.as_ref().map(|path| files.write("--histograms", path, FileKind::Table));
    let histograms = histograms.transpose()?;
    let probe = Probe::system();
    let cpu = loop_cpu(&probe, args.timing.cpu);
    let request = args.timing.request();
    let priority = request.fifo_priority.unwrap_or(palpate_host::sys::DEFAULT_FIFO_PRIORITY);
    // Checked first, so that the load is that before the measurement.
    let mut checks = if args.measure.is_none() { examine(&probe, cpu, priority) } else { Vec::new() };
    if args.measure.is_none() {
        let fifo_priority = hardware::above(request.fifo_priority);
        let options =
            GuardOptions { limit_ms: DEFAULT_LIMIT_MS, fifo_priority, locks_memory: request.lock_memory };
        checks.push(guard(hardware::try_guard(options), fifo_priority));
        checks.extend(makers(&probe));
    }
    let measured = if seconds > 0.0 {
        let stop = stop_flag()?;
        let measured = measure(seconds, args.timing.haptic(None), request, &stop);
        Some(measured.map_err(|error| Failure::work(format!("cannot start the measuring thread: {error}")))?)
    } else {
        None
    };
    let surroundings = SystemInfo::of(&probe, args.timing.cpu);
    if args.json {
        let figures = json!({
            "cpu": cpu, "kernel": surroundings.kernel, "governor": surroundings.governor,
            "isolated": surroundings.isolated, "checks": checks, "measured": measured.as_ref().map(figures),
        });
        output::line(format!("{figures:#}"))?;
    } else {
        let what = Printed { checks: &checks, measured: measured.as_ref(), surroundings: &surroundings };
        what.print(cpu, args.verbose)?;
    }
    if let (Some(file), Some(measured)) = (&histograms, &measured) {
        output::histograms(file, &measured.latency)?;
        if !args.json {
            output::line(format!("histogram    {}", file.path().display()))?;
        }
    }
    match measured {
        Some(measured) if measured.verdict() == Verdict::Bad => Err(Failure::work(format!(
            "1 kHz is not possible: one wake-up in a hundred is at least {:.1} ms late",
            measured.latency.wake.p99_ns as f64 * 1e-6
        ))),
        _ => Ok(()),
    }
}

/// Whether a guard can zero the device of a session.
fn guard(started: std::io::Result<(Duration, Policy)>, fifo_priority: Option<i32>) -> Check {
    let check = |verdict, found, fix: &[&str]| Check {
        name: "guard",
        verdict,
        found,
        fix: fix.iter().map(ToString::to_string).collect(),
    };
    let (started, policy) = match started {
        Ok(started) => started,
        Err(error) => {
            let fix = [
                "without it no real device is driven, because a killed session would leave the last force on:",
                "run palpate from a file that this user may read and execute, and permit one more process (ulimit -u)",
            ];
            return check(Verdict::Bad, error.to_string(), &fix);
        }
    };
    let found = format!(
        "starts within {} ms with {policy}; zeroes a real device {DEFAULT_LIMIT_MS} ms after the last tick",
        started.as_millis()
    );
    match (policy, fifo_priority) {
        (Policy::Other, Some(_)) => {
            check(Verdict::Better, found, &["its latency depends on the load of this PC: see `priority`"])
        }
        _ => check(Verdict::Good, found, &[]),
    }
}

/// What the command prints.
struct Printed<'a> {
    checks: &'a [Check],
    measured: Option<&'a Measurement>,
    surroundings: &'a SystemInfo,
}

impl Printed<'_> {
    /// The verdict, then the checks with a fix; with `verbose` every check and setting.
    fn print(&self, cpu: usize, verbose: bool) -> Result<(), Failure> {
        output::line(self.headline())?;
        let (good, rest): (Vec<&Check>, Vec<&Check>) =
            self.checks.iter().partition(|check| check.verdict == Verdict::Good && !verbose);
        if !rest.is_empty() {
            output::line(format!("\n{:<9} {:<13} found; fix, for a loop on CPU {cpu}", "", "what"))?;
        }
        for check in rest {
            output::line(check)?;
        }
        if !good.is_empty() {
            let names: Vec<&str> = good.iter().map(|check| check.name).collect();
            output::line(format!("{:<9} {}", Verdict::Good.name(), names.join(", ")))?;
        }
        let Some(measured) = self.measured else { return Ok(()) };
        let LatencyReport { wake, overruns, skipped_periods, .. } = &measured.latency;
        if verbose {
            output::line(format!(
                "\n{}\n{}\nperiod       {} us, the last {} us of it spun",
                measured.real_time, self.surroundings, measured.config.period_us, measured.config.spin_us
            ))?;
        }
        output::line(format!(
            "\nwake-up late {wake}\nmissed       {skipped_periods} deadlines in {overruns} overruns"
        ))
    }

    /// Verdict of the measurement and number of checks by verdict.
    fn headline(&self) -> String {
        let count = |verdict| self.checks.iter().filter(|check| check.verdict == verdict).count();
        let measured = self.measured.map(|measured| {
            let LatencyReport { wake, skipped_periods, .. } = &measured.latency;
            let periods = (wake.count + skipped_periods) as f64;
            let seconds = periods * f64::from(measured.config.period_us) * 1e-6;
            format!("measured for {seconds:.1} s: {}", measured.verdict().name())
        });
        let checks = (!self.checks.is_empty()).then(|| {
            let [good, better, bad, unknown] =
                [Verdict::Good, Verdict::Better, Verdict::Bad, Verdict::Unknown].map(count);
            format!(
                "{} checks: {good} ok, {better} could be better, {bad} bad, {unknown} unknown (docs/guide.md, section 11)",
                self.checks.len()
            )
        });
        measured.into_iter().chain(checks).collect::<Vec<_>>().join("; ")
    }
}

fn figures(measured: &Measurement) -> serde_json::Value {
    let Measurement { config, real_time, latency } = measured;
    json!({
        "verdict": measured.verdict(), "period_us": config.period_us, "spin_us": config.spin_us,
        "scheduler": real_time.scheduler.to_string(), "policy": real_time.policy.to_string(),
        "memory_lock": real_time.memory.to_string(), "cpu_pinning": real_time.affinity.to_string(),
        "cpus_awake": real_time.awake.to_string(), "lateness_ns": percentiles(&latency.wake),
        "missed_deadlines": latency.skipped_periods, "overruns": latency.overruns,
        "worst": latency.worst.iter().map(|miss| json!({ "tick": miss.tick, "late_ns": miss.late_ns })).collect::<Vec<_>>(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_guard_that_does_not_start_is_bad_and_says_what_is_at_stake() {
        let bad = guard(Err(std::io::ErrorKind::UnexpectedEof.into()), Some(51));
        assert_eq!((bad.name, bad.verdict), ("guard", Verdict::Bad));
        assert!(bad.fix[0].contains("last force"), "{bad}");
        let started = |policy| Ok((Duration::from_millis(7), policy));
        assert_eq!(guard(started(Policy::Other), Some(51)).verdict, Verdict::Better);
        let plain = guard(started(Policy::Other), None);
        assert_eq!(plain.verdict, Verdict::Good, "nothing more was requested");
        assert!(plain.found.contains("within 7 ms") && plain.found.contains("SCHED_OTHER"), "{plain}");
    }
}
