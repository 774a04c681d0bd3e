//! `palpate bench public`: a public benchmark of deformable haptics on one page.
//!
//! ```text
//! bundled scenes -> scenes.rs -> folder of questions: scene, mesh, body as CSV
//!     organs.rs     space, blob, reference forces -> questions.rs: positions, loops, hands (CSV, versioned)
//!     ours.rs       every method, live             \
//!     answers.rs    CSV of other systems           / -> forces -> judge.rs -> rows of figures
//!     stated.rs     TOML of other systems -> figures that they state
//! forces, cost, zwidth, nodule, first_touch, ticks: one section of tables each (figures.rs)
//!     kept in DIR/work; figures.json, figures.csv and page.rs show the same cells
//! ```
//!
//! The questions hold all that a system needs, and no code of this project. A system answers with forces on the
//! body (N) at displacements (m), and states the rest in `system.toml`. Forces of all systems are judged by the same
//! functions. A figure without an answer is an empty cell.

mod answers;
mod charts;
mod cost;
mod figures;
mod first_touch;
mod forces;
mod jets;
mod judge;
mod nodule;
mod organs;
mod ours;
mod page;
mod questions;
mod run;
mod scenes;
mod sections;
mod stated;
mod systems;
mod ticks;
mod ways;
mod zwidth;

use std::path::PathBuf;
use std::time::Instant;

use clap::Args as ClapArgs;

use crate::analysis::threads;
use crate::failure::Failure;
use crate::files::{FileKind, Files, Folder, Replace};
use crate::interrupt::stop_flag;
use crate::machine::{Machine, Ticks};
use crate::output;
use figures::Section;
use questions::Questions;
use run::Context;
use sections::{KEYS, Workshop};
use systems::Answers;

/// Measure interpolation methods and live against finite elements, on one page.
///
/// Force error, energy round loops, cost, Z-width on emulated devices, detectability of nodules, time to the first touch,
/// worst tick. The page is DIR/page.html; its figures are beside it as JSON and CSV. A
/// full run takes a few minutes on two cores. After Ctrl-C the same command continues; finished sections are kept.
/// --only measures some sections and keeps the others.
///
/// The questions in DIR/questions let anybody run another system; --answers puts it beside ours.
///
/// Example: palpate bench public, then with the same --out: palpate bench public --answers mine=my-answers
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// Folder for the page
    #[arg(long, value_name = "DIR", default_value = "palpate-public")]
    out: PathBuf,
    /// Folder of the bundled scenes
    #[arg(long, value_name = "DIR", default_value = "assets")]
    assets: PathBuf,
    /// Fewer positions and cases, in a minute or two; the page says so
    #[arg(long)]
    quick: bool,
    /// Sections, separated by commas: force, hands, energy, cost, zwidth, nodule, start, tick
    #[arg(long, value_name = "SECTION,..", value_delimiter = ',')]
    only: Vec<String>,
    /// Measure finished sections again
    #[arg(long)]
    again: bool,
    /// Write the questions to this folder too, and measure nothing
    #[arg(long, value_name = "DIR", conflicts_with = "answers")]
    questions: Option<PathBuf>,
    /// Answers of another system: a column beside ours; may be repeated
    #[arg(long, value_name = "NAME=DIR", value_parser = named)]
    answers: Vec<(String, PathBuf)>,
    /// Worker threads; one per core if not given
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    replace: Replace,
}

/// Parses `NAME=DIR`.
fn named(text: &str) -> Result<(String, PathBuf), String> {
    match text.split_once('=') {
        Some((name, folder)) if !name.trim().is_empty() && !folder.is_empty() => {
            Ok((name.trim().into(), folder.into()))
        }
        _ => Err("give a name and a folder, as in mine=my-answers".into()),
    }
}

/// The failure of a run that Ctrl-C ended.
fn interrupted() -> Failure {
    Failure::work("interrupted; finished sections are kept, run the same command to continue")
}

/// The kind of a file in a folder of questions or answers.
fn table_kind(name: &str) -> Option<FileKind> {
    match name.rsplit_once('.')?.1 {
        "csv" => Some(FileKind::Table),
        "toml" => Some(FileKind::Toml),
        "msh" => Some(FileKind::Mesh),
        _ => None,
    }
}

