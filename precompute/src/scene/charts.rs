//! The charts of a sphere's field: places of the centre where the sphere just touches the skin, and the part of the space
//! round each that its table covers.
//!
//! The energy W(c) of a sphere is no function of the place of its centre c: an organ that gives way by centimetres has at
//! one c the equilibrium of a push from the front and that of one from behind. It is one where the sphere came in on the
//! same side. So the field has a table for each of many places of the surface of the first touch, a *chart*, valid in a
//! column along the normal there. A vertex of that surface belongs to the chart of the nearest place. Round a rim of the
//! body the surface is long, so that it has a chart for each side.

use std::collections::BTreeSet;

use palpate_core::Limits;
use toml::Spanned;

use super::ActiveNode;
use super::place::Place;
use crate::error::InputError;
use crate::fem::Sphere;
use crate::mesh::{Offset, SkinPoint, Surface, TetMesh};
use crate::num::vector::{difference, distance, dot, norm, unit};
use crate::spec::{BESIDE, Chart, Charts, Column, from_axis_m};

/// Least distance of two places, in radii of the sphere.
const APART: f64 = 1.0;
/// Depth of the origin of a chart below the first touch, in radii: there the body is surely touched.
const DEPTH: f64 = 0.3;

/// Length of the kernel of the fits, in radii.
const LENGTH: f64 = 1.0;
/// Charts of a sphere for a unit of skin of the radius squared, about; twice as many as a blob can hold are not built.
const A_SQUARE: f64 = 0.8;

/// The charts of a sphere on the free skin, as active nodes. The places are chosen one by one, each as far as possible
/// from those before; so neighbours have distant numbers.
///
/// # Errors
///
/// If they are more than a blob can hold; the error is one of the table of the tool.
pub(super) fn charts<T>(
    mesh: &TetMesh,
    skin: &Surface,
    fixed: &[u32],
    sphere: &Sphere,
    (place, table): (&Place, Option<&Spanned<T>>),
) -> Result<(Vec<ActiveNode>, Charts), InputError> {
    let too_small = |what: String| {
        let fix = "give a larger `radius_m`, or leave out [grid] and use `palpate live`";
        place.error(table.map_or(0..0, Spanned::span), what, fix)
    };
    let too_many = |charts: usize| {
        let most = Limits::PC.spaces;
        too_small(format!(
            "the field of so small a sphere has about {charts} charts, and a blob holds {most}"
        ))
    };
    let about = (A_SQUARE * skin.area_m2(mesh) / sphere.radius_m.powi(2)) as usize;
    if about > 2 * Limits::PC.spaces {
        return Err(too_many(about));
    }
    let is_free = |foot: &SkinPoint| {
        let nodes = foot.triangle.iter().zip(foot.weights).filter(|(_, weight)| *weight > 0.0);
        nodes.into_iter().any(|(node, _)| fixed.binary_search(node).is_err())
    };
    let Some(Offset { places_m, feet, triangles }) = Offset::of(mesh, skin, is_free, sphere.reach_m()) else {
        return Err(too_small("the sphere is too small for the extent of the body".into()));
    };
    let (mut chosen, mut owners) = (Vec::new(), vec![0; places_m.len()]);
    let mut away_m = vec![f64::INFINITY; places_m.len()];
    while let Some(next) = (0..away_m.len()).max_by(|&a, &b| away_m[a].total_cmp(&away_m[b]).then(b.cmp(&a)))
        && away_m[next] >= APART * sphere.radius_m
    {
        for (vertex, least_m) in away_m.iter_mut().enumerate() {
            let to_next_m = distance(places_m[vertex], places_m[next]);
            if to_next_m < *least_m {
                (*least_m, owners[vertex]) = (to_next_m, chosen.len() as u32);
            }
        }
        chosen.push(next);
    }
    if chosen.len() > Limits::PC.spaces {
        return Err(too_many(chosen.len()));
    }
    let beside = beside(&owners, &triangles, chosen.len());
    let chart = |(number, &vertex): (usize, &usize)| {
        let (place_m, normal) = (places_m[vertex], feet[vertex].1);
        let owned = triangles
            .iter()
            .filter(|corners| corners.iter().any(|&corner| owners[corner as usize] as usize == number));
        let (mut core_m, mut whole_m, mut top_m) = (0.5 * sphere.radius_m, sphere.radius_m, 0.0f64);
        for corners in owned {
            for &corner in corners {
                let away_m = difference(places_m[corner as usize], place_m);
                let across_m = from_axis_m(&normal, away_m);
                whole_m = whole_m.max(across_m);
                top_m = top_m.max(dot(away_m, normal));
                if owners[corner as usize] as usize == number {
                    core_m = core_m.max(across_m);
                }
            }
        }
        let depth_m = DEPTH * sphere.radius_m;
        let to_beside_m = beside[number].iter().map(|&n| difference(places_m[chosen[n as usize]], place_m));
        let column = Column {
            beside: half_way(to_beside_m, (normal, depth_m)),
            core_m,
            whole_m,
            top_m: top_m + depth_m,
            length_m: LENGTH * sphere.radius_m,
        };
        let centre_m = std::array::from_fn(|k| place_m[k] - depth_m * normal[k]);
        Chart { centre_m, normal, column }
    };
    let charts: Vec<Chart> = chosen.iter().enumerate().map(chart).collect();
    let active = (1..).zip(&chosen).zip(&charts).map(|((number, &vertex), chart)| ActiveNode {
        chart: Some(*chart),
        ..ActiveNode::at(format!("skin-{number}"), feet[vertex].0)
    });
    let active = active.collect();
    Ok((active, Charts { sphere: *sphere, charts, places_m, owners, triangles }))
}

