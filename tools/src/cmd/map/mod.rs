//! `palpate map`: stiffness, depth at a force and the detectability of an inclusion over the skin.

mod outputs;
mod summary;
mod sweep;

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, PoisonError};

use clap::Args as ClapArgs;
use palpate_precompute::fem::Fingertip;
use palpate_precompute::map::{Ball, Found, Goal, Inclusion, JND, MapError, Mapped, Places, SURE_EDGE, Work};
use palpate_precompute::pipeline::PipelineError;
use palpate_precompute::scene::{PULP, ResolvedScene, Scene};
use palpate_precompute::spec::{Tolerance, Tool};
use palpate_viewer::map::Side;

use super::inspect::side;
use crate::analysis::threads;
use crate::failure::Failure;
use crate::files::{FileKind, Files, Output, Replace};
use crate::interrupt::stop_flag;
use crate::output;
use crate::progress::WorkProgress;
use summary::Summary;

/// Map stiffness over the skin, and where an inclusion can be felt.
///
/// At every free vertex of the skin the tool of the scene pushes along the inward normal until the normal
/// force reaches --force-n. With --inclusion or --ball-mm the same depth is solved with the surrounding
/// material in the inclusion's place: its detectability is the difference of the forces over the just
/// noticeable one.
///
/// Example: palpate map tumour.toml --inclusion tumour --picture felt.png
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// Scene file (TOML)
    scene: PathBuf,
    /// Group of volumes with a [[material]] of its own: where can it be felt? May be repeated
    #[arg(long, value_name = "GROUP")]
    inclusion: Vec<String>,
    /// A ball in the scene's body instead: centre and radius, mm
    #[arg(long, value_name = "X,Y,Z,RADIUS", value_parser = numbers::<4>, allow_hyphen_values = true, conflicts_with = "inclusion")]
    ball_mm: Option<[f64; 4]>,
    /// Stiffness of the ball over that of the tissue
    #[arg(long, value_name = "RATIO", default_value_t = 10.0, requires = "ball_mm")]
    ratio: f64,
    /// Print a table of detectability by depth, size and stiffness of a ball under one place
    #[arg(long, conflicts_with_all = ["inclusion", "ball_mm", "ratio", "vtu", "picture", "points"])]
    sweep: bool,
    /// With --sweep: the place, an active node or contact point of the scene; its first if not given
    #[arg(long, value_name = "NAME", requires = "sweep", hide_short_help = true)]
    under: Option<String>,
    /// With --sweep: tissue between skin and ball, mm
    #[arg(long, value_name = "MM,..", requires = "sweep", value_delimiter = ',', default_values_t = [2.0, 5.0, 10.0, 15.0], hide_short_help = true)]
    covers_mm: Vec<f64>,
    /// With --sweep: radii of the ball, mm
    #[arg(long, value_name = "MM,..", requires = "sweep", value_delimiter = ',', default_values_t = [5.0, 7.5, 10.0], hide_short_help = true)]
    radii_mm: Vec<f64>,
    /// With --sweep: ratios of stiffness
    #[arg(long, value_name = "RATIO,..", requires = "sweep", value_delimiter = ',', default_values_t = [2.0, 5.0, 10.0], hide_short_help = true)]
    ratios: Vec<f64>,
    /// Normal force to reach, N
    #[arg(long, value_name = "N", default_value_t = 1.0)]
    force_n: f64,
    /// Largest depth, mm; the radius of the scene's [grid] if not given, or 15 mm without one
    #[arg(long, value_name = "MM")]
    max_depth_mm: Option<f64>,
    /// Just noticeable difference of force, as a share of it
    ///
    /// 0.07 is for fingers that squeeze with 2.5 to 10 N (Pang, Tan and Durlach 1991); comparisons of stiffness
    /// need 0.08 to 0.22 (Tan et al. 1995). A difference below 0.02 N is never felt.
    #[arg(long, value_name = "SHARE", default_value_t = JND.relative)]
    jnd: f64,
    /// Push at N evenly spread vertices only; the others take the values of the nearest one
    #[arg(long, value_name = "N", hide_short_help = true)]
    points: Option<usize>,
    /// Push with a fingertip of this radius instead of the scene's tool, mm
    #[arg(long, value_name = "RADIUS", hide_short_help = true)]
    fingertip_mm: Option<f64>,
    /// A row per place, or per ball of a sweep
    #[arg(long, value_name = "FILE.csv")]
    csv: Option<PathBuf>,
    /// The skin with its fields, for ParaView
    #[arg(long, value_name = "FILE.vtu")]
    vtu: Option<PathBuf>,
    /// The body in false colours
    #[arg(long, value_name = "FILE.png")]
    picture: Option<PathBuf>,
    /// With --picture: sides to show; that of the strongest place if not given
    ///
    /// Any of front, back, left, right, above, below.
    #[arg(long, value_name = "SIDE,..", value_delimiter = ',', value_parser = side, requires = "picture", hide_short_help = true)]
    from: Vec<Side>,
    /// Worker threads; one per core if not given
    #[arg(long, value_name = "N", hide_short_help = true)]
    threads: Option<usize>,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    replace: Replace,
}

