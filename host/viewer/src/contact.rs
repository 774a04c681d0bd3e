//! Where a sphere presses on the skin, and how much.
//!
//! The deformed skin is in the layer of the sphere. A layer of the thickness d, of which 2 d / 3 lie outside the radius,
//! presses with k t^3, t = (reach - r) / d, at the distance r from the centre, or from the axis of a capsule. So the pressure is
//! p = |F| t^3 / |sum of A t^3 n| for the known force F.

use super::camera::Projection;
use super::deformation::Deformation;
use super::image::{Image, StrokeMask};
use super::touched::nearest_on_axis;
use core::fmt;
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
    /// Finds the patch of a sphere, or of a capsule with a half axis; `None` if it does not press.
    pub(super) fn update(
        &mut self,
        (surface, triangles): (&Deformation, &[[u32; 3]]),
        (sphere, half_m): (Sphere, Vec3),
        record: &TickRecord,
    ) -> Option<Patch> {
        self.samples.clear();
        let (centre_m, force_n) = (Vec3::from_array(record.hip_m), vec3::norm(record.reaction_n));
        if force_n == 0.0 {
            return None;
        }
        self.spacing_m = SPACING * sphere.radius_m;
        let at = |vertex: u32| surface.position_m()[vertex as usize] - centre_m;
        let sample = |place: Vec3, cubed: f32| self.samples.push((centre_m + place, cubed));
        let (patch, largest) = pressed(triangles, at, (sphere, half_m), force_n, sample)?;
        for (_, share) in &mut self.samples {
            *share /= largest;
        }
        Some(patch)
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

/// Where a sphere presses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Patch {
    /// Area, m^2. The layer is soft and begins outside the radius: the skin in it is up to twice the area of a hard contact. This
    /// is that of Hertz, p = p_0 sqrt(1 - rho^2 / a^2), with the same sums of A p and of A p^2: (9/8) (sum A p)^2 / sum A p^2.
    pub area_m2: f32,
    /// Greatest pressure, Pa.
    pub largest_pa: f32,
    /// Whether the pressed triangles are so large, more than half the radius, that both are those of the facets: shown with a ~.
    pub is_coarse: bool,
}

/// Edges longer than this share of the radius are coarse.
const COARSE: f32 = 0.5;

impl Patch {
    /// The patch of a sphere that presses with a force of this size, N, on triangles whose vertices `place_m` gives
    /// relative to its centre; `None` if the skin is beside it.
    #[must_use]
    pub fn of(
        triangles: &[[u32; 3]],
        place_m: impl Fn(u32) -> [f32; 3],
        sphere: Sphere,
        force_n: f32,
    ) -> Option<Self> {
        let at = |vertex| Vec3::from_array(place_m(vertex));
        pressed(triangles, at, (sphere, Vec3::ZERO), force_n, |_, _| {}).map(|(patch, _)| patch)
    }
}

impl fmt::Display for Patch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let about = if self.is_coarse { "~" } else { "" };
        write!(f, "{about}{:.1} cm2, {about}{:.0} kPa", 1e4 * self.area_m2, 1e-3 * self.largest_pa)
    }
}

