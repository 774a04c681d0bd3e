//! A cheap body with the response of the probes. Adaptive sampling, plan and fits run on it as on the real
//! body.
//!
//! Its energy is a kernel fit of the probes with a shorter length than that of the best prediction, because a
//! real body has more detail between the probes than their fit.

use crate::adaptive::{AdaptiveFit, Search, SolveResult};
use crate::fit::{KernelFit, KernelSystem, Sample};
use crate::num::{EnergyJet, norm};
use crate::space::expand_model;
use crate::spec::{GridIndex, Lattice, Requirements, Tolerance};

use super::probe::Probed;
use super::tables::Place;

/// Trial lengths of the kernel as shares of the initial reach, over the range of the search.
const LENGTH_SHARES: [f64; 3] = [0.5, 0.9, 1.5];
/// Ratio of the surrogate's length to that of the fit with the best predictions.
const LENGTH_RATIO: f64 = 0.75;

/// Convergence order of a fit by energy, force, stiffness and third derivatives, in the distance of its data.
const ORDER: f64 = 6.0;
/// With this number of probes the leave-one-out errors are used as they are. With fewer they are scaled to
/// this number.
const FULL_PROBES: f64 = 16.0;

/// The energy fitted to the probes.
#[derive(Debug, Clone)]
pub(super) struct Surrogate {
    fit: KernelFit,
    rest: EnergyJet,
    wanted: Requirements,
    /// Ratio of the errors of a fit on the body to those on the surrogate; 1 if the probes show all features.
    doubt: f64,
}

/// A completed run of adaptive sampling.
#[derive(Debug)]
pub(super) struct Scattered {
    /// Its fit.
    pub fit: AdaptiveFit,
    /// Number of configurations on the surrogate, including rest.
    pub solved: usize,
    /// Number of configurations for the body, including rest.
    pub configurations: f64,
}

/// A completed expansion of a lattice.
#[derive(Debug)]
pub(super) struct Expanded {
    /// Solved points, sorted, including rest.
    pub samples: Vec<Sample>,
}

impl Surrogate {
    /// The energy that interpolates every probe.
    pub(super) fn of(probed: &Probed) -> Option<Self> {
        let (rest, wanted) = (*probed.jets.first()?, probed.wanted);
        let mean = (rest.stiffness_n_m.trace() / 3.0).max(f64::MIN_POSITIVE);
        let reach = (wanted.max_force_n / mean).min(wanted.radius_m);
        let scores = LENGTH_SHARES.iter().filter_map(|share| {
            let mut system = KernelSystem::of_energy(share * reach, rest.stiffness_n_m);
            system.add(&probed.jets).ok()?;
            Some((left_out(&system, &probed.jets), share))
        });
        let (score, share) = scores.min_by(|a, b| a.0.total_cmp(&b.0))?;
        let mut system = KernelSystem::of_energy(LENGTH_RATIO * share * reach, rest.stiffness_n_m);
        system.add(&probed.jets).ok()?;
        let doubt = doubt(score.sqrt(), probed.jets.len() - 1);
        Some(Self { fit: system.fit, rest, wanted, doubt })
    }

    /// A linear body with the same stiffness at rest, for any displacement.
    pub(super) fn linear(&self) -> Self {
        let rest = EnergyJet { third_n_m2: [0.0; 10], ..self.rest };
        let mut system = KernelSystem::of_energy(self.fit.length_m, rest.stiffness_n_m);
        system.add(&[rest]).expect("one configuration is apart from all others");
        Self { fit: system.fit, rest, wanted: self.wanted, doubt: 1.0 }
    }

    /// Ratio of the errors of a fit with few configurations on the body to those on the surrogate. Lattices
    /// have enough points for the features that the probes do not show.
    pub(super) fn doubt(&self) -> f64 {
        self.doubt
    }

    /// Ratio of the configurations for that error: it decreases with their number to the power of [`ORDER`] /
    /// 3.
    pub(super) fn more(&self) -> f64 {
        libm::pow(self.doubt, 3.0 / ORDER)
    }

    /// Force h, N.
    pub(super) fn force_n(&self, at: [f64; 3]) -> [f64; 3] {
        self.fit.force_n(at)
    }