/// Parses N finite numbers separated by commas.
fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let parts: Result<Vec<f64>, _> = text.split(',').map(|part| part.trim().parse::<f64>()).collect();
    let parts: [f64; N] = parts
        .map_err(|e| e.to_string())?
        .try_into()
        .map_err(|_| format!("give {N} numbers with commas between them"))?;
    if parts.iter().all(|x| x.is_finite()) { Ok(parts) } else { Err("the numbers must be finite".into()) }
}

/// Refuses numbers that mean nothing.
fn check(args: &Args) -> Result<(), Failure> {
    let positive = |option: &str, values: &[f64]| {
        let is_good = values.iter().all(|x| *x > 0.0 && x.is_finite());
        if is_good { Ok(()) } else { Err(Failure::input(format!("{option}: give a positive number"))) }
    };
    positive("--force-n", &[args.force_n])?;
    positive("--max-depth-mm", args.max_depth_mm.as_slice())?;
    positive("--ratio", &[args.ratio])?;
    positive("--ball-mm: the radius", args.ball_mm.map(|ball| ball[3]).as_slice())?;
    positive("--fingertip-mm", args.fingertip_mm.as_slice())?;
    positive("--covers-mm", &args.covers_mm)?;
    positive("--radii-mm", &args.radii_mm)?;
    positive("--ratios", &args.ratios)?;
    if !(args.jnd > 0.0 && args.jnd <= 1.0) {
        return Err(Failure::input("--jnd: give a share above 0 and up to 1, such as 0.07"));
    }
    if args.points == Some(0) {
        return Err(Failure::input("--points: give at least 1"));
    }
    Ok(())
}

/// Loads the scene with the tool that pushes, and prints warnings.
fn load(args: &Args) -> Result<ResolvedScene, Failure> {
    let mut scene = Scene::load(&args.scene)?.resolve()?;
    scene.cover = None;
    if let Some(radius_mm) = args.fingertip_mm {
        let radius_m = 1e-3 * radius_mm;
        if radius_m > 0.25 * scene.mesh.diagonal_m() {
            return Err(Failure::input(format!(
                "--fingertip-mm {radius_mm}: is larger than a quarter of the body"
            )));
        }
        scene.tool = Tool::Fingertip(Fingertip { radius_m, ..PULP });
    }
    if scene.tool.sphere().is_some() {
        return Err(Failure::input(format!(
            "{}: a sphere or capsule slides on the skin, so a push along the normal is not defined; push with \
             --fingertip-mm {:.0}",
            args.scene.display(),
            1e3 * PULP.radius_m
        )));
    }
    let mut warnings = scene.warnings.clone();
    if scene.tool == Tool::Point {
        warnings.push(
            "the tool holds single nodes, so stiffness and depth depend on the mesh; a fingertip has a size \
             (--fingertip-mm 10)"
                .into(),
        );
    }
    for warning in &warnings {
        eprintln!("palpate: warning: {warning}");
    }
    Ok(scene)
}

/// The inclusion that the options name.
fn inclusion(args: &Args, scene: &ResolvedScene) -> Result<Option<Inclusion>, MapError> {
    if let Some([x, y, z, radius]) = args.ball_mm {
        let ball = Ball { centre_m: [x, y, z].map(|x| 1e-3 * x), radius_m: 1e-3 * radius, ratio: args.ratio };
        return Ok(Some(Inclusion::ball(scene, ball)?));
    }
    if args.inclusion.is_empty() {
        return Ok(None);
    }
    Ok(Some(Inclusion::of_groups(scene, &args.inclusion)?))
}

/// A map's failure as that of the command.
fn failure(scene: &Path, error: MapError) -> Failure {
    let shown = scene.display();
    match error {
        MapError::Body(error) => PipelineError::Body(scene.to_path_buf(), error).into(),
        MapError::Inclusion(error) => Failure::input(format!("{shown}: {error}")),
        MapError::Rest(..) => Failure::work(format!("{shown}: {error}; check the constants and [fixed]")),
        MapError::Threads(_) | MapError::Interrupted => Failure::work(error),
    }
}

