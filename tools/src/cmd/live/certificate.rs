//! The certificate of a live session: how far the felt force was from full solutions, and what it cost.

use std::time::Duration;

use palpate_host::SessionSummary;
use palpate_host::live::Counters;
use serde::Serialize;

use super::check::Checked;
use super::visits::{Loops, Visits};

/// Share of processor time of other processes, the solver included, from which on they delay it.
const BUSY: f64 = 0.6;

/// What is reported. `null` where nothing was checked.
#[derive(Debug, Serialize)]
pub(crate) struct Certificate {
    /// Positions that were solved for comparison, and those that could not be.
    checked: usize,
    unsolved: usize,
    /// Whether the user ended the check before all positions were solved.
    is_cut: bool,
    error_mn: Option<Errors>,
    /// Share of both kinds whose error cannot be felt; none of the second kind.
    not_felt_share: Option<f64>,
    /// The same of the positions whose force came from a trusted jet.
    trusted: Trusted,
    /// From the command to the loop, and the wait of the first touch for its force.
    first_force_s: Option<f64>,
    solver_busy_share: f64,
    jets: u64,
    lost: u64,
    handover_max_mn: f64,
    extrapolated_share: f64,
    /// Share of processor time of other processes during the touch, those of the solver included.
    others_share: Option<f64>,
    /// Touches that ended; the largest energy given to the hand round one, and the energy exchanged in it.
    loops: u32,
    loop_pumped_mj: f64,
    loop_exchanged_mj: f64,
}

/// Positions that were not extrapolated.
#[derive(Debug, Serialize)]
struct Trusted {
    checked: usize,
    error_mn: Option<Errors>,
    not_felt_share: Option<f64>,
}

#[derive(Debug, Serialize)]
struct Errors {
    mean: f64,
    p99: f64,
    max: f64,
}

impl Certificate {
    /// Of a session whose loop began to tick `ready` after its command.
    pub(super) fn new(
        visits: &Visits,
        checked: &Checked,
        summary: &SessionSummary,
        counters: Counters,
        ready: Option<Duration>,
        others_share: Option<f64>,
    ) -> Self {
        let touch = &summary.touch;
        let waited_us = touch.first_force_us.zip(visits.first_touch_us);
        let waited = waited_us.map(|(force_us, touch_us)| (force_us - touch_us) as f64 * 1e-6);
        let errors = |[mean, p99, max]: [f64; 3]| Errors { mean: 1e3 * mean, p99: 1e3 * p99, max: 1e3 * max };
        let Loops { count, pumped_j, exchanged_j } = visits.loops;
        let trusted = checked.trusted();
        Self {
            checked: checked.compared.len(),
            unsolved: checked.unsolved,
            is_cut: checked.is_cut,
            error_mn: checked.summary_n().map(errors),
            not_felt_share: checked.not_felt_share(),
            trusted: Trusted {
                checked: trusted.compared.len(),
                error_mn: trusted.summary_n().map(errors),
                not_felt_share: trusted.not_felt_share(),
            },
            first_force_s: ready.zip(waited).map(|(ready, waited)| ready.as_secs_f64() + waited),
            solver_busy_share: counters.busy_ns as f64 * 1e-9 / (summary.ticks.max(1) as f64 * 1e-3),
            jets: counters.solves,
            lost: counters.lost,
            handover_max_mn: 1e3 * f64::from(touch.largest_hand_over_n),
            extrapolated_share: touch.extrapolated_share(),
            others_share,
            loops: count,
            loop_pumped_mj: 1e3 * f64::from(pumped_j),
            loop_exchanged_mj: 1e3 * f64::from(exchanged_j),
        }
    }

    /// What the check says, in a sentence.
    pub(crate) fn verdict(&self) -> String {
        match (&self.error_mn, self.not_felt_share) {
            (Some(error), Some(share)) => format!(
                "the felt force is within {:.1} mN of {} full finite-element solutions; at {:.1} % of {} positions the error is \
                 below what can be felt",
                error.max,
                self.checked,
                100.0 * share,
                self.checked + self.unsolved
            ),
            _ => "the felt force was compared with no full solution".into(),
        }
    }

    /// The lines of the report.
    pub(crate) fn lines(&self) -> Vec<String> {
        let mut lines = vec![format!(
            "solver       {} jets, busy {:.1} % of the time, {} positions without an equilibrium",
            self.jets,
            100.0 * self.solver_busy_share,
            self.lost
        )];
        lines.extend(self.of_check());
        if let Some(share) = self.others_share.filter(|share| *share > BUSY) {
            lines.push(format!(
                "             a busy machine: other programs took {:.0} % of it, and the solver waited for them",
                100.0 * share
            ));
        }
        if self.is_cut {
            lines.push("             ended by Ctrl-C before all positions were solved".into());
        }
        if self.unsolved > 0 {
            lines.push(format!(
                "             {} positions without a full solution count as felt",
                self.unsolved
            ));
        }
        if self.loops > 0 {
            let (pumped_mj, exchanged_mj) = (self.loop_pumped_mj, self.loop_exchanged_mj);
            lines.push(if pumped_mj > 0.0 {
                format!("energy       at most {pumped_mj:.2} mJ given to the hand round a touch, of {exchanged_mj:.1} mJ exchanged in it")
            } else {
                format!("energy       none given to the hand: every touch took at least {:.2} mJ from it", -pumped_mj)
            });
        }
        if let Some(first_s) = self.first_force_s {
            lines.push(format!("first force  {first_s:.2} s after the command, without the way of the hand"));
        }
        lines
    }

    /// The line of the check.
    fn of_check(&self) -> Option<String> {
        let errors = match &self.error_mn {
            Some(Errors { mean, p99, max }) => {
                format!("error of the felt force {mean:.1} mN mean, {p99:.1} mN p99, {max:.1} mN at most")
            }
            None => "none with a full solution".into(),
        };
        let share = self.not_felt_share?;
        let all = self.checked + self.unsolved;
        Some(format!("check        {all} positions: {errors}; {:.1} % below what can be felt", 100.0 * share))
    }
}
