//! Contact points over a part of the skin: as many as the difference between them needs.
//!
//! Between contact points the energies of three are blended ([`crate::spec::ContactSurface`]). How far this is
//! from the energy of the place itself depends on how fast the tissue changes along the skin, not on the mesh.
//! The first candidates are the vertices of the skin. The rest solution of each gives W_i to third order. The
//! middle of an edge becomes a candidate too if the edge is large beside the pad, or if the force blended from
//! its ends is not that of the middle. Then candidates are removed, the one that is missed least first, by
//! collapsing an edge of their triangulation, as long as
//!
//! - the force at every removed candidate, blended from the corners of its triangle, differs from its own by at
//!   most a share of the tolerance, for pushes along the normal and to all sides of it,
//! - the triangles stay close to the skin, do not fold and are not slivers.
//!
//! The prediction leaves out what the third order does not show. The certificate measures the error between the
//! contact points at solves that no choice has used.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

mod net;

use net::{Candidate, Net};

use super::{ActiveNode, ElementOrder, Problems, ResolvedScene};
use crate::fem::{Body, Fingertip, Problem, SolveFailure, Solver};
use crate::mesh::{SkinPoint, Surface};
use crate::num::jet::EnergyJet;
use crate::num::parallel::in_parallel;
use crate::num::vector::{cross, unit};
use crate::spec::Tolerance;

/// A part of the skin that is to be covered.
#[derive(Debug, Clone, PartialEq)]
pub struct Cover {
    /// Prefix of the names of its contact points.
    pub name: String,
    /// Its nodes, ascending.
    pub nodes: Vec<u32>,
}

/// Edges longer than this, in radii of the pad, are always divided.
const COARSE: f64 = 0.75;
/// Shorter ones than this are not divided any more.
const FINE: f64 = 0.25;
/// An edge is not tested if the forces at its ends are as near as this, in tolerances.
const ALIKE: f64 = 2.0;
/// A candidate is solved without a factor of its own from this share of the usual number of operations on: its one state
/// needs no inertia and serves no other. Measured with 8,888 equations beside a load: 37 instead of 89 ms.
const LARGE_SHARE: f64 = 1.0 / 3.0;
/// Depth of the pushes that are compared, in radii of the pad: the third order is accurate there.
const DEPTH: f64 = 0.75;

