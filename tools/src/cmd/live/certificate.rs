//! The certificate of a live session: how far the felt force was from full solutions, and what it cost.

use std::time::{Duration, Instant};

use nalgebra::Vector3;
use palpate_core::{NodeWeight, vec3};
use palpate_host::SessionSummary;
use palpate_host::live::Counters;
use palpate_host::rt::TickRecord;
use palpate_precompute::live::{Touch, Truth};
use palpate_precompute::spec::Tolerance;
use serde::Serialize;

use super::super::live_solver::{scene, solver};
use super::Args;
use crate::failure::Failure;
use crate::progress::WorkProgress;

/// Way of the control between two kept visits, m.
const WAY_M: f32 = 2e-3;

/// A position of the tool in touch.
#[derive(Debug, Clone, Copy)]
struct Visit {
    weights: [NodeWeight; 3],
    control_m: [f32; 3],
    felt_n: [f32; 3],
    /// Whether a new touch begins here.
    begins: bool,
}

/// The positions that a session visits.
#[derive(Debug)]
pub(super) struct Visits {
    begun: Instant,
    ready: Option<Duration>,
    first_touch_us: Option<u64>,
    touches: bool,
    kept: Vec<Visit>,
    /// Whether the scene was changed: later positions belong to other models.
    has_changed: bool,
    /// Whether positions are kept.
    keeps: bool,
}

/// What is reported. `null` where nothing was checked.
#[derive(Debug, Serialize)]
pub(super) struct Certificate {
    /// Positions that were solved for comparison, and those that could not be.
    checked: usize,
    unsolved: usize,
    /// Whether the scene was changed: positions after that were not checked.
    ends_at_change: bool,
    error_mn: Option<Errors>,
    not_felt_share: Option<f64>,
    /// From the command to the loop, and the wait of the first touch for its force.
    first_force_s: Option<f64>,
    solver_busy_share: f64,
    jets: u64,
    lost: u64,
    handover_max_mn: f64,
    extrapolated_share: f64,
    /// Largest work on the hand since the start of a touch.
    pumped_max_mj: f64,
}

#[derive(Debug, Serialize)]
struct Errors {
    mean: f64,
    p99: f64,
    max: f64,
}

impl Visits {
    /// `keeps` says whether positions will be checked.
    pub(super) fn new(begun: Instant, keeps: bool) -> Self {
        Self {
            begun,
            ready: None,
            first_touch_us: None,
            touches: false,
            kept: Vec::new(),
            has_changed: false,
            keeps,
        }
    }

    /// Takes the next record. Positions count until the scene is changed.
    pub(super) fn take(&mut self, record: &TickRecord, has_changed: bool) {
        self.ready.get_or_insert_with(|| self.begun.elapsed());
        let begins = !std::mem::replace(&mut self.touches, record.engaged.is_some());
        if !self.touches {
            return;
        }
        self.first_touch_us.get_or_insert(record.t_us);
        self.has_changed |= has_changed;
        if self.has_changed || !self.keeps {
            return;
        }
        let is_far = |last: &Visit| {
            vec3::distance(last.control_m, record.displacement_m) > WAY_M
                || last.weights.map(|node| node.space) != record.shares.map(|node| node.space)
        };
        if begins || self.kept.last().is_none_or(is_far) {
            self.kept.push(Visit {
                weights: record.shares,
                control_m: record.displacement_m,
                felt_n: record.reaction_n,
                begins,
            });
        }
    }

    /// Solves the positions that `--check` asks for.
    pub(super) fn certificate(
        &self,
        args: &Args,
        summary: &SessionSummary,
        counters: Counters,
    ) -> Result<Certificate, Failure> {
        let checked = if args.check > 0 { self.check(args)? } else { Checked::default() };
        let touch = &summary.touch;
        let waited_us = touch.first_force_us.zip(self.first_touch_us);
        let waited = waited_us.map(|(force_us, touch_us)| (force_us - touch_us) as f64 * 1e-6);
        Ok(Certificate {
            ends_at_change: self.has_changed,
            checked: checked.errors.len(),
            unsolved: checked.unsolved,
            error_mn: checked.errors(),
            not_felt_share: checked.not_felt_share(),
            first_force_s: self.ready.zip(waited).map(|(ready, waited)| ready.as_secs_f64() + waited),
            solver_busy_share: counters.busy_ns as f64 * 1e-9 / (summary.ticks.max(1) as f64 * 1e-3),
            jets: counters.solves,
            lost: counters.lost,
            handover_max_mn: 1e3 * f64::from(touch.largest_hand_over_n),
            extrapolated_share: touch.extrapolated_share(),
            pumped_max_mj: 1e3 * f64::from(touch.largest_work_j),
        })
    }

