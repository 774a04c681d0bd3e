//! Ambient occlusion from the depth buffer: it darkens creases, dents and the base of markers.

use super::raster::Raster;
use glam::Vec3;

/// Sampling directions in the picture.
const DIRECTIONS: [[f32; 2]; 8] = [
    [1.0, 0.0],
    [0.707, 0.707],
    [0.0, 1.0],
    [-0.707, 0.707],
    [-1.0, 0.0],
    [-0.707, -0.707],
    [0.0, -1.0],
    [0.707, -0.707],
];
/// Sampling distances along every direction, as fractions of the radius.
const STEPS: [f32; 3] = [0.25, 0.6, 1.0];
/// Radius as a share of the distance from the eye.
const RADIUS: f32 = 0.03;
/// Pixels between the samples of the coarse grid.
const COARSE: usize = 4;
/// Strongest darkening.
const STRENGTH: f32 = 0.75;

/// Occlusion of every pixel, 0 open to 255 occluded, at the size of the picture; `buffer` is reused.
///
/// For each direction, the sine of the horizon angle above the tangent plane at the sample; averaged over the
/// directions. It is computed at every fourth pixel and interpolated where the depth is continuous: the term
/// is smooth, and a dense evaluation costs more than all other shading.
pub(super) fn ambient(raster: &Raster, mut buffer: Vec<u8>) -> Vec<u8> {
    let factor = raster.factor();
    let (width, height) = (raster.sample_width() / factor, raster.sample_height() / factor);
    buffer.clear();
    buffer.resize(width * height, 0);
    let drawn = raster.drawn();
    let grid = Grid {
        left: drawn.left / factor / COARSE,
        top: drawn.top / factor / COARSE,
        columns: drawn.right.div_ceil(factor).div_ceil(COARSE) + 1 - drawn.left / factor / COARSE,
        rows: drawn.bottom.div_ceil(factor).div_ceil(COARSE) + 1 - drawn.top / factor / COARSE,
    };
    let knots = occlusion_at_knots(raster, &grid);
    for (row, pair) in
        knots.chunks_exact(grid.columns).zip(knots.chunks_exact(grid.columns).skip(1)).enumerate()
    {
        for (column, (above, below)) in pair.0.windows(2).zip(pair.1.windows(2)).enumerate() {
            let corners = [above[0], above[1], below[0], below[1]];
            let (x, y) = ((grid.left + column) * COARSE, (grid.top + row) * COARSE);
            fill_cell(raster, &corners, (x, y), (width.min(x + COARSE), height.min(y + COARSE)), &mut buffer);
        }
    }
    buffer
}

/// Part of the picture that contains drawn samples, in coarse cells.
struct Grid {
    left: usize,
    top: usize,
    columns: usize,
    rows: usize,
}

/// Sample of the coarse grid.
#[derive(Debug, Clone, Copy, Default)]
struct Knot {
    /// 1/m; 0 on the background.
    inverse_depth: f32,
    /// 0 open to 1 occluded.
    closed: f32,
}

/// Interpolates the pixels of one coarse cell.
fn fill_cell(
    raster: &Raster,
    knots: &[Knot; 4],
    (left, top): (usize, usize),
    (right, bottom): (usize, usize),
    buffer: &mut [u8],
) {
    let width = raster.sample_width() / raster.factor();
    let nearest = knots.iter().map(|knot| knot.inverse_depth).fold(0.0, f32::max);
    let furthest = knots.iter().map(|knot| knot.inverse_depth).fold(f32::INFINITY, f32::min);
    if nearest <= 0.0 && !(left..right).any(|x| raster.inverse_depth_at(x as i32, top as i32 + 1) > 0.0) {
        return;
    }
    let smooth = nearest - furthest < 0.02 * nearest;
    for y in top..bottom {
        let v = (y - top) as f32 / COARSE as f32;
        let edge = |above: usize, below: usize| {
            knots[above].closed + (knots[below].closed - knots[above].closed) * v
        };
        let (at_left, at_right) = (edge(0, 2), edge(1, 3));
        for x in left..right {
            let u = (x - left) as f32 / COARSE as f32;
            let closed = if smooth {
                at_left + (at_right - at_left) * u
            } else {
                across_an_edge(knots, (u, v), raster.inverse_depth_at(x as i32, y as i32))
            };
            buffer[y * width + x] = (255.0 * STRENGTH * closed) as u8;
        }
    }
}

/// Interpolation across a depth discontinuity: a knot on the other side belongs to another surface and has
/// little weight.
fn across_an_edge(knots: &[Knot; 4], (u, v): (f32, f32), inverse_depth: f32) -> f32 {
    if inverse_depth <= 0.0 {
        return 0.0;
    }
    let shares = [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v];
    let (mut sum, mut weights) = (0.0, 1e-6);
    for (knot, share) in knots.iter().zip(shares) {
        if knot.inverse_depth > 0.0 {
            let gap = (knot.inverse_depth - inverse_depth) / inverse_depth;
            let weight = (share + 0.01) / (1.0 + 4.0e4 * gap * gap);
            sum += weight * knot.closed;
            weights += weight;
        }
    }
    sum / weights
}

