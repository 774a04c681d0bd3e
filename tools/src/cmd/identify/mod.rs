//! `palpate identify`: constants of materials from measured forces.

mod plot;
mod words;

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::Instant;

use clap::Args as ClapArgs;
use palpate_precompute::identify::{Bounds, Data, Identified, Loss, Options, identify};
use palpate_precompute::pipeline::Run;
use palpate_precompute::scene::Scene;
use serde_json::json;

use super::path::direction;
use crate::analysis::threads;
use crate::failure::Failure;
use crate::files::{FileKind, Files, Output, Replace};
use crate::interrupt::stop_flag;
use crate::output;
use crate::progress::WorkProgress;

/// Identify material constants from measured forces.
///
/// The free constants are fitted to the forces of an indentation by least squares on the finite-element solution of the
/// scene, from the values in the scene on. The tool of the scene is the tip of the indenter.
///
/// The table has the columns dx_m,dy_m,dz_m (displacement of the tool; or x_m,y_m,z_m, its position) and fx_n,fy_n,fz_n
/// (force of the tool on the body); or depth_m,force_n along --direction. Lengths may be in _mm, forces in _mn. Optional
/// columns: test, active.
///
/// Example: palpate identify liver.toml --data indentation.csv --free c10_pa,c01_pa --out fitted.toml
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// Scene file (TOML)
    scene: PathBuf,
    /// Measured places and forces
    #[arg(long, value_name = "FILE.csv")]
    data: PathBuf,
    /// Constants to identify, as in the scene; with several materials GROUP.NAME
    #[arg(long, value_name = "NAMES", value_delimiter = ',', required = true)]
    free: Vec<String>,
    /// Active node or contact point that the tool moves; the scene's first if not given
    #[arg(long, value_name = "NAME")]
    active: Option<String>,
    /// Direction of depth_m and force_n, from the tool into the body
    #[arg(long, value_name = "X,Y,Z", value_parser = direction, allow_hyphen_values = true)]
    direction: Option<[f64; 3]>,
    /// Bounds of a constant; may be repeated. An end may be left out: mu_pa=500:
    #[arg(long, value_name = "NAME=LOW:HIGH", value_parser = bounds, allow_hyphen_values = true)]
    bounds: Vec<(String, [f64; 2])>,
    /// How much outliers count
    #[arg(long, value_name = "LOSS", value_enum, default_value_t = LossName::Linear)]
    loss: LossName,
    /// Confidence of the intervals
    #[arg(long, value_name = "SHARE", default_value_t = 0.95, value_parser = confidence)]
    confidence: f64,
    /// Scene file to write, with the constants
    #[arg(long, value_name = "FILE.toml")]
    out: Option<PathBuf>,
    /// Drawing of measured and computed forces, and of the residuals
    #[arg(long, value_name = "FILE.svg")]
    plot: Option<PathBuf>,
    /// Table of measured and computed forces
    #[arg(long, value_name = "FILE.csv")]
    csv: Option<PathBuf>,
    /// Worker threads; one per core if not given
    #[arg(long, value_name = "N", hide_short_help = true)]
    threads: Option<usize>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    replace: Replace,
}

/// The losses on the command line.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum LossName {
    /// Least squares
    Linear,
    /// Smooth, outliers count by their size
    SoftL1,
    /// Least squares for most rows, outliers count by their size
    Huber,
}

impl From<LossName> for Loss {
    fn from(name: LossName) -> Self {
        match name {
            LossName::Linear => Self::Linear,
            LossName::SoftL1 => Self::SoftL1,
            LossName::Huber => Self::Huber,
        }
    }
}

/// Parses NAME=LOW:HIGH, either end optional.
fn bounds(text: &str) -> Result<(String, [f64; 2]), String> {
    let wanted = || "give NAME=LOW:HIGH, as in c10_pa=0:5000".to_owned();
    let (name, range) = text.split_once('=').ok_or_else(wanted)?;
    let (low, high) = range.split_once(':').ok_or_else(wanted)?;
    let end = |text: &str, none: f64| match text.trim() {
        "" => Ok(none),
        number => number.parse::<f64>().ok().filter(|x| !x.is_nan()).ok_or_else(wanted),
    };
    Ok((name.trim().to_owned(), [end(low, f64::NEG_INFINITY)?, end(high, f64::INFINITY)?]))
}

fn confidence(text: &str) -> Result<f64, String> {
    let share = text.parse::<f64>().ok().filter(|share| *share > 0.0 && *share < 1.0);
    share.ok_or_else(|| "give a share between 0 and 1, as in 0.95".into())
}

/// The outputs of the command.
struct Outputs {
    scene: Option<Output>,
    plot: Option<Output>,
    csv: Option<Output>,
}

impl Outputs {
    fn of(args: &Args, files: &mut Files) -> Result<Self, Failure> {
        let mut output = |option, path: &Option<PathBuf>, kind| {
            path.as_ref().map(|path| files.write(option, path, kind)).transpose()
        };
        Ok(Self {
            scene: output("--out", &args.out, FileKind::Toml)?,
            plot: output("--plot", &args.plot, FileKind::Svg)?,
            csv: output("--csv", &args.csv, FileKind::Table)?,
        })
    }

    /// Writes all of them.
    fn write(&self, found: &Identified) -> Result<(), Failure> {
        if let Some(file) = &self.scene {
            let folder = file.path().parent().unwrap_or(Path::new(""));
            let text = found.scene.text_for(folder).map_err(|error| file.failure(&error))?;
            file.put(text.as_bytes())?;
        }
        if let Some(file) = &self.plot {
            file.put(plot::drawing(found).as_bytes())?;
        }
        match &self.csv {
            Some(file) => file.put(&words::table(found)?),
            None => Ok(()),
        }
    }

    /// The paths.
    fn paths(&self) -> impl Iterator<Item = &Path> {
        [&self.scene, &self.plot, &self.csv].into_iter().flatten().map(Output::path)
    }
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let mut files = Files::new(args.replace);
    files.read_scene(&args.scene)?;
    files.read(&args.data);
    let outputs = Outputs::of(args, &mut files)?;
    let stop = stop_flag()?;
    let scene = Scene::load(&args.scene)?;
    let resolved = scene.resolve()?;
    for warning in &resolved.warnings {
        eprintln!("palpate: warning: {warning}");
    }
    let data = Data::read(&args.data, args.direction)?;
    let of = |(name, [low, high]): &(String, [f64; 2])| (name.clone(), Bounds { low: *low, high: *high });
    let options = Options {
        free: args.free.clone(),
        bounds: args.bounds.iter().map(of).collect(),
        loss: args.loss.into(),
        confidence: args.confidence,
        active: args.active.clone(),
    };
    let begun = Instant::now();
    let progress = Mutex::new(WorkProgress::new(&scene.name(), "places"));
    let run = Run { threads: threads(args.threads)?, stop: &stop };
    let found = identify(&scene, &resolved, &data, &options, run, |at| {
        let mut progress = progress.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let what = at.rms_n.map_or(String::new(), |rms_n| format!("RMS residual {:.2} mN", 1e3 * rms_n));
        progress.round(format!("evaluation {}", at.evaluation), what, at.solved, at.places);
    });
    drop(progress);
    let (found, seconds) = (found?, begun.elapsed().as_secs_f64());
    outputs.write(&found)?;
    if args.json {
        let mut value = serde_json::to_value(&found).map_err(Failure::work)?;
        value["seconds"] = json!(seconds);
        return output::json(&value);
    }
    words::print(&found, seconds, outputs.paths())
}
