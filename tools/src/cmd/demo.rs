//! `palpate demo`: all steps on the bundled organ, without hardware or display.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use clap::Args as ClapArgs;
use palpate_core::{Method, Organ};
use palpate_host::SessionSummary;
use palpate_host::device::script::StrokeConfig;
use palpate_host::device::simulated::{SimulatedConfig, SimulatedHand};
use palpate_host::rt::watchdog::DEFAULT_LIMIT_MS;
use palpate_precompute::certificate::Certificate;
use palpate_precompute::held_out::Draw;
use palpate_precompute::pack::{PackOptions, Packed};
use palpate_precompute::pipeline::{Analysis, Run, certified};
use palpate_precompute::space::{Store, TagCounts};
use serde_json::json;

use super::inspect::certificate::as_text;
use crate::analysis::{self, open_space, threads};
use crate::failure::Failure;
use crate::files::{FileKind, Files, Output, Replace};
use crate::interrupt::stop_flag;
use crate::progress::WorkProgress;
use crate::timing::Timing;
use crate::truth::{self, Checked, MethodError, Visit};
use crate::{blob, output, touch};

/// Solve, pack, palpate and check the bundled organ in one command.
///
/// Solves the configuration spaces of two active nodes of a liver-like phantom (incompressible Mooney-Rivlin,
/// 514 points each), packs them, lets a simulated hand palpate at 1 kHz, and compares the rendered force with
/// new finite-element solves at 200 visited positions. All files stay in the output folder. A second run uses
/// the solved spaces there; --again solves them again.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// Seconds of palpation
    #[arg(long, value_name = "S", default_value_t = 10.0)]
    seconds: f64,
    /// PNG frames instead of a window, even with a display
    #[arg(long)]
    headless: bool,
    /// Output folder
    #[arg(long, value_name = "DIR", default_value = "palpate-demo")]
    out: PathBuf,
    /// Solve the spaces again even if the folder holds them
    #[arg(long)]
    again: bool,
    /// Interpolation method of the loop
    #[arg(long, value_name = "M", default_value = "energy", value_parser = super::pack::method)]
    method: Method,
    /// Print the figures as JSON (they are always in summary.json)
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    replace: Replace,
}

const SCENE: &str = include_str!("../../../assets/liver-small.toml");
const MESH: &str = include_str!("../../../assets/liver-small.msh");
/// Number of positions at which the force is checked.
const CHECKS: usize = 200;

/// Summary of the solves.
struct Solved {
    names: Vec<String>,
    counts: Vec<TagCounts>,
    points: usize,
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
    scene: Output,
    mesh: Output,
    space: Output,
    blob: Output,
    forces: Output,
    summary: Output,
}

impl Outputs {
    fn of(args: &Args) -> Result<Self, Failure> {
        let mut files = Files::new(args.replace);
        let folder = files.folder("--out", &args.out, |_| None)?;
        Files::not_a_file("--out", &args.out.join("frames"))?;
        let mut at = |name: &str, kind| files.write("--out", &folder.path().join(name), kind);
        Ok(Self {
            scene: at("liver-small.toml", FileKind::Toml)?,
            mesh: at("liver-small.msh", FileKind::Mesh)?,
            space: at("liver-small.space", FileKind::Space)?,
            blob: at("liver-small.blob", FileKind::Blob)?,
            forces: at("forces.csv", FileKind::Table)?,
            summary: at("summary.json", FileKind::Json)?,
        })
    }
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    if !(args.seconds > 0.0 && args.seconds.is_finite()) {
        return Err(Failure::input("--seconds must be a positive number"));
    }
    let stop = stop_flag()?;
    let outputs = Outputs::of(args)?;
    outputs.mesh.put(MESH.as_bytes())?;
    outputs.scene.put(SCENE.as_bytes())?;
    let say = |text: String| if args.json { Ok(()) } else { output::line(text) };

    let bench = analysis::load(outputs.scene.path())?;
    say(format!(
        "organ        {}: {} nodes, {} tetrahedra, {}, {} fixed nodes",
        bench.scene.name,
        bench.scene.mesh.nodes_m.len(),
        bench.scene.mesh.tets.len(),
        bench.body.law_names(),
        bench.scene.fixed.len()
    ))?;
    if args.again {
        outputs.space.remove_database()?;
    }
    let store = open_space(&bench, &outputs.space, false)?;
    let solved = solve(&bench, &store, &stop)?;
    say(in_lines(&bench, &solved))?;

    let start = Instant::now();
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
    say(format!(
        "packed       {:.2} MB, all methods, certified at {HELD_OUT} fresh positions a node, in {:.1} s\n\n{}",
        bytes.len() as f64 * 1e-6,
        start.elapsed().as_secs_f64(),
        as_text(&certificate)
    ))?;

    let file = blob::load(outputs.blob.path())?;
    let organ = blob::organ(outputs.blob.path(), &file)?;
    let frames = args.out.join("frames");
    let (summary, visits) = palpate(args, &organ, &frames, &stop)?;
    say(format!("\nmethod       {}\n{summary}", args.method.name()))?;
    if stop.load(Ordering::Relaxed) {
        return Err(Failure::work("interrupted; the force on the hand is zero, the spaces are kept"));
    }

    touch::judge(&summary)?;

