//! Measures the error of the discretisation at some of the held-out positions of a space.
//!
//! Linear elements are compared with quadratic ones on the same mesh, quadratic ones with a mesh that is
//! refined once near the tool. Each position is solved from rest.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use palpate_core::ConfigTag;

use super::{Analysis, PipelineError, Run};
use crate::certificate::{Discretisation, FinerForce};
use crate::fem::Fingertip;
use crate::fem::solve::{LoadingOptions, Solver};
use crate::held_out::{Draw, Places};
use crate::mesh::{SkinPoint, Surface};
use crate::num::parallel::in_parallel;
use crate::num::vector::{distance, norm};
use crate::scene::{ElementOrder, ResolvedScene};
use crate::space::{Kind, Store};

/// Default number of positions that are compared.
pub const DISCRETISATION_POSITIONS: usize = 6;
/// Largest number of active nodes that are compared; of more, evenly spread ones.
const MAX_NODES: usize = 8;
/// Positions have at least this share of the largest force of their node: the relative error of a small force
/// is not felt.
const LEAST_SHARE: f64 = 0.5;
/// The refined part of the body, in radii of the tool round its place.
const REACH: f64 = 2.0;

/// Effort at a position. A position that needs more is at an end of a branch of the more accurate elements.
const EFFORT: LoadingOptions = LoadingOptions { max_halvings: 4, perturbations: 0, snap_through: false };

/// A held-out position of a space.
struct Position {
    found: FinerForce,
    /// Its place on the skin of the scene's mesh.
    place: SkinPoint,
}

/// Solves `positions` of the held-out positions with more accurate elements and stores their forces in the
/// `.space` file, unless it has them. Does nothing for a point, whose force does not converge. Returns the
/// number of positions solved by this call; `progress` is called with the number of solved ones and of all.
pub fn solve_discretisation(
    space: &Path,
    positions: usize,
    run: Run<'_>,
    progress: impl Fn(usize, usize) + Sync,
) -> Result<usize, PipelineError> {
    let store = Store::open(space)?;
    if positions == 0 || store.identity()?.contacts.is_none() {
        return Ok(0);
    }
    let analysis = Analysis::of_store(&store)?;
    drop(store);
    discretisation_in(&analysis, &analysis.store(space)?, positions, run, progress)
}

/// [`solve_discretisation`] in a store that is open for writing.
pub fn discretisation_in(
    analysis: &Analysis,
    store: &Store,
    positions: usize,
    run: Run<'_>,
    progress: impl Fn(usize, usize) + Sync,
) -> Result<usize, PipelineError> {
    let Some(tip) = analysis.scene.tool.fingertip().copied() else { return Ok(0) };
    let chosen = choose(&analysis.scene, store, positions)?;
    let skin = Surface::of(&analysis.scene.mesh);
    let places_m: Vec<[f64; 3]> = chosen
        .iter()
        .map(|of| of.place.interpolate(|node| analysis.scene.mesh.nodes_m[node as usize]))
        .collect();
    let Some((reference, finer)) = more_accurate(&analysis.scene, &places_m, &tip) else { return Ok(0) };
    let mut measured = Discretisation {
        elements: analysis.scene.elements().into(),
        reference,
        edge_m: mean_edge_m(&analysis.scene, &skin, &places_m, tip.radius_m),
        radius_m: tip.radius_m,
        tolerance: analysis.scene.discretisation,
        positions: Vec::new(),
        unsolved: 0,
    };
    let known = Discretisation::stored(store)?;
    let is_known = |of: &Discretisation| {
        let same = |a: &FinerForce, b: &Position| (&a.active, a.number) == (&b.found.active, b.found.number);
        let all = of.positions.len() + of.unsolved == chosen.len();
        all && of.reference == measured.reference
            && of.positions.iter().all(|a| chosen.iter().any(|b| same(a, b)))
    };
    let mut solved = 0;
    if let Some(known) = known.filter(is_known) {
        measured = Discretisation { tolerance: measured.tolerance, ..known };
    } else {
        let Some(forces) = solve(&analysis.path, finer, &chosen, &places_m, run, progress)? else {
            return Err(PipelineError::Interrupted);
        };
        solved = forces.len();
        measured.unsolved = forces.iter().filter(|force| force.is_none()).count();
        measured.positions = forces.into_iter().flatten().collect();
    }
    measured.keep_in(store)?;
    Ok(solved)
}

