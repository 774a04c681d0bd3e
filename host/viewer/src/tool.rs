//! The tool: a ball for a point, a soft pad for a fingertip. No part of it is hidden by the skin: what lies
//! behind is seen through it.

use super::camera::Projection;
use super::image::{Image, StrokeMask};
use super::material::Material;
use super::palette::linear;
use super::raster::Raster;
use super::shapes::Shapes;
use super::touched::Touched;
use glam::{Vec2, Vec3};
use palpate_core::Orientation;

/// Colour of the ball.
const BALL_COLOUR: u32 = 0xdd_e6ee;
/// Colour of the pad, and of what is behind the skin.
pub(super) const PAD_COLOUR: u32 = 0xbf_e3f2;
/// Colour of the pad's edges turned away from the light.
const SHADE_COLOUR: u32 = 0x35_5468;
/// Radius of the ball, in radii of the organ.
const BALL: f32 = 0.030;
/// Height of the pad, in its radii.
pub(super) const PAD_HEIGHT: f32 = 0.62;
/// Opacity of the pad where it faces the eye, and what its edge has more.
const PAD_OPACITY: [f32; 2] = [0.46, 0.44];
/// Opacity behind the skin, relative to that in front of it.
const BEHIND: f32 = 0.6;
/// Opacity of a ball behind the skin.
const BALL_OPACITY: f32 = 0.42;
/// Number of sides of an outline.
const SIDES: usize = 56;

/// The shape of the tool.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Tool {
    /// A ball of this radius, m, for a point.
    Ball(f32),
    /// A sphere of this radius, m.
    Sphere(f32),
    /// A capsule of this radius with this half axis, m.
    Capsule(f32, Vec3),
    /// A fingertip whose pad has this radius, m.
    Fingertip(f32),
}

impl Tool {
    /// The tool of an organ of this size.
    pub(super) const fn new(tool: palpate_core::format::Tool, organ_radius_m: f32) -> Self {
        match tool {
            palpate_core::format::Tool::Point => Self::Ball(BALL * organ_radius_m),
            palpate_core::format::Tool::Fingertip(tip) => Self::Fingertip(tip.radius_m),
            palpate_core::format::Tool::Sphere(sphere) => Self::Sphere(sphere.radius_m),
            palpate_core::format::Tool::Capsule(capsule) => {
                Self::Capsule(capsule.sphere.radius_m, Vec3::from_array(capsule.half_axis_m))
            }
        }
    }

    /// Half axis of a capsule, m; zero of other tools.
    pub(super) const fn half_m(self) -> Vec3 {
        match self {
            Self::Capsule(_, half_m) => half_m,
            Self::Ball(_) | Self::Sphere(_) | Self::Fingertip(_) => Vec3::ZERO,
        }
    }

    /// A capsule as the grip turns it.
    pub(super) fn turned(self, tool: palpate_core::format::Tool, grip: Orientation) -> Self {
        match (self, tool.half_axis_m()) {
            (Self::Capsule(radius_m, _), Some(half_m)) => {
                Self::Capsule(radius_m, Vec3::from_array(grip.turn(half_m)))
            }
            _ => self,
        }
    }

    /// Distance from the tool's position to its outside, along the normal, m.
    pub(super) const fn height_m(self) -> f32 {
        match self {
            Self::Ball(radius_m) | Self::Sphere(radius_m) | Self::Capsule(radius_m, _) => radius_m,
            Self::Fingertip(radius_m) => PAD_HEIGHT * radius_m,
        }
    }

    /// Draws what is opaque: the ball.
    pub(super) fn draw_solid(self, shapes: &mut Shapes, raster: &mut Raster, at_m: Vec3) {
        if let Self::Ball(radius_m) | Self::Sphere(radius_m) | Self::Capsule(radius_m, _) = self {
            let colour = linear(BALL_COLOUR);
            shapes.capsule(raster, (at_m, self.half_m()), radius_m, colour, Material::Polished);
        }
    }

