//! Error estimates of a kernel fit: leave-one-out errors, and the standard deviation of the force (kriging).
//!
//! A kernel fit is the mean of a Gaussian process whose covariance is the kernel. Let B_n be the diagonal
//! block of K^-1 of configuration n, and a_n its part of the solution. If configuration n is left out, the
//! error of the other configurations' fit at n, and the covariance of this error, are (Dubrule, Cross
//! validation of kriging in a unique neighborhood, Math. Geol. 15, 1983)
//!
//! e_n = B_n^-1 a_n,   C_n = s^2 B_n^-1
//!
//! The variance s^2 of the process is not needed for the fit. It is estimated from these errors as the mean
//! of |e_n|^2 divided by the trace of B_n^-1, for the force components only. At any position x the standard
//! deviation of the force is then
//!
//! sigma(x)^2 = s^2 (3 - sum_i |L^-1 k_i(x)|^2) / l^2,   K = L L',
//! k_i the kernel between all data and dW/dx_i at x
//!
//! For a configuration at the boundary of the data, the other configurations extrapolate, so its
//! leave-one-out error can be large although the complete fit is accurate. sigma accounts for this, because
//! B_n^-1 of such a configuration is large too. sigma estimates the size of an error and is not a bound: the
//! body is not a sample of the process, and the largest errors are several times sigma (docs/theory.md,
//! section 11).

use faer::linalg::solvers::Solve;
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Mat, Par, Side};

use nalgebra::Vector3;

use super::{DATA, KernelSystem, diagonal, entry, polynomials};
use crate::spec::Quantity;

/// Indices of the force components x, y and z among the data.
const FORCE: [usize; 3] = [1, 2, 3];
/// Number of positions in one batch; limits the memory.
const BATCH: usize = 64;

/// The error of the others' fit at a configuration.
struct LeftOut {
    /// Of the quantity.
    missed_value: f64,
    /// Of its gradient.
    missed: [f64; 3],
    /// Variance of the gradient for s = 1, 1/m^2.
    own: f64,
}

impl LeftOut {
    const UNKNOWN: Self =
        Self { missed_value: f64::INFINITY, missed: [f64::INFINITY; 3], own: f64::INFINITY };
}

impl KernelSystem {
    /// Leave-one-out errors of the force, N, in the order of the configurations: the true force minus the
    /// prediction of the fit to all other configurations.
    pub(crate) fn leave_one_out_n(&self) -> impl Iterator<Item = [f64; 3]> {
        self.leave_one_out().zip(&self.data).map(|(left_out, (value, slope))| match self.fit.quantity {
            Quantity::Energy => left_out.missed,
            Quantity::Root => {
                let predicted = (value - left_out.missed_value).max(0.0);
                (*value * slope - predicted * (slope - Vector3::from(left_out.missed))).into()
            }
        })
    }

    /// Standard deviation of the force (all three components together) at these positions, N. Infinite if it
    /// is undefined, for example with rest as the only configuration. The first configuration, which is rest,
    /// is excluded from s. Of a root it is s times the deviation of ds/dp.
    ///
    /// Cost: (20 N)^2 operations for N configurations and each of the three right-hand sides of a position.
    pub(crate) fn deviation_n(&self, places: &[[f64; 3]]) -> Vec<f64> {
        let by_its_own = |left: LeftOut| left.missed.iter().map(|e| e * e).sum::<f64>() / left.own;
        let shares: Vec<f64> = self.leave_one_out().skip(1).map(by_its_own).collect();
        let variance = shares.iter().sum::<f64>() / shares.len() as f64;
        let deviation_n = |own: f64| Some((variance * own).sqrt()).filter(|n| !n.is_nan());
        let of_slope =
            self.variances(places).into_iter().map(|own| deviation_n(own).unwrap_or(f64::INFINITY));
        let times = |(sigma, &at): (f64, &[f64; 3])| match self.fit.quantity {
            Quantity::Energy => sigma,
            Quantity::Root => sigma * self.fit.value_and_slope(at).0.max(0.0),
        };
        of_slope.zip(places).map(times).collect()
    }

