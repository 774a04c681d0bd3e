//! What a fit knows of its own errors: each configuration as the others say it, and how far apart the energies that meet all data may be elsewhere.
//!
//! A fit by a kernel is the mean of a Gaussian process whose covariance the kernel is (kriging). With configuration n left out, of K^-1 the block
//! B_n on the diagonal and its share a_n of the solution give both what the others miss there and the covariance of that (Dubrule, Cross
//! validation of kriging in a unique neighborhood, Math. Geol. 15, 1983):
//!
//! e_n = B_n^-1 a_n,   C_n = s^2 B_n^-1
//!
//! The process' variance s^2, which the fit itself does not need, is what makes those errors what they should be: the mean of |e_n|^2 by the trace
//! of B_n^-1, of the force alone. Anywhere else the force then has the standard deviation
//!
//! sigma(x)^2 = s^2 (3 - sum_i |L^-1 k_i(x)|^2) / l^2,   K = L L',   k_i the kernel between all data and dW/dx_i at x
//!
//! A configuration at the edge of what is known is said by extrapolation by the others, and missed; with it the fit may know all there is to know. The
//! left-out errors alone cannot tell that, sigma can: what they are too large by its B_n^-1 is large by too. It is an estimate of the size of an error, no
//! bound of it: the body is no sample of the process, and the largest errors are some times what sigma is (docs/theory.md, section 11).

use faer::linalg::solvers::Solve;
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Mat, Par, Side};

use super::{DATA, KernelFit, diagonal, entry, polynomials};

/// The force among the data, along x, y and z: where it stands, and its orders.
const FORCE: [usize; 3] = [1, 2, 3];
/// Places that are looked at together: bounds the memory.
const TOGETHER: usize = 64;

impl KernelFit {
    /// By how much the fit of all the others misses the force of each configuration, N, in the order they were taken in: the truth less what it
    /// says.
    ///
    /// # Panics
    /// If it is a fit [as it is](Self::as_it_is).
    pub fn left_out_n(&self) -> impl Iterator<Item = [f64; 3]> {
        self.left_out().map(|(missed_n, _)| missed_n)
    }

    /// Standard deviation of the force, all three components together, at these places, N; infinite where there is none to be told, as of rest alone. The
    /// first configuration, which is rest, does not count for s.
    ///
    /// Cost: with N configurations (20 N)^2 operations for each of three right-hand sides a place.
    ///
    /// # Panics
    /// If it is a fit [as it is](Self::as_it_is).
    pub fn deviation_n(&self, places: &[[f64; 3]]) -> Vec<f64> {
        let by_its_own = |(missed_n, own): ([f64; 3], f64)| missed_n.iter().map(|e| e * e).sum::<f64>() / own;
        let shares: Vec<f64> = self.left_out().skip(1).map(by_its_own).collect();
        let variance = shares.iter().sum::<f64>() / shares.len() as f64;
        let deviation_n = |own: f64| Some((variance * own).sqrt()).filter(|n| !n.is_nan());
        self.variances(places).into_iter().map(|own| deviation_n(own).unwrap_or(f64::INFINITY)).collect()
    }

    /// What the others miss, and the variance of it where s = 1, 1/m^2.
    fn left_out(&self) -> impl Iterator<Item = ([f64; 3], f64)> {
        assert_eq!(self.inverse.len(), self.centres.len(), "the fit does not know its matrix any more");
        let scale = DATA.map(diagonal).map(f64::sqrt);
        self.inverse.iter().zip(&self.weights).map(move |(block, weights)| {
            let Ok(factor) = block.llt(Side::Lower) else { return ([f64::INFINITY; 3], f64::INFINITY) };
            // The solution, and unit vectors of the first derivatives, whose scale is 1, by x = p / l.
            let right = Mat::from_fn(DATA.len(), 4, |a, column| match column {
                0 => scale[a] * weights[a],
                axis => f64::from(u8::from(a == FORCE[axis - 1])),
            });
            let solved = factor.solve(&right);
            let missed_n = FORCE.map(|a| solved[(a, 0)] / self.length_m);
            let own = FORCE.iter().zip(1..).map(|(&a, column)| solved[(a, column)]).sum::<f64>();
            (missed_n, own / self.length_m.powi(2))
        })
    }

