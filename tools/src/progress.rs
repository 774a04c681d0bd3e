//! Progress of long work: a bar with ETA on a terminal, a plain line every few seconds otherwise.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{HumanDuration, ProgressBar, ProgressStyle};
use palpate_precompute::configuration_space::Progress;

/// Lines on a pipe are this far apart.
const LINE_EVERY: Duration = Duration::from_secs(5);

/// Progress display of the spaces of a scene.
#[derive(Debug)]
pub(crate) struct SpaceProgress {
    label: String,
    bar: Option<ProgressBar>,
    started: Instant,
    last_line: Instant,
}

impl SpaceProgress {
    /// Display under the scene's name.
    pub(crate) fn new(label: &str) -> Self {
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
        Self { label: label.into(), bar, started: now, last_line: now }
    }

    /// Shows `progress`.
    pub(crate) fn update(&mut self, progress: &Progress) {
        let Progress { counts, total, spaces: (done, spaces), round, solved_now } = *progress;
        let decided = total - counts.unknown;
        let of_spaces = if spaces > 1 { format!("{done}/{spaces} spaces, ") } else { String::new() };
        let seconds = self.started.elapsed().as_secs_f64();
        // Unknown points behind terminating ones are never solved, so this is an upper bound.
        let left = seconds * counts.unknown as f64 / solved_now.max(1) as f64;
        let tags = format!(
            "{of_spaces}{} expandable, {} terminating, {} failed, {} unknown (round {round})",
            counts.expandable, counts.terminating, counts.failed, counts.unknown
        );
        match &self.bar {
            Some(bar) => {
                bar.set_length(total as u64);
                bar.set_position(decided as u64);
                bar.set_message(format!(
                    "{tags}, at most {} left",
                    HumanDuration(Duration::from_secs_f64(left))
                ));
            }
            None if self.last_line.elapsed() >= LINE_EVERY => {
                self.last_line = Instant::now();
                eprintln!(
                    "{}: {decided}/{total} points, {tags}, {seconds:.0} s, at most {left:.0} s left",
                    self.label
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
