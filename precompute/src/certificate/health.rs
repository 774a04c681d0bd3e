//! Numerical health of a space: the reasons to distrust its numbers, with their severity.
//!
//! The errors of a certificate are differences from the solver's force. Health judges the solver's force
//! itself: whether it is converged, on a stable branch, computed with non-inverted elements, and
//! single-valued.

use serde::{Deserialize, Serialize};

use super::{BranchDifference, MethodCertificate, SpaceCertificate};
use crate::adaptive::{AdaptiveFit, Verdict as LoopVerdict};
use crate::space::{Equilibrium, Record};
use crate::spec::Tolerance;

/// Verdict on a space.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// No reason to distrust it.
    #[default]
    Green,
    /// Usable after a review of the reasons.
    Yellow,
    /// Not usable as it is.
    Red,
}

impl Verdict {
    /// Name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Green => "green",
            Self::Yellow => "yellow",
            Self::Red => "red",
        }
    }
}

/// One reason to distrust a space.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Reason {
    /// Severity.
    pub verdict: Verdict,
    /// Description and remedy.
    pub what: String,
}

/// Statistics of the reachable configurations (those within f_max), and the verdict.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Health {
    /// The most severe verdict of the reasons.
    pub verdict: Verdict,
    /// The reasons, most severe first.
    pub reasons: Vec<Reason>,
    /// Number of reachable configurations, including rest.
    pub reachable: usize,
    /// Smallest J of any element in any of them.
    pub min_jacobian: f64,
    /// Number of configurations with inverted elements.
    pub inverted: usize,
    /// Number of unstable equilibria, in which a real body does not stay.
    pub unstable: usize,
    /// Number of configurations whose stability is unknown: those without a factor that gives it.
    #[serde(default)]
    pub unknown_stability: usize,
    /// Number of configurations whose transition switched the branch.
    pub switched: usize,
    /// Number of configurations that Newton's method accepted at the rounding floor of the residual, above
    /// its tolerance.
    pub at_rounding_floor: usize,
    /// Largest residual, N.
    pub residual_n: f64,
    /// Lower bound of the condition number of the fit's matrix; `None` without adaptive sampling.
    pub condition: Option<f64>,
    /// Whether adaptive sampling met its stopping criterion; `None` without adaptive sampling.
    pub loop_passed: Option<bool>,
    /// Whether adaptive sampling stagnated, so that a lattice replaced it.
    pub loop_stalled: bool,
}

/// Largest green and largest yellow value of a quantity.
struct Limits {
    yellow: f64,
    red: f64,
}

impl Limits {
    fn of(&self, figure: f64) -> Verdict {
        // NaN is red.
        if figure <= self.yellow {
            Verdict::Green
        } else if figure <= self.red {
            Verdict::Yellow
        } else {
            Verdict::Red
        }
    }
}

/// Share of the ball near branch jumps, of unstable or branch-switching configurations, and of points with
/// two solutions. Up to 1 % a user rarely meets one within a stroke.
const BRANCHES: Limits = Limits { yellow: 0.0, red: 0.01 };
/// Share of configurations with inverted elements. P1/P1 tolerates a few; above a quarter the result is that
/// of the mesh and not of the body.
const INVERTED: Limits = Limits { yellow: 0.0, red: 0.25 };
/// Share of points that could not be solved.
const FAILED: Limits = Limits { yellow: 0.01, red: 0.05 };
/// Residual, N. A converged residual is rounding error. The red limit is a twentieth of the imperceptible
/// error.
const RESIDUAL_N: Limits = Limits { yellow: 1e-6, red: Tolerance::IMPERCEPTIBLE.absolute_n / 20.0 };
/// Share of independent positions with a perceptible error, for the best method.
const PERCEPTIBLE: Limits = Limits { yellow: 0.01, red: 0.05 };
/// Share of these positions with an error beyond the scene's own tolerance.
const TOLERATED: Limits = Limits { yellow: 0.01, red: 0.05 };
/// Difference of the core's f32 arithmetic from f64, N.
const ROUNDING_N: Limits =
    Limits { yellow: Tolerance::IMPERCEPTIBLE.absolute_n / 10.0, red: Tolerance::IMPERCEPTIBLE.absolute_n };
/// Condition number of the fit's matrix. The nuggets keep it below 1e12 unless data contradict each other.
const CONDITION: Limits = Limits { yellow: 1e13, red: 1e16 };

