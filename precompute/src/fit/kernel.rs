//! Interpolation of the energy from scattered configurations: a Gaussian kernel with W, h, S and W_ijk of
//! each.
//!
//! W(p) = p . S0 p / 2 + sum_n sum_|b|<=3 w_nb d^b/dq^b k(p, q) at q = p_n,
//! k(p, q) = exp(-|p - q|^2 / 2 l^2)
//!
//! Each configuration gives 20 data and has 20 weights. The weights are those with which the fit reproduces
//! all derivatives up to the third order (Hermite-Birkhoff interpolation; Wendland, Scattered Data
//! Approximation, 2004, chapter 16). The force is the exact gradient of W, so the fit is conservative for any
//! error. The quadratic energy of the stiffness at rest, S0, is subtracted from the data. Of a tool that can leave the
//! body, s = sqrt(2 W) is interpolated in place of W, without its second-order Taylor polynomial at p = 0.
//!
//! With x = p / l and He_n the Hermite polynomials of probability theory, d^n/dr^n exp(-r^2/2) = (-1)^n
//! He_n(r) exp(-r^2/2). The entry between derivative a at x_m and weight b at x_n is, with r = x_m - x_n,
//!
//! K = prod_i (-1)^a_i He_(a_i + b_i)(r_i) exp(-|r|^2 / 2),   on the diagonal prod_i (2 a_i - 1)!! .
//!
//! The sums cancel (weights are thousands of times larger than the values), so the evaluation uses f64.

mod cross_validation;
mod system;

pub(crate) use system::KernelSystem;

use nalgebra::{Matrix3, Vector3};

use crate::num::jet::EnergyJet;
use crate::spec::Quantity;

/// Orders of the derivatives of a configuration along x, y and z.
///
/// The third derivatives are in the order of [`crate::num::jet::THIRD_INDICES`].
pub(crate) const DATA: [[usize; 3]; 20] = [
    [0, 0, 0],
    [1, 0, 0],
    [0, 1, 0],
    [0, 0, 1],
    [2, 0, 0],
    [1, 1, 0],
    [1, 0, 1],
    [0, 2, 0],
    [0, 1, 1],
    [0, 0, 2],
    [3, 0, 0],
    [2, 1, 0],
    [2, 0, 1],
    [1, 2, 0],
    [1, 1, 1],
    [1, 0, 2],
    [0, 3, 0],
    [0, 2, 1],
    [0, 1, 2],
    [0, 0, 3],
];

/// Nugget added to the unit diagonal of the scaled matrix, by order of the derivative.
pub(super) const NUGGET: [f64; 4] = [1e-9, 1e-9, 1e-6, 1e-4];

/// Highest order of the Hermite polynomials: 6 between two data, 5 between the table's second derivatives and
/// the data.
const POLYNOMIALS: usize = 7;

/// W_abc as `[a][b][c]`, in J/m^(a+b+c) or, in tables, in cells.
pub(crate) type Derivatives = [[[f64; 3]; 3]; 3];

/// The fitted energy.
#[derive(Debug, Clone)]
pub struct KernelFit {
    /// Length l of the kernel, m.
    pub length_m: f64,
    /// What is interpolated.
    pub quantity: Quantity,
    /// The polynomial that is subtracted from the data: value, slope and curvature at p = 0. Of an energy the first two
    /// are zero, and the last is S0, the stiffness at rest, N/m.
    pub base: Base,
    /// Displacements of the configurations in units of l.
    pub centres: Vec<[f64; 3]>,
    /// Weights of each configuration in the order W, h, S and W_ijk, J.
    pub weights: Vec<[f64; 20]>,
}

/// A polynomial of second order in the displacement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Base {
    /// Its value at zero.
    pub value: f64,
    /// Its slope there.
    pub slope: Vector3<f64>,
    /// Its second derivatives.
    pub curvature: Matrix3<f64>,
}

impl Base {
    /// The quadratic energy of a stiffness, N/m.
    pub(crate) fn quadratic(stiffness_n_m: Matrix3<f64>) -> Self {
        Self { value: 0.0, slope: Vector3::zeros(), curvature: stiffness_n_m }
    }