/// The files of the command.
struct Wanted {
    csv: Option<Output>,
    vtu: Option<Output>,
    picture: Option<Output>,
}

impl Wanted {
    fn of(args: &Args) -> Result<Self, Failure> {
        let mut files = Files::new(args.replace);
        files.read_scene(&args.scene)?;
        let mut write = |option, path: &Option<PathBuf>, kind| {
            path.as_ref().map(|path| files.write(option, path, kind)).transpose()
        };
        Ok(Self {
            csv: write("--csv", &args.csv, FileKind::Table)?,
            vtu: write("--vtu", &args.vtu, FileKind::Vtu)?,
            picture: write("--picture", &args.picture, FileKind::Png)?,
        })
    }
}

/// Runs `work` with a display of its progress.
fn with_progress<T>(
    args: &Args,
    scene: &ResolvedScene,
    (doing, of, total): (&str, &'static str, usize),
    stop: &Arc<AtomicBool>,
    work: impl FnOnce(Work<'_>) -> Result<T, MapError>,
) -> Result<T, Failure> {
    let progress = Mutex::new(WorkProgress::new(&scene.name, of));
    let show =
        |done: usize| progress.lock().unwrap_or_else(PoisonError::into_inner).steps(doing, done, total);
    show(0);
    let result = work(Work { threads: threads(args.threads)?, stop, done: &show });
    progress.into_inner().unwrap_or_else(PoisonError::into_inner).finish();
    result.map_err(|error| failure(&args.scene, error))
}

/// All of a map, for its outputs.
struct Map {
    scene: ResolvedScene,
    inclusion: Option<Inclusion>,
    places: Places,
    found: Vec<Found>,
    goal: Goal,
    jnd: Tolerance,
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    check(args)?;
    let wanted = Wanted::of(args)?;
    threads(args.threads)?;
    let stop = stop_flag()?;
    let scene = load(args)?;
    let of_grid_m = scene.grid.as_ref().map(|grid| grid.radius_m());
    let max_depth_m = args.max_depth_mm.map(|mm| 1e-3 * mm).or(of_grid_m).unwrap_or(0.015);
    let goal = Goal { force_n: args.force_n, max_depth_m };
    let jnd = Tolerance { relative: args.jnd, ..JND };
    if args.sweep {
        return sweep::run(args, &scene, (&goal, &jnd), &stop, wanted.csv.as_ref());
    }
    let in_scene = |error| failure(&args.scene, error);
    let inclusion = inclusion(args, &scene).map_err(in_scene)?;
    let scene = inclusion.as_ref().map_or(scene, |inclusion| inclusion.with.clone());
    let places = Places::over(&scene, args.points);
    if places.places.is_empty() {
        return Err(Failure::input(format!(
            "{}: the skin has no free vertex; fix less of it",
            args.scene.display()
        )));
    }
    warn_of_edges(&scene, &places);
    let without = inclusion.as_ref().map(|inclusion| &inclusion.without);
    let mapped = Mapped::new(&scene, without).map_err(|error| in_scene(error.into()))?;
    let found = with_progress(args, &scene, ("map", "places", places.places.len()), &stop, |work| {
        mapped.all(&places.places, &goal, work)
    })?;
    let map = Map { scene, inclusion, places, found, goal, jnd };
    let summary = Summary::of(&map);
    if let Some(file) = &wanted.csv {
        file.put(&outputs::csv(&map)?)?;
    }
    if let Some(file) = &wanted.vtu {
        file.put(outputs::vtu(&map).map_err(|error| file.failure(&error))?.as_bytes())?;
    }
    if let Some(file) = &wanted.picture {
        file.put(&outputs::picture(&map, &summary, &args.from).map_err(|error| file.failure(&error))?)?;
    }
    if args.json { output::json(&summary) } else { output::line(summary.in_words()) }
}

/// A warning if the mesh is coarse for the tool.
fn warn_of_edges(scene: &ResolvedScene, places: &Places) {
    let Some(tip) = scene.tool.fingertip() else { return };
    let coarse = places.places.iter().filter(|place| place.edge_m > SURE_EDGE * tip.radius_m).count();
    if coarse > 0 {
        eprintln!(
            "palpate: warning: at {} of {} places the edges of the skin are longer than the tool's radius: the stiffness \
             there is that of the mesh, and too large; use a finer mesh or a larger tool",
            coarse,
            places.places.len()
        );
    }
}
