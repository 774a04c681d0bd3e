//! `palpate demo --precomputed`: solve, pack, touch and check, all steps on the bundled organ.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use palpate_core::{Method, Organ};
use palpate_host::SessionSummary;
use palpate_host::device::script::StrokeConfig;
use palpate_host::device::simulated::{SimulatedConfig, SimulatedHand};
use palpate_precompute::certificate::Certificate;
use palpate_precompute::held_out::Draw;
use palpate_precompute::pack::{PackOptions, Packed};
use palpate_precompute::pipeline::{Analysis, DISCRETISATION_POSITIONS, Run, certified, discretisation_in};
use palpate_precompute::space::{Store, TagCounts};
use serde_json::json;

use super::super::inspect::certificate::as_text;
use super::super::inspect::overview;
use super::Args;
use crate::analysis::{self, open_space, threads};
use crate::failure::Failure;
use crate::files::{FileKind, Files, Output};
use crate::interrupt::stop_flag;
use crate::output::{Csv, Table};
use crate::progress::WorkProgress;
use crate::timing::Timing;
use crate::touch::Source;
use crate::truth::{self, Checked, MethodError, Visit};
use crate::{blob, output, summary, touch};

/// Number of positions at which the force is checked.
const CHECKS: usize = 100;

/// Summary of the solves.
struct Solved {
    names: Vec<String>,
    counts: Vec<TagCounts>,
    solved_now: usize,
    seconds: f64,
    threads: usize,
}

impl Solved {
    fn configurations(&self) -> usize {
        self.counts.iter().map(TagCounts::solved).sum()
    }
}

/// Files of the demo other than its numbered pictures.
struct Outputs {
    space: Output,
    blob: Output,
    certificate: Output,
    forces: Output,
    summary: Output,
}

impl Outputs {
    fn of(args: &Args, files: &mut Files) -> Result<Self, Failure> {
        let mut at = |name: &str, kind| files.write("--out", &args.out.join(name), kind);
        Ok(Self {
            space: at("demo.space", FileKind::Space)?,
            blob: at("demo.blob", FileKind::Blob)?,
            certificate: at("certificate.txt", FileKind::Text)?,
            forces: at("forces.csv", FileKind::Table)?,
            summary: at("summary.json", FileKind::Json)?,
        })
    }
}

/// Runs the command in its folder, which holds the scene.
pub(super) fn run(args: &Args, files: &mut Files, bundled: &super::Organ) -> Result<(), Failure> {
    let stop = stop_flag()?;
    let outputs = Outputs::of(args, files)?;
    let bench = analysis::load(bundled.put()?)?;
    if args.again {
        outputs.space.remove_database()?;
    }
    let store = open_space(&bench, &outputs.space, false)?;
    let solved = solve(&bench, &store, &stop)?;
    let (packed, certificate) = pack(&bench, &store, solved.threads, &stop)?;
    // From here on the spaces of the blob and the active nodes of the scene have the same numbers.
    if !packed.nodes_without_data.is_empty() {
        return Err(Failure::work(format!(
            "nothing could be solved around {}",
            packed.nodes_without_data.join(", ")
        )));
    }
    let bytes = packed.bytes()?;
    outputs.blob.put(&bytes)?;
    outputs.certificate.put(as_text(&certificate).as_bytes())?;

    let file = blob::load(outputs.blob.path())?;
    let organ = blob::organ(outputs.blob.path(), &file)?;
    let (touched, visits) = palpate(args, &organ, &args.out.join("frames"), &stop)?;
    if stop.load(Ordering::Relaxed) {
        return Err(Failure::work("interrupted; the force on the hand is zero, the spaces are kept"));
    }
    touch::judge(&touched.summary)?;

    let errors = errors(&bench, &store, &organ, &visits, (solved.threads, &stop))?;
    write_forces(&outputs.forces, &bench, &organ, &errors.checked)?;
    let figures = figures(args, &solved, bytes.len(), &touched, &errors.errors, errors.checked.len());
    let text = serde_json::to_string_pretty(&figures).map_err(Failure::work)?;
    outputs.summary.put(text.as_bytes())?;
    if args.json {
        return output::line(text);
    }
    let result = Outcome { bench: &bench, solved: &solved, certificate: &certificate, errors: &errors };
    output::line(result.in_words(args, bytes.len(), &touched.summary))
}

/// The results of the steps.
struct Outcome<'a> {
    bench: &'a Analysis,
    solved: &'a Solved,
    certificate: &'a Certificate,
    errors: &'a Errors,
}

