//! What sliding from node to node costs in smoothness and in energy, measured on the tables of an organ.
//!
//! A tool that slides is answered by h = sum w_i h_i(d), the w_i being its foot's barycentric weights. Over an edge the weights are continuous, so
//! the force is: the **seam** is what rounding leaves of it. The force is not the gradient of the blended energy U = sum w_i W_i(d), though:
//! dU = h . dd + sum W_i dw_i, and the second part is felt by nobody. Who presses at one node, slides to its neighbour and lifts there gets
//! W_there - W_here for nothing: the **energy error** of the edge. Friction takes mu |h_n| along the same edge; as long as that is more, no
//! way over the surface gives energy to the hand.

use core::fmt;
use palpate_core::surface::{Foot, TouchSurface};
use palpate_core::{Method, Organ, Share, Vec3, vec3};
use std::collections::BTreeMap;

/// Steps of a press along the normal.
const STEPS: usize = 40;

/// What sliding over an organ costs.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SlidingReport {
    /// Triangles whose corners are all active nodes.
    pub triangles: usize,
    /// Triangles of the surface.
    pub all_triangles: usize,
    /// Edges between two of them, over which a tool may slide.
    pub edges: usize,
    /// Largest difference of the force from both sides of an edge, N.
    pub seam_n: f32,
    /// Largest |W_there - W_here| of two neighbours at the same displacement within the force limit, J.
    pub energy_j: f32,
    /// Largest share that error is of what friction takes on the way; below 1 sliding gives no energy.
    pub friction_share: f32,
}

impl fmt::Display for SlidingReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "over {} of {} triangles; seam {:.4} mN at most; neighbours differ by up to {:.2} mJ, {:.2} of what friction takes on the way",
            self.triangles,
            self.all_triangles,
            self.seam_n * 1e3,
            self.energy_j * 1e3,
            self.friction_share
        )
    }
}

/// Presses at both ends of every edge that a tool may slide along, and at its middle from both sides, until the force limit.
#[must_use]
pub fn report<const N: usize>(
    organ: &Organ<'_, N>,
    surface: &TouchSurface<'_>,
    method: Method,
    friction: f32,
) -> SlidingReport {
    let triangles = organ.surface.triangles;
    let mut report = SlidingReport { all_triangles: triangles.len(), ..SlidingReport::default() };
    // The feet at the middle of each edge, one a triangle that has it.
    let mut edges: BTreeMap<[u32; 2], Vec<Foot>> = BTreeMap::new();
    for (triangle, corners) in (0..).zip(triangles) {
        let middle = |weights| Foot { triangle, weights };
        if surface.shares(&middle([1.0, 0.0, 0.0])).is_none() {
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
            organ.spaces.iter().find(|space| space.node == node)
        };
        let (Some(one), Some(other)) = (space(*a), space(*b)) else { continue };
        let normal = vec3::normalize_or_zero(vec3::add(one.outward_normal, other.outward_normal));
        let length_m = vec3::distance(one.rest_position_m, other.rest_position_m);
        let reach_m = one.lattice.radius_m().min(other.lattice.radius_m());
        let step_m = reach_m / STEPS as f32;
        let (mut before, mut work_j) = ([0.0; 2], [0.0_f32; 2]);
        for step in 1..=STEPS {
            let d = vec3::scale(normal, -step_m * step as f32);
            let at = |space: &palpate_core::Space<'_>| space.force(method, d).map(|answer| answer.force_n);
            let (Some(here_n), Some(there_n)) = (at(one), at(other)) else { break };
            if vec3::norm(here_n).max(vec3::norm(there_n)) > organ.max_force_n {
                break;
            }
            report.seam_n = report.seam_n.max(seam_n(organ, surface, feet, method, d));
            let pressing = [here_n, there_n].map(|force_n| -vec3::dot(force_n, normal));
            for ((work, before), now) in work_j.iter_mut().zip(&mut before).zip(pressing) {
                *work += 0.5 * (*before + now) * step_m;
                *before = now;
            }
            let apart_j = (work_j[0] - work_j[1]).abs();
            let taken_j = friction * 0.5 * (pressing[0] + pressing[1]) * length_m;
            report.energy_j = report.energy_j.max(apart_j);
            report.friction_share = report.friction_share.max(apart_j / taken_j.max(f32::MIN_POSITIVE));
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
        for Share { space, weight } in surface.shares(foot)? {
            let force_n = organ.spaces.get(usize::from(space))?.force(method, d)?.force_n;
            sum = vec3::add(sum, vec3::scale(force_n, weight));
        }
        Some(sum)
    };
    let forces: Vec<Vec3> = feet.iter().filter_map(blended).collect();
    forces.windows(2).map(|pair| vec3::distance(pair[0], pair[1])).fold(0.0, f32::max)
}
