//! Contact points over a part of the skin: as many as the difference between them needs.
//!
//! Between contact points the energies of three are blended ([`crate::spec::ContactSurface`]). How far this is
//! from the energy of the place itself depends on how fast the tissue changes along the skin, not on the mesh.
//! Candidates are the vertices of the skin and, where its triangles are larger than the pad, their middles. The
//! rest solution of each gives W_i to third order. Then candidates are removed, the one that is missed least
//! first, by collapsing an edge of their triangulation, as long as
//!
//! - the force at every removed candidate, blended from the corners of its triangle, differs from its own by at
//!   most a share of the tolerance, for pushes along the normal and to all sides of it,
//! - the triangles stay close to the skin, do not fold and are not slivers.
//!
//! The prediction leaves out what the third order does not show. The certificate measures the error between the
//! contact points at solves that no choice has used.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use super::{ActiveNode, ResolvedScene};
use crate::fem::{Body, Fingertip, SolveFailure, Solver};
use crate::mesh::{SkinPoint, Surface, nearest_on_triangle};
use crate::num::jet::EnergyJet;
use crate::num::parallel::in_parallel;
use crate::num::vector::{cross, difference, distance, dot, norm, unit};
use crate::spec::Tolerance;

/// A part of the skin that is to be covered.
#[derive(Debug, Clone, PartialEq)]
pub struct Cover {
    /// Prefix of the names of its contact points.
    pub name: String,
    /// Its nodes, ascending.
    pub nodes: Vec<u32>,
}

/// Triangles whose mean edge exceeds this multiple of the radius of the pad get candidates in their middles.
const COARSE: f64 = 0.75;
/// Largest number of divisions of a triangle's edges.
const MAX_DIVISIONS: u32 = 2;
/// Share of the tolerance that the predicted difference may use at the removed candidates, where it is largest,
/// in the worst of the pushes. Half of it needs nearly twice as many points.
const SHARE: f64 = 1.0;
/// Largest distance of a removed candidate from the triangles, as a share of the radius of the pad.
const LARGEST_SAG: f64 = 0.05;
/// Largest edge of a triangle, in radii of the pad.
const LONGEST_EDGE: f64 = 2.0;
/// Least sine of the angles of a triangle.
const LEAST_SINE: f64 = 0.25;
/// Least cosine between the normals of a triangle before and after a collapse.
const LEAST_COSINE: f64 = 0.7;
/// Depth of the pushes that are compared, in radii of the pad: the third order is accurate there.
const DEPTH: f64 = 0.75;

/// A place that may become a contact point.
#[derive(Debug)]
struct Candidate {
    at: SkinPoint,
    place_m: [f64; 3],
    /// Displacements at which forces are compared, m, with its own force there, N.
    pushes: Vec<([f64; 3], [f64; 3])>,
    jet: EnergyJet,
}