    /// What a fit of this quantity subtracts, from the configuration at p = 0; `None` if it has no root.
    pub(crate) fn of(quantity: Quantity, first: &EnergyJet) -> Option<Self> {
        match quantity {
            Quantity::Energy => Some(Self::quadratic(first.stiffness_n_m)),
            Quantity::Root => first.root(LEAST_ROOT_J).map(|root| Self {
                value: root.energy_j,
                slope: root.force_n.into(),
                curvature: root.stiffness_n_m,
            }),
        }
    }

    /// Value and slope at a displacement.
    fn at(&self, p: Vector3<f64>) -> (f64, Vector3<f64>) {
        let bent = self.curvature * p;
        (self.value + self.slope.dot(&p) + 0.5 * p.dot(&bent), self.slope + bent)
    }
}

/// A configuration with less energy has no root for a fit, J: its derivatives are quotients of small numbers.
pub(crate) const LEAST_ROOT_J: f64 = 1e-5;

/// The jet of a quantity from that of the energy; `None` if the touch is too light for a root.
pub(super) fn quantity_of(quantity: Quantity, jet: &EnergyJet) -> Option<EnergyJet> {
    match quantity {
        Quantity::Energy => Some(*jet),
        Quantity::Root => jet.root(LEAST_ROOT_J),
    }
}

impl KernelFit {
    /// A fit without configurations.
    pub(crate) fn empty(length_m: f64, quantity: Quantity, base: Base) -> Self {
        Self { length_m, quantity, base, centres: Vec::new(), weights: Vec::new() }
    }

    /// The quadratic energy of a stiffness S0, N/m.
    pub(crate) fn quadratic(length_m: f64, rest_stiffness_n_m: Matrix3<f64>) -> Self {
        Self::empty(length_m, Quantity::Energy, Base::quadratic(rest_stiffness_n_m))
    }

    /// h, N: the gradient of the energy.
    pub fn force_n(&self, displacement_m: [f64; 3]) -> [f64; 3] {
        let (value, slope) = self.value_and_slope(displacement_m);
        match self.quantity {
            Quantity::Energy => slope.into(),
            Quantity::Root => (value.max(0.0) * slope).into(),
        }
    }

    /// The quantity and its gradient.
    pub(crate) fn value_and_slope(&self, displacement_m: [f64; 3]) -> (f64, Vector3<f64>) {
        let x = displacement_m.map(|p| p / self.length_m);
        let (mut value, mut sum) = (0.0, [0.0; 3]);
        for (&centre, weights) in self.centres.iter().zip(&self.weights) {
            let (tables, e) = polynomials(x, centre);
            let mut gradient = [0.0; 3];
            for (b, weight) in DATA.iter().zip(weights) {
                let [[x0, x1], [y0, y1], [z0, z1]]: [[f64; 2]; 3] =
                    std::array::from_fn(|axis| [tables[axis][b[axis]], -tables[axis][b[axis] + 1]]);
                value += e * weight * x0 * y0 * z0;
                gradient[0] += weight * x1 * y0 * z0;
                gradient[1] += weight * x0 * y1 * z0;
                gradient[2] += weight * x0 * y0 * z1;
            }
            for (sum, slope) in sum.iter_mut().zip(gradient) {
                *sum += slope * e;
            }
        }
        let (base, base_slope) = self.base.at(displacement_m.into());
        (base + value, base_slope + Vector3::from(sum) / self.length_m)
    }

