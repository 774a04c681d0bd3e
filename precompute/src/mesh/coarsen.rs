//! Coarsening away from a point: the mesh stays as it is where a tool holds it and grows coarse with the distance.
//!
//! Half-edge collapses, the shortest for their place first: a node moves onto a neighbour and takes its edges along, no node is made and none
//! is displaced. A collapse must keep the body a body (the link condition: Dey, Edelsbrunner, Guha and Nekhayev 1999), leave every tet
//! a fair shape, turn no triangle of the skin by much, keep what is fixed fixed and each material on its side.

use std::collections::{BTreeMap, BTreeSet};

use super::TetMesh;
use super::surface::FACES;
use super::tetrahedral::{EDGES, cross, distance, dot, norm, six_volume, sorted, sub};

/// What must survive a coarsening.
#[derive(Debug, Clone, Copy)]
pub struct Kept<'a> {
    /// The node round which the mesh stays as it is.
    pub centre: u32,
    /// Other nodes that stay.
    pub nodes: &'a [u32],
    /// Fixed nodes: they go onto fixed nodes only.
    pub fixed: &'a [u32],
    /// Number of each tet's material; none where there is but one.
    pub region_of_tet: &'a [u16],
}

/// A coarser mesh of the same body.
#[derive(Debug, Clone)]
pub struct Coarsened {
    /// The mesh; without groups.
    pub mesh: TetMesh,
    /// Number in it of each node of the finer one, if it is still there.
    node: Vec<Option<u32>>,
    /// The tet of the finer mesh that each tet was.
    was: Vec<u32>,
}

/// Least shape of a tet that a collapse may make, where the worst round it is better: 12 (3 V)^(2/3) / sum l^2, 1 if regular.
const SHAPE: f64 = 0.25;
/// A triangle of the skin turns by no more than this, as a cosine: 37 degrees.
const TURN: f64 = 0.8;
/// A collapse takes or adds no more than this share of the volume round its node: sharp edges of the body stay sharp.
const VOLUME: f64 = 0.04;
/// No edge that a collapse makes is longer than this by its place.
const LONGEST: f64 = 1.5;

impl Coarsened {
    /// Edges grow to `grade` times their distance from the centre.
    pub fn of(fine: &TetMesh, kept: Kept<'_>, grade: f64) -> Self {
        let mut work = Work::new(fine, kept, grade);
        while work.pass() {}
        work.done()
    }

    /// Those of these nodes that are still there, by their new numbers. Ascending.
    pub fn nodes(&self, fine: &[u32]) -> Vec<u32> {
        let mut nodes: Vec<u32> = fine.iter().filter_map(|&node| self.node[node as usize]).collect();
        nodes.sort_unstable();
        nodes
    }

    /// Those of these tets that are still there. Ascending.
    pub fn tets(&self, fine: &[u32]) -> Vec<u32> {
        let fine: BTreeSet<u32> = fine.iter().copied().collect();
        (0..).zip(&self.was).filter(|(_, was)| fine.contains(was)).map(|(tet, _)| tet).collect()
    }
}

/// A mesh while it is coarsened.
struct Work<'a> {
    nodes_m: &'a [[f64; 3]],
    region_of_tet: &'a [u16],
    centre_m: [f64; 3],
    grade: f64,
    stays: Vec<bool>,
    fixed: Vec<bool>,
    /// None once collapsed.
    tets: Vec<Option<[u32; 4]>>,
    /// Tets of each node.
    star: Vec<Vec<u32>>,
}

impl<'a> Work<'a> {
    fn new(fine: &'a TetMesh, kept: Kept<'a>, grade: f64) -> Self {
        let marked = |nodes: &[u32]| {
            let mut marks = vec![false; fine.nodes_m.len()];
            nodes.iter().for_each(|&node| marks[node as usize] = true);
            marks
        };
        let mut star = vec![Vec::new(); fine.nodes_m.len()];
        for (tet, nodes) in (0..).zip(&fine.tets) {
            nodes.iter().for_each(|&node| star[node as usize].push(tet));
        }
        let mut stays = marked(kept.nodes);
        stays[kept.centre as usize] = true;
        Self {
            nodes_m: &fine.nodes_m,
            region_of_tet: kept.region_of_tet,
            centre_m: fine.nodes_m[kept.centre as usize],
            grade,
            stays,
            fixed: marked(kept.fixed),
            tets: fine.tets.iter().copied().map(Some).collect(),
            star,
        }
    }

