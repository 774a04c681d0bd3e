//! A triangulation of candidates: divided where the difference between them is too large, then coarsened.

use std::collections::{BTreeMap, BTreeSet};

use crate::fem::Fingertip;
use crate::mesh::{SkinPoint, nearest_on_triangle};
use crate::num::jet::EnergyJet;
use crate::num::vector::{cross, difference, distance, dot, norm, unit};
use crate::spec::Tolerance;

/// Share of the tolerance that the predicted difference may use at the removed candidates, where it is largest,
/// in the worst of the pushes. In scene `anywhere` it leaves 0.1 % of the held-out positions beyond the JND.
const SHARE: f64 = 0.8;
/// Largest distance of a removed candidate from the triangles, as a share of the radius of the pad.
const LARGEST_SAG: f64 = 0.05;
/// Largest edge of a triangle, in radii of the pad.
const LONGEST_EDGE: f64 = 2.0;
/// Least sine of the angles of a triangle.
const LEAST_SINE: f64 = 0.25;
/// Least cosine between the normals of a triangle before and after a collapse.
const LEAST_COSINE: f64 = 0.7;

/// A place that may become a contact point.
#[derive(Debug)]
pub(super) struct Candidate {
    pub(super) at: SkinPoint,
    pub(super) place_m: [f64; 3],
    /// Displacements at which forces are compared, m, with its own force there, N.
    pub(super) pushes: Vec<([f64; 3], [f64; 3])>,
    pub(super) jet: EnergyJet,
}

/// A triangulation of candidates, from which candidates are removed.
pub(super) struct Net {
    pub(super) candidates: Vec<Candidate>,
    pub(super) triangles: BTreeMap<usize, [usize; 3]>,
    /// Triangles round each candidate; none of a removed one.
    pub(super) around: Vec<BTreeSet<usize>>,
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
    pub(super) fn new(
        candidates: Vec<Candidate>,
        triangles: Vec<[usize; 3]>,
        tolerance: Tolerance,
        tip: &Fingertip,
    ) -> Self {
        let (around, triangles) = around(candidates.len(), triangles);
        Self { candidates, triangles, around, removed: BTreeMap::new(), tolerance, radius_m: tip.radius_m }
    }

    /// The edges, each once, ascending.
    pub(super) fn edges(&self) -> Vec<[usize; 2]> {
        let of = |[a, b, c]: &[usize; 3]| [[*a, *b], [*b, *c], [*c, *a]];
        let edges = self.triangles.values().flat_map(of).map(|[a, b]| [a.min(b), a.max(b)]);
        edges.collect::<BTreeSet<_>>().into_iter().collect()
    }

    pub(super) fn length_m(&self, edge: [usize; 2]) -> f64 {
        let [a, b] = edge.map(|end| self.candidates[end].place_m);
        distance(a, b)
    }

    /// Middle of an edge, m.
    pub(super) fn middle_m(&self, edge: [usize; 2]) -> [f64; 3] {
        let [a, b] = edge.map(|end| self.candidates[end].place_m);
        std::array::from_fn(|axis| 0.5 * (a[axis] + b[axis]))
    }

    /// Largest difference of the forces at the ends of an edge, in tolerances.
    pub(super) fn apart(&self, [a, b]: [usize; 2]) -> f64 {
        self.error(&self.candidates[a], [b; 3], [1.0, 0.0, 0.0])
    }

    /// Whether the force blended from the ends of an edge misses that of its middle.
    pub(super) fn is_missed(&self, [a, b]: [usize; 2], middle: &Candidate) -> bool {
        let error = self.error(middle, [a, b, b], [0.5, 0.5, 0.0]);
        error.is_nan() || error > SHARE
    }

    /// Adds candidates at the middles of edges, and divides the triangles there.
    pub(super) fn divide(&mut self, middles: BTreeMap<[usize; 2], Candidate>) {
        let mut at = BTreeMap::new();
        for (edge, middle) in middles {
            at.insert(edge, self.candidates.len());
            self.candidates.push(middle);
        }
        let place = |candidate: usize| self.candidates[candidate].place_m;
        let middle = |a: usize, b: usize| at.get(&[a.min(b), a.max(b)]).copied();
        let mut divided = Vec::new();
        for &[a, b, c] in self.triangles.values() {
            // Turned so that a missing middle comes last.
            let turned = [[a, b, c], [b, c, a], [c, a, b]];
            let has = |[a, b, c]: [usize; 3]| [middle(a, b), middle(b, c), middle(c, a)];
            let count = has([a, b, c]).iter().flatten().count();
            let [a, b, c] = turned
                .into_iter()
                .find(|&corners| has(corners)[..count].iter().all(Option::is_some))
                .expect("one of three turns");
            match has([a, b, c]) {
                [Some(ab), Some(bc), Some(ca)] => {
                    divided.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
                }
                [Some(ab), Some(bc), None] => {
                    divided.push([ab, b, bc]);
                    // The shorter diagonal of the rest.
                    if distance(place(a), place(bc)) <= distance(place(ab), place(c)) {
                        divided.extend([[a, ab, bc], [a, bc, c]]);
                    } else {
                        divided.extend([[a, ab, c], [ab, bc, c]]);
                    }
                }
                [Some(ab), ..] => divided.extend([[a, ab, c], [ab, b, c]]),
                _ => divided.push([a, b, c]),
            }
        }
        (self.around, self.triangles) = around(self.candidates.len(), divided);
    }

    /// Removes candidates until none can be removed, in each round the ones whose neighbours stay.
    pub(super) fn coarsen(&mut self) {
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
            let error = self.error(&self.candidates[candidate], triangles[index].0, weights);
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
    fn error(&self, candidate: &Candidate, corners: [usize; 3], weights: [f64; 3]) -> f64 {
        let error = |(push, own): &([f64; 3], [f64; 3])| {
            let forces = corners.map(|corner| self.candidates[corner].jet.taylor_force_n(*push));
            let blended: [f64; 3] =
                std::array::from_fn(|axis| (0..3).map(|k| weights[k] * forces[k][axis]).sum());
            distance(blended, *own) / self.tolerance.at(*own)
        };
        candidate.pushes.iter().map(error).fold(0.0, f64::max)
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

/// The numbered triangles, and those round each of `count` candidates.
fn around(count: usize, triangles: Vec<[usize; 3]>) -> (Vec<BTreeSet<usize>>, BTreeMap<usize, [usize; 3]>) {
    let mut around = vec![BTreeSet::new(); count];
    let triangles: BTreeMap<usize, [usize; 3]> = triangles.into_iter().enumerate().collect();
    for (&triangle, corners) in &triangles {
        for &corner in corners {
            around[corner].insert(triangle);
        }
    }
    (around, triangles)
}

#[cfg(test)]
mod tests;