    /// Solves positions that are spread evenly over the visited way, each continued from the one before.
    fn check(&self, args: &Args) -> Result<Checked, Failure> {
        let live = solver(&args.scene, &scene(&args.scene, &args.start()?)?.resolve()?)?;
        let mut truth = Truth::new(&live);
        let mut checked = Checked::default();
        let mut progress = WorkProgress::new("check", "positions");
        let (all, wanted) = (self.kept.len(), args.check.min(self.kept.len()));
        let mut done = 0;
        for (index, visit) in self.kept.iter().enumerate() {
            if visit.begins {
                truth.release();
            }
            // The first `wanted` steps of a fair division of all visits.
            if (index + 1) * wanted / all.max(1) == done {
                continue;
            }
            done += 1;
            let touch = Touch {
                contacts: visit.weights.map(|node| (node.space, f64::from(node.weight))),
                control_m: visit.control_m.map(f64::from),
            };
            match truth.force_n(&touch) {
                Ok(true_n) => {
                    let true_n = Vector3::from(true_n);
                    let felt_n = Vector3::from(visit.felt_n.map(f64::from));
                    checked.errors.push(((felt_n - true_n).norm(), true_n.norm()));
                }
                Err(_) => checked.unsolved += 1,
            }
            progress.steps("full solutions", done, wanted);
        }
        progress.finish();
        checked.errors.sort_by(|a, b| a.0.total_cmp(&b.0));
        Ok(checked)
    }
}

/// Errors of the felt force with the size of the true one, N, ascending.
#[derive(Debug, Default)]
struct Checked {
    errors: Vec<(f64, f64)>,
    unsolved: usize,
}

impl Checked {
    fn errors(&self) -> Option<Errors> {
        let largest = self.errors.last()?.0;
        let count = self.errors.len();
        let p99 = self.errors[((count - 1) as f64 * 0.99) as usize].0;
        let mean = self.errors.iter().map(|(error, _)| error).sum::<f64>() / count as f64;
        Some(Errors { mean: 1e3 * mean, p99: 1e3 * p99, max: 1e3 * largest })
    }

    fn not_felt_share(&self) -> Option<f64> {
        let unfelt =
            self.errors.iter().filter(|(error, size)| *error <= Tolerance::IMPERCEPTIBLE.of_size(*size));
        (!self.errors.is_empty()).then(|| unfelt.count() as f64 / self.errors.len() as f64)
    }
}

impl Certificate {
    /// The lines of the report.
    pub(super) fn lines(&self) -> Vec<String> {
        let mut lines = vec![format!(
            "solver       {} jets, busy {:.1} % of the time, {} positions without an equilibrium",
            self.jets,
            100.0 * self.solver_busy_share,
            self.lost
        )];
        if let (Some(error), Some(share)) = (&self.error_mn, self.not_felt_share) {
            lines.push(format!(
                "check        {} positions: error of the felt force {:.1} mN mean, {:.1} mN p99, {:.1} mN at most; {:.1} % \
                 below what can be felt",
                self.checked,
                error.mean,
                error.p99,
                error.max,
                100.0 * share
            ));
        }
        if self.ends_at_change && self.error_mn.is_some() {
            lines.push("             positions after the first change of the scene are not checked".into());
        }
        if self.unsolved > 0 {
            lines.push(format!("             {} positions could not be solved", self.unsolved));
        }
        if let Some(first_s) = self.first_force_s {
            lines.push(format!("first force  {first_s:.2} s after the command, without the way of the hand"));
        }
        lines
    }
}
