//! What was measured, on what, and the main figures at a glance.

use super::super::Report;
use super::super::measure::{Measured, MethodRow};
use super::super::plan::Family;
use super::super::words::{bytes, count, figure, law, milli, percent, seconds};
use super::html::{Cell, files, paragraph, section as whole, table};
use super::{is_of_the_paper, title};
use palpate_precompute::certificate::{NOT_FELT_N, NOT_FELT_SHARE};

const PARTS: [(&str, &str); 7] = [
    ("glance", "At a glance"),
    ("a", "(a) Time of a query"),
    ("b", "(b) Configurations and seconds"),
    ("c", "(c) Bytes"),
    ("d", "(d) The paper\u{2019}s figures"),
    ("e", "(e) Discretisation"),
    ("f", "(f) Hard cases"),
];

/// Title, setting and main table.
pub(super) fn section(report: &Report) -> String {
    let mut page = String::from("<h1>Speed against error</h1>\n");
    page += &paragraph(
        "lead",
        "A soft organ is solved by finite elements at the points of a grid of tool positions; between them the force is interpolated, a \
         thousand times a second. This page says how wrong each method is, and what it costs.",
    );
    for (family, cases) in report.plan.families.iter().zip(&report.cases) {
        page += &paragraph("setting", &setting(family, cases));
    }
    page += &paragraph(
        "setting",
        &format!(
            "Errors are those of the force vector at independent uniform positions within r_G where |h| is below f_max, each solved by \
             finite elements and never used for a fit; every method is asked at the same ones. Positions at folds, where neighbouring \
             points lie on different branches, are never averaged in: they stand apart. \u{201c}Not felt\u{201d}: an error up to {} of |h| \
             or {} mN, whichever is more.",
            percent(NOT_FELT_SHARE),
            milli(NOT_FELT_N)
        ),
    );
    if report.machine.is_shared() {
        let share = percent(report.machine.others_share.unwrap_or(0.0));
        page += &paragraph(
            "warning",
            &format!(
                "Shared machine: other programs took {share} of the processor while this ran. Errors and bytes do not mind; seconds \
                 and nanoseconds are too large, and not all by the same share."
            ),
        );
    }
    page += "<nav>";
    for (id, name) in PARTS {
        page += &format!("<a href=\"#{id}\">{name}</a>");
    }
    page += "</nav>\n";
    let mut glance = String::new();
    for (n, cases) in report.cases.iter().enumerate() {
        glance += &format!("<h3>{}</h3>\n", super::escaped(&title(report, n)));
        glance += &(error_table(cases) + &cost_table(cases) + &space_table(cases));
    }
    glance += &paragraph(
        "setting",
        "* not among the paper\u{2019}s four. Bold: the least of its grid. Covered: positions where the method has its own data all round; \
         elsewhere the out-of-table policy answers. Work: round closed circles, share of the energy exchanged. Seam: largest jump of the \
         force at a face of the grid or the rim. f32: what the tick\u{2019}s arithmetic adds. Solving: seconds of all threads together, \
         corners that complete the cells at the rim with them.",
    );
    for left_out in report.cases.iter().flatten().flat_map(|case| &case.left_out) {
        let words = format!("Left out: {} on {}: {}.", left_out.method, left_out.case, left_out.why);
        glance += &paragraph("setting", &words);
    }
    glance += &files(&["methods", "spaces"]);
    page + &whole("glance", "At a glance", &glance)
}

fn setting(family: &Family, cases: &[Measured]) -> String {
    let scene = &family.bench.scene;
    let complete = scene.grid.is_some_and(|grid| grid.complete_cells);
    let positions = cases.iter().flat_map(|case| case.methods.first()).map(|row| row.positions);
    let (least, most) = positions.fold((usize::MAX, 0), |(low, high), n| (low.min(n), high.max(n)));
    let limit = if scene.max_force_n.is_finite() {
        format!("f_max = {} N", figure(scene.max_force_n))
    } else {
        "no force limit".into()
    };
    format!(
        "{}: {} nodes, {} tets, {}; active node {}, r_G = {} mm, {limit}, cells at the rim {}; {} uniform positions a grid away from folds.",
        family.name,
        count(scene.mesh.nodes_m.len()),
        count(scene.mesh.tets.len()),
        law(&family.bench.body.law_names()),
        family.active(),
        milli(family.radius_m()),
        if complete { "completed" } else { "not completed" },
        if least == most { count(most) } else { format!("{} to {}", count(least), count(most)) }
    )
}

/// The least of a figure in one case; what is no number does not count.
fn best(case: &Measured, of: fn(&MethodRow) -> f64) -> f64 {
    case.methods.iter().map(of).fold(f64::INFINITY, f64::min)
}

/// A figure in words, marked if no other of the case is less.
fn marked(case: &Measured, row: &MethodRow, of: fn(&MethodRow) -> f64, shown: fn(f64) -> String) -> Cell {
    Cell { text: shown(of(row)), best: of(row) <= best(case, of) }
}

fn grid_words(row: &MethodRow) -> String {
    format!("{} points", count(row.grid as usize))
}

fn method_words(row: &MethodRow) -> String {
    format!("{}{}", row.method, if is_of_the_paper(row) { "" } else { " *" })
}

/// Errors, grid by grid and method by method.
fn error_table(cases: &[Measured]) -> String {
    let head = [
        "grid",
        "method",
        "mean, mN",
        "p50",
        "p95",
        "p99",
        "max",
        "not felt",
        "covered",
        "mean of covered, mN",
        "positions at folds",
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
            percent(row.not_felt_share).into(),
            percent(row.covered_share).into(),
            milli(row.covered_mean_n).into(),
            count(row.folded_positions).into(),
            milli(row.folded_mean_n).into(),
            milli(row.folded_max_n).into(),
        ]
    };
    let rows: Vec<Vec<Cell>> =
        cases.iter().flat_map(|case| case.methods.iter().map(|of| row(case, of))).collect();
    table(&head, &rows)
}

/// What the methods cost, and how they behave as a force field.
fn cost_table(cases: &[Measured]) -> String {
    let head = ["grid", "method", "a query, ns", "tables", "work, mean %", "max", "seam, mN", "f32, mN"];
    let row = |case: &Measured, row: &MethodRow| -> Vec<Cell> {
        vec![
            grid_words(row).into(),
            method_words(row).into(),
            marked(case, row, |row| row.nanoseconds, figure),
            marked(case, row, |row| row.table_bytes as f64, |n| bytes(n as usize)),
            figure(100.0 * row.work_mean_share).into(),
            figure(100.0 * row.work_max_share).into(),
            milli(row.seam_n).into(),
            milli(row.rounding_n).into(),
        ]
    };
    let rows: Vec<Vec<Cell>> =
        cases.iter().flat_map(|case| case.methods.iter().map(|of| row(case, of))).collect();
    table(&head, &rows)
}

/// What the spaces took.
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
        "fold pairs",
        "volume at folds",
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
            count(space.fold_pairs).into(),
            percent(space.folded_volume).into(),
            count(space.held_out_positions as usize).into(),
            bytes(space.space_bytes as usize).into(),
        ]
    };
    table(&head, &cases.iter().map(row).collect::<Vec<_>>())
}
