//! The runs as a Markdown table and as comma-separated values.

use super::outcome::Run;
use crate::fault::FaultKind;
use core::fmt;

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
        let mut ends: Vec<(&str, usize)> = Vec::new();
        for run in &self.runs {
            let name = run.ended.name();
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
                row.fault,
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

/// The columns of a run and their values.
fn columns(run: &Run) -> [(&'static str, String); 18] {
    let number = |us: Option<u64>| us.map_or_else(String::new, |us| us.to_string());
    let newtons = |force: Option<f32>| force.map_or_else(String::new, |force| force.to_string());
    [
        ("rig", run.rig.into()),
        ("fault", run.fault.to_string()),
        ("seed", run.seed.to_string()),
        ("ended", format!("{:?}", run.ended)),
        ("degraded_us", number(run.degraded_us)),
        ("detected_us", number(run.detected_us)),
        ("zero_us", number(run.zero_us)),
        ("zero_after_fault_us", number(run.zero_after_fault_us)),
        ("largest_n", run.largest_n.to_string()),
        ("step_n", run.step_n.to_string()),
        ("over_limit_us", run.over_limit_us.to_string()),
        ("resumed", run.resumed.to_string()),
        ("error_before_n", newtons(run.error_before_n)),
        ("error_after_n", newtons(run.error_after_n)),
        ("injected_to_device", number(run.injected.map(|[to_device, _]| to_device))),
        ("injected_to_host", number(run.injected.map(|[_, to_host]| to_host))),
        ("steepest_n_per_s", run.steepest_n_per_s.to_string()),
        ("violation", run.violation().unwrap_or("").into()),
    ]
}

/// The runs one by one, as comma-separated values.
///
/// # Panics
///
/// Never: memory takes every record, and all have the same length.
#[must_use]
pub fn csv(runs: &[Run]) -> String {
    let mut writer = csv::Writer::from_writer(Vec::new());
    for (index, run) in runs.iter().enumerate() {
        let columns = columns(run);
        if index == 0 {
            writer.write_record(columns.each_ref().map(|(name, _)| *name)).expect("memory");
        }
        writer.write_record(columns.map(|(_, value)| value)).expect("memory");
    }
    String::from_utf8(writer.into_inner().expect("memory")).expect("text")
}
