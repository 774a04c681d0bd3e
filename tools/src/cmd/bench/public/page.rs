//! The page: one HTML file with its style and drawings.

use super::charts;
use super::figures::{Best, Others, Row, Section, Table};
use super::questions::VERSION;
use super::systems::YOURS;
use crate::html::{self, Cell, heading, paragraph, section as whole, table};
use crate::machine::Machine;
use crate::plot::escaped;
use crate::words::{figure, percent, seconds};

/// Names of the page and its figures.
pub(super) const PAGE: &str = "page.html";
pub(super) const JSON: &str = "figures.json";
pub(super) const CSV: &str = "figures.csv";

/// The whole page. `systems` are the names of other systems with what they say about themselves.
pub(super) fn html(sections: &[Section], systems: &[(&str, &str)], machine: &Machine) -> String {
    let title = "A public benchmark of deformable haptics";
    let quick = sections.iter().any(|section| section.quick);
    let mut body = format!("<h1>{title}</h1>\n");
    body += &paragraph(
        "lead",
        "How far is the force that a person feels from that of the body, how stable is the loop, and how long does it \
         take? Every method of Palpate and its live solver are measured against finite elements, by questions that any \
         other system can answer.",
    );
    if quick {
        body += &paragraph(
            "warning",
            "A quick run (--quick): fewer positions, loops and ticks. Its figures are for a check of the program, not for a comparison.",
        );
    }
    if machine.is_shared() {
        let share = machine.others_share.map(percent).unwrap_or_default();
        body += &paragraph(
            "warning",
            &format!(
                "Other programs used {share} of this machine during the run: times, and the errors of the live solver, are larger than on an idle one."
            ),
        );
    }
    body += &navigation(sections);
    body += &summary(sections);
    for section in sections {
        body += &drawn(section, sections);
    }
    body += &how_to_join(systems);
    body += &footer(machine);
    html::page(title, &body)
}

fn navigation(sections: &[Section]) -> String {
    let links: String = sections
        .iter()
        .map(|section| format!("<a href=\"#{}\">{}</a>", section.key, escaped(&section.title)))
        .collect();
    format!("<nav>{links}<a href=\"#join\">Add your system</a></nav>\n")
}

/// The main figures in sentences, from the tables.
fn summary(sections: &[Section]) -> String {
    let table =
        |key: &str| sections.iter().flat_map(|section| &section.tables).find(|table| table.key == key);
    let value = |key: &str, row: &str, column: &str| table(key)?.value(row, column);
    let mut says = Vec::new();
    for organ in ["point", "fingertip"] {
        let error = |method| value(&format!("force.{organ}"), "mean_mn", method);
        if let Some((energy, trilinear)) = error("energy").zip(error("trilinear")) {
            says.push(format!(
                "Force on \u{201c}{organ}\u{201d}: mean error {} mN by energy, the default, and {} mN by trilinear interpolation.",
                figure(energy),
                figure(trilinear)
            ));
        }
        if let Some(p99) = value(&format!("hands.{organ}"), "poke.p99_mn", "live") {
            says.push(format!(
                "Live on \u{201c}{organ}\u{201d}: 99 % of the errors under a fast poke are below {} mN.",
                figure(p99)
            ));
        }
    }
    let stiffness = |column| value("zwidth.devices", "omega.1000_hz", column);
    if let Some((plain, guarded)) = stiffness("energy").zip(stiffness("energy, guarded")) {
        says.push(format!(
            "On an emulated omega.3 at 1 kHz an organ is passive up to {} N/m, with the energy guard up to {} N/m.",
            figure(plain),
            figure(guarded)
        ));
    }
    if let Some(table) = table("nodule.nodules") {
        let felt: Vec<String> = table
            .rows
            .iter()
            .filter(|row| row.key.ends_with(".detectability"))
            .filter_map(|row| Some(format!("{} {}", row.key.split('.').next()?, figure(row.values[0]?))))
            .collect();
        says.push(format!("Detectability of the nodules, felt above 1: {}.", felt.join(", ")));
    }
    if let Some(table) = table("start.first_touch")
        && let Some(value) = table.value("large_s", "live")
    {
        says.push(format!("Live touches the liver of 2,030 nodes {} s after the command.", figure(value)));
    }
    html::says(&says)
}