    fn at(&self, node: u32) -> &'a [f64; 3] {
        &self.nodes_m[node as usize]
    }

    /// Length of an edge by what its place allows.
    fn share(&self, a: u32, b: u32) -> f64 {
        let (a, b) = (self.at(a), self.at(b));
        let middle = std::array::from_fn(|i| 0.5 * (a[i] + b[i]));
        distance(a, b) / (self.grade * distance(&middle, &self.centre_m))
    }

    /// Whether it collapsed anything.
    fn pass(&mut self) -> bool {
        let edges: BTreeSet<[u32; 2]> =
            self.tets.iter().flatten().flat_map(|tet| EDGES.map(|(a, b)| sorted([tet[a], tet[b]]))).collect();
        let mut short: Vec<(f64, [u32; 2])> = edges
            .into_iter()
            .map(|[a, b]| (self.share(a, b), [a, b]))
            .filter(|(share, _)| *share < 1.0)
            .collect();
        short.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut any = false;
        for (_, [a, b]) in short {
            any |= self.collapse(a, b) || self.collapse(b, a);
        }
        any
    }

    /// Moves `from` onto `onto`, if it may.
    fn collapse(&mut self, from: u32, onto: u32) -> bool {
        if self.stays[from as usize] || self.fixed[from as usize] && !self.fixed[onto as usize] {
            return false;
        }
        let tets = |node: u32| {
            self.star[node as usize].iter().map(|&tet| (tet, self.tets[tet as usize].expect("in a star")))
        };
        let (shared, moving): (Vec<_>, Vec<_>) = tets(from).partition(|(_, tet)| tet.contains(&onto));
        if shared.is_empty() {
            return false;
        }
        let (own, other) =
            (Link::of(from, tets(from).map(|(_, tet)| tet)), Link::of(onto, tets(onto).map(|(_, tet)| tet)));
        let (own_regions, other_regions) = (self.regions(from), self.regions(onto));
        let is_sound = own.meets_as_its_edge(&other, from, onto)
            && own_regions.is_subset(&other_regions)
            && (own_regions.len() == 1 || self.is_on_interface(&shared, &own_regions))
            && self.keeps_shape(from, onto, &moving, &shared)
            && self.keeps_skin(from, onto, &own)
            && own.nodes.iter().all(|&node| node == onto || self.share(node, onto) <= LONGEST);
        if !is_sound {
            return false;
        }
        let moving: Vec<u32> = moving.into_iter().map(|(tet, _)| tet).collect();
        for (gone, nodes) in shared {
            self.tets[gone as usize] = None;
            nodes.iter().for_each(|&node| self.star[node as usize].retain(|&tet| tet != gone));
        }
        for &tet in &moving {
            let nodes = self.tets[tet as usize].as_mut().expect("in a star");
            nodes.iter_mut().filter(|node| **node == from).for_each(|node| *node = onto);
        }
        self.star[onto as usize].extend(moving);
        self.star[from as usize].clear();
        true
    }

    fn region(&self, tet: u32) -> u16 {
        self.region_of_tet.get(tet as usize).copied().unwrap_or(0)
    }

    fn regions(&self, node: u32) -> BTreeSet<u16> {
        self.star[node as usize].iter().map(|&tet| self.region(tet)).collect()
    }

    /// Whether the edge of these tets lies between the same materials as its end.
    fn is_on_interface(&self, shared: &[(u32, [u32; 4])], regions: &BTreeSet<u16>) -> bool {
        shared.iter().map(|&(tet, _)| self.region(tet)).collect::<BTreeSet<u16>>() == *regions
    }

    fn keeps_shape(
        &self,
        from: u32,
        onto: u32,
        moving: &[(u32, [u32; 4])],
        shared: &[(u32, [u32; 4])],
    ) -> bool {
        // Shape of the worst, and volume of all.
        let of = |tets: &mut dyn Iterator<Item = [u32; 4]>| {
            tets.map(|tet| tet.map(|node| *self.at(node)))
                .fold((f64::INFINITY, 0.0), |(worst, sum), x| (shape(&x).min(worst), six_volume(&x) + sum))
        };
        let (before, old) = of(&mut moving.iter().chain(shared).map(|&(_, tet)| tet));
        let (after, new) =
            of(&mut moving.iter().map(|&(_, tet)| tet.map(|node| if node == from { onto } else { node })));
        after >= SHAPE.min(before) && (new - old).abs() <= VOLUME * old
    }

    fn keeps_skin(&self, from: u32, onto: u32, own: &Link) -> bool {
        own.skin.iter().filter(|edge| !edge.contains(&onto)).all(|&[a, b]| {
            let normal = |tip: u32| cross(&sub(self.at(a), self.at(tip)), &sub(self.at(b), self.at(tip)));
            let (old, new) = (normal(from), normal(onto));
            dot(&old, &new) >= TURN * norm(&old) * norm(&new) && norm(&new) > 0.0
        })
    }

    fn done(self) -> Coarsened {
        let mut node = vec![None; self.nodes_m.len()];
        let mut mesh = TetMesh::default();
        for (old, _) in self.star.iter().enumerate().filter(|(_, star)| !star.is_empty()) {
            node[old] = Some(mesh.nodes_m.len() as u32);
            mesh.nodes_m.push(self.nodes_m[old]);
        }
        let mut was = Vec::new();
        for (old, tet) in (0..).zip(&self.tets) {
            if let Some(tet) = tet {
                was.push(old);
                mesh.tets.push(tet.map(|n| node[n as usize].expect("it has a tet")));
            }
        }
        Coarsened { mesh, node, was }
    }
}

