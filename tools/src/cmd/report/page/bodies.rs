//! Section (e): discretisation error.

use super::super::bodies::BodyRow;
use super::super::plot::{Axis, Chart, Point, Series, Style};
use super::super::results::Report;
use super::super::words::{count, figure, milli, percent, seconds};
use super::html::{Cell, Key, figure as plots, files, paragraph, says, section as whole, table};

/// Returns the section.
pub(super) fn section(report: &Report) -> String {
    let rows = &report.bodies;
    let mut elements: Vec<&str> = Vec::new();
    for row in rows {
        if !elements.contains(&row.element.as_str()) {
            elements.push(&row.element);
        }
    }
    let style = |row: &BodyRow, meshes: &[&str]| {
        let n = elements.iter().position(|e| *e == row.element).unwrap_or(0);
        // Markers of the first mesh are hollow, those of finer meshes are filled.
        if meshes.first() == Some(&row.mesh.as_str()) { Style::number(n).hollow() } else { Style::number(n) }
    };
    let (mut charts, mut words) = (Vec::new(), Vec::new());
    for family in &report.plan.families {
        for tool in ["node", "patch"] {
            let of: Vec<&BodyRow> =
                rows.iter().filter(|r| r.scene == family.name && r.tool == tool).collect();
            if of.is_empty() {
                continue;
            }
            let mut meshes: Vec<&str> = Vec::new();
            for row in &of {
                if !meshes.contains(&row.mesh.as_str()) {
                    meshes.push(&row.mesh);
                }
            }
            let compared: Vec<&&BodyRow> = of.iter().filter(|row| !row.finest && row.compared > 0).collect();
            let series = compared.iter().map(|row| Series {
                style: style(row, &meshes),
                joined: false,
                marked: true,
                points: vec![Point {
                    x: 1e3 * row.seconds,
                    y: 100.0 * row.mean_relative,
                    r: 6.0,
                    title: format!("{} on {}: {}", row.element, row.mesh, percent(row.mean_relative)),
                    note: Some(format!("{} eq.", count(row.equations))),
                }],
            });
            charts.push(
                Chart {
                    title: format!("{}, tool on {}", family.name, tool_words(of.first().copied())),
                    x: Axis::log("time of a configuration, ms", compared.iter().map(|row| 1e3 * row.seconds)),
                    y: Axis::log(
                        "mean difference from the finest, %",
                        compared.iter().map(|row| 100.0 * row.mean_relative),
                    ),
                    series: series.collect(),
                    levels: vec![],
                }
                .svg(),
            );
            words.extend(sentence(&family.name, tool, &of));
        }
    }
    let keys: Vec<Key> =
        elements.iter().enumerate().map(|(n, name)| Key::line(Style::number(n), *name)).collect();
    let note = if rows.iter().any(|row| row.mesh != row.scene) {
        "hollow: the coarser mesh; filled: the finer"
    } else {
        ""
    };
    let body = paragraph(
        "setting",
        "The same displacements, along both directions of every axis, by other elements, pressure fields and meshes; the finest of them \
         is the reference. With a single node the force decreases without limit as the mesh is refined, so its column shows the difference \
         between discretisations and not an error; with a patch of fixed radius the force converges.",
    ) + &says(&words)
        + &plots(&keys, note, &charts)
        + &body_table(rows)
        + &files(&["bodies"]);
    whole("e", "(e) Discretisation: error of the force against its cost", &body)
}

fn tool_words(row: Option<&BodyRow>) -> String {
    match row.and_then(|row| row.patch_radius_m) {
        Some(radius_m) => format!("a patch of {} mm", milli(radius_m)),
        None => "one node".into(),
    }
}

fn sentence(scene: &str, tool: &str, rows: &[&BodyRow]) -> Option<String> {
    let finest = rows.iter().find(|row| row.finest)?;
    let each: Vec<String> = rows
        .iter()
        .filter(|row| !row.finest && row.compared > 0)
        .map(|row| {
            let mesh = if row.mesh == scene { String::new() } else { format!(" on {}", row.mesh) };
            format!("{}{mesh} {} in {}", row.element, percent(row.mean_relative), seconds(row.seconds))
        })
        .collect();
    Some(format!(
        "{scene}, {}: mean difference from {} on {} ({} equations, {}): {}.",
        if tool == "node" { "one node".into() } else { tool_words(Some(finest)) },
        finest.element,
        finest.mesh,
        count(finest.equations),
        seconds(finest.seconds),
        each.join("; ")
    ))
}

fn body_table(rows: &[BodyRow]) -> String {
    let head = [
        "scene",
        "tool",
        "element",
        "mesh",
        "tets",
        "equations",
        "compared",
        "mean",
        "largest",
        "mean, mN",
        "a configuration",
    ];
    let rows: Vec<Vec<Cell>> = rows
        .iter()
        .map(|row| {
            let or_finest = |text: String| if row.finest { "reference".to_string() } else { text };
            vec![
                row.scene.clone().into(),
                tool_words(Some(row)).into(),
                row.element.clone().into(),
                row.mesh.clone().into(),
                count(row.tets).into(),
                count(row.equations).into(),
                format!("{} of {}", row.compared, row.asked).into(),
                or_finest(percent(row.mean_relative)).into(),
                or_finest(percent(row.max_relative)).into(),
                or_finest(figure(1e3 * row.mean_n)).into(),
                seconds(row.seconds).into(),
            ]
        })
        .collect();
    table(&head, &rows)
}
