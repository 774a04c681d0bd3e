//! `--check`: full solutions at visited positions, to compare the felt force with.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::time::Duration;

use nalgebra::Vector3;
use palpate_precompute::live::{Touch, Truth};
use palpate_precompute::spec::Tolerance;

use super::super::live_solver::{scene, solver};
use super::Model;
use super::visits::Visit;
use crate::failure::Failure;
use crate::progress::WorkProgress;

/// How often the wait for a solution looks at the stop flag.
const LOOK: Duration = Duration::from_millis(20);

/// Errors of the felt force with the size of the true one, N, ascending.
#[derive(Debug, Default)]
pub(super) struct Checked {
    pub(super) errors: Vec<(f64, f64)>,
    pub(super) unsolved: usize,
    /// Whether the user ended it.
    pub(super) is_cut: bool,
}

/// A place to solve.
struct Place {
    visit: Visit,
    /// Whether the touch begins here, or the model, so that the path begins at rest.
    begins: bool,
    /// Whether its force is compared; else only its start of a touch counts.
    compares: bool,
}

impl Checked {
    /// Solves `wanted` positions that are spread evenly over the visits, each continued from the one before. The
    /// stop flag ends it at once; what was compared by then counts.
    pub(super) fn of(
        model: &Model<'_>,
        visits: &[Visit],
        wanted: usize,
        stop: &AtomicBool,
    ) -> Result<Self, Failure> {
        let (all, wanted) = (visits.len(), wanted.min(visits.len()));
        let (mut done, mut changes) = (0, None);
        let mut places = Vec::new();
        for (index, visit) in visits.iter().enumerate() {
            let begins = visit.begins || changes.replace(visit.changes) != Some(visit.changes);
            // The first `wanted` steps of a fair division of all visits.
            let compares = (index + 1) * wanted / all.max(1) != done;
            done += usize::from(compares);
            if begins || compares {
                places.push(Place { visit: *visit, begins, compares });
            }
        }
        let (sender, results) = channel();
        let path = model.scene.to_owned();
        let settings: Vec<Vec<String>> =
            (0..=changes.unwrap_or(0)).map(|changes| model.settings(changes)).collect();
        // A solve is not interrupted, so its thread is left behind when the user ends the check.
        std::thread::spawn(move || {
            if let Err(failure) = solve(&path, &settings, places, &sender) {
                // Without a receiver nobody wants to know.
                let _ = sender.send(Err(failure));
            }
        });
        let mut checked = Self::default();
        let mut progress = WorkProgress::new("check", "positions");
        loop {
            match results.recv_timeout(LOOK) {
                Ok(Ok(Some(error))) => checked.errors.push(error),
                Ok(Ok(None)) => checked.unsolved += 1,
                Ok(Err(failure)) => return Err(failure),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
            if stop.load(Ordering::Relaxed) {
                checked.is_cut = true;
                break;
            }
            progress.steps("full solutions", checked.errors.len() + checked.unsolved, wanted);
        }
        progress.finish();
        checked.errors.sort_by(|a, b| a.0.total_cmp(&b.0));
        Ok(checked)
    }

    /// Mean, 99 % quantile and maximum of the error, N.
    pub(super) fn summary_n(&self) -> Option<[f64; 3]> {
        let largest = self.errors.last()?.0;
        let count = self.errors.len();
        let p99 = self.errors[((count - 1) as f64 * 0.99) as usize].0;
        let mean = self.errors.iter().map(|(error, _)| error).sum::<f64>() / count as f64;
        Some([mean, p99, largest])
    }

    /// Share of the positions whose error cannot be felt.
    pub(super) fn not_felt_share(&self) -> Option<f64> {
        let unfelt =
            self.errors.iter().filter(|(error, size)| *error <= Tolerance::IMPERCEPTIBLE.of_size(*size));
        (!self.errors.is_empty()).then(|| unfelt.count() as f64 / self.errors.len() as f64)
    }
}

/// An error with the size of the true force, N; `None` where there is no equilibrium.
type Found = Result<Option<(f64, f64)>, Failure>;

/// Solves the places of each model in their order.
fn solve(
    path: &std::path::Path,
    settings: &[Vec<String>],
    places: Vec<Place>,
    sender: &Sender<Found>,
) -> Result<(), Failure> {
    let mut places = places.into_iter().peekable();
    while let Some(first) = places.peek() {
        let changes = first.visit.changes;
        let live = solver(path, &scene(path, &settings[changes])?.resolve()?)?;
        let mut truth = Truth::new(&live);
        while let Some(Place { visit, begins, compares }) =
            places.next_if(|place| place.visit.changes == changes)
        {
            if begins {
                truth.release();
            }
            if !compares {
                continue;
            }
            let touch = Touch {
                contacts: visit.weights.map(|node| (node.space, f64::from(node.weight))),
                control_m: visit.control_m.map(f64::from),
            };
            let found = truth.force_n(&touch).ok().map(|true_n| {
                let true_n = Vector3::from(true_n);
                let felt_n = Vector3::from(visit.felt_n.map(f64::from));
                ((felt_n - true_n).norm(), true_n.norm())
            });
            if sender.send(Ok(found)).is_err() {
                return Ok(());
            }
        }
    }
    Ok(())
}
