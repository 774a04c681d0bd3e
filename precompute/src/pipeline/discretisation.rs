//! Measures the error of the discretisation at some of the held-out positions of a space.
//!
//! Linear elements are compared with quadratic ones on the same mesh, quadratic ones with a mesh that is
//! refined once near the tool. Each position is solved from rest. Where the more accurate elements have no
//! solution, another held-out position takes the place of that one.

use std::collections::VecDeque;
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
use crate::mesh::Surface;
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
#[derive(Clone)]
struct Position {
    /// Which of the compared active nodes it belongs to.
    node: usize,
    found: FinerForce,
    /// Its place on the skin of the scene's mesh.
    place_m: [f64; 3],
}

/// Solves `positions` of the held-out positions with more accurate elements and stores their forces in the
/// `.space` file, unless it has them. Does nothing for a point, whose force does not converge. Returns the
/// number of positions tried by this call; `progress` is called with the number of tried ones and of all.
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
    let scene = &analysis.scene;
    let mut tries = Tries::of(scene, store, positions)?;
    let Some((reference, _)) = more_accurate(scene, &tries.next, &tip) else { return Ok(0) };
    let known = Discretisation::stored(store)?.filter(|known| known.reference == reference);
    if let Some(known) = known {
        tries = tries.after(&known);
    }
    let mut solved = 0;
    while !tries.next.is_empty() {
        let forces = match more_accurate(scene, &tries.next, &tip) {
            Some((_, finer)) => {
                let shown = |now| progress(solved + now, solved + tries.next.len());
                solve(&analysis.path, finer, &tries.next, run, shown)?.ok_or(PipelineError::Interrupted)?
            }
            None => vec![None; tries.next.len()],
        };
        solved += forces.len();
        tries.take(forces);
    }
    let measured = Discretisation {
        elements: scene.elements().into(),
        reference,
        edge_m: mean_edge_m(scene, &Surface::of(&scene.mesh), &tries.places_m, tip.radius_m),
        radius_m: tip.radius_m,
        tolerance: scene.discretisation,
        positions: tries.solved,
        unsolved: tries.unsolved,
        replaced: tries.replaced,
    };
    measured.keep_in(store)?;
    Ok(solved)
}

/// Which positions are tried, in order: as many as are wanted and, for each that is not solved, the next of
/// the others. The order does not depend on the number of threads.
#[derive(Clone)]
struct Tries {
    /// To be solved now.
    next: Vec<Position>,
    /// The others of each active node.
    others: Vec<VecDeque<Position>>,
    /// How many more of the others may be tried: at most as many as are wanted.
    left: usize,
    /// Where the positions tried so far are, on the skin of the scene's mesh.
    places_m: Vec<[f64; 3]>,
    solved: Vec<FinerForce>,
    unsolved: usize,
    replaced: usize,
}

impl Tries {
    /// The first tries: `positions` of them, from nodes over the whole list.
    fn of(scene: &ResolvedScene, store: &Store, positions: usize) -> Result<Self, PipelineError> {
        let nodes = scene.active.len().min(MAX_NODES);
        let (mut next, mut others) = (Vec::new(), Vec::new());
        for (n, candidates) in candidates(scene, store, nodes)?.into_iter().enumerate() {
            let mut candidates = VecDeque::from(candidates);
            let wanted = positions * (n + 1) / nodes - positions * n / nodes;
            next.extend(candidates.drain(..wanted.min(candidates.len())));
            others.push(candidates);
        }
        Ok(Self::new(next, others))
    }

    fn new(next: Vec<Position>, others: Vec<VecDeque<Position>>) -> Self {
        let (left, places_m, solved) = (next.len(), Vec::new(), Vec::new());
        Self { next, others, left, places_m, solved, unsolved: 0, replaced: 0 }
    }

