//! `palpate path`: the reaction along a loading path, solved step by step.

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::Instant;

use clap::Args as ClapArgs;
use palpate_precompute::fem::{Configuration, FailureReason, Pose, SolveFailure};
use palpate_precompute::num::{distance, norm};
use palpate_precompute::pipeline::{Analysis, Loading};

use crate::analysis;
use crate::displacements::Displacements;
use crate::failure::Failure;
use crate::files::{Files, Replace, STANDARD};
use crate::interrupt::stop_flag;
use crate::output::{self, Csv};
use crate::points::read_points;
use crate::progress::WorkProgress;

/// Solve the reaction force along a loading path.
///
/// The tool moves from rest along DIRECTION in equal steps, or through the displacements of a table. Each step
/// starts from the last one with the tangent predictor. Every converged step is a row of the CSV file. A failed
/// path keeps its rows, adds one with status `failed` and exits with code 1. An interrupted path does the same
/// without that row.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// Scene file (TOML)
    scene: PathBuf,
    /// Active node or contact point to move; the scene's first if not given
    #[arg(long, value_name = "NAME")]
    active: Option<String>,
    /// Direction; its length does not matter
    #[arg(long, value_name = "X,Y,Z", value_parser = direction, allow_hyphen_values = true, requires = "steps")]
    #[arg(required_unless_present = "controls")]
    direction: Option<[f64; 3]>,
    /// Length of a step, mm
    #[arg(long, value_name = "MM", default_value_t = 1.0)]
    step_mm: f64,
    /// Number of steps along the direction
    #[arg(long, value_name = "N")]
    steps: Option<u32>,
    /// Displacements from rest instead of a direction: a table with the columns x_m,y_m,z_m, or - for standard
    /// input. Of a sphere the places of its centre
    #[arg(long, value_name = "FILE.csv", conflicts_with_all = ["direction", "steps", "step_mm"])]
    controls: Option<PathBuf>,
    /// Solve a sphere with its elastic layer, as fields and live touch do, instead of exact contact; a capsule always
    /// has it
    #[arg(long, requires = "controls")]
    layer: bool,
    /// CSV file to write; standard output if not given, or -
    #[arg(long, value_name = "FILE.csv")]
    csv: Option<PathBuf>,
    /// Displacement of every node at every step (.csv, or .pvd for ParaView)
    ///
    /// FILE.csv, or FILE.pvd with a folder FILE/ of VTU files. The series starts with rest. Its time is the
    /// length of the active node's displacement in mm; each VTU file has displacement_m on the nodes, and
    /// reaction_force_n, active_displacement_m and energy_j as field data. It is written step by step, so an
    /// interrupted run leaves a series of the steps so far.
    #[arg(long, value_name = "FILE")]
    displacements: Option<PathBuf>,
    /// More columns: reason, unstable modes, branch, moment, time
    ///
    /// After `status`: reason of a failure, unstable modes, whether the step left its branch, moment of a
    /// patch, wall time of the step in s.
    #[arg(long)]
    details: bool,
    /// Also turn the patch of the active node about it, or a capsule about its centre: rotation vector x,y,z in
    /// rad, reached at the last step
    #[arg(long, value_name = "X,Y,Z", value_parser = three, allow_hyphen_values = true, hide_short_help = true)]
    turn: Option<[f64; 3]>,
    #[command(flatten)]
    replace: Replace,
}

/// Parses three finite numbers separated by commas.
pub(crate) fn three(text: &str) -> Result<[f64; 3], String> {
    let parts: Vec<f64> = text
        .split(',')
        .map(|t| t.trim().parse::<f64>())
        .collect::<Result<_, _>>()
        .map_err(|e| e.to_string())?;
    let vector: [f64; 3] = parts.try_into().map_err(|_| "give three numbers, as in 0,0,1".to_string())?;
    if vector.iter().all(|x| x.is_finite()) { Ok(vector) } else { Err("the numbers must be finite".into()) }
}

