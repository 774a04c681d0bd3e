//! The surface of the organ at rest: which triangle a path enters, and where a point on the surface slides
//! to.
//!
//! An untouched body is at rest. Therefore the HIP enters it where its path since the last sample passes
//! through a triangle of the rest surface from outside. The triangles are found through a grid of cells over
//! the bounding box; a tick examines the few cells round one short path. All lists lie in memory of the
//! caller and are filled once, at the start.
//!
//! ```text
//! memory: cell_start | vertex_start | vertex_space | vertex_triangle | cell_triangle
//! ```

use super::cells::{Cells, corners, fill_lists, list};
use crate::blob::{Organ, Surface};
use crate::num::vec3::{self, Vec3};

/// Largest number of pieces into which a path is divided, each at most a cell long: enough for a path through
/// the whole box of [`super::cells::MAX_ALONG`] cells.
const MAX_PIECES: u32 = 64;
/// Largest number of triangles that one tick tests.
pub(super) const MAX_TESTS: usize = 2_048;
/// Largest number of triangles that a slide crosses in one tick.
const MAX_STEPS: usize = 8;
/// Largest number of triangles examined round a vertex.
const MAX_ROUND: usize = 64;
/// Tolerance of the barycentric weights: rounding must leave no gap between neighbouring triangles.
const GAP: f32 = 1e-3;
/// Marks a vertex that is not an active node.
const NO_SPACE: u32 = u32::MAX;

/// The weight of one active node in a contact.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct NodeWeight {
    /// Index of the space of the node.
    pub space: u16,
    /// 0 to 1; a space of weight 0 does not take part.
    pub weight: f32,
}

/// A point of the surface: a triangle and three barycentric weights, none negative, of sum 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Foot {
    /// Index of the triangle.
    pub triangle: u32,
    /// Weight of each of its corners.
    pub weights: Vec3,
}

/// Where a path enters the body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Crossing {
    /// The point of the path, model frame, metres.
    pub(super) at_m: Vec3,
    /// The same point of the surface.
    pub(super) foot: Foot,
}

/// The surface of an organ with the lists that contact needs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TouchSurface<'m> {
    surface: Surface<'m>,
    /// Whether it is that of the contact points, and not the body's skin.
    pub(crate) is_of_contacts: bool,
    cells: Cells,
    cell_start: &'m [u32],
    cell_triangle: &'m [u32],
    vertex_start: &'m [u32],
    vertex_triangle: &'m [u32],
    vertex_space: &'m [u32],
}

impl<'m> TouchSurface<'m> {
    /// Number of words of memory that [`TouchSurface::new`] needs; 0 for an organ without a surface.
    pub fn words<const N: usize>(organ: &Organ<'_, N>) -> usize {
        let surface = organ.met();
        let (vertices, triangles) = (surface.node.len(), surface.triangles.len());
        if triangles == 0 {
            return 0;
        }
        let (cells, entries) = Cells::over(&surface);
        let lists = [cells.total(), 1, vertices, 1, vertices, triangles.saturating_mul(3), entries];
        lists.into_iter().fold(0, usize::saturating_add)
    }

    /// Fills the lists. `None` if the organ has no surface, or if `memory` is shorter than
    /// [`TouchSurface::words`].
    ///
    /// For start-up: every triangle is visited a few times.
    pub fn new<const N: usize>(organ: &Organ<'m, N>, memory: &'m mut [u32]) -> Option<Self> {
        let surface = organ.met();
        let (triangles, vertices) = (surface.triangles, surface.node.len());
        if triangles.is_empty() {
            return None;
        }
        let (cells, entries) = Cells::over(&surface);
        let (cell_start, memory) = memory.split_at_mut_checked(cells.total().saturating_add(1))?;
        let (vertex_start, memory) = memory.split_at_mut_checked(vertices.saturating_add(1))?;
        let (vertex_space, memory) = memory.split_at_mut_checked(vertices)?;
        let (vertex_triangle, memory) = memory.split_at_mut_checked(triangles.len().saturating_mul(3))?;
        let (cell_triangle, _) = memory.split_at_mut_checked(entries)?;
        let cells_of = |triangle: &[u32; 3]| {
            corners(&surface, triangle).into_iter().flat_map(|corners| cells.touched(&corners))
        };
        fill_lists(triangles, cells_of, cell_start, cell_triangle);
        let vertices_of = |triangle: &[u32; 3]| triangle.map(|vertex| vertex as usize).into_iter();
        fill_lists(triangles, vertices_of, vertex_start, vertex_triangle);
        let is_of_contacts = !organ.contact.triangles.is_empty();
        for (space, node) in vertex_space.iter_mut().zip(surface.node) {
            if is_of_contacts {
                *space = *node;
                continue;
            }
            let found = (0_u32..).zip(&organ.spaces).find(|(_, space)| space.active.node == *node);
            *space = found.map_or(NO_SPACE, |(index, _)| index);
        }
        Some(Self {
            surface,
            is_of_contacts,
            cells,
            cell_start,
            cell_triangle,
            vertex_start,
            vertex_triangle,
            vertex_space,
        })
    }