/// Chooses the contact points of `cover`, and triangulates them. `body` is that of the scene. Instead of quadratic
/// elements everywhere, linear ones show where the tissue changes, in less time.
pub(crate) fn choose(
    scene: &ResolvedScene,
    cover: &Cover,
    tip: &Fingertip,
    body: &Arc<Body>,
    threads: usize,
) -> Result<(Vec<ActiveNode>, Vec<[u32; 3]>), SolveFailure> {
    let linear = (scene.order == ElementOrder::Quadratic)
        .then(|| ResolvedScene { order: ElementOrder::Linear, ..scene.clone() });
    // A body that only second order can solve keeps its order.
    let linear = linear.and_then(|scene| Some((Arc::new(scene.body().ok()?), scene)));
    let (body, solved_scene) = linear.as_ref().map_or((body, scene), |(body, scene)| (body, scene));
    let tolerance = scene
        .grid
        .as_ref()
        .and_then(|grid| grid.scattered())
        .map_or(Tolerance::IMPERCEPTIBLE, |of| of.tolerance);
    let skin = Surface::of(&scene.mesh);
    let is_covered = |node: &u32| cover.nodes.binary_search(node).is_ok();
    let faces: Vec<[u32; 3]> =
        skin.triangles.iter().filter(|triangle| triangle.iter().all(is_covered)).copied().collect();
    let mut vertices: Vec<u32> = faces.iter().flatten().copied().collect();
    vertices.sort_unstable();
    vertices.dedup();
    let vertex = |node: &u32| {
        let triangle = *faces.iter().find(|corners| corners.contains(node)).expect("a corner of a face");
        SkinPoint { triangle, weights: triangle.map(|corner| f64::from(u8::from(corner == *node))) }
    };
    let number = |node: u32| vertices.binary_search(&node).expect("a corner of a face");
    let triangles = faces.iter().map(|corners| corners.map(number)).collect();
    let problems = solved_scene.problems(body);
    let solve = |&at: &SkinPoint| -> Result<Candidate, SolveFailure> {
        let active = ActiveNode::at(String::new(), at);
        let normal = active.normal(&skin).unwrap_or_default();
        let rest = Solver::new(problem_of(&problems, &active, solved_scene.order)).rest()?;
        let jet = rest.jet().as_rest();
        let pushes =
            pushes(normal, &jet, scene.max_force_n, tip).map(|d| (d, jet.taylor_force_n(d))).collect();
        Ok(Candidate { at, place_m: active.place_m(&scene.mesh), pushes, jet })
    };
    let solve_all = |points: &[SkinPoint]| -> Result<Vec<Candidate>, SolveFailure> {
        let solved = in_parallel(points, threads, solve);
        // Without more threads this one does all the work.
        solved.unwrap_or_else(|_| points.iter().map(solve).collect()).into_iter().collect()
    };
    let first: Vec<SkinPoint> = vertices.iter().map(vertex).collect();
    let mut net = Net::new(solve_all(&first)?, triangles, tolerance, tip);
    let mut tested = BTreeSet::new();
    loop {
        let edges: Vec<[usize; 2]> = net.edges().into_iter().filter(|edge| !tested.contains(edge)).collect();
        let long = |edge: &[usize; 2]| net.length_m(*edge) / tip.radius_m;
        let is_doubtful =
            |edge: &&[usize; 2]| long(edge) > COARSE || long(edge) > FINE && net.apart(**edge) > ALIKE;
        let doubtful: Vec<[usize; 2]> = edges.iter().filter(is_doubtful).copied().collect();
        let middle =
            |edge: &[usize; 2]| skin.nearest(&scene.mesh, net.middle_m(*edge)).expect("the skin has faces");
        let middles: Vec<SkinPoint> = doubtful.iter().map(middle).collect();
        let middles = doubtful.iter().zip(solve_all(&middles)?);
        let divided: BTreeMap<[usize; 2], Candidate> = middles
            .filter(|(edge, middle)| long(edge) > COARSE || net.is_missed(**edge, middle))
            .map(|(edge, middle)| (*edge, middle))
            .collect();
        tested.extend(edges);
        if divided.is_empty() {
            break;
        }
        net.divide(divided);
    }
    net.coarsen();
    let kept: Vec<usize> = (0..net.candidates.len()).filter(|&c| !net.around[c].is_empty()).collect();
    let place = |candidate: &usize| kept.binary_search(candidate).expect("the corner of a triangle") as u32;
    let triangles = net.triangles.values().map(|corners| corners.each_ref().map(place)).collect();
    let active = (1..).zip(&kept).map(|(number, &candidate)| {
        ActiveNode::at(format!("{}-{number}", cover.name), net.candidates[candidate].at)
    });
    Ok((active.collect(), triangles))
}

/// The problem of a candidate.
fn problem_of(problems: &Problems, candidate: &ActiveNode, order: ElementOrder) -> Arc<Problem> {
    let mut problem = problems.of(candidate);
    // With elements that are quadratic near the tool every candidate has a body of its own.
    if order != ElementOrder::NearTool {
        let own = Arc::get_mut(&mut problem).expect("a new problem");
        own.newton.large_flops *= LARGE_SHARE;
    }
    problem
}

/// Displacements along the inward normal, and turned from it by 45 degrees to four sides.
fn pushes(
    normal: [f64; 3],
    jet: &EnergyJet,
    max_force_n: f64,
    tip: &Fingertip,
) -> impl Iterator<Item = [f64; 3]> {
    let inward = normal.map(|x| -x);
    let stiffness = jet.stiffness_n_m * nalgebra::Vector3::from(inward);
    let depth_m = (max_force_n / stiffness.norm()).min(DEPTH * tip.radius_m);
    let other = if inward[0].abs() < 0.6 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
    let side = unit(cross(inward, other));
    let sides = [side, side.map(|x| -x), cross(inward, side), cross(inward, side).map(|x| -x)];
    let turned = sides.map(|side| unit(std::array::from_fn(|i| inward[i] + side[i])));
    std::iter::once(inward).chain(turned).map(move |direction| direction.map(|x| x * depth_m))
}
