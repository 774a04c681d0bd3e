//! The gap between a sphere and a feature of the skin: a triangle, an edge or a vertex.
//!
//! With the corners x_i of the feature, its barycentric weights w_i(xi) and the centre c of the sphere,
//!
//! z = sum w_i x_i - c,     g(x, c) = min over xi of |z| - R,     n = z / |z|, from the centre to the foot.
//!
//! At the foot n . t_a = 0, t_a = dz/dxi_a. Its response to changes v of the corners and e of the centre follows from
//! this condition, with r = |z|, P = I - n n^T, T_ab = t_a . t_b / r and d_a = sum (dw_i/dxi_a) v_i:
//!
//! T xi' = -(t_a . (sum w_i v_i - e) / r + n . d_a).
//!
//! With the total first and second variations
//!
//! z' = sum w_i v_i - e + sum t_a xi_a',     z'' = sum over a of xi_a'(1) d_a(2) + xi_a'(2) d_a(1),
//!
//! of two or three directions the derivatives of g are
//!
//! Dg = n . z',     D2g = z1' . P z2' / r + n . z12'',
//! D3g = sum over the three orders of (z12'' . P z3' - (n . z1') z2' . P z3' / r) / r.
//!
//! Responses of higher order do not occur in D2 and D3, because the foot is stationary (the 2n+1 rule). The moving foot
//! makes the second derivative of a plane's gap differ from that of a fixed point.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

/// A feature of the skin by its corners, ascending.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) enum Feature {
    Vertex([u32; 1]),
    Edge([u32; 2]),
    Face([u32; 3]),
}

impl Feature {
    /// The feature between these corners.
    pub(crate) fn between(corners: &[u32]) -> Self {
        match *corners {
            [a] => Self::Vertex([a]),
            [a, b] => Self::Edge([a.min(b), a.max(b)]),
            [a, b, c] => {
                let mut corners = [a, b, c];
                corners.sort_unstable();
                Self::Face(corners)
            }
            _ => unreachable!("a triangle has three corners"),
        }
    }

    /// The corners.
    pub(crate) fn corners(&self) -> &[u32] {
        match self {
            Self::Vertex(corners) => corners,
            Self::Edge(corners) => corners,
            Self::Face(corners) => corners,
        }
    }
}

/// A change of the corners of a feature and of the centre.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Variation {
    pub(crate) corners: [Vector3<f64>; 3],
    pub(crate) centre: Vector3<f64>,
}

/// First variations along one direction.
#[derive(Debug, Clone, Copy)]
struct Response {
    /// z'.
    arrow: Vector3<f64>,
    /// xi'.
    foot: Vector2<f64>,
    /// d_a.
    tangents: [Vector3<f64>; 2],
}

/// The gap of a feature at a state.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Gap {
    pub(crate) feature: Feature,
    /// Weights of the corners at the foot; zero beyond the feature's corners.
    pub(crate) weights: [f64; 3],
    /// n.
    pub(crate) normal: Vector3<f64>,
    /// |z|, m.
    pub(crate) distance_m: f64,
    /// t_a; zero where the feature has fewer directions.
    tangents: [Vector3<f64>; 2],
    /// T^-1, with zeros for the missing directions.
    compliance: Matrix2<f64>,
}

/// dw_i/dxi_a: the weights are (1 - xi_1 - xi_2, xi_1, xi_2).
const SLOPES: [[f64; 2]; 3] = [[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]];

