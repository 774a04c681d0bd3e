//! The measured bodies, the conditions, and a summary of the main figures.

use super::super::measure::{Measured, MethodRow};
use super::super::plan::Family;
use super::super::results::Report;
use super::{least, method_words, row, title};
use crate::html::{Cell, files, heading, paragraph, section as whole, table};
use crate::words::{bytes, count, figure, law, milli, percent};
use palpate_precompute::spec::Tolerance;
use palpate_precompute::spec::{Lattice, Sampling};

const PARTS: [(&str, &str); 5] = [
    ("glance", "At a glance"),
    ("a", "(a) Time of a query"),
    ("b", "(b) Configurations and seconds"),
    ("c", "(c) Bytes"),
    ("d", "(d) The paper\u{2019}s figures"),
];

/// Returns the title, the conditions and the main table.
pub(super) fn section(report: &Report) -> String {
    let mut page = String::from("<h1>Speed against error</h1>\n");
    page += &paragraph(
        "lead",
        "A soft organ is solved by finite elements at the points of a grid of tool positions. The force between them is interpolated, a \
         thousand times per second. This page shows error and cost of each method.",
    );
    for (family, cases) in report.plan.families.iter().zip(&report.cases) {
        page += &paragraph("setting", &setting(family, cases));
    }
    page += &paragraph(
        "setting",
        &format!(
            "Errors are those of the force vector at independent uniform positions within r_G where |h| is below f_max, each solved by \
             finite elements and never used for a fit; all methods use the same positions. Positions at branch jumps, where neighbouring \
             points lie on different branches, are excluded from the means and reported separately. \u{201c}Below JND\u{201d}: an error up to the larger of {} of |h| \
             and {} mN.",
            percent(Tolerance::IMPERCEPTIBLE.relative),
            milli(Tolerance::IMPERCEPTIBLE.absolute_n)
        ),
    );
    if report.machine.is_shared() {
        let share = percent(report.machine.others_share.unwrap_or(0.0));
        page += &paragraph(
            "warning",
            &format!(
                "Shared machine: other processes used {share} of the processor during this run. Errors and bytes are not affected; seconds \
                 and nanoseconds are too large by different amounts."
            ),
        );
    }
    page += "<nav>";
    for (id, name) in PARTS {
        page += &format!("<a href=\"#{id}\">{name}</a>");
    }
    page += "</nav>\n";
    let mut glance = paragraph(
        "setting",
        "Error vector in mN, mean / 99th percentile, on each grid; bold: the smallest mean of the grid. Time of a query and bytes of the tables \
         from the coarsest grid to the finest. * not among the paper\u{2019}s four. The tables have the other figures: maxima, shares below \
         JND, positions at branch jumps, work around closed circles, seams, rounding, and the cost of the spaces.",
    );
    for (n, cases) in report.cases.iter().enumerate() {
        glance += &(heading(&title(report, n)) + &matrix(report, cases));
    }
    for left_out in report.cases.iter().flatten().flat_map(|case| &case.left_out) {
        let words = format!("Left out: {} on {}: {}.", left_out.method, left_out.case, left_out.why);
        glance += &paragraph("setting", &words);
    }
    glance += &files(&["methods", "spaces"]);
    page + &whole("glance", "At a glance", &glance)
}

fn setting(family: &Family, cases: &[Measured]) -> String {
    let scene = &family.bench.scene;
    let complete = matches!(scene.grid, Some(Sampling::Lattice(Lattice { complete_cells: true, .. })));
    let positions = cases.iter().flat_map(|case| case.methods.first()).map(|row| row.positions);
    let (least, most) = positions.fold((usize::MAX, 0), |(low, high), n| (low.min(n), high.max(n)));
    let limit = if scene.max_force_n.is_finite() {
        format!("f_max = {} N", figure(scene.max_force_n))
    } else {
        "no force limit".into()
    };
    format!(
        "{}: {} nodes, {} tets, {}; active node {}, r_G = {} mm, {limit}, cells at the rim {}; {} uniform positions per grid away from branch jumps.",
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

/// One row per method, one column per grid.
fn matrix(report: &Report, cases: &[Measured]) -> String {
    let grids: Vec<String> =
        cases.iter().map(|case| format!("{} points", count(case.space.grid as usize))).collect();
    let mut head = vec!["method"];
    head.extend(grids.iter().map(String::as_str));
    head.extend(["a query, ns", "tables"]);
    let mut rows = Vec::new();
    for &method in &report.plan.methods {
        let of: Vec<Option<&MethodRow>> = cases.iter().map(|case| row(case, method)).collect();
        let there: Vec<&MethodRow> = of.iter().copied().flatten().collect();
        let (Some(first), Some(last)) = (there.first(), there.last()) else { continue };
        let mut cells: Vec<Cell> = vec![method_words(first).into()];
        for (case, row) in cases.iter().zip(&of) {
            let best = least(&case.methods, |row| row.mean_n).map_or(0.0, |row| row.mean_n);
            cells.push(row.map_or("\u{2013}".into(), |row| Cell {
                text: format!("{} / {}", milli(row.mean_n), milli(row.p99_n)),
                best: row.mean_n <= best,
            }));
        }
        let range = |shown: fn(&MethodRow) -> String| match (shown(first), shown(last)) {
            (a, b) if a == b => a,
            (a, b) => format!("{a} \u{2013} {b}"),
        };
        cells.push(range(|row| figure(row.nanoseconds)).into());
        cells.push(range(|row| bytes(row.table_bytes)).into());
        rows.push(cells);
    }
    table(&head, &rows)
}