impl Outcome<'_> {
    /// The verdict, the steps, and the errors of the methods.
    fn in_words(&self, args: &Args, blob_bytes: usize, summary: &SessionSummary) -> String {
        let Self { bench, solved, certificate, errors } = self;
        let rendered = errors.rendered();
        let first = format!(
            "{}; the rendered force is within {:.3} mN of {} new finite-element solves",
            overview::verdict_in_words(certificate),
            1e3 * rendered.max_n,
            errors.checked.len()
        );
        let scene = &bench.scene;
        let (nodes, tets) = (scene.mesh.nodes_m.len(), scene.mesh.tets.len());
        let organ = format!("{}: {nodes} nodes, {tets} tetrahedra, {}", scene.name, bench.body.law_names());
        let count = solved.configurations();
        let solve = format!(
            "{count} configurations of {} active nodes, {} of them now, in {:.1} s on {} threads",
            solved.names.len(),
            solved.solved_now,
            solved.seconds,
            solved.threads
        );
        let (megabytes, out) = (blob_bytes as f64 * 1e-6, args.out.display());
        let unsolved = match errors.unsolved {
            0 => String::new(),
            n => format!(", {n} more unsolved"),
        };
        format!(
            "{first}\n\norgan    {organ}\nsolved   {solve}\npacked   {megabytes:.2} MB, {} methods, certified at {HELD_OUT} positions a node\n\
             touched  {}\n\n{}\n\nforce error at {} visited positions{unsolved}\n{}\n\n\
             in {out}/: certificate.txt (all errors), forces.csv, summary.json, frames/, demo.blob for `palpate run`",
            Method::OF_LATTICE.len(),
            summary::headline(summary),
            overview::nodes(certificate),
            errors.checked.len(),
            error_table(&errors.errors, args.method)
        )
    }
}

/// Errors of every method and of the session at visited positions.
struct Errors {
    checked: Vec<Checked>,
    unsolved: usize,
    errors: Vec<MethodError>,
}

impl Errors {
    /// The errors of the forces that the session rendered.
    fn rendered(&self) -> &MethodError {
        self.errors.last().expect("the session's are the last")
    }
}

fn errors(
    bench: &Analysis,
    store: &Store,
    organ: &Organ<'_>,
    visits: &[Visit],
    (threads, stop): (usize, &AtomicBool),
) -> Result<Errors, Failure> {
    let chosen = spread(visits, CHECKS);
    let (checked, unsolved) = truth::check(bench, store, &chosen, threads, stop)?;
    let errors = Method::OF_LATTICE
        .iter()
        .filter_map(|method| truth::method_error(organ, *method, &checked))
        .chain([truth::loop_error(&checked)])
        .collect();
    Ok(Errors { checked, unsolved, errors })
}

/// Solves held-out positions, then fits and measures the tables.
fn pack(
    bench: &Analysis,
    store: &Store,
    threads: usize,
    stop: &AtomicBool,
) -> Result<(Packed, Certificate), Failure> {
    hold_out(bench, store, threads, stop)?;
    let progress = Mutex::new(WorkProgress::new("demo", "positions"));
    let run = Run { threads, stop };
    let solved = discretisation_in(bench, store, DISCRETISATION_POSITIONS, run, |done, all| {
        let mut progress = progress.lock().unwrap_or_else(PoisonError::into_inner);
        progress.steps("more accurate elements", done, all);
    });
    progress.into_inner().unwrap_or_else(PoisonError::into_inner).finish();
    solved?;
    let mut progress = WorkProgress::new("demo", "");
    progress.phase("tables and certificate");
    let options = PackOptions { methods: &Method::OF_LATTICE, use_intermediate_states: false, threads };
    let packed = certified(store, &options);
    progress.finish();
    Ok(packed?)
}

fn solve(bench: &Analysis, store: &Store, stop: &AtomicBool) -> Result<Solved, Failure> {
    let start = Instant::now();
    let mut solved = Solved {
        names: bench.scene.active.iter().map(|a| a.name.clone()).collect(),
        counts: Vec::new(),
        solved_now: 0,
        seconds: 0.0,
        threads: threads(None)?,
    };
    let mut progress = WorkProgress::new(&bench.scene.name, "solves");
    let all: Vec<usize> = (0..bench.scene.active.len()).collect();
    let counts = bench.solve(&all, store, Run { threads: solved.threads, stop }, |p| {
        solved.solved_now = p.solved_now;
        progress.spaces(p);
    });
    progress.finish();
    solved.counts = counts?;
    solved.seconds = start.elapsed().as_secs_f64();
    Ok(solved)
}

/// Uniform positions per node for a quick certificate, without a bound on the last percent.
const HELD_OUT: u32 = 60;

fn hold_out(bench: &Analysis, store: &Store, threads: usize, stop: &AtomicBool) -> Result<(), Failure> {
    let actives: Vec<usize> = (0..bench.scene.active.len()).collect();
    let draw = Draw { regular_m: None, random: 0, uniform: HELD_OUT, ..Draw::PAPER };
    let mut progress = WorkProgress::new("demo", "positions");
    let held_out = bench.held_out(&actives, draw)?;
    let solved = bench.solve_held_out(&held_out, store, Run { threads, stop }, |p| progress.held_out(p));
    progress.finish();
    Ok(solved?)
}

