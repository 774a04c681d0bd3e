//! Interpolation of the energy from scattered configurations: a Gaussian kernel with W, h, S and W_ijk of
//! each.
//!
//! W(p) = p . S0 p / 2 + sum_n sum_|b|<=3 w_nb d^b/dq^b k(p, q) at q = p_n,
//! k(p, q) = exp(-|p - q|^2 / 2 l^2)
//!
//! Each configuration gives 20 data and has 20 weights. The weights are those with which the fit reproduces
//! all derivatives up to the third order (Hermite-Birkhoff interpolation; Wendland, Scattered Data
//! Approximation, 2004, chapter 16). The force is the exact gradient of W, so the fit is conservative for any
//! error. The quadratic energy of the stiffness at rest, S0, is subtracted from the data.
//!
//! With x = p / l and He_n the Hermite polynomials of probability theory, d^n/dr^n exp(-r^2/2) = (-1)^n
//! He_n(r) exp(-r^2/2). The entry between derivative a at x_m and weight b at x_n is, with r = x_m - x_n,
//!
//! K = prod_i (-1)^a_i He_(a_i + b_i)(r_i) exp(-|r|^2 / 2),   on the diagonal prod_i (2 a_i - 1)!! .
//!
//! Rows and columns are scaled to a unit diagonal, and a nugget that depends on the order is added to it
//! ([`NUGGET`]). The matrix of a smooth kernel is singular to working precision long before the data are
//! exhausted. Without the nugget the fit would amplify rounding errors to oscillations.
//!
//! The error estimates in [`cross_validation`] need the diagonal blocks of K's inverse. With K = [A B; B' C],
//! H = (L^-T L^-1 B) M^-T, A = L L', C - B' A^-1 B = M M', the blocks grow by H_m H_m'.
//!
//! The sums cancel (weights are thousands of times larger than the values), so the evaluation uses f64.

mod cross_validation;

use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::{Mat, MatRef, Par, Side};
use nalgebra::{Matrix3, Vector3};

use crate::num::jet::EnergyJet;

/// Orders of the derivatives of a configuration along x, y and z.
///
/// The third derivatives are in the order of [`THIRD_INDICES`].
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

/// Nugget added to the unit diagonal, by order of the derivative.
pub(super) const NUGGET: [f64; 4] = [1e-9, 1e-9, 1e-6, 1e-4];

/// Highest order of the Hermite polynomials: 6 between two data, 5 between the table's second derivatives and
/// the data.
const POLYNOMIALS: usize = 7;

/// W_abc as `[a][b][c]`, J/m^(a+b+c).
pub type Derivatives = [[[f64; 3]; 3]; 3];

impl EnergyJet {
    /// The data in the order of [`DATA`], minus those of the quadratic energy of `base`.
    fn beside(&self, base: &Matrix3<f64>) -> [f64; 20] {
        let p = Vector3::from(self.control_m);
        let beside = Self {
            energy_j: self.energy_j - 0.5 * p.dot(&(base * p)),
            force_n: (Vector3::from(self.force_n) - base * p).into(),
            stiffness_n_m: self.stiffness_n_m - base,
            ..*self
        };
        beside.numbers()
    }
}

/// Error: two configurations are too close for the kernel to distinguish them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CoincidentData;

impl std::fmt::Display for CoincidentData {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "two configurations are too close for the kernel; take a shorter length")
    }
}

impl std::error::Error for CoincidentData {}

/// A fit that can be extended by configurations.
#[derive(Debug, Clone)]
pub struct KernelFit {
    length_m: f64,
    base: Matrix3<f64>,
    /// Displacements in units of the kernel length.
    centres: Vec<[f64; 3]>,
    /// Lower Cholesky factor of the scaled matrix.
    factor: Mat<f64>,
    /// Forward substitution of the scaled data with the factor; extended with it.
    forward: Mat<f64>,
    /// The diagonal block of each configuration in the inverse of the scaled matrix.
    inverse: Vec<Mat<f64>>,
    /// Weights in the order of [`DATA`], J.
    weights: Vec<[f64; 20]>,
}

impl KernelFit {
    /// An empty fit with the kernel length l, m, and the stiffness at rest, N/m.
    pub fn new(length_m: f64, rest_stiffness_n_m: Matrix3<f64>) -> Self {
        Self {
            length_m,
            base: rest_stiffness_n_m,
            centres: Vec::new(),
            factor: Mat::zeros(0, 0),
            forward: Mat::zeros(0, 1),
            inverse: Vec::new(),
            weights: Vec::new(),
        }
    }

