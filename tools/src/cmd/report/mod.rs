//! `palpate report`: what every method is worth and what it costs, as tables, plots and one page.
//!
//! [`plan`] says what is measured; [`solve`] makes the spaces and the truth, [`tables`] the blobs with their certificates, [`measure`]
//! the rows of the main tables; [`bodies`], [`curves`], [`hard`], [`parts`], [`ledger`] and [`forms`] the rest; [`files`] writes CSV and JSON; [`page`] the page, with
//! the drawings of [`plot`]. No number of the page is in the code.

mod bodies;
mod curves;
mod files;
mod forms;
mod hard;
mod ledger;
mod machine;
mod measure;
mod page;
mod parts;
mod plan;
mod plot;
mod solve;
mod steps;
mod tables;
mod words;

use std::path::PathBuf;
use std::time::Instant;

use clap::Args as ClapArgs;
use palpate_core::Method;

use super::bench::forms::FormRow;
use crate::analysis::threads;
use crate::failure::Failure;
use crate::files::Replace;
use crate::interrupt::stop_flag;
use crate::output;

use bodies::BodyRow;
use curves::CurveRow;
use hard::HardRow;
use ledger::LedgerRow;
use machine::{Machine, Ticks};
use measure::Measured;
use parts::{PartsRow, SurfaceRow};
use plan::Plan;
use steps::Steps;

/// Measure speed against error of every method on several grids, and write tables, plots and one page.
///
/// Spaces, held-out truth and blobs are kept in DIR/work and used again: after Ctrl-C the same command goes on. The page is
/// DIR/report.html; it needs no other file and prints well. Beside it stand its tables as CSV and JSON.
///
/// Without a scene the bundled organ is measured, by Mooney-Rivlin and by St. Venant-Kirchhoff. Of every scene one active node is
/// used, with the scene's own force limit and completion of cells.
///
/// Example: palpate report --out report --grids 514,1418
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// Scene files (TOML); the bundled organ if none is given
    scenes: Vec<PathBuf>,
    /// Folder for the page, its tables, and what is solved for them
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Coarse grids and little truth: done in a minute, good for a look
    #[arg(long)]
    small: bool,
    /// Grid points along r_G's ball, several with commas: 514,1418,4168,14146 if not given
    #[arg(long, value_name = "N,M", value_delimiter = ',')]
    grids: Vec<u32>,
    /// Methods, several with commas
    #[arg(long, value_delimiter = ',', value_parser = super::pack::method, default_values = Method::OF_LATTICE.map(Method::name))]
    methods: Vec<Method>,
    /// r_G in mm; each scene's own if not given (20 for the bundled organ with --small)
    #[arg(long, value_name = "MM", allow_negative_numbers = true)]
    radius_mm: Option<f64>,
    /// Active node; each scene's first if not given
    #[arg(long)]
    active: Option<String>,
    /// Fit and measure all tables again, even if the blobs are there
    #[arg(long)]
    fit_again: bool,
    /// Worker threads; one a core if not given
    #[arg(long)]
    threads: Option<usize>,
    /// Print the table of methods as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    replace: Replace,
}

/// Everything that the page shows.
#[derive(Debug)]
struct Report {
    plan: Plan,
    /// Family by family, and in each grid by grid.
    cases: Vec<Vec<Measured>>,
    bodies: Vec<BodyRow>,
    curves: Vec<CurveRow>,
    hard: Vec<HardRow>,
    parts: (Vec<PartsRow>, Vec<SurfaceRow>),
    ledger: Vec<LedgerRow>,
    forms: Vec<FormRow>,
    machine: Machine,
}

/// Name of the page.
const PAGE: &str = "report.html";

/// Rounds of timing.
const ROUNDS: usize = 5;

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let (started, ticks) = (Instant::now(), Ticks::now());
    let (stop, threads) = (stop_flag()?, threads(args.threads));
    let plan = Plan::new(args, threads)?;
    let cases = 3 * plan.families.len() * plan.grids.len();
    let total = cases
        + bodies::steps(&plan)
        + 1
        + hard::steps(&plan)
        + parts::STEPS
        + ledger::STEPS
        + forms::STEPS
        + 2;
    let mut steps = Steps::new(total, stop);
    let mut measured = Vec::new();
    for family in &plan.families {
        let (mut of_family, mut sibling) = (Vec::new(), None);
        for &grid in &plan.grids {
            let case = family.on_grid(grid)?;
            let path: &mut Option<PathBuf> = &mut sibling;
            of_family.push(measure::measured(
                &plan,
                family,
                &case,
                path.as_deref(),
                args.fit_again,
                &mut steps,
            )?);
            path.get_or_insert_with(|| plan.work.path().join(format!("{}.space", case.name)));
        }
        measured.push(of_family);
    }
    let first = &plan.families[0];
    let curves = curves::measured(&plan, first, &mut steps)?;
    let bodies = bodies::measured(&plan, &mut steps)?;
    let hard = hard::measured(&plan, plan.grids[0], args.fit_again, &mut steps)?;
    let parts = parts::measured(&plan, &plan.families[0], plan.grids[0], &mut steps)?;
    let case = first.on_grid(plan.grids[0])?;
    let ledger = ledger::measured(&plan, &case, &measured[0][0], &mut steps)?;
    let forms = forms::measured(&plan, first, &mut steps)?;
    steps.next("times of the queries")?;
    for case in measured.iter_mut().flatten() {
        case.time(ROUNDS)?;
    }
    steps.next("tables and page")?;
    let machine = Machine::here(threads, ticks, started.elapsed().as_secs_f64());
    let report = Report { plan, cases: measured, bodies, curves, hard, parts, ledger, forms, machine };
    files::write(&report, &report.plan.out)?;
    let page = report.plan.out.file(PAGE);
    page::write(&report, &page)?;
    if args.json {
        let rows: Vec<_> = report.cases.iter().flatten().flat_map(|case| &case.methods).collect();
        return output::line(serde_json::to_string_pretty(&rows).map_err(Failure::work)?);
    }
    output::line(format!("{}: written, with its tables as CSV and JSON beside it", page.path().display()))
}
