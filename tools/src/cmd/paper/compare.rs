//! `palpate paper compare`: the same pull of a body with several laws, in one picture.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use clap::Args as ClapArgs;
use palpate_precompute::fem::material::LAWS;
use palpate_precompute::fem::{Configuration, Solver};
use palpate_precompute::mesh::Surface;
use palpate_precompute::num::norm;
use palpate_precompute::pipeline::Analysis;
use palpate_viewer::comparison::{Comparison, DeformedShape, draw};
use palpate_viewer::frames::still;
use serde::Serialize;

use crate::analysis;
use crate::cmd::path::direction;
use crate::failure::Failure;
use crate::files::{FileKind, Files, Output, Replace};
use crate::interrupt::stop_flag;
use crate::output::{self, Csv, Table};
use crate::progress::WorkProgress;

/// Pull one body with several laws; draw the shapes in one picture.
///
/// The active node moves from rest along DIRECTION in steps of about 1 mm (the solver halves a step that does
/// not converge), once per law. The laws agree at small strain, so only the law differs: each takes the
/// moduli of the scene's material, region by region. From Mooney-Rivlin, E = 6 (C10 + C01) and nu = 0.49 for
/// the laws without a pressure, as in the paper (or nu from `bulk_pa`, where the scene has it); from Lame's
/// constants, C10 = C01 = mu / 4.
///
/// In the picture the scene's own law (or the last of --laws) is solid. Each other law is transparent, in its
/// own colour, with its outline, and its mesh outside the solid. The grey outline is the shape at rest. The
/// camera shows the pull from the side. A law that fails is drawn, and tabled, at its last converged step;
/// the exit code is 1. Ctrl-C keeps the rows of the laws so far, the last one at its last converged step; no
/// picture is drawn.
///
/// Example: palpate paper compare liver.toml --active A1 --direction=0,0,1 --length-mm 40 --out laws.png
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
    /// PNG file to write
    #[arg(long, value_name = "FILE.png")]
    out: PathBuf,
    /// Size of the picture in pixels
    #[arg(long, value_name = "WxH", value_parser = size, default_value = "1280x720")]
    size: (usize, usize),
    /// Also write the figures to this file
    #[arg(long, value_name = "FILE.csv")]
    csv: Option<PathBuf>,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    replace: Replace,
}

fn size(text: &str) -> Result<(usize, usize), String> {
    let sides = text.split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    match sides {
        Some((w @ 320..=4096, h @ 240..=4096)) => Ok((w, h)),
        _ => Err("give width x height in pixels, as in 1280x720, from 320x240 to 4096x4096".into()),
    }
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

/// A solved law: its figures and the position of every mesh vertex.
struct Outcome {
    row: Row,
    rest_m: Vec<[f64; 3]>,
    position_m: Vec<[f64; 3]>,
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    check(args)?;
    let (width, height) = args.size;
    let mut files = Files::new(args.replace);
    files.read_scene(&args.scene)?;
    let png = files.write("--out", &args.out, FileKind::Png)?;
    let csv = args.csv.as_ref().map(|path| files.write("--csv", path, FileKind::Table)).transpose()?;
    let stop = stop_flag()?;
    let bench = analysis::load(&args.scene)?;
    let (_, active) = bench.active(args.active.as_deref())?;
    let benches =
        args.laws.iter().map(|law| Ok((law, by_law(&bench, law)?))).collect::<Result<Vec<_>, Failure>>()?;
    let pull = Pull { node: active.node, direction: args.direction, length_m: 1e-3 * args.length_mm };
    let mut outcomes = Vec::new();
    let mut progress = WorkProgress::new("compare", "steps");
    for (n, (law, bench)) in benches.iter().enumerate() {
        let doing = format!("law {} of {}: {law}", n + 1, benches.len());
        let mut step = |done| progress.steps(&doing, n * pull.steps() + done, benches.len() * pull.steps());
        outcomes.push(pull.solve(law, bench, &stop, &mut step)?);
        if stop.load(Ordering::Relaxed) {
            progress.finish();
            write_rows(&outcomes, csv.as_ref(), args.json)?;
            return Err(Failure::work("interrupted; the rows so far are kept, no picture is drawn"));
        }
    }
    progress.phase("picture");
    let image = draw(&picture(&bench, &pull, &outcomes), width, height);
    png.put(&still(&image).map_err(|error| png.failure(&error))?)?;
    progress.finish();
    write_rows(&outcomes, csv.as_ref(), args.json)?;
    let rows = outcomes.iter().map(|o| &o.row);
    let failed: Vec<&str> = rows.filter(|row| row.status != "ok").map(|row| row.law.as_str()).collect();
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
fn write_rows(outcomes: &[Outcome], csv: Option<&Output>, as_json: bool) -> Result<(), Failure> {
    if let Some(file) = csv {
        file.put(&table(outcomes)?)?;
    }
    let rows: Vec<&Row> = outcomes.iter().map(|o| &o.row).collect();
    if as_json {
        return output::json(&rows);
    }
    output::line(text(&rows))
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
    if !args.out.extension().is_some_and(|e| e.eq_ignore_ascii_case("png")) {
        return Err(Failure::input(format!(
            "--out {}: the picture is a PNG; end it with .png",
            args.out.display()
        )));
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
    ) -> Result<Outcome, Failure> {
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
                        "palpate: {law}: {failure} on the way to {mm:.1} mm; the last converged state is shown"
                    );
                    break;
                }
            }
        }
        let row = Row {
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
        };
        Ok(Outcome { row, rest_m: positions(bench, &rest), position_m: positions(bench, &here) })
    }
}

