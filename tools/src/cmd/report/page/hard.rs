//! Section (f): the hard cases of the interpolation.

use super::super::hard::HardRow;
use super::super::plot::{Axis, Chart, Point, Series, Style};
use super::super::results::Report;
use super::super::words::{count, figure, milli, percent};
use super::html::{Cell, figure as plots, files, paragraph, says, section as whole, table};
use super::method_keys;

/// Returns the section.
pub(super) fn section(report: &Report) -> String {
    let rows = &report.hard;
    let mut cases: Vec<&HardRow> = Vec::new();
    for row in rows {
        if cases.last().is_none_or(|last| last.case != row.case) {
            cases.push(row);
        }
    }
    let head = [
        "case",
        "f_max, N",
        "configurations",
        "jump pairs",
        "volume at branch jumps",
        "jump up to, N",
        "two solutions",
        "branch changes",
    ];
    let facts = cases.iter().map(|row| -> Vec<Cell> {
        vec![
            row.case.clone().into(),
            row.max_force_n.map_or("none".into(), figure).into(),
            count(row.configurations).into(),
            count(row.branch_jump_pairs).into(),
            percent(row.branch_jump_volume).into(),
            figure(row.largest_jump_n).into(),
            match row.two_solutions {
                0 => "none".into(),
                n => format!("{}, {} N apart", count(n), figure(row.apart_n)),
            }
            .into(),
            format!("{} of {}", row.branch_changes, row.held_out).into(),
        ]
    });
    let facts: Vec<Vec<Cell>> = facts.collect();
    let scene = rows.first().map_or("", |row| row.scene.as_str());
    let grid = rows.first().map_or(0, |row| row.grid);
    let body = paragraph(
        "setting",
        &format!(
            "{scene} on {} points. Missing points are removed at random before the fit. Jump pair: two neighbours on different branches. \
             Two solutions: points where attempts from different neighbours found different stable states. Change of branch: a held-out step to another branch, for any step size.",
            count(grid as usize)
        ),
    ) + &says(&words(rows, &cases))
        + &table(&head, &facts)
        + &matrix(rows, &cases)
        + &holes(report)
        + &files(&["hard"])
        + &paragraph(
            "setting",
            "Hard cases of the solver itself: docs/measurements.md in the source tree, tests in tests/tests/hard.",
        );
    whole("f", "(f) Hard cases of the interpolation", &body)
}

/// Errors: one row per case, one column per method, and an additional row for positions at branch jumps, if
/// any.
fn matrix(rows: &[HardRow], cases: &[&HardRow]) -> String {
    let mut head = vec!["mean / p99, mN"];
    for row in rows {
        if !head.contains(&row.method) {
            head.push(row.method);
        }
    }
    let mut lines: Vec<Vec<Cell>> = Vec::new();
    for case in cases {
        let of = |method: &str| rows.iter().find(|row| row.case == case.case && row.method == method);
        let line = |name: String, text: &dyn Fn(&HardRow) -> Option<[f64; 2]>| -> Vec<Cell> {
            let all: Vec<Option<[f64; 2]>> = head[1..].iter().map(|m| of(m).and_then(text)).collect();
            let least = all.iter().flatten().map(|[mean, _]| *mean).fold(f64::INFINITY, f64::min);
            let cell = |errors: &Option<[f64; 2]>| match errors {
                Some([mean, high]) => {
                    Cell { text: format!("{} / {}", milli(*mean), milli(*high)), best: *mean <= least }
                }
                None => "\u{2013}".into(),
            };
            std::iter::once(Cell::from(name)).chain(all.iter().map(cell)).collect()
        };
        lines.push(line(case.case.clone(), &|row| (row.positions > 0).then_some([row.mean_n, row.p99_n])));
        if rows.iter().any(|row| row.case == case.case && row.branch_jump_positions > 0) {
            let at_branch_jumps = |row: &HardRow| {
                (row.branch_jump_positions > 0).then_some([row.branch_jump_mean_n, row.branch_jump_max_n])
            };
            lines.push(line(
                format!(
                    "\u{2014} {} positions at branch jumps: mean / max",
                    count(case.branch_jump_positions)
                ),
                &at_branch_jumps,
            ));
        }
    }
    table(&head, &lines)
}

