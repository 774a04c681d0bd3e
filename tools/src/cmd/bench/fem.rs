//! `palpate bench fem`: seconds of the finite-element solver on the five bodies of the paper's Table 1.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::time::Instant;

use clap::Args as ClapArgs;
use palpate_precompute::fem::material::{Lame, Material, MooneyRivlin, StVenantKirchhoff};
use palpate_precompute::fem::{Body, IterationProfile, Pose, Problem, Solver};
use palpate_precompute::scene::{ElementOrder, ResolvedScene, Scene};
use serde::{Deserialize, Serialize};

use super::common::{Out, assets};
use crate::failure::Failure;

/// Measure the solver on the five bodies of the paper's Table 1, on one thread.
///
/// Measured are the parts of a Newton iteration, and a whole configuration 10 mm from a solved neighbour.
///
/// With --peer, GetFEM + MUMPS computes the same in the same run (tests/peers/install installs it). Its times
/// are those of its own calls only. Other load affects absolute times: pin the run
/// (`taskset -c 1 palpate bench fem --peer ...`) and compare ratios.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// Folder with liver-small.toml and liver-large.toml
    #[arg(long, value_name = "DIR", default_value = "assets")]
    assets: PathBuf,
    /// Cases, separated by commas: those of the paper, which are the default, and the large organ as mr-p2p1-large
    #[arg(long, value_name = "A,B", value_delimiter = ',')]
    cases: Vec<String>,
    /// Number of repetitions; medians are shown
    #[arg(long, value_name = "N", default_value_t = 9)]
    repetitions: usize,
    /// Run this GetFEM script (tests/peers/getfem_bench.py) for the same cases
    #[arg(long, value_name = "SCRIPT")]
    peer: Option<PathBuf>,
    #[command(flatten)]
    out: Out,
}

/// The first ones are the bodies of the paper.
const PAPER: usize = 5;
/// One body: name, scene, law, element order.
const CASES: [(&str, &str, bool, ElementOrder); PAPER + 1] = [
    ("stvk-p1-small", "liver-small", false, ElementOrder::Linear),
    ("mr-p1p1-small", "liver-small", true, ElementOrder::Linear),
    ("stvk-p1-large", "liver-large", false, ElementOrder::Linear),
    ("mr-p2p1-small", "liver-small", true, ElementOrder::Quadratic),
    ("mr-p1p1-large", "liver-large", true, ElementOrder::Linear),
    ("mr-p2p1-large", "liver-large", true, ElementOrder::Quadratic),
];

/// The direction of the peer's script: into the body at A2.
const INWARD: [f64; 3] = [-0.67, -0.15, -0.73];
/// Displacements of the solved neighbour and of the target, mm.
const NEIGHBOUR_MM: f64 = 5.0;
const TARGET_MM: f64 = 15.0;

/// Figures of one case.
#[derive(Debug, Serialize)]
struct Row {
    case: &'static str,
    equations: usize,
    factor_entries: usize,
    factor_mflop: f64,
    profile: IterationProfile,
    /// Whole iteration relative to the factorisation alone.
    iteration_over_factorisation: f64,
    /// S, du/dd and third derivatives relative to the solve of a 10 mm configuration ...
    derivatives_share: f64,
    /// ... and relative to the whole configuration, including its last factorisation and correction.
    derivatives_share_of_whole: f64,
    /// 10 mm in one step, to a residual of 1e-8 of the reaction.
    configuration_s: f64,
    iterations: u32,
    factorisations: u32,
    /// The same including the last correction, S, du/dd and W_ijk.
    configuration_with_derivatives_s: f64,
    residual_n: f64,
    /// Force by the tool on the body at the active node there, N: other codes must reach the same.
    force_n: [f64; 3],
    peer: Option<Peer>,
}

/// A row of the peer's table.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Peer {
    assembly_s: f64,
    solve_s: f64,
    iteration_s: f64,
    config_10mm_increments_s: f64,
    config_10mm_onestep_s: f64,
    onestep_iterations: u32,
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    if let Some(unknown) = args.cases.iter().find(|c| !CASES.iter().any(|(name, ..)| name == c)) {
        let names = CASES.map(|(name, ..)| name).join(", ");
        return Err(Failure::input(format!("no case `{unknown}`; the cases are {names}")));
    }
    let out = args.out.ready(assets(&args.assets).iter().chain(&args.peer).map(PathBuf::as_path))?;
    let chosen = CASES.into_iter().enumerate().filter(|(at, (name, ..))| match args.cases.is_empty() {
        true => *at < PAPER,
        false => args.cases.iter().any(|case| case == name),
    });
    let mut rows = Vec::new();
    for (_, (name, scene, incompressible, order)) in chosen {
        eprintln!("palpate: {name}");
        let scene = Scene::load(&args.assets.join(format!("{scene}.toml")))?.resolve()?;
        let mut row = measure(name, scene, incompressible, order, args.repetitions.max(1))?;
        if let Some(script) = &args.peer {
            row.peer = Some(peer(script, name, &args.assets)?);
        }
        rows.push(row);
    }
    out.write(|| Ok(csv(&rows).into()), &rows, || table(&rows))
}