    /// Variance of the force where s = 1, 1/m^2.
    fn variances(&self, places: &[[f64; 3]]) -> Vec<f64> {
        let scale = DATA.map(diagonal).map(|d| d.sqrt().recip());
        let mut found = Vec::with_capacity(places.len());
        for places in places.chunks(TOGETHER) {
            let mut across = Mat::<f64>::zeros(self.factor.nrows(), 3 * places.len());
            for (p, place) in places.iter().enumerate() {
                let x = place.map(|p| p / self.length_m);
                for (m, &centre) in self.centres.iter().enumerate() {
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
            found.extend((0..places.len()).map(|p| (3.0 - known(p)).clamp(0.0, 3.0) / self.length_m.powi(2)));
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::made_up::{jet, spread};
    use super::super::{EnergyJet, NUGGET};
    use super::*;

    fn apart(a: [f64; 3], b: [f64; 3]) -> f64 {
        a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
    }

    fn jets(count: u32) -> Vec<EnergyJet> {
        std::iter::once([0.0; 3]).chain((1..count).map(|n| spread(n, 0.05))).map(jet).collect()
    }

    /// However the configurations came.
    #[test]
    fn what_the_others_say_is_what_a_fit_without_it_says() {
        let jets = jets(14);
        let empty = || KernelFit::new(0.03, jets[0].stiffness_n_m);
        let mut whole = empty();
        for batch in [&jets[..1], &jets[1..5], &jets[5..6], &jets[6..]] {
            whole.add(batch).expect("apart");
        }
        let (left_out, mut largest): (Vec<_>, f64) = (whole.left_out().collect(), 0.0);
        let mut shares = Vec::new();
        assert_eq!(left_out.len(), jets.len());
        for (left, (missed, variance)) in left_out.into_iter().enumerate() {
            let mut fit = empty();
            let others: Vec<EnergyJet> = (0..jets.len()).filter(|&m| m != left).map(|m| jets[m]).collect();
            fit.add(&others).expect("apart");
            let at = jets[left].control_m;
            let (truth, said) = (jets[left].force_n, fit.force_n(at));
            let expected: [f64; 3] = std::array::from_fn(|i| truth[i] - said[i]);
            let size = apart(expected, [0.0; 3]);
            assert!(apart(missed, expected) < 1e-6 + 1e-4 * size, "{left}: {missed:?} {expected:?}");
            largest = size.max(largest);
            shares.push(size * size / variance);
            // The left-out datum carries its own nugget, which nobody else's variance has.
            let [others, own] = [fit.variances(&[at])[0], variance].map(|v| v * 0.03 * 0.03);
            let nugget = 3.0 * NUGGET[1];
            assert!((own - others - nugget).abs() < 1e-7 + 1e-4 * own, "{left}: {own} {others}");
        }
        assert!(largest > 0.01, "nothing is missed: {largest} N");
        // Far from all data the deviation is that of the process, whose scale these errors make, without that of rest.
        let process_n = (shares[1..].iter().sum::<f64>() / (shares.len() - 1) as f64 * 3.0).sqrt() / 0.03;
        let far_n = whole.deviation_n(&[[0.5; 3]])[0];
        assert!((far_n / process_n - 1.0).abs() < 1e-3, "{far_n} {process_n} N");
    }

    /// Beyond all data it is that of the process, and the more is known the less it is.
    #[test]
    fn the_deviation_falls_from_that_of_the_process_to_nothing() {
        let jets = jets(20);
        let mut fit = KernelFit::new(0.03, jets[0].stiffness_n_m);
        fit.add(&jets[..8]).expect("apart");
        let [far, near] = [[0.5; 3], jets[5].control_m];
        let [by_far, by_near] = [far, near].map(|at| fit.variances(&[at])[0] * 0.03 * 0.03);
        assert!((by_far - 3.0).abs() < 1e-9 && (0.0..1e-6).contains(&by_near), "{by_far} {by_near}");
        let places: Vec<[f64; 3]> = (1000..1100).map(|n| spread(n, 0.045)).collect();
        let few = fit.variances(&places);
        assert!(places.len() > TOGETHER && few.iter().any(|v| (v / few[0] - 1.0).abs() > 0.1));
        for (&at, together) in places.iter().zip(&few) {
            let alone = fit.variances(&[at])[0];
            assert!((alone - together).abs() < 1e-9 * (3.0 / 0.03f64.powi(2)), "{at:?}: {alone} {together}");
        }
        fit.add(&jets[8..]).expect("apart");
        let many = fit.variances(&places);
        assert!(few.iter().zip(&many).all(|(few, many)| many <= few), "more data say less");
        assert!(many.iter().sum::<f64>() < 0.1 * few.iter().sum::<f64>());
    }

    #[test]
    fn rest_alone_says_nothing_of_its_errors() {
        let rest = jets(1);
        let mut fit = KernelFit::new(0.03, rest[0].stiffness_n_m);
        fit.add(&rest).expect("the first");
        assert_eq!(fit.deviation_n(&[[0.0; 3], [0.01; 3]]), [f64::INFINITY; 2]);
    }

    /// From ten configurations on it is no less than half of the errors, and no more than ten times them; with six it is less than a third.
    #[test]
    fn errors_are_of_the_size_of_the_deviation() {
        let places: Vec<[f64; 3]> = (1000..1300).map(|n| spread(n, 0.045)).collect();
        for count in [11, 15, 24, 36] {
            let jets = jets(count);
            let mut fit = KernelFit::new(0.04, jets[0].stiffness_n_m);
            fit.add(&jets).expect("apart");
            let deviations = fit.deviation_n(&places);
            let rms =
                |values: Vec<f64>| (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt();
            let errors: Vec<f64> = places.iter().map(|&at| apart(fit.force_n(at), jet(at).force_n)).collect();
            let (error, deviation) = (rms(errors), rms(deviations));
            println!("{count} configurations: error {error} N, deviation {deviation} N");
            assert!((0.1..2.0).contains(&(error / deviation)), "{count}: {error} {deviation} N");
        }
    }
}