/// Positions of the mesh vertices.
fn positions(bench: &Analysis, c: &Configuration) -> Vec<[f64; 3]> {
    let moved = c.seed.state.as_chunks::<3>().0;
    let vertices = bench.scene.mesh.nodes_m.iter();
    vertices.zip(moved).map(|(rest, u)| std::array::from_fn(|axis| rest[axis] + u[axis])).collect()
}

fn picture(bench: &Analysis, pull: &Pull, outcomes: &[Outcome]) -> Comparison {
    let &Pull { node, direction, length_m } = pull;
    let scene = &bench.scene;
    let skin = Surface::of(&scene.mesh);
    let on_skin = |all: &[[f64; 3]]| -> Vec<[f32; 3]> {
        skin.nodes.iter().map(|&node| all[node as usize].map(|x| x as f32)).collect()
    };
    let vertex =
        |node: &u32| skin.nodes.binary_search(node).expect("corners are among the skin's nodes") as u32;
    let own = scene.materials[0].material.name();
    let solid = outcomes.iter().position(|o| o.row.law == own).unwrap_or(outcomes.len() - 1);
    // The state at rest depends on the law if there is a body force; that of the solid is drawn.
    let rest_m = &outcomes[solid].rest_m;
    let from = rest_m[node as usize];
    let to: [f64; 3] = std::array::from_fn(|axis| from[axis] + length_m * direction[axis]);
    let name = scene.active.iter().find(|a| a.node == node).map_or("", |a| a.name.as_str());
    let [x, y, z] = direction;
    let shapes = outcomes.iter().map(|Outcome { row, position_m, .. }| DeformedShape {
        name: row.law.clone(),
        position_m: on_skin(position_m),
        values: vec![
            ["force |h|".into(), format!("{:.2} N", row.force_norm_n)],
            ["volume".into(), percent(row.volume_change)],
            ["smallest J".into(), format!("{:.2}", row.min_jacobian).replace('-', "\u{2212}")],
        ],
        note: note(row),
    });
    Comparison {
        title: "one pull, several laws".into(),
        subtitle: vec![format!(
            "{}  \u{b7}  {name} moved by {} mm along ({}, {}, {})",
            scene.name,
            figure(1e3 * length_m),
            figure(x),
            figure(y),
            figure(z)
        )],
        triangles: skin.triangles.iter().map(|t| t.each_ref().map(vertex)).collect(),
        fixed: skin.nodes.iter().map(|node| scene.fixed.binary_search(node).is_ok()).collect(),
        pull_m: [from, to].map(|p| p.map(|x| x as f32)),
        outward: skin.normal(node).unwrap_or_default().map(|x| x as f32),
        shapes: shapes.collect(),
        rest_m: on_skin(rest_m),
        solid,
    }
}

/// Additional information on a law for the reader of the picture.
fn note(row: &Row) -> Option<String> {
    if row.status != "ok" {
        return Some(format!("failed: shown at {:.1} mm", 1e3 * row.length_m));
    }
    match row.inverted {
        0 => None,
        1 => Some("1 inverted element".into()),
        n => Some(format!("{n} inverted elements")),
    }
}

/// Two decimals, without a minus sign before zero.
fn figure(value: f64) -> String {
    let text = format!("{value:.2}");
    if text == "-0.00" {
        "0".into()
    } else {
        text.trim_end_matches('0').trim_end_matches('.').replace('-', "\u{2212}")
    }
}

/// A signed percentage; a value that rounds to zero has no sign.
fn percent(share: f64) -> String {
    let text = format!("{:+.2} %", 100.0 * share);
    match text.as_str() {
        "+0.00 %" | "-0.00 %" => "0.00 %".into(),
        _ => text.replace('-', "\u{2212}"),
    }
}

const HEADER: &str = "law,status,length_m,asked_m,fx_n,fy_n,fz_n,force_n,volume_change,min_jacobian,inverted,newton_iterations";

fn table(outcomes: &[Outcome]) -> Result<Vec<u8>, Failure> {
    let mut table = Csv::new(HEADER.split(','))?;
    for Outcome { row, .. } in outcomes {
        table.row(row)?;
    }
    table.finish()
}

fn text(rows: &[&Row]) -> Table {
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