    /// Where the path from one HIP to the next first enters the body, if it does.
    ///
    /// Cost: at most 2,048 triangles; usually one cell and ten triangles. A path longer than a cell is
    /// examined piece by piece, so that the surface is found after a gap in the samples too.
    pub(super) fn crossing(&self, from_m: Vec3, to_m: Vec3) -> Option<Crossing> {
        let path_m = vec3::sub(to_m, from_m);
        // The cast saturates and converts NaN to 0.
        let pieces =
            ((vec3::norm(path_m) * self.cells.cells_per_m()) as u32).saturating_add(1).min(MAX_PIECES);
        let fraction_of = |piece: u32| piece as f32 / pieces as f32;
        let (mut first, mut tests): (Option<(f32, Crossing)>, usize) = (None, MAX_TESTS);
        for piece in 0..pieces {
            let end = |piece| vec3::add(from_m, vec3::scale(path_m, fraction_of(piece)));
            let ends = [end(piece), end(piece + 1)];
            if self.cells.misses(&ends) {
                continue;
            }
            for &triangle in self.near(&ends).take(tests) {
                tests = tests.saturating_sub(1);
                // The whole path is tested, so that no triangle is missed between two pieces.
                let Some((fraction, crossing)) = self.enters(triangle, from_m, to_m) else { continue };
                if first.is_none_or(|(least, _)| fraction < least) {
                    first = Some((fraction, crossing));
                }
            }
            if first.is_some_and(|(fraction, _)| fraction <= fraction_of(piece + 1)) {
                break;
            }
        }
        first.map(|(_, crossing)| crossing)
    }