/// What is round a node.
struct Link {
    nodes: BTreeSet<u32>,
    edges: BTreeSet<[u32; 2]>,
    faces: BTreeSet<[u32; 3]>,
    /// Edges that make, with the node, triangles of the skin.
    skin: Vec<[u32; 2]>,
}

impl Link {
    fn of(node: u32, tets: impl Iterator<Item = [u32; 4]>) -> Self {
        let mut link =
            Self { nodes: BTreeSet::new(), edges: BTreeSet::new(), faces: BTreeSet::new(), skin: Vec::new() };
        // Triangles at the node: those of one tet are skin.
        let mut uses: BTreeMap<[u32; 2], u32> = BTreeMap::new();
        for tet in tets {
            for face in FACES.map(|face| face.map(|v| tet[v])) {
                if face.contains(&node) {
                    let [a, b] = others(face, node);
                    *uses.entry(sorted([a, b])).or_default() += 1;
                } else {
                    link.nodes.extend(face);
                    link.edges.extend(
                        [[0, 1], [1, 2], [0, 2]].map(|[a, b]: [usize; 2]| sorted([face[a], face[b]])),
                    );
                    link.faces.insert(sorted(face));
                }
            }
        }
        link.skin = uses.into_iter().filter(|(_, tets)| *tets == 1).map(|(edge, _)| edge).collect();
        link
    }

    /// The link condition, on the body and on its skin.
    fn meets_as_its_edge(&self, other: &Self, from: u32, onto: u32) -> bool {
        // Of the edge from-onto: the edges of the tets that have both, less the two.
        let with = |link: &Self, end: u32| -> BTreeSet<u32> {
            link.edges
                .iter()
                .filter(|edge| edge.contains(&end))
                .flatten()
                .copied()
                .filter(|&n| n != end)
                .collect()
        };
        let ring = with(self, onto);
        let rim: BTreeSet<[u32; 2]> = self
            .faces
            .iter()
            .filter(|face| face.contains(&onto))
            .map(|&face| sorted(others(face, onto)))
            .collect();
        let nodes: BTreeSet<u32> = self.nodes.intersection(&other.nodes).copied().collect();
        let edges = self
            .edges
            .intersection(&other.edges)
            .filter(|edge| !edge.contains(&from) && !edge.contains(&onto));
        let is_sound = nodes == ring && edges.eq(rim.iter()) && self.faces.is_disjoint(&other.faces);
        if !is_sound || self.skin.is_empty() {
            return is_sound;
        }
        // A node of the skin moves along the skin, and the only triangles it closes are those of its edge.
        let across = |link: &Self, end: u32| -> BTreeSet<u32> {
            link.skin
                .iter()
                .filter(|edge| edge.contains(&end))
                .flatten()
                .copied()
                .filter(|&n| n != end)
                .collect()
        };
        let on_skin = |link: &Self| -> BTreeSet<u32> { link.skin.iter().flatten().copied().collect() };
        let both = across(self, onto);
        let common: BTreeSet<u32> = on_skin(self).intersection(&on_skin(other)).copied().collect();
        both.len() == 2 && common == both
    }
}

fn others(face: [u32; 3], node: u32) -> [u32; 2] {
    match face {
        [n, a, b] | [a, n, b] | [a, b, n] if n == node => [a, b],
        _ => unreachable!("the node is one of the face's"),
    }
}

