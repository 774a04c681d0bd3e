//! Shape measures of a tet.

use crate::mesh::surface::FACES;
use crate::mesh::tetrahedral::{EDGES, six_volume};
use crate::num::vector::{cross, difference, distance, dot, norm};

/// The dihedral angles at the six edges, in the order of [`EDGES`], degrees.
///
/// The angle at the edge from a to b, with the other vertices c and d, is the angle between (b-a) x (c-a) and
/// (b-a) x (d-a). It is computed by atan2, which is accurate near 0 and 180 degrees; acos loses half its
/// digits there.
pub(super) fn dihedral_angles_deg(x: &[[f64; 3]; 4]) -> [f64; 6] {
    // EDGES[5 - e] is the edge opposite to EDGES[e].
    std::array::from_fn(|e| {
        let ([a, b], [c, d]) = (EDGES[e], EDGES[5 - e]);
        let edge = difference(x[b], x[a]);
        let first = cross(edge, difference(x[c], x[a]));
        let second = cross(edge, difference(x[d], x[a]));
        libm::atan2(norm(cross(first, second)), dot(first, second)).to_degrees()
    })
}

/// The smallest of a tet's dihedral angles.
pub(super) fn smallest_dihedral_deg(x: &[[f64; 3]; 4]) -> f64 {
    dihedral_angles_deg(x).into_iter().fold(f64::INFINITY, f64::min)
}

/// Longest edge over the diameter of the inscribed sphere, scaled so that a regular tet has 1.
///
/// The inscribed sphere's radius is 3 V / A; in a regular tet of edge l it is l / (2 sqrt 6).
pub(super) fn aspect(x: &[[f64; 3]; 4]) -> f64 {
    let longest = EDGES.iter().map(|&[a, b]| distance(x[a], x[b])).fold(0.0, f64::max);
    let area: f64 = FACES
        .iter()
        .map(|&[a, b, c]| 0.5 * norm(cross(difference(x[b], x[a]), difference(x[c], x[a]))))
        .sum();
    let radius = 0.5 * six_volume(x).abs() / area;
    longest / (2.0 * 6f64.sqrt() * radius)
}
