//! Where a sphere presses on the skin, and how much.
//!
//! The deformed skin is in the layer of the sphere. A layer of the thickness d, of which 2 d / 3 lie outside the radius,
//! presses with k t^3, t = (reach - r) / d, at the distance r from the centre, or from the axis of a capsule. So the pressure is
//! p = |F| t^3 / |sum of A t^3 n| for the known force F.

use super::camera::Projection;
use super::deformation::Deformation;
use super::image::{Image, StrokeMask};
use super::touched::nearest_on_axis;
use glam::Vec3;
use palpate_core::format::Sphere;
use palpate_core::vec3;
use palpate_host::rt::TickRecord;

/// Distance of the samples on the skin, in radii of the sphere.
const SPACING: f32 = 0.06;
/// Largest number of parts of an edge.
const MOST_PARTS: usize = 24;
/// Colours from a light to the greatest pressure.
const COLOURS: [u32; 4] = [0xff_f3c4, 0xff_d166, 0xff_8c42, 0xf2_4236];
/// Opacity of the patch.
const OPACITY: f32 = 0.85;

/// The patch; buffers are reused from frame to frame.
#[derive(Debug, Clone, Default)]
pub(super) struct Contact {
    /// Places, m, with t^3.
    samples: Vec<(Vec3, f32)>,
    spacing_m: f32,
    mask: StrokeMask,
}

impl Contact {
    /// Finds the patch of a sphere, or of a capsule with a half axis. Returns the area of the skin in its layer and the greatest pressure in words; `None` if
    /// it does not press.
    pub(super) fn update(
        &mut self,
        (surface, triangles): (&Deformation, &[[u32; 3]]),
        (sphere, half_m): (Sphere, Vec3),
        record: &TickRecord,
    ) -> Option<String> {
        self.samples.clear();
        let (centre_m, force_n) = (Vec3::from_array(record.hip_m), vec3::norm(record.reaction_n));
        if force_n == 0.0 {
            return None;
        }
        self.spacing_m = SPACING * sphere.radius_m;
        let (reach_m, thickness_m) = (sphere.reach_m(), sphere.thickness_m());
        let (mut area_m2, mut pressing_m2, mut largest) = (0.0, Vec3::ZERO, 0.0_f32);
        for corners in triangles {
            let [a, b, c] = corners.map(|corner| surface.position_m()[corner as usize] - centre_m);
            let (low, high) = (a.min(b).min(c), a.max(b).max(c));
            let most_m = half_m.abs() + reach_m;
            if low.cmpgt(most_m).any() || high.cmplt(-most_m).any() {
                continue;
            }
            let longest_m = a.distance(b).max(b.distance(c)).max(c.distance(a));
            let parts = ((longest_m / self.spacing_m).ceil() as usize).clamp(1, MOST_PARTS);
            let part_m2 = 0.5 * (b - a).cross(c - a).length() / (parts * parts) as f32;
            for (i, j, third) in parts_of(parts) {
                let [u, v] = [i, j].map(|at| (at as f32 + third) / parts as f32);
                let place = a + u * (b - a) + v * (c - a);
                let from_axis = place - nearest_on_axis(half_m, place);
                let overlap = (reach_m - from_axis.length()) / thickness_m;
                if overlap > 0.0 {
                    let cubed = overlap.powi(3);
                    self.samples.push((centre_m + place, cubed));
                    area_m2 += part_m2;
                    pressing_m2 += part_m2 * cubed * from_axis.normalize_or_zero();
                    largest = largest.max(cubed);
                }
            }
        }
        for (_, share) in &mut self.samples {
            *share /= largest;
        }
        let pressing_m2 = pressing_m2.length();
        (pressing_m2 > 0.0).then(|| {
            let largest_pa = force_n * largest / pressing_m2;
            format!("{:.1} cm2, {:.0} kPa", 1e4 * area_m2, 1e-3 * largest_pa)
        })
    }

    /// Draws the patch over the sphere and the skin.
    pub(super) fn draw(&mut self, projection: &Projection, image: &mut Image) {
        let seen = |&(place_m, share): &(Vec3, f32)| {
            let (pixel, _) = projection.project(place_m)?;
            let (beside, _) = projection.project(place_m + self.spacing_m * projection.to_eye.row(0))?;
            Some((pixel, 0.62 * beside.distance(pixel), share))
        };
        let seen: Vec<_> = self.samples.iter().filter_map(seen).collect();
        for (band, colour) in COLOURS.into_iter().enumerate() {
            self.mask.reset(0, 0, image.width(), image.height());
            let is_in = |share: f32| (share * COLOURS.len() as f32) as usize;
            for &(pixel, radius, share) in &seen {
                if is_in(share).min(COLOURS.len() - 1) == band {
                    self.mask.segment(pixel.to_array(), pixel.to_array(), radius, 1.0);
                }
            }
            self.mask.paint(image, colour, OPACITY);
        }
    }
}

/// The equal parts of a triangle: two indices, and the place of the middle in them.
fn parts_of(parts: usize) -> impl Iterator<Item = (usize, usize, f32)> {
    let upright = (0..parts).flat_map(move |i| (0..parts - i).map(move |j| (i, j, 1.0 / 3.0)));
    let inverse = (1..parts).flat_map(move |i| (1..=parts - i).map(move |j| (i - 1, j - 1, 2.0 / 3.0)));
    upright.chain(inverse)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every part of a triangle once, inside it.
    #[test]
    fn the_parts_cover_a_triangle() {
        for parts in [1, 2, 7] {
            let middles: Vec<[f32; 2]> = parts_of(parts)
                .map(|(i, j, third)| [i, j].map(|at| (at as f32 + third) / parts as f32))
                .collect();
            assert_eq!(middles.len(), parts * parts);
            assert!(middles.iter().all(|[u, v]| *u > 0.0 && *v > 0.0 && u + v < 1.0));
            let mean = middles.iter().map(|[u, _]| u).sum::<f32>() / middles.len() as f32;
            assert!((mean - 1.0 / 3.0).abs() < 1e-5, "{mean}");
        }
    }
}
