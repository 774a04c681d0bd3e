//! The reachable set: displacements within radius, workspace and force limit; without pull if the tool only
//! pushes.

use super::AdaptiveFit;
use crate::fit::LEAST_ROOT_J;
use crate::num::sequence::{on_sphere, r2};
use crate::num::vector::{distance, norm};
use crate::spec::{Quantity, UNIT_M};

/// Number of ray directions.
const RAYS: u32 = 256;
/// Number of bisections of a ray's length; the error is below 1 / 500 of the radius.
const HALVINGS: u32 = 9;
/// Factor on the force limit for predictions, so that positions on both sides of the limit are chosen.
const LIMIT_FACTOR: f64 = 1.02;
/// Positions on a ray, as shares of the reachable volume.
const SHARES: [f64; 3] = [1.0, 0.6, 0.2];

/// A sphere is only solved where its predicted energy exceeds the least one of a root by this factor.
const TOUCHING: f64 = 3.0;

impl AdaptiveFit {
    /// About `count` displacements, m, distributed over the reachable set, different from those of the
    /// search.
    pub fn places(&self, count: u32) -> Vec<[f64; 3]> {
        let rounds = count.div_ceil(RAYS * SHARES.len() as u32);
        (0..rounds).flat_map(|round| self.candidates(1000 + round)).collect()
    }

    /// Positions distributed over the predicted reachable set, in a fixed order.
    ///
    /// A ray ends where the fit or the Taylor series of the nearest configuration predicts a force beyond the
    /// limit. The fit alone is unreliable far from its data.
    pub(super) fn candidates(&self, round: u32) -> Vec<[f64; 3]> {
        let mut found = Vec::new();
        for n in 0..RAYS {
            let direction = direction(round * RAYS + n);
            let reach = self.reach(direction);
            for share in SHARES {
                let at = direction.map(|x| x * reach * libm::cbrt(share));
                if self.presses(at) {
                    found.push(at);
                }
            }
        }
        found
    }

    /// Length of a ray to the boundary of the column and the workspace, m; r_G without them.
    fn boundary_distance_m(&self, direction: [f64; 3]) -> f64 {
        let column = self.wanted.column.zip(self.wanted.push);
        let to_column_m = column.map(|(column, normal)| column.length_of_ray_m(normal, direction));
        let limit_m = to_column_m.map_or(self.wanted.radius_m, |way_m| way_m.min(self.wanted.radius_m));
        let Some([low, high]) = self.wanted.workspace_m else { return limit_m };
        let ways = (0..3).map(|axis| {
            let end = if direction[axis] < 0.0 { low[axis] } else { high[axis] };
            if direction[axis] == 0.0 { f64::INFINITY } else { (end / direction[axis]).max(0.0) }
        });
        ways.fold(limit_m, f64::min)
    }

    /// Length of a ray within the reachable set, m.
    fn reach(&self, direction: [f64; 3]) -> f64 {
        let mut way_m = self.boundary_distance_m(direction);
        let least_root = (2.0 * TOUCHING * LEAST_ROOT_J).sqrt();
        let within = |share: f64, way_m: f64| {
            let at = direction.map(|x| x * share * way_m);
            let touches = self.root_at(at).is_none_or(|(value, _)| value > least_root);
            touches && self.largest_n(at) <= LIMIT_FACTOR * self.wanted.max_force_n
        };
        if within(1.0, way_m) {
            return way_m;
        }
        // On a stiff node the reach is a small share of the radius. The search continues in the first part of
        // the ray.
        while way_m > UNIT_M {
            let (mut low, mut high) = (0.0, 1.0);
            for _ in 0..HALVINGS {
                let middle = 0.5 * (low + high);
                if within(middle, way_m) { low = middle } else { high = middle }
            }
            if low > 0.0 {
                return low * way_m;
            }
            way_m *= high;
        }
        0.0
    }