/// Chooses the contact points of `cover`, and triangulates them. `body` is that of the scene; its rest solutions
/// are those of linear elements, which show how the tissue changes as well as others.
pub(crate) fn choose(
    scene: &ResolvedScene,
    cover: &Cover,
    tip: &Fingertip,
    body: &Arc<Body>,
    threads: usize,
) -> Result<(Vec<ActiveNode>, Vec<[u32; 3]>), SolveFailure> {
    let linear = (scene.order > 1).then(|| ResolvedScene { order: 1, ..scene.clone() });
    // A body that only second order can solve keeps its order.
    let linear = linear.and_then(|scene| Some((Arc::new(scene.body().ok()?), scene)));
    let (body, solved_scene) = linear.as_ref().map_or((body, scene), |(body, scene)| (body, scene));
    let tolerance = scene
        .grid
        .as_ref()
        .and_then(|grid| grid.scattered())
        .map_or(Tolerance::IMPERCEPTIBLE, |of| of.tolerance);
    let skin = Surface::of(&scene.mesh);
    let (points, triangles) = candidates(scene, cover, tip, &skin);
    let problems = solved_scene.problems(body);
    let solve = |&at: &SkinPoint| -> Result<Candidate, SolveFailure> {
        let active = ActiveNode::at(at);
        let normal = active.normal(&skin).unwrap_or_default();
        let rest = Solver::new(problems.of(&active)).rest()?;
        let jet = rest.jet().as_rest();
        let pushes =
            pushes(normal, &jet, scene.max_force_n, tip).map(|d| (d, jet.taylor_force_n(d))).collect();
        Ok(Candidate { at, place_m: active.place_m(&scene.mesh), pushes, jet })
    };
    let solved = in_parallel(&points, threads, solve);
    // Without more threads this one does all the work.
    let solved = solved.unwrap_or_else(|_| points.iter().map(solve).collect());
    let solved = solved.into_iter().collect::<Result<Vec<_>, SolveFailure>>()?;
    let mut net = Net::new(solved, triangles, tolerance, tip);
    net.coarsen();
    let kept: Vec<usize> = (0..net.candidates.len()).filter(|&c| !net.around[c].is_empty()).collect();
    let place = |candidate: &usize| kept.binary_search(candidate).expect("the corner of a triangle") as u32;
    let triangles = net.triangles.values().map(|corners| corners.each_ref().map(place)).collect();
    let active = (1..).zip(&kept).map(|(number, &candidate)| ActiveNode {
        name: format!("{}-{number}", cover.name),
        ..ActiveNode::at(net.candidates[candidate].at)
    });
    Ok((active.collect(), triangles))
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

/// The candidates, and the triangles between them.
fn candidates(
    scene: &ResolvedScene,
    cover: &Cover,
    tip: &Fingertip,
    skin: &Surface,
) -> (Vec<SkinPoint>, Vec<[usize; 3]>) {
    let is_covered = |node: &u32| cover.nodes.binary_search(node).is_ok();
    let faces: Vec<[u32; 3]> =
        skin.triangles.iter().filter(|triangle| triangle.iter().all(is_covered)).copied().collect();
    let place = |node: u32| scene.mesh.nodes_m[node as usize];
    let edges = faces.iter().flat_map(|[a, b, c]| [[*a, *b], [*b, *c], [*c, *a]]);
    let length_m = edges.map(|[a, b]| distance(place(a), place(b))).sum::<f64>();
    let mut edge_m = length_m / (3 * faces.len()).max(1) as f64;
    let (mut points, mut at) = (Vec::new(), BTreeMap::new());
    // A point is known by its weights of mesh nodes, in quarters.
    let mut number = |face: &[u32; 3], quarters: [u8; 3]| {
        let mut key: Vec<(u32, u8)> = face.iter().copied().zip(quarters).filter(|(_, w)| *w > 0).collect();
        key.sort_unstable();
        *at.entry(key).or_insert_with(|| {
            let weights = quarters.map(|w| f64::from(w) / 4.0);
            points.push(SkinPoint { triangle: *face, weights });
            points.len() - 1
        })
    };
    let mut divisions = 0;
    while edge_m > COARSE * tip.radius_m && divisions < MAX_DIVISIONS {
        (edge_m, divisions) = (0.5 * edge_m, divisions + 1);
    }
    let mut triangles = Vec::new();
    for face in &faces {
        let mut pieces = vec![[[4, 0, 0], [0, 4, 0], [0, 0, 4]]];
        for _ in 0..divisions {
            let divided = |[a, b, c]: [[u8; 3]; 3]| {
                let middle =
                    |p: [u8; 3], q: [u8; 3]| -> [u8; 3] { std::array::from_fn(|i| (p[i] + q[i]) / 2) };
                let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            };
            pieces = pieces.into_iter().flat_map(divided).collect();
        }
        triangles.extend(pieces.into_iter().map(|piece| piece.map(|quarters| number(face, quarters))));
    }
    (points, triangles)
}

/// A triangulation of candidates, from which candidates are removed.
struct Net {
    candidates: Vec<Candidate>,
    triangles: BTreeMap<usize, [usize; 3]>,
    /// Triangles round each candidate; none of a removed one.
    around: Vec<BTreeSet<usize>>,
    /// Removed candidates of each triangle.
    removed: BTreeMap<usize, Vec<usize>>,
    tolerance: Tolerance,
    radius_m: f64,
}

/// A collapse: what replaces the triangles round the removed candidate.
struct Collapse {
    cost: f64,
    triangles: Vec<([usize; 3], Vec<usize>)>,
}

impl Net {
    fn new(
        candidates: Vec<Candidate>,
        triangles: Vec<[usize; 3]>,
        tolerance: Tolerance,
        tip: &Fingertip,
    ) -> Self {
        let mut around = vec![BTreeSet::new(); candidates.len()];
        let triangles: BTreeMap<usize, [usize; 3]> = triangles.into_iter().enumerate().collect();
        for (&triangle, corners) in &triangles {
            for &corner in corners {
                around[corner].insert(triangle);
            }
        }
        Self { candidates, triangles, around, removed: BTreeMap::new(), tolerance, radius_m: tip.radius_m }
    }

    /// Removes candidates until none can be removed, in each round the ones whose neighbours stay.
    fn coarsen(&mut self) {
        loop {
            let mut collapses: Vec<(usize, Collapse)> = (0..self.candidates.len())
                .filter(|&candidate| !self.around[candidate].is_empty())
                .filter_map(|candidate| Some((candidate, self.cheapest(candidate)?)))
                .collect();
            collapses.sort_by(|a, b| a.1.cost.total_cmp(&b.1.cost).then(a.0.cmp(&b.0)));
            let mut touched = BTreeSet::new();
            let mut any = false;
            for (candidate, collapse) in collapses {
                let ring = self.neighbours(candidate);
                if touched.contains(&candidate) || ring.iter().any(|other| touched.contains(other)) {
                    continue;
                }
                touched.insert(candidate);
                touched.extend(ring);
                self.apply(candidate, collapse);
                any = true;
            }
            if !any {
                return;
            }
        }
    }

    fn neighbours(&self, candidate: usize) -> BTreeSet<usize> {
        let corners = self.around[candidate].iter().flat_map(|triangle| self.triangles[triangle]);
        corners.filter(|&other| other != candidate).collect()
    }

    /// Number of triangles at the edge between two candidates.
    fn sharing(&self, a: usize, b: usize) -> usize {
        self.around[a].intersection(&self.around[b]).count()
    }

    /// The collapse of a candidate onto a neighbour that is missed least, if one is allowed.
    fn cheapest(&self, candidate: usize) -> Option<Collapse> {
        let ring = self.neighbours(candidate);
        let rim: Vec<usize> = ring.iter().copied().filter(|&b| self.sharing(candidate, b) == 1).collect();
        let onto = ring.iter().filter(|&&b| rim.is_empty() || rim.contains(&b));
        let collapses = onto.filter_map(|&b| self.collapse(candidate, b, &ring, &rim));
        collapses.min_by(|a, b| a.cost.total_cmp(&b.cost))
    }

    fn collapse(&self, from: usize, onto: usize, ring: &BTreeSet<usize>, rim: &[usize]) -> Option<Collapse> {
        // The neighbours of both are the corners opposite to their edge: otherwise the surface would be pinched.
        let common = self.neighbours(onto).intersection(ring).count();
        if common != self.sharing(from, onto) {
            return None;
        }
        // The rim of the covered part keeps its shape.
        if let [a, b] = *rim {
            let [a, b] = [a, b].map(|at| self.candidates[at].place_m);
            let at = self.candidates[from].place_m;
            if dot(unit(difference(at, a)), unit(difference(b, at))) < LEAST_COSINE {
                return None;
            }
        } else if !rim.is_empty() {
            return None;
        }
        let mut placed = vec![from];
        let mut triangles = Vec::new();
        for triangle in &self.around[from] {
            let before = self.triangles[triangle];
            placed.extend(self.removed.get(triangle).into_iter().flatten());
            if before.contains(&onto) {
                continue;
            }
            let after = before.map(|corner| if corner == from { onto } else { corner });
            if !self.is_sound(before, after) {
                return None;
            }
            triangles.push((after, Vec::new()));
        }
        let mut cost = 0.0f64;
        for candidate in placed {
            let at_m = self.candidates[candidate].place_m;
            let nearest = |(corners, _): &([usize; 3], Vec<usize>)| {
                let places = corners.map(|corner| self.candidates[corner].place_m);
                let (point_m, weights) = nearest_on_triangle(places, at_m);
                (distance(point_m, at_m), weights)
            };
            let found = triangles.iter().map(nearest).enumerate();
            let (index, (away_m, weights)) = found.min_by(|a, b| a.1.0.total_cmp(&b.1.0))?;
            let error = self.error(candidate, triangles[index].0, weights);
            if away_m > LARGEST_SAG * self.radius_m || error.is_nan() || error > SHARE {
                return None;
            }
            cost = cost.max(error);
            triangles[index].1.push(candidate);
        }
        Some(Collapse { cost, triangles })
    }

    /// Whether a triangle keeps its side, is not a sliver and not too long.
    fn is_sound(&self, before: [usize; 3], after: [usize; 3]) -> bool {
        let places = |corners: [usize; 3]| corners.map(|corner| self.candidates[corner].place_m);
        let area = |[a, b, c]: [[f64; 3]; 3]| cross(difference(b, a), difference(c, a));
        let (old, new) = (area(places(before)), area(places(after)));
        let [a, b, c] = places(after);
        let edges = [distance(a, b), distance(b, c), distance(c, a)];
        let longest = edges.into_iter().fold(0.0, f64::max);
        // The least sine is at the shortest edge's opposite corner: area / product of the two longer edges.
        let shortest = edges.into_iter().fold(f64::INFINITY, f64::min);
        let sine = norm(new) * shortest / (edges[0] * edges[1] * edges[2]);
        dot(unit(old), unit(new)) >= LEAST_COSINE
            && sine >= LEAST_SINE
            && longest <= LONGEST_EDGE * self.radius_m
    }

    /// Largest difference of the blended force from that of a candidate, in tolerances.
    fn error(&self, candidate: usize, corners: [usize; 3], weights: [f64; 3]) -> f64 {
        let error = |(push, own): &([f64; 3], [f64; 3])| {
            let forces = corners.map(|corner| self.candidates[corner].jet.taylor_force_n(*push));
            let blended: [f64; 3] =
                std::array::from_fn(|axis| (0..3).map(|k| weights[k] * forces[k][axis]).sum());
            distance(blended, *own) / self.tolerance.at(*own)
        };
        self.candidates[candidate].pushes.iter().map(error).fold(0.0, f64::max)
    }

    fn apply(&mut self, from: usize, collapse: Collapse) {
        let old = std::mem::take(&mut self.around[from]);
        for triangle in &old {
            for corner in self.triangles.remove(triangle).into_iter().flatten() {
                self.around[corner].remove(triangle);
            }
            self.removed.remove(triangle);
        }
        for (number, (corners, removed)) in old.into_iter().zip(collapse.triangles) {
            for corner in corners {
                self.around[corner].insert(number);
            }
            self.triangles.insert(number, corners);
            self.removed.insert(number, removed);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fem::PadProfile;
    use nalgebra::Matrix3;

    const TIP: Fingertip = Fingertip { radius_m: 0.01, stiffness_pa_m: 5e6, profile: PadProfile::Quartic };

    /// A plane of cells of 5 mm whose stiffness varies along x.
    fn plane(stiffness_n_m: impl Fn(f64) -> f64) -> Net {
        let cells = 8;
        let mut candidates = Vec::new();
        for j in 0..=cells {
            for i in 0..=cells {
                let place_m = [5e-3 * f64::from(i), 5e-3 * f64::from(j), 0.0];
                let jet = EnergyJet {
                    control_m: [0.0; 3],
                    energy_j: 0.0,
                    force_n: [0.0; 3],
                    stiffness_n_m: Matrix3::from_diagonal_element(stiffness_n_m(place_m[0])),
                    third_n_m2: [0.0; 10],
                };
                let pushes = pushes([0.0, 0.0, 1.0], &jet, 4.0, &TIP).map(|d| (d, jet.taylor_force_n(d)));
                let at = SkinPoint { triangle: [0; 3], weights: [1.0, 0.0, 0.0] };
                candidates.push(Candidate { at, place_m, pushes: pushes.collect(), jet });
            }
        }
        let at = |i: i32, j: i32| (j * (cells + 1) + i) as usize;
        let mut triangles = Vec::new();
        for j in 0..cells {
            for i in 0..cells {
                triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
                triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
            }
        }
        Net::new(candidates, triangles, Tolerance::IMPERCEPTIBLE, &TIP)
    }

    fn kept(net: &Net) -> usize {
        net.around.iter().filter(|around| !around.is_empty()).count()
    }

    /// Area of all triangles, and whether all keep the side of the plane.
    fn area(net: &Net) -> (f64, bool) {
        let areas = net.triangles.values().map(|corners| {
            let [a, b, c] = corners.map(|corner| net.candidates[corner].place_m);
            0.5 * cross(difference(b, a), difference(c, a))[2]
        });
        let areas: Vec<f64> = areas.collect();
        (areas.iter().sum(), areas.iter().all(|area| *area > 0.0))
    }

    #[test]
    fn equal_tissue_needs_few_points_and_an_edge_in_it_many() {
        let mut equal = plane(|_| 300.0);
        let mut edge = plane(|x| if x < 0.0201 { 300.0 } else { 900.0 });
        let mut linear = plane(|x| 300.0 + 1e4 * x);
        for net in [&mut equal, &mut edge, &mut linear] {
            net.coarsen();
            let (area_m2, keeps_its_side) = area(net);
            assert!((area_m2 - 0.04 * 0.04).abs() < 1e-12 && keeps_its_side, "{area_m2}");
        }
        let [a, b, c] = [kept(&equal), kept(&edge), kept(&linear)];
        println!("{a} points for equal tissue, {b} with an edge, {c} for a slope");
        // Limited by the longest edge, of two radii.
        assert!((9..=24).contains(&a) && c <= a + 6, "{a} {b} {c}");
        // No triangle spans the edge of the tissue but those from its last line to its first one.
        for corners in edge.triangles.values() {
            let x = corners.map(|corner| edge.candidates[corner].place_m[0]);
            let (low, high) = (x.into_iter().fold(1.0, f64::min), x.into_iter().fold(0.0, f64::max));
            assert!(high < 0.0201 || low > 0.0249 || (low > 0.0199 && high < 0.0251), "{x:?}");
        }
    }

    /// Every removed candidate is within the tolerance of its triangle, after all collapses.
    #[test]
    fn no_removed_candidate_is_missed() {
        let mut net = plane(|x| 300.0 * (1.0 + 0.3 * (x / 6e-3).sin()));
        net.coarsen();
        let mut checked = 0;
        for (triangle, removed) in &net.removed {
            let corners = net.triangles[triangle];
            for &candidate in removed {
                let places = corners.map(|corner| net.candidates[corner].place_m);
                let (_, weights) = nearest_on_triangle(places, net.candidates[candidate].place_m);
                assert!(net.error(candidate, corners, weights) <= SHARE);
                checked += 1;
            }
        }
        assert_eq!(checked + kept(&net), net.candidates.len());
        assert!(checked > 10, "{checked}");
    }
}
