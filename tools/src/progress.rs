//! Progress of long work: a bar with ETA on a terminal, a plain line every few seconds otherwise.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{HumanDuration, ProgressBar, ProgressStyle};
use palpate_precompute::configuration_space::Progress;
use palpate_precompute::held_out::HeldOutProgress;

/// Lines on a pipe are this far apart.
const LINE_EVERY: Duration = Duration::from_secs(5);

/// Display of some work under a label.
#[derive(Debug)]
pub(crate) struct WorkProgress {
    label: String,
    /// What is counted.
    of: &'static str,
    bar: Option<ProgressBar>,
    started: Instant,
    last_line: Instant,
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
        Self { label: label.into(), of, bar, started: now, last_line: now }
    }

    /// Shows progress of configuration spaces.
    pub(crate) fn spaces(&mut self, progress: &Progress) {
        let Progress { counts, total, spaces: (done, spaces), round, solved_now } = *progress;
        let of_spaces = if spaces > 1 { format!("{done}/{spaces} spaces, ") } else { String::new() };
        // Unknown points behind terminating ones are never solved, so the time left is an upper bound.
        self.show(total - counts.unknown, total, solved_now, || {
            format!(
                "{of_spaces}{} expandable, {} terminating, {} failed, {} unknown (round {round})",
                counts.expandable, counts.terminating, counts.failed, counts.unknown
            )
        });
    }

    /// Shows progress of held-out truth.
    pub(crate) fn walks(&mut self, progress: &HeldOutProgress) {
        let HeldOutProgress { walks, total, positions_now, walks_now } = *progress;
        self.show(walks, total, walks_now, || format!("{positions_now} positions solved"));
    }

    /// `done` of `total`, of which `now` were done by this run.
    fn show(&mut self, done: usize, total: usize, now: usize, what: impl Fn() -> String) {
        let seconds = self.started.elapsed().as_secs_f64();
        let left = seconds * (total - done) as f64 / now.max(1) as f64;
        match &self.bar {
            Some(bar) => {
                bar.set_length(total as u64);
                bar.set_position(done as u64);
                let left = HumanDuration(Duration::from_secs_f64(left));
                bar.set_message(format!("{}, at most {left} left", what()));
            }
            None if self.last_line.elapsed() >= LINE_EVERY => {
                self.last_line = Instant::now();
                eprintln!(
                    "{}: {done}/{total} {}, {}, {seconds:.0} s, at most {left:.0} s left",
                    self.label,
                    self.of,
                    what()
                );
            }
            None => {}
        }
    }

    /// Takes the bar away.
    pub(crate) fn finish(self) {
        if let Some(bar) = self.bar {
            bar.finish_and_clear();
        }
    }
}