    /// Positions distributed over the reach, with the force there.
    pub(super) fn places(&self, fit: &AdaptiveFit, count: u32) -> Vec<Place> {
        let places = fit.places(count).into_iter().map(|at| Place { at, exact: self.force_n(at) });
        places.filter(|place| norm(place.exact) <= self.wanted.max_force_n).collect()
    }

    /// Runs adaptive sampling on it.
    pub(super) fn scattered(&self) -> Scattered {
        let mut search = Search::new(self.wanted, &self.rest);
        let mut solved = 1_usize;
        search.run(|_, target| {
            solved += 1;
            SolveResult::Solved(self.fit.jet(target.displacement_m))
        });
        let configurations =
            f64::min(solved as f64 * self.more(), self.wanted.max_configurations as f64 + 1.0);
        Scattered { fit: search.fitted, solved, configurations }
    }

    /// Runs the lattice's plan on it as for a scene with a lattice: the whole ball within the force limit.
    pub(super) fn lattice(&self, lattice: &Lattice) -> Expanded {
        self.expanded(lattice, false)
    }

    /// The lattice that replaces adaptive sampling, limited to the tool's reach.
    pub(super) fn lattice_that_takes_over(&self, lattice: &Lattice) -> Expanded {
        self.expanded(lattice, true)
    }

    fn expanded(&self, lattice: &Lattice, is_limited: bool) -> Expanded {
        let jet = |index: GridIndex| match index {
            [0, 0, 0] => self.rest,
            _ => self.fit.jet(lattice.grid.displacement_m(index)),
        };
        Expanded { samples: expand_model(lattice, &self.wanted, is_limited, jet) }
    }
}

/// Mean square of the leave-one-out errors of the probes, relative to the human just-noticeable difference:
/// the roughness of a body does not depend on the scene's tolerance.
fn left_out(system: &KernelSystem, jets: &[EnergyJet]) -> f64 {
    let missed = system.leave_one_out_n().zip(jets).skip(1);
    let felt = |force_n| Tolerance::IMPERCEPTIBLE.at(force_n);
    let sum: f64 = missed.map(|(missed, jet)| (norm(missed) / felt(jet.force_n)).powi(2)).sum();
    sum / (jets.len() - 1).max(1) as f64
}