/// Held-out positions of significant force, from nodes over the whole list.
fn choose(scene: &ResolvedScene, store: &Store, positions: usize) -> Result<Vec<Position>, PipelineError> {
    let nodes = scene.active.len().min(MAX_NODES);
    let draw = Draw::of(store)?;
    let places = Places::of(scene.contacts(), &scene.mesh);
    let mut chosen = Vec::new();
    for n in 0..nodes {
        let number = n * scene.active.len() / nodes;
        let active = &scene.active[number];
        let wanted = positions * (n + 1) / nodes - positions * n / nodes;
        let mut found = Vec::new();
        store.each_truth(number, |walk, _, truth| {
            let at = truth.equilibrium().filter(|_| truth.tag() == ConfigTag::Expandable);
            let Some(at) = at.filter(|_| walk.kind == Kind::Uniform) else { return };
            let drawn = places.as_ref().zip(draw.as_ref()).and_then(|(places, draw)| {
                places.on_skin(&places.drawn(draw, number, &active.name, walk.number)?)
            });
            let Some(place) = drawn.or(active.contact) else { return };
            let displacement_m = truth.displacement_m;
            let found_there = FinerForce {
                active: active.name.clone(),
                number: walk.number,
                displacement_m,
                force_n: at.force_n,
                finer_n: [0.0; 3],
                seconds: 0.0,
            };
            found.push(Position { found: found_there, place });
        })?;
        let largest = found.iter().map(|of| norm(of.found.force_n)).fold(0.0, f64::max);
        found.retain(|of| norm(of.found.force_n) >= LEAST_SHARE * largest);
        found.truncate(wanted);
        chosen.extend(found);
    }
    Ok(chosen)
}

/// The scene with more accurate elements, and what it is.
fn more_accurate(
    scene: &ResolvedScene,
    places_m: &[[f64; 3]],
    tip: &Fingertip,
) -> Option<(String, ResolvedScene)> {
    let quadratic = ResolvedScene { order: ElementOrder::Quadratic, ..scene.clone() };
    if scene.order == ElementOrder::Linear {
        return Some((quadratic.elements().into(), quadratic));
    }
    let finer = quadratic.refined_near(places_m, REACH * tip.radius_m, 1)?;
    Some((format!("{} of half the size near the tool", quadratic.elements()), finer))
}

/// Mean edge of the triangles of the skin that have a corner within the radius of a place, m.
fn mean_edge_m(scene: &ResolvedScene, skin: &Surface, places_m: &[[f64; 3]], radius_m: f64) -> f64 {
    let at = |node: u32| scene.mesh.nodes_m[node as usize];
    let nearest_m = |triangle: &[u32; 3], place: &[f64; 3]| {
        triangle.iter().map(|&node| distance(at(node), *place)).fold(f64::INFINITY, f64::min)
    };
    let mut edges = Vec::new();
    for place in places_m {
        let closest = skin.triangles.iter().map(|t| nearest_m(t, place)).fold(f64::INFINITY, f64::min);
        let near = skin.triangles.iter().filter(|t| nearest_m(t, place) <= radius_m.max(closest));
        edges.extend(
            near.flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]).map(|[a, b]| distance(at(a), at(b))),
        );
    }
    edges.iter().sum::<f64>() / edges.len().max(1) as f64
}

/// Forces of the more accurate scene; `None` if stopped. A position that cannot be solved is `None`.
fn solve(
    path: &Path,
    finer: ResolvedScene,
    chosen: &[Position],
    places_m: &[[f64; 3]],
    run: Run<'_>,
    progress: impl Fn(usize, usize) + Sync,
) -> Result<Option<Vec<Option<FinerForce>>>, PipelineError> {
    let all = chosen.len();
    let body = Arc::new(finer.body().map_err(|error| PipelineError::Body(path.to_path_buf(), error))?);
    let (problems, skin) = (finer.problems(&body), Surface::of(&finer.mesh));
    let done = AtomicUsize::new(0);
    progress(0, all);
    let items: Vec<(&Position, &[f64; 3])> = chosen.iter().zip(places_m).collect();
    let force = |&(position, place_m): &(&Position, &[f64; 3])| {
        if run.stop.load(Ordering::Relaxed) {
            return None;
        }
        let begun = Instant::now();
        let place = skin.nearest(&finer.mesh, *place_m)?;
        let mut solver = Solver::new(problems.at(place));
        solver.loading = EFFORT;
        let rest = solver.rest().ok()?;
        let at = solver.advance(&rest.seed, position.found.displacement_m).ok();
        progress(done.fetch_add(1, Ordering::Relaxed) + 1, all);
        let (finer_n, seconds) = (at?.jet().force_n, begun.elapsed().as_secs_f64());
        Some(FinerForce { finer_n, seconds, ..position.found.clone() })
    };
    let forces = in_parallel(&items, run.threads, force)?;
    Ok((!run.stop.load(Ordering::Relaxed)).then_some(forces))
}