    /// The tries that remain after those of a kept result; all of them if it is of other positions.
    fn after(self, known: &Discretisation) -> Self {
        let all = known.positions.len() + known.unsolved;
        let mut tries = self.clone();
        while !tries.next.is_empty() && tries.places_m.len() < all {
            let forces = tries.next.iter().map(|of| {
                let same = |a: &&FinerForce| (&a.active, a.number) == (&of.found.active, of.found.number);
                known.positions.iter().find(same).cloned()
            });
            tries.take(forces.collect());
        }
        let same = tries.solved.len() == known.positions.len() && tries.unsolved == known.unsolved;
        if same { tries } else { self }
    }

    /// Takes the forces of `next`, where `None` is not solved, and makes their replacements the next tries.
    fn take(&mut self, forces: Vec<Option<FinerForce>>) {
        for (position, force) in std::mem::take(&mut self.next).into_iter().zip(forces) {
            self.places_m.push(position.place_m);
            if let Some(force) = force {
                self.solved.push(force);
                continue;
            }
            self.unsolved += 1;
            if let Some(replacement) = self.replacement(position.node) {
                self.replaced += 1;
                self.next.push(replacement);
            }
        }
    }

    /// The next position of the same active node, or else of the first one that has another.
    fn replacement(&mut self, node: usize) -> Option<Position> {
        self.left = self.left.checked_sub(1)?;
        let same = self.others.get_mut(node).and_then(VecDeque::pop_front);
        same.or_else(|| self.others.iter_mut().find_map(VecDeque::pop_front))
    }
}

/// Held-out positions of significant force of `nodes` of the active nodes, spread over the whole list.
fn candidates(
    scene: &ResolvedScene,
    store: &Store,
    nodes: usize,
) -> Result<Vec<Vec<Position>>, PipelineError> {
    let draw = Draw::of(store)?;
    let places = Places::of(scene.contacts(), &scene.mesh);
    let mut of_nodes = Vec::new();
    for node in 0..nodes {
        let number = node * scene.active.len() / nodes;
        let active = &scene.active[number];
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
            let place_m = place.interpolate(|node| scene.mesh.nodes_m[node as usize]);
            found.push(Position { node, found: found_there, place_m });
        })?;
        let largest = found.iter().map(|of| norm(of.found.force_n)).fold(0.0, f64::max);
        found.retain(|of| norm(of.found.force_n) >= LEAST_SHARE * largest);
        of_nodes.push(found);
    }
    Ok(of_nodes)
}

