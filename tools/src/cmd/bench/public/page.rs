//! The page: one HTML file with its style and drawings.

use super::charts;
use super::figures::{Best, Others, Row, Section, Table};
use super::judge::ANSWERED;
use super::questions::VERSION;
use super::systems::YOURS;
use crate::html::{self, Cell, heading, paragraph, section as whole, table};
use crate::machine::{Machine, is_shared};
use crate::plot::escaped;
use crate::words::{figure, percent, seconds};

/// Names of the page and its figures.
pub(super) const PAGE: &str = "page.html";
pub(super) const JSON: &str = "figures.json";
pub(super) const CSV: &str = "figures.csv";

/// Names of other systems, with what they say about themselves.
type Systems<'s> = &'s [(&'s str, &'s str)];

/// The whole page.
pub(super) fn html(sections: &[Section], systems: Systems<'_>, machine: &Machine) -> String {
    let title = "A public benchmark of deformable haptics";
    let quick = sections.iter().any(|section| section.quick);
    let mut body = format!("<h1>{title}</h1>\n");
    body += &paragraph(
        "lead",
        "How accurate is the force that a person feels, how stable is the loop, and how long does it take? The forces of every interpolation method of Palpate, and those of its live solver under a moving hand, are measured \
         against finite elements, by questions that any other system can answer.",
    );
    body += &paragraph(
        "explains",
        "In the commands that repeat a section, OUT is a new folder: in an old one its solves are used again. ASSETS is the folder \
         of the bundled scenes: assets of a clone of the sources, or /usr/share/palpate.",
    );
    body += &paragraph(
        "explains",
        "The best figure of a row is bold, with those that the measurement cannot tell from it. A system that left questions of a \
         table open is not compared. Rows in which a system states its own figure have no bold one, because nobody measured it here.",
    );
    if quick {
        body += &paragraph(
            "warning",
            "A quick run (--quick): fewer positions, loops and ticks. Its figures are for a check of the program, not for a comparison.",
        );
    }
    body += &warning_of_load(sections);
    body += &navigation(sections);
    body += &summary(sections);
    for section in sections {
        body += &drawn(section, sections, systems);
    }
    body += &how_to_join(systems);
    body += &footer(machine);
    html::page(title, &body)
}