impl Gap {
    /// The gap of a feature whose corners are at these places. The foot is that on the whole plane or line.
    /// `None` if the corners of a face lie on a line, those of an edge coincide, or the centre is on the feature.
    pub(crate) fn new(feature: Feature, places_m: [Vector3<f64>; 3], centre_m: Vector3<f64>) -> Option<Self> {
        let directions = feature.corners().len() - 1;
        let first = places_m[0];
        let tangents =
            [0, 1].map(|a| if a < directions { places_m[a + 1] - first } else { Vector3::zeros() });
        let metric = Matrix2::from_fn(|a, b| {
            let missing = a >= directions || b >= directions;
            if missing { f64::from(u8::from(a == b)) } else { tangents[a].dot(&tangents[b]) }
        });
        let inverse = metric.try_inverse()?;
        let xi = inverse * Vector2::from_fn(|a, _| tangents[a].dot(&(centre_m - first)));
        let arrow = first + tangents[0] * xi[0] + tangents[1] * xi[1] - centre_m;
        let distance_m = arrow.norm();
        let compliance = Matrix2::from_fn(|a, b| {
            if a < directions && b < directions { distance_m * inverse[(a, b)] } else { 0.0 }
        });
        let weights = [1.0 - xi[0] - xi[1], xi[0], xi[1]];
        (distance_m > 0.0 && distance_m.is_finite()).then(|| Self {
            feature,
            weights,
            normal: arrow / distance_m,
            distance_m,
            tangents,
            compliance,
        })
    }

    /// The foot, relative to the centre, m.
    pub(crate) fn foot(&self) -> Vector3<f64> {
        self.distance_m * self.normal
    }

    fn corners(&self) -> usize {
        self.feature.corners().len()
    }

    /// I - n n^T.
    fn projection(&self) -> Matrix3<f64> {
        Matrix3::identity() - self.normal * self.normal.transpose()
    }

    /// Mixed derivative of |z| by corner i, or the centre for `None`, and xi_a.
    fn mixed(&self, corner: Option<usize>, a: usize) -> Vector3<f64> {
        if a + 1 >= self.corners() {
            return Vector3::zeros();
        }
        match corner {
            Some(i) => self.tangents[a] * (self.weights[i] / self.distance_m) + self.normal * SLOPES[i][a],
            None => -self.tangents[a] / self.distance_m,
        }
    }

    /// Second derivative of g by the places of two corners, or of the centre for `None`, 1/m.
    pub(crate) fn second(&self, one: Option<usize>, other: Option<usize>) -> Matrix3<f64> {
        let weight = |corner: Option<usize>| corner.map_or(-1.0, |i| self.weights[i]);
        let mut sum = self.projection() * (weight(one) * weight(other) / self.distance_m);
        for a in 0..2 {
            for b in 0..2 {
                let moved = self.mixed(other, b) * self.compliance[(a, b)];
                sum -= self.mixed(one, a) * moved.transpose();
            }
        }
        sum
    }

    fn response(&self, v: &Variation) -> Response {
        let corners = self.corners();
        let fixed: Vector3<f64> =
            (0..corners).map(|i| v.corners[i] * self.weights[i]).sum::<Vector3<f64>>() - v.centre;
        let tangents = [0, 1].map(|a| {
            let slope = |i: usize| v.corners[i] * SLOPES[i][a];
            if a + 1 < corners { (0..corners).map(slope).sum() } else { Vector3::zeros() }
        });
        let load = Vector2::from_fn(|a, _| {
            self.tangents[a].dot(&fixed) / self.distance_m + self.normal.dot(&tangents[a])
        });
        let foot = -(self.compliance * load);
        let arrow = fixed + self.tangents[0] * foot[0] + self.tangents[1] * foot[1];
        Response { arrow, foot, tangents }
    }

    /// D2g along two directions, 1/m times their units.
    pub(crate) fn along_two(&self, one: &Variation, other: &Variation) -> f64 {
        let (one, other) = (self.response(one), self.response(other));
        self.curved(&one.arrow, &other.arrow) + self.normal.dot(&second_arrow(&one, &other))
    }

    /// a . P b / r
    fn curved(&self, a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
        (a.dot(b) - self.normal.dot(a) * self.normal.dot(b)) / self.distance_m
    }

