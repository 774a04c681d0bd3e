//! `palpate paper compare`: the same pull of a body with several laws.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use clap::Args as ClapArgs;
use palpate_precompute::fem::Solver;
use palpate_precompute::fem::material::LAWS;
use palpate_precompute::num::norm;
use palpate_precompute::pipeline::Analysis;
use serde::Serialize;

use crate::analysis;
use crate::cmd::path::direction;
use crate::failure::Failure;
use crate::files::{FileKind, Files, Output, Replace};
use crate::interrupt::stop_flag;
use crate::output::{self, Csv, Table};
use crate::progress::WorkProgress;

/// Pull one body with several laws; compare force and volume.
///
/// The active node moves from rest along DIRECTION in steps of about 1 mm (the solver halves a step that does
/// not converge), once per law. The laws agree at small strain, so only the law differs: each takes the
/// moduli of the scene's material, region by region. From Mooney-Rivlin, E = 6 (C10 + C01) and nu = 0.49 for
/// the laws without a pressure, as in the paper (or nu from `bulk_pa`, where the scene has it); from Lame's
/// constants, C10 = C01 = mu / 4.
///
/// The figures of a law that fails are those of its last converged step; the exit code is 1. Ctrl-C keeps the
/// rows of the laws so far, the last one at its last converged step. `palpate path --displacements` with a
/// scene of each law gives the shapes for ParaView.
///
/// Example: palpate paper compare liver.toml --active A1 --direction=0,0,1 --length-mm 40
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// Scene file (TOML)
    scene: PathBuf,
    /// Active node to move; the scene's first if not given
    #[arg(long, value_name = "NAME")]
    active: Option<String>,
    /// Direction; its length does not matter
    #[arg(long, value_name = "X,Y,Z", value_parser = direction, allow_hyphen_values = true)]
    direction: [f64; 3],
    /// How far the node is moved, mm
    #[arg(long, value_name = "MM", allow_hyphen_values = true)]
    length_mm: f64,
    /// Laws to compare, at least two, by their names in a scene file
    #[arg(
        long,
        value_name = "L,L",
        value_delimiter = ',',
        default_value = "linear,st-venant-kirchhoff,mooney-rivlin"
    )]
    laws: Vec<String>,
    /// Also write the figures to this file
    #[arg(long, value_name = "FILE.csv")]
    csv: Option<PathBuf>,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    replace: Replace,
}

/// Longest step of the loading, mm.
const STEP_MM: f64 = 1.0;
/// A larger number of steps is an input error.
const MAX_STEPS: f64 = 10_000.0;

/// Result of one law.
#[derive(Debug, Serialize)]
struct Row {
    law: String,
    status: &'static str,
    /// Reached and requested displacement, m.
    length_m: f64,
    asked_m: f64,
    /// Force of the tool on the body, N.
    force_n: [f64; 3],
    force_norm_n: f64,
    /// Volume relative to that at rest, minus 1.
    volume_change: f64,
    min_jacobian: f64,
    inverted: usize,
    newton_iterations: u32,
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    check(args)?;
    let mut files = Files::new(args.replace);
    files.read_scene(&args.scene)?;
    let csv = args.csv.as_ref().map(|path| files.write("--csv", path, FileKind::Table)).transpose()?;
    let stop = stop_flag()?;
    let bench = analysis::load(&args.scene)?;
    let (_, active) = bench.active(args.active.as_deref())?;
    let benches =
        args.laws.iter().map(|law| Ok((law, by_law(&bench, law)?))).collect::<Result<Vec<_>, Failure>>()?;
    let pull = Pull { node: active.node, direction: args.direction, length_m: 1e-3 * args.length_mm };
    let mut rows = Vec::new();
    let mut progress = WorkProgress::new("compare", "steps");
    for (n, (law, bench)) in benches.iter().enumerate() {
        let doing = format!("law {} of {}: {law}", n + 1, benches.len());
        let mut step = |done| progress.steps(&doing, n * pull.steps() + done, benches.len() * pull.steps());
        rows.push(pull.solve(law, bench, &stop, &mut step)?);
        if stop.load(Ordering::Relaxed) {
            progress.finish();
            write_rows(&rows, csv.as_ref(), args.json)?;
            return Err(Failure::work("interrupted; the rows so far are kept"));
        }
    }
    progress.finish();
    write_rows(&rows, csv.as_ref(), args.json)?;
    let failed: Vec<&str> =
        rows.iter().filter(|row| row.status != "ok").map(|row| row.law.as_str()).collect();
    if failed.is_empty() {
        return Ok(());
    }
    Err(Failure::work(format!(
        "{} did not reach {} mm; use a shorter pull, or omit the law with --laws",
        failed.join(", "),
        args.length_mm
    )))
}

/// Writes the figures to the CSV file, if requested, and to standard output.
fn write_rows(rows: &[Row], csv: Option<&Output>, as_json: bool) -> Result<(), Failure> {
    if let Some(file) = csv {
        file.put(&table(rows)?)?;
    }
    if as_json {
        return output::json(&rows);
    }
    output::line(text(rows))
}

