//! The organ's surface at rest as contact needs it: which triangle a motion goes through, and where a foot on it slides to.
//!
//! A free body is at rest, so the HIP enters it where its way since the last sample goes through a triangle of the rest surface from
//! outside. The triangles are found in a grid of cells over the bounding box; a tick looks at the few cells round one short way.
//! All lists are in memory of the caller, filled once at the start: nothing here grows.
//!
//! ```text
//! memory: cell_start | cell_triangle | vertex_start | vertex_triangle | vertex_space
//! ```

use crate::blob::{Organ, Surface};
use crate::vec3::{self, Vec3};

/// Pieces of at most a cell's length that a way is looked at in, at most: more than go through the whole box of [`MOST_ALONG`] cells.
const MOST_PIECES: u32 = 64;
/// Triangles one tick tests, at most.
const MOST_TESTS: usize = 2_048;
/// Triangles a slide goes over in one tick, at most.
const MOST_STEPS: usize = 8;
/// Triangles round a vertex that are looked at, at most.
const MOST_ROUND: usize = 64;
/// Cells along the longest side, at most.
const MOST_ALONG: u32 = 32;
/// A way that passes a triangle by this share of its size still meets it: no slit between neighbours through rounding.
const SLIT: f32 = 1e-3;
/// The vertex is no active node.
const NO_SPACE: u32 = u32::MAX;

/// How much of a touch is the business of one space.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Share {
    /// Index of the space.
    pub space: u16,
    /// 0 to 1; a share of 0 is none.
    pub weight: f32,
}

/// A point of the surface: a triangle and its three barycentric weights, none below 0, of sum 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Foot {
    /// Index of the triangle.
    pub triangle: u32,
    /// Weight of each of its corners.
    pub weights: Vec3,
}

/// Where a way enters the body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Crossing {
    /// The point, model frame, metres: on the way.
    pub at_m: Vec3,
    /// The same point of the surface.
    pub foot: Foot,
}

/// Cells of equal size over the bounding box of the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Cells {
    low_m: Vec3,
    cells_per_m: f32,
    count: [u32; 3],
}

impl Cells {
    /// About as many as there are triangles, of which the surface then goes through a few hundred.
    fn over(surface: &Surface<'_>) -> Self {
        let bounds = surface.position_m.map(|plane| {
            plane.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), &x| (low.min(x), high.max(x)))
        });
        let longest_m = bounds.iter().fold(0.0_f32, |most, (low, high)| most.max(high - low));
        let enough = |along: &u32| (*along as usize).pow(3) >= surface.triangles.len();
        let along = (1..MOST_ALONG).find(enough).unwrap_or(MOST_ALONG);
        let cells_per_m = if longest_m > 0.0 { along as f32 / longest_m } else { 0.0 };
        let count = bounds.map(|(low, high)| (((high - low) * cells_per_m) as u32 + 1).min(along));
        Self { low_m: bounds.map(|(low, _)| low), cells_per_m, count }
    }

    fn total(&self) -> usize {
        self.count.iter().map(|count| *count as usize).product()
    }

    /// First and last cell along each axis that the box of some points touches.
    fn range(&self, points: &[Vec3]) -> [(u32, u32); 3] {
        let along = |axis: usize| {
            let at = |v: &Vec3| v.get(axis).copied().unwrap_or(0.0);
            let (low, last) = (at(&self.low_m), self.count.get(axis).map_or(0, |count| count - 1));
            // The cast saturates: what is outside the box counts to its outermost cells.
            let cell = |x: f32| (((x - low) * self.cells_per_m) as u32).min(last);
            let least = points.iter().map(at).fold(f32::INFINITY, f32::min);
            let most = points.iter().map(at).fold(f32::NEG_INFINITY, f32::max);
            (cell(least), cell(most))
        };
        [along(0), along(1), along(2)]
    }

    /// Whether the box of some points is wholly beside the cells.
    fn misses(&self, points: &[Vec3]) -> bool {
        [0, 1, 2].into_iter().any(|axis: usize| {
            let at = |v: &Vec3| v.get(axis).copied().unwrap_or(0.0);
            let cells = self.count.get(axis).map_or(0.0, |count| *count as f32);
            let above = |p: &Vec3| (at(p) - at(&self.low_m)) * self.cells_per_m > cells;
            points.iter().all(|p| at(p) < at(&self.low_m)) || points.iter().all(above)
        })
    }

    /// Indices of the cells of a range.
    fn of(&self, [x, y, z]: [(u32, u32); 3]) -> impl Iterator<Item = usize> + use<> {
        let [_, ny, nz] = self.count;
        (x.0..=x.1).flat_map(move |i| {
            (y.0..=y.1).flat_map(move |j| {
                let row = i.wrapping_mul(ny).wrapping_add(j).wrapping_mul(nz);
                (z.0..=z.1).map(move |k| row.wrapping_add(k) as usize)
            })
        })
    }
}