/// Parses a unit vector from three numbers separated by commas.
pub(crate) fn direction(text: &str) -> Result<[f64; 3], String> {
    let vector = three(text)?;
    let length = vector.iter().map(|x| x * x).sum::<f64>().sqrt();
    if !(length > 0.0 && length.is_finite()) {
        return Err("the direction must be finite and not zero".into());
    }
    Ok(vector.map(|x| x / length))
}

const HEADER: &str = "step,dx_m,dy_m,dz_m,fx_n,fy_n,fz_n,energy_j,newton_iterations,residual_n,min_jacobian,inverted,\
                      volume_m3,status";
/// Additional columns of --details.
const DETAILS: &str = "reason,unstable_modes,switched,tx_n_m,ty_n_m,tz_n_m,solve_s";

/// The displacements of the tool from rest, m.
fn controls(args: &Args) -> Result<Vec<[f64; 3]>, Failure> {
    let controls = match (&args.controls, args.direction) {
        (Some(file), _) => read_points(file, "--controls")?,
        (None, direction) => {
            if !(args.step_mm > 0.0 && args.step_mm.is_finite()) {
                return Err(Failure::input("--step-mm must be a positive number"));
            }
            let direction = direction.unwrap_or_default();
            let at = |step: u32| direction.map(|x| x * (f64::from(step) * args.step_mm * 1e-3));
            (1..=args.steps.unwrap_or(0)).map(at).collect()
        }
    };
    if controls.is_empty() {
        let what = if args.controls.is_some() { "--controls: no row" } else { "--steps must be at least 1" };
        return Err(Failure::input(what));
    }
    Ok(controls)
}

