//! Tests of the triangulation on a plane of known stiffness.

use super::super::pushes;
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
            assert!(net.error(&net.candidates[candidate], corners, weights) <= SHARE);
            checked += 1;
        }
    }
    assert_eq!(checked + kept(&net), net.candidates.len());
    assert!(checked > 10, "{checked}");
}

/// Division at the middles of all edges that cross x = 20 mm keeps the area and leaves no gap.
#[test]
fn divided_edges_leave_no_gap() {
    let mut net = plane(|_| 300.0);
    let before = area(&net);
    let (edges, triangles) = (net.edges(), net.triangles.len());
    assert_eq!(edges.len(), 8 * 9 * 2 + 64);
    let x = |net: &Net, candidate: usize| net.candidates[candidate].place_m[0];
    let crosses = |net: &Net, [a, b]: [usize; 2]| (x(net, a) - 0.0201) * (x(net, b) - 0.0201) < 0.0;
    let middle = |net: &Net, edge: [usize; 2]| {
        let Candidate { at, pushes, jet, .. } = &net.candidates[edge[0]];
        Candidate { at: *at, place_m: net.middle_m(edge), pushes: pushes.clone(), jet: *jet }
    };
    let middles: BTreeMap<_, _> = edges
        .into_iter()
        .filter(|&edge| crosses(&net, edge))
        .map(|edge| (edge, middle(&net, edge)))
        .collect();
    let added = middles.len();
    assert_eq!(added, 9 + 8);
    net.divide(middles);
    let after = area(&net);
    assert!((after.0 - before.0).abs() < 1e-12 && after.1);
    // Two crossed edges make three triangles of one.
    assert_eq!((net.candidates.len(), net.triangles.len()), (81 + added, triangles + 2 * 16));
    let mut sides: BTreeMap<[usize; 2], usize> = BTreeMap::new();
    for [a, b, c] in net.triangles.values() {
        for [a, b] in [[a, b], [b, c], [c, a]] {
            *sides.entry([*a.min(b), *a.max(b)]).or_default() += 1;
        }
    }
    let inside = |edge: &[usize; 2]| {
        let [a, b] = edge.map(|end| net.candidates[end].place_m);
        let is_rim = |axis: usize| a[axis] == b[axis] && (a[axis] == 0.0 || (a[axis] - 0.04).abs() < 1e-12);
        !is_rim(0) && !is_rim(1)
    };
    assert!(sides.iter().all(|(edge, count)| *count == 1 + usize::from(inside(edge))));
    let edge = [0, 1];
    assert!(!net.is_missed(edge, &middle(&net, edge)) && net.apart(edge) < 1e-9);
    let mut stiff = plane(|x| 300.0 + 2e5 * x);
    assert!(
        stiff.apart(edge) > 1.0
            && !stiff.is_missed(edge, &{
                let mut other = middle(&stiff, edge);
                let of = |end: usize| stiff.candidates[end].jet.stiffness_n_m;
                other.jet.stiffness_n_m = 0.5 * (of(0) + of(1));
                for (d, force) in &mut other.pushes {
                    *force = other.jet.taylor_force_n(*d);
                }
                other
            })
    );
    assert!(stiff.is_missed(edge, &middle(&stiff, edge)));
    stiff.coarsen();
}