fn measure(
    case: &'static str,
    mut scene: ResolvedScene,
    incompressible: bool,
    order: ElementOrder,
    repetitions: usize,
) -> Result<Row, Failure> {
    scene.order = order;
    for region in &mut scene.materials {
        region.material = if incompressible {
            Material::MooneyRivlin(MooneyRivlin { c10_pa: 1300.0, c01_pa: 1280.0 })
        } else {
            Material::StVenantKirchhoff(StVenantKirchhoff { lame: Lame::from_young_poisson(15480.0, 0.49) })
        };
    }
    let active =
        scene.active.iter().find(|a| a.name == "A2").ok_or_else(|| {
            Failure::input("the organ's scene has no active node A2; use the bundled assets")
        })?;
    let body = Arc::new(Body::new(&scene.mesh, &scene.model())?);
    let problem = Arc::new(Problem::new(body, active.node));
    let mut solver = Solver::new(problem.clone());
    let length = INWARD.iter().map(|x| x * x).sum::<f64>().sqrt();
    let at = |mm: f64| Pose::translation(INWARD.map(|x| x / length * mm * 1e-3));
    let failed = |error| Failure::work(format!("{case}: {error}"));
    let mut neighbour = solver.rest().map_err(failed)?;
    let steps = NEIGHBOUR_MM as u32;
    for step in 1..=steps {
        let pose = at(NEIGHBOUR_MM * f64::from(step) / f64::from(steps));
        neighbour = solver.advance_to(&neighbour.seed, &pose).map_err(failed)?;
    }
    let mut profiles = Vec::new();
    let (mut bare, mut whole) = (Vec::new(), Vec::new());
    let mut reached = None;
    for _ in 0..repetitions {
        profiles.push(solver.profile(&neighbour.seed).map_err(failed)?);
        let start = Instant::now();
        let spent = solver.reach(&neighbour.seed, &at(TARGET_MM)).map_err(failed)?;
        bare.push(start.elapsed().as_secs_f64());
        let start = Instant::now();
        let configuration = solver.advance_to(&neighbour.seed, &at(TARGET_MM)).map_err(failed)?;
        whole.push(start.elapsed().as_secs_f64());
        reached = Some((spent, configuration.residual_n, configuration.seed.jet.force_n));
    }
    let ((iterations, factorisations), residual_n, force_n) = reached.expect("at least one repetition");
    let part = |of: fn(&IterationProfile) -> f64| median(profiles.iter().map(of).collect());
    let profile = IterationProfile {
        assembly_s: part(|p| p.assembly_s),
        residual_s: part(|p| p.residual_s),
        factorisation_s: part(|p| p.factorisation_s),
        solve_s: part(|p| p.solve_s),
        bare_solve_s: part(|p| p.bare_solve_s),
        derivatives_s: part(|p| p.derivatives_s),
        iteration_s: part(|p| p.iteration_s),
    };
    let (_, factor_entries) = problem.entries();
    let (configuration_s, configuration_with_derivatives_s) = (median(bare), median(whole));
    Ok(Row {
        case,
        equations: problem.unknowns(),
        factor_entries,
        factor_mflop: problem.factor_flops() * 1e-6,
        profile,
        iteration_over_factorisation: profile.iteration_s / profile.factorisation_s,
        derivatives_share: profile.derivatives_s / configuration_s,
        derivatives_share_of_whole: profile.derivatives_s / configuration_with_derivatives_s,
        configuration_s,
        iterations,
        factorisations,
        configuration_with_derivatives_s,
        residual_n,
        force_n,
        peer: None,
    })
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Runs the peer's script for one case and reads its CSV.
fn peer(script: &Path, case: &str, assets: &Path) -> Result<Peer, Failure> {
    let output = Command::new("/usr/bin/python3")
        .arg(script)
        .args(["--cases", case, "--mesh-dir"])
        .arg(assets)
        .env("OMP_NUM_THREADS", "1")
        .output()
        .map_err(|error| Failure::work(format!("/usr/bin/python3: {error}; the peer needs Python 3")))?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        let last = said.lines().last().unwrap_or("no message");
        return Err(Failure::work(format!("{}: {last}", script.display())));
    }
    let text = String::from_utf8_lossy(&output.stdout);
    let unreadable =
        || Failure::work(format!("{}: its table does not have the expected columns", script.display()));
    let mut lines = text.lines().filter(|line| line.contains(','));
    let header: Vec<&str> = lines.next().ok_or_else(unreadable)?.split(',').collect();
    let values: Vec<&str> = lines.next().ok_or_else(unreadable)?.split(',').collect();
    let value = |key: &str| -> Result<f64, Failure> {
        let column = header.iter().position(|name| *name == key).ok_or_else(unreadable)?;
        // The field of a part that did not converge is empty.
        let text = values.get(column).copied().ok_or_else(unreadable)?;
        if text.is_empty() { Ok(f64::NAN) } else { text.parse().map_err(|_| unreadable()) }
    };
    Ok(Peer {
        assembly_s: value("assembly_s")?,
        solve_s: value("solve_s")?,
        iteration_s: value("iteration_s")?,
        config_10mm_increments_s: value("config_10mm_increments_s")?,
        config_10mm_onestep_s: value("config_10mm_onestep_s")?,
        onestep_iterations: value("onestep_iterations")? as u32,
    })
}