    /// Draws what is translucent: the pad, and the part of the ball behind the skin.
    pub(super) fn draw_translucent(
        self,
        touched: &Touched,
        (raster, projection): (&Raster, &Projection),
        mask: &mut StrokeMask,
        image: &mut Image,
    ) {
        let (centre_m, normal) = (touched.tool_m, touched.normal);
        let (side, other) = normal.any_orthonormal_pair();
        let dome = match self {
            // Of a capsule the place of its axis that is deepest.
            Self::Ball(radius_m) | Self::Sphere(radius_m) | Self::Capsule(radius_m, _) => {
                Dome { centre_m, axes: [side, other, normal], radii_m: Vec3::splat(radius_m), is_half: false }
            }
            Self::Fingertip(radius_m) => Dome {
                centre_m,
                axes: [side, other, normal],
                radii_m: Vec3::new(radius_m, radius_m, self.height_m()),
                is_half: true,
            },
        };
        dome.draw(raster, projection, image);
        let line = (image.height() as f32 / 720.0).max(0.6);
        let ring = match self {
            Self::Ball(radius_m) | Self::Sphere(radius_m) | Self::Capsule(radius_m, _) => {
                // The outline of a ball is a circle that faces the eye.
                let (right, up) = (projection.to_eye.row(0), projection.to_eye.row(1));
                ring(centre_m, [right * radius_m, up * radius_m])
            }
            Self::Fingertip(radius_m) => ring(centre_m, [side * radius_m, other * radius_m]),
        };
        let [in_front, behind] = if dome.is_half { [1.0, 0.55] } else { [0.0, 1.0] };
        outline(&ring, (raster, projection), [in_front, behind], line, mask, image);
    }
}

/// An ellipsoid, or its half on the positive side of its third axis.
struct Dome {
    centre_m: Vec3,
    axes: [Vec3; 3],
    radii_m: Vec3,
    is_half: bool,
}

/// Where a ray enters a dome.
struct Entry {
    depth_m: f32,
    /// Cosine between ray and surface, 0 at the outline.
    facing: f32,
    /// Height of the surface's normal above the horizon of the picture, -1 to 1.
    upward: f32,
    /// Part of the pixel that the dome covers.
    coverage: f32,
}

impl Dome {
    /// Blends the dome over the picture, pixel by pixel: a ray-ellipsoid intersection each.
    fn draw(&self, raster: &Raster, projection: &Projection, image: &mut Image) {
        let Some((middle, inverse_depth)) = projection.project(self.centre_m) else { return };
        let reach = 1.1 * self.radii_m.max_element() * projection.focal_px * inverse_depth + 2.0;
        let size = Vec2::new(image.width() as f32, image.height() as f32);
        let (low, high) = ((middle - reach).max(Vec2::ZERO), (middle + reach).min(size));
        if !(low.is_finite() && high.is_finite()) {
            return;
        }
        let eye = self.seen_by(projection);
        for y in low.y as i32..high.y.ceil() as i32 {
            for x in low.x as i32..high.x.ceil() as i32 {
                let pixel =
                    (Vec2::new(x as f32, y as f32) + 0.5 - projection.centre_px) / projection.focal_px;
                let Some(entry) = eye.entry(pixel) else { continue };
                let skin = raster.inverse_depth_at(x, y);
                let is_nearer = skin > 0.0 && skin.recip() < entry.depth_m;
                let is_behind = is_nearer && raster.is_tissue_at(x, y);
                if is_nearer && !is_behind {
                    // An arrow or a marker in front of it.
                    continue;
                }
                let opacity = match (self.is_half, is_behind) {
                    (true, _) => {
                        let edge = 1.0 - entry.facing;
                        let own = PAD_OPACITY[0] + PAD_OPACITY[1] * edge * edge;
                        if is_behind { BEHIND * own } else { own }
                    }
                    (false, true) => BALL_OPACITY,
                    (false, false) => continue,
                };
                image.blend(x, y, entry.colour(), opacity * entry.coverage);
            }
        }
    }

    /// The dome in the eye's frame, scaled to a unit sphere.
    fn seen_by(&self, projection: &Projection) -> UnitDome {
        let scaled = |along: Vec3| -> Vec3 {
            Vec3::from_array(self.axes.map(|axis| (projection.to_eye * axis).dot(along))) / self.radii_m
        };
        UnitDome {
            from: -scaled(projection.eye_point(self.centre_m)),
            steps: [Vec3::X, -Vec3::Y, -Vec3::Z].map(scaled),
            up: scaled(projection.to_eye * projection.up),
            pixel: (projection.focal_px * self.radii_m.min_element()).recip(),
            is_half: self.is_half,
        }
    }
}

