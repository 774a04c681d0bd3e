//! The charts of a sphere's field: places of the skin, and the part of the space round each that its table covers.
//!
//! The energy W(c) of a sphere is no function of the place of its centre c: an organ that gives way by centimetres has at
//! one c the equilibrium of a push from the front and that of one from behind. It is one where the sphere came in on the
//! same side. So the field has a table for each of many places of the skin, a *chart*, valid in a column along the normal
//! there. A vertex of the skin belongs to the chart of the nearest place.

use super::ActiveNode;
use crate::fem::Sphere;
use crate::mesh::{SkinPoint, Surface, TetMesh};
use crate::num::vector::{cross, difference, distance, dot, unit};
use crate::spec::{Chart, Charts, Column, from_axis_m};

/// Least distance of two places, in radii of the sphere.
const APART: f64 = 1.0;
/// Depth of the origin of a chart below the first touch, in radii: there the body is surely touched.
const DEPTH: f64 = 0.3;

/// The charts of a sphere that has a field, with their active nodes; otherwise these active nodes.
pub(super) fn charts(
    mesh: &TetMesh,
    skin: &Surface,
    fixed: &[u32],
    sphere: Option<&Sphere>,
    active: Vec<ActiveNode>,
) -> (Vec<ActiveNode>, Option<Charts>) {
    let Some(sphere) = sphere else { return (active, None) };
    let (active, charts) = on_skin(mesh, skin, fixed, sphere);
    (active, Some(charts))
}

/// The charts of a sphere on the free skin, as active nodes. The places are chosen one by one, each as far as possible
/// from those before; so neighbours have distant numbers.
fn on_skin(mesh: &TetMesh, skin: &Surface, fixed: &[u32], sphere: &Sphere) -> (Vec<ActiveNode>, Charts) {
    let is_fixed = |node: &u32| fixed.binary_search(node).is_ok();
    let free: Vec<[u32; 3]> =
        skin.triangles.iter().filter(|corners| !corners.iter().all(is_fixed)).copied().collect();
    let mut vertices: Vec<u32> = free.iter().flatten().copied().collect();
    vertices.sort_unstable();
    vertices.dedup();
    let place = |vertex: usize| mesh.nodes_m[vertices[vertex] as usize];
    let number = |node: u32| vertices.binary_search(&node).expect("a corner of a triangle") as u32;
    let triangles: Vec<[u32; 3]> = free.iter().map(|corners| corners.map(number)).collect();
    let (mut chosen, mut owners) = (Vec::new(), vec![0; vertices.len()]);
    let mut away_m = vec![f64::INFINITY; vertices.len()];
    while let Some(next) = (0..away_m.len()).max_by(|&a, &b| away_m[a].total_cmp(&away_m[b]).then(b.cmp(&a)))
        && away_m[next] >= APART * sphere.radius_m
    {
        for (vertex, least_m) in away_m.iter_mut().enumerate() {
            let to_next_m = distance(place(vertex), place(next));
            if to_next_m < *least_m {
                (*least_m, owners[vertex]) = (to_next_m, chosen.len() as u32);
            }
        }
        chosen.push(next);
    }
    let chart = |(number, &vertex): (usize, &usize)| {
        let (at_m, normal) = (place(vertex), skin.normal(vertices[vertex]).expect("a vertex of the skin"));
        let reach_m = sphere.radius_m + sphere.layer.thickness_m;
        let rest_m = reach_m - DEPTH * sphere.radius_m;
        let owned = triangles
            .iter()
            .filter(|corners| corners.iter().any(|&corner| owners[corner as usize] as usize == number));
        let (mut core_m, mut whole_m, mut top_m) = (0.5 * sphere.radius_m, sphere.radius_m, 0.0f64);
        for corners in owned {
            // Where the centre is when the sphere touches these corners along the face.
            let [a, b, c] = corners.map(|corner| place(corner as usize));
            let face = unit(cross(difference(b, a), difference(c, a)));
            let turned_m: [f64; 3] = std::array::from_fn(|k| reach_m * (face[k] - normal[k]));
            let away_m = [a, b, c].map(|corner| plus(difference(corner, at_m), turned_m));
            let middle_m = std::array::from_fn(|k| away_m.iter().map(|away| away[k]).sum::<f64>() / 3.0);
            core_m = core_m.max(from_axis_m(&normal, middle_m));
            for away_m in away_m {
                whole_m = whole_m.max(from_axis_m(&normal, away_m));
                top_m = top_m.max(dot(away_m, normal));
            }
        }
        let column = Column { core_m, whole_m, top_m: top_m + DEPTH * sphere.radius_m };
        Chart { centre_m: std::array::from_fn(|k| at_m[k] + rest_m * normal[k]), normal, column }
    };
    let charts: Vec<Chart> = chosen.iter().enumerate().map(chart).collect();
    let active = (1..).zip(&chosen).zip(&charts).map(|((number, &vertex), chart)| {
        let node = vertices[vertex];
        let triangle = *free.iter().find(|corners| corners.contains(&node)).expect("a corner of a triangle");
        let at = SkinPoint { triangle, weights: triangle.map(|corner| f64::from(u8::from(corner == node))) };
        ActiveNode { chart: Some(*chart), ..ActiveNode::at(format!("skin-{number}"), at) }
    });
    (active.collect(), Charts { sphere: *sphere, charts: charts.clone(), vertices, owners, triangles })
}

/// a + b
fn plus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|k| a[k] + b[k])
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
        let sphere = Sphere { radius_m: 0.015, layer: Layer::of(0.015) };
        let (active, Charts { charts, vertices, owners, triangles, .. }) =
            on_skin(&mesh, &skin, &fixed, &sphere);
        assert_eq!(active.len(), charts.len());
        assert!((10..vertices.len()).contains(&charts.len()), "{} of {}", charts.len(), vertices.len());
        for (one, a) in active.iter().enumerate() {
            for b in &active[..one] {
                assert!(distance(a.place_m(&mesh), b.place_m(&mesh)) >= 0.015, "{a:?} {b:?}");
            }
        }
        for corners in &triangles {
            for &corner in corners {
                let chart = &charts[owners[corner as usize] as usize];
                // Where a sphere touches a triangle with a vertex of a chart, its centre lies in the column.
                let places = corners.map(|corner| mesh.nodes_m[vertices[corner as usize] as usize]);
                let [a, b, c] = places;
                let face = unit(cross(difference(b, a), difference(c, a)));
                for place in places {
                    let centre_m = plus(place, face.map(|x| x * (0.015 + Layer::of(0.015).thickness_m)));
                    let away_m = difference(centre_m, chart.centre_m);
                    let across_m = from_axis_m(&chart.normal, away_m);
                    assert!(dot(away_m, chart.normal) <= chart.column.top_m + 1e-12, "{corner}");
                    assert!(across_m <= chart.column.whole_m + 1e-12, "{corner}: {across_m}");
                    assert!(chart.column.core_m < chart.column.whole_m);
                }
            }
        }
        // The wholly fixed face is not touched.
        assert!(vertices.iter().all(|&n| mesh.nodes_m[n as usize][2] > 1e-9 || {
            let [x, y, _] = mesh.nodes_m[n as usize];
            [x, y].iter().any(|a| *a < 1e-9 || *a > 0.06 - 1e-9)
        }));
    }
}