/// Error and coverage as functions of the share of missing points.
fn holes(report: &Report) -> String {
    let rows = || report.hard.iter().filter(|row| is_near(report, row));
    let chart = |title: &str, label: &str, of: fn(&HardRow) -> f64, log: bool| {
        let series = report.plan.methods.iter().map(|method| Series {
            style: Style::of_method(*method),
            joined: true,
            marked: true,
            points: rows()
                .filter(|row| row.method == method.name())
                .map(|row| Point {
                    x: 100.0 * row.missing_share,
                    y: of(row),
                    r: 4.0,
                    title: format!("{}, {}: {}", row.method, row.case, figure(of(row))),
                    note: None,
                })
                .collect(),
        });
        let all = rows().map(of);
        Chart {
            title: title.into(),
            x: Axis::linear("points missing, %", rows().map(|row| 100.0 * row.missing_share)),
            y: if log { Axis::log(label, all) } else { Axis::linear(label, all) },
            series: series.collect(),
            levels: vec![],
        }
        .svg()
    };
    let charts = [
        chart("Error of tables with missing points", "mean |error|, mN", |row| 1e3 * row.mean_n, true),
        chart("Positions surrounded by data", "covered, %", |row| 100.0 * row.covered_share, false),
    ];
    plots(&method_keys(report), "", &charts)
}

/// Whether a row has the radius of the first row.
fn is_near(report: &Report, row: &HardRow) -> bool {
    report.hard.first().is_some_and(|first| first.radius_m == row.radius_m)
}

fn words(rows: &[HardRow], cases: &[&HardRow]) -> Vec<String> {
    let mut lines = Vec::new();
    let of = |case: &str| -> Vec<&HardRow> { rows.iter().filter(|row| row.case == case).collect() };
    let Some(whole) = cases.first() else { return lines };
    for case in cases.iter().skip(1) {
        let mut of_case = of(&case.case);
        of_case.sort_by(|a, b| a.mean_n.total_cmp(&b.mean_n));
        let (Some(best), Some(worst)) = (of_case.first(), of_case.last()) else { continue };
        if case.missing_share > 0.0 {
            let before = of(&whole.case).into_iter().find(|row| row.method == best.method);
            lines.push(format!(
                "{}: {} has the smallest error, {} mN ({} with all points), {} the largest, {} mN; {} covers {} of the positions.",
                case.case,
                best.method,
                milli(best.mean_n),
                before.map_or("\u{2013}".into(), |row| milli(row.mean_n)),
                worst.method,
                milli(worst.mean_n),
                best.method,
                percent(best.covered_share)
            ));
        } else if case.branch_jump_pairs > 0 {
            let mut at_branch_jumps: Vec<_> =
                of_case.iter().filter(|row| row.branch_jump_positions > 0).collect();
            at_branch_jumps.sort_by(|a, b| a.branch_jump_mean_n.total_cmp(&b.branch_jump_mean_n));
            let jumps =
                at_branch_jumps.first().zip(at_branch_jumps.last()).map_or(String::new(), |(low, high)| {
                    format!(
                        "; at branch jumps the mean is {} mN ({}) to {} mN ({})",
                        milli(low.branch_jump_mean_n),
                        low.method,
                        milli(high.branch_jump_mean_n),
                        high.method
                    )
                });
            let elsewhere = match best.positions {
                0 => "every position is at a branch jump".into(),
                n => format!(
                    "elsewhere {} has the smallest error, {} mN, and is below JND at {} of {} positions",
                    best.method,
                    milli(best.mean_n),
                    percent(best.below_jnd_share),
                    count(n)
                ),
            };
            lines.push(format!(
                "{}: {} pairs of neighbours lie on different branches, with jumps up to {} N, and {} of the volume is in cells with them; \
                 {elsewhere}{jumps}.",
                case.case,
                count(case.branch_jump_pairs),
                figure(case.largest_jump_n),
                percent(case.branch_jump_volume)
            ));
        } else {
            lines.push(format!(
                "{}: no branch jumps; {} has the smallest error, {} mN, and is below JND at {} of {} positions.",
                case.case,
                best.method,
                milli(best.mean_n),
                percent(best.below_jnd_share),
                count(best.positions)
            ));
        }
    }
    lines
}
