//! Ambient occlusion from the depth buffer: creases, dents and the feet of markers darken.

use super::raster::Raster;

/// Picture-space directions looked along, pixels of the coarse grid times a radius.
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
/// Fractions of the radius sampled along every direction.
const STEPS: [f32; 3] = [0.25, 0.6, 1.0];
/// Radius as a share of the distance from the eye.
const RADIUS: f32 = 0.03;
/// Pixels between the samples of the coarse grid.
const COARSE: usize = 4;
/// Strongest darkening.
const STRENGTH: f32 = 0.62;

/// Occlusion of every pixel, 0 open to 255 closed, at the size of the picture; `buffer` is reused.
///
/// For each direction: how far the surroundings rise above the tangent plane at the sample, as a sine, averaged. Computed
/// on every fourth pixel and interpolated where depth is continuous: the term is smooth, and a dense one costs more than all
/// other shading together.
pub(super) fn ambient(raster: &Raster, mut buffer: Vec<u8>) -> Vec<u8> {
    let factor = raster.factor();
    let (width, height) = (raster.sample_width() / factor, raster.sample_height() / factor);
    buffer.clear();
    buffer.resize(width * height, 0);
    let drawn = raster.drawn();
    let (left, right) = (drawn.left / factor / COARSE, drawn.right.div_ceil(factor).div_ceil(COARSE) + 1);
    let (top, bottom) = (drawn.top / factor / COARSE, drawn.bottom.div_ceil(factor).div_ceil(COARSE) + 1);
    let columns = right - left;
    let mut coarse = vec![(0.0_f32, 0.0_f32); columns * (bottom - top)];
    for row in top..bottom {
        for column in left..right {
            coarse[(row - top) * columns + column - left] = at(raster, column * COARSE, row * COARSE);
        }
    }
    for y in drawn.top / factor..drawn.bottom.div_ceil(factor).min(height) {
        for x in drawn.left / factor..drawn.right.div_ceil(factor).min(width) {
            let inverse_depth = raster.inverse_depth_at(x as i32, y as i32);
            if inverse_depth <= 0.0 {
                continue;
            }
            let (column, row) = (x / COARSE, y / COARSE);
            let (u, v) =
                ((x % COARSE) as f32 / COARSE as f32 + 0.01, (y % COARSE) as f32 / COARSE as f32 + 0.01);
            let mut sum = 0.0;
            let mut weights = 1e-6;
            for (dx, dy, share) in
                [(0, 0, (1.0 - u) * (1.0 - v)), (1, 0, u * (1.0 - v)), (0, 1, (1.0 - u) * v), (1, 1, u * v)]
            {
                let Some(&(depth, value)) = coarse.get((row + dy - top) * columns + (column + dx - left))
                else {
                    continue;
                };
                // A neighbour across a depth edge belongs to another surface.
                let gap = ((depth - inverse_depth) / inverse_depth).abs();
                let weight = share / (1.0 + 4.0e4 * gap * gap);
                sum += weight * value * f32::from(u8::from(depth > 0.0));
                weights += weight * f32::from(u8::from(depth > 0.0));
            }
            buffer[y * width + x] = (255.0 * STRENGTH * (sum / weights).clamp(0.0, 1.0)) as u8;
        }
    }
    buffer
}

/// Inverse depth and occlusion (0..1) at a pixel.
fn at(raster: &Raster, x: usize, y: usize) -> (f32, f32) {
    let factor = raster.factor();
    let (width, height) = (raster.sample_width() / factor, raster.sample_height() / factor);
    if x >= width || y >= height {
        return (0.0, 0.0);
    }
    let middle = factor / 2;
    let surfel = &raster.surfels()[(y * factor + middle) * raster.sample_width() + x * factor + middle];
    if surfel.inverse_depth <= 0.0 {
        return (0.0, 0.0);
    }
    let projection = raster.sample_projection();
    let focal_px = projection.focal_px / factor as f32;
    let centre_px = projection.centre_px / factor as f32;
    let point = |px: f32, py: f32, inverse_depth: f32| {
        let depth = inverse_depth.recip();
        glam::Vec3::new((px - centre_px.x) / focal_px * depth, (centre_px.y - py) / focal_px * depth, -depth)
    };
    let here = point(x as f32 + 0.5, y as f32 + 0.5, surfel.inverse_depth);
    let normal = surfel.normal.normalize_or(glam::Vec3::Z);
    let radius_m = RADIUS * -here.z;
    let radius_px = RADIUS * focal_px;
    let mut closed = 0.0;
    for (i, direction) in DIRECTIONS.iter().enumerate() {
        let mut horizon = 0.0_f32;
        for step in STEPS {
            // Neighbouring samples look at different distances, which trades banding for a little grain.
            let reach = radius_px * step * (0.8 + 0.4 * (((x / COARSE + i) ^ (y / COARSE)) % 3) as f32 / 3.0);
            let (px, py) = (x as f32 + direction[0] * reach, y as f32 + direction[1] * reach);
            let inverse_depth = raster.inverse_depth_at(px as i32, py as i32);
            if inverse_depth <= 0.0 {
                continue;
            }
            let offset = point(px + 0.5, py + 0.5, inverse_depth) - here;
            let distance = offset.length().max(1e-9);
            let rise = normal.dot(offset) / distance;
            // Far occluders belong to something else in front, not to a crease.
            let near = (1.0 - distance / (2.5 * radius_m)).clamp(0.0, 1.0);
            horizon = horizon.max((rise - 0.12) * near);
        }
        closed += horizon;
    }
    (surfel.inverse_depth, (closed * (1.6 / DIRECTIONS.len() as f32)).min(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::viewer::camera::OrbitCamera;
    use crate::viewer::raster::Vertex;
    use crate::viewer::shade::Material;
    use glam::Vec3;

    fn quad(corners: [Vec3; 4]) -> (Vec<Vertex>, Vec<[u32; 3]>) {
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        let vertices =
            corners.iter().map(|&position_m| Vertex { position_m, normal, albedo: Vec3::ONE }).collect();
        (vertices, vec![[0, 1, 2], [0, 2, 3]])
    }

    /// A flat wall is open; the foot of two walls that meet is not.
    #[test]
    fn a_corner_is_darker_than_a_flat_wall() {
        let camera = OrbitCamera::framing(Vec3::ZERO, 1.0, Vec3::new(1.0, 0.0, 0.6));
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
