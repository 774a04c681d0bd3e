//! The table of results, printed row by row as Markdown.

use palpate_precompute::fem::Configuration;

/// The cases, in the order of the table.
#[derive(Debug, Clone, Copy)]
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

/// Prints a row: case, what was tried, equations, iterations, factorisations, increments, result, verdict.
pub(crate) fn row(case: Case, tried: &str, cost: Cost, result: &str, verdict: &str) {
    let Cost { equations, iterations, factorisations, increments } = cost;
    let title = case.title();
    println!(
        "| {title} | {tried} | {equations} | {iterations} | {factorisations} | {increments} | {result} | {verdict} |"
    );
}
