//! The places of the skin that a map pushes at, and the part of the skin that each stands for.

use crate::mesh::{SkinPoint, Surface};
use crate::num::vector::{cross, difference, distance, norm};
use crate::scene::ResolvedScene;
use crate::spec::{ActiveNode, Tool};

/// A place of the skin.
#[derive(Debug, Clone, PartialEq)]
pub struct Place {
    /// The tool's contact there.
    pub active: ActiveNode,
    /// Position on the undeformed body, m.
    pub position_m: [f64; 3],
    /// Inward unit normal.
    pub inward: [f64; 3],
    /// Area of the skin that the place stands for, m^2.
    pub area_m2: f64,
    /// Mean edge of the triangles of the skin there, m.
    pub edge_m: f64,
}

/// Up to this edge of the skin, in radii of the tool, the force of quadratic elements is within about 8 % of
/// its limit.
pub const SURE_EDGE: f64 = 1.0;

impl Place {
    /// A place that a scene names, without an area; `None` if it is not on the skin. A fingertip touches a
    /// node as a contact point there.
    pub fn named(scene: &ResolvedScene, active: &ActiveNode) -> Option<Self> {
        let skin = Surface::of(&scene.mesh);
        let inward = active.normal(&skin)?.map(|x| -x);
        let position_m = active.place_m(&scene.mesh);
        let active = match (scene.tool, active.contact) {
            (Tool::Fingertip(_), None) => {
                ActiveNode::at(active.name.clone(), skin.nearest(&scene.mesh, position_m)?)
            }
            _ => active.clone(),
        };
        Some(Self { active, position_m, inward, area_m2: 0.0, edge_m: 0.0 })
    }
}

/// Places over the free skin.
#[derive(Debug, Clone, PartialEq)]
pub struct Places {
    /// The places.
    pub places: Vec<Place>,
    /// The free nodes of the skin, ascending.
    pub nodes: Vec<u32>,
    /// The place that stands for each of `nodes`: the nearest one.
    pub owner: Vec<u32>,
    /// The whole outer skin, fixed parts included.
    pub skin: Surface,
}

impl Places {
    /// The free vertices of the outer skin, or `limit` of them, evenly spread: each next one is the farthest
    /// from those before it.
    pub fn over(scene: &ResolvedScene, limit: Option<usize>) -> Self {
        let mesh = &scene.mesh;
        let skin = Surface::of(mesh).seen(mesh);
        let is_free = |node: &u32| scene.fixed.binary_search(node).is_err();
        let has_normal = |node: &u32| skin.normal(*node).is_some_and(|normal| normal != [0.0; 3]);
        let nodes: Vec<u32> =
            skin.nodes.iter().copied().filter(|node| is_free(node) && has_normal(node)).collect();
        let at = |node: u32| mesh.nodes_m[node as usize];
        let (chosen, owner) = spread(&nodes.iter().map(|&node| at(node)).collect::<Vec<_>>(), limit);
        let mut corner_of = vec![None; mesh.nodes_m.len()];
        let mut area_m2 = vec![0.0; mesh.nodes_m.len()];
        let mut edges_m = vec![(0.0, 0); mesh.nodes_m.len()];
        for triangle in &skin.triangles {
            let [a, b, c] = triangle.map(at);
            let third_m2 = norm(cross(difference(b, a), difference(c, a))) / 6.0;
            let around_m = distance(a, b) + distance(b, c) + distance(c, a);
            for &node in triangle {
                corner_of[node as usize].get_or_insert(*triangle);
                area_m2[node as usize] += third_m2;
                let (sum_m, count) = &mut edges_m[node as usize];
                *sum_m += around_m;
                *count += 3;
            }
        }
        let place = |&which: &usize| {
            let node = nodes[which];
            let triangle = corner_of[node as usize].expect("a node of the skin");
            let weights = triangle.map(|corner| f64::from(u8::from(corner == node)));
            let name = node.to_string();
            let active = match scene.tool {
                Tool::Point => ActiveNode::node(name, node),
                _ => ActiveNode::at(name, SkinPoint { triangle, weights }),
            };
            let inward = skin.normal(node).expect("a node of the skin").map(|x| -x);
            let (sum_m, count) = edges_m[node as usize];
            Place { active, position_m: at(node), inward, area_m2: 0.0, edge_m: sum_m / f64::from(count) }
        };
        let mut places: Vec<Place> = chosen.iter().map(place).collect();
        for (&node, &owner) in nodes.iter().zip(&owner) {
            places[owner as usize].area_m2 += area_m2[node as usize];
        }
        Self { places, nodes, owner, skin }
    }

    /// Total area that the places stand for, m^2.
    pub fn area_m2(&self) -> f64 {
        self.places.iter().map(|place| place.area_m2).sum()
    }

    /// The value of each node of the skin: that of its place, or `None` for a fixed node.
    pub fn on_skin<T: Copy>(&self, of_places: &[Option<T>]) -> Vec<Option<T>> {
        let value = |node: &u32| {
            let at = self.nodes.binary_search(node).ok()?;
            of_places[self.owner[at] as usize]
        };
        self.skin.nodes.iter().map(value).collect()
    }
}

/// `limit` of the points, ascending, and the position among them of the one nearest to each point.
fn spread(points_m: &[[f64; 3]], limit: Option<usize>) -> (Vec<usize>, Vec<u32>) {
    let limit = limit.unwrap_or(points_m.len()).min(points_m.len());
    if limit == points_m.len() {
        return ((0..limit).collect(), (0..limit as u32).collect());
    }
    let mut chosen = Vec::with_capacity(limit);
    let mut away_m = vec![f64::INFINITY; points_m.len()];
    while chosen.len() < limit {
        // The first of the farthest points.
        let next = (1..points_m.len()).fold(0, |far, n| if away_m[n] > away_m[far] { n } else { far });
        chosen.push(next);
        for (away, point) in away_m.iter_mut().zip(points_m) {
            *away = away.min(distance(*point, points_m[next]));
        }
    }
    chosen.sort_unstable();
    let nearest = |point: &[f64; 3]| {
        let away = |n: &usize| distance(points_m[chosen[*n]], *point);
        (0..chosen.len()).min_by(|a, b| away(a).total_cmp(&away(b))).unwrap_or(0) as u32
    };
    let owner = points_m.iter().map(nearest).collect();
    (chosen, owner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_few_points_are_spread_over_all() {
        let points: Vec<[f64; 3]> = (0..11).map(|n| [f64::from(n), 0.0, 0.0]).collect();
        let (chosen, owner) = spread(&points, Some(3));
        assert_eq!(chosen, [0, 5, 10]);
        assert_eq!(owner, [0, 0, 0, 1, 1, 1, 1, 1, 2, 2, 2]);
        assert_eq!(spread(&points, None).0.len(), 11);
        assert_eq!(spread(&points, Some(20)), spread(&points, None));
        assert_eq!(spread(&[], Some(3)), (vec![], vec![]));
    }
}
