//! Section (f): the hard cases of the interpolation.

use super::super::Report;
use super::super::hard::HardRow;
use super::super::words::{count, figure, milli, percent};
use super::html::{Cell, files, paragraph, says, section as whole, table};

/// The section.
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
        "missing",
        "fold pairs",
        "volume at folds",
        "largest jump, N",
        "changes of branch",
    ];
    let facts = cases.iter().map(|row| -> Vec<Cell> {
        vec![
            row.case.clone().into(),
            row.max_force_n.map_or("none".into(), figure).into(),
            count(row.configurations).into(),
            percent(row.missing_share).into(),
            count(row.fold_pairs).into(),
            percent(row.folded_volume).into(),
            figure(row.largest_jump_n).into(),
            format!("{} of {}", row.branch_changes, row.held_out).into(),
        ]
    });
    let facts: Vec<Vec<Cell>> = facts.collect();
    let errors_head = [
        "case",
        "method",
        "covered",
        "mean, mN",
        "p99",
        "max",
        "at folds: positions",
        "mean, mN",
        "max",
        "seam, mN",
    ];
    let errors = rows.iter().map(|row| -> Vec<Cell> {
        let best = rows.iter().filter(|r| r.case == row.case).all(|r| r.mean_n >= row.mean_n);
        let folded = |value: f64| -> Cell {
            if row.folded_positions == 0 { "\u{2013}".into() } else { milli(value).into() }
        };
        vec![
            row.case.clone().into(),
            row.method.into(),
            percent(row.covered_share).into(),
            Cell { text: milli(row.mean_n), best },
            milli(row.p99_n).into(),
            milli(row.max_n).into(),
            count(row.folded_positions).into(),
            folded(row.folded_mean_n),
            folded(row.folded_max_n),
            milli(row.seam_n).into(),
        ]
    });
    let errors: Vec<Vec<Cell>> = errors.collect();
    let scene = rows.first().map_or("", |row| row.scene.as_str());
    let grid = rows.first().map_or(0, |row| row.grid);
    let body = paragraph(
        "setting",
        &format!(
            "{scene} on {} points. Missing points are taken away at random before the fit. A fold pair: two neighbours that no smooth force \
             joins. Change of branch: a held-out step after which the body rests elsewhere, however small the step.",
            count(grid as usize)
        ),
    ) + &says(&words(rows, &cases))
        + &table(&head, &facts)
        + &table(&errors_head, &errors)
        + &files(&["hard"])
        + &paragraph(
            "setting",
            "Hard cases of the solver itself: docs/hard-cases.md in the source tree, tests in tests/hard.",
        );
    whole("f", "(f) Hard cases of the interpolation", &body)
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
                "{}: {} errs least, {} mN ({} with all points), {} most, {} mN; {} covers {} of the positions.",
                case.case,
                best.method,
                milli(best.mean_n),
                before.map_or("\u{2013}".into(), |row| milli(row.mean_n)),
                worst.method,
                milli(worst.mean_n),
                best.method,
                percent(best.covered_share)
            ));
        } else if case.fold_pairs > 0 {
            let mut at_folds: Vec<_> = of_case.iter().filter(|row| row.folded_positions > 0).collect();
            at_folds.sort_by(|a, b| a.folded_mean_n.total_cmp(&b.folded_mean_n));
            let folded = at_folds.first().zip(at_folds.last()).map_or(String::new(), |(low, high)| {
                format!(
                    "; at folds the mean is {} mN ({}) to {} mN ({})",
                    milli(low.folded_mean_n),
                    low.method,
                    milli(high.folded_mean_n),
                    high.method
                )
            });
            lines.push(format!(
                "{}: {} pairs of neighbours lie on different branches, with jumps up to {} N, and {} of the volume touches them; elsewhere {} errs \
                 least, {} mN{folded}.",
                case.case,
                count(case.fold_pairs),
                figure(case.largest_jump_n),
                percent(case.folded_volume),
                best.method,
                milli(best.mean_n)
            ));
        } else {
            lines.push(format!(
                "{}: no folds; {} errs least, {} mN.",
                case.case,
                best.method,
                milli(best.mean_n)
            ));
        }
    }
    lines
}