fn table(rows: &[Row]) -> String {
    let ms = |s: f64| format!("{:.2}", 1e3 * s);
    let mut text = String::from(
        "one Newton iteration, ms\n\
         case           equations  assembly  residual  factor  solve  whole  /factor  Gflop/s\n",
    );
    for row in rows {
        let p = &row.profile;
        text += &format!(
            "{:14} {:>9} {:>9} {:>9} {:>7} {:>6} {:>6} {:>8.2} {:>8.1}\n",
            row.case,
            row.equations,
            ms(p.assembly_s),
            ms(p.residual_s),
            ms(p.factorisation_s),
            ms(p.solve_s),
            ms(p.iteration_s),
            row.iteration_over_factorisation,
            1e-3 * row.factor_mflop / p.factorisation_s,
        );
    }
    text += "\na configuration 10 mm from a solved neighbour, in one step, ms\n\
             case            iterations  factors   solve  derivatives  (share)   whole  (share)  residual N\n";
    for row in rows {
        text += &format!(
            "{:14} {:>11} {:>8} {:>7} {:>12} {:>8.1}% {:>6} {:>8.1}% {:>11.1e}\n",
            row.case,
            row.iterations,
            row.factorisations,
            ms(row.configuration_s),
            ms(row.profile.derivatives_s),
            100.0 * row.derivatives_share,
            ms(row.configuration_with_derivatives_s),
            100.0 * row.derivatives_share_of_whole,
            row.residual_n,
        );
    }
    if rows.iter().any(|row| row.peer.is_some()) {
        text += "\nGetFEM + MUMPS in the same run, ms, and ratio to Palpate\n\
                 case           assembly    solve   iteration        ten 1 mm steps     one step, predicted\n";
        for (row, peer) in rows.iter().filter_map(|row| Some((row, row.peer.as_ref()?))) {
            let times = |theirs: f64, ours: f64| format!("{} ({:.1}x)", ms(theirs), theirs / ours);
            text += &format!(
                "{:14} {:>8} {:>8} {:>16} {:>18} {:>18}\n",
                row.case,
                ms(peer.assembly_s),
                ms(peer.solve_s),
                times(peer.iteration_s, row.profile.iteration_s),
                times(peer.config_10mm_increments_s, row.configuration_s),
                times(peer.config_10mm_onestep_s, row.configuration_s),
            );
        }
    }
    text.truncate(text.trim_end().len());
    text
}

fn csv(rows: &[Row]) -> String {
    let mut text = String::from(
        "case,equations,factor_entries,factor_mflop,assembly_s,residual_s,factorisation_s,solve_s,iteration_s,\
         derivatives_s,configuration_s,iterations,factorisations,configuration_with_derivatives_s,residual_n,\
         peer_iteration_s,peer_increments_s,peer_onestep_s\n",
    );
    for row in rows {
        let p = &row.profile;
        let peer =
            |value: fn(&Peer) -> f64| row.peer.as_ref().map_or(String::new(), |peer| value(peer).to_string());
        text += &format!(
            "{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{}\n",
            row.case,
            row.equations,
            row.factor_entries,
            row.factor_mflop,
            p.assembly_s,
            p.residual_s,
            p.factorisation_s,
            p.solve_s,
            p.iteration_s,
            p.derivatives_s,
            row.configuration_s,
            row.iterations,
            row.factorisations,
            row.configuration_with_derivatives_s,
            row.residual_n,
            peer(|p| p.iteration_s),
            peer(|p| p.config_10mm_increments_s),
            peer(|p| p.config_10mm_onestep_s),
        );
    }
    text
}