    /// Triangles in the cells that the box of some points touches.
    pub(super) fn near(&self, points_m: &[Vec3]) -> impl Iterator<Item = &'m u32> + use<'_, 'm> {
        self.cells.touched(points_m).flat_map(|cell| list(self.cell_start, self.cell_triangle, cell))
    }

    /// Whether a point is within a distance of the surface, on either side. Tests at most 2,048 triangles.
    pub(crate) fn is_within(&self, point_m: Vec3, distance_m: f32) -> bool {
        let corner = |sign: f32| point_m.map(|x| x + sign * distance_m);
        let close = |&triangle: &u32| {
            let nearest = self.corners(triangle).map(|corners| nearest_on_triangle(corners, point_m));
            nearest.is_some_and(|nearest_m| vec3::distance(nearest_m, point_m) <= distance_m)
        };
        self.near(&[corner(-1.0), corner(1.0)]).take(MAX_TESTS).any(close)
    }

    /// The point of the surface nearest to a point, if it is within a distance. Tests at most 2,048 triangles.
    pub(crate) fn nearest(&self, point_m: Vec3, distance_m: f32) -> Option<Foot> {
        let corner = |sign: f32| point_m.map(|x| x + sign * distance_m);
        let mut least: Option<(f32, Foot)> = None;
        for &triangle in self.near(&[corner(-1.0), corner(1.0)]).take(MAX_TESTS) {
            let Some(corners) = self.corners(triangle) else { continue };
            let nearest_m = nearest_on_triangle(corners, point_m);
            let away_m = vec3::distance(nearest_m, point_m);
            if away_m <= least.map_or(distance_m, |(least_m, _)| least_m) {
                let weights = normalized(barycentric(corners, area(corners), nearest_m));
                least = Some((away_m, Foot { triangle, weights }));
            }
        }
        least.map(|(_, foot)| foot)
    }

    /// The fraction of a path up to its entry through a triangle, and the point of entry.
    fn enters(&self, triangle: u32, from_m: Vec3, to_m: Vec3) -> Option<(f32, Crossing)> {
        let corners = self.corners(triangle)?;
        let ([a, ..], area) = (corners, area(corners));
        let (fraction, at_m) = entry([from_m, to_m], |point_m| vec3::dot(area, vec3::sub(point_m, a)))?;
        let weights = barycentric(corners, area, at_m);
        let inside = weights.iter().all(|weight| *weight >= -GAP);
        inside.then(|| (fraction, Crossing { at_m, foot: Foot { triangle, weights: normalized(weights) } }))
    }

    /// Whether a point of the surface follows fixed vertices more than others.
    pub(super) fn is_fixed(&self, foot: &Foot) -> bool {
        let vertices = self.surface.triangles.get(foot.triangle as usize).copied().unwrap_or_default();
        let is_held = |vertex: u32| self.surface.fixed.get(vertex as usize).is_some_and(|fixed| *fixed != 0);
        let held = vertices.into_iter().zip(foot.weights).filter(|(vertex, _)| is_held(*vertex));
        held.map(|(_, weight)| weight).fold(0.0, |sum, weight| sum + weight) > 0.5
    }

    /// Position of a foot, model frame, metres.
    pub(super) fn point(&self, foot: &Foot) -> Vec3 {
        self.corners(foot.triangle).map_or(vec3::ZERO, |corners| point(corners, foot.weights))
    }

    /// Outward unit normal of a triangle.
    pub(super) fn face_normal(&self, triangle: u32) -> Vec3 {
        self.corners(triangle).map_or(vec3::ZERO, |corners| vec3::normalize_or_zero(area(corners)))
    }

    /// The weights of the corners of a foot's triangle, if all three are active nodes.
    pub fn node_weights(&self, foot: &Foot) -> Option<[NodeWeight; 3]> {
        let ([a, b, c], [wa, wb, wc]) = (self.spaces(foot.triangle)?, foot.weights);
        Some([(a, wa), (b, wb), (c, wc)].map(|(space, weight)| NodeWeight { space, weight }))
    }

    /// The gradient along the surface of the weight of each corner of a triangle, per metre.
    ///
    /// Of corner a it is n x (c - b) / |n|^2 with n = (b - a) x (c - a).
    pub(super) fn weight_slopes(&self, triangle: u32) -> Option<[Vec3; 3]> {
        let corners = self.corners(triangle)?;
        let ([a, b, c], area) = (corners, area(corners));
        let per_m2 = vec3::norm_squared(area).max(f32::MIN_POSITIVE).recip();
        let slope = |from: Vec3, to: Vec3| vec3::scale(vec3::cross(area, vec3::sub(to, from)), per_m2);
        Some([slope(b, c), slope(c, a), slope(a, b)])
    }

    fn spaces(&self, triangle: u32) -> Option<[u16; 3]> {
        let space = |vertex: u32| -> Option<u16> {
            self.vertex_space.get(vertex as usize).and_then(|space| u16::try_from(*space).ok())
        };
        let [a, b, c] = *self.surface.triangles.get(triangle as usize)?;
        Some([space(a)?, space(b)?, space(c)?])
    }

    /// Moves a foot along the surface by the tangential part of a displacement.
    ///
    /// It stays on triangles whose corners are all active nodes. Where these end it slides along the edge,
    /// and the second value, "left the active region", is true.
    pub(super) fn slide(&self, foot: Foot, along_m: Vec3) -> (Foot, bool) {
        let (mut foot, mut left_m) = (foot, along_m);
        let (mut wall, mut left_active_region) = (None, false);
        for _ in 0..MAX_STEPS {
            let Some(corners) = self.corners(foot.triangle) else { break };
            let ([a, ..], area) = (corners, area(corners));
            let normal = vec3::normalize_or_zero(area);
            left_m = vec3::sub(left_m, vec3::scale(normal, vec3::dot(left_m, normal)));
            // The weights are affine in the point, so their change is linear in the displacement.
            let from = barycentric(corners, area, a);
            let mut change = vec3::sub(barycentric(corners, area, vec3::add(a, left_m)), from);
            if let Some(change) = wall.and_then(|wall: usize| change.get_mut(wall)) {
                *change = change.max(0.0);
            }
            let Some((exit, fraction)) = first_exit(foot.weights, change) else {
                foot.weights = normalized(vec3::add(foot.weights, change));
                break;
            };
            let mut weights = vec3::add(foot.weights, vec3::scale(change, fraction));
            if let Some(weight) = weights.get_mut(exit) {
                *weight = 0.0;
            }
            foot.weights = normalized(weights);
            left_m = vec3::scale(left_m, 1.0 - fraction);
            match self.neighbour(&foot, exit) {
                Some(next) => (foot, wall) = (next, None),
                None => {
                    let corner = |i: usize| corners.get(i % 3).copied().unwrap_or(a);
                    let edge = vec3::normalize_or_zero(vec3::sub(corner(exit + 2), corner(exit + 1)));
                    left_m = vec3::scale(edge, vec3::dot(edge, left_m));
                    wall = Some(exit);
                    left_active_region = true;
                }
            }
        }
        (foot, left_active_region)
    }

    /// A foot on the edge opposite to a corner, expressed in the triangle beyond that edge.
    fn neighbour(&self, foot: &Foot, corner: usize) -> Option<Foot> {
        let vertices = *self.surface.triangles.get(foot.triangle as usize)?;
        let at =
            |i: usize| -> Option<(u32, f32)> { Some((*vertices.get(i % 3)?, *foot.weights.get(i % 3)?)) };
        let ((one, weight_one), (other, weight_other)) = (at(corner + 1)?, at(corner + 2)?);
        let round = list(self.vertex_start, self.vertex_triangle, one as usize);
        let beyond = round.iter().take(MAX_ROUND).find(|&&triangle| {
            let corners = self.surface.triangles.get(triangle as usize);
            triangle != foot.triangle && corners.is_some_and(|corners| corners.contains(&other))
        });
        let triangle = *beyond?;
        self.spaces(triangle)?;
        let weights = self.surface.triangles.get(triangle as usize)?.map(|vertex| {
            if vertex == one {
                weight_one
            } else if vertex == other {
                weight_other
            } else {
                0.0
            }
        });
        Some(Foot { triangle, weights })
    }

    pub(super) fn corners(&self, triangle: u32) -> Option<[Vec3; 3]> {
        corners(&self.surface, self.surface.triangles.get(triangle as usize)?)
    }
}