/// The scene with more accurate elements, and what it is.
fn more_accurate(
    scene: &ResolvedScene,
    positions: &[Position],
    tip: &Fingertip,
) -> Option<(String, ResolvedScene)> {
    let quadratic = ResolvedScene { order: ElementOrder::Quadratic, ..scene.clone() };
    if scene.order == ElementOrder::Linear {
        return Some((quadratic.elements().into(), quadratic));
    }
    let places_m: Vec<[f64; 3]> = positions.iter().map(|of| of.place_m).collect();
    let finer = quadratic.refined_near(&places_m, REACH * tip.radius_m, 1)?;
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
    positions: &[Position],
    run: Run<'_>,
    progress: impl Fn(usize) + Sync,
) -> Result<Option<Vec<Option<FinerForce>>>, PipelineError> {
    let body = Arc::new(finer.body().map_err(|error| PipelineError::Body(path.to_path_buf(), error))?);
    let (problems, skin) = (finer.problems(&body), Surface::of(&finer.mesh));
    let done = AtomicUsize::new(0);
    progress(0);
    let force = |position: &Position| {
        if run.stop.load(Ordering::Relaxed) {
            return None;
        }
        let begun = Instant::now();
        let place = skin.nearest(&finer.mesh, position.place_m)?;
        let mut solver = Solver::new(problems.at(place));
        solver.loading = EFFORT;
        let rest = solver.rest().ok()?;
        let at = solver.advance(&rest.seed, position.found.displacement_m).ok();
        progress(done.fetch_add(1, Ordering::Relaxed) + 1);
        let (finer_n, seconds) = (at?.jet().force_n, begun.elapsed().as_secs_f64());
        Some(FinerForce { finer_n, seconds, ..position.found.clone() })
    };
    let forces = in_parallel(positions, run.threads, force)?;
    Ok((!run.stop.load(Ordering::Relaxed)).then_some(forces))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Positions of two active nodes: two and one to be solved, others below each.
    fn tries() -> Tries {
        let position = |node: usize, number: u32| {
            let found = FinerForce {
                active: ["A", "B"][node].into(),
                number,
                displacement_m: [0.0; 3],
                force_n: [1.0; 3],
                finer_n: [1.0; 3],
                seconds: 0.0,
            };
            Position { node, found, place_m: [node as f64, f64::from(number), 0.0] }
        };
        let others = [vec![position(0, 3)], (2..9).map(|number| position(1, number)).collect()];
        Tries::new(vec![position(0, 1), position(0, 2), position(1, 1)], others.map(VecDeque::from).into())
    }

    /// Tries until nothing is left to try; `can` says which ones are solved. What was tried, by round.
    fn run(mut tries: Tries, can: impl Fn(&str, u32) -> bool) -> (Tries, Vec<Vec<(String, u32)>>) {
        let mut rounds = Vec::new();
        while !tries.next.is_empty() {
            let found: Vec<FinerForce> = tries.next.iter().map(|of| of.found.clone()).collect();
            rounds.push(found.iter().map(|of| (of.active.clone(), of.number)).collect());
            tries.take(found.into_iter().map(|of| can(&of.active, of.number).then_some(of)).collect());
        }
        (tries, rounds)
    }

    fn names(rounds: &[Vec<(String, u32)>]) -> Vec<String> {
        let name = |(active, number): &(String, u32)| format!("{active}{number}");
        rounds.iter().map(|round| round.iter().map(name).collect::<Vec<_>>().join(" ")).collect()
    }

    #[test]
    fn another_position_takes_the_place_of_one_that_is_not_solved() {
        let (all, rounds) = run(tries(), |_, _| true);
        assert_eq!(names(&rounds), ["A1 A2 B1"]);
        assert_eq!((all.solved.len(), all.unsolved, all.replaced), (3, 0, 0));
        // First of the same node, then of another one.
        let (all, rounds) = run(tries(), |active, number| active == "B" || number == 2);
        assert_eq!(names(&rounds), ["A1 A2 B1", "A3", "B2"]);
        assert_eq!((all.solved.len(), all.unsolved, all.replaced), (3, 2, 2));
        assert_eq!(all.places_m.len(), 5);
        // As many again at most.
        let (none, rounds) = run(tries(), |_, _| false);
        assert_eq!(names(&rounds), ["A1 A2 B1", "A3 B2 B3"]);
        assert_eq!((none.solved.len(), none.unsolved, none.replaced), (0, 6, 3));
    }

    #[test]
    fn a_kept_result_is_not_solved_again_and_one_that_lacks_positions_is_completed() {
        let kept = |tries: &Tries| Discretisation {
            elements: "P1".into(),
            reference: "P2".into(),
            edge_m: 0.01,
            radius_m: 0.01,
            tolerance: crate::spec::Tolerance { relative: 0.08, absolute_n: 0.02 },
            positions: tries.solved.clone(),
            unsolved: tries.unsolved,
            replaced: tries.replaced,
        };
        for can in
            [|_: &str, _: u32| true, |active: &str, number| active == "B" || number == 2, |_: &str, _| false]
        {
            let (all, _) = run(tries(), can);
            let again = tries().after(&kept(&all));
            assert!(again.next.is_empty(), "all is known");
            assert_eq!(kept(&again), kept(&all));
        }
        // An earlier version tried the first three only.
        let mut first = tries();
        first.take(first.next.iter().map(|of| (of.found.number != 1).then(|| of.found.clone())).collect());
        let earlier = Discretisation { replaced: 0, ..kept(&first) };
        let (all, rounds) = run(tries().after(&earlier), |_, _| true);
        assert_eq!(names(&rounds), ["A3 B2"]);
        assert_eq!((all.solved.len(), all.unsolved, all.replaced), (3, 2, 2));
        // One of other positions is not used.
        let mut other = kept(&run(tries(), |_, _| true).0);
        other.positions[1].number = 7;
        assert_eq!(names(&run(tries().after(&other), |_, _| true).1), ["A1 A2 B1"]);
    }
}
