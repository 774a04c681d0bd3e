//! The layer against the fixed part.
//!
//! What is fixed does not give way. There a layer whose pressure grows with the third power of the overlap becomes stiffer
//! than any device can render: for the force of a hand it would have to be scaled down, and the softer wall be pressed deeper
//! still. Under a live hand the fixed part is therefore a spring. It has the shape at rest, and where more than half of a point
//! of a face follows fixed nodes, the point does not move. So its energy depends on the tool alone, and adds to that of the body.
//! With the outer radius R_o of the layer, and the sum
//!
//! Phi = sum over q of A_q (k d / 4) t_q^4 R_o / r_q,   t = (R_o - r) / d,
//!
//! over the points that do not move, the spring stores
//!
//! G(Phi) = (5/2) Phi_0 ((1 + Phi / Phi_0)^(2/5) - 1).
//!
//! A sphere that overlaps a plane by D has Phi = a d t^5 / 5 with t = D / d and a = 2 pi R_o k d / 4: R_o / r takes up the
//! curvature. Its force is
//!
//! F(D) = a t^4 (1 + Phi / Phi_0)^(-3/5),
//!
//! the layer's at a light touch, and K D deep in the wall if Phi_0 = (d / 5) (K d)^(5/3) a^(-2/3); it is nowhere stiffer than
//! 1.65 K. The sum Phi is larger under the side of a capsule than under its end, and the force grows with Phi^(2/5): its side is
//! 2 to 3 times as stiff as its end with a length of 2 to 5 radii, and 8 times with 80 radii.

use std::f64::consts::TAU;

use nalgebra::{Matrix3, Vector3};

use super::overlap::Overlap;
use crate::fem::elastic::ElasticState;
use crate::num::jet::{SymmetricThird, THIRD_INDICES};

/// Stiffness K of a plane wall, N/m: stiffer than soft tissue, and for most devices no reason to scale the force.
const WALL_N_M: f64 = 1_500.0;
/// A smaller sphere has a stiffer wall, up to twice, so that it bears more before the sphere is in it: 7 N with 3 mm, m.
const SMALL_M: f64 = 5e-3;
/// A wall within this share of the radius is pierced: its points do not come nearer than they lie apart.
const PIERCED: f64 = 0.25;

/// Thickness d, m, and pressure k, Pa, of a layer.
type Layer = (f64, f64);

/// Energy of the fixed part with its derivatives by the place c of the tool and by the half axis a.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Wall {
    energy_j: f64,
    /// By c.
    force_n: Vector3<f64>,
    /// By a.
    of_axis_n: Vector3<f64>,
    /// By c and c.
    own_n_m: Matrix3<f64>,
    /// By c, in rows, and a.
    axis_n_m: Matrix3<f64>,
    /// By a and a.
    of_axis_n_m: Matrix3<f64>,
    /// By c three times.
    third_n_m2: SymmetricThird,
    /// Whether the tool is so deep inside that it may come out on the other side.
    is_pierced: bool,
}

/// The energy of the layer, per area, and its first three derivatives by r, at the distance r.
fn potential((d, k): Layer, outer_m: f64, r: f64) -> [f64; 4] {
    let (t, a) = ((outer_m - r) / d, outer_m / r);
    let [g, g1, g2, g3] =
        [0.25 * k * d * t.powi(4), -k * t.powi(3), 3.0 * k * t * t / d, -6.0 * k * t / (d * d)];
    [
        a * g,
        a * (g1 - g / r),
        a * (g2 - 2.0 * g1 / r + 2.0 * g / (r * r)),
        a * (g3 - 3.0 * g2 / r + 6.0 * g1 / (r * r) - 6.0 * g / (r * r * r)),
    ]
}

impl Wall {
    /// Adds a point with its area to Phi: its overlap with a capsule of the half axis, whose layer begins at the outer radius.
    pub(super) fn add(
        &mut self,
        area_m2: f64,
        overlap: &Overlap,
        half: Vector3<f64>,
        (layer, radius_m, outer_m): (Layer, f64, f64),
    ) {
        let [energy, slope, curvature, third] =
            potential(layer, outer_m, overlap.distance_m).map(|value| area_m2 * value);
        let force_n = -slope * overlap.normal;
        self.energy_j += energy;
        self.force_n += force_n;
        self.of_axis_n += overlap.share * force_n;
        self.own_n_m += overlap.second(curvature, slope);
        let changes = [0, 1, 2].map(|axis| -Vector3::ith(axis, 1.0));
        let of_point = overlap.third(&changes, [slope, curvature, third]);
        self.third_n_m2.iter_mut().zip(of_point).for_each(|(sum, value)| *sum += value);
        if half != Vector3::zeros() {
            self.axis_n_m -= overlap.turned(curvature, slope, half);
            self.of_axis_n_m += overlap.of_axis(curvature, slope, half);
        }
        self.is_pierced |= overlap.distance_m < PIERCED * radius_m;
    }