    /// D3g along three directions.
    pub(crate) fn along_three(&self, directions: [&Variation; 3]) -> f64 {
        let responses = directions.map(|direction| self.response(direction));
        let orders = [[0, 1, 2], [0, 2, 1], [1, 2, 0]];
        let one_order = |[i, j, k]: [usize; 3]| {
            let [u, v, w] = [i, j, k].map(|at| &responses[at]);
            let along = self.normal.dot(&w.arrow) / self.distance_m;
            self.curved(&second_arrow(u, v), &w.arrow) - along * self.curved(&u.arrow, &v.arrow)
        };
        orders.map(one_order).iter().sum()
    }
}

/// z'' of two directions.
fn second_arrow(one: &Response, other: &Response) -> Vector3<f64> {
    (0..2).map(|a| other.tangents[a] * one.foot[a] + one.tangents[a] * other.foot[a]).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLACES_M: [[f64; 3]; 3] = [[0.011, 0.002, -0.001], [-0.007, 0.009, 0.003], [0.001, -0.008, 0.002]];
    const CENTRE_M: [f64; 3] = [0.002, 0.003, 0.011];

    fn variation(seed: u32) -> Variation {
        let number = |k: u32| libm::sin(f64::from(7 * seed + 3 * k + 1));
        let vector = |k: u32| Vector3::new(number(k), number(k + 1), number(k + 2));
        Variation { corners: [vector(0), vector(3), vector(6)], centre: vector(9) }
    }

    /// The gap with all places moved along a direction.
    fn moved(feature: Feature, v: &Variation, by_m: f64) -> Gap {
        let places = [0, 1, 2].map(|i| Vector3::from(PLACES_M[i]) + by_m * v.corners[i]);
        Gap::new(feature, places, Vector3::from(CENTRE_M) + by_m * v.centre).expect("not degenerate")
    }

    fn features() -> [Feature; 3] {
        [Feature::Vertex([0]), Feature::Edge([0, 1]), Feature::Face([0, 1, 2])]
    }

    /// Dg = sum w_i n . v_i - n . e.
    fn slope(gap: &Gap, v: &Variation) -> f64 {
        gap.normal.dot(&gap.response(v).arrow)
    }

    #[test]
    fn derivatives_are_those_of_differences() {
        let h = 1e-7;
        for feature in features() {
            let [u, v, w] = [variation(1), variation(2), variation(3)];
            let central = |of: &dyn Fn(&Gap) -> f64, along: &Variation| {
                (of(&moved(feature, along, h)) - of(&moved(feature, along, -h))) / (2.0 * h)
            };
            let gap = moved(feature, &u, 0.0);
            let checks = [
                (slope(&gap, &u), central(&|gap| gap.distance_m, &u)),
                (gap.along_two(&u, &v), central(&|gap| slope(gap, &u), &v)),
                (gap.along_three([&u, &v, &w]), central(&|gap| gap.along_two(&u, &v), &w)),
                (gap.along_three([&u, &u, &w]), central(&|gap| gap.along_two(&u, &u), &w)),
            ];
            for (found, wanted) in checks {
                assert!(
                    (found - wanted).abs() < 1e-6 * wanted.abs().max(1.0),
                    "{feature:?}: {found} {wanted}"
                );
            }
        }
    }

    #[test]
    fn the_blocks_of_the_second_derivative_are_its_values_along_directions() {
        for feature in features() {
            let [u, v] = [variation(4), variation(5)];
            let gap = moved(feature, &u, 0.0);
            let part = |v: &Variation, at: Option<usize>| at.map_or(v.centre, |i| v.corners[i]);
            let all = (0..feature.corners().len()).map(Some).chain([None]);
            let sum: f64 = all
                .clone()
                .flat_map(|i| all.clone().map(move |j| (i, j)))
                .map(|(i, j)| part(&u, i).dot(&(gap.second(i, j) * part(&v, j))))
                .sum();
            let wanted = gap.along_two(&u, &v);
            assert!((sum - wanted).abs() < 1e-9 * wanted.abs(), "{feature:?}: {sum} {wanted}");
        }
    }
}