    /// Restores a read-only fit from the kernel length l, m, the stiffness at rest, N/m, and for each
    /// configuration its displacement, m, and its weights, J ([`Self::weights`]).
    pub(crate) fn of_weights(
        length_m: f64,
        rest_stiffness_n_m: Matrix3<f64>,
        configurations: impl IntoIterator<Item = ([f64; 3], [f64; 20])>,
    ) -> Self {
        let in_lengths = |(at, weights): ([f64; 3], _)| (at.map(|x| x / length_m), weights);
        let (centres, weights) = configurations.into_iter().map(in_lengths).unzip();
        Self { centres, weights, ..Self::new(length_m, rest_stiffness_n_m) }
    }

    /// The kernel's length l, m.
    pub fn length_m(&self) -> f64 {
        self.length_m
    }

    /// The stiffness at rest, N/m.
    pub(crate) fn base_n_m(&self) -> &Matrix3<f64> {
        &self.base
    }

    /// Displacements in kernel lengths, and the weights of the Gaussian's derivatives in the order of
    /// [`DATA`], J.
    pub(super) fn centres(&self) -> impl Iterator<Item = (&[f64; 3], &[f64; 20])> {
        self.centres.iter().zip(&self.weights)
    }

    /// The weights of each configuration, in the order W, h, S and W_ijk, J.
    pub(crate) fn weights(&self) -> &[[f64; 20]] {
        &self.weights
    }

    /// Number of configurations.
    pub fn len(&self) -> usize {
        self.centres.len()
    }

    /// Whether the fit has no configuration.
    pub fn is_empty(&self) -> bool {
        self.centres.is_empty()
    }

    /// Lower bound of the condition number of the scaled matrix: the squared ratio of the factor's diagonal
    /// entries.
    pub(crate) fn condition(&self) -> f64 {
        let diagonal = (0..self.factor.nrows()).map(|i| self.factor[(i, i)]);
        let (low, high) = diagonal.fold((f64::INFINITY, 0.0f64), |(low, high), d| (low.min(d), high.max(d)));
        (high / low).powi(2)
    }

    /// A read-only copy without the factor, which is most of the memory. It gives the same values and cannot
    /// be extended.
    #[must_use]
    pub fn read_only(&self) -> Self {
        let Self { length_m, base, ref centres, ref weights, .. } = *self;
        let (centres, weights) = (centres.clone(), weights.clone());
        let (factor, forward) = (Mat::zeros(0, 0), Mat::zeros(0, 1));
        Self { length_m, base, centres, factor, forward, inverse: Vec::new(), weights }
    }

    /// Adds configurations. The fit is unchanged if one of them is too close to another.
    ///
    /// Each configuration extends the factor by 20 rows. N configurations cost (20 N)^3 / 3 operations in
    /// total, for any number of calls.
    ///
    /// # Panics
    ///
    /// If the fit is [read-only](Self::read_only).
    pub fn add(&mut self, jets: &[EnergyJet]) -> Result<(), CoincidentData> {
        assert_eq!(self.factor.nrows(), DATA.len() * self.centres.len(), "the fit is read-only");
        let (old, more) = (DATA.len() * self.centres.len(), DATA.len() * jets.len());
        let added: Vec<[f64; 3]> = jets.iter().map(|jet| jet.control_m.map(|x| x / self.length_m)).collect();
        let scale = DATA.map(diagonal).map(|d| d.sqrt().recip());
        // Columns of the new rows: against the old data, and among themselves.
        let mut across = Mat::<f64>::zeros(old, more);
        let mut own = Mat::<f64>::zeros(more, more);
        for (m, &x) in added.iter().enumerate() {
            for (n, &y) in self.centres.iter().chain(&added).enumerate() {
                let (tables, e) = polynomials(x, y);
                for a in 0..DATA.len() {
                    for b in 0..DATA.len() {
                        let value = scale[a] * scale[b] * e * entry(DATA[a], DATA[b], &tables);
                        let (row, column) = (DATA.len() * m + a, DATA.len() * n + b);
                        if column < old {
                            across[(column, row)] = value;
                        } else {
                            own[(row, column - old)] = value;
                        }
                    }
                }
            }
            for (a, orders) in DATA.iter().enumerate() {
                own[(DATA.len() * m + a, DATA.len() * m + a)] += NUGGET[orders.iter().sum::<usize>()];
            }
        }
        solve_lower_triangular_in_place(self.factor.as_ref(), across.as_mut(), Par::Seq);
        own -= across.transpose() * &across;
        let corner = own.llt(Side::Lower).map_err(|_| CoincidentData)?;
        let corner = corner.L();
        // The data in the same scale, as derivatives with respect to x = p / l.
        let mut right = Mat::<f64>::zeros(more, 1);
        for (m, jet) in jets.iter().enumerate() {
            for ((a, orders), value) in DATA.iter().enumerate().zip(jet.beside(&self.base)) {
                let order = orders.iter().sum::<usize>() as i32;
                right[(DATA.len() * m + a, 0)] = scale[a] * value * self.length_m.powi(order);
            }
        }
        right -= across.transpose() * &self.forward;
        solve_lower_triangular_in_place(corner, right.as_mut(), Par::Seq);
        self.extend_inverse(&across, corner);
        let n = old + more;
        self.factor.resize_with(n, n, |_, _| 0.0);
        self.forward.resize_with(n, 1, |_, _| 0.0);
        for row in 0..more {
            for column in 0..old {
                self.factor[(old + row, column)] = across[(column, row)];
            }
            for column in 0..=row {
                self.factor[(old + row, old + column)] = corner[(row, column)];
            }
            self.forward[(old + row, 0)] = right[(row, 0)];
        }
        self.centres.extend(added);
        let mut solved = self.forward.clone();
        solve_upper_triangular_in_place(self.factor.transpose(), solved.as_mut(), Par::Seq);
        self.weights = (0..self.centres.len())
            .map(|m| std::array::from_fn(|a| scale[a] * solved[(DATA.len() * m + a, 0)]))
            .collect();
        Ok(())
    }