/// 12 (3 V)^(2/3) / sum l^2; 0 where it is flat or inside out.
fn shape(x: &[[f64; 3]; 4]) -> f64 {
    let squares: f64 = EDGES.iter().map(|&(a, b)| distance(&x[a], &x[b]).powi(2)).sum();
    12.0 * (0.5 * six_volume(x).max(0.0)).powf(2.0 / 3.0) / squares
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Surface;

    /// A block of two materials, held on one side, with nothing regular about its inside.
    fn block() -> (TetMesh, Vec<u32>, Vec<u16>) {
        const CELLS: [usize; 3] = [10, 6, 6];
        let mut mesh = TetMesh::cuboid(CELLS, 0.01);
        let skin = Surface::of(&mesh);
        for n in (0..mesh.nodes_m.len()).filter(|&n| !skin.contains(n as u32)) {
            if (mesh.nodes_m[n][0] - 0.05).abs() > 1e-9 {
                mesh.nodes_m[n][n % 3] += 0.001 * ((n * 7 % 5) as f64 - 2.0);
            }
        }
        let fixed = (0..mesh.nodes_m.len() as u32).filter(|&n| mesh.nodes_m[n as usize][0] < 1e-9).collect();
        let middle = |tet: usize| mesh.vertices_m(tet).iter().map(|x| x[0]).sum::<f64>() / 4.0;
        let region = (0..mesh.tets.len()).map(|tet| u16::from(middle(tet) > 0.05)).collect();
        (mesh, fixed, region)
    }

    #[test]
    fn far_from_its_centre_the_same_body_has_fewer_tets() {
        let (fine, fixed, region_of_tet) = block();
        fine.check().expect("sound");
        let centre =
            (0..).zip(&fine.nodes_m).find(|(_, x)| distance(x, &[0.1, 0.03, 0.06]) < 1e-9).expect("a node").0;
        let kept = Kept { centre, nodes: &[7], fixed: &fixed, region_of_tet: &region_of_tet };
        let coarse = Coarsened::of(&fine, kept, 0.6);
        coarse.mesh.check().expect("sound");
        println!("{} of {} nodes", coarse.mesh.nodes_m.len(), fine.nodes_m.len());
        assert!(3 * coarse.mesh.nodes_m.len() < fine.nodes_m.len(), "{}", coarse.mesh.nodes_m.len());
        // Its skin is closed; body and halves keep their volume but for the edges of the box, which collapses may bevel.
        let skin = Surface::of(&coarse.mesh);
        assert!(skin.topology.is_manifold() && skin.topology.euler_characteristic == 2);
        let near_one = |ratio: f64| assert!((ratio - 1.0).abs() < 0.03, "{ratio}");
        near_one(coarse.mesh.volume_m3() / fine.volume_m3());
        let half = |mesh: &TetMesh, tets: &[u32]| {
            tets.iter().map(|&t| mesh.signed_volume_m3(t as usize)).sum::<f64>()
        };
        let first: Vec<u32> =
            (0..).zip(&region_of_tet).filter(|(_, region)| **region == 0).map(|(t, _)| t).collect();
        near_one(half(&coarse.mesh, &coarse.tets(&first)) / half(&fine, &first));
        // Fixed is the same face, what was to stay is there, and so is all round the centre.
        assert!(coarse.nodes(&fixed).iter().all(|&n| coarse.mesh.nodes_m[n as usize][0] < 1e-9));
        assert!(coarse.nodes(&fixed).len() >= 4);
        assert_eq!(coarse.nodes(&[7, centre]).len(), 2);
        let near = |mesh: &TetMesh| {
            mesh.nodes_m.iter().filter(|x| distance(x, &fine.nodes_m[centre as usize]) < 0.015).count()
        };
        assert_eq!(near(&coarse.mesh), near(&fine));
        let worst =
            (0..coarse.mesh.tets.len()).map(|t| shape(&coarse.mesh.vertices_m(t))).fold(1.0, f64::min);
        let was = (0..fine.tets.len()).map(|t| shape(&fine.vertices_m(t))).fold(1.0, f64::min);
        assert!(worst >= SHAPE.min(was), "{worst} {was}");
        // Every time the same.
        assert_eq!(Coarsened::of(&fine, kept, 0.6).mesh, coarse.mesh);
    }

    #[test]
    fn a_shape_is_one_if_regular_and_nothing_if_flat() {
        let regular = [[1.0, 1.0, 1.0], [-1.0, 1.0, -1.0], [1.0, -1.0, -1.0], [-1.0, -1.0, 1.0]];
        assert!((shape(&regular) - 1.0).abs() < 1e-12);
        let [a, b, c, d] = regular;
        assert_eq!(shape(&[b, a, c, d]), 0.0);
    }
}
