//! Continuity and energy error of sliding from node to node, measured on the tables of an organ.
//!
//! While the tool slides, the force is h = sum w_i h_i(d), where w_i are the barycentric weights of the
//! contact point. The weights are continuous across an edge, so the force is too. The **seam** is the
//! rounding difference that remains. The force is not the gradient of the blended energy U = sum w_i W_i(d):
//! dU = h . dd + sum W_i dw_i, and the force omits the second term. A tool that presses at one node, slides
//! to its neighbour and lifts there gains or loses W_b - W_a. This is the **energy error** of the edge.
//! Friction dissipates mu |h_n| per unit length of the edge. While it dissipates more than the energy error,
//! no path over the surface gives energy to the hand.

use core::fmt;
use palpate_core::{Foot, Method, NodeWeight, Organ, TouchSurface, Vec3, vec3};
use std::collections::BTreeMap;

/// Load steps of a press along the normal.
const STEPS: usize = 40;

/// Result of sliding over an organ.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SlidingReport {
    /// Triangles whose three corners are active nodes.
    pub triangles: usize,
    /// Triangles of the surface.
    pub all_triangles: usize,
    /// Edges of these triangles: a tool can slide along them.
    pub edges: usize,
    /// Largest difference of the force between the two sides of an edge, N.
    pub seam_n: f32,
    /// Largest |W_b - W_a| of two neighbours at equal displacement within the force limit, J.
    pub energy_j: f32,
    /// Largest ratio of this energy error to the work of friction along the edge. Below 1, sliding gives no
    /// energy.
    pub friction_share: f32,
}

impl fmt::Display for SlidingReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "over {} of {} triangles; seam at most {:.4} mN; energies of neighbours differ by at most {:.2} mJ, {:.2} of the work of friction",
            self.triangles,
            self.all_triangles,
            self.seam_n * 1e3,
            self.energy_j * 1e3,
            self.friction_share
        )
    }
}

/// Presses up to the force limit at both ends of every edge that a tool can slide along, and at its middle
/// from both sides.
#[must_use]
pub fn report<const N: usize>(
    organ: &Organ<'_, N>,
    surface: &TouchSurface<'_>,
    method: Method,
    friction: f32,
) -> SlidingReport {
    let triangles = organ.surface.triangles;
    let mut report = SlidingReport { all_triangles: triangles.len(), ..SlidingReport::default() };
    // Contact points at the middle of each edge, one per adjacent triangle.
    let mut edges: BTreeMap<[u32; 2], Vec<Foot>> = BTreeMap::new();
    for (triangle, corners) in (0..).zip(triangles) {
        let middle = |weights| Foot { triangle, weights };
        if surface.node_weights(&middle([1.0, 0.0, 0.0])).is_none() {
            continue;
        }
        report.triangles += 1;
        for (a, b, weights) in [(0, 1, [0.5, 0.5, 0.0]), (1, 2, [0.0, 0.5, 0.5]), (2, 0, [0.5, 0.0, 0.5])] {
            let (a, b): (u32, u32) = (corners[a], corners[b]);
            edges.entry([a.min(b), a.max(b)]).or_default().push(middle(weights));
        }
    }
    report.edges = edges.len();
    for ([a, b], feet) in &edges {
        let space = |vertex: u32| {
            let node = organ.surface.node[vertex as usize];
            organ.spaces.iter().find(|space| space.active.node == node)
        };
        let (Some(one), Some(other)) = (space(*a), space(*b)) else { continue };
        let normal =
            vec3::normalize_or_zero(vec3::add(one.active.outward_normal, other.active.outward_normal));
        let length_m = vec3::distance(one.active.rest_position_m, other.active.rest_position_m);
        let reach_m = one.lattice().radius_m().min(other.lattice().radius_m());
        let step_m = reach_m / STEPS as f32;
        let (mut before, mut work_j) = ([0.0; 2], [0.0_f32; 2]);
        for step in 1..=STEPS {
            let d = vec3::scale(normal, -step_m * step as f32);
            let at = |space: &palpate_core::Space<'_>| space.force(method, d).map(|answer| answer.force_n);
            let (Some(first_n), Some(second_n)) = (at(one), at(other)) else { break };
            if vec3::norm(first_n).max(vec3::norm(second_n)) > organ.max_force_n {
                break;
            }
            report.seam_n = report.seam_n.max(seam_n(organ, surface, feet, method, d));
            let pressing = [first_n, second_n].map(|force_n| -vec3::dot(force_n, normal));
            for ((work, before), now) in work_j.iter_mut().zip(&mut before).zip(pressing) {
                *work += 0.5 * (*before + now) * step_m;
                *before = now;
            }
            let difference_j = (work_j[0] - work_j[1]).abs();
            let friction_j = friction * 0.5 * (pressing[0] + pressing[1]) * length_m;
            report.energy_j = report.energy_j.max(difference_j);
            report.friction_share =
                report.friction_share.max(difference_j / friction_j.max(f32::MIN_POSITIVE));
        }
    }
    report
}

fn seam_n<const N: usize>(
    organ: &Organ<'_, N>,
    surface: &TouchSurface<'_>,
    feet: &[Foot],
    method: Method,
    d: Vec3,
) -> f32 {
    let blended = |foot: &Foot| -> Option<Vec3> {
        let mut sum = vec3::ZERO;
        for NodeWeight { space, weight } in surface.node_weights(foot)? {
            let force_n = organ.spaces.get(usize::from(space))?.force(method, d)?.force_n;
            sum = vec3::add(sum, vec3::scale(force_n, weight));
        }
        Some(sum)
    };
    let forces: Vec<Vec3> = feet.iter().filter_map(blended).collect();
    forces.windows(2).map(|pair| vec3::distance(pair[0], pair[1])).fold(0.0, f32::max)
}
