//! Progress of long work: what is being done, how much of it, for how long, and how long it will take. A bar
//! on a terminal; on a pipe a line at every change of the phase and every few seconds.

use std::io::IsTerminal;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use indicatif::{HumanDuration, ProgressBar, ProgressStyle};
use palpate_precompute::held_out::HeldOutProgress;
use palpate_precompute::space::{Phase, Progress, SolvesLeft};

/// Interval of the lines on a pipe.
const LINE_EVERY: Duration = Duration::from_secs(5);
/// Interval at which the bar shows the elapsed time.
const TICK: Duration = Duration::from_millis(200);
/// An estimate that is exceeded by so much is not shown, s.
const OVERDUE_S: f64 = 5.0;
/// With fewer solves in a phase its rate is that of the whole work.
const ENOUGH_FOR_A_RATE: usize = 8;

/// Progress display of a task with a label.
#[derive(Debug)]
pub(crate) struct WorkProgress {
    state: Arc<Mutex<State>>,
    /// Ends the lines on a pipe when it is dropped.
    lines: Option<(Sender<()>, JoinHandle<()>)>,
    /// Start of the phase: time and solves of this run.
    phase_began: (Instant, usize),
}

/// What is displayed.
#[derive(Debug)]
struct State {
    label: String,
    /// Unit of the count.
    of: &'static str,
    bar: Option<ProgressBar>,
    started: Instant,
    /// Identity of the phase: a line is printed when it changes.
    phase: Option<String>,
    /// The phase in words, with the number of the active node.
    doing: String,
    /// Done, total, and whether the total is a lower bound.
    count: Option<(usize, usize, bool)>,
    /// More figures.
    what: String,
    /// Estimate of the seconds left, and when it was made.
    left_s: Option<(f64, Instant)>,
}

impl State {
    /// The line without its label.
    fn line(&self) -> String {
        let mut parts = vec![self.doing.clone()];
        if let Some((done, total, is_bound)) = self.count {
            let total = if is_bound { format!("at least {total}") } else { total.to_string() };
            parts.push(format!("{done} of {total} {}", self.of));
        }
        if !self.what.is_empty() {
            parts.push(self.what.clone());
        }
        parts.push(format!("{:.0} s elapsed", self.started.elapsed().as_secs_f64()));
        if let Some(left) = self.left() {
            parts.push(left);
        }
        parts.join(", ")
    }

    fn left(&self) -> Option<String> {
        let (seconds, since) = self.left_s?;
        let seconds = seconds - since.elapsed().as_secs_f64();
        let is_bound = self.count.is_some_and(|(_, _, is_bound)| is_bound);
        // A lower bound below a second is no information, nor is an estimate that was wrong.
        if is_bound && seconds < 1.0 || seconds < -OVERDUE_S {
            return None;
        }
        let about = if is_bound { "at least" } else { "about" };
        Some(format!("{about} {} left", HumanDuration(Duration::from_secs_f64(seconds.max(1.0)))))
    }

    fn print(&self) {
        if !self.doing.is_empty() {
            eprintln!("{}: {}", self.label, self.line());
        }
    }

    /// Updates the bar, or prints a line if the phase has changed.
    fn show(&mut self, phase: String) {
        let is_change = self.phase.replace(phase.clone()).is_some_and(|old| old != phase);
        match &self.bar {
            Some(bar) => {
                let (done, total, _) = self.count.unwrap_or((0, 0, false));
                bar.set_length(total as u64);
                bar.set_position(done as u64);
                let rest: Vec<String> = [Some(self.what.clone()), self.left()]
                    .into_iter()
                    .flatten()
                    .filter(|s| !s.is_empty())
                    .collect();
                bar.set_prefix(format!("{}: {}", self.label, self.doing));
                bar.set_message(rest.join(", "));
            }
            None if is_change => self.print(),
            None => {}
        }
    }
}