/// The planes half way to places beside one, the nearest first, for displacements from `depth_m` below it.
fn half_way(
    to_m: impl Iterator<Item = [f64; 3]>,
    (normal, depth_m): ([f64; 3], f64),
) -> [([f64; 3], f64); BESIDE] {
    let plane = |to_m: [f64; 3]| {
        let towards = unit(to_m);
        (towards, 0.5 * norm(to_m) + depth_m * dot(towards, normal))
    };
    let mut planes: Vec<([f64; 3], f64)> = to_m.map(plane).collect();
    planes.sort_by(|a, b| a.1.total_cmp(&b.1));
    planes.resize(BESIDE, ([0.0; 3], 0.0));
    std::array::from_fn(|k| planes[k])
}

/// The charts beside each: those of the other corners of its triangles.
fn beside(owners: &[u32], triangles: &[[u32; 3]], charts: usize) -> Vec<BTreeSet<u32>> {
    let mut beside = vec![BTreeSet::new(); charts];
    for corners in triangles {
        let owned = corners.map(|corner| owners[corner as usize]);
        for one in owned {
            beside[one as usize].extend(owned.iter().filter(|other| **other != one));
        }
    }
    beside
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fem::Layer;

    #[test]
    fn charts_cover_the_free_skin() {
        let mesh = TetMesh::cuboid([6, 6, 2], 0.01);
        let skin = Surface::of(&mesh);
        let fixed: Vec<u32> =
            (0..mesh.nodes_m.len() as u32).filter(|&n| mesh.nodes_m[n as usize][2] < 1e-9).collect();
        let sphere = Sphere { radius_m: 0.012, layer: Layer::of(0.012) };
        let place = Place { path: "block.toml".into(), text: String::new() };
        let (active, Charts { charts, places_m, owners, triangles, .. }) =
            super::charts(&mesh, &skin, &fixed, &sphere, (&place, None::<&Spanned<()>>)).expect("few");
        assert_eq!(active.len(), charts.len());
        assert!((10..places_m.len() / 4).contains(&charts.len()), "{} of {}", charts.len(), places_m.len());
        for (one, a) in charts.iter().enumerate() {
            for b in &charts[..one] {
                // The origins are 0.3 R deeper than the places, which are R apart.
                assert!(distance(a.centre_m, b.centre_m) >= 0.7 * 0.012, "{a:?} {b:?}");
            }
            let steep = |z: f64| charts.iter().filter(|chart| (chart.normal[2] - z).abs() < 0.2).count();
            let counts = [1.0, 0.7, 0.0].map(steep);
            assert!(counts.iter().all(|count| *count > 5), "the top, the rims and the sides: {counts:?}");
        }
        for corners in &triangles {
            for &corner in corners {
                let chart = &charts[owners[corner as usize] as usize];
                for &other in corners {
                    let away_m = difference(places_m[other as usize], chart.centre_m);
                    assert!(dot(away_m, chart.normal) <= chart.column.top_m + 1e-12, "{corner}");
                    assert!(from_axis_m(&chart.normal, away_m) <= chart.column.whole_m + 1e-12, "{corner}");
                }
                let own_m = difference(places_m[corner as usize], chart.centre_m);
                assert!(from_axis_m(&chart.normal, own_m) <= chart.column.core_m + 1e-12, "{corner}");
            }
        }
        // The wholly fixed face is not touched from below.
        assert!(charts.iter().all(|chart| chart.normal[2] > -0.5));
    }
}