    /// The spring, from the sums of Phi: with g = G'(Phi),
    ///
    /// G_i = g Phi_i,   G_ij = g Phi_ij + g' Phi_i Phi_j,
    /// G_ijk = g Phi_ijk + g' (Phi_ij Phi_k + Phi_ik Phi_j + Phi_jk Phi_i) + g'' Phi_i Phi_j Phi_k.
    pub(super) fn sprung(self, (d, k): Layer, outer_m: f64) -> Self {
        let a = 0.25 * TAU * outer_m * k * d;
        let wall_n_m = WALL_N_M * (SMALL_M / outer_m).clamp(1.0, 2.0);
        let scale_j = 0.2 * d * libm::pow(wall_n_m * d, 5.0 / 3.0) / libm::pow(a, 2.0 / 3.0);
        let ratio = self.energy_j / scale_j;
        let first = libm::pow(1.0 + ratio, -0.6);
        let second = -0.6 / scale_j * first / (1.0 + ratio);
        let third = -1.6 / scale_j * second / (1.0 + ratio);
        let (force, axis) = (self.force_n, self.of_axis_n);
        let mut third_n_m2 = self.third_n_m2;
        for (value, [i, j, k]) in third_n_m2.iter_mut().zip(THIRD_INDICES) {
            let own = &self.own_n_m;
            let mixed = own[(i, j)] * force[k] + own[(i, k)] * force[j] + own[(j, k)] * force[i];
            *value = first * *value + second * mixed + third * force[i] * force[j] * force[k];
        }
        Self {
            energy_j: 2.5 * scale_j * libm::expm1(0.4 * libm::log1p(ratio)),
            force_n: first * force,
            of_axis_n: first * axis,
            own_n_m: first * self.own_n_m + second * force * force.transpose(),
            axis_n_m: first * self.axis_n_m + second * force * axis.transpose(),
            of_axis_n_m: first * self.of_axis_n_m + second * axis * axis.transpose(),
            third_n_m2,
            is_pierced: self.is_pierced,
        }
    }

    /// Adds it to what the tool does to the body.
    pub(super) fn add_to(&self, to: &mut ElasticState) {
        to.energy_j += self.energy_j;
        to.force_n += self.force_n;
        to.of_axis_n += self.of_axis_n;
        to.own_n_m += self.own_n_m;
        to.axis_n_m += self.axis_n_m;
        to.of_axis_n_m += self.of_axis_n_m;
        to.is_pierced |= self.is_pierced;
    }

    /// Its force on the tool, N.
    pub(super) fn norm_n(&self) -> f64 {
        self.force_n.norm()
    }