impl WorkProgress {
    /// Display that counts `of`.
    pub(crate) fn new(label: &str, of: &'static str) -> Self {
        let bar = std::io::stderr().is_terminal().then(|| {
            let bar = ProgressBar::new(0);
            let style =
                ProgressStyle::with_template("{prefix} [{bar:24}] {pos}/{len}  {msg}  {elapsed} elapsed")
                    .expect("the template is valid")
                    .progress_chars("=> ");
            bar.set_style(style);
            bar.enable_steady_tick(TICK);
            bar
        });
        let (now, is_pipe) = (Instant::now(), bar.is_none());
        let state = Arc::new(Mutex::new(State {
            label: label.into(),
            of,
            bar,
            started: now,
            phase: None,
            doing: String::new(),
            count: None,
            what: String::new(),
            left_s: None,
        }));
        Self { lines: is_pipe.then(|| lines(state.clone())).flatten(), state, phase_began: (now, 0) }
    }

    /// Shows a phase of unknown length.
    pub(crate) fn phase(&mut self, doing: &str) {
        self.update(|state| {
            (state.doing, state.count, state.left_s) = (doing.into(), None, None);
            doing.into()
        });
    }

    /// Shows `done` of `total` equal steps of a phase.
    pub(crate) fn steps(&mut self, doing: &str, done: usize, total: usize) {
        self.update(|state| {
            state.doing = doing.into();
            state.count = Some((done, total, false));
            let rate = state.started.elapsed().as_secs_f64() / done.max(1) as f64;
            state.left_s = (done > 0).then(|| (rate * total.saturating_sub(done) as f64, Instant::now()));
            doing.into()
        });
    }

    /// Shows `done` of `total` parts of one of several rounds, whose number is not known before.
    pub(crate) fn round(&mut self, doing: String, what: String, done: usize, total: usize) {
        self.update(|state| {
            (state.count, state.left_s) = (Some((done, total, false)), None);
            (state.doing, state.what) = (doing.clone(), what);
            doing
        });
    }

    /// Shows progress of configuration spaces.
    pub(crate) fn spaces(&mut self, progress: &Progress) {
        if let Some(out) = progress.stopping {
            return self.stopping(out, "solves in hand are waited for");
        }
        let doing = in_words(progress);
        let phase = format!("{doing}{}", progress.taken_over);
        let Progress { tried, solved_now, left, .. } = *progress;
        if self.lock().phase.as_ref() != Some(&phase) {
            self.phase_began = (Instant::now(), solved_now);
        }
        let (left, is_bound) = match left {
            SolvesLeft::About(left) => (left, false),
            SolvesLeft::AtLeast(left) => (left, true),
        };
        let (began, before) = self.phase_began;
        self.update(|state| {
            let (since, solved) = match solved_now - before {
                solved if solved >= ENOUGH_FOR_A_RATE => (began, solved),
                _ => (state.started, solved_now),
            };
            let rate = since.elapsed().as_secs_f64() / solved.max(1) as f64;
            state.left_s = (solved > 0).then(|| (rate * left as f64, Instant::now()));
            state.count = Some((tried, tried + left, is_bound));
            state.doing = format!("node {} of {}: {doing}", progress.space, progress.spaces.1);
            state.what = figures(progress);
            phase
        });
    }

    /// Shows progress of held-out solutions.
    pub(crate) fn held_out(&mut self, progress: &HeldOutProgress) {
        let HeldOutProgress { walks, total, positions_now, steps: (done, all), stopping, .. } = *progress;
        if let Some(out) = stopping {
            return self.stopping(out, "paths in hand are given up");
        }
        self.update(|state| {
            state.doing = "held-out positions".into();
            state.count = Some((walks, total, false));
            state.what = format!("{positions_now} positions solved");
            let rate = state.started.elapsed().as_secs_f64() / done.max(1) as f64;
            state.left_s = (done > 0).then(|| (rate * all.saturating_sub(done) as f64, Instant::now()));
            state.doing.clone()
        });
    }

    /// Reports the state of unfinished work, if there is any; on a pipe only once.
    fn stopping(&mut self, out: usize, what: &str) {
        if out == 0 {
            return;
        }
        let is_pipe = self.lock().bar.is_none();
        // No further lines on a pipe.
        if is_pipe && self.lines.take().is_none() {
            return;
        }
        let state = self.lock();
        let line = format!("stopping: {out} {what} (again to end at once)");
        match &state.bar {
            Some(bar) => bar.set_message(line),
            None => eprintln!("{}: {line}", state.label),
        }
    }

