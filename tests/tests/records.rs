//! The records side by side (`tests/peers/records`): its published figures are cited, its peers pinned.

use std::path::Path;
use std::process::Command;

const PYTHON: &str = "/usr/bin/python3";
const PUBLISHED: &str = include_str!("../peers/published.csv");
const REQUIREMENTS: &str =
    concat!(include_str!("../peers/requirements.txt"), include_str!("../peers/requirements-dolfinx.txt"));

/// The cells of a row of a table; a cell in quotes may contain commas.
fn cells(line: &str) -> Vec<String> {
    let (mut cells, mut quoted) = (vec![String::new()], false);
    for letter in line.chars() {
        match letter {
            '"' => quoted = !quoted,
            ',' if !quoted => cells.push(String::new()),
            _ => cells.last_mut().expect("one at least").push(letter),
        }
    }
    cells
}

/// Whether a text contains a year from 1990 on.
fn has_year(text: &str) -> bool {
    text.split(|c: char| !c.is_ascii_digit()).any(|digits| {
        digits.len() == 4 && digits.parse::<u32>().is_ok_and(|year| (1990..2100).contains(&year))
    })
}

#[test]
fn every_published_figure_has_a_source_and_a_difference() {
    let mut lines = PUBLISHED.lines();
    let header = ["system", "quantity", "figure", "hardware", "source", "differs"];
    assert_eq!(cells(lines.next().unwrap_or_default()), header);
    let mut systems = String::new();
    for line in lines {
        let row = cells(line);
        assert_eq!(row.len(), header.len(), "{line}");
        assert!(row.iter().all(|cell| cell.trim().len() > 2), "an empty cell: {line}");
        assert!(row[2].contains(|c: char| c.is_ascii_digit()), "no figure: {line}");
        assert!(has_year(&row[4]), "the source has no year: {line}");
        assert!(row[5].split(' ').count() > 3, "what differs: {line}");
        systems += &row[0];
    }
    for system in ["SOFA", "Byeon", "PGD", "network"] {
        assert!(systems.contains(system), "{system} is not in {systems}");
    }
    assert!(!has_year("arXiv:2507.05315v1, 12345") && has_year("ICLR (2021)"));
}

#[test]
fn the_peers_from_the_registry_are_pinned() {
    let pinned: Vec<&str> = REQUIREMENTS.lines().filter(|line| !line.starts_with('#')).collect();
    for name in ["felupe", "interpn", "scipy", "numpy", "dolfinx-solver-real"] {
        assert!(pinned.iter().any(|line| line.starts_with(&format!("{name}=="))), "{name}");
    }
    assert!(pinned.iter().all(|line| line.contains("==")), "{pinned:?}");
}

#[test]
#[ignore = "needs Python: tests/peers/numpy runs it"]
fn the_records_explain_themselves_without_their_peers() {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("peers/records");
    let run = |arguments: &[&str]| {
        Command::new(PYTHON).arg("-B").arg(&script).args(arguments).output().expect("Python starts")
    };
    let help = run(&["--help"]);
    let said = String::from_utf8_lossy(&help.stdout);
    assert!(help.status.success(), "{}", String::from_utf8_lossy(&help.stderr));
    for option in ["--only", "--quick", "--out", "--palpate", "--summary", "published"] {
        assert!(said.contains(option), "{option} is not in {said}");
    }
    assert_eq!(run(&["--only", "nonsense"]).status.code(), Some(2));
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().to_str().expect("plain");
    let published = run(&["--only", "published", "--out", out]);
    assert!(published.status.success(), "{}", String::from_utf8_lossy(&published.stderr));
    let table = std::fs::read_to_string(folder.path().join("records.md")).expect("written");
    assert!(table.contains("16,481 nodes"), "{table}");
}
