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
            unstable: count(&|r| r.unstable_modes.unwrap_or(0) > 0),
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
        say(
            BRANCHES.of(self.share(self.unstable)),
            format!("{} {of_all} are unstable equilibria", self.unstable),
        );
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
mod tests {
    use super::super::{Cost, Errors, Within};
    use super::*;
    use crate::num::jet::EnergyJet;
    use crate::space::Task;

    #[test]
    fn a_figure_is_judged_by_its_limits_and_no_number_is_red() {
        for (figure, verdict) in
            [(0.0, Verdict::Green), (1e-3, Verdict::Yellow), (0.02, Verdict::Red), (f64::NAN, Verdict::Red)]
        {
            assert_eq!(BRANCHES.of(figure), verdict, "{figure}");
        }
    }

    /// With `count` independent positions.
    fn method(count: usize, below_jnd: usize, tolerated: Option<Within>) -> MethodCertificate {
        let uniform = Errors { count, below_jnd, ..Errors::default() };
        MethodCertificate { method: "energy".into(), uniform, tolerated, ..MethodCertificate::default() }
    }

    /// A space of `configurations` without a branch jump.
    fn space(configurations: usize, methods: &[MethodCertificate]) -> SpaceCertificate {
        let cost = Cost { configurations, ..Cost::default() };
        SpaceCertificate { cost, methods: methods.to_vec(), ..SpaceCertificate::default() }
    }

    #[test]
    fn configurations_at_the_rounding_floor_are_counted() {
        let task = Task { target: [1, 0, 0], attempt: 0, round: 1, parent: None, chart: None };
        let record = |force_n: f64, residual_n: f64| {
            let mut numbers = [0.0; 20];
            numbers[1] = force_n;
            let jet = EnergyJet::from_numbers([0.0; 3], &numbers);
            Record { residual_n: Some(residual_n), ..Record::of_jet(&task, &jet, false) }
        };
        let found = space(3, &[method(300, 300, None)]);
        let of = |records: &[Record]| Health::of(records, &found, None, None);
        let health = of(&[record(0.0, 1e-13), record(1.0, 9e-9), record(3.0, 2e-8)]);
        assert_eq!((health.at_rounding_floor, health.verdict), (0, Verdict::Green), "{:?}", health.reasons);
        let health = of(&[record(1.0, 9e-9), record(1.0, 2e-7), record(0.0, 1e-9)]);
        assert_eq!((health.at_rounding_floor, health.verdict), (2, Verdict::Yellow));
        assert!(health.reasons[0].what.starts_with("2 of 3 reachable configurations have a residual above"));
    }

    /// Each defect alone makes a sound space yellow or red, with its reason.
    #[test]
    fn the_loudest_reason_is_the_verdict() {
        let sound = Health { reachable: 200, min_jacobian: 0.4, ..Health::default() };
        let measured = [method(300, 300, None)];
        let judge =
            |health: &Health, methods: &[MethodCertificate], change: &dyn Fn(&mut SpaceCertificate)| {
                let mut found = space(200, methods);
                change(&mut found);
                let reasons = health.judged(&found, None);
                (reasons.iter().map(|r| r.verdict).max().unwrap_or_default(), reasons.len())
            };
        let judged =
            |health: &Health, change: &dyn Fn(&mut SpaceCertificate)| judge(health, &measured, change);
        let nothing = |_: &mut SpaceCertificate| {};
        assert_eq!(judge(&sound, &[], &nothing), (Verdict::Yellow, 1));
        let tolerance = Tolerance { relative: 0.0, absolute_n: 0.5 };
        for (of, below_jnd, tolerated, verdict) in [
            (5, 4, None, Verdict::Yellow),
            (5, 3, None, Verdict::Red),
            (300, 290, None, Verdict::Yellow),
            (300, 250, Some(300), Verdict::Yellow),
            (300, 300, Some(290), Verdict::Yellow),
            (300, 300, Some(250), Verdict::Red),
        ] {
            let tolerated = tolerated.map(|count| Within { tolerance, count, certified: 0.0 });
            let judged = judge(&sound, &[method(of, below_jnd, tolerated)], &nothing);
            assert_eq!(judged, (verdict, 1), "{below_jnd} of {of}, {tolerated:?}");
        }
        assert_eq!(judged(&sound, &nothing), (Verdict::Green, 0));
        for (health, verdict) in [
            (Health { unstable: 1, ..sound.clone() }, Verdict::Yellow),
            (Health { unstable: 10, ..sound.clone() }, Verdict::Red),
            (Health { switched: 10, ..sound.clone() }, Verdict::Red),
            (Health { inverted: 10, ..sound.clone() }, Verdict::Yellow),
            (Health { inverted: 90, ..sound.clone() }, Verdict::Red),
            (Health { residual_n: 1e-4, ..sound.clone() }, Verdict::Yellow),
            (Health { residual_n: f64::NAN, ..sound.clone() }, Verdict::Red),
            (Health { condition: Some(1e14), ..sound.clone() }, Verdict::Yellow),
            (Health { loop_passed: Some(false), ..sound.clone() }, Verdict::Yellow),
            (Health { loop_passed: Some(false), loop_stalled: true, ..sound.clone() }, Verdict::Yellow),
        ] {
            assert_eq!(judged(&health, &nothing), (verdict, 1), "{health:?}");
        }
        let jumps = |found: &mut SpaceCertificate| found.branch_jump_volume = 0.2;
        assert_eq!(judged(&sound, &jumps), (Verdict::Red, 1));
        let buckled =
            |found: &mut SpaceCertificate| found.two_solutions = BranchDifference { points: 1, apart_n: 0.5 };
        assert_eq!(judged(&sound, &buckled), (Verdict::Yellow, 1));
    }
}
