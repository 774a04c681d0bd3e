//! Batches of elements for SIMD: grouping, and gathering of their data into lanes.

use std::ops::Range;

use crate::fem::body::{ABSENT, Body, Element};
use crate::fem::element::Point;
use crate::fem::material::Material;
use crate::num::lanes::Real;
use crate::num::tensor::Vec3;

/// Consecutive elements of one region, at most one per lane.
///
/// Lanes past the last element repeat it; their results are ignored.
pub(super) struct Batch {
    pub(super) first: usize,
    pub(super) count: usize,
}

impl Batch {
    /// A batch of one element.
    pub(super) fn single(element: usize) -> Self {
        Self { first: element, count: 1 }
    }

    /// Batches of the elements of a range, in their order.
    #[inline(always)]
    pub(super) fn all<R: Real>(body: &Body, range: Range<usize>) -> impl Iterator<Item = Self> {
        let elements = &body.elements[..range.end];
        let mut next = range.start;
        std::iter::from_fn(
            #[inline(always)]
            move || {
                let first = next;
                let region = elements.get(first)?.region;
                let end = elements.len().min(first + R::LANES);
                next += 1;
                while next < end && elements[next].region == region {
                    next += 1;
                }
                Some(Self { first, count: next - first })
            },
        )
    }

    #[inline(always)]
    fn index(&self, lane: usize) -> usize {
        self.first + lane.min(self.count - 1)
    }

    #[inline(always)]
    pub(super) fn element<'a>(&self, body: &'a Body, lane: usize) -> &'a Element {
        &body.elements[self.index(lane)]
    }

    /// The law of all elements of the batch.
    #[inline(always)]
    pub(super) fn material<'a>(&self, body: &'a Body) -> &'a Material {
        &body.regions[usize::from(body.elements[self.first].region)].material
    }

    /// Whether the law has a pressure.
    #[inline(always)]
    pub(super) fn has_pressure(&self, body: &Body) -> bool {
        body.elements[self.first].pressures[0] != ABSENT
    }

    /// Volumes and gradients of the barycentric coordinates.
    #[inline(always)]
    pub(super) fn geometry<R: Real>(&self, machine: R::Machine, body: &Body) -> (R, [Vec3<R>; 4]) {
        let volume = R::new(machine, |lane| self.element(body, lane).tet.volume_m3);
        let mut gradients = [Vec3([volume; 3]); 4];
        for (k, gradient) in gradients.iter_mut().enumerate() {
            for (axis, value) in gradient.0.iter_mut().enumerate() {
                *value = R::new(machine, |lane| self.element(body, lane).tet.gradients[k][axis]);
            }
        }
        (volume, gradients)
    }
}

/// Values of a state at the nodes of each element of a batch.
pub(super) struct LocalState<R, const N: usize> {
    pub(super) displacements: [Vec3<R>; N],
    pub(super) pressures: [R; 4],
}

impl<R: Real, const N: usize> LocalState<R, N> {
    #[inline(always)]
    pub(super) fn gather(machine: R::Machine, body: &Body, batch: &Batch, state: &[f64]) -> Self {
        let zero = R::new(machine, |_| 0.0);
        let stride = body.order.nodes();
        let mut displacements = [Vec3([zero; 3]); N];
        for (a, displacement) in displacements.iter_mut().enumerate() {
            for (axis, value) in displacement.0.iter_mut().enumerate() {
                *value = R::new(machine, |lane| {
                    let node = body.connectivity[stride * batch.index(lane) + a];
                    state[3 * node as usize + axis]
                });
            }
        }
        let mut pressures = [zero; 4];
        if batch.has_pressure(body) {
            let pressure_state = &state[body.displacement_len()..];
            for (v, pressure) in pressures.iter_mut().enumerate() {
                *pressure =
                    R::new(machine, |lane| pressure_state[batch.element(body, lane).pressures[v] as usize]);
            }
        }
        Self { displacements, pressures }
    }

    #[inline(always)]
    pub(super) fn pressure_at(&self, point: &Point<N>) -> R {
        let ([a, b, c, d], [s, t, u, v]) = (self.pressures, point.barycentric);
        a * s + b * t + c * u + d * v
    }
}