/// Checks the arguments before the solves.
fn check(args: &Args) -> Result<(), Failure> {
    let steps = args.length_mm / STEP_MM;
    if !(steps > 0.0 && steps <= MAX_STEPS) {
        return Err(Failure::input(format!(
            "--length-mm {}: give a positive number of millimetres, at most {}",
            args.length_mm,
            MAX_STEPS * STEP_MM
        )));
    }
    for (index, law) in args.laws.iter().enumerate() {
        if !LAWS.contains(&law.as_str()) {
            return Err(Failure::input(format!("--laws: no law `{law}`; choose from {}", LAWS.join(", "))));
        }
        if args.laws[..index].contains(law) {
            return Err(Failure::input(format!("--laws: `{law}` is given twice; name each law once")));
        }
    }
    if args.laws.len() < 2 {
        return Err(Failure::input(
            "--laws: a comparison needs two laws; give two or more, separated by commas",
        ));
    }
    Ok(())
}

/// The same scene with the law of every region replaced.
pub(crate) fn by_law(bench: &Analysis, law: &str) -> Result<Analysis, Failure> {
    let mut scene = bench.scene.clone();
    for (region, own) in scene.materials.iter_mut().zip(bench.scene.model().regions) {
        let found = own
            .counterpart(law)
            .map_err(|error| Failure::input(format!("--laws: {} as {law}: {error}", own.material.name())))?;
        (region.material, region.bulk_modulus_pa) = (found.material, found.bulk_modulus_pa);
    }
    let body =
        scene.body().map_err(|error| Failure::work(format!("{} by {law}: {error}", bench.path.display())))?;
    Ok(Analysis { path: bench.path.clone(), scene, body: Arc::new(body) })
}

/// The load that is applied with every law.
struct Pull {
    node: u32,
    /// Unit vector.
    direction: [f64; 3],
    length_m: f64,
}

impl Pull {
    fn steps(&self) -> usize {
        (1e3 * self.length_m / STEP_MM).ceil() as usize
    }

    /// Displaces the active node up to the target, a failure, or `stop`. Calls `solved` with the number of
    /// solved steps.
    fn solve(
        &self,
        law: &str,
        bench: &Analysis,
        stop: &AtomicBool,
        solved: &mut dyn FnMut(usize),
    ) -> Result<Row, Failure> {
        let nodes = &bench.scene.active;
        let active = nodes.iter().find(|a| a.node == self.node).expect("every law has the scene's nodes");
        let mut solver = Solver::new(bench.problem(active));
        let rest = solver.rest().map_err(|failure| {
            Failure::work(format!("{} by {law}: no solution at rest: {failure}", bench.path.display()))
        })?;
        let steps = self.steps();
        solved(0);
        let mut here = rest.clone();
        let (mut iterations, mut status) = (0, "ok");
        for step in 1..=steps {
            if stop.load(Ordering::Relaxed) {
                status = "interrupted";
                break;
            }
            let length_m = self.length_m * step as f64 / steps as f64;
            match solver.advance(&here.seed, self.direction.map(|x| x * length_m)) {
                Ok(next) => {
                    iterations += next.iterations;
                    here = next;
                    solved(step);
                }
                Err(failure) => {
                    iterations += failure.iterations;
                    status = "failed";
                    let mm = 1e3 * length_m;
                    eprintln!(
                        "palpate: {law}: {failure} on the way to {mm:.1} mm; its row is that of the last converged step"
                    );
                    break;
                }
            }
        }
        Ok(Row {
            law: law.to_string(),
            status,
            length_m: norm(here.seed.pose.displacement_m),
            asked_m: self.length_m,
            force_n: here.jet().force_n,
            force_norm_n: norm(here.jet().force_n),
            volume_change: here.volume_m3 / rest.volume_m3 - 1.0,
            min_jacobian: here.min_jacobian,
            inverted: here.inverted,
            newton_iterations: iterations,
        })
    }
}

const HEADER: &str = "law,status,length_m,asked_m,fx_n,fy_n,fz_n,force_n,volume_change,min_jacobian,inverted,newton_iterations";

fn table(rows: &[Row]) -> Result<Vec<u8>, Failure> {
    let mut table = Csv::new(HEADER.split(','))?;
    for row in rows {
        table.row(row)?;
    }
    table.finish()
}

fn text(rows: &[Row]) -> Table {
    let header = ["law", "status", "pull, mm", "|h|, N", "volume, %", "smallest J", "inverted", "iterations"];
    let mut table = Table::new(2, header);
    for row in rows {
        table.row([
            row.law.clone(),
            row.status.into(),
            format!("{:.2}", 1e3 * row.length_m),
            format!("{:.3}", row.force_norm_n),
            format!("{:+.4}", 100.0 * row.volume_change),
            format!("{:.3}", row.min_jacobian),
            row.inverted.to_string(),
            row.newton_iterations.to_string(),
        ]);
    }
    table
}