/// The surrogate lacks features of the body that the few probes do not show. They appear in `error`, the
/// leave-one-out error relative to the just-noticeable difference, with `probes` probes. An error below it
/// needs no correction.
fn doubt(error: f64, probes: usize) -> f64 {
    let fewer = (probes as f64 / FULL_PROBES).min(1.0);
    (error * libm::pow(fewer, ORDER / 3.0)).max(1.0)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::adaptive::Step;
    use crate::spec::{Quantity, SpaceGrid};

    /// A body that stiffens under load: W = 100 |p|^2 + 0.02 (exp(g.p) - 1 - g.p).
    pub(in crate::plan) fn stiffening(p: [f64; 3]) -> EnergyJet {
        let (d, g, c) = ([200.0, 150.0, 300.0], [20.0, -12.0, 16.0], 0.02);
        let e = c * (0..3).map(|i| g[i] * p[i]).sum::<f64>().exp();
        let third = crate::num::THIRD_INDICES.map(|t| t.iter().map(|&i| g[i]).product::<f64>() * e);
        let mut jet = EnergyJet {
            control_m: p,
            energy_j: (0..3).map(|i| 0.5 * d[i] * p[i] * p[i] - c * g[i] * p[i]).sum::<f64>() + e - c,
            force_n: std::array::from_fn(|i| d[i] * p[i] + (e - c) * g[i]),
            stiffness_n_m: Default::default(),
            third_n_m2: third,
        };
        for i in 0..3 {
            for j in 0..3 {
                jet.stiffness_n_m[(i, j)] = e * g[i] * g[j] + if i == j { d[i] } else { 0.0 };
            }
        }
        jet
    }

    pub(in crate::plan) fn probed(batches: usize, max_force_n: f64) -> Probed {
        let tolerance = Tolerance::IMPERCEPTIBLE;
        let wanted = Requirements {
            tolerance,
            radius_m: 0.05,
            max_force_n,
            push: None,
            workspace_m: None,
            column: None,
            quantity: Quantity::Energy,
            max_configurations: 160,
        };
        let rest = stiffening([0.0; 3]);
        let mut search = Search::new(wanted, &rest);
        let mut jets = vec![rest];
        for _ in 0..batches {
            let Step::Solve(targets) = search.step() else { break };
            let solved: Vec<EnergyJet> = targets.iter().map(|t| stiffening(t.displacement_m)).collect();
            jets.extend(&solved);
            search.take(&solved.into_iter().map(SolveResult::Solved).collect::<Vec<_>>());
        }
        Probed {
            active: 0,
            wanted,
            moved: Vec::new(),
            jets,
            rest_s: 1.0,
            far_s: vec![3.0],
            near_s: vec![2.0],
            lost: 0,
            failed: 0,
            has_ended: false,
            beyond: 0,
            again: 0,
            elsewhere: 0,
            too_stiff: None,
            size: [3000, 100_000, 400_000],
        }
    }

    /// Number of configurations of adaptive sampling on the body itself.
    fn true_count(probed: &Probed) -> usize {
        let mut search = Search::new(probed.wanted, &stiffening([0.0; 3]));
        let mut count = 1;
        search.run(|_, target| {
            count += 1;
            SolveResult::Solved(stiffening(target.displacement_m))
        });
        count
    }

    #[test]
    fn the_loop_on_the_surrogate_takes_what_it_takes_on_the_body() {
        for batches in [1, 2] {
            let probed = probed(batches, 8.0);
            let (predicted, truth) = (Surrogate::of(&probed).unwrap().scattered(), true_count(&probed));
            let ratio = predicted.configurations / truth as f64;
            assert!((0.5..=2.0).contains(&ratio), "{} for {truth}", predicted.configurations);
        }
    }

    #[test]
    fn a_lattice_ends_where_the_force_does() {
        let grid = SpaceGrid::new(0.01, 0.05).unwrap();
        let lattice = Lattice { grid, complete_cells: true, increments: None };
        let of = |force_n| Surrogate::of(&probed(2, force_n)).unwrap().lattice(&lattice);
        let (all, some) = (of(1e3), of(4.0));
        assert_eq!(all.samples.len(), 1015);
        assert!(
            some.samples.len() < 600 && some.samples.iter().any(|s| s.terminating),
            "{}",
            some.samples.len()
        );
        // The body itself, by the same rule: within 20 %.
        let truly = |s: &&Sample| norm(stiffening(grid.displacement_m(s.index)).force_n) < 4.0;
        let inside = some.samples.iter().filter(truly).count();
        let said = some.samples.iter().filter(|s| !s.terminating).count();
        assert!(inside.abs_diff(said) * 5 < said, "{inside} {said}");
    }

    #[test]
    fn what_a_left_out_probe_tells() {
        assert_eq!((doubt(0.7, 16), doubt(4.0, 16), doubt(4.0, 8), doubt(4.0, 99)), (1.0, 4.0, 1.0, 4.0));
    }

    #[test]
    fn a_finer_tolerance_takes_more_but_makes_no_body_rougher() {
        let mut probed = probed(2, 8.0);
        let felt = Surrogate::of(&probed).unwrap();
        probed.wanted.tolerance = Tolerance { absolute_n: 0.002, relative: 0.0 };
        let fine = Surrogate::of(&probed).unwrap();
        assert_eq!(fine.doubt(), felt.doubt());
        assert!(fine.scattered().configurations > felt.scattered().configurations);
    }

    #[test]
    fn the_linear_body_answers_in_proportion() {
        let linear = Surrogate::of(&probed(1, 8.0)).unwrap().linear();
        let [a, b] = [[0.01, -0.002, 0.004], [0.02, -0.004, 0.008]].map(|at| linear.force_n(at));
        for (a, b) in a.iter().zip(b) {
            assert!((2.0 * a - b).abs() < 1e-9 * a.abs().max(1.0));
        }
    }
}