/// Occlusion at every knot.
///
/// Occluders are sampled at the knots too: their points fit into the cache, unlike the whole geometry buffer,
/// whose access dominated the time.
fn occlusion_at_knots(raster: &Raster, grid: &Grid) -> Vec<Knot> {
    let factor = raster.factor();
    let projection = raster.sample_projection();
    let (stride, height) = (raster.sample_width(), raster.sample_height());
    let surfel_at = |index: usize| {
        let (column, row) = (grid.left + index % grid.columns, grid.top + index / grid.columns);
        let (x, y) = (column * COARSE * factor + factor / 2, row * COARSE * factor + factor / 2);
        let inside = x < stride && y < height;
        inside
            .then(|| (&raster.surfels()[y * stride + x], x, y))
            .filter(|(surfel, ..)| surfel.inverse_depth > 0.0)
    };
    // Eye-frame points; z = 0 is the background.
    let points: Vec<Vec3> = (0..grid.columns * grid.rows)
        .map(|index| {
            surfel_at(index).map_or(Vec3::ZERO, |(surfel, x, y)| {
                let across = x as f32 + 0.5 - projection.centre_px.x;
                let up = projection.centre_px.y - y as f32 - 0.5;
                Vec3::new(across, up, -projection.focal_px) / (projection.focal_px * surfel.inverse_depth)
            })
        })
        .collect();
    let reach = RADIUS * projection.focal_px / (factor * COARSE) as f32;
    let offsets = DIRECTIONS
        .map(|direction| STEPS.map(|step| direction.map(|along| (along * step * reach).round() as isize)));
    let (columns, rows) = (grid.columns as isize, grid.rows as isize);
    (0..points.len())
        .map(|index| {
            let Some((surfel, ..)) = surfel_at(index) else { return Knot::default() };
            let (column, row) = (index as isize % columns, index as isize / columns);
            let (point, normal) = (points[index], surfel.normal.normalize_or(Vec3::Z));
            let fade = (2.5 * RADIUS * -point.z).recip();
            let mut closed = 0.0;
            for steps in &offsets {
                let mut horizon = 0.0_f32;
                for [across, down] in steps {
                    let (x, y) = (column + across, row + down);
                    if x < 0 || y < 0 || x >= columns || y >= rows {
                        continue;
                    }
                    let sample = points[(y * columns + x) as usize];
                    if sample.z == 0.0 {
                        continue;
                    }
                    let offset = sample - point;
                    let distance = offset.length().max(1e-9);
                    // A far occluder is another object in front, not part of a crease.
                    let near = 1.0 - distance * fade;
                    horizon = horizon.max((normal.dot(offset) / distance - 0.12) * near.max(0.0));
                }
                closed += horizon;
            }
            let closed = (closed * (1.6 / DIRECTIONS.len() as f32)).min(1.0);
            Knot { inverse_depth: surfel.inverse_depth, closed }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::OrbitCamera;
    use crate::material::Material;
    use crate::raster::Vertex;

    fn quad(corners: [Vec3; 4]) -> (Vec<Vertex>, Vec<[u32; 3]>) {
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        let vertices =
            corners.iter().map(|&position_m| Vertex { position_m, normal, albedo: Vec3::ONE }).collect();
        (vertices, vec![[0, 1, 2], [0, 2, 3]])
    }

    /// A flat wall is open; the crease between two walls is occluded.
    #[test]
    fn a_corner_is_darker_than_a_flat_wall() {
        let camera = OrbitCamera::framing(Vec3::ZERO, 1.0, Vec3::new(1.0, 0.0, 0.6), Vec3::Z);
        let projection = camera.projection(160, 120);
        let mut raster = Raster::new(160, 120, 1, &projection);
        let floor = quad([
            Vec3::new(-2.0, -2.0, 0.0),
            Vec3::new(2.0, -2.0, 0.0),
            Vec3::new(2.0, 2.0, 0.0),
            Vec3::new(-2.0, 2.0, 0.0),
        ]);
        raster.draw(&floor.0, &floor.1, Material::Plain);
        let open = ambient(&raster, Vec::new());
        let wall = quad([
            Vec3::new(-0.03, -2.0, 0.0),
            Vec3::new(-0.03, 2.0, 0.0),
            Vec3::new(-0.03, 2.0, 2.0),
            Vec3::new(-0.03, -2.0, 2.0),
        ]);
        raster.draw(&wall.0, &wall.1, Material::Plain);
        let corner = ambient(&raster, Vec::new());
        let index = 60 * 160 + 80;
        assert!(open[index] < 8, "{}", open[index]);
        assert!(corner[index] > open[index] + 25, "{} against {}", corner[index], open[index]);
    }
}