/// Rays in the frame of a unit sphere round the dome's centre: from the eye, as far as the depth of the point.
struct UnitDome {
    from: Vec3,
    /// The ray's change with x and y of the picture, and straight on.
    steps: [Vec3; 3],
    up: Vec3,
    /// Size of a pixel at a depth of 1 m.
    pixel: f32,
    is_half: bool,
}

impl UnitDome {
    fn entry(&self, at: Vec2) -> Option<Entry> {
        let [x, y, on] = self.steps;
        let ray = x * at.x + y * at.y + on;
        let length_squared = ray.length_squared();
        let nearest_m = -self.from.dot(ray) / length_squared;
        let miss = (self.from + ray * nearest_m).length();
        // The edge is smoothed over a pixel.
        let coverage = ((1.0 - miss) / (self.pixel * nearest_m) + 0.5).clamp(0.0, 1.0);
        if coverage <= 0.0 || nearest_m <= 0.0 {
            return None;
        }
        let half_m = ((1.0 - miss * miss).max(0.0) / length_squared).sqrt();
        let (mut depth_m, mut normal) = (nearest_m - half_m, self.from + ray * (nearest_m - half_m));
        if self.is_half && normal.z < 0.0 {
            // Through the flat side, unless the ray leaves the sphere before it.
            let flat_m = -self.from.z / ray.z;
            if ray.z <= 0.0 || flat_m > nearest_m + half_m {
                return None;
            }
            (depth_m, normal) = (flat_m, Vec3::NEG_Z);
        }
        let facing = (-normal.dot(ray) / length_squared.sqrt()).clamp(0.0, 1.0);
        let upward = normal.dot(self.up) / self.up.length();
        Some(Entry { depth_m, facing, upward, coverage })
    }
}

impl Entry {
    /// Lit from above.
    fn colour(&self) -> u32 {
        super::image::mix(SHADE_COLOUR, PAD_COLOUR, 0.62 + 0.38 * self.upward)
    }
}

/// A closed ring of points.
fn ring(centre_m: Vec3, [one, other]: [Vec3; 2]) -> Vec<Vec3> {
    let turn = |i: usize| core::f32::consts::TAU * i as f32 / SIDES as f32;
    (0..=SIDES).map(|i| centre_m + one * turn(i).cos() + other * turn(i).sin()).collect()
}

