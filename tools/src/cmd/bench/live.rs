//! `palpate bench live`: how well a solver beside the loop follows scripted hands.

mod hands;
mod simulation;

use std::path::PathBuf;
use std::time::Instant;

use clap::Args as ClapArgs;
use palpate_precompute::live::LiveSolver;
use palpate_precompute::scene::Scene;

use super::common::{Out, Pinned};
use crate::failure::Failure;
use hands::Hands;
use simulation::Outcome;

/// Measure how well a solver beside the loop follows scripted hands on one contact of a scene.
///
/// The time is simulated: a tick is one millisecond, and each solve takes as long as it takes on this CPU. The true
/// force comes from full solutions along the same path.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// Scene
    #[arg(value_name = "SCENE")]
    scene: PathBuf,
    /// Active node of the scene that is touched, at the nearest vertex of the skin; the first one if not given
    #[arg(long, value_name = "NAME")]
    active: Option<String>,
    /// Depth of a press, mm
    #[arg(long, value_name = "MM", default_value_t = 27.0)]
    depth_mm: f64,
    /// Hands: press20, press50, press100, press200, circle, poke, drag; all if not given
    #[arg(long, value_name = "NAME,..", value_delimiter = ',')]
    hands: Vec<String>,
    /// Time between true forces, ms
    #[arg(long, value_name = "MS", default_value_t = 20)]
    every: usize,
    /// Multiply the time of each solve, as on a slower or busier CPU
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    slower: f64,
    #[command(flatten)]
    pinned: Pinned,
    #[command(flatten)]
    out: Out,
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let out = args.out.ready([args.scene.as_path()])?;
    let begun = Instant::now();
    let scene = Scene::load(&args.scene)?.resolve()?;
    let active = match &args.active {
        None => scene.active.first(),
        Some(name) => scene.active.iter().find(|active| active.name == *name),
    };
    let active = active.ok_or_else(|| {
        Failure::input(format!("{}: no such active node; name one with --active", args.scene.display()))
    })?;
    let affinity = args.pinned.pin();
    let solver = || {
        LiveSolver::new(&scene).map_err(|error| Failure::input(format!("{}: {error}", args.scene.display())))
    };
    let first = solver()?;
    let contact = first.skin().contacts.iter().position(|contact| contact.node == active.node);
    let contact = contact.ok_or_else(|| Failure::input("the active node is not on the free skin"))?;
    let start_s = begun.elapsed().as_secs_f64();
    let hands = Hands::new(first.skin().contacts[contact].normal, 1e-3 * args.depth_mm);
    let mut outcomes: Vec<Outcome> = Vec::new();
    for hand in hands.all(&args.hands) {
        let mut solver = solver()?;
        let outcome = simulation::run(&mut solver, contact as u16, &hand, args.slower, args.every)?;
        eprintln!("{}", outcome.line());
        outcomes.push(outcome);
    }
    let figures = serde_json::json!({
        "scene": args.scene, "active": active.name, "equations": first.unknowns(), "start_s": start_s,
        "affinity": affinity, "slower": args.slower, "hands": outcomes,
    });
    let table = || {
        let title = format!(
            "{} at {}: {} equations, body ready after {start_s:.2} s, {affinity}",
            scene.name,
            active.name,
            first.unknowns()
        );
        let lines: Vec<String> = outcomes.iter().map(Outcome::line).collect();
        format!("{title}\n{}\n{}", Outcome::HEAD, lines.join("\n"))
    };
    out.write(|| simulation::csv(&outcomes), &figures, table)
}