    /// The larger of the two predictions of |h|, N.
    fn largest_n(&self, at: [f64; 3]) -> f64 {
        let predicted_n = norm(self.predicted_n(at));
        match self.wanted.quantity {
            Quantity::Energy => predicted_n.max(norm(self.jets[self.nearest(at)].taylor_force_n(at))),
            Quantity::Root => predicted_n,
        }
    }

    /// h at a displacement, N: that of the fit. Of a sphere that of the Taylor series of the nearest configuration, because a
    /// fit to different branches can keep a part of the chart from being solved.
    pub(super) fn predicted_n(&self, at: [f64; 3]) -> [f64; 3] {
        match self.root_at(at) {
            Some((value, slope)) => slope.map(|slope| value.max(0.0) * slope),
            None => self.fit.force_n(at),
        }
    }

    /// Value and slope of the root of a sphere in the Taylor series of the nearest configuration.
    fn root_at(&self, at: [f64; 3]) -> Option<(f64, [f64; 3])> {
        let root = match self.wanted.quantity {
            Quantity::Energy => return None,
            Quantity::Root => self.jets[self.nearest(at)].root(LEAST_ROOT_J)?,
        };
        Some((root.taylor_value(at), root.taylor_force_n(at)))
    }

    /// Whether the tool presses at a position, if it only pushes.
    fn presses(&self, at: [f64; 3]) -> bool {
        self.wanted.push.is_none_or(|normal| self.wanted.pushes(self.predicted_n(at), normal))
    }

    /// Index of the configuration nearest to a displacement.
    pub(crate) fn nearest(&self, at: [f64; 3]) -> usize {
        let away = |n: usize| distance(at, self.jets[n].control_m);
        (0..self.jets.len()).min_by(|&a, &b| away(a).total_cmp(&away(b))).unwrap_or(0)
    }
}

/// Direction `n` of a sequence that is evenly distributed for any number of terms (R2 sequence: Roberts
/// 2018).
fn direction(n: u32) -> [f64; 3] {
    let [z, turn] = r2(n, 0.5);
    on_sphere(2.0 * z - 1.0, libm::sincos(std::f64::consts::TAU * turn))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::adaptive::Search;
    use crate::fit::KernelSystem;
    use crate::fit::synthetic::jet;
    use crate::spec::{Requirements, Tolerance};

    /// A fit with a short kernel length approaches the model at rest far from its data. Without the Taylor
    /// series of the configurations it would choose positions far beyond the limit.
    #[test]
    fn a_fit_that_knows_nothing_there_does_not_lead_astray() {
        let wanted = Requirements {
            tolerance: Tolerance::IMPERCEPTIBLE,
            radius_m: 0.1,
            max_force_n: 20.0,
            push: None,
            workspace_m: None,
            column: None,
            quantity: Quantity::Energy,
            max_configurations: 100,
        };
        let jets = [[0.0; 3], [0.03, -0.02, 0.025]].map(jet).to_vec();
        let mut system = KernelSystem::of_energy(0.004, jets[0].stiffness_n_m);
        system.add(&jets).expect("apart");
        let search = Search::new(wanted, &jets[0]);
        let model = AdaptiveFit { jets, fit: system.fit, ..search.fitted };
        let (fit, candidates) = (&model.fit, model.candidates(0));
        assert!(candidates.len() > 500);
        let limit_n = 1.001 * LIMIT_FACTOR * wanted.max_force_n;
        for &at in &candidates {
            let [by_fit, by_taylor] =
                [fit.force_n(at), model.jets[model.nearest(at)].taylor_force_n(at)].map(norm);
            assert!(by_fit <= limit_n && by_taylor <= limit_n, "{at:?}: {by_fit} N, {by_taylor} N");
        }
        // Farther out along a ray the force of the fit alone would be within the limit.
        let astray = candidates.iter().filter(|at| {
            let further = at.map(|x| 1.2 * x);
            norm(further) <= wanted.radius_m && norm(fit.force_n(further)) <= wanted.max_force_n
        });
        assert!(astray.count() > 20);
    }
}
