//! Branches of a sphere's field: an organ that gives way has several equilibria at one place of the sphere.
//!
//! The forces of two branches differ by tens of tolerances. The Taylor series of a neighbour differs from the truth by less
//! up to a distance of about 6 mm. So a configuration is compared with the series of the nearest one on the branch.

use crate::fit::LEAST_ROOT_J;
use crate::num::jet::EnergyJet;
use crate::num::vector::distance;
use crate::spec::Tolerance;

/// A configuration is on another branch if the Taylor series of the nearest one on the chart's branch misses its force
/// by more than this multiple of the tolerance at the distance [`CLOSE_M`], and by more than the other up to half of it;
/// the error of a series grows with the third power. It is too if none is nearer than twice that distance.
const CONTRADICTION: f64 = 6.0;
const LEAST_CONTRADICTION: f64 = 1.5;
const CLOSE_M: f64 = 4e-3;

/// Two configurations agree if the series of both miss by at most this multiple of the tolerance up to the distance
/// [`CLOSE_M`], and by more beyond.
const AGREEMENT: f64 = 12.0;

/// Whether a configuration is near enough to a neighbour to be compared with it.
fn is_close(of: &EnergyJet, neighbour: &EnergyJet) -> bool {
    distance(of.control_m, neighbour.control_m) <= 2.0 * CLOSE_M
}

/// Error of the third-order Taylor series of a neighbour's root in the force of a configuration, as a share of the
/// tolerance; infinite if the neighbour has no root.
pub(super) fn series_error(of: &EnergyJet, neighbour: &EnergyJet, tolerance: &Tolerance) -> f64 {
    neighbour.root(LEAST_ROOT_J).map_or(f64::INFINITY, |root| {
        let value = root.taylor_value(of.control_m).max(0.0);
        let predicted_n = root.taylor_force_n(of.control_m).map(|slope| value * slope);
        distance(predicted_n, of.force_n) / tolerance.at(of.force_n)
    })
}

/// Whether the series of each of two configurations predicts the other, so that one fit can have both.
pub(super) fn agree(a: &EnergyJet, b: &EnergyJet, tolerance: &Tolerance) -> bool {
    let share = distance(a.control_m, b.control_m) / CLOSE_M;
    let most = AGREEMENT * share.powi(3).max(1.0);
    series_error(a, b, tolerance) <= most && series_error(b, a, tolerance) <= most
}

/// Whether a configuration near a neighbour is on another branch.
pub(super) fn contradicts(of: &EnergyJet, neighbour: &EnergyJet, tolerance: &Tolerance) -> bool {
    let share = distance(of.control_m, neighbour.control_m) / CLOSE_M;
    let most = (CONTRADICTION * share.powi(3)).max(LEAST_CONTRADICTION);
    is_close(of, neighbour) && series_error(of, neighbour, tolerance) > most
}

/// Which of the configurations are on the branch of the first. From the first on, always the one nearest to those on the
/// branch is compared with the one there.
pub(crate) fn on_one_branch(jets: &[EnergyJet], tolerance: &Tolerance) -> Vec<bool> {
    let mut agrees = vec![false; jets.len()];
    // The nearest one on the branch, and its distance.
    let mut nearest = vec![(f64::INFINITY, 0); jets.len()];
    let mut is_open = vec![true; jets.len()];
    let mut next = (!jets.is_empty()).then_some(0);
    while let Some(at) = next {
        is_open[at] = false;
        let neighbour = &jets[nearest[at].1];
        agrees[at] =
            at == 0 || is_close(&jets[at], neighbour) && !contradicts(&jets[at], neighbour, tolerance);
        if agrees[at] {
            for (other, nearest) in nearest.iter_mut().enumerate() {
                let away_m = distance(jets[other].control_m, jets[at].control_m);
                if away_m < nearest.0 {
                    *nearest = (away_m, at);
                }
            }
        }
        let open = (0..jets.len()).filter(|other| is_open[*other] && nearest[*other].0.is_finite());
        next = open.min_by(|&a, &b| nearest[a].0.total_cmp(&nearest[b].0));
    }
    agrees
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    /// A state of W = s^2 / 2 with a linear root that rises by `slope` on the way down the z axis.
    fn state(control_m: [f64; 3], slope: f64) -> EnergyJet {
        let root = EnergyJet {
            control_m,
            energy_j: 0.2 - slope * control_m[2],
            force_n: [0.0, 0.0, -slope],
            stiffness_n_m: Matrix3::zeros(),
            third_n_m2: [0.0; 10],
        };
        root.squared()
    }

    /// A branch goes on from neighbour to neighbour. States of another one, and those that no neighbour reaches, are left out.
    #[test]
    fn a_branch_is_followed_from_neighbour_to_neighbour() {
        let along = |n: usize, slope| state([3e-3 * n as f64, 0.0, -2e-3], slope);
        let mut jets: Vec<EnergyJet> = (0..8).map(|n| along(n, 20.0)).collect();
        jets.extend(
            (1..8).map(|n| EnergyJet { control_m: [3e-3 * n as f64, 1e-3, -2e-3], ..along(n, 10.0) }),
        );
        jets.push(state([0.04, 0.0, -2e-3], 20.0));
        let agrees = on_one_branch(&jets, &Tolerance::IMPERCEPTIBLE);
        let expected: Vec<bool> = (0..jets.len()).map(|n| n < 8).collect();
        assert_eq!(agrees, expected);
        assert!(contradicts(&jets[9], &jets[1], &Tolerance::IMPERCEPTIBLE));
        assert!(!contradicts(&jets[2], &jets[1], &Tolerance::IMPERCEPTIBLE));
        // Of one that is far away a series says nothing.
        assert!(!contradicts(&along(9, 10.0), &jets[1], &Tolerance::IMPERCEPTIBLE));
    }
}
