//! A point of the skin in the layer of a sphere or capsule.

use nalgebra::{Matrix3, Vector3};

use crate::num::jet::{SymmetricThird, THIRD_INDICES};

/// A point of the skin in the layer.
pub(super) struct Overlap<'a> {
    /// Values of the shape functions of its face.
    pub(super) values: &'a [f64; 6],
    /// Its distance r from the nearest place of the axis, m.
    pub(super) distance_m: f64,
    /// Direction n from there to it.
    pub(super) normal: Vector3<f64>,
    /// Where that place is: s, -1 and 1 at the ends, 0 of a sphere.
    pub(super) share: f64,
    /// Direction of the axis between its ends; zero at an end, and of a sphere.
    pub(super) axis: Vector3<f64>,
}

impl<'a> Overlap<'a> {
    /// A point at `from_centre`, with the half axis `half`; `None` on the axis.
    pub(super) fn of(values: &'a [f64; 6], from_centre: Vector3<f64>, half: Vector3<f64>) -> Option<Self> {
        let length2 = half.norm_squared();
        let along = if length2 > 0.0 { from_centre.dot(&half) / length2 } else { 0.0 };
        let share = along.clamp(-1.0, 1.0);
        let is_between = length2 > 0.0 && along.abs() < 1.0;
        let arrow = from_centre - share * half;
        let distance_m = arrow.norm();
        let axis = if is_between { half / length2.sqrt() } else { Vector3::zeros() };
        (distance_m > 0.0).then(|| Self { values, distance_m, normal: arrow / distance_m, share, axis })
    }

    /// D2 phi for changes of the point, with phi'' and phi'.
    pub(super) fn second(&self, curvature: f64, slope: f64) -> Matrix3<f64> {
        let along = self.normal * self.normal.transpose();
        let across = Matrix3::identity() - along - self.axis * self.axis.transpose();
        curvature * along + slope / self.distance_m * across
    }

    /// D3 phi for three changes of the point, with phi', phi'' and phi'''.
    pub(super) fn third(&self, changes: &[Vector3<f64>; 3], of_phi: [f64; 3]) -> SymmetricThird {
        let [slope, curvature, third] = of_phi;
        let along = changes.map(|change| self.normal.dot(&change));
        let on_axis = changes.map(|change| self.axis.dot(&change));
        let across =
            |i: usize, j: usize| changes[i].dot(&changes[j]) - along[i] * along[j] - on_axis[i] * on_axis[j];
        let turn = (curvature - slope / self.distance_m) / self.distance_m;
        THIRD_INDICES.map(|[i, j, k]| {
            let turned = along[i] * across(j, k) + along[j] * across(i, k) + along[k] * across(i, j);
            third * along[i] * along[j] * along[k] + turn * turned
        })
    }

    /// D2 phi for a change of the point, by rows, and one of the half axis.
    pub(super) fn turned(&self, curvature: f64, slope: f64, half: Vector3<f64>) -> Matrix3<f64> {
        let along = self.normal * self.normal.transpose();
        let across = -self.share * (Matrix3::identity() - along);
        let lever = self.distance_m * self.normal - self.share * half;
        let follows = self.axis * lever.transpose() / half.norm();
        -self.share * curvature * along + slope / self.distance_m * (across - follows)
    }

    /// D2 phi for changes of the half axis: phi'' s^2 n n^T + phi' times the second derivative of the distance,
    ///
    /// (s^2 / r) (1 - n n^T - e e^T) + (s / |a|) (n e^T + e n^T) - (r / |a|^2) n n^T between the ends, e = a / |a|,
    ///
    /// and s^2 D2 phi of the point at an end.
    pub(super) fn of_axis(&self, curvature: f64, slope: f64, half: Vector3<f64>) -> Matrix3<f64> {
        let of_end = self.share * self.share * self.second(curvature, slope);
        if self.axis == Vector3::zeros() {
            return of_end;
        }
        let length = half.norm();
        let mixed = self.normal * self.axis.transpose();
        let along = self.normal * self.normal.transpose();
        let bent = self.share / length * (mixed + mixed.transpose());
        of_end + slope * (bent - self.distance_m / (length * length) * along)
    }
}

/// Whether the box round the control points of a face, relative to the centre, comes within `reach` of it.
pub(super) fn is_near(places: &[Vector3<f64>; 6], is_quadratic: bool, reach: &Vector3<f64>) -> bool {
    let [a, b, c, ab, bc, ca] = *places;
    let (mut low, mut high) = (a.inf(&b).inf(&c), a.sup(&b).sup(&c));
    if is_quadratic {
        for (middle, one, other) in [(ab, a, b), (bc, b, c), (ca, c, a)] {
            let control = 2.0 * middle - 0.5 * (one + other);
            (low, high) = (low.inf(&control), high.sup(&control));
        }
    }
    (0..3).all(|k| low[k] < reach[k] && high[k] > -reach[k])
}