/// Where a path first has no height above a plane, if it starts above it: the fraction of the path, and the
/// point.
pub(super) fn entry([from_m, to_m]: [Vec3; 2], height: impl Fn(Vec3) -> f32) -> Option<(f32, Vec3)> {
    let (before, now) = (height(from_m), height(to_m));
    if !(before > 0.0 && now <= 0.0) {
        return None;
    }
    // before > 0 >= now, so the quotient is in (0, 1]; min limits its rounding.
    let fraction = (before / (before - now)).min(1.0);
    let travel = vec3::scale(vec3::sub(to_m, from_m), fraction);
    // On the plane itself the sample is the crossing: rounding must not make d differ from 0.
    Some((fraction, if now == 0.0 { to_m } else { vec3::add(from_m, travel) }))
}

/// Twice the area of a triangle times its normal.
fn area([a, b, c]: [Vec3; 3]) -> Vec3 {
    vec3::cross(vec3::sub(b, a), vec3::sub(c, a))
}

/// The point of a triangle with these weights of its corners.
fn point([a, b, c]: [Vec3; 3], [wa, wb, wc]: Vec3) -> Vec3 {
    vec3::add(vec3::scale(a, wa), vec3::add(vec3::scale(b, wb), vec3::scale(c, wc)))
}

/// Weights of the corners at a point of their plane; `area` is that of [`area()`].
fn barycentric([a, b, c]: [Vec3; 3], area: Vec3, at: Vec3) -> Vec3 {
    let opposite = |p: Vec3, q: Vec3| vec3::dot(area, vec3::cross(vec3::sub(q, p), vec3::sub(at, p)));
    let weights = [opposite(b, c), opposite(c, a), opposite(a, b)];
    vec3::scale(weights, vec3::norm_squared(area).max(f32::MIN_POSITIVE).recip())
}

/// The point of a triangle nearest to a point: its projection, or the nearest point of the edges.
pub fn nearest_on_triangle(corners: [Vec3; 3], point_m: Vec3) -> Vec3 {
    let weights = barycentric(corners, area(corners), point_m);
    if weights.iter().all(|weight| *weight >= 0.0) {
        return point(corners, weights);
    }
    let [a, b, c] = corners;
    let mut nearest = (f32::INFINITY, a);
    for (p, q) in [(a, b), (b, c), (c, a)] {
        let edge = vec3::sub(q, p);
        let length_squared = vec3::norm_squared(edge).max(f32::MIN_POSITIVE);
        let along = (vec3::dot(vec3::sub(point_m, p), edge) / length_squared).clamp(0.0, 1.0);
        let on_edge = vec3::add(p, vec3::scale(edge, along));
        let distance_m = vec3::distance(on_edge, point_m);
        if distance_m < nearest.0 {
            nearest = (distance_m, on_edge);
        }
    }
    nearest.1
}

/// Weights with negative ones set to 0 and sum 1.
fn normalized(weights: Vec3) -> Vec3 {
    let [a, b, c] = weights.map(|weight| weight.max(0.0));
    let sum = a + b + c;
    // If a weight is NaN the comparison fails, and the first corner is used.
    if sum > 0.0 { [a / sum, b / sum, c / sum] } else { [1.0, 0.0, 0.0] }
}

/// The weight that reaches 0 first as the weights change, and the fraction of the change at which it does.
fn first_exit(weights: Vec3, change: Vec3) -> Option<(usize, f32)> {
    let mut first = None;
    for (corner, (weight, change)) in weights.into_iter().zip(change).enumerate() {
        let fraction = if change < 0.0 { (weight / -change).max(0.0) } else { f32::INFINITY };
        if fraction < 1.0 && first.is_none_or(|(_, least)| fraction < least) {
            first = Some((corner, fraction));
        }
    }
    first
}
