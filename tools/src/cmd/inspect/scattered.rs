//! How the search of a scattered space went.

use palpate_precompute::adaptive::{LeftOut, LinearSuits, PASSES, Test, Verdict};
use palpate_precompute::space::ScatteredPlan;
use serde_json::json;

/// That the linear body is enough.
pub(crate) fn in_words(linear: &LinearSuits) -> String {
    let LinearSuits { tests, worst, from_fit } = linear;
    format!(
        "linear model suffices: worst of its {tests} tests {:.0} % of tolerance, {:.0} % from the fit anywhere",
        100.0 * worst,
        100.0 * from_fit
    )
}

/// Words and figures.
pub(super) fn describe(plan: &ScatteredPlan) -> (String, serde_json::Value) {
    let Some(search) = plan.search() else { return (String::new(), json!(null)) };
    let LeftOut { configurations: left_out, beyond, worst } = search.left_out();
    let verdict = match plan.verdict() {
        Some(Verdict::Linear) => in_words(&search.linear()),
        Some(Verdict::Passed) => {
            let sure = search.deviation().map_or_else(String::new, |largest| {
                format!(
                    "; the fit is sure: deviation of its force estimated at {:.0} % of tolerance or less",
                    100.0 * largest
                )
            });
            format!(
                "passed: the last {} predictions were within tolerance, and {} of {left_out} configurations as the others say{sure}",
                search.passes().min(PASSES),
                left_out - beyond
            )
        }
        Some(Verdict::Stalled) => {
            let on = plan.switched().map_or_else(String::new, |lattice| {
                let (counts, spacing_mm) = (lattice.counts(), 1e3 * lattice.grid().spacing_m);
                format!(": {} points of a lattice of {spacing_mm:.1} mm took over", counts.solved())
            });
            format!("FOLDS: the predictions did not fall{on}")
        }
        Some(Verdict::NotReached) => "NOT REACHED: the predictions do not come within tolerance".into(),
        None => format!("not finished: {} of {PASSES} predictions in a row", search.passes()),
    };
    let share = |test: &Test| test.error_n / test.tolerance_n;
    let counted: Vec<&Test> = search.tests().iter().filter(|test| test.within).collect();
    let last: Vec<String> = counted
        .iter()
        .skip(counted.len().saturating_sub(PASSES))
        .map(|test| format!("{:.2}", share(test)))
        .collect();
    let words = format!(
        "  {verdict}\n  {} configurations in the fit, length {:.1} mm; errors of the last predictions by their tolerance: {}; of each from the others: up to {worst:.2}\n",
        search.jets().len(),
        1e3 * search.fit().length_m(),
        last.join(" ")
    );
    let tests: Vec<_> = search
        .tests()
        .iter()
        .map(|test| json!({ "index": test.index, "error_n": test.error_n, "tolerance_n": test.tolerance_n, "within": test.within }))
        .collect();
    let verdict = plan.verdict().map(|verdict| match verdict {
        Verdict::Linear => "linear",
        Verdict::Passed => "passed",
        Verdict::Stalled => "stalled",
        Verdict::NotReached => "not reached",
    });
    let figures = json!({
        "verdict": verdict, "configurations": search.jets().len(), "length_m": search.fit().length_m(), "tests": tests,
        "left_out": { "configurations": left_out, "beyond": beyond, "worst": worst },
        "deviation": search.deviation(),
        "linear": search.linear(), "switched_to_spacing_m": plan.switched().map(|lattice| lattice.grid().spacing_m),
    });
    (words, figures)
}