    /// W and its derivatives up to the third order.
    pub fn jet(&self, displacement_m: [f64; 3]) -> EnergyJet {
        let x = displacement_m.map(|p| p / self.length_m);
        let mut sum = [0.0; 20];
        for (&centre, weights) in self.centres.iter().zip(&self.weights) {
            let (tables, e) = polynomials(x, centre);
            for (sum, a) in sum.iter_mut().zip(DATA) {
                *sum += e * DATA.iter().zip(weights).map(|(b, w)| w * entry(a, *b, &tables)).sum::<f64>();
            }
        }
        for (sum, orders) in sum.iter_mut().zip(DATA) {
            *sum *= self.length_m.powi(-(orders.iter().sum::<usize>() as i32));
        }
        let beside = EnergyJet::from_numbers(displacement_m, &sum);
        let (value, slope) = self.base.at(displacement_m.into());
        let jet = EnergyJet {
            energy_j: beside.energy_j + value,
            force_n: (Vector3::from(beside.force_n) + slope).into(),
            stiffness_n_m: beside.stiffness_n_m + self.base.curvature,
            ..beside
        };
        match self.quantity {
            Quantity::Energy => jet,
            Quantity::Root => jet.squared(),
        }
    }

    /// All derivatives of the quantity up to the second order along each axis.
    pub(crate) fn derivatives(&self, displacement_m: [f64; 3]) -> Derivatives {
        let x = displacement_m.map(|p| p / self.length_m);
        let mut sum = Derivatives::default();
        for (&centre, weights) in self.centres.iter().zip(&self.weights) {
            let (tables, e) = polynomials(x, centre);
            for (b, weight) in DATA.iter().zip(weights) {
                let along = |axis: usize| -> [f64; 3] {
                    std::array::from_fn(|c| {
                        let value = tables[axis][c + b[axis]];
                        if c == 1 { -value } else { value }
                    })
                };
                let [along_x, along_y, along_z] = [along(0), along(1), along(2)];
                for (sum, x) in sum.iter_mut().zip(along_x) {
                    for (sum, y) in sum.iter_mut().zip(along_y) {
                        let xy = weight * e * x * y;
                        for (sum, z) in sum.iter_mut().zip(along_z) {
                            *sum += xy * z;
                        }
                    }
                }
            }
        }
        for (a, plane) in sum.iter_mut().enumerate() {
            for (b, row) in plane.iter_mut().enumerate() {
                for (c, value) in row.iter_mut().enumerate() {
                    *value *= self.length_m.powi(-((a + b + c) as i32));
                }
            }
        }
        let (s, (value, slope)) = (&self.base.curvature, self.base.at(displacement_m.into()));
        sum[0][0][0] += value;
        sum[1][0][0] += slope.x;
        sum[0][1][0] += slope.y;
        sum[0][0][1] += slope.z;
        sum[2][0][0] += s[(0, 0)];
        sum[0][2][0] += s[(1, 1)];
        sum[0][0][2] += s[(2, 2)];
        sum[1][1][0] += s[(0, 1)];
        sum[1][0][1] += s[(0, 2)];
        sum[0][1][1] += s[(1, 2)];
        sum
    }
}

/// prod (2 a_i - 1)!!
pub(super) fn diagonal(orders: [usize; 3]) -> f64 {
    orders.iter().map(|&a| [1.0, 1.0, 3.0, 15.0][a]).product()
}

/// prod_i (-1)^a_i He_(a_i + b_i)(r_i)
pub(super) fn entry(a: [usize; 3], b: [usize; 3], tables: &[[f64; POLYNOMIALS]; 3]) -> f64 {
    let product: f64 = (0..3).map(|axis| tables[axis][a[axis] + b[axis]]).product();
    if a.iter().sum::<usize>() % 2 == 0 { product } else { -product }
}

/// He_n(x - y) along each axis, and exp(-|x - y|^2 / 2).
pub(super) fn polynomials(x: [f64; 3], y: [f64; 3]) -> ([[f64; POLYNOMIALS]; 3], f64) {
    let r: [f64; 3] = std::array::from_fn(|axis| x[axis] - y[axis]);
    let tables = r.map(|r| {
        let mut he = [1.0; POLYNOMIALS];
        he[1] = r;
        for n in 1..POLYNOMIALS - 1 {
            he[n + 1] = r * he[n] - n as f64 * he[n - 1];
        }
        he
    });
    (tables, libm::exp(-0.5 * r.iter().map(|r| r * r).sum::<f64>()))
}

#[cfg(test)]
mod tests;