/// The surface of an organ, ready to be touched.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TouchSurface<'m> {
    surface: Surface<'m>,
    cells: Cells,
    cell_start: &'m [u32],
    cell_triangle: &'m [u32],
    vertex_start: &'m [u32],
    vertex_triangle: &'m [u32],
    vertex_space: &'m [u32],
}

impl<'m> TouchSurface<'m> {
    /// Words of memory that the surface of an organ needs; 0 for an organ that was packed without a surface.
    pub fn words<const N: usize>(organ: &Organ<'_, N>) -> usize {
        let surface = &organ.surface;
        if surface.triangles.is_empty() {
            return 0;
        }
        let cells = Cells::over(surface);
        let entries: usize = (surface.triangles.iter())
            .filter_map(|triangle| corners(surface, triangle))
            .map(|corners| cells.of(cells.range(&corners)).count())
            .sum();
        cells.total() + 1 + entries + 2 * surface.node.len() + 1 + 3 * surface.triangles.len()
    }

    /// Fills the lists. `None` if the organ has no surface, or the memory is shorter than [`TouchSurface::words`].
    ///
    /// For start-up: every triangle is looked at a few times.
    pub fn new<const N: usize>(organ: &Organ<'m, N>, memory: &'m mut [u32]) -> Option<Self> {
        let surface = organ.surface;
        let vertices = surface.node.len();
        if surface.triangles.is_empty() || memory.len() < Self::words(organ) {
            return None;
        }
        let cells = Cells::over(&surface);
        let triangles = surface.triangles;
        let cells_of = |triangle: &[u32; 3]| {
            let corners = corners(&surface, triangle);
            corners.into_iter().flat_map(|corners| cells.of(cells.range(&corners)))
        };
        let (cell_start, memory) = memory.split_at_mut_checked(cells.total() + 1)?;
        let (vertex_start, memory) = memory.split_at_mut_checked(vertices + 1)?;
        let (vertex_space, memory) = memory.split_at_mut_checked(vertices)?;
        let (vertex_triangle, memory) = memory.split_at_mut_checked(3 * triangles.len())?;
        lists(triangles, cells_of, cell_start, memory);
        lists(triangles, |triangle| triangle.map(|v| v as usize).into_iter(), vertex_start, vertex_triangle);
        for (space, node) in vertex_space.iter_mut().zip(surface.node) {
            let found = (0_u32..).zip(&organ.spaces).find(|(_, space)| space.node == *node);
            *space = found.map_or(NO_SPACE, |(index, _)| index);
        }
        Some(Self {
            surface,
            cells,
            cell_start,
            cell_triangle: memory,
            vertex_start,
            vertex_triangle,
            vertex_space,
        })
    }

