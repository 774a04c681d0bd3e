//! `--check`: full solutions at visited positions, to compare the felt force with.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::time::Duration;

use palpate_precompute::live::{Touch, Truth};
use palpate_precompute::num::{distance, norm};
use palpate_precompute::spec::Tolerance;

use super::super::live_solver::{scene, solver};
use super::Model;
use super::visits::Visit;
use crate::failure::Failure;
use crate::progress::WorkProgress;

/// How often the wait for a solution looks at the stop flag.
const LOOK: Duration = Duration::from_millis(20);

/// A visited position with its full solution.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Compared {
    pub(crate) visit: Visit,
    /// h of the full solution, N.
    pub(crate) true_n: [f64; 3],
}

impl Compared {
    /// Size of the error of the felt force, N.
    fn error_n(&self) -> f64 {
        distance(self.visit.felt_n.map(f64::from), self.true_n)
    }
}

/// The felt force against full solutions, in the order of the visits.
#[derive(Debug, Default)]
pub(crate) struct Checked {
    pub(crate) compared: Vec<Compared>,
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
        if wanted == 0 {
            return Ok(Self::default());
        }
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
                Ok(Ok(Some(compared))) => checked.compared.push(compared),
                Ok(Ok(None)) => checked.unsolved += 1,
                Ok(Err(failure)) => return Err(failure),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    let done = checked.compared.len() + checked.unsolved;
                    if done < wanted {
                        return Err(Failure::work(format!(
                            "the check ended after {done} of {wanted} positions"
                        )));
                    }
                    break;
                }
            }
            if stop.load(Ordering::Relaxed) {
                checked.is_cut = true;
                break;
            }
            progress.steps("full solutions", checked.compared.len() + checked.unsolved, wanted);
        }
        progress.finish();
        Ok(checked)
    }

    /// Those whose force came from a trusted jet, as the session promises it; the rest were extrapolated.
    pub(super) fn trusted(&self) -> Self {
        let is_trusted = |at: &&Compared| !at.visit.is_extrapolated;
        let compared = self.compared.iter().filter(is_trusted).copied().collect();
        Self { compared, unsolved: 0, is_cut: self.is_cut }
    }

    /// Mean, 99 % quantile and maximum of the error, N.
    pub(super) fn summary_n(&self) -> Option<[f64; 3]> {
        let mut errors: Vec<f64> = self.compared.iter().map(Compared::error_n).collect();
        errors.sort_by(f64::total_cmp);
        let largest = *errors.last()?;
        let p99 = errors[(errors.len() as f64 * 0.99).ceil() as usize - 1];
        Some([errors.iter().sum::<f64>() / errors.len() as f64, p99, largest])
    }

    /// Share of the positions whose error cannot be felt. One without a full solution does not count as such.
    pub(super) fn not_felt_share(&self) -> Option<f64> {
        let cannot_be_felt =
            |at: &&Compared| at.error_n() <= Tolerance::IMPERCEPTIBLE.of_size(norm(at.true_n));
        let unfelt = self.compared.iter().filter(cannot_be_felt).count();
        let all = self.compared.len() + self.unsolved;
        (all > 0).then(|| unfelt as f64 / all as f64)
    }
}

/// `None` where there is no equilibrium.
type Found = Result<Option<Compared>, Failure>;

/// Solves the places of each model in their order. The contacts of all models have the numbers of the first one, as
/// in the session.
fn solve(
    path: &Path,
    settings: &[Vec<String>],
    places: Vec<Place>,
    sender: &Sender<Found>,
) -> Result<(), Failure> {
    let resolved = |changes: usize| Ok::<_, Failure>(scene(path, &settings[changes])?.resolve()?);
    let mut live = solver(path, &resolved(0)?)?;
    let mut present = 0;
    let mut places = places.into_iter().peekable();
    while let Some(first) = places.peek() {
        let changes = first.visit.changes;
        if changes != present {
            live.change(&resolved(changes)?).map_err(Failure::input)?;
            present = changes;
        }
        let mut truth = Truth::new(&live);
        while let Some(Place { visit, begins, compares }) =
            places.next_if(|place| place.visit.changes == changes)
        {
            if begins {
                truth.release();
            }
            let touch = Touch {
                contacts: visit.weights.map(|node| (node.space, f64::from(node.weight))),
                control_m: visit.control_m.map(f64::from),
            };
            truth.face(visit.second_m.map(|at_m| at_m.map(f64::from)));
            // A vertex that a change has fixed cannot be displaced.
            let is_free = |&(contact, weight): &(u16, f64)| weight <= 0.0 || live.skin().is_free(contact);
            let solved = touch.contacts.iter().all(is_free).then(|| truth.force_n(&touch).ok()).flatten();
            if !compares {
                continue;
            }
            if sender.send(Ok(solved.map(|true_n| Compared { visit, true_n }))).is_err() {
                return Ok(());
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use palpate_core::NodeWeight;

    use super::*;

    #[test]
    fn positions_without_a_full_solution_do_not_improve_the_share() {
        let visit = Visit {
            weights: [NodeWeight::default(); 3],
            control_m: [0.0; 3],
            felt_n: [0.0, 0.0, 1.0],
            is_extrapolated: false,
            second_m: None,
            begins: false,
            changes: 0,
        };
        let compared = [1.0, 1.001, 2.0].map(|n| Compared { visit, true_n: [0.0, 0.0, n] });
        let checked = Checked { compared: compared.into(), unsolved: 1, is_cut: false };
        assert_eq!(checked.not_felt_share(), Some(0.5));
        assert_eq!(Checked { compared: Vec::new(), ..checked }.not_felt_share(), Some(0.0));
        assert_eq!(Checked::default().not_felt_share(), None);
    }

    #[test]
    fn trusted_positions_are_those_that_are_not_extrapolated() {
        let at = |is_extrapolated: bool, n: f64| Compared {
            visit: Visit {
                weights: [NodeWeight::default(); 3],
                control_m: [0.0; 3],
                felt_n: [0.0, 0.0, 1.0],
                is_extrapolated,
                second_m: None,
                begins: false,
                changes: 0,
            },
            true_n: [0.0, 0.0, n],
        };
        let compared = vec![at(false, 1.0), at(true, 3.0), at(false, 1.001), at(true, 1.0)];
        let checked = Checked { compared, unsolved: 1, is_cut: false };
        assert_eq!(checked.trusted().compared.len(), 2);
        assert_eq!(checked.trusted().not_felt_share(), Some(1.0));
        assert_eq!(checked.not_felt_share(), Some(0.6));
    }
}