/// Runs the session. Returns the positions of the tool in contact.
fn palpate(
    args: &Args,
    organ: &Organ<'_>,
    frames: &Path,
    stop: &AtomicBool,
) -> Result<(touch::Touched, Vec<Visit>), Failure> {
    let nodes = organ.spaces.len().max(1) as f32;
    // The tour touches every active node once within the duration.
    let strokes = StrokeConfig {
        press_m: 0.012,
        drag_m: 0.012,
        seconds_per_node: args.seconds as f32 / nodes,
        ..StrokeConfig::default()
    };
    let hand = SimulatedConfig { strokes, ..SimulatedConfig::default() };
    let show = touch::Show {
        seconds: Some(args.seconds),
        headless: args.headless,
        pictures: frames,
        record: None,
        friction: None,
        change_every: None,
        profile: None,
        rate_hz: None,
        timing: Timing::default(),
        mouse: None,
        has_motors: false,
        control: None,
        regions: None,
        between: None,
    };
    let mut visits = Vec::new();
    let touched = touch::run(
        &[organ],
        Source::Tables(args.method),
        show,
        stop,
        || Ok(SimulatedHand::new(organ, hand)),
        |record| {
            if let Some(space) = record.engaged {
                visits.push(Visit {
                    active: usize::from(space),
                    displacement_m: record.displacement_m,
                    reaction_n: record.reaction_n,
                });
            }
        },
    )?;
    Ok((touched, visits))
}

/// Selects `count` visits, evenly distributed over the session.
fn spread(visits: &[Visit], count: usize) -> Vec<Visit> {
    let count = count.min(visits.len());
    (0..count).map(|i| visits[(2 * i + 1) * visits.len() / (2 * count)]).collect()
}

fn error_table(errors: &[MethodError], used: Method) -> Table {
    let header = ["method", "mean, mN", "max, mN", "mean, % (Eq. 14)", "max, %", "own data around, %"];
    let mut table = Table::new(1, header);
    for e in errors {
        let is_loop = e.method == "loop";
        table.row([
            if is_loop { format!("rendered ({})", used.name()) } else { e.method.clone() },
            format!("{:.3}", 1e3 * e.mean_n),
            format!("{:.3}", 1e3 * e.max_n),
            format!("{:.4}", 1e2 * e.mean_relative),
            format!("{:.3}", 1e2 * e.max_relative),
            if is_loop { String::new() } else { format!("{:.0}", 1e2 * e.covered) },
        ]);
    }
    table
}

fn write_forces(
    file: &Output,
    bench: &Analysis,
    organ: &Organ<'_>,
    checked: &[Checked],
) -> Result<(), Failure> {
    let of_method =
        |method: Method| ["fx_n", "fy_n", "fz_n", "coverage"].map(|name| format!("{}_{name}", method.name()));
    let own = ["active", "x_m", "y_m", "z_m", "fe_fx_n", "fe_fy_n", "fe_fz_n"].map(String::from);
    let mut table = Csv::new(own.into_iter().chain(Method::OF_LATTICE.into_iter().flat_map(of_method)))?;
    for c in checked {
        let answers = Method::OF_LATTICE.into_iter().filter_map(|method| {
            let found = organ.spaces.get(c.visit.active)?.force(method, c.visit.displacement_m)?;
            Some((found.force_n, found.coverage.name()))
        });
        let name = &bench.scene.active[c.visit.active].name;
        table.row((name, c.visit.displacement_m, c.force_n, answers.collect::<Vec<_>>()))?;
    }
    file.put(&table.finish()?)
}

fn figures(
    args: &Args,
    solved: &Solved,
    blob_bytes: usize,
    touched: &touch::Touched,
    errors: &[MethodError],
    checks: usize,
) -> serde_json::Value {
    let spaces: Vec<_> = solved
        .names
        .iter()
        .zip(&solved.counts)
        .map(|(name, c)| {
            json!({ "active": name, "expandable": c.expandable, "terminating": c.terminating,
                    "failed": c.failed, "unknown": c.unknown })
        })
        .collect();
    let summary = &touched.summary;
    let tick = &summary.latency.compute;
    let wake = &summary.latency.wake;
    json!({
        "configurations": solved.configurations(), "solved_now": solved.solved_now, "solve_seconds": solved.seconds,
        "threads": solved.threads, "spaces": spaces, "blob_bytes": blob_bytes, "method": args.method.name(),
        "seconds": args.seconds, "ticks": summary.ticks, "missed_deadlines": summary.latency.skipped_periods,
        "tick_ns": { "p50": tick.p50_ns, "p99": tick.p99_ns, "max": tick.max_ns },
        "lateness_ns": { "p50": wake.p50_ns, "p99": wake.p99_ns, "max": wake.max_ns },
        "frames": touched.frames.written, "checks": checks, "errors": errors,
    })
}