    /// Where the way from one HIP to the next enters the body first, if it does.
    ///
    /// Bounded: at most 2,048 triangles; of a hand's way usually one cell and ten triangles. A way that is longer than a cell is looked at
    /// piece by piece, so that a jump after a gap finds the surface too.
    pub fn crossing(&self, from_m: Vec3, to_m: Vec3) -> Option<Crossing> {
        let way_m = vec3::sub(to_m, from_m);
        // The cast saturates, and takes what is no number to 0.
        let pieces = ((vec3::norm(way_m) * self.cells.cells_per_m) as u32).saturating_add(1).min(MOST_PIECES);
        let share_of = |piece: u32| piece as f32 / pieces as f32;
        let (mut first, mut tests): (Option<(f32, Crossing)>, usize) = (None, MOST_TESTS);
        for piece in 0..pieces {
            let end = |piece| vec3::add(from_m, vec3::scale(way_m, share_of(piece)));
            let ends = [end(piece), end(piece + 1)];
            if self.cells.misses(&ends) {
                continue;
            }
            for &triangle in self.near(&ends).take(tests) {
                tests = tests.saturating_sub(1);
                // Of the whole way, so that none slips through between two pieces.
                let Some((share, crossing)) = self.enters(triangle, from_m, to_m) else { continue };
                if first.is_none_or(|(least, _)| share < least) {
                    first = Some((share, crossing));
                }
            }
            if first.is_some_and(|(share, _)| share <= share_of(piece + 1)) {
                break;
            }
        }
        first.map(|(_, crossing)| crossing)
    }

