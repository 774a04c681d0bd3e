//! Where a chart of a sphere's field is solved next: in the widest gaps between its configurations.
//!
//! The Taylor series of configuration n misses the force by about c_n r^3 at the distance r. Its errors e_m at the nearest
//! configurations, s_m away, give c_n, the mean of e_m / s_m^3. The fit takes all of them, and its error is a share of that
//! of one series. So the tolerance t holds within
//!
//! r_n = (SERIES t / c_n)^(1/3),   between LEAST_M and MOST_M
//!
//! A position is covered if the configuration nearest to it is within that one's radius. The search ends when no candidate
//! is uncovered. So few configurations are needed where the force is smooth, and more over the edges of the skin.

use super::{BATCH, Search};
use crate::adaptive::branch::series_error;
use crate::num::jet::EnergyJet;
use crate::num::vector::distance;

/// Error of a single series in tolerances at the end of its radius.
const SERIES: f64 = 3.0;
/// Number of neighbours that tell the error of a series.
const NEIGHBOURS: usize = 3;
/// Bounds of the radius, m.
const LEAST_M: f64 = 3.5e-3;
const MOST_M: f64 = 7e-3;
/// Radius of a position that failed or is no datum, and of one without neighbours, m.
const USUAL_M: f64 = 6e-3;

impl Search {
    /// Chooses a batch: the replacements, then the candidates that are farthest outside the radius of the nearest
    /// configuration, relative to it.
    pub(super) fn choose_in_gaps(&mut self) {
        for (at, parent) in std::mem::take(&mut self.replacements) {
            self.aim(at, parent, true);
        }
        let known = self.covered();
        let candidates = self.fitted.candidates(self.round);
        self.round += 1;
        let gap = |at: &[f64; 3]| {
            let shares = known.iter().map(|(place, radius_m)| (distance(*at, *place), radius_m));
            let (away_m, radius_m) = shares.min_by(|a, b| a.0.total_cmp(&b.0)).expect("the origin");
            away_m / radius_m
        };
        let mut gaps: Vec<f64> = candidates.iter().map(gap).collect();
        while self.batch.len() < BATCH {
            let widest = (0..gaps.len()).max_by(|&a, &b| gaps[a].total_cmp(&gaps[b]).then(b.cmp(&a)));
            let Some(widest) = widest.filter(|&n| gaps[n] > 1.0) else { break };
            let at = candidates[widest];
            for (gap, &other) in gaps.iter_mut().zip(&candidates) {
                *gap = gap.min(distance(at, other) / USUAL_M);
            }
            self.aim(at, self.fitted.nearest(at), true);
        }
    }

    /// The known positions with their radii, m.
    fn covered(&self) -> Vec<([f64; 3], f64)> {
        let jets = &self.fitted.jets;
        let data = jets.iter().map(|jet| (jet.control_m, self.radius_m(jet)));
        data.chain(self.taken().skip(jets.len()).map(|place| (place, USUAL_M))).collect()
    }

    fn radius_m(&self, of: &EnergyJet) -> f64 {
        let away_m = |jet: &EnergyJet| distance(jet.control_m, of.control_m);
        let mut others: Vec<&EnergyJet> = self.fitted.jets.iter().filter(|jet| away_m(jet) > 0.0).collect();
        others.sort_by(|a, b| away_m(a).total_cmp(&away_m(b)));
        others.truncate(NEIGHBOURS);
        if others.is_empty() {
            return USUAL_M;
        }
        let of_one =
            |jet: &&EnergyJet| series_error(jet, of, &self.fitted.wanted.tolerance) / away_m(jet).powi(3);
        let mean = others.iter().map(of_one).sum::<f64>() / others.len() as f64;
        libm::cbrt(SERIES / mean).clamp(LEAST_M, MOST_M)
    }
}
