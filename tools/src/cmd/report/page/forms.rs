//! Section (j): the storage forms of a fitted energy, bytes against time.

use super::super::plot::{Axis, Chart, Point, Series, Style};
use super::super::results::Report;
use super::super::words::{bytes, count, figure, milli};
use super::html::{Cell, Key, figure as plots, files, paragraph, section as whole, table};
use crate::cmd::bench::forms::FormRow;

/// Description of each form.
const FORMS: [(&str, &str); 3] = [
    ("cell", "one polynomial per cell (not in blobs)"),
    ("node", "derivatives at nodes (energy)"),
    ("kernel", "the fit itself (kernel)"),
];

/// Returns the section; without rows it contains a note.
pub(super) fn section(report: &Report) -> String {
    let rows = &report.forms;
    let scene = report.plan.families.first().map_or("", |family| family.name.as_str());
    let id = ("j", "(j) The forms of a fitted energy");
    let Some(first) = rows.first() else {
        let body = paragraph("setting", &format!("{scene}: no fit, because only rest is reachable."));
        return whole(id.0, id.1, &body);
    };
    let head = [
        "form",
        "on",
        "bytes",
        "a query, ns",
        "after the last, ns",
        "mean, mN",
        "p99",
        "max",
        "off the fit, mN",
    ];
    let cells = |row: &FormRow| -> Vec<Cell> {
        vec![
            words(row).into(),
            row.instructions.into(),
            bytes(row.bytes).into(),
            figure(row.median_ns).into(),
            row.waits_ns.map_or("\u{2013}".into(), figure).into(),
            milli(row.mean_n).into(),
            milli(row.p99_n).into(),
            milli(row.max_n).into(),
            milli(row.from_fit_max_n).into(),
        ]
    };
    let body = paragraph(
        "setting",
        &format!(
            "{scene}, node {}, sampled until the error is below the JND: {} configurations, and one fit of their energies. A blob contains the \
             derivatives at nodes or the fit, depending on its method; one polynomial per cell is measured for comparison. Errors are at {} \
             held-out positions away from branch jumps; \u{201c}off the fit\u{201d} is the largest difference from the fit in f64. Bytes exclude flags and displacements.",
            first.active,
            count(first.configurations),
            count(first.positions)
        ),
    ) + &plots(&keys(), "", &chart(rows).into_iter().collect::<Vec<_>>())
        + &table(&head, &rows.iter().map(cells).collect::<Vec<_>>())
        + &files(&["forms"]);
    whole(id.0, id.1, &body)
}

fn words(row: &FormRow) -> &'static str {
    FORMS.iter().find(|(form, _)| *form == row.form).map_or(row.form, |(_, words)| *words)
}

fn keys() -> Vec<Key> {
    FORMS.iter().enumerate().map(|(n, (_, words))| Key::line(Style::number(n), *words)).collect()
}

/// One point per form and instruction set.
fn chart(rows: &[FormRow]) -> Option<String> {
    let sound = |row: &&FormRow| row.bytes > 0 && row.median_ns > 0.0 && row.median_ns.is_finite();
    let point = |row: &FormRow| {
        let title = format!(
            "{} on {}: {}, {} ns, p99 {} mN",
            words(row),
            row.instructions,
            bytes(row.bytes),
            figure(row.median_ns),
            milli(row.p99_n)
        );
        Point { x: row.bytes as f64, y: row.median_ns, r: 5.0, title, note: Some(row.instructions.into()) }
    };
    let of = |form: &str| -> Vec<Point> {
        rows.iter().filter(sound).filter(|row| row.form == form).map(point).collect()
    };
    let all = FORMS.map(|(form, _)| of(form));
    let points = || all.iter().flatten();
    points().next()?;
    let x = Axis::log("bytes that a query may read", points().map(|p| p.x));
    let y = Axis::log("time of a query, ns", points().map(|p| p.y));
    let series = all.into_iter().enumerate();
    let series = series
        .map(|(n, points)| Series { style: Style::number(n), joined: false, marked: true, points })
        .collect();
    Some(Chart { title: "Forms of a fitted energy".into(), x, y, series, levels: Vec::new() }.svg())
}
