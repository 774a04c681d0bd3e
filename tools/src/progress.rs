//! Progress of long work: a bar with ETA on a terminal, a plain line every few seconds otherwise.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use palpate_precompute::configuration_space::Progress;

/// Lines on a pipe are this far apart.
const LINE_EVERY: Duration = Duration::from_secs(5);

/// Progress display of one configuration space.
#[derive(Debug)]
pub(crate) struct SpaceProgress {
    label: String,
    total: usize,
    bar: Option<ProgressBar>,
    started: Instant,
    last_line: Instant,
}

impl SpaceProgress {
    /// Display for `total` points.
    pub(crate) fn new(label: &str, total: usize) -> Self {
        let bar = std::io::stderr().is_terminal().then(|| {
            let bar = ProgressBar::new(total as u64);
            let style = ProgressStyle::with_template(
                "{prefix} [{bar:32}] {pos}/{len}  {msg}  {elapsed} elapsed, {eta} left at most",
            )
            .expect("the template is valid")
            .progress_chars("=> ");
            bar.set_style(style);
            bar.set_prefix(label.to_string());
            bar
        });
        let now = Instant::now();
        Self { label: label.into(), total, bar, started: now, last_line: now }
    }

    /// Shows `progress`.
    pub(crate) fn update(&mut self, progress: &Progress) {
        let counts = progress.counts;
        let decided = self.total - counts.unknown;
        let tags = format!(
            "{} expandable, {} terminating, {} failed, {} unknown (round {})",
            counts.expandable, counts.terminating, counts.failed, counts.unknown, progress.round
        );
        match &self.bar {
            Some(bar) => {
                bar.set_position(decided as u64);
                bar.set_message(tags);
            }
            None if self.last_line.elapsed() >= LINE_EVERY => {
                self.last_line = Instant::now();
                let seconds = self.started.elapsed().as_secs_f64();
                // Unknown points behind terminating ones are never solved, so this is an upper bound.
                let left = seconds * counts.unknown as f64 / progress.solved_now.max(1) as f64;
                eprintln!(
                    "{}: {decided}/{} points, {tags}, {seconds:.0} s, at most {left:.0} s left",
                    self.label, self.total
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
