//! Local refinement by bisection of longest edges (Rivara 1997). The domain does not change.
//!
//! An edge is divided in all its tets at once, so that the mesh is conforming after each step. It is divided only
//! if it is the longest edge of each of them: from the longest edge of a coarse tet, the search goes on to a
//! longer edge of a neighbour until there is none. Children thus keep a good shape, also after many steps. What
//! to divide next follows from the mesh alone: a second refinement continues the first as if it were one.

use std::cmp::Ordering;
use std::collections::{BTreeMap, HashMap};

use super::refine::Refined;
use super::surface::FACES;
use super::tetrahedral::{EDGES, six_volume, sorted};
use super::{TetMesh, nearest_on_triangle};
use crate::num::vector::distance;

/// Number of bisections that divide a tet into eight, and so halve its size.
pub(crate) const BISECTIONS_A_LEVEL: u32 = 3;

impl Refined {
    /// Bisects tets as long as `is_coarse` accepts their vertices and the number of bisections that made them.
    /// `None` if there are more than `most_tets`.
    pub(crate) fn locally(
        coarse: &TetMesh,
        most_tets: usize,
        is_coarse: impl Fn(&[[f64; 3]; 4], u32) -> bool,
    ) -> Option<Self> {
        let mut bisection = Bisection::of(coarse);
        loop {
            let before = bisection.tets.len();
            let mut tet = 0;
            while tet < bisection.tets.len() {
                while is_coarse(&bisection.vertices_m(tet), bisection.made_by[tet]) {
                    bisection.divide(bisection.terminal_edge(tet));
                    if bisection.tets.len() > most_tets {
                        return None;
                    }
                }
                tet += 1;
            }
            // A neighbour may have divided a tet that was fine, and a part of it may be coarse.
            if bisection.tets.len() == before {
                return Some(bisection.finish(coarse));
            }
        }
    }
}

/// Mean length of the six edges of a tet, m.
pub(crate) fn mean_edge_m(vertices_m: &[[f64; 3]; 4]) -> f64 {
    EDGES.iter().map(|&[a, b]| distance(vertices_m[a], vertices_m[b])).sum::<f64>() / 6.0
}

/// The mesh while it is refined.
struct Bisection {
    nodes_m: Vec<[f64; 3]>,
    tets: Vec<[u32; 4]>,
    /// The tet of the coarse mesh that contains each tet.
    parent: Vec<u32>,
    /// Number of bisections that made each tet.
    made_by: Vec<u32>,
    /// Ends of the edge of each new node.
    ends: Vec<[u32; 2]>,
    /// The tets at each edge.
    at_edge: HashMap<[u32; 2], Vec<u32>>,
}

impl Bisection {
    fn of(mesh: &TetMesh) -> Self {
        let mut at_edge: HashMap<[u32; 2], Vec<u32>> = HashMap::with_capacity(2 * mesh.tets.len());
        for (number, tet) in (0..).zip(&mesh.tets) {
            for edge in EDGES {
                at_edge.entry(sorted(edge.map(|v| tet[v]))).or_default().push(number);
            }
        }
        Self {
            nodes_m: mesh.nodes_m.clone(),
            tets: mesh.tets.clone(),
            parent: (0..mesh.tets.len() as u32).collect(),
            made_by: vec![0; mesh.tets.len()],
            ends: Vec::new(),
            at_edge,
        }
    }

    fn vertices_m(&self, tet: usize) -> [[f64; 3]; 4] {
        self.tets[tet].map(|node| self.nodes_m[node as usize])
    }

    /// By length; of equal edges, by the numbers of their ends, so that all tets agree on the longest.
    fn compare(&self, one: [u32; 2], other: [u32; 2]) -> Ordering {
        let length_m = |ends: [u32; 2]| {
            let [a, b] = ends.map(|end| self.nodes_m[end as usize]);
            distance(a, b)
        };
        length_m(one).total_cmp(&length_m(other)).then(one.cmp(&other))
    }

    fn longest_edge(&self, tet: usize) -> [u32; 2] {
        let edges = EDGES.map(|edge| sorted(edge.map(|v| self.tets[tet][v])));
        edges[1..].iter().fold(
            edges[0],
            |longest, &edge| {
                if self.compare(edge, longest).is_gt() { edge } else { longest }
            },
        )
    }

    /// The edge at the end of the path from this tet to longer and longer edges of neighbours.
    fn terminal_edge(&self, tet: usize) -> [u32; 2] {
        let mut edge = self.longest_edge(tet);
        loop {
            let around = self.at_edge[&edge].iter().map(|&tet| self.longest_edge(tet as usize));
            let Some(longer) = around.into_iter().find(|&other| other != edge) else { return edge };
            edge = longer;
        }
    }