impl Health {
    /// Health of the records of a space, of its other measurements and of its fit, if it was sampled
    /// adaptively. `mesh` is the reason to distrust the discretisation.
    pub(super) fn of(
        records: &[Record],
        found: &SpaceCertificate,
        fit: Option<&AdaptiveFit>,
        mesh: Option<&Reason>,
    ) -> Self {
        let solved = records.iter().filter_map(|r| Some((r, r.equilibrium()?)));
        let reachable: Vec<(&Record, &Equilibrium)> = solved.filter(|(_, at)| !at.terminating).collect();
        let count = |is: &dyn Fn(&Equilibrium) -> bool| reachable.iter().filter(|(_, at)| is(at)).count();
        let mut health = Self {
            reachable: reachable.len(),
            min_jacobian: reachable.iter().map(|(_, at)| at.min_jacobian).fold(f64::INFINITY, f64::min),
            inverted: count(&|r| r.inverted > 0),
            unstable: count(&|r| r.unstable_modes.is_some_and(|modes| modes > 0)),
            unknown_stability: count(&|r| r.unstable_modes.is_none()),
            switched: count(&|r| r.switched),
            at_rounding_floor: reachable.iter().filter(|(r, _)| r.is_at_rounding_floor()).count(),
            residual_n: reachable
                .iter()
                .filter_map(|(r, _)| r.residual_n)
                .fold(0.0, |a, b| if b <= a { a } else { b }),
            condition: fit.map(|fit| fit.condition),
            loop_passed: fit
                .map(|fit| matches!(fit.verdict, Some(LoopVerdict::Passed | LoopVerdict::Linear))),
            loop_stalled: fit.is_some_and(|fit| fit.verdict == Some(LoopVerdict::Stagnated)),
            ..Self::default()
        };
        health.reasons = health.judged(found, mesh);
        health.conclude();
        health
    }

    /// Orders the reasons and takes the most severe for the verdict.
    pub(super) fn conclude(&mut self) {
        self.reasons.sort_by_key(|reason| std::cmp::Reverse(reason.verdict));
        self.verdict = self.reasons.iter().map(|reason| reason.verdict).max().unwrap_or_default();
    }

    pub(super) fn judged(&self, found: &SpaceCertificate, mesh: Option<&Reason>) -> Vec<Reason> {
        let mut reasons = Vec::new();
        let mut say = |verdict: Verdict, what: String| {
            if verdict > Verdict::Green {
                reasons.push(Reason { verdict, what });
            }
        };
        self.judge_branches(found, &mut say);
        self.judge_solutions(found, &mut say);
        self.judge_fit(&mut say);
        judge_errors(&found.methods, &mut say);
        if let Some(Reason { verdict, what }) = mesh {
            say(*verdict, what.clone());
        }
        // Small, but above the tolerance.
        if self.at_rounding_floor > 0 {
            say(
                Verdict::Yellow,
                format!(
                    "{} of {} reachable configurations have a residual above the tolerance of the solver, because rounding errors of \
                     very stiff parts limit it: reduce the ratio of the stiffnesses",
                    self.at_rounding_floor, self.reachable
                ),
            );
        }
        reasons
    }

    /// `n` as a share of the reachable configurations.
    fn share(&self, n: usize) -> f64 {
        n as f64 / self.reachable.max(1) as f64
    }

    /// Number of configurations that are known to be stable or unstable.
    pub(super) fn known_stability(&self) -> usize {
        self.reachable.saturating_sub(self.unknown_stability)
    }

    fn of_all(&self) -> String {
        format!("of {} reachable configurations", self.reachable)
    }

    /// Branch jumps and unstable equilibria.
    fn judge_branches(&self, found: &SpaceCertificate, say: &mut impl FnMut(Verdict, String)) {
        let of_all = self.of_all();
        say(
            BRANCHES.of(found.branch_jump_volume),
            format!(
                "{:.1} % of the volume lies at branch jumps ({} pairs of neighbours on different branches): the force there depends on the path; \
                 take a smaller radius_m",
                100.0 * found.branch_jump_volume,
                found.branch_jump_pairs
            ),
        );
        let BranchDifference { points, apart_n } = found.two_solutions;
        say(
            BRANCHES.of(self.share(points)),
            format!(
                "two stable solutions at {points} points, with forces up to {apart_n:.2} N apart: the body buckles; use a smaller radius_m"
            ),
        );
        let known = self.known_stability();
        let of_known = if known == self.reachable {
            of_all.clone()
        } else {
            format!("of {known} configurations of known stability")
        };
        say(
            BRANCHES.of(self.unstable as f64 / known.max(1) as f64),
            format!("{} {of_known} are unstable equilibria", self.unstable),
        );
        if self.unknown_stability > 0 {
            say(
                Verdict::Yellow,
                format!(
                    "the stability of {} {of_all} is unknown, because a body this large is solved without a factor, which only a sample gets; \
                     with fewer than about 40,000 equations all are known",
                    self.unknown_stability
                ),
            );
        }
        say(
            BRANCHES.of(self.share(self.switched)),
            format!("{} {of_all} switched to another branch", self.switched),
        );
    }