    /// Triangles in the cells of a box round some points.
    fn near(&self, points_m: &[Vec3]) -> impl Iterator<Item = &'m u32> + use<'_, 'm> {
        let cells = self.cells.of(self.cells.range(points_m));
        cells.flat_map(|cell| list(self.cell_start, self.cell_triangle, cell))
    }

    /// Whether a point is within a distance of the surface, on either side. Bounded: at most 2,048 triangles.
    pub fn is_within(&self, point_m: Vec3, distance_m: f32) -> bool {
        let corner = |sign: f32| point_m.map(|x| x + sign * distance_m);
        let close = |&triangle: &u32| {
            let nearest = self.corners(triangle).map(|corners| nearest_on(corners, point_m));
            nearest.is_some_and(|nearest_m| vec3::distance(nearest_m, point_m) <= distance_m)
        };
        self.near(&[corner(-1.0), corner(1.0)]).take(MOST_TESTS).any(close)
    }

    /// Share of the way before it goes through a triangle from outside.
    fn enters(&self, triangle: u32, from_m: Vec3, to_m: Vec3) -> Option<(f32, Crossing)> {
        let [a, b, c] = self.corners(triangle)?;
        let area = vec3::cross(vec3::sub(b, a), vec3::sub(c, a));
        let (before, now) = (vec3::dot(area, vec3::sub(from_m, a)), vec3::dot(area, vec3::sub(to_m, a)));
        if !(before > 0.0 && now <= 0.0) {
            return None;
        }
        // before > 0 >= now, so the quotient is in (0, 1]; min guards its rounding.
        let share = (before / (before - now)).min(1.0);
        // On the triangle itself the sample is the crossing; rounding must not give d a last digit.
        let travel = vec3::scale(vec3::sub(to_m, from_m), share);
        let at_m = if now == 0.0 { to_m } else { vec3::add(from_m, travel) };
        let weights = barycentric([a, b, c], area, at_m);
        let inside = weights.iter().all(|weight| *weight >= -SLIT);
        inside.then(|| (share, Crossing { at_m, foot: Foot { triangle, weights: normalized(weights) } }))
    }

    /// A point of the surface, model frame, metres.
    pub fn point(&self, foot: &Foot) -> Vec3 {
        let Some([a, b, c]) = self.corners(foot.triangle) else { return vec3::ZERO };
        let [wa, wb, wc] = foot.weights;
        vec3::add(vec3::scale(a, wa), vec3::add(vec3::scale(b, wb), vec3::scale(c, wc)))
    }

    /// Outward unit normal of a triangle.
    pub fn face_normal(&self, triangle: u32) -> Vec3 {
        let corners = self.corners(triangle);
        corners.map_or(vec3::ZERO, |[a, b, c]| {
            vec3::normalize_or_zero(vec3::cross(vec3::sub(b, a), vec3::sub(c, a)))
        })
    }

    /// The spaces of a triangle's corners with their weights, if all three are active nodes.
    pub fn shares(&self, foot: &Foot) -> Option<[Share; 3]> {
        let spaces = self.spaces(foot.triangle)?;
        let mut shares = [Share::default(); 3];
        for ((share, space), weight) in shares.iter_mut().zip(spaces).zip(foot.weights) {
            *share = Share { space, weight };
        }
        Some(shares)
    }

    fn spaces(&self, triangle: u32) -> Option<[u16; 3]> {
        let space = |vertex: u32| -> Option<u16> {
            self.vertex_space.get(vertex as usize).and_then(|space| u16::try_from(*space).ok())
        };
        let [a, b, c] = *self.surface.triangles.get(triangle as usize)?;
        Some([space(a)?, space(b)?, space(c)?])
    }

    /// Moves a foot along the surface by the tangential part of a way. It stays on triangles whose corners are all active nodes: where
    /// those end, it goes along the edge, and true says that it was stopped there.
    pub fn slide(&self, foot: Foot, along_m: Vec3) -> (Foot, bool) {
        let (mut foot, mut left_m) = (foot, along_m);
        let (mut wall, mut is_stopped) = (None, false);
        for _ in 0..MOST_STEPS {
            let Some(corners) = self.corners(foot.triangle) else { break };
            let [a, b, c] = corners;
            let area = vec3::cross(vec3::sub(b, a), vec3::sub(c, a));
            let normal = vec3::normalize_or_zero(area);
            left_m = vec3::sub(left_m, vec3::scale(normal, vec3::dot(left_m, normal)));
            // Weights are affine in the point, so their change is linear in the way.
            let from = barycentric(corners, area, a);
            let mut change = vec3::sub(barycentric(corners, area, vec3::add(a, left_m)), from);
            if let Some(change) = wall.and_then(|wall: usize| change.get_mut(wall)) {
                *change = change.max(0.0);
            }
            let Some((exit, share)) = first_exit(foot.weights, change) else {
                foot.weights = normalized(vec3::add(foot.weights, change));
                break;
            };
            let mut weights = vec3::add(foot.weights, vec3::scale(change, share));
            if let Some(weight) = weights.get_mut(exit) {
                *weight = 0.0;
            }
            foot.weights = normalized(weights);
            left_m = vec3::scale(left_m, 1.0 - share);
            match self.neighbour(&foot, exit) {
                Some(next) => (foot, wall) = (next, None),
                None => {
                    let corner = |i: usize| corners.get(i % 3).copied().unwrap_or(a);
                    let edge = vec3::normalize_or_zero(vec3::sub(corner(exit + 2), corner(exit + 1)));
                    left_m = vec3::scale(edge, vec3::dot(edge, left_m));
                    wall = Some(exit);
                    is_stopped = true;
                }
            }
        }
        (foot, is_stopped)
    }

    /// The same point, on the edge opposite to a corner, as one of the triangle beyond it.
    fn neighbour(&self, foot: &Foot, corner: usize) -> Option<Foot> {
        let vertices = *self.surface.triangles.get(foot.triangle as usize)?;
        let at =
            |i: usize| -> Option<(u32, f32)> { Some((*vertices.get(i % 3)?, *foot.weights.get(i % 3)?)) };
        let ((one, weight_one), (other, weight_other)) = (at(corner + 1)?, at(corner + 2)?);
        let round = list(self.vertex_start, self.vertex_triangle, one as usize);
        let beyond = round.iter().take(MOST_ROUND).find(|&&triangle| {
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

    fn corners(&self, triangle: u32) -> Option<[Vec3; 3]> {
        corners(&self.surface, self.surface.triangles.get(triangle as usize)?)
    }
}

fn corners(surface: &Surface<'_>, [a, b, c]: &[u32; 3]) -> Option<[Vec3; 3]> {
    let [x, y, z] = surface.position_m;
    let at = |vertex: u32| -> Option<Vec3> {
        let vertex = vertex as usize;
        Some([*x.get(vertex)?, *y.get(vertex)?, *z.get(vertex)?])
    };
    Some([at(*a)?, at(*b)?, at(*c)?])
}

/// Weights of the corners at a point of their plane; `area` is twice the area times the normal.
fn barycentric([a, b, c]: [Vec3; 3], area: Vec3, at: Vec3) -> Vec3 {
    let opposite = |p: Vec3, q: Vec3| vec3::dot(area, vec3::cross(vec3::sub(q, p), vec3::sub(at, p)));
    let weights = [opposite(b, c), opposite(c, a), opposite(a, b)];
    vec3::scale(weights, vec3::norm_squared(area).max(f32::MIN_POSITIVE).recip())
}

/// The point of a triangle that is nearest to a point: in its plane, or on the nearest of its edges.
fn nearest_on([a, b, c]: [Vec3; 3], point_m: Vec3) -> Vec3 {
    let area = vec3::cross(vec3::sub(b, a), vec3::sub(c, a));
    let weights = barycentric([a, b, c], area, point_m);
    if weights.iter().all(|weight| *weight >= 0.0) {
        let [wa, wb, wc] = weights;
        return vec3::add(vec3::scale(a, wa), vec3::add(vec3::scale(b, wb), vec3::scale(c, wc)));
    }
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

/// None below 0, sum 1.
fn normalized(weights: Vec3) -> Vec3 {
    let [a, b, c] = weights.map(|weight| weight.max(0.0));
    let sum = a + b + c;
    // NaN too: the first corner is as good as any.
    if sum > 0.0 { [a / sum, b / sum, c / sum] } else { [1.0, 0.0, 0.0] }
}

/// The weight that reaches 0 first as they change, and the share of the change until then.
fn first_exit(weights: Vec3, change: Vec3) -> Option<(usize, f32)> {
    let mut first = None;
    for (corner, (weight, change)) in weights.into_iter().zip(change).enumerate() {
        let share = if change < 0.0 { (weight / -change).max(0.0) } else { f32::INFINITY };
        if share < 1.0 && first.is_none_or(|(_, least)| share < least) {
            first = Some((corner, share));
        }
    }
    first
}

/// Lists of the triangles that belong to each of `start.len() - 1` places: list i is `items[start[i]..start[i + 1]]`.
fn lists<I: Iterator<Item = usize>>(
    triangles: &[[u32; 3]],
    places: impl Fn(&[u32; 3]) -> I,
    start: &mut [u32],
    items: &mut [u32],
) {
    start.fill(0);
    for place in triangles.iter().flat_map(&places) {
        if let Some(count) = start.get_mut(place) {
            *count = count.wrapping_add(1);
        }
    }
    let mut sum = 0_u32;
    for end in start.iter_mut() {
        sum = sum.wrapping_add(*end);
        *end = sum;
    }
    // Filling from the back turns the ends into starts, and leaves each list ascending.
    for (index, triangle) in triangles.iter().enumerate().rev() {
        for place in places(triangle) {
            let Some(next) = start.get_mut(place) else { continue };
            *next = next.wrapping_sub(1);
            if let Some(item) = items.get_mut(*next as usize) {
                *item = index as u32;
            }
        }
    }
}

fn list<'l>(start: &[u32], items: &'l [u32], place: usize) -> &'l [u32] {
    let bound = |i: usize| start.get(i).map(|bound| *bound as usize);
    let (Some(from), Some(to)) = (bound(place), bound(place + 1)) else { return &[] };
    items.get(from..to).unwrap_or(&[])
}