/// Draws a line with one opacity in front of the skin and another behind it.
fn outline(
    points_m: &[Vec3],
    (raster, projection): (&Raster, &Projection),
    [in_front, behind]: [f32; 2],
    line: f32,
    mask: &mut StrokeMask,
    image: &mut Image,
) {
    let pixels: Vec<(Vec2, f32)> =
        points_m.iter().filter_map(|point_m| projection.project(*point_m)).collect();
    let bounds = pixels.iter().fold((Vec2::INFINITY, Vec2::NEG_INFINITY), |(low, high), (pixel, _)| {
        (low.min(*pixel), high.max(*pixel))
    });
    let size = Vec2::new(image.width() as f32, image.height() as f32);
    let (low, high) = ((bounds.0 - 3.0).max(Vec2::ZERO).floor(), (bounds.1 + 3.0).min(size).ceil());
    if !low.cmplt(high).all() {
        return;
    }
    mask.reset(low.x as i32, low.y as i32, (high.x - low.x) as usize, (high.y - low.y) as usize);
    for pair in pixels.windows(2) {
        let [(from, near_from), (to, near_to)] = [pair[0], pair[1]];
        mask.segment_where(from.to_array(), to.to_array(), 0.8 * line, |x, y, t| {
            let is_hidden = raster.inverse_depth_at(x, y) > near_from + (near_to - near_from) * t
                && raster.is_tissue_at(x, y);
            if is_hidden { behind } else { in_front }
        });
    }
    mask.paint(image, PAD_COLOUR, 0.9);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::OrbitCamera;
    use crate::raster::Vertex;

    const SIZE: usize = 240;
    const RADIUS_M: f32 = 0.010;

    /// A camera 30 degrees above the plane z = 0, and a wall of tissue in that plane, or nothing.
    fn view(has_skin: bool) -> (Raster, Projection) {
        let camera = OrbitCamera::framing(Vec3::ZERO, 0.02, Vec3::new(0.0, -0.87, 0.5), Vec3::Z);
        let projection = camera.projection(SIZE, SIZE);
        let mut raster = Raster::new(SIZE, SIZE, 1, &projection);
        if has_skin {
            let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| Vertex {
                position_m: Vec3::new(0.04 * x, 0.04 * y, 0.0),
                normal: Vec3::Z,
                albedo: Vec3::X,
            });
            raster.draw(&corners, &[[0, 1, 2], [0, 2, 3]], Material::Tissue);
        }
        (raster, projection)
    }

    fn drawn(tool: Tool, height_m: f32, has_skin: bool) -> Image {
        let (raster, projection) = view(has_skin);
        let tool_m = Vec3::Z * height_m;
        let touched =
            Touched { tool_m, reach_m: 0.0, contact_m: Vec3::ZERO, normal: Vec3::Z, is_engaged: true };
        let mut image = Image::new(SIZE, SIZE);
        tool.draw_translucent(&touched, (&raster, &projection), &mut StrokeMask::default(), &mut image);
        image
    }

    fn lit(image: &Image) -> usize {
        image.pixels().iter().filter(|pixel| **pixel != 0).count()
    }

    fn sum(image: &Image) -> u64 {
        image.pixels().iter().map(|pixel| u64::from(pixel & 0xff)).sum()
    }

    /// Above the skin, half in it and below it: the whole dome is seen, fainter where the skin covers it.
    #[test]
    fn a_pad_is_seen_through_the_skin() {
        let pad = Tool::Fingertip(RADIUS_M);
        let (alone, above) = (drawn(pad, -0.004, false), drawn(pad, 0.004, true));
        assert!(lit(&alone) > 5_000, "{}", lit(&alone));
        for height_m in [-0.002, -0.004, -0.009] {
            let (covered, free) = (drawn(pad, height_m, true), drawn(pad, height_m, false));
            // The faintest pixels of the edge may round to nothing.
            assert!(lit(&free) - lit(&covered) < 20, "{height_m}: {} {}", lit(&free), lit(&covered));
            assert!(sum(&covered) < sum(&free) && 3 * sum(&covered) > sum(&free), "{height_m}");
        }
        assert_eq!(above, drawn(pad, 0.004, false));
        // Half an ellipse above, half of the base's ellipse below the middle.
        let (_, projection) = view(false);
        let scale_px = projection.focal_px / projection.eye_m.distance(Vec3::ZERO) * RADIUS_M;
        let (sin, cos) = (0.5_f32, 0.75_f32.sqrt());
        let silhouette = (sin * sin + (PAD_HEIGHT * cos).powi(2)).sqrt();
        let area = 0.5 * core::f32::consts::PI * scale_px * scale_px * (silhouette + sin);
        let found = lit(&drawn(pad, 0.0, false)) as f32;
        // The dome is nearer to the eye than its middle, and its edge is smoothed over a pixel.
        assert!((found / area - 1.0).abs() < 0.10, "{found} of {area}");
    }

    /// In front of the skin the rasteriser draws the ball; below it the ball is translucent, with an outline.
    #[test]
    fn a_ball_is_seen_through_the_skin() {
        let ball = Tool::Ball(0.5 * RADIUS_M);
        assert_eq!(lit(&drawn(ball, 0.009, true)), 0);
        let (half, whole) = (drawn(ball, 0.0, true), drawn(ball, -0.009, true));
        assert!(lit(&half) > 300 && lit(&whole) > 3 * lit(&half) / 2, "{} {}", lit(&half), lit(&whole));
        let middle = whole.pixels().iter().filter(|pixel| **pixel & 0xff > 0xa0).count();
        assert!(middle > 100, "the outline is brighter than the ball: {middle}");
    }

    /// The eye inside the pad, behind it, and a pad without a place: nothing is drawn, and nothing panics.
    #[test]
    fn a_pad_anywhere_is_drawn_or_left_out() {
        let pad = Tool::Fingertip(RADIUS_M);
        let (raster, projection) = view(true);
        for tool_m in [projection.eye_m, 2.0 * projection.eye_m, Vec3::NAN, 1e6 * Vec3::ONE] {
            let touched =
                Touched { tool_m, reach_m: 0.0, contact_m: Vec3::ZERO, normal: Vec3::Z, is_engaged: true };
            let mut image = Image::new(SIZE, SIZE);
            pad.draw_translucent(&touched, (&raster, &projection), &mut StrokeMask::default(), &mut image);
            assert_eq!(lit(&image), 0, "{tool_m}");
        }
    }
}
