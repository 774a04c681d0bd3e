//! Test of the linear model h = S0 d, with the stiffness S0 at rest, at the positions of the search.
//!
//! The model has no fitted parameters, so every position is an independent test of the same model. One failed
//! test excludes it, also if later tests at smaller displacements pass. The tests take the farthest positions
//! first, where a body is least linear. Ten tests can still miss the one direction in which the body is
//! nonlinear. Therefore the fit, which uses all of them, must finally agree with the linear model within
//! tolerance over the reachable set.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::prediction::STREAK;
use crate::num::vector::distance;

/// The linear model and its tests so far.
#[derive(Debug, Clone)]
pub(super) struct Linear {
    stiffness_n_m: Matrix3<f64>,
    pub(super) errors: LinearModelErrors,
    /// Whether a test failed, or a position was unsolved or on a different branch.
    excluded: bool,
}

/// Prediction errors of the linear model.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct LinearModelErrors {
    /// Number of tests that count.
    pub tests: usize,
    /// The largest error, as a share of the tolerance.
    pub worst: f64,
    /// The largest difference from the fit over the reachable set, as a share of the tolerance; computed
    /// after the tests.
    pub from_fit: f64,
}

impl Linear {
    pub(super) fn new(stiffness_n_m: Matrix3<f64>) -> Self {
        Self { stiffness_n_m, errors: LinearModelErrors::default(), excluded: false }
    }

    /// h = S0 d, N.
    fn force_n(&self, displacement_m: [f64; 3]) -> [f64; 3] {
        (self.stiffness_n_m * Vector3::from(displacement_m)).into()
    }

    /// Adds a test that counts.
    pub(super) fn score(&mut self, displacement_m: [f64; 3], truth_n: [f64; 3], tolerance_n: f64) {
        let share = distance(self.force_n(displacement_m), truth_n) / tolerance_n;
        let LinearModelErrors { tests, worst, .. } = self.errors;
        self.errors = LinearModelErrors { tests: tests + 1, worst: worst.max(share), ..self.errors };
        self.excluded |= share.is_nan() || share > 1.0;
    }

    /// Excludes the model: a position was unsolved or on a different branch, which a linear body does not
    /// have.
    pub(super) fn exclude(&mut self) {
        self.excluded = true;
    }

    /// Number of tests still to pass; `None` if the model is excluded.
    pub(super) fn tests_missing(&self) -> Option<usize> {
        (!self.excluded).then(|| STREAK.saturating_sub(self.errors.tests))
    }

    /// Whether the model agrees with the fit at these reachable positions, each given with the fit's force
    /// and its tolerance.
    pub(super) fn agrees_with_fit(&mut self, fit: impl Iterator<Item = ([f64; 3], [f64; 3], f64)>) -> bool {
        let share = |(at, force_n, tolerance_n)| distance(self.force_n(at), force_n) / tolerance_n;
        self.errors.from_fit = fit.map(share).fold(0.0, f64::max);
        let agrees_with_fit = self.errors.from_fit <= 1.0;
        self.excluded |= !agrees_with_fit;
        agrees_with_fit
    }
}

#[cfg(test)]
mod tests {
    use super::super::{AdaptiveFit, Search, SolveResult, Verdict, resample};
    use super::*;
    use crate::fit::KernelFit;
    use crate::fit::synthetic::jet;
    use crate::num::vector::norm;
    use crate::spec::{Quantity, Requirements, Tolerance};
    use palpate_core::HermitePlanes;

    const RADIUS_M: f64 = 0.002;

    fn searched(radius_m: f64, found: impl Fn([f64; 3]) -> SolveResult) -> (AdaptiveFit, usize) {
        let tolerance = Tolerance::IMPERCEPTIBLE;
        let wanted = Requirements {
            tolerance,
            radius_m,
            max_force_n: 8.0,
            push: None,
            workspace_m: None,
            column: None,
            quantity: Quantity::Energy,
            max_configurations: 100,
        };
        let mut search = Search::new(wanted, &jet([0.0; 3]));
        let mut solves = 1;
        search.run(|_, target| {
            solves += 1;
            found(target.displacement_m)
        });
        (search.fitted, solves)
    }

    fn solved(at: [f64; 3]) -> SolveResult {
        SolveResult::Solved(jet(at))
    }

    #[test]
    fn small_displacements_are_linear_after_ten_tests_and_large_ones_never() {
        let (search, solves) = searched(RADIUS_M, solved);
        println!("{:?} of {:?} after {solves}", search.verdict, search.linear);
        assert_eq!((search.verdict, solves), (Some(Verdict::Linear), STREAK + 1));
        assert!(search.linear.worst <= 1.0 && search.linear.tests == STREAK);
        let (search, _) = searched(0.04, solved);
        assert_eq!(search.verdict, Some(Verdict::Passed));
        // Its ten farthest positions miss the direction of the nonlinearity; the fit includes it.
        assert!(search.linear.worst < 1.0 && search.linear.from_fit > 1.2, "{:?}", search.linear);
    }

    #[test]
    fn one_bad_test_a_failure_or_another_branch_is_enough_against_it() {
        // The eighth test has an error of twice the tolerance; all others agree with a linear body.
        let base = jet([0.0; 3]).stiffness_n_m;
        let exact = |at: [f64; 3]| {
            let quadratic = KernelFit::quadratic(1.0, base);
            quadratic.jet(at)
        };
        let planted = |spoil: &dyn Fn(crate::num::jet::EnergyJet) -> SolveResult| {
            let seen = std::cell::Cell::new(0);
            searched(RADIUS_M, |at| {
                seen.set(seen.get() + 1);
                if seen.get() == 8 { spoil(exact(at)) } else { SolveResult::Solved(exact(at)) }
            })
        };
        assert_eq!(planted(&SolveResult::Solved).0.verdict, Some(Verdict::Linear));
        let off = |mut jet: crate::num::jet::EnergyJet| {
            jet.force_n[1] += 2.0 * Tolerance::IMPERCEPTIBLE.at(jet.force_n);
            SolveResult::Solved(jet)
        };
        for (search, _) in
            [planted(&off), planted(&SolveResult::OtherBranch), planted(&|_| SolveResult::Failed)]
        {
            assert_ne!(search.verdict, Some(Verdict::Linear), "{:?}", search.linear);
        }
    }

    #[test]
    fn its_table_is_one_cell_and_exact() {
        let (search, _) = searched(RADIUS_M, solved);
        let on = resample(&search).expect("a lattice");
        assert_eq!((on.samples.len(), on.grid.spacing_m), (27, on.grid.radius_m));
        let nodes = crate::fit::hermite_nodes(&on.grid, &on.samples, &[]);
        let lattice = &on.grid.lattice;
        let table = HermitePlanes { row: &nodes.row, nodes: &nodes.nodes };
        table.check(lattice).expect("a valid table");
        for n in 0..200 {
            let at = crate::fit::synthetic::spread(n, 0.99 * on.grid.radius_m);
            let found = table.energy_gradient(lattice, &lattice.locate(at.map(|x| x as f32)));
            let exact: [f64; 3] = (jet([0.0; 3]).stiffness_n_m * Vector3::from(at)).into();
            let apart = distance(found.map(f64::from), exact);
            assert!(apart < 1e-6 * norm(exact) + 1e-7, "{apart} N of {}", norm(exact));
        }
    }
}