    /// Contribution of new rows to the blocks of the inverse: `across` is L^-1 B, `corner` the factor of the
    /// Schur complement.
    fn extend_inverse(&mut self, across: &Mat<f64>, corner: MatRef<'_, f64>) {
        let mut back = across.clone();
        solve_upper_triangular_in_place(self.factor.transpose(), back.as_mut(), Par::Seq);
        let mut back = back.transpose().to_owned();
        solve_lower_triangular_in_place(corner, back.as_mut(), Par::Seq);
        let mut own = Mat::<f64>::identity(corner.nrows(), corner.nrows());
        solve_lower_triangular_in_place(corner, own.as_mut(), Par::Seq);
        let squared = |of: &Mat<f64>, m: usize| {
            let columns = of.subcols(DATA.len() * m, DATA.len());
            columns.transpose() * columns
        };
        for (m, block) in self.inverse.iter_mut().enumerate() {
            *block += squared(&back, m);
        }
        self.inverse.extend((0..corner.nrows() / DATA.len()).map(|m| squared(&own, m)));
    }

    /// h = dW/dp, N.
    pub fn force_n(&self, displacement_m: [f64; 3]) -> [f64; 3] {
        let x = displacement_m.map(|p| p / self.length_m);
        let mut sum = [0.0; 3];
        for (&centre, weights) in self.centres.iter().zip(&self.weights) {
            let (tables, e) = polynomials(x, centre);
            let mut gradient = [0.0; 3];
            for (b, weight) in DATA.iter().zip(weights) {
                let [[x0, x1], [y0, y1], [z0, z1]]: [[f64; 2]; 3] =
                    std::array::from_fn(|axis| [tables[axis][b[axis]], -tables[axis][b[axis] + 1]]);
                gradient[0] += weight * x1 * y0 * z0;
                gradient[1] += weight * x0 * y1 * z0;
                gradient[2] += weight * x0 * y0 * z1;
            }
            for (sum, slope) in sum.iter_mut().zip(gradient) {
                *sum += slope * e;
            }
        }
        let p = Vector3::from(displacement_m);
        (self.base * p + Vector3::from(sum) / self.length_m).into()
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
        let p = Vector3::from(displacement_m);
        let (slope, beside) = (self.base * p, EnergyJet::from_numbers(displacement_m, &sum));
        EnergyJet {
            energy_j: beside.energy_j + 0.5 * p.dot(&slope),
            force_n: (Vector3::from(beside.force_n) + slope).into(),
            stiffness_n_m: beside.stiffness_n_m + self.base,
            ..beside
        }
    }

    /// All derivatives of W up to the second order along each axis.
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
        let p = Vector3::from(displacement_m);
        let (s, slope) = (&self.base, self.base * p);
        sum[0][0][0] += 0.5 * p.dot(&slope);
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
