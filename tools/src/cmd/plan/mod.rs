//! `palpate plan`: the cost of a scene, predicted before it is solved. [`palpate_precompute::plan`] computes
//! it, [`words`] prints it.

mod words;

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use clap::Args as ClapArgs;
use palpate_core::{Method, Organ};
use palpate_host::doctor::wrapped;
use palpate_precompute::plan::{PackedBlob, Plan, Prediction, Row, compare};
use palpate_precompute::scene::Tool;
use serde_json::json;

use crate::analysis::{self, threads};
use crate::blob;
use crate::cmd::inspect::certificate;
use crate::failure::Failure;
use crate::files::{FileKind, Files, Replace};
use crate::interrupt::end_when_interrupted;
use crate::output;
use crate::progress::WorkProgress;

/// Columns of the text.
const WIDTH: usize = 110;

/// Predict the cost of a scene before it is solved.
///
/// The choices of sampling are compared by configurations, seconds, memory, bytes, query time and error.
///
/// A few probing solves on each active node (at most four nodes) measure stiffness, nonlinearity and the time
/// of a solve on this machine. The sampling, the plan and the fits of `precompute` and `pack` then run on a
/// surrogate that interpolates the probes. Errors are against the finite elements of the same model; the
/// column `stiffer` is the additional error of its discretisation.
///
/// For the sampling that the scene asks for, 80 % prediction intervals are given. They include the lattice
/// that takes over a search at branch jumps, with its probability and cost. `--out` saves them, and `--check`
/// later compares them with the solved space.
///
/// Example: palpate plan liver.toml --out plan.json; then, after precompute and pack,
/// palpate plan --check liver.space --prediction plan.json --blob liver.blob
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// Scene file (TOML)
    #[arg(required_unless_present = "check", conflicts_with = "check")]
    scene: Option<PathBuf>,
    /// Save the prediction to this file
    #[arg(long, value_name = "FILE.json", conflicts_with = "check")]
    out: Option<PathBuf>,
    /// Compare a saved prediction with this solved space
    #[arg(long, value_name = "FILE.space")]
    check: Option<PathBuf>,
    /// With --check: the prediction that --out saved
    #[arg(long, value_name = "FILE.json", requires = "check")]
    prediction: Option<PathBuf>,
    /// With --check: the blob of the space, for bytes, error and query time
    #[arg(long, value_name = "FILE.blob", requires = "check")]
    blob: Option<PathBuf>,
    /// Worker threads, of the plan and of the predicted work; one per core if not given
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Print all rows, nodes and intervals
    #[arg(long)]
    verbose: bool,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    replace: Replace,
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    if let Some(space) = &args.check {
        return run_check(args, space);
    }
    let Some(scene) = &args.scene else { return Err(Failure::input("give a scene")) };
    let begun = Instant::now();
    end_when_interrupted()?;
    let threads = threads(args.threads)?;
    let mut files = Files::new(args.replace);
    files.read_scene(scene)?;
    let out = args.out.as_ref().map(|path| files.write("--out", path, FileKind::Json)).transpose()?;
    let analysis = analysis::load(scene)?;
    let progress = Mutex::new(WorkProgress::new(&analysis.scene.name, "steps"));
    let plan = Plan::of(&analysis, threads, &|phase, done, total| {
        progress.lock().unwrap_or_else(PoisonError::into_inner).steps(phase, done, total);
    });
    drop(progress);
    let plan = plan?;
    for node in &plan.too_stiff {
        eprintln!("palpate: warning: {}: {node}; it is omitted", scene.display());
    }
    if let Some(out) = out {
        let text = serde_json::to_string_pretty(&plan.prediction).map_err(Failure::work)?;
        out.put(format!("{text}\n").as_bytes())?;
    }
    let seconds = begun.elapsed().as_secs_f64();
    let Plan { rows, recommended, why, prediction, .. } = &plan;
    if args.json {
        let figures = json!({
            "scene": analysis.scene.name, "threads": threads, "seconds": seconds, "nodes": plan.nodes, "rows": rows,
            "recommended": rows[*recommended], "why": why, "prediction": prediction,
        });
        return output::line(serde_json::to_string_pretty(&figures).map_err(Failure::work)?);
    }
    let recommended = format!("Recommended: {}: {why}.", words::row(&rows[*recommended]));
    output::line(format!("{}\n", wrapped(&recommended, WIDTH).join("\n  ")))?;
    if analysis.scene.tool == Tool::Point
        && analysis.scene.active.iter().any(|active| active.patch.is_empty())
    {
        output::line(
            "The tool is a point: its force depends on the mesh, which no figure below includes. A fingertip has a \
             size\n([tool] shape = \"fingertip\").\n",
        )?;
    }
    // Of each sampling the default method, unless all are asked for.
    let is_shown =
        |row: &&Row| args.verbose || row.recommended || row.asked || row.method == Method::Energy.name();
    let shown: Vec<Row> = rows.iter().filter(is_shown).cloned().collect();
    output::line(words::table(&shown, threads))?;
    if args.verbose {
        output::line(words::nodes(&plan, &analysis))?;
    } else if analysis.scene.unrefined.is_some() {
        output::line(format!("Mesh: {}.\n", analysis.scene.size_in_words()))?;
    }
    output::line(words::prediction(prediction))?;
    output::line(format!(
        "Seconds are on {threads} thread{} of this machine with its present load; ~ marks values extrapolated from\n\
         coarser or smaller solves. Planned in {seconds:.1} s",
        if threads == 1 { "" } else { "s" }
    ))
}

/// Compares a saved prediction with a solved space.
fn run_check(args: &Args, space: &Path) -> Result<(), Failure> {
    let store = analysis::existing_space(space)?;
    let Some(path) = &args.prediction else {
        return Err(Failure::input(format!(
            "--check {}: needs the prediction that was saved before; save one with `palpate plan SCENE.toml --out FILE.json` \
             and give --prediction FILE.json",
            space.display()
        )));
    };
    let prediction = Prediction::load(path, &store)?;
    let compared = match &args.blob {
        None => compare(&prediction, &store, None)?,
        Some(path) => {
            let file = blob::load(path)?;
            let organ: Organ<'_> = blob::organ(path, &file)?;
            let certificate = certificate::of(path, &organ)?;
            let bytes = file.bytes().len();
            let packed = PackedBlob { organ: &organ, certificate: certificate.as_ref(), bytes };
            compare(&prediction, &store, Some(&packed))?
        }
    };
    if compared.lines.is_empty() {
        return Err(Failure::input(format!(
            "{}: no active node is finished; run `palpate precompute` to its end and check again",
            store.path().display()
        )));
    }
    if args.json {
        return output::line(serde_json::to_string_pretty(&compared).map_err(Failure::work)?);
    }
    output::line(words::comparison(&compared))
}
