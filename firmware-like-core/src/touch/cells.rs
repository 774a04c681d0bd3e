//! Equal cells over the bounding box of a surface, and lists of triangles by cell or by vertex.

use crate::blob::Surface;
use crate::num::vec3::Vec3;

/// Largest number of cells along the longest side.
pub(super) const MAX_ALONG: u32 = 32;

/// Largest mean number of cells per triangle; a surface whose triangles span more gets coarser cells.
const MAX_CELLS_PER_TRIANGLE: usize = 64;

/// Cells of equal size over the bounding box of the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Cells {
    low_m: Vec3,
    cells_per_m: f32,
    count: [u32; 3],
}

impl Cells {
    /// About as many cells as triangles; the surface passes through a few hundred of them. Returned with the
    /// number of entries of their lists.
    pub(super) fn over(surface: &Surface<'_>) -> (Self, usize) {
        let bounds = surface.position_m.map(|plane| bounds(plane.iter().copied()));
        let longest_m = bounds.iter().fold(0.0_f32, |most, (low, high)| most.max(high - low));
        let triangles = surface.triangles.len();
        let is_enough = |along: &u32| (*along as usize).pow(3) >= triangles;
        let mut along = (1..MAX_ALONG).find(is_enough).unwrap_or(MAX_ALONG);
        loop {
            let cells_per_m = if longest_m > 0.0 { along as f32 / longest_m } else { 0.0 };
            let count = bounds.map(|(low, high)| (((high - low) * cells_per_m) as u32 + 1).min(along));
            let cells = Self { low_m: bounds.map(|(low, _)| low), cells_per_m, count };
            let entries = cells.entries(surface);
            if along == 1 || entries <= triangles.saturating_mul(MAX_CELLS_PER_TRIANGLE) {
                return (cells, entries);
            }
            along /= 2;
        }
    }

    /// Sum over the triangles of the number of cells that their boxes touch.
    fn entries(&self, surface: &Surface<'_>) -> usize {
        let corners = surface.triangles.iter().filter_map(|triangle| corners(surface, triangle));
        let touched = corners.map(|corners| {
            let along = self.range(&corners).map(|(first, last)| (last - first) as usize + 1);
            along.iter().product::<usize>()
        });
        touched.fold(0, usize::saturating_add)
    }

    pub(super) const fn cells_per_m(&self) -> f32 {
        self.cells_per_m
    }

    pub(super) fn total(&self) -> usize {
        self.count.iter().map(|count| *count as usize).product()
    }

    /// First and last cell along each axis that the box of some points touches.
    fn range(&self, points: &[Vec3]) -> [(u32, u32); 3] {
        let along = |(least, most): (f32, f32), low: f32, count: u32| {
            // The cast saturates: points outside the box belong to its outermost cells.
            let cell = |x: f32| (((x - low) * self.cells_per_m) as u32).min(count.saturating_sub(1));
            (cell(least), cell(most))
        };
        let ([x, y, z], [low_x, low_y, low_z], [nx, ny, nz]) = (box_of(points), self.low_m, self.count);
        [along(x, low_x, nx), along(y, low_y, ny), along(z, low_z, nz)]
    }

    /// Whether the box of some points lies wholly outside the cells.
    pub(super) fn misses(&self, points: &[Vec3]) -> bool {
        let axes = box_of(points).into_iter().zip(self.low_m).zip(self.count);
        let outside = |(((least, most), low), count): (((f32, f32), f32), u32)| {
            most < low || (least - low) * self.cells_per_m > count as f32
        };
        axes.into_iter().any(outside)
    }

    /// Indices of the cells that the box of some points touches.
    pub(super) fn touched(&self, points: &[Vec3]) -> impl Iterator<Item = usize> + use<> {
        let ([x, y, z], [_, ny, nz]) = (self.range(points), self.count);
        (x.0..=x.1).flat_map(move |i| {
            (y.0..=y.1).flat_map(move |j| {
                let row = i.wrapping_mul(ny).wrapping_add(j).wrapping_mul(nz);
                (z.0..=z.1).map(move |k| row.wrapping_add(k) as usize)
            })
        })
    }
}

/// Least and largest of some numbers.
fn bounds(numbers: impl Iterator<Item = f32>) -> (f32, f32) {
    numbers.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)))
}

/// Bounds of some points along each axis.
fn box_of(points: &[Vec3]) -> [(f32, f32); 3] {
    [
        bounds(points.iter().map(|[x, ..]| *x)),
        bounds(points.iter().map(|[_, y, _]| *y)),
        bounds(points.iter().map(|[.., z]| *z)),
    ]
}

/// Positions of the corners of a triangle.
pub(super) fn corners(surface: &Surface<'_>, [a, b, c]: &[u32; 3]) -> Option<[Vec3; 3]> {
    let [x, y, z] = surface.position_m;
    let at = |vertex: u32| -> Option<Vec3> {
        let vertex = vertex as usize;
        Some([*x.get(vertex)?, *y.get(vertex)?, *z.get(vertex)?])
    };
    Some([at(*a)?, at(*b)?, at(*c)?])
}

/// Fills lists of the triangles at each of `start.len() - 1` places. List i is `items[start[i]..start[i +
/// 1]]`.
pub(super) fn fill_lists<I: Iterator<Item = usize>>(
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
    // Filling from the back turns the ends into starts and leaves each list ascending.
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

/// The list of one place.
pub(super) fn list<'l>(start: &[u32], items: &'l [u32], place: usize) -> &'l [u32] {
    let bound = |i: usize| start.get(i).map(|bound| *bound as usize);
    let (Some(from), Some(to)) = (bound(place), bound(place + 1)) else { return &[] };
    items.get(from..to).unwrap_or(&[])
}