    /// Leave-one-out errors, and their variance for s = 1, 1/m^2.
    fn leave_one_out(&self) -> impl Iterator<Item = LeftOut> {
        let scale = DATA.map(diagonal).map(f64::sqrt);
        let length_m = self.fit.length_m;
        self.inverse.iter().zip(&self.fit.weights).map(move |(block, weights)| {
            let Ok(factor) = block.llt(Side::Lower) else { return LeftOut::UNKNOWN };
            // The solution, and unit vectors of the first derivatives with respect to x = p / l, whose scale
            // is 1.
            let right = Mat::from_fn(DATA.len(), 4, |a, column| match column {
                0 => scale[a] * weights[a],
                axis => f64::from(u8::from(a == FORCE[axis - 1])),
            });
            let solved = factor.solve(&right);
            let (missed_value, missed) = (solved[(0, 0)], FORCE.map(|a| solved[(a, 0)] / length_m));
            let own = FORCE.iter().zip(1..).map(|(&a, column)| solved[(a, column)]).sum::<f64>();
            LeftOut { missed_value, missed, own: own / length_m.powi(2) }
        })
    }

    /// Variance of the force for s = 1, 1/m^2.
    fn variances(&self, places: &[[f64; 3]]) -> Vec<f64> {
        let scale = DATA.map(diagonal).map(|d| d.sqrt().recip());
        let length_m = self.fit.length_m;
        let mut found = Vec::with_capacity(places.len());
        for places in places.chunks(BATCH) {
            let mut across = Mat::<f64>::zeros(self.factor.nrows(), 3 * places.len());
            for (p, place) in places.iter().enumerate() {
                let x = place.map(|p| p / length_m);
                for (m, &centre) in self.fit.centres.iter().enumerate() {
                    let (tables, e) = polynomials(centre, x);
                    for (a, &orders) in DATA.iter().enumerate() {
                        for (axis, force) in FORCE.into_iter().enumerate() {
                            across[(DATA.len() * m + a, 3 * p + axis)] =
                                scale[a] * e * entry(orders, DATA[force], &tables);
                        }
                    }
                }
            }
            solve_lower_triangular_in_place(self.factor.as_ref(), across.as_mut(), Par::Seq);
            let known = |p: usize| across.subcols(3 * p, 3).squared_norm_l2();
            found.extend((0..places.len()).map(|p| (3.0 - known(p)).clamp(0.0, 3.0) / length_m.powi(2)));
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::synthetic::{jet, spread};
    use super::super::{EnergyJet, NUGGET};
    use super::*;

    fn apart(a: [f64; 3], b: [f64; 3]) -> f64 {
        a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
    }

    fn jets(count: u32) -> Vec<EnergyJet> {
        std::iter::once([0.0; 3]).chain((1..count).map(|n| spread(n, 0.05))).map(jet).collect()
    }

    /// The result is independent of the order of the configurations.
    #[test]
    fn what_the_others_say_is_what_a_fit_without_it_says() {
        let jets = jets(14);
        let empty = || KernelSystem::of_energy(0.03, jets[0].stiffness_n_m);
        let mut whole = empty();
        for batch in [&jets[..1], &jets[1..5], &jets[5..6], &jets[6..]] {
            whole.add(batch).expect("apart");
        }
        let (leave_one_out, mut largest): (Vec<_>, f64) = (whole.leave_one_out().collect(), 0.0);
        let mut shares = Vec::new();
        assert_eq!(leave_one_out.len(), jets.len());
        for (left, LeftOut { missed, own: variance, .. }) in leave_one_out.into_iter().enumerate() {
            let mut system = empty();
            let others: Vec<EnergyJet> = (0..jets.len()).filter(|&m| m != left).map(|m| jets[m]).collect();
            system.add(&others).expect("apart");
            let at = jets[left].control_m;
            let (truth, said) = (jets[left].force_n, system.fit.force_n(at));
            let expected: [f64; 3] = std::array::from_fn(|i| truth[i] - said[i]);
            let size = apart(expected, [0.0; 3]);
            assert!(apart(missed, expected) < 1e-6 + 1e-4 * size, "{left}: {missed:?} {expected:?}");
            largest = size.max(largest);
            shares.push(size * size / variance);
            // The left-out datum includes its own nugget; the variance of the other fit does not.
            let [others, own] = [system.variances(&[at])[0], variance].map(|v| v * 0.03 * 0.03);
            let nugget = 3.0 * NUGGET[1];
            assert!((own - others - nugget).abs() < 1e-7 + 1e-4 * own, "{left}: {own} {others}");
        }
        assert!(largest > 0.01, "no error is large: {largest} N");
        // Far from all data the deviation is that of the process, estimated from these errors without rest.
        let process_n = (shares[1..].iter().sum::<f64>() / (shares.len() - 1) as f64 * 3.0).sqrt() / 0.03;
        let far_n = whole.deviation_n(&[[0.5; 3]])[0];
        assert!((far_n / process_n - 1.0).abs() < 1e-3, "{far_n} {process_n} N");
    }

    /// Far from all data sigma is that of the process, and it decreases with additional configurations.
    #[test]
    fn the_deviation_falls_from_that_of_the_process_to_nothing() {
        let jets = jets(20);
        let mut system = KernelSystem::of_energy(0.03, jets[0].stiffness_n_m);
        system.add(&jets[..8]).expect("apart");
        let [far, near] = [[0.5; 3], jets[5].control_m];
        let [by_far, by_near] = [far, near].map(|at| system.variances(&[at])[0] * 0.03 * 0.03);
        assert!((by_far - 3.0).abs() < 1e-9 && (0.0..1e-6).contains(&by_near), "{by_far} {by_near}");
        let places: Vec<[f64; 3]> = (1000..1100).map(|n| spread(n, 0.045)).collect();
        let few = system.variances(&places);
        assert!(places.len() > BATCH && few.iter().any(|v| (v / few[0] - 1.0).abs() > 0.1));
        for (&at, together) in places.iter().zip(&few) {
            let alone = system.variances(&[at])[0];
            assert!((alone - together).abs() < 1e-9 * (3.0 / 0.03f64.powi(2)), "{at:?}: {alone} {together}");
        }
        system.add(&jets[8..]).expect("apart");
        let many = system.variances(&places);
        assert!(few.iter().zip(&many).all(|(few, many)| many <= few), "sigma decreases with more data");
        assert!(many.iter().sum::<f64>() < 0.1 * few.iter().sum::<f64>());
    }

    #[test]
    fn rest_alone_says_nothing_of_its_errors() {
        let rest = jets(1);
        let mut system = KernelSystem::of_energy(0.03, rest[0].stiffness_n_m);
        system.add(&rest).expect("the first");
        assert_eq!(system.deviation_n(&[[0.0; 3], [0.01; 3]]), [f64::INFINITY; 2]);
    }

    /// With ten or more configurations sigma is at least half of the errors and at most ten times the errors.
    /// With six it is less than a third.
    #[test]
    fn errors_are_of_the_size_of_the_deviation() {
        let places: Vec<[f64; 3]> = (1000..1300).map(|n| spread(n, 0.045)).collect();
        for count in [11, 15, 24, 36] {
            let jets = jets(count);
            let mut system = KernelSystem::of_energy(0.04, jets[0].stiffness_n_m);
            system.add(&jets).expect("apart");
            let deviations = system.deviation_n(&places);
            let rms =
                |values: Vec<f64>| (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt();
            let errors: Vec<f64> =
                places.iter().map(|&at| apart(system.fit.force_n(at), jet(at).force_n)).collect();
            let (error, deviation) = (rms(errors), rms(deviations));
            println!("{count} configurations: error {error} N, deviation {deviation} N");
            assert!((0.1..2.0).contains(&(error / deviation)), "{count}: {error} {deviation} N");
        }
    }
}