/// Which sections were measured beside other programs, in this run or an earlier one.
fn warning_of_load(sections: &[Section]) -> String {
    let loaded: Vec<&Section> = sections.iter().filter(|section| is_shared(section.others_share)).collect();
    let Some(most) = loaded.iter().filter_map(|section| section.others_share).max_by(f64::total_cmp) else {
        return String::new();
    };
    let titles: Vec<String> =
        loaded.iter().map(|section| format!("\u{201c}{}\u{201d}", section.title)).collect();
    paragraph(
        "warning",
        &format!(
            "Other programs used up to {} of this machine during these sections: {}. Times, and the errors of the live solver, are \
             larger there than on an idle machine.",
            percent(most),
            titles.join(", ")
        ),
    )
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
        says.extend(table(&format!("hands.{organ}")).and_then(|table| live_under_a_poke(organ, table)));
    }
    let stiffness = |column| value("zwidth.devices", "omega.1000_hz", column).map(figure);
    if let [Some(plain), Some(guarded)] = ["energy", "guarded"].map(stiffness) {
        says.push(format!(
            "On an emulated omega.3 at 1 kHz a hand comes to rest on an organ up to {plain} N/m, with the energy guard up to {guarded} N/m."
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

/// The errors of live under the fast hand. Fewer than 100 have no 99th percentile.
fn live_under_a_poke(organ: &str, table: &Table) -> Option<String> {
    let live = format!("Live on \u{201c}{organ}\u{201d} under a fast poke:");
    if let Some(p99) = table.value("poke.p99_mn", "live") {
        return Some(format!("{live} 99 % of the errors are below {} mN.", figure(p99)));
    }
    let row = table.rows.iter().find(|row| row.key == "poke.max_mn")?;
    // As "poke: largest of 37 errors, mN".
    let of = row.name.trim_start_matches("poke: ").trim_end_matches(", mN");
    Some(format!("{live} {of}, {} mN.", figure(table.value(&row.key, "live")?)))
}

/// A section with its plots and tables.
fn drawn(section: &Section, all: &[Section], systems: Systems<'_>) -> String {
    let mut body = String::new();
    for text in &section.explains {
        body += &paragraph("explains", text);
    }
    body += &charts::of(section, all);
    for one in &section.tables {
        body += &heading(&one.title);
        body += &paragraph("setting", &one.explains);
        body += &cells(one, systems);
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
    let codes = |texts: &[String]| {
        let codes: Vec<String> = texts.iter().map(|text| format!("<code>{}</code>", escaped(text))).collect();
        codes.join(", ")
    };
    let files = match section.files.as_slice() {
        [] => String::new(),
        files => format!("; files: {}", codes(files)),
    };
    body += &format!(
        "<p class=\"files\">Repeat it: {}{files} (measured {} in {}{}{}).</p>\n",
        codes(&section.repeats),
        escaped(&section.date),
        seconds(section.seconds),
        section.others_share.map_or(String::new(), |share| format!(
            ", other programs used {} of the machine",
            percent(share)
        )),
        if section.quick { ", quick" } else { "" }
    );
    whole(&section.key, &section.title, &body)
}

/// Which values of a row are marked as the best ones: in the columns of each criterion, if several differ.
fn marks(of: &Table, row: &Row, systems: Systems<'_>) -> Vec<bool> {
    let answered = of.rows.iter().find(|row| row.key == ANSWERED);
    let is_complete =
        |n: usize| answered.is_none_or(|row| row.values.get(n).copied().flatten() == Some(100.0));
    let is_stated = |n: usize| {
        of.others == Others::Declared
            && systems.iter().any(|(name, _)| of.columns.get(n).is_some_and(|c| c == name))
    };
    let mut marks = vec![false; row.values.len()];
    for apart in [false, true] {
        let in_group = |n: usize| of.columns.get(n).is_some_and(|column| of.apart.contains(column) == apart);
        let group = row.values.iter().enumerate().filter_map(|(n, value)| Some((n, (*value)?)));
        let group: Vec<(usize, f64)> = group.filter(|(n, _)| in_group(*n)).collect();
        if group.iter().any(|(n, _)| is_stated(*n)) {
            continue;
        }
        let compared = || group.iter().copied().filter(|(n, _)| is_complete(*n));
        let values = || compared().map(|(_, value)| value);
        let best = match row.best {
            Best::Least => values().min_by(f64::total_cmp),
            Best::Most => values().max_by(f64::total_cmp),
            Best::None => None,
        };
        let Some(best) = best else { continue };
        let is_best = |value: f64| (value - best).abs() <= of.accuracy * best.abs();
        if !values().all(is_best) {
            compared().filter(|(_, value)| is_best(*value)).for_each(|(n, _)| marks[n] = true);
        }
    }
    marks
}

/// The rows of a table.
fn cells(of: &Table, systems: Systems<'_>) -> String {
    let head: Vec<&str> =
        std::iter::once(of.of.as_str()).chain(of.columns.iter().map(String::as_str)).collect();
    let row = |row: &Row| {
        let cells = row.values.iter().zip(marks(of, row, systems));
        let cell =
            |(value, best): (&Option<f64>, bool)| Cell { text: value.map(figure).unwrap_or_default(), best };
        std::iter::once(Cell::from(row.name.as_str())).chain(cells.map(cell)).collect::<Vec<Cell>>()
    };
    let rows: Vec<Vec<Cell>> = of.rows.iter().map(row).collect();
    table(&head, &rows)
}

/// How another system gets its column.
fn how_to_join(systems: Systems<'_>) -> String {
    let mut body = String::new();
    if systems.is_empty() {
        body += &paragraph(
            "explains",
            &format!("The column \u{201c}{YOURS}\u{201d} is empty: there are no answers yet."),
        );
    }
    for (name, about) in systems {
        body += &paragraph("explains", &format!("{name}: {about}"));
    }
    body += &format!(
        "<p class=\"explains\">Each organ in questions/ (version {VERSION}) has a folder with a body as tables (nodes.csv, tets.csv, place.csv, \
         scene.toml with law and constants) and displacements of the touched place; the bodies with nodules have scene and mesh only. Write the force of your system on the body for \
         them, in a folder of the same structure, and what it states in system.toml. <a href=\"questions/README.txt\">README.txt</a> \
         has the columns; answers/ has the answers of Palpate as examples. A figure that a system does not give stays empty. \
         Then, with OUT as the folder of this page:</p>\n\
         <p><code>palpate bench public --out OUT --assets ASSETS --answers mine=my-answers</code></p>\n\
         <p class=\"explains\">Programs of a clone that answer: for CHAI3D hil/bridges/chai3d_answers.cpp (built and run with 3.3.0), \
         for SOFA hil/bridges/SofaQuestions.cpp with the scene of hil/bridges/sofa_scene (compiled against stand-ins of its headers only).</p>\n\
         <p><code>chai3d_answers questions/point my-answers/point</code></p>\n\
         <p><code>hil/bridges/sofa_scene questions/point &gt; scene.scn</code></p>\n"
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

#[cfg(test)]
mod tests {
    use super::*;

    fn table(others: Others, columns: &[&str], rows: &[(&str, Best, &[f64])]) -> Table {
        let columns = columns.iter().map(|column| (*column).to_owned()).collect();
        let mut table = Table::new("t", "", "", "", columns);
        table.others = others;
        table.rows =
            rows.iter().map(|(key, best, values)| Row::new(*key, *key, *best, values.to_vec())).collect();
        table
    }

    #[test]
    fn only_a_system_that_answered_everything_is_marked_as_the_best() {
        let with = |answered: f64| {
            let mean: (_, _, &[f64]) = ("mean_mn", Best::Least, &[3.0, 2.0, 1.0]);
            let answered = [100.0, 100.0, answered];
            let table =
                table(Others::Judged, &["a", "b", "theirs"], &[mean, (ANSWERED, Best::None, &answered)]);
            marks(&table, &table.rows[0], &[("theirs", "")])
        };
        assert_eq!(with(100.0), [false, false, true]);
        assert_eq!(with(2.5), [false, true, false]);
    }

    #[test]
    fn a_row_with_a_stated_value_has_no_best_one() {
        let with = |theirs: f64| {
            let row: (_, _, &[f64]) = ("bytes", Best::Least, &[3.0, 2.0, theirs]);
            let table = table(Others::Declared, &["a", "b", "theirs"], &[row]);
            marks(&table, &table.rows[0], &[("theirs", "")])
        };
        assert_eq!(with(f64::NAN), [false, true, false]);
        assert_eq!((with(1.0), with(9.0)), (vec![false; 3], vec![false; 3]));
    }

    #[test]
    fn columns_of_another_criterion_are_compared_with_each_other() {
        let row: (_, _, &[f64]) = ("k", Best::Most, &[1.0, 2.0, 8.0, 9.0]);
        let mut table = table(Others::None, &["a", "b", "c", "d"], &[row]);
        table.apart = vec!["c".into(), "d".into()];
        assert_eq!(marks(&table, &table.rows[0], &[]), [false, true, false, true]);
    }

    #[test]
    fn values_that_the_measurement_cannot_tell_apart_are_all_the_best_ones() {
        let with = |values: &[f64]| {
            let mut table = table(Others::None, &["a", "b", "c"], &[("k", Best::Most, values)]);
            table.accuracy = 0.02;
            marks(&table, &table.rows[0], &[])
        };
        assert_eq!(with(&[2914.0, 2955.0, 2000.0]), [true, true, false]);
        assert_eq!(with(&[2914.0, 2955.0, 2920.0]), [false; 3], "none is better");
    }

    #[test]
    fn the_warning_of_load_is_that_of_each_section() {
        let of =
            |title: &str, others_share| Section { title: title.into(), others_share, ..Section::default() };
        assert_eq!(warning_of_load(&[of("a", Some(0.02)), of("b", None)]), "");
        let said = warning_of_load(&[of("a", Some(0.02)), of("b", Some(0.3)), of("c", Some(0.2))]);
        assert!(
            said.contains("30 %") && said.contains("b\u{201d}, \u{201c}c") && !said.contains("\u{201c}a"),
            "{said}"
        );
    }

    #[test]
    fn few_errors_have_a_largest_one_and_no_percentile() {
        let one: &[f64] = &[4.0];
        let mut few = table(Others::Judged, &["live"], &[("poke.max_mn", Best::Least, one)]);
        few.rows[0].name = "poke: largest of 37 errors, mN".into();
        let said = live_under_a_poke("point", &few).expect("said");
        assert!(said.ends_with("largest of 37 errors, 4 mN."), "{said}");
        let rows = [("poke.p99_mn", Best::Least, one), ("poke.max_mn", Best::Least, &[5.0][..])];
        let said = live_under_a_poke("point", &table(Others::Judged, &["live"], &rows)).expect("said");
        assert!(said.contains("99 %") && said.contains("4 mN"), "{said}");
    }
}
