//! The runs as a Markdown table and as comma-separated values.

use super::ended::Ended;
use super::fault_kind::FaultKind;
use super::outcome::Run;
use core::fmt::{self, Write};

/// One row: all runs of one fault on one rig.
struct Row<'a> {
    rig: &'static str,
    fault: FaultKind,
    runs: Vec<&'a Run>,
}

impl Row<'_> {
    fn count(&self, is: impl Fn(&Run) -> bool) -> usize {
        self.runs.iter().filter(|run| is(run)).count()
    }

    /// Maximum of some times, ms; a dash without any.
    fn max_ms(&self, of: impl Fn(&Run) -> Option<u64>) -> String {
        let max = self.runs.iter().filter_map(|run| of(run)).max();
        max.map_or_else(|| "-".into(), |us| format!("{:.1}", us as f32 / 1e3))
    }

    fn max(&self, of: impl Fn(&Run) -> f32) -> f32 {
        self.runs.iter().fold(0.0, |max, run| max.max(of(run)))
    }

    /// Largest error of the force after recovery, N; a dash without any.
    fn max_error_after(&self) -> String {
        let max = self.runs.iter().filter_map(|run| run.error_after_n).reduce(f32::max);
        max.map_or_else(|| "-".into(), |newtons| format!("{newtons:.3}"))
    }

    /// The outcomes and their counts.
    fn ends(&self) -> String {
        let mut ends: Vec<(String, usize)> = Vec::new();
        for run in &self.runs {
            let name = match run.ended {
                Ended::Recovered => "recovered".into(),
                Ended::Latched(fault) => fault.name().into(),
                Ended::Lost => "loop ended".into(),
                Ended::Refused => "not opened".into(),
                Ended::Opened => "opened".into(),
                Ended::Guard => "guard".into(),
                Ended::Host => "host".into(),
                Ended::Watchdog => "device's watchdog".into(),
                Ended::TimedOut(what) => what.into(),
            };
            match ends.iter_mut().find(|(known, _)| *known == name) {
                Some((_, count)) => *count += 1,
                None => ends.push((name, 1)),
            }
        }
        ends.sort_by_key(|(_, count)| core::cmp::Reverse(*count));
        let parts: Vec<String> = ends.iter().map(|(name, count)| format!("{name} {count}")).collect();
        parts.join(", ")
    }
}

/// The runs as a Markdown table.
#[derive(Debug)]
pub struct Table<'a>(pub &'a [Run]);

impl fmt::Display for Table<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut rows: Vec<Row<'_>> = Vec::new();
        for run in self.0 {
            match rows.iter_mut().find(|row| row.rig == run.rig && row.fault == run.fault) {
                Some(row) => row.runs.push(run),
                None => rows.push(Row { rig: run.rig, fault: run.fault, runs: vec![run] }),
            }
        }
        rows.sort_by_key(|row| (row.rig, row.fault));
        f.write_str(
            "| device, link | fault | runs | first missing sample, ms | detection, ms | detection to zero, ms | end of fault to zero, ms | \
             largest force, N | above the limit, ms | largest step, N | outcome | force error afterwards, N | resumed without arming |\n\
             |---|---|---|---|---|---|---|---|---|---|---|---|---|\n",
        )?;
        for row in &rows {
            writeln!(
                f,
                "| {} | {} | {} | {} | {} | {} | {} | {:.2} | {} | {:.2} | {} | {} | {} |",
                row.rig,
                row.fault.name(),
                row.runs.len(),
                row.max_ms(|run| run.degraded_us),
                row.max_ms(|run| run.detected_us),
                row.max_ms(|run| run.zero_us.filter(|_| run.request_path_ok)),
                row.max_ms(|run| run.zero_after_fault_us.filter(|_| !run.request_path_ok)),
                row.max(|run| run.largest_n),
                row.max_ms(|run| Some(run.over_limit_us).filter(|us| *us > 0)),
                row.max(|run| run.step_n),
                row.ends(),
                row.max_error_after(),
                row.count(|run| run.resumed),
            )?;
        }
        Ok(())
    }
}

/// The runs one by one, as comma-separated values.
#[must_use]
pub fn csv(runs: &[Run]) -> String {
    let mut text = String::from(
        "rig,fault,seed,ended,degraded_us,detected_us,zero_us,zero_after_fault_us,largest_n,step_n,over_limit_us,resumed,error_before_n,error_after_n,injected_to_device,injected_to_host,steepest_n_per_s,violation\n",
    );
    // Names contain commas.
    let quoted = |text: &str| format!("\"{}\"", text.replace('"', "\"\""));
    let number = |us: Option<u64>| us.map_or_else(String::new, |us| us.to_string());
    let newtons = |force: Option<f32>| force.map_or_else(String::new, |force| force.to_string());
    for run in runs {
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{}",
            run.rig,
            quoted(run.fault.name()),
            run.seed,
            quoted(&format!("{:?}", run.ended)),
            number(run.degraded_us),
            number(run.detected_us),
            number(run.zero_us),
            number(run.zero_after_fault_us),
            run.largest_n,
            run.step_n,
            run.over_limit_us,
            run.resumed,
            newtons(run.error_before_n),
            newtons(run.error_after_n),
            number(run.injected.map(|[to_device, _]| to_device)),
            number(run.injected.map(|[_, to_host]| to_host)),
            run.steepest_n_per_s,
            quoted(run.violation().unwrap_or(""))
        );
    }
    text
}