/// A section with its plots and tables.
fn drawn(section: &Section, all: &[Section]) -> String {
    let mut body = String::new();
    for text in &section.explains {
        body += &paragraph("explains", text);
    }
    body += &charts::of(section, all);
    for one in &section.tables {
        body += &heading(&one.title);
        body += &paragraph("setting", &one.explains);
        body += &cells(one);
        body += &format!(
            "<p class=\"files\">Table <code>{}</code>{}</p>\n",
            escaped(&one.key),
            match one.others {
                Others::Judged => "; another system is judged from its forces.",
                Others::Declared => "; another system states its figures.",
                Others::None => ".",
            }
        );
    }
    let repeats: Vec<String> =
        section.repeats.iter().map(|command| format!("<code>{}</code>", escaped(command))).collect();
    body += &format!(
        "<p class=\"files\">Repeat it: {} (measured in {}{}).</p>\n",
        repeats.join(", "),
        seconds(section.seconds),
        if section.quick { ", quick" } else { "" }
    );
    whole(&section.key, &section.title, &body)
}

/// The best value of a row, if several differ.
fn best(row: &Row) -> Option<f64> {
    let values = || row.values.iter().flatten().copied();
    let found = match row.best {
        Best::Least => values().min_by(f64::total_cmp),
        Best::Most => values().max_by(f64::total_cmp),
        Best::None => None,
    };
    found.filter(|best| values().any(|value| value != *best))
}

/// The rows of a table.
fn cells(of: &Table) -> String {
    let head: Vec<&str> =
        std::iter::once(of.of.as_str()).chain(of.columns.iter().map(String::as_str)).collect();
    let row = |row: &Row| {
        let best = best(row);
        let cell = |value: &Option<f64>| Cell {
            text: value.map(figure).unwrap_or_default(),
            best: value.is_some() && *value == best,
        };
        std::iter::once(Cell::from(row.name.as_str()))
            .chain(row.values.iter().map(cell))
            .collect::<Vec<Cell>>()
    };
    let rows: Vec<Vec<Cell>> = of.rows.iter().map(row).collect();
    table(&head, &rows)
}

/// How another system gets its column.
fn how_to_join(systems: &[(&str, &str)]) -> String {
    let mut body = String::new();
    if systems.is_empty() {
        body += &paragraph(
            "explains",
            &format!("The column \u{201c}{YOURS}\u{201d} is empty: nobody has answered yet."),
        );
    }
    for (name, about) in systems {
        body += &paragraph("explains", &format!("{name}: {about}"));
    }
    body += &paragraph(
        "explains",
        &format!(
            "Each folder of questions/ (version {VERSION}) has a body as tables (nodes.csv, tets.csv, place.csv, scene.toml with law and \
             constants) and displacements of the touched place. Write the force of your system on the body for them, in a folder of the \
             same structure, and what it states in system.toml; answers/ has those of Palpate as examples, and README.txt \
             the columns. Then:"
        ),
    );
    body += "<p><code>palpate bench public --answers mine=my-answers</code></p>\n";
    body += &paragraph(
        "explains",
        "hil/bridges has programs that ask CHAI3D and SOFA. A figure that a system does not give stays empty.",
    );
    whole("join", "Add your system", &body)
}

fn footer(machine: &Machine) -> String {
    let memory = machine.memory_gb.map_or(String::new(), |gb| format!(", {} GB", figure(gb)));
    let load = machine.others_share.map_or_else(|| "unknown".into(), percent);
    let facts = [
        ("Command", format!("<code>{}</code>", escaped(&machine.command))),
        ("Date", escaped(&machine.date)),
        (
            "Machine",
            escaped(&format!(
                "{}, {} hardware threads{memory}; {} worker threads",
                machine.cpu, machine.cores, machine.threads
            )),
        ),
        ("Other load", escaped(&load)),
        ("System", escaped(&machine.system)),
        (
            "Versions",
            escaped(&format!("palpate {}, solver {}, {}", machine.palpate, machine.solver, machine.rustc)),
        ),
        (
            "This run",
            escaped(&format!(
                "{}; sections of an earlier run keep their figures",
                seconds(machine.wall_seconds)
            )),
        ),
        ("Figures", format!("<a href=\"{JSON}\">{JSON}</a>, <a href=\"{CSV}\">{CSV}</a>")),
    ];
    let facts: String =
        facts.iter().map(|(name, text)| format!("<dt>{name}</dt><dd>{text}</dd>\n")).collect();
    format!("<footer>\n<dl>\n{facts}</dl>\n</footer>\n")
}