    /// Divides the tets at an edge in its middle. One half keeps the number of the tet.
    fn divide(&mut self, edge: [u32; 2]) {
        let [a, b] = edge;
        let middle = self.nodes_m.len() as u32;
        let [at_a, at_b] = edge.map(|end| self.nodes_m[end as usize]);
        self.nodes_m.push(std::array::from_fn(|axis| 0.5 * (at_a[axis] + at_b[axis])));
        self.ends.push(edge);
        for tet in self.at_edge.remove(&edge).unwrap_or_default() {
            let whole = self.tets[tet as usize];
            let half = |without: u32| whole.map(|node| if node == without { middle } else { node });
            let other = self.tets.len() as u32;
            self.tets[tet as usize] = half(b);
            self.tets.push(half(a));
            self.parent.push(self.parent[tet as usize]);
            self.made_by[tet as usize] += 1;
            self.made_by.push(self.made_by[tet as usize]);
            let [c, d] = beside(whole, edge);
            for node in [c, d] {
                for of in self.at_edge.get_mut(&sorted([b, node])).into_iter().flatten() {
                    *of = if *of == tet { other } else { *of };
                }
            }
            let new = [([c, d], other), ([a, middle], tet), ([b, middle], other)];
            let inner = [c, d].map(|node| [([node, middle], tet), ([node, middle], other)]);
            for (ends, half) in new.into_iter().chain(inner.into_iter().flatten()) {
                self.at_edge.entry(sorted(ends)).or_default().push(half);
            }
        }
    }

    /// The mesh with the children of each tet together, in the order of the coarse tets.
    fn finish(self, coarse: &TetMesh) -> Refined {
        let mut order: Vec<usize> = (0..self.tets.len()).collect();
        order.sort_by_key(|&tet| self.parent[tet]);
        let mut first_child = vec![0; coarse.tets.len() + 1];
        for &parent in &self.parent {
            first_child[parent as usize + 1] += 1;
        }
        for tet in 0..coarse.tets.len() {
            first_child[tet + 1] += first_child[tet];
        }
        let tets = order.into_iter().map(|tet| self.tets[tet]).collect();
        Refined::new(coarse, self.nodes_m, tets, self.ends, first_child)
    }
}

/// The two vertices of a tet that are not on this edge of it.
fn beside(tet: [u32; 4], edge: [u32; 2]) -> [u32; 2] {
    let mut others = tet.into_iter().filter(|node| !edge.contains(node));
    std::array::from_fn(|_| others.next().expect("a tet has two vertices beside an edge"))
}

/// Places in cells of a grid, to find the tets within a distance of any of them.
pub(crate) struct Near {
    within_m: f64,
    cells: BTreeMap<[i64; 3], Vec<[f64; 3]>>,
}

impl Near {
    /// What is within `within_m` (positive) of these places.
    pub(crate) fn new(places_m: &[[f64; 3]], within_m: f64) -> Self {
        let mut cells: BTreeMap<[i64; 3], Vec<[f64; 3]>> = BTreeMap::new();
        for &place_m in places_m {
            cells.entry(place_m.map(|x| (x / within_m).floor() as i64)).or_default().push(place_m);
        }
        Self { within_m, cells }
    }

    /// Whether any part of a tet of positive volume is within the distance.
    pub(crate) fn reaches(&self, vertices_m: &[[f64; 3]; 4]) -> bool {
        let side = |fold: fn(f64, f64) -> f64, off: f64| -> [i64; 3] {
            std::array::from_fn(|axis| {
                let end = vertices_m.iter().map(|x| x[axis]).reduce(fold).expect("four vertices");
                ((end + off) / self.within_m).floor() as i64
            })
        };
        let (low, high) = (side(f64::min, -self.within_m), side(f64::max, self.within_m));
        let is_in = |cell: &[i64; 3]| (0..3).all(|axis| (low[axis]..=high[axis]).contains(&cell[axis]));
        let rows = self.cells.range([low[0], i64::MIN, i64::MIN]..=[high[0], i64::MAX, i64::MAX]);
        rows.filter(|(cell, _)| is_in(cell))
            .flat_map(|(_, places)| places)
            .any(|&place_m| distance_m(vertices_m, place_m) <= self.within_m)
    }
}

/// Distance of a point from a tet of positive volume, m; zero inside.
fn distance_m(vertices_m: &[[f64; 3]; 4], point_m: [f64; 3]) -> f64 {
    let faces = FACES.map(|face| face.map(|v| vertices_m[v]));
    if faces.iter().all(|&[a, b, c]| six_volume(&[point_m, a, c, b]) >= 0.0) {
        return 0.0;
    }
    let away = faces.map(|face| distance(nearest_on_triangle(face, point_m).0, point_m));
    away.into_iter().fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests;
