//! `palpate path`: the reaction along a straight loading path, solved step by step.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args as ClapArgs;
use palpate_precompute::blob_writer::write_atomically;
use palpate_precompute::solve::{Configuration, Solver};

use crate::displacements::Displacements;
use crate::failure::Failure;
use crate::workbench::Workbench;

/// Solve the reaction force along a straight loading path.
///
/// The active node is moved from rest along DIRECTION in equal steps; each step starts from the last one with the
/// tangent predictor. Every converged step is a row of the CSV file. A path that fails keeps its rows, adds a last
/// one with status `failed` and exits with code 1.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// Scene file (TOML)
    scene: PathBuf,
    /// Active node to move; the scene's first if not given
    #[arg(long)]
    active: Option<String>,
    /// Direction x,y,z; its length does not matter
    #[arg(long, value_parser = direction, allow_hyphen_values = true)]
    direction: [f64; 3],
    /// Length of a step, mm
    #[arg(long, default_value_t = 1.0)]
    step_mm: f64,
    /// Number of steps
    #[arg(long)]
    steps: u32,
    /// CSV file to write; standard output if not given
    #[arg(long)]
    csv: Option<PathBuf>,
    /// Displacement of every node at every step: FILE.csv, or FILE.pvd with a folder FILE/ of VTU files for ParaView
    ///
    /// The series starts with rest. Its time is the length of the active node's displacement in mm; each VTU file has
    /// displacement_m on the nodes, and reaction_force_n, active_displacement_m and energy_j as field data. It is
    /// written step by step, so an interrupted run leaves a series of the steps so far.
    #[arg(long, value_name = "FILE")]
    displacements: Option<PathBuf>,
}

/// A unit vector from three numbers with commas.
pub(crate) fn direction(text: &str) -> Result<[f64; 3], String> {
    let parts: Vec<f64> = text
        .split(',')
        .map(|t| t.trim().parse::<f64>())
        .collect::<Result<_, _>>()
        .map_err(|e| e.to_string())?;
    let vector: [f64; 3] = parts.try_into().map_err(|_| "give three numbers, as in 0,0,1".to_string())?;
    let length = vector.iter().map(|x| x * x).sum::<f64>().sqrt();
    if !(length > 0.0 && length.is_finite()) {
        return Err("the direction must be finite and not zero".into());
    }
    Ok(vector.map(|x| x / length))
}

const HEADER: &str = "step,dx_m,dy_m,dz_m,fx_n,fy_n,fz_n,energy_j,newton_iterations,residual_n,min_jacobian,inverted,\
                      volume_m3,status";

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    if !(args.step_mm > 0.0 && args.step_mm.is_finite()) {
        return Err(Failure::input("--step-mm must be a positive number"));
    }
    let mut displacements = Displacements::new(args.displacements.as_deref())?;
    let bench = Workbench::load(&args.scene)?;
    let (_, active) = bench.active(args.active.as_deref())?;
    let mut solver = Solver::new(bench.problem(active));
    let mut here = solver.rest().map_err(|failure| {
        Failure::input(format!("{}: the body cannot be solved at rest: {failure}", args.scene.display()))
    })?;
    let mut table = format!("{HEADER}\n");
    displacements.add(0, 0.0, &bench.body, &here)?;
    let mut failed = None;
    for step in 1..=args.steps {
        let length_mm = f64::from(step) * args.step_mm;
        let target = args.direction.map(|x| x * (length_mm * 1e-3));
        match solver.advance(&here.seed, target) {
            Ok(configuration) => {
                push_row(&mut table, step, &configuration);
                displacements.add(step, length_mm, &bench.body, &configuration)?;
                here = configuration;
            }
            Err(failure) => {
                let [x, y, z] = target;
                let (iterations, residual) = (failure.iterations, failure.residual_n);
                table
                    .push_str(&format!("{step},{x:?},{y:?},{z:?},,,,,{iterations},{residual:?},,,,failed\n"));
                failed = Some((step, failure));
                break;
            }
        }
    }
    write_table(args.csv.as_deref(), &table)?;
    displacements.finish()?;
    match failed {
        None => Ok(()),
        Some((step, failure)) => {
            Err(Failure::work(format!("step {step} of {}: {failure}; the rows so far are kept", args.steps)))
        }
    }
}

fn push_row(table: &mut String, step: u32, c: &Configuration) {
    let ([dx, dy, dz], [fx, fy, fz]) = (c.seed.pose.displacement_m, c.force_n);
    table.push_str(&format!(
        "{step},{dx:?},{dy:?},{dz:?},{fx:?},{fy:?},{fz:?},{:?},{},{:?},{:?},{},{:?},ok\n",
        c.energy_j, c.iterations, c.residual_n, c.min_jacobian, c.inverted, c.volume_m3
    ));
}

/// Writes to a file, or to standard output.
fn write_table(path: Option<&Path>, table: &str) -> Result<(), Failure> {
    match path {
        Some(path) => write_atomically(path, table.as_bytes()).map_err(|error| Failure::file(path, &error)),
        None => std::io::stdout()
            .write_all(table.as_bytes())
            .map_err(|error| Failure::file(Path::new("standard output"), &error)),
    }
}
