//! Progress of long work: a bar with ETA on a terminal, a plain line every few seconds otherwise.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{HumanDuration, ProgressBar, ProgressStyle};
use palpate_precompute::held_out::HeldOutProgress;
use palpate_precompute::space::Progress;

/// Interval of the lines on a pipe.
const LINE_EVERY: Duration = Duration::from_secs(5);

/// Progress display of a task with a label.
#[derive(Debug)]
pub(crate) struct WorkProgress {
    label: String,
    /// Unit of the count.
    of: &'static str,
    bar: Option<ProgressBar>,
    started: Instant,
    last_line: Instant,
    /// Whether the stop message was printed.
    told: bool,
}

/// Remaining work.
enum Left {
    /// Steps left and steps done, at the rate so far.
    Steps(usize, usize),
    /// Unknown.
    Unknown,
}

impl WorkProgress {
    /// Display that counts `of`.
    pub(crate) fn new(label: &str, of: &'static str) -> Self {
        let bar = std::io::stderr().is_terminal().then(|| {
            let bar = ProgressBar::new(0);
            let style =
                ProgressStyle::with_template("{prefix} [{bar:32}] {pos}/{len}  {msg}  {elapsed} elapsed")
                    .expect("the template is valid")
                    .progress_chars("=> ");
            bar.set_style(style);
            bar.set_prefix(label.to_string());
            bar
        });
        let now = Instant::now();
        Self { label: label.into(), of, bar, started: now, last_line: now, told: false }
    }

    /// Shows progress of configuration spaces.
    pub(crate) fn spaces(&mut self, progress: &Progress) {
        let Progress { counts, total, passes, spaces: (done, spaces), round, solved_now, again, stopping } =
            *progress;
        if let Some(out) = stopping {
            return self.stopping(out, "running solves will be finished");
        }
        let of_spaces = if spaces > 1 { format!("{done}/{spaces} spaces, ") } else { String::new() };
        if let Some((passed, wanted)) = passes {
            // The number of configurations is unknown. The streak of passed validations shows how near the
            // end is.
            return self.show(passed, wanted, Left::Unknown, || {
                format!(
                    "{of_spaces}{} solved, {} beyond f_max, {} failed (batch {round})",
                    counts.solved(),
                    counts.terminating,
                    counts.failed
                )
            });
        }
        let total = total.unwrap_or(0);
        // Points behind terminating ones are never solved. Failed points and branch jumps are solved more
        // than once.
        let left = if again { Left::Unknown } else { Left::Steps(counts.unknown, solved_now) };
        self.show(total - counts.unknown, total, left, || {
            let doing = if again { "retries at failed points and branch jumps, " } else { "" };
            format!(
                "{of_spaces}{doing}{} expandable, {} terminating, {} failed, {} unknown (round {round})",
                counts.expandable, counts.terminating, counts.failed, counts.unknown
            )
        });
    }

    /// Shows progress of held-out solutions.
    pub(crate) fn walks(&mut self, progress: &HeldOutProgress) {
        let HeldOutProgress { walks, total, positions_now, steps: (done, all), stopping, .. } = *progress;
        if let Some(out) = stopping {
            return self.stopping(out, "running paths are cancelled");
        }
        let left = Left::Steps(all - done, done);
        self.show(walks, total, left, || format!("{positions_now} positions solved"));
    }

    /// Reports the state of unfinished work, if there is any; on a pipe only once.
    fn stopping(&mut self, out: usize, what: &str) {
        if out == 0 {
            return;
        }
        let line = format!("stopping: {out} {what} (press again to end at once)");
        match &self.bar {
            Some(bar) => bar.set_message(line),
            None if !std::mem::replace(&mut self.told, true) => eprintln!("{}: {line}", self.label),
            None => {}
        }
    }

    /// Shows `done` of `total`.
    fn show(&mut self, done: usize, total: usize, left: Left, what: impl Fn() -> String) {
        let seconds = self.started.elapsed().as_secs_f64();
        let left = match left {
            Left::Steps(left, done) if done > 0 => {
                let seconds = seconds * left as f64 / done as f64;
                format!(", about {} left", HumanDuration(Duration::from_secs_f64(seconds)))
            }
            _ => String::new(),
        };
        match &self.bar {
            Some(bar) => {
                bar.set_length(total as u64);
                bar.set_position(done as u64);
                bar.set_message(format!("{}{left}", what()));
            }
            None if self.last_line.elapsed() >= LINE_EVERY => {
                self.last_line = Instant::now();
                eprintln!("{}: {done}/{total} {}, {}, {seconds:.0} s{left}", self.label, self.of, what());
            }
            None => {}
        }
    }

    /// Removes the bar.
    pub(crate) fn finish(self) {
        if let Some(bar) = self.bar {
            bar.finish_and_clear();
        }
    }
}
