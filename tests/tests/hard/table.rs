//! The table of results: printed row by row, and written as Markdown to the file `PALPATE_HARD_TABLE`.

use std::fmt::Write;
use std::sync::{Mutex, PoisonError};

use palpate_precompute::fem::Configuration;

/// The cases, in the order of the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Case {
    NearlyIncompressible,
    Compression,
    OrganPull,
    BadElements,
    Units,
    Contrast,
    Support,
    Branches,
    HeldPressure,
}

impl Case {
    fn title(self) -> &'static str {
        match self {
            Self::NearlyIncompressible => "nearly incompressible",
            Self::Compression => "compression",
            Self::OrganPull => "60 mm pull",
            Self::BadElements => "bad elements",
            Self::Units => "units",
            Self::Contrast => "contrast 1e6",
            Self::Support => "support",
            Self::Branches => "perturbed starts",
            Self::HeldPressure => "held pressures",
        }
    }
}

/// Cost of a solve or a path.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Cost {
    pub(crate) equations: usize,
    pub(crate) iterations: u32,
    pub(crate) factorisations: u32,
    pub(crate) increments: u32,
}

impl Cost {
    pub(crate) fn of(equations: usize, solved: &Configuration) -> Self {
        let Configuration { iterations, factorisations, increments, .. } = *solved;
        Self { equations, iterations, factorisations, increments }
    }
}

#[derive(Debug)]
struct Row {
    case: Case,
    cells: [String; 7],
}

static ROWS: Mutex<Vec<Row>> = Mutex::new(Vec::new());

const HEAD: [&str; 8] =
    ["case", "tried", "equations", "iterations", "factorisations", "increments", "result", "verdict"];

/// Prints a row and rewrites the Markdown file, so that the file is complete after any test.
pub(crate) fn row(case: Case, tried: &str, cost: Cost, result: &str, verdict: &str) {
    let count = |n: u64| if n == 0 { "-".to_owned() } else { n.to_string() };
    let cells = [
        tried.to_owned(),
        count(cost.equations as u64),
        count(cost.iterations.into()),
        count(cost.factorisations.into()),
        count(cost.increments.into()),
        result.to_owned(),
        verdict.to_owned(),
    ];
    println!("{} | {}", case.title(), cells.join(" | "));
    let mut rows = ROWS.lock().unwrap_or_else(PoisonError::into_inner);
    rows.push(Row { case, cells });
    let Some(path) = std::env::var_os("PALPATE_HARD_TABLE") else { return };
    // A stable sort keeps the rows of a case in order.
    rows.sort_by_key(|row| row.case);
    std::fs::write(&path, markdown(&rows)).expect("the file PALPATE_HARD_TABLE is writable");
}

fn markdown(rows: &[Row]) -> String {
    let mut text = format!("| {} |\n|{}\n", HEAD.join(" | "), "---|".repeat(HEAD.len()));
    for Row { case, cells } in rows {
        let cells = cells.each_ref().map(|cell| cell.replace('|', "\\|"));
        writeln!(text, "| {} | {} |", case.title(), cells.join(" | "))
            .expect("writing to a string cannot fail");
    }
    text
}

#[test]
fn markdown_has_a_cell_for_every_column() {
    let row = Row { case: Case::Units, cells: std::array::from_fn(|i| format!("|{i}")) };
    let text = markdown(&[row]);
    let cells = |line: &str| line.replace("\\|", "").matches('|').count();
    assert_eq!(text.lines().count(), 3);
    assert!(text.lines().all(|line| cells(line) == HEAD.len() + 1), "{text}");
}
