//! The features of a deformed skin that are nearest to a sphere.
//!
//! The skin consists of the triangles between its nodes: with quadratic elements four for each face, because the nodes
//! between the corners move by themselves. A feature counts if the centre has a foot inside it that is a local minimum
//! of the distance: an edge or a vertex, if no triangle at it comes nearer. Triangles that share a foot so give one
//! feature; at a concave edge both faces count, if the centre has a foot in each.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

use nalgebra::Vector3;

use super::gap::{Feature, Gap};
use crate::fem::body::Body;
use crate::mesh::nearest_on_triangle;

/// Distances that differ by less than this share are those of one foot.
const SAME: f64 = 1e-9;

/// The triangles of a skin, and those at each edge and vertex.
#[derive(Debug)]
pub(crate) struct Skin {
    triangles: Vec<[u32; 3]>,
    /// Triangles at each edge and vertex.
    at: BTreeMap<Feature, Vec<u32>>,
}

impl Skin {
    /// The skin of a body.
    pub(crate) fn of(body: &Body) -> Self {
        let triangles: Vec<[u32; 3]> = body
            .skin()
            .flat_map(|face| match *face {
                [a, b, c, ab, bc, ca] => vec![[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]],
                _ => vec![[face[0], face[1], face[2]]],
            })
            .collect();
        let mut at: BTreeMap<Feature, Vec<u32>> = BTreeMap::new();
        for (index, &[a, b, c]) in (0..).zip(&triangles) {
            for feature in [&[a][..], &[b], &[c], &[a, b], &[b, c], &[c, a]] {
                at.entry(Feature::between(feature)).or_default().push(index);
            }
        }
        Self { triangles, at }
    }

    /// The gaps of the features that count and whose distance from the centre is below `within_m`, ascending by
    /// feature. `place` gives the place of a node.
    pub(crate) fn near(
        &self,
        place: &dyn Fn(u32) -> Vector3<f64>,
        centre_m: Vector3<f64>,
        within_m: f64,
    ) -> Vec<Gap> {
        let mut found: BTreeMap<Feature, (f64, Gap)> = BTreeMap::new();
        let mut nearest: BTreeMap<u32, f64> = BTreeMap::new();
        for (index, triangle) in (0..).zip(&self.triangles) {
            let corners = triangle.map(place);
            let low = corners[0].inf(&corners[1]).inf(&corners[2]);
            let high = corners[0].sup(&corners[1]).sup(&corners[2]);
            if (low - centre_m).max() > within_m || (centre_m - high).max() > within_m {
                continue;
            }
            let (at, weights) = nearest_on_triangle(corners.map(Into::into), centre_m.into());
            let away_m = (Vector3::from(at) - centre_m).norm();
            if away_m >= within_m {
                continue;
            }
            nearest.insert(index, away_m);
            let inside: Vec<u32> =
                triangle.iter().zip(weights).filter(|(_, w)| *w > 0.0).map(|(node, _)| *node).collect();
            let feature = Feature::between(&inside);
            if let Entry::Vacant(room) = found.entry(feature) {
                let mut places = [Vector3::zeros(); 3];
                for (to, &node) in places.iter_mut().zip(feature.corners()) {
                    *to = place(node);
                }
                if let Some(gap) = Gap::new(feature, places, centre_m) {
                    room.insert((away_m, gap));
                }
            }
        }
        // A triangle at the feature that is not within the distance is not nearer.
        let is_minimum = |feature: &Feature, away_m: f64| {
            let around = self.at.get(feature).into_iter().flatten();
            around.filter_map(|triangle| nearest.get(triangle)).all(|near_m| *near_m >= away_m * (1.0 - SAME))
        };
        found
            .into_iter()
            .filter(|(feature, (away_m, _))| is_minimum(feature, *away_m))
            .map(|(_, (_, gap))| gap)
            .collect()
    }
}
