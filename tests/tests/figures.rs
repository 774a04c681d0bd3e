//! Every picture and every section of measured numbers in the documents has a command in docs/figures/*.toml, and every
//! entry there points at something.

use std::collections::BTreeSet;
use std::fs;

use palpate_tests::documents;
use palpate_tests::figures::{self, Figure, section_of, without_mark};

const MEASUREMENTS: &str = "docs/measurements.md";

fn entries() -> Vec<Figure> {
    figures::all().unwrap_or_else(|error| panic!("{error}"))
}

fn document(name: &str) -> String {
    let path = documents::root().join(name);
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{name}: {error}"))
}

/// Headings of the second and third level, outside of code.
fn headings(text: &str) -> Vec<&str> {
    let mut is_code = false;
    let outside = text.lines().filter(|line| {
        is_code ^= line.starts_with("```");
        !is_code
    });
    outside.filter(|line| line.starts_with("## ") || line.starts_with("### ")).collect()
}

#[test]
fn every_entry_points_at_what_is_there() {
    let mut names = BTreeSet::new();
    let mut checked = 0;
    for figure in entries() {
        let name = &figure.name;
        assert!(names.insert(name.clone()), "two entries `{name}`");
        assert!(!figure.run.trim().is_empty(), "{name}: no command");
        section_of(&document(&figure.file), &figure.heading)
            .unwrap_or_else(|error| panic!("{name}: {error}"));
        let is_compared = !figure.places.is_empty() || !figure.pictures.is_empty();
        assert!(
            is_compared != figure.why.is_some(),
            "{name}: either something is compared, or `why` says why not"
        );
        assert!(!is_compared || figure.seconds.is_some(), "{name}: about how many `seconds` it takes");
        for place in &figure.places {
            let found = place.printed();
            assert!(found.is_ok(), "{name}: {}: {found:?}", place.what());
            checked += 1;
        }
    }
    assert!(checked > 200, "only {checked} places are compared");
}

#[test]
fn every_picture_is_made_by_an_entry_and_shown() {
    let made: BTreeSet<String> = entries().into_iter().flat_map(|figure| figure.pictures).collect();
    let mut shown = BTreeSet::new();
    for (name, text) in documents::all() {
        let folder = name.rsplit_once('/').map_or("", |(folder, _)| folder);
        for part in text.split("![").skip(1) {
            let target = part.split_once("](").and_then(|(_, rest)| rest.split_once(')'));
            let (target, _) = target.unwrap_or_else(|| panic!("{name}: a picture without a target"));
            shown.insert(format!("{folder}/{target}").trim_start_matches('/').to_owned());
        }
    }
    let folder = fs::read_dir(documents::root().join("docs/images")).expect("the folder is there");
    let names = folder.map(|entry| entry.expect("readable").file_name().into_string().expect("UTF-8"));
    let there: BTreeSet<String> = names.map(|name| format!("docs/images/{name}")).collect();
    assert_eq!(made, shown, "pictures of docs/figures/*.toml, and those in the documents");
    assert_eq!(made, there, "pictures of docs/figures/*.toml, and the files in docs/images");
}

#[test]
fn every_section_of_the_measurements_has_an_entry() {
    let named: BTreeSet<String> = entries()
        .into_iter()
        .flat_map(|figure| {
            let own = (figure.file, figure.heading);
            figure.places.into_iter().map(|place| (place.file, place.heading)).chain([own])
        })
        .filter(|(file, _)| file == MEASUREMENTS)
        .map(|(_, heading)| heading)
        .collect();
    for heading in headings(&document(MEASUREMENTS)).into_iter().map(without_mark) {
        assert!(
            named.contains(heading),
            "`{heading}`: no entry of docs/figures/measurements.toml has this heading"
        );
    }
}

/// Whether a section begins with the date and the commit of its numbers: `*2026-11-29, be306a09*`.
fn is_dated(section: &str) -> bool {
    let line = section.trim_start().lines().next().unwrap_or_default();
    let inside = line.strip_prefix('*').and_then(|line| line.strip_suffix('*'));
    let Some((date, commit)) = inside.and_then(|inside| inside.split_once(", ")) else { return false };
    let is_date = date.len() == 10 && date.chars().all(|c| c.is_ascii_digit() || c == '-');
    is_date && commit.len() >= 7 && commit.chars().all(|c| c.is_ascii_hexdigit())
}

#[test]
fn every_measurement_has_its_date_and_commit() {
    let text = document(MEASUREMENTS);
    for heading in headings(&text).into_iter().map(without_mark) {
        let section = section_of(&text, heading).expect("it is there");
        assert!(is_dated(section), "below `{heading}` there is no `*date, commit*` of the measurement");
    }
    assert!(is_dated("\n*2026-11-29, be306a09*\n") && !is_dated("\n*2026-11-29*\n"));
}
