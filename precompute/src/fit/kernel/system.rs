//! The linear system of a kernel fit, which can be extended by configurations.
//!
//! Rows and columns are scaled to a unit diagonal, and a nugget that depends on the order is added to it
//! ([`NUGGET`]). The matrix of a smooth kernel is singular to working precision long before the data are
//! exhausted. Without the nugget the fit would amplify rounding errors to oscillations.
//!
//! The error estimates in `cross_validation` need the diagonal blocks of K's inverse. With K = [A B; B' C],
//! H = (L^-T L^-1 B) M^-T, A = L L', C - B' A^-1 B = M M', the blocks grow by H_m H_m'.

use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::{Mat, MatRef, Par, Side};
use nalgebra::{Matrix3, Vector3};

use super::{Base, DATA, KernelFit, NUGGET, diagonal, entry, polynomials, quantity_of};
use crate::num::jet::EnergyJet;
use crate::spec::Quantity;

/// Error: two configurations are too close for the kernel to distinguish them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("two configurations are too close for the kernel; take a shorter length")]
pub(crate) struct CoincidentData;

/// A kernel fit with its factorised system.
#[derive(Debug, Clone)]
pub(crate) struct KernelSystem {
    /// The fit to the configurations so far.
    pub fit: KernelFit,
    /// Lower Cholesky factor of the scaled matrix.
    pub(super) factor: Mat<f64>,
    /// Forward substitution of the scaled data with the factor; extended with it.
    forward: Mat<f64>,
    /// The diagonal block of each configuration in the inverse of the scaled matrix.
    pub(super) inverse: Vec<Mat<f64>>,
    /// Whether those blocks are computed, which takes most of the time.
    estimates_errors: bool,
    /// The quantity at each configuration with its slope.
    pub(super) data: Vec<(f64, Vector3<f64>)>,
}

impl KernelSystem {
    /// A system without configurations, for the kernel length l, m.
    pub(crate) fn new(length_m: f64, quantity: Quantity, base: Base) -> Self {
        Self {
            fit: KernelFit::empty(length_m, quantity, base),
            factor: Mat::zeros(0, 0),
            forward: Mat::zeros(0, 1),
            inverse: Vec::new(),
            estimates_errors: true,
            data: Vec::new(),
        }
    }

    /// The same without error estimates.
    pub(crate) fn without_errors(length_m: f64, quantity: Quantity, base: Base) -> Self {
        Self { estimates_errors: false, ..Self::new(length_m, quantity, base) }
    }

    /// A system of an energy, for the stiffness at rest, N/m.
    pub(crate) fn of_energy(length_m: f64, rest_stiffness_n_m: Matrix3<f64>) -> Self {
        Self::new(length_m, Quantity::Energy, Base::quadratic(rest_stiffness_n_m))
    }

    /// Lower bound of the condition number of the scaled matrix: the squared ratio of the factor's diagonal
    /// entries.
    pub(crate) fn condition(&self) -> f64 {
        let diagonal = (0..self.factor.nrows()).map(|i| self.factor[(i, i)]);
        let (low, high) = diagonal.fold((f64::INFINITY, 0.0f64), |(low, high), d| (low.min(d), high.max(d)));
        (high / low).powi(2)
    }

    /// Adds configurations, each with a root if that is interpolated. Nothing changes if one of them is too close to
    /// another.
    ///
    /// Each configuration extends the factor by 20 rows. N configurations cost (20 N)^3 / 3 operations in
    /// total, for any number of calls.
    pub(crate) fn add(&mut self, jets: &[EnergyJet]) -> Result<(), CoincidentData> {
        let (old, more) = (self.factor.nrows(), DATA.len() * jets.len());
        let length_m = self.fit.length_m;
        let of_quantity =
            |jet: &EnergyJet| quantity_of(self.fit.quantity, jet).expect("its caller checked it");
        let jets: Vec<EnergyJet> = jets.iter().map(of_quantity).collect();
        let added: Vec<[f64; 3]> = jets.iter().map(|jet| jet.control_m.map(|x| x / length_m)).collect();
        let scale = DATA.map(diagonal).map(|d| d.sqrt().recip());
        // Columns of the new rows: against the old data, and among themselves.
        let mut across = Mat::<f64>::zeros(old, more);
        let mut own = Mat::<f64>::zeros(more, more);
        for (m, &x) in added.iter().enumerate() {
            for (n, &y) in self.fit.centres.iter().chain(&added).enumerate() {
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
            for ((a, orders), value) in DATA.iter().enumerate().zip(beside(jet, &self.fit.base)) {
                let order = orders.iter().sum::<usize>() as i32;
                right[(DATA.len() * m + a, 0)] = scale[a] * value * length_m.powi(order);
            }
        }
        right -= across.transpose() * &self.forward;
        solve_lower_triangular_in_place(corner, right.as_mut(), Par::Seq);
        if self.estimates_errors {
            self.extend_inverse(&across, corner);
        }
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
        self.data.extend(jets.iter().map(|jet| (jet.energy_j, jet.force_n.into())));
        self.fit.centres.extend(added);
        let mut solved = self.forward.clone();
        solve_upper_triangular_in_place(self.factor.transpose(), solved.as_mut(), Par::Seq);
        self.fit.weights = (0..self.fit.centres.len())
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
}

/// The data of a configuration in the order of [`DATA`], minus those of `base`.
fn beside(jet: &EnergyJet, base: &Base) -> [f64; 20] {
    let (value, slope) = base.at(jet.control_m.into());
    let beside = EnergyJet {
        energy_j: jet.energy_j - value,
        force_n: (Vector3::from(jet.force_n) - slope).into(),
        stiffness_n_m: jet.stiffness_n_m - base.curvature,
        ..*jet
    };
    beside.numbers()
}