/// The sections of the command line, in the order of the page.
fn wanted(only: &[String]) -> Result<Vec<&'static str>, Failure> {
    if let Some(unknown) = only.iter().find(|key| !KEYS.contains(&key.as_str())) {
        return Err(Failure::input(format!(
            "--only {unknown}: no such section; choose from {}",
            KEYS.join(", ")
        )));
    }
    Ok(KEYS.into_iter().filter(|key| only.is_empty() || only.iter().any(|one| one == key)).collect())
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let (started, ticks) = (Instant::now(), Ticks::now());
    let wanted = wanted(&args.only)?;
    let threads = threads(args.threads)?;
    let mut systems = systems::open(&args.answers)?;
    let mut files = Files::new(args.replace);
    let out = files.folder("--out", &args.out, |name| match name {
        page::PAGE => Some(FileKind::Html),
        page::JSON => Some(FileKind::Json),
        page::CSV => Some(FileKind::Table),
        _ => None,
    })?;
    let stop = stop_flag()?;
    let context = Context { quick: args.quick, threads, stop: &stop };
    if !args.assets.is_dir() {
        let folder = args.assets.display();
        return Err(Failure::input(format!(
            "{folder}: no such folder; give that of the bundled scenes with --assets (assets of a clone, or /usr/share/palpate)"
        )));
    }
    let mut workshop = Workshop::open(&mut files, &out, &args.assets, context)?;
    if let Some(folder) = &args.questions {
        let written = workshop.copy_questions(&mut files, folder)?;
        return output::line(format!(
            "{}: the questions about {written} organs, README.txt says how to answer them",
            folder.display()
        ));
    }
    if !systems.is_empty() {
        // Before the sections, so that a wrong row is reported before long work.
        let questions = workshop.questions()?;
        systems.iter_mut().try_for_each(|system| system.read_forces(&questions))?;
    }
    let (mut sections, failure) = sections(&mut workshop, &wanted, args.again);
    if sections.is_empty() {
        return failure.map_or(Ok(()), Err);
    }
    // After Ctrl-C the page has the finished sections.
    let questions: Vec<&Questions> = if systems.is_empty() { Vec::new() } else { workshop.questions()? };
    systems::add_columns(&mut sections, &questions, &systems);
    let machine = Machine::here(threads, ticks, started.elapsed().as_secs_f64());
    write(&out, &sections, &systems, &machine)?;
    if let Some(failure) = failure {
        eprintln!("palpate: {} has the finished sections", out.path().join(page::PAGE).display());
        return Err(failure);
    }
    if args.json {
        return output::json(&sections);
    }
    output::line(format!(
        "{}: written in {:.0} s, with its figures as {} and {}",
        out.path().join(page::PAGE).display(),
        started.elapsed().as_secs_f64(),
        page::JSON,
        page::CSV
    ))
}

/// The wanted sections, and those that are finished from an earlier run, in the order of the page; and the failure
/// that ended the work.
fn sections(workshop: &mut Workshop<'_>, wanted: &[&str], again: bool) -> (Vec<Section>, Option<Failure>) {
    let (mut sections, mut failure) = (Vec::new(), None);
    let mut left = wanted;
    for key in KEYS {
        if failure.is_some() || !wanted.contains(&key) {
            sections.extend(workshop.stored(key));
            continue;
        }
        match workshop.section(key, again, left) {
            Ok(section) => sections.push(section),
            Err(error) => failure = Some(error),
        }
        left = &left[1..];
    }
    (sections, failure)
}

/// Writes the page and its figures.
fn write(out: &Folder, sections: &[Section], systems: &[Answers], machine: &Machine) -> Result<(), Failure> {
    let about: Vec<(&str, &str)> =
        systems.iter().map(|system| (system.name.as_str(), system.system.about.as_str())).collect();
    let figures = serde_json::json!({
        "questions": questions::VERSION,
        "machine": machine,
        "systems": about.iter().map(|(name, about)| serde_json::json!({"name": name, "about": about})).collect::<Vec<_>>(),
        "sections": sections,
    });
    out.file(page::JSON).put(serde_json::to_string_pretty(&figures).map_err(Failure::work)?.as_bytes())?;
    out.file(page::CSV).put(&output::csv(&figures::cells(sections))?)?;
    out.file(page::PAGE).put(page::html(sections, &about, machine).as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_section_is_refused_and_the_order_is_that_of_the_page() {
        let only = |text: &str| text.split(',').map(String::from).collect::<Vec<_>>();
        assert_eq!(wanted(&only("tick,force")).expect("known"), ["force", "tick"]);
        assert_eq!(wanted(&[]).expect("all"), KEYS);
        let line = wanted(&only("force,foo")).expect_err("unknown").line();
        assert!(line.contains("--only foo") && line.contains("zwidth"), "{line}");
        assert!(named("a=b").is_ok() && named("a").is_err() && named("=b").is_err());
    }
}
