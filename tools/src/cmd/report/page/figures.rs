//! Section (e): all figures of the methods and of the spaces, for reference.

use super::super::measure::{Measured, MethodRow};
use super::super::results::Report;
use super::super::words::{bytes, count, figure, milli, percent, seconds};
use super::html::{Cell, files, heading, paragraph, section as whole, table};
use super::{method_words, title};

/// Returns the section.
pub(super) fn section(report: &Report) -> String {
    let mut body = paragraph(
        "setting",
        "* not among the paper\u{2019}s four. Bold: the smallest of its grid. Covered: positions that the method\u{2019}s own data surround; \
         elsewhere the force is extrapolated. Work: around closed circles, share of the energy exchanged. Seam: largest jump of the \
         force at a face of the grid or the rim. f32: rounding error of the tick\u{2019}s arithmetic. Solving: seconds of all threads together, \
         including the corners that complete the cells at the rim.",
    );
    for (n, cases) in report.cases.iter().enumerate() {
        body += &heading(&title(report, n));
        body += &(error_table(cases) + &cost_table(cases) + &space_table(cases));
    }
    body += &files(&["methods", "spaces"]);
    whole("e", "(e) All figures", &body)
}

/// The smallest value of a figure in one case; NaN is ignored.
fn best(case: &Measured, of: fn(&MethodRow) -> f64) -> f64 {
    case.methods.iter().map(of).fold(f64::INFINITY, f64::min)
}

/// A figure as text, marked if it is the smallest of the case.
fn marked(case: &Measured, row: &MethodRow, of: fn(&MethodRow) -> f64, shown: fn(f64) -> String) -> Cell {
    Cell { text: shown(of(row)), best: of(row) <= best(case, of) }
}

fn grid_words(row: &MethodRow) -> String {
    format!("{} points", count(row.grid as usize))
}

/// Table of the errors by grid and method.
fn error_table(cases: &[Measured]) -> String {
    let head = [
        "grid",
        "method",
        "mean, mN",
        "p50",
        "p95",
        "p99",
        "max",
        "below JND",
        "covered",
        "mean of covered, mN",
        "positions at branch jumps",
        "mean there, mN",
        "max",
    ];
    let row = |case: &Measured, row: &MethodRow| -> Vec<Cell> {
        let error = |of| marked(case, row, of, milli);
        vec![
            grid_words(row).into(),
            method_words(row).into(),
            error(|row| row.mean_n),
            error(|row| row.p50_n),
            error(|row| row.p95_n),
            error(|row| row.p99_n),
            error(|row| row.max_n),
            percent(row.below_jnd_share).into(),
            percent(row.covered_share).into(),
            milli(row.covered_mean_n).into(),
            count(row.branch_jump_positions).into(),
            milli(row.branch_jump_mean_n).into(),
            milli(row.branch_jump_max_n).into(),
        ]
    };
    let rows: Vec<Vec<Cell>> =
        cases.iter().flat_map(|case| case.methods.iter().map(|of| row(case, of))).collect();
    table(&head, &rows)
}

/// Table of the cost of the methods, and of their properties as a force field.
fn cost_table(cases: &[Measured]) -> String {
    let head = [
        "grid",
        "method",
        "a query, ns",
        "tables",
        "work, mean %",
        "max",
        "at branch jumps, mean %",
        "max",
        "seam, mN",
        "f32, mN",
    ];
    let share = |value: f64| if value.is_finite() { figure(100.0 * value) } else { "\u{2013}".into() };
    let row = |case: &Measured, row: &MethodRow| -> Vec<Cell> {
        vec![
            grid_words(row).into(),
            method_words(row).into(),
            marked(case, row, |row| row.nanoseconds, figure),
            marked(case, row, |row| row.table_bytes as f64, |n| bytes(n as usize)),
            figure(100.0 * row.work_mean_share).into(),
            figure(100.0 * row.work_max_share).into(),
            share(row.work_at_branch_jumps_mean_share).into(),
            share(row.work_at_branch_jumps_max_share).into(),
            milli(row.seam_n).into(),
            milli(row.rounding_n).into(),
        ]
    };
    let rows: Vec<Vec<Cell>> =
        cases.iter().flat_map(|case| case.methods.iter().map(|of| row(case, of))).collect();
    table(&head, &rows)
}

/// Table of the cost of the spaces.
fn space_table(cases: &[Measured]) -> String {
    let head = [
        "grid",
        "configurations",
        "tries",
        "failed",
        "solving",
        "iterations",
        "factorisations",
        "residual up to, N",
        "jump pairs",
        "volume at branch jumps",
        "held-out solves",
        "store",
    ];
    let row = |case: &Measured| -> Vec<Cell> {
        let space = &case.space;
        vec![
            format!("{} points", count(space.grid as usize)).into(),
            count(space.configurations).into(),
            count(space.tries).into(),
            count(space.failed).into(),
            seconds(space.solve_seconds).into(),
            count(space.iterations as usize).into(),
            count(space.factorisations as usize).into(),
            figure(space.largest_residual_n).into(),
            count(space.branch_jump_pairs).into(),
            percent(space.branch_jump_volume).into(),
            count(space.held_out_positions as usize).into(),
            bytes(space.space_bytes as usize).into(),
        ]
    };
    table(&head, &cases.iter().map(row).collect::<Vec<_>>())
}
