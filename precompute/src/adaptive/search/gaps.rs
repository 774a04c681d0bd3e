//! Where a chart of a sphere's field is solved next: in the widest gaps between its configurations.
//!
//! The fit is exact to the third order at each configuration. So its error at the distance r from configuration n grows
//! about as r^4, and the leave-one-out error e_n, made at the distance s_n of the nearest other configuration, gives the
//! radius within which the tolerance holds:
//!
//! r_n = s_n (SAFETY tolerance / e_n)^(1/4),   between LEAST_M and MOST_M
//!
//! A position is covered if the configuration nearest to it is within that one's radius. The search ends when no candidate
//! is uncovered. So few configurations are needed where the force is smooth, and more over the edges of the skin.

use super::{BATCH, Search};
use crate::num::vector::distance;

/// Share of the tolerance that the estimate may reach.
const SAFETY: f64 = 4.0;
/// Bounds of the radius, m. The upper one is that of a position that failed or is no datum, too.
const LEAST_M: f64 = 4e-3;
const MOST_M: f64 = 7e-3;

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
                *gap = gap.min(distance(at, other) / MOST_M);
            }
            self.aim(at, self.fitted.nearest(at), true);
        }
    }

    /// The known positions with their radii, m.
    fn covered(&self) -> Vec<([f64; 3], f64)> {
        let shares = &self.fits[self.chosen].leave_one_out;
        // Those of the configurations that are no given ones; the origin is one of these.
        let places: Vec<[f64; 3]> = self.fitted.jets.iter().map(|jet| jet.control_m).collect();
        let nearest_m = |n: usize| {
            let others = places.iter().enumerate().filter(|(other, _)| *other != n);
            others.map(|(_, place)| distance(*place, places[n])).fold(f64::INFINITY, f64::min)
        };
        let radius_m = |n: usize| {
            let share = n.checked_sub(1).and_then(|own| shares.get(own)).copied().unwrap_or(1.0);
            (nearest_m(n) * (SAFETY / share).sqrt().sqrt()).clamp(LEAST_M, MOST_M)
        };
        let data = places.iter().enumerate().map(|(n, place)| (*place, radius_m(n)));
        data.chain(self.taken().skip(places.len()).map(|place| (place, MOST_M))).collect()
    }
}