    /// The third derivatives by c.
    pub(super) fn third_n_m2(&self) -> SymmetricThird {
        self.third_n_m2
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// That of a sphere of 10 mm.
    const LAYER: Layer = (2e-3, 1e5);
    const RADIUS_M: f64 = 0.01;
    const OUTER_M: f64 = RADIUS_M + 2.0 / 3.0 * 2e-3;

    /// Under a tool over the plane z = 0, whose points lie 0.5 mm apart.
    fn on_plane(centre: Vector3<f64>, half: Vector3<f64>) -> Wall {
        let mut wall = Wall::default();
        let grid = || (-80..80).map(|n| 5e-4 * (f64::from(n) + 0.5));
        for (x, y) in grid().flat_map(|x| grid().map(move |y| (x, y))) {
            let point =
                Overlap::of(&[0.0; 6], Vector3::new(x, y, 0.0) - centre, half).expect("beside the axis");
            if point.distance_m < OUTER_M {
                wall.add(2.5e-7, &point, half, (LAYER, RADIUS_M, OUTER_M));
            }
        }
        wall.sprung(LAYER, OUTER_M)
    }

    fn assert_near(name: &str, got: Matrix3<f64>, wanted: Matrix3<f64>) {
        assert!((got - wanted).norm() < 2e-5 * wanted.norm(), "{name}: {got} {wanted}");
    }

    #[test]
    fn the_derivatives_are_differences() {
        let step_m = 1e-7;
        for (height_m, half) in [
            (0.0105, Vector3::zeros()),
            (0.006, Vector3::zeros()),
            (0.0085, Vector3::new(0.02, 0.003, 0.001)),
            (0.006, Vector3::new(0.012, -0.005, 0.002)),
        ] {
            let centre = Vector3::new(1e-3, 2e-3, height_m);
            let at = on_plane(centre, half);
            let steps = [0, 1, 2].map(|axis| Vector3::ith(axis, step_m));
            let moved = steps.map(|step| [-step, step].map(|step| on_plane(centre + step, half)));
            let turned = steps.map(|step| [-step, step].map(|step| on_plane(centre, half + step)));
            let by = |[before, after]: &[Wall; 2], of: &dyn Fn(&Wall) -> Vector3<f64>| {
                (of(after) - of(before)) / (2.0 * step_m)
            };
            let columns = |pairs: &[[Wall; 2]; 3], of: &dyn Fn(&Wall) -> Vector3<f64>| {
                Matrix3::from_columns(&[0, 1, 2].map(|axis| by(&pairs[axis], of)))
            };
            let energy = |wall: &Wall| Vector3::x() * wall.energy_j;
            let row = |of: Vector3<f64>| {
                Matrix3::from_rows(&[of.transpose(), Default::default(), Default::default()])
            };
            assert_near("force", columns(&moved, &energy), row(at.force_n));
            assert_near("own", columns(&moved, &|wall| wall.force_n), at.own_n_m);
            for j in 0..3 {
                let third = Matrix3::from_fn(|i, k| {
                    let mut triple = [i, j, k];
                    triple.sort_unstable();
                    at.third_n_m2[THIRD_INDICES.iter().position(|of| *of == triple).expect("a triple")]
                });
                assert_near("third", columns(&moved, &|wall| wall.own_n_m.column(j).into()), third);
            }
            if half != Vector3::zeros() {
                assert_near("of axis", columns(&turned, &energy), row(at.of_axis_n));
                assert_near("axis", columns(&turned, &|wall| wall.force_n), at.axis_n_m);
                assert_near("axis twice", columns(&turned, &|wall| wall.of_axis_n), at.of_axis_n_m);
            }
        }
    }

    /// Forces at overlaps of a plane of 0.1 mm, 0.2 mm and so on, N.
    fn forces_n(half: Vector3<f64>) -> Vec<f64> {
        let force_n = |n: i32| on_plane(Vector3::z() * (OUTER_M - 1e-4 * f64::from(n)), half).force_n;
        (0..80).map(|n| -force_n(n).z).collect()
    }

    fn slopes_n_m(forces_n: &[f64]) -> Vec<f64> {
        forces_n.windows(2).map(|pair| (pair[1] - pair[0]) / 1e-4).collect()
    }

    #[test]
    fn a_plane_is_a_spring_for_a_sphere() {
        let forces_n = forces_n(Vector3::zeros());
        let slopes_n_m = slopes_n_m(&forces_n);
        let stiffest_n_m = slopes_n_m.iter().copied().fold(0.0, f64::max);
        assert!(stiffest_n_m > WALL_N_M && stiffest_n_m < 1.66 * WALL_N_M, "{stiffest_n_m}");
        assert!(slopes_n_m[60..].iter().all(|slope| (slope / WALL_N_M - 1.0).abs() < 0.1), "{slopes_n_m:?}");
        // A light touch is that of the layer on anything else that does not move.
        let light_n = 0.25 * TAU * OUTER_M * LAYER.0 * LAYER.1 * 0.1f64.powi(4);
        assert!((forces_n[2] / light_n - 1.0).abs() < 0.02, "{} {light_n}", forces_n[2]);
    }

    /// However long its side is, and whether it comes with its end or its side.
    #[test]
    fn a_plane_is_a_spring_for_a_capsule() {
        for (half, most) in [
            (Vector3::new(0.0, 0.0, 0.02), 1.0),
            (Vector3::new(0.01, 0.0, 0.0), 2.0),
            (Vector3::new(0.025, 0.0, 0.0), 3.0),
        ] {
            let forces_n = if half.z > 0.0 {
                let force_n =
                    |n: i32| on_plane(Vector3::z() * (half.z + OUTER_M - 1e-4 * f64::from(n)), half).force_n;
                (0..80).map(|n| -force_n(n).z).collect()
            } else {
                forces_n(half)
            };
            let slopes_n_m = slopes_n_m(&forces_n);
            let stiffest_n_m = slopes_n_m.iter().copied().fold(0.0, f64::max);
            println!(
                "{half:?}: stiffest {stiffest_n_m:.0} N/m, {:.2} N at 1 mm, {:.2} N at 7.9 mm",
                forces_n[10], forces_n[79]
            );
            assert!(
                stiffest_n_m < 1.66 * most * WALL_N_M && slopes_n_m.iter().all(|slope| *slope > 0.0),
                "{stiffest_n_m}"
            );
            assert!(forces_n[79] > 0.9 * WALL_N_M * 7.9e-3);
        }
    }
}