    let start = Instant::now();
    let Errors { checked, unsolved, errors } =
        errors(&bench, &store, &organ, &visits, (solved.threads, &stop))?;
    say(format!(
        "\nforce error against {} fresh finite-element solves at visited positions ({:.1} s, {unsolved} unsolved):\n{}",
        checked.len(),
        start.elapsed().as_secs_f64(),
        error_table(&errors, args.method)
    ))?;
    write_forces(&outputs.forces, &bench, &organ, &checked)?;
    let figures = figures(args, &solved, bytes.len(), &summary, &errors, checked.len());
    let text = serde_json::to_string_pretty(&figures).map_err(Failure::work)?;
    outputs.summary.put(text.as_bytes())?;
    if args.json {
        output::line(text)?;
    } else {
        output::line(format!(
            "\npictures     {}\nfigures      {}",
            frames.display(),
            outputs.summary.path().display()
        ))?;
    }
    Ok(())
}

/// The solved spaces as text.
fn in_lines(bench: &Analysis, solved: &Solved) -> String {
    let spaces = solved.names.iter().zip(&solved.counts).map(|(name, counts)| {
        format!(
            "space {name:6} {} of {} points solved: {} reachable, {} beyond {} N; {} failed, {} not reached\n",
            counts.solved(),
            solved.points,
            counts.expandable,
            counts.terminating,
            bench.scene.max_force_n,
            counts.failed,
            counts.unknown
        )
    });
    let sum = format!(
        "solved       {} configurations ({} now) in {:.1} s on {} threads",
        solved.configurations(),
        solved.solved_now,
        solved.seconds,
        solved.threads
    );
    spaces.chain([sum]).collect()
}

/// Errors of every method and of the session at visited positions.
struct Errors {
    checked: Vec<Checked>,
    unsolved: usize,
    errors: Vec<MethodError>,
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
        points: bench.sampling()?.points().unwrap_or(0),
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
) -> Result<(SessionSummary, Vec<Visit>), Failure> {
    let nodes = organ.spaces.len().max(1) as f32;
    // The tour touches every active node once within the duration.
    let strokes = StrokeConfig { seconds_per_node: args.seconds as f32 / nodes, ..StrokeConfig::default() };
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
        watchdog_ms: DEFAULT_LIMIT_MS,
        gif: None,
        mouse: None,
    };
    let mut visits = Vec::new();
    let touched = touch::run(
        &[organ],
        args.method,
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
    Ok((touched.summary, visits))
}

/// Selects `count` visits, evenly distributed over the session.
fn spread(visits: &[Visit], count: usize) -> Vec<Visit> {
    let count = count.min(visits.len());
    (0..count).map(|i| visits[(2 * i + 1) * visits.len() / (2 * count)]).collect()
}

fn error_table(errors: &[MethodError], used: Method) -> String {
    let mut table =
        String::from("  method        mean mN   max mN  mean % (Eq. 14)     max %   own data around\n");
    for e in errors {
        let name = if e.method == "loop" { format!("rendered ({})", used.name()) } else { e.method.clone() };
        table.push_str(&format!(
            "  {name:<14}{:>7.3}{:>9.3}{:>15.4}{:>11.3}{:>15}\n",
            1e3 * e.mean_n,
            1e3 * e.max_n,
            1e2 * e.mean_relative,
            1e2 * e.max_relative,
            if e.method == "loop" { String::new() } else { format!("{:.0} %", 1e2 * e.covered) }
        ));
    }
    table.trim_end().into()
}

fn write_forces(
    file: &Output,
    bench: &Analysis,
    organ: &Organ<'_>,
    checked: &[Checked],
) -> Result<(), Failure> {
    let mut table = String::from("active,x_m,y_m,z_m,fe_fx_n,fe_fy_n,fe_fz_n");
    for method in Method::OF_LATTICE {
        let name = method.name();
        table.push_str(&format!(",{name}_fx_n,{name}_fy_n,{name}_fz_n,{name}_coverage"));
    }
    table.push('\n');
    for c in checked {
        let ([x, y, z], [fx, fy, fz]) = (c.visit.displacement_m, c.force_n);
        table.push_str(&format!(
            "{},{x:?},{y:?},{z:?},{fx:?},{fy:?},{fz:?}",
            bench.scene.active[c.visit.active].name
        ));
        for method in Method::OF_LATTICE {
            let found =
                organ.spaces.get(c.visit.active).and_then(|s| s.force(method, c.visit.displacement_m));
            if let Some(found) = found {
                let [fx, fy, fz] = found.force_n;
                table.push_str(&format!(",{fx:?},{fy:?},{fz:?},{}", found.coverage.name()));
            }
        }
        table.push('\n');
    }
    file.put(table.as_bytes())
}

fn figures(
    args: &Args,
    solved: &Solved,
    blob_bytes: usize,
    summary: &SessionSummary,
    errors: &[MethodError],
    checks: usize,
) -> serde_json::Value {
    let spaces: Vec<_> = solved
        .names
        .iter()
        .zip(&solved.counts)
        .map(|(name, c)| {
            json!({ "active": name, "points": solved.points, "expandable": c.expandable, "terminating": c.terminating,
                    "failed": c.failed, "unknown": c.unknown })
        })
        .collect();
    let tick = &summary.latency.compute;
    let wake = &summary.latency.wake;
    json!({
        "configurations": solved.configurations(), "solved_now": solved.solved_now, "solve_seconds": solved.seconds,
        "threads": solved.threads, "spaces": spaces, "blob_bytes": blob_bytes, "method": args.method.name(),
        "seconds": args.seconds, "ticks": summary.ticks, "missed_deadlines": summary.latency.skipped_periods,
        "tick_ns": { "p50": tick.p50_ns, "p99": tick.p99_ns, "max": tick.max_ns },
        "lateness_ns": { "p50": wake.p50_ns, "p99": wake.p99_ns, "max": wake.max_ns },
        "frames": summary.frames_written, "checks": checks, "errors": errors,
    })
}