/// The patch, and the largest t^3. `sample` gets each place of the skin in the layer, relative to the centre, with its t^3.
fn pressed(
    triangles: &[[u32; 3]],
    place_m: impl Fn(u32) -> Vec3,
    (sphere, half_m): (Sphere, Vec3),
    force_n: f32,
    mut sample: impl FnMut(Vec3, f32),
) -> Option<(Patch, f32)> {
    let spacing_m = SPACING * sphere.radius_m;
    let (reach_m, thickness_m) = (sphere.reach_m(), sphere.thickness_m());
    let (mut sum_m2, mut square_m2, mut edges_m3) = (0.0, 0.0, 0.0);
    let (mut pressing_m2, mut largest) = (Vec3::ZERO, 0.0_f32);
    for corners in triangles {
        let [a, b, c] = corners.map(&place_m);
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        let most_m = half_m.abs() + reach_m;
        if low.cmpgt(most_m).any() || high.cmplt(-most_m).any() {
            continue;
        }
        let longest_m = a.distance(b).max(b.distance(c)).max(c.distance(a));
        let parts = ((longest_m / spacing_m).ceil() as usize).clamp(1, MOST_PARTS);
        let part_m2 = 0.5 * (b - a).cross(c - a).length() / (parts * parts) as f32;
        for (i, j, third) in parts_of(parts) {
            let [u, v] = [i, j].map(|at| (at as f32 + third) / parts as f32);
            let place = a + u * (b - a) + v * (c - a);
            let from_axis = place - nearest_on_axis(half_m, place);
            let overlap = (reach_m - from_axis.length()) / thickness_m;
            if overlap > 0.0 {
                let cubed = overlap.powi(3);
                sample(place, cubed);
                sum_m2 += part_m2 * cubed;
                square_m2 += part_m2 * cubed * cubed;
                edges_m3 += part_m2 * cubed * longest_m;
                pressing_m2 += part_m2 * cubed * from_axis.normalize_or_zero();
                largest = largest.max(cubed);
            }
        }
    }
    let pressing_m2 = pressing_m2.length();
    let largest_pa = force_n * largest / pressing_m2;
    let area_m2 = 9.0 / 8.0 * sum_m2 * sum_m2 / square_m2;
    let is_coarse = edges_m3 > COARSE * sphere.radius_m * sum_m2;
    (pressing_m2 > 0.0).then_some((Patch { area_m2, largest_pa, is_coarse }, largest))
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

    /// R = 10 mm with a layer of 2 mm.
    const SPHERE: Sphere = Sphere { radius_m: 0.010, layer_m: 0.004 / 3.0 };

    /// A net of triangles over a square of 32 edges of this length, lifted to `height_m`.
    fn net(edge_m: f32, height_m: impl Fn(f32, f32) -> f32) -> (Vec<[u32; 3]>, Vec<[f32; 3]>) {
        const N: u32 = 33;
        let at = |i: u32| edge_m * (i as f32 - 16.0);
        let places =
            (0..N * N).map(|n| (at(n / N), at(n % N))).map(|(x, y)| [x, y, height_m(x, y)]).collect();
        let corners = (0..N - 1).flat_map(|i| (0..N - 1).map(move |j| i * N + j));
        (corners.flat_map(|n| [[n, n + N, n + N + 1], [n, n + N + 1, n + 1]]).collect(), places)
    }

    fn patch(triangles: &[[u32; 3]], places: &[[f32; 3]], force_n: f32) -> Option<Patch> {
        Patch::of(triangles, |vertex| places[vertex as usize], SPHERE, force_n)
    }

    /// A plane at the distance h is in the layer within sqrt(reach^2 - h^2). With rho drho = r dr the force of k t^3 is
    /// 2 pi h int_h^reach k t^3 dr = pi h k t_h^4 d / 2, so that the greatest pressure k t_h^3 is 2 F / (pi h (reach - h)).
    /// Likewise the sums of A t^3 and A t^6 are 2 pi d (reach t^4 / 4 - d t^5 / 5) and 2 pi d (reach t^7 / 7 - d t^8 / 8).
    #[test]
    fn on_a_plane_area_and_pressure_are_those_of_the_closed_form() {
        let (force_n, reach_m) = (1.5, SPHERE.reach_m());
        let mut before_m2 = 0.0;
        for h in [0.0110, 0.0105, 0.0100, 0.0095] {
            let (triangles, places) = net(1.5e-3, |_, _| -h);
            let found = patch(&triangles, &places, force_n).expect("it presses");
            let d = SPHERE.thickness_m();
            let t = (reach_m - h) / d;
            let [sum, square] = [(4, 5), (7, 8)].map(|(n, m)| {
                core::f32::consts::TAU * d * (reach_m * t.powi(n) / n as f32 - d * t.powi(m) / m as f32)
            });
            let area_m2 = 9.0 / 8.0 * sum * sum / square;
            let largest_pa = 2.0 * force_n / (core::f32::consts::PI * h * (reach_m - h));
            let [area, pressure] = [found.area_m2 / area_m2, found.largest_pa / largest_pa];
            assert!((area - 1.0).abs() < 0.03 && (pressure - 1.0).abs() < 0.03, "h {h}: {area}, {pressure}");
            assert!(found.area_m2 > before_m2 && !found.is_coarse, "the area grows with the depth");
            before_m2 = found.area_m2;
        }
        let (triangles, places) = net(1.5e-3, |_, _| -1.001 * reach_m);
        assert_eq!(patch(&triangles, &places, force_n), None, "beside the sphere");
        // Edges of 6 mm, diagonals of 8.5.
        let (triangles, places) = net(6e-3, |_, _| -0.0095);
        let coarse = patch(&triangles, &places, force_n).expect("it presses");
        assert!(coarse.is_coarse && coarse.to_string().starts_with('~'), "{coarse}");
    }

    /// On a bowl round the sphere the pressure is uniform, and its resultant is the pressure on the disc of the rim: only
    /// the share of each normal along the force counts.
    #[test]
    fn on_a_bowl_the_pressure_is_the_force_on_the_disc_of_its_rim() {
        let (bowl_m, rim_m) = (0.0095_f32, 0.007_f32);
        let (triangles, places) = net(0.5e-3, |x, y| {
            let square = x * x + y * y;
            if square < 1.02 * rim_m * rim_m { -(bowl_m * bowl_m - square).max(0.0).sqrt() } else { -1.0 }
        });
        let inside = |corners: &&[u32; 3]| corners.iter().all(|&vertex| places[vertex as usize][2] > -0.5);
        let triangles: Vec<[u32; 3]> = triangles.iter().filter(inside).copied().collect();
        let found = patch(&triangles, &places, 2.0).expect("it presses");
        // The disc that the triangles cover, and their area, summed from their corners.
        let (mut disc_m2, mut area_m2) = (0.0, 0.0);
        for corners in &triangles {
            let [a, b, c] = corners.map(|vertex| Vec3::from_array(places[vertex as usize]));
            let twice = (b - a).cross(c - a);
            (disc_m2, area_m2) = (disc_m2 + 0.5 * twice.z.abs(), area_m2 + 0.5 * twice.length());
        }
        let [area, pressure] = [found.area_m2 / area_m2, found.largest_pa * disc_m2 / 2.0];
        // Nine eighths, because that of Hertz is not uniform.
        assert!((area - 1.125).abs() < 0.002 && (pressure - 1.0).abs() < 0.02, "{area}, {pressure}");
    }
}