/// Refuses options that do not go with the tool.
fn check_tool(args: &Args, bench: &Analysis) -> Result<(), Failure> {
    if bench.scene.tool.sphere().is_none() {
        if args.layer {
            return Err(Failure::input("--layer: only a sphere has a layer; leave it out"));
        }
        let (_, active) = bench.active(args.active.as_deref())?;
        return match args.turn {
            Some(_) if active.patch.is_empty() => Err(Failure::input(format!(
                "--turn: active node {} is a single node and has no patch to rotate; give it a `patch` or `patch_radius_m`",
                active.name
            ))),
            _ => Ok(()),
        };
    }
    if args.active.is_some() {
        return Err(Failure::input("--active: a sphere or capsule has no active node; leave it out"));
    }
    if args.turn.is_some() && bench.scene.tool.half_axis_m().is_none() {
        return Err(Failure::input("--turn: a sphere is the same however it is turned; leave it out"));
    }
    match args.controls {
        Some(_) => Ok(()),
        None => Err(Failure::input(
            "a sphere or capsule has no place of rest: give the places of its centre with --controls FILE.csv (x_m,y_m,z_m)",
        )),
    }
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let controls_m = controls(args)?;
    let mut files = Files::new(args.replace);
    files.read_scene(&args.scene)?;
    if let Some(table) = args.controls.as_ref().filter(|table| **table != Path::new(STANDARD)) {
        files.read(table);
    }
    let csv = files.table("--csv", args.csv.as_deref())?;
    let mut displacements = Displacements::new(args.displacements.as_deref(), &mut files)?;
    let stop = stop_flag()?;
    let bench = analysis::load(&args.scene)?;
    check_tool(args, &bench)?;
    let mut loading = Loading::begin(&bench, args.active.as_deref(), controls_m[0], args.layer)?;
    let details = DETAILS.split(',').filter(|_| args.details);
    let start_m = bench.scene.tool.sphere().map_or([0.0; 3], |_| controls_m[0]);
    let mut table = Csv::new(HEADER.split(',').chain(details))?;
    let mut last = None;
    let mut ended = displacements.add(0, 0.0, &bench.body, loading.here());
    let mut progress = WorkProgress::new(&bench.scene.name, "steps");
    let steps = controls_m.len();
    for (step, &target) in (1..).zip(&controls_m) {
        progress.steps("loading path", step as usize - 1, steps);
        if ended.is_ok() && stop.load(Ordering::Relaxed) {
            ended = Err(Failure::work(format!(
                "interrupted before step {step} of {steps}; the rows so far are kept"
            )));
        }
        if ended.is_err() {
            break;
        }
        // Of a straight path the exact length; otherwise the distance from its start.
        let length_mm = args
            .direction
            .map_or_else(|| 1e3 * distance(target, start_m), |_| f64::from(step) * args.step_mm);
        let share = f64::from(step) / steps as f64;
        let pose =
            Pose { displacement_m: target, rotation_rad: args.turn.unwrap_or_default().map(|x| x * share) };
        let begun = Instant::now();
        let reached = loading.advance(&pose);
        let solve_s = begun.elapsed().as_secs_f64();
        match reached {
            Ok(()) => {
                let details = args.details.then(|| (loading.unstable_modes(), solve_s));
                let configuration = loading.here();
                push_row(&mut table, step, configuration, details)?;
                if configuration.switched {
                    eprintln!(
                        "palpate: warning: step {step}: the body left its branch (snap-through, or Newton found another \
                         equilibrium): W, h and S do not continue those of the last step"
                    );
                }
                ended = displacements.add(step, length_mm, &bench.body, configuration);
                last = Some((step, length_mm, norm(configuration.jet().force_n)));
            }
            Err(failure) => {
                push_failure(&mut table, step, target, &failure, args.details.then_some(solve_s))?;
                let what = match failure.reason {
                    FailureReason::Pierced => {
                        "the skin is deep inside the sphere, whose layer is too soft here".into()
                    }
                    FailureReason::FixedPart => {
                        "the sphere presses on the fixed part, which cannot give way".into()
                    }
                    _ => failure.to_string(),
                };
                ended =
                    Err(Failure::work(format!("step {step} of {steps}: {what}; the rows so far are kept")));
            }
        }
    }
    progress.finish();
    // The rows are written after any end of the path. Its error is reported first.
    let written = table
        .finish()
        .and_then(|table| output::table(csv.as_ref(), &table))
        .and_then(|()| displacements.finish());
    if let (Some((step, length_mm, force_n)), Some(file), true) = (last, csv.as_ref(), written.is_ok()) {
        output::line(format!(
            "{}: {step} of {steps} steps, {length_mm} mm, |h| {force_n:.3} N",
            file.path().display()
        ))?;
    }
    ended.and(written)
}

/// The row of a step that did not converge; with its time if details are asked for.
fn push_failure(
    table: &mut Csv,
    step: u32,
    target_m: [f64; 3],
    failure: &SolveFailure,
    details: Option<f64>,
) -> Result<(), Failure> {
    let (solved, at_end) = ([""; 4], [""; 3]);
    let row = (step, target_m, solved, failure.iterations, failure.residual_n, at_end, "failed");
    match details {
        Some(solve_s) => table.row((row, failure.reason.to_string(), [""; 5], solve_s)),
        None => table.row(row),
    }
}

/// The row of a solved step; with its number of unstable modes and its time if details are asked for.
fn push_row(
    table: &mut Csv,
    step: u32,
    c: &Configuration,
    details: Option<(Option<u32>, f64)>,
) -> Result<(), Failure> {
    let (moved_m, jet) = (c.seed.pose.displacement_m, c.jet());
    let row = (step, moved_m, jet.force_n, jet.energy_j, c.iterations, c.residual_n, c.min_jacobian);
    let row = (row, c.inverted, c.volume_m3, "ok");
    match details {
        Some((modes, solve_s)) => table.row((row, "", modes, u32::from(c.switched), c.torque_n_m, solve_s)),
        None => table.row(row),
    }
}