    /// Inverted elements, failures and residuals.
    fn judge_solutions(&self, found: &SpaceCertificate, say: &mut impl FnMut(Verdict, String)) {
        let of_all = self.of_all();
        say(
            INVERTED.of(self.share(self.inverted)),
            format!(
                "{} {of_all} have inverted elements (smallest J {:.2}): refine the mesh there, or use a smaller radius_m",
                self.inverted, self.min_jacobian
            ),
        );
        let points = found.cost.configurations + found.cost.failed;
        say(
            FAILED.of(found.cost.failed as f64 / points.max(1) as f64),
            format!("{} of {points} points could not be solved", found.cost.failed),
        );
        say(
            RESIDUAL_N.of(self.residual_n),
            format!("residuals of up to {:.1e} N: not converged", self.residual_n),
        );
    }

    /// End of the adaptive search and condition of its fit.
    fn judge_fit(&self, say: &mut impl FnMut(Verdict, String)) {
        if self.loop_stalled {
            say(
                Verdict::Yellow,
                "adaptive sampling stagnated at a branch jump, and a lattice replaced it; use a smaller radius_m"
                    .into(),
            );
        } else if self.loop_passed == Some(false) {
            say(
                Verdict::Yellow,
                "adaptive sampling did not reach its tolerance; use a smaller radius_m, or a lattice".into(),
            );
        }
        if let Some(condition) = self.condition {
            say(
                CONDITION.of(condition),
                format!("the fit's matrix has a condition number of {condition:.0e} or more"),
            );
        }
    }
}

/// Errors at independent positions, and rounding.
fn judge_errors(methods: &[MethodCertificate], say: &mut impl FnMut(Verdict, String)) {
    let measured = || methods.iter().filter(|method| method.uniform.count > 0);
    let perceptible = |m: &MethodCertificate| 1.0 - m.uniform.below_jnd as f64 / m.uniform.count as f64;
    let best = measured().min_by(|a, b| perceptible(a).total_cmp(&perceptible(b)));
    if let Some(best) = best {
        // A scene's own tolerance may permit a perceptible error. Errors beyond that tolerance are judged
        // below. A single perceptible error can be chance for any number of positions.
        let is_sure = best.uniform.count > best.uniform.below_jnd + 1;
        let most = if best.tolerated.is_some() || !is_sure { Verdict::Yellow } else { Verdict::Red };
        let percent = 100.0 * perceptible(best);
        say(
            PERCEPTIBLE.of(perceptible(best)).min(most),
            format!(
                "the error is perceptible at {percent:.1} % of {} independent positions ({}, the best method)",
                best.uniform.count, best.method
            ),
        );
    } else {
        say(
            Verdict::Yellow,
            "no independent position away from branch jumps was solved: the errors are known only from the predictions of the search".into(),
        );
    }
    let beyond = |m: &MethodCertificate| Some(1.0 - m.tolerated?.count as f64 / m.uniform.count as f64);
    let beyond = measured().filter_map(|m| Some((m, beyond(m)?))).min_by(|a, b| a.1.total_cmp(&b.1));
    if let Some((best, share)) = beyond {
        say(
            TOLERATED.of(share),
            format!(
                "the error is beyond the scene's tolerance at {:.1} % of {} independent positions ({}, the best method)",
                100.0 * share,
                best.uniform.count,
                best.method
            ),
        );
    }
    for method in methods {
        say(
            ROUNDING_N.of(method.probe.rounding_n),
            format!("{}: rounding of up to {:.1} mN", method.method, 1e3 * method.probe.rounding_n),
        );
    }
}

#[cfg(test)]
mod tests;
