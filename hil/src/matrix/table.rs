//! The runs as tables, for people and for machines.

use super::{Ended, Run, Wrong};
use core::fmt::{self, Write};

/// One line of the table: all runs of one fault on one rig.
struct Row<'a> {
    rig: &'static str,
    wrong: Wrong,
    runs: Vec<&'a Run>,
}

impl Row<'_> {
    fn count(&self, is: impl Fn(&Run) -> bool) -> usize {
        self.runs.iter().filter(|run| is(run)).count()
    }

    /// The largest of some times, ms; a dash if there is none.
    fn most_ms(&self, of: impl Fn(&Run) -> Option<u64>) -> String {
        let most = self.runs.iter().filter_map(|run| of(run)).max();
        most.map_or_else(|| "-".into(), |us| format!("{:.1}", us as f32 / 1e3))
    }

    fn most(&self, of: impl Fn(&Run) -> f32) -> f32 {
        self.runs.iter().fold(0.0, |most, run| most.max(of(run)))
    }

    /// Furthest from the organ's force after it was ridden out, N; a dash if none was.
    fn most_after(&self) -> String {
        let most = self.runs.iter().filter_map(|run| run.after_n).reduce(f32::max);
        most.map_or_else(|| "-".into(), |newtons| format!("{newtons:.3}"))
    }

    /// How they ended, and how often.
    fn ends(&self) -> String {
        let mut ends: Vec<(String, usize)> = Vec::new();
        for run in &self.runs {
            let name = match run.ended {
                Ended::RodeOn => "rode on".into(),
                Ended::Latched(fault) => fault.name().into(),
                Ended::Lost => "loop ended".into(),
                Ended::Refused => "not opened".into(),
                Ended::Opened => "opened".into(),
                Ended::Supervisor => "supervisor".into(),
                Ended::Watchdog => "device's watchdog".into(),
                Ended::Missed(what) => what.into(),
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

/// The runs as a table for people; Markdown.
#[derive(Debug)]
pub struct Table<'a>(pub &'a [Run]);

impl fmt::Display for Table<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut rows: Vec<Row<'_>> = Vec::new();
        for run in self.0 {
            match rows.iter_mut().find(|row| row.rig == run.rig && row.wrong == run.wrong) {
                Some(row) => row.runs.push(run),
                None => rows.push(Row { rig: run.rig, wrong: run.wrong, runs: vec![run] }),
            }
        }
        rows.sort_by_key(|row| (row.rig, row.wrong));
        f.write_str(
            "| device, link | fault | runs | no sample after, ms | detected after, ms | then zero after, ms | zero after the link is back, ms | \
             largest force, N | beyond the limit for, ms | largest step, N | ended | off the organ's force afterwards, N | again without arming |\n\
             |---|---|---|---|---|---|---|---|---|---|---|---|---|\n",
        )?;
        for row in &rows {
            writeln!(
                f,
                "| {} | {} | {} | {} | {} | {} | {} | {:.2} | {} | {:.2} | {} | {} | {} |",
                row.rig,
                row.wrong.name(),
                row.runs.len(),
                row.most_ms(|run| run.degraded_us),
                row.most_ms(|run| run.detected_us),
                row.most_ms(|run| run.zero_us.filter(|_| run.way_is_sound)),
                row.most_ms(|run| run.mended_us.filter(|_| !run.way_is_sound)),
                row.most(|run| run.largest_n),
                row.most_ms(|run| Some(run.beyond_us).filter(|us| *us > 0)),
                row.most(|run| run.step_n),
                row.ends(),
                row.most_after(),
                row.count(|run| run.resumed),
            )?;
        }
        Ok(())
    }
}

/// The runs one by one, for a machine: comma-separated values.
#[must_use]
pub fn csv(runs: &[Run]) -> String {
    let mut text = String::from(
        "rig,fault,seed,ended,degraded_us,detected_us,zero_us,mended_us,largest_n,step_n,beyond_us,resumed,off_n,after_n,struck_there,struck_back,steepest_n_per_s,broken\n",
    );
    // Names have commas.
    let quoted = |text: &str| format!("\"{}\"", text.replace('"', "\"\""));
    let number = |us: Option<u64>| us.map_or_else(String::new, |us| us.to_string());
    let newtons = |force: Option<f32>| force.map_or_else(String::new, |force| force.to_string());
    for run in runs {
        // Writing to a String does not fail.
        let _ = writeln!(
            text,
            "{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{}",
            run.rig,
            quoted(run.wrong.name()),
            run.seed,
            quoted(&format!("{:?}", run.ended)),
            number(run.degraded_us),
            number(run.detected_us),
            number(run.zero_us),
            number(run.mended_us),
            run.largest_n,
            run.step_n,
            run.beyond_us,
            run.resumed,
            newtons(run.off_n),
            newtons(run.after_n),
            number(run.struck.map(|[there, _]| there)),
            number(run.struck.map(|[_, back]| back)),
            run.steepest_n_per_s,
            quoted(run.broken().unwrap_or(""))
        );
    }
    text
}
