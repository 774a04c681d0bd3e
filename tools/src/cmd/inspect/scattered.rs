//! Results of the search of a scattered space.

use palpate_precompute::adaptive::{
    AdaptiveFit, LeaveOneOutErrors, LinearModelErrors, STREAK, Test, Verdict,
};
use palpate_precompute::space::{FallbackLattice, Record};
use serde_json::json;

/// A message that the linear body suffices.
pub(crate) fn in_words(linear: &LinearModelErrors) -> String {
    let LinearModelErrors { tests, worst, from_fit } = linear;
    format!(
        "linear model suffices: largest error of its {tests} tests {:.0} % of tolerance, largest difference from the fit {:.0} %",
        100.0 * worst,
        100.0 * from_fit
    )
}

/// Text and figures of the present fit, and of the lattice that replaced it, with the records of the space.
pub(super) fn describe(
    fit: Option<&AdaptiveFit>,
    fallback: Option<(&FallbackLattice, &[Record])>,
) -> (String, serde_json::Value) {
    let Some(fit) = fit else { return (String::new(), json!(null)) };
    let LeaveOneOutErrors { configurations: left_out, beyond, worst } = fit.leave_one_out();
    let verdict = match fit.verdict {
        Some(Verdict::Linear) => in_words(&fit.linear),
        Some(Verdict::Passed) => {
            let sure = fit.deviation.map_or_else(String::new, |largest| {
                format!(
                    "; estimated standard deviation of the force at most {:.0} % of tolerance",
                    100.0 * largest
                )
            });
            format!(
                "passed: the last {} predictions were within tolerance, and {} of {left_out} leave-one-out errors{sure}",
                fit.passes().min(STREAK),
                left_out - beyond
            )
        }
        Some(Verdict::Stagnated) => {
            let on = fallback.map_or_else(String::new, |(lattice, records)| {
                let solved = |r: &&Record| r.tag().is_solved() && r.index != [0; 3];
                let solved = lattice.records(records).iter().filter(solved).count();
                let spacing_mm = 1e3 * lattice.grid.spacing_m;
                format!("; replaced by {solved} points of a lattice of {spacing_mm:.1} mm")
            });
            format!("STAGNATED: the prediction errors did not decrease, which indicates a branch jump{on}")
        }
        Some(Verdict::NotReached) => "NOT REACHED: the predictions are not within tolerance".into(),
        Some(Verdict::TooStiff) => format!("TOO STIFF: {}", fit.too_stiff_in_words()),
        None => format!("not finished: {} of {STREAK} predictions in a row", fit.passes()),
    };
    let share = |test: &Test| test.error_n / test.tolerance_n;
    let counted: Vec<&Test> = fit.tests.iter().filter(|test| test.counts).collect();
    let last: Vec<String> = counted
        .iter()
        .skip(counted.len().saturating_sub(STREAK))
        .map(|test| format!("{:.2}", share(test)))
        .collect();
    let words = format!(
        "  {verdict}\n  {} configurations in the fit, length {:.1} mm; last prediction errors, as shares of the tolerance: {}; largest leave-one-out error: {worst:.2}\n",
        fit.jets.len(),
        1e3 * fit.fit.length_m,
        last.join(" ")
    );
    let tests: Vec<_> = fit
        .tests
        .iter()
        .map(|test| json!({ "index": test.index, "error_n": test.error_n, "tolerance_n": test.tolerance_n, "within": test.counts }))
        .collect();
    let verdict = fit.verdict.map(Verdict::name);
    let figures = json!({
        "verdict": verdict, "configurations": fit.jets.len(), "length_m": fit.fit.length_m, "tests": tests,
        "left_out": { "configurations": left_out, "beyond": beyond, "worst": worst },
        "deviation": fit.deviation,
        "linear": fit.linear, "switched_to_spacing_m": fallback.map(|(lattice, _)| lattice.grid.spacing_m),
    });
    (words, figures)
}
