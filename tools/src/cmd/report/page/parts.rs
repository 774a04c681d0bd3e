//! Section (g): states between grid points, and the displayed surface.

use super::super::results::Report;
use super::super::words::{bytes, count, figure, milli};
use super::html::{Cell, files, heading, paragraph, section as whole, table};

/// Returns the section.
pub(super) fn section(report: &Report) -> String {
    let (forces, surfaces) = (&report.parts.0, &report.parts.1);
    let scene = forces.first().map_or("", |row| row.scene.as_str());
    let grid = forces.first().map_or(0, |row| row.grid);
    let force_head = ["method", "centres", "mean, mN", "p99", "max", "a query, ns"];
    let force_rows: Vec<Vec<Cell>> = forces
        .iter()
        .map(|row| {
            let from = if row.intermediate { "grid points and intermediate states" } else { "grid points" };
            vec![
                format!("{}, {from}", row.method).into(),
                count(row.centres).into(),
                milli(row.mean_n).into(),
                milli(row.p99_n).into(),
                milli(row.max_n).into(),
                figure(row.nanoseconds).into(),
            ]
        })
        .collect();
    let surface_head = [
        "interpolation",
        "bytes",
        "rms mean, mm",
        "rms max",
        "largest mean, mm",
        "largest max",
        "a surface, us",
    ];
    let least = surfaces.iter().map(|row| row.rms_mean_mm).fold(f64::INFINITY, f64::min);
    let surface_rows: Vec<Vec<Cell>> = surfaces
        .iter()
        .map(|row| {
            vec![
                row.how.into(),
                bytes(row.bytes).into(),
                Cell { text: figure(row.rms_mean_mm), best: row.rms_mean_mm <= least },
                figure(row.rms_max_mm).into(),
                figure(row.max_mean_mm).into(),
                figure(row.max_mm).into(),
                figure(row.microseconds).into(),
            ]
        })
        .collect();
    let nodes = surfaces.first().map_or(0, |row| row.nodes);
    let body = paragraph(
        "setting",
        &format!(
            "{scene} on {} points; the intermediate states of every transition are stored.",
            count(grid as usize)
        ),
    ) + &heading(
        "Force by radial basis functions, from grid points alone and with intermediate states",
    ) + &table(&force_head, &force_rows)
        + &heading(&format!(
            "Displacement of the {} nodes of the surface, away from branch jumps",
            count(nodes)
        ))
        + &table(&surface_head, &surface_rows)
        + &paragraph(
            "setting",
            "Packed: int16 modes within the scene\u{2019}s bound. Radial: all configurations, unpacked, for comparison; intermediate \
             states have forces only.",
        )
        + &files(&["parts", "surfaces"]);
    whole("g", "(g) Intermediate states between grid points, and the displayed surface", &body)
}
