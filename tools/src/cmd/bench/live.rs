//! `palpate bench live`: how well a solver beside the loop follows scripted hands.

pub(super) mod hands;
pub(super) mod simulation;

use std::path::PathBuf;
use std::time::Instant;

use clap::Args as ClapArgs;
use palpate_precompute::live::LiveSolver;
use palpate_precompute::mesh::Surface;
use palpate_precompute::num::distance;
use palpate_precompute::scene::{ResolvedScene, Scene};

use super::common::{Out, Pinned};
use crate::cmd::path::three;
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
    /// Where the hands of a sphere begin: the vertex of the skin nearest to this place, m
    #[arg(long, value_name = "X,Y,Z", value_parser = three, allow_hyphen_values = true)]
    point: Option<[f64; 3]>,
    /// Depth of a press, mm
    #[arg(long, value_name = "MM", default_value_t = 27.0)]
    depth_mm: f64,
    /// Hands: press10, press20, press30, press50, press100, press200, circle, poke, drag; all if not given
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

/// Where the hands begin.
struct Place {
    name: String,
    contact: u16,
    /// Outward normal of the skin.
    normal: [f64; 3],
    /// The control where they begin, m.
    origin_m: [f64; 3],
}

impl Place {
    /// The active node, or with a sphere the vertex of the skin that is nearest to the point.
    fn of(args: &Args, scene: &ResolvedScene, solver: &LiveSolver) -> Result<Self, Failure> {
        let contacts = &solver.skin().contacts;
        let Some(sphere) = scene.tool.sphere() else {
            let active = match &args.active {
                None => scene.active.first(),
                Some(name) => scene.active.iter().find(|active| active.name == *name),
            };
            let active = active.ok_or_else(|| {
                Failure::input(format!(
                    "{}: no such active node; name one with --active",
                    args.scene.display()
                ))
            })?;
            let contact = contacts.iter().position(|contact| contact.node == active.node);
            let contact = contact.ok_or_else(|| Failure::input("the active node is not on the free skin"))?;
            let normal = contacts[contact].normal;
            return Ok(Self {
                name: active.name.clone(),
                contact: contact as u16,
                normal,
                origin_m: [0.0; 3],
            });
        };
        let point_m = args.point.ok_or_else(|| {
            Failure::input("a sphere has no active node; give a place with --point X,Y,Z (m)")
        })?;
        let surface = Surface::of(&scene.mesh);
        let place_m = |node: u32| scene.mesh.nodes_m[node as usize];
        let away = |node: &u32| distance(place_m(*node), point_m);
        let nearest = surface.nodes.iter().copied().min_by(|a, b| away(a).total_cmp(&away(b)));
        let node = nearest.ok_or_else(|| Failure::input("the mesh has no surface"))?;
        let normal = surface.normal(node).unwrap_or_default();
        let origin_m =
            std::array::from_fn(|k| place_m(node)[k] + sphere.reach_m() * normal[k] - contacts[0].rest_m[k]);
        Ok(Self { name: format!("node {node}"), contact: 0, normal, origin_m })
    }
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let out = args.out.ready([args.scene.as_path()])?;
    let begun = Instant::now();
    let scene = Scene::load(&args.scene)?.resolve()?;
    let affinity = args.pinned.pin();
    let solver = || {
        LiveSolver::new(&scene).map_err(|error| Failure::input(format!("{}: {error}", args.scene.display())))
    };
    let first = solver()?;
    let place = Place::of(args, &scene, &first)?;
    let start_s = begun.elapsed().as_secs_f64();
    let hands = Hands::new(place.normal, place.origin_m, 1e-3 * args.depth_mm);
    let mut outcomes: Vec<Outcome> = Vec::new();
    for hand in hands.all(&args.hands) {
        let mut solver = solver()?;
        let outcome = simulation::run(&mut solver, place.contact, &hand, args.slower, args.every)?;
        eprintln!("{}", outcome.line());
        outcomes.push(outcome);
    }
    let figures = serde_json::json!({
        "scene": args.scene, "place": place.name, "equations": first.unknowns(), "start_s": start_s,
        "affinity": affinity, "slower": args.slower, "hands": outcomes,
    });
    let table = || {
        let title = format!(
            "{} at {}: {} equations, body ready after {start_s:.2} s, {affinity}",
            scene.name,
            place.name,
            first.unknowns()
        );
        let lines: Vec<String> = outcomes.iter().map(Outcome::line).collect();
        format!("{title}\n{}\n{}", Outcome::HEAD, lines.join("\n"))
    };
    out.write(|| simulation::csv(&outcomes), &figures, table)
}