    /// Changes what is displayed; `change` returns the identity of the phase.
    fn update(&mut self, change: impl FnOnce(&mut State) -> String) {
        let mut state = self.lock();
        let phase = change(&mut state);
        state.show(phase);
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Removes the bar; ends the lines.
    pub(crate) fn finish(self) {
        drop(self);
    }
}

impl Drop for WorkProgress {
    fn drop(&mut self) {
        if let Some((end, lines)) = self.lines.take() {
            drop(end);
            let _ = lines.join();
        }
        if let Some(bar) = &self.lock().bar {
            bar.finish_and_clear();
        }
    }
}

/// Prints the line of `state` every few seconds until the sender is dropped. Without a thread there are only
/// the lines at changes of phase.
fn lines(state: Arc<Mutex<State>>) -> Option<(Sender<()>, JoinHandle<()>)> {
    let (end, ended) = channel();
    let print = move || {
        while ended.recv_timeout(LINE_EVERY) == Err(RecvTimeoutError::Timeout) {
            state.lock().unwrap_or_else(PoisonError::into_inner).print();
        }
    };
    Some((end, std::thread::Builder::new().spawn(print).ok()?))
}

/// What is solved in the first unfinished space.
fn in_words(progress: &Progress) -> String {
    let phase = match progress.phase {
        Phase::Search => "adaptive search",
        Phase::Lattice => "lattice",
        Phase::FallbackLattice => "lattice took over the search",
    };
    if progress.again { format!("{phase}, failed points and branch jumps again") } else { phase.into() }
}

/// Counts of all spaces, and how near the first unfinished search is to its end.
fn figures(progress: &Progress) -> String {
    let counts = &progress.counts;
    let mut text = format!(
        "{} kept, {} of them beyond f_max, {} failed",
        counts.solved(),
        counts.terminating,
        counts.failed
    );
    if let (Phase::Search, Some((passed, wanted))) = (progress.phase, progress.passes) {
        text.push_str(&format!(", {passed}/{wanted} predictions within tolerance"));
    }
    if progress.taken_over > 0 && progress.phase != Phase::FallbackLattice {
        let nodes = if progress.taken_over == 1 { "node" } else { "nodes" };
        text.push_str(&format!(", a lattice took over at {} {nodes}", progress.taken_over));
    }
    text
}

#[cfg(test)]
mod tests {
    use palpate_precompute::space::TagCounts;

    use super::*;

    fn progress(phase: Phase, tried: usize, left: SolvesLeft) -> Progress {
        Progress {
            counts: TagCounts { expandable: tried, ..TagCounts::default() },
            passes: Some((3, 20)),
            spaces: (1, 2),
            space: 2,
            phase,
            taken_over: usize::from(phase == Phase::FallbackLattice),
            tried,
            left,
            solved_now: tried,
            again: false,
            stopping: None,
        }
    }

    #[test]
    fn a_lattice_that_takes_over_changes_phase_total_and_time_left() {
        let mut shown = WorkProgress::new("a", "solves");
        shown.spaces(&progress(Phase::Search, 84, SolvesLeft::AtLeast(7)));
        let before = shown.lock().line();
        assert!(before.starts_with("node 2 of 2: adaptive search, 84 of at least 91 solves"), "{before}");
        assert!(
            before.contains("3/20 predictions within tolerance") && before.contains("at least"),
            "{before}"
        );
        shown.spaces(&progress(Phase::FallbackLattice, 85, SolvesLeft::About(612)));
        let after = shown.lock().line();
        let expected = "node 2 of 2: lattice took over the search, 85 of 697 solves";
        assert!(after.starts_with(expected) && after.contains("s elapsed, about"), "{after}");
    }

    #[test]
    fn every_line_says_what_is_done_and_for_how_long() {
        let mut shown = WorkProgress::new("a", "steps");
        shown.phase("certificate");
        assert_eq!(shown.lock().line(), "certificate, 0 s elapsed");
        shown.steps("path", 3, 6);
        let line = shown.lock().line();
        assert!(line.starts_with("path, 3 of 6 steps, 0 s elapsed, about"), "{line}");
        shown.lock().left_s = Some((-6.0, Instant::now()));
        assert!(!shown.lock().line().contains("left"), "the estimate was wrong");
    }
}
