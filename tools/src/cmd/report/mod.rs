//! `palpate report`: errors and cost of every method, as tables, plots and one page.
//!
//! [`plan`] defines the cases. [`solve`] makes the spaces and held-out solutions, [`tables`] the blobs with
//! their certificates, [`measure`] the rows of the main tables, [`curves`] the finite-element curves by law.
//! [`files`] writes CSV and JSON, and [`page`] the page with its drawings. The code contains no
//! result that the page shows.

mod args;
mod curves;
mod files;
mod measure;
mod outputs;
mod page;
mod plan;
mod results;
mod solve;
mod tables;

use std::path::PathBuf;
use std::time::Instant;

pub(crate) use args::Args;

use crate::analysis::threads;
use crate::failure::Failure;
use crate::interrupt::stop_flag;
use crate::output;

use crate::machine::{Machine, Ticks};
use crate::steps::Steps;
use outputs::PAGE;
use plan::Plan;
use results::Report;

/// Number of timing rounds.
const ROUNDS: usize = 5;

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let (started, ticks) = (Instant::now(), Ticks::now());
    let (stop, threads) = (stop_flag()?, threads(args.threads)?);
    let plan = Plan::new(args, threads)?;
    let cases = plan.families.len() * plan.grids.len();
    let mut steps = Steps::new(3 * cases + 3, stop);
    let mut measured = Vec::new();
    for family in &plan.families {
        let (mut of_family, mut sibling) = (Vec::new(), None);
        for &grid in &plan.grids {
            let case = family.on_grid(grid)?;
            let path: &mut Option<PathBuf> = &mut sibling;
            of_family.push(measure::measured(&plan, family, &case, path.as_deref(), args.again, &mut steps)?);
            path.get_or_insert_with(|| plan.work.path().join(format!("{}.space", case.name)));
        }
        measured.push(of_family);
    }
    let curves = curves::measured(&plan, &plan.families[0], &mut steps)?;
    steps.next("times of the queries")?;
    for case in measured.iter_mut().flatten() {
        case.time(ROUNDS)?;
    }
    steps.next("tables and page")?;
    let machine = Machine::here(threads, ticks, started.elapsed().as_secs_f64());
    let report = Report { plan, cases: measured, curves, machine };
    files::write(&report, &report.plan.out)?;
    let page = report.plan.out.file(PAGE);
    page::write(&report, &page)?;
    if args.json {
        let rows: Vec<_> = report.cases.iter().flatten().flat_map(|case| &case.methods).collect();
        return output::line(serde_json::to_string_pretty(&rows).map_err(Failure::work)?);
    }
    output::line(format!("{}: written, with its tables as CSV and JSON beside it", page.path().display()))
}
