//! Light: one warm key, one cool fill, sky and ground, a rim, a wet highlight, and occlusion from the depth buffer.

use super::image::Image;
use super::palette::{linear, linear_from_srgb, srgb_from_linear};
use super::raster::{Raster, Surfel};
use glam::Vec3;

/// Steps of the table from linear light to sRGB.
const ENCODE_STEPS: usize = 4096;
/// Thresholds of a 4 by 4 ordered dither: a dark gradient in 8 bits shows bands without it.
const DITHER: [[f32; 4]; 4] =
    [[0.0, 8.0, 2.0, 10.0], [12.0, 4.0, 14.0, 6.0], [3.0, 11.0, 1.0, 9.0], [15.0, 7.0, 13.0, 5.0]];

/// How a surface answers to light.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Material {
    /// Matt, as a marker.
    #[default]
    Plain,
    /// Moist tissue: light wraps round it, two highlights.
    Tissue,
    /// Hard and shiny, as a tool.
    Polished,
    /// Its own colour whatever the light, slightly shaded for its form.
    Luminous,
}

/// Lights and the background, with the tables for a fast encode.
#[derive(Debug, Clone)]
pub struct Shader {
    encode: Vec<f32>,
    decode: Vec<f32>,
    background: Vec<u32>,
    background_size: (usize, usize),
    occlusion: Vec<u8>,
}

impl Default for Shader {
    fn default() -> Self {
        Self::new()
    }
}

/// Everything about the lights that one sample needs, in the eye frame.
#[derive(Clone, Copy)]
struct Lights {
    key: Vec3,
    fill: Vec3,
    up: Vec3,
}

const KEY_COLOUR: Vec3 = Vec3::new(1.28, 1.20, 1.09);
const FILL_COLOUR: Vec3 = Vec3::new(0.10, 0.14, 0.21);
const SKY_COLOUR: Vec3 = Vec3::new(0.25, 0.27, 0.31);
const GROUND_COLOUR: Vec3 = Vec3::new(0.11, 0.085, 0.08);
const RIM_COLOUR: Vec3 = Vec3::new(0.26, 0.33, 0.43);

impl Shader {
    /// Makes the tables.
    #[must_use]
    pub fn new() -> Self {
        Self {
            encode: (0..ENCODE_STEPS)
                .map(|i| 255.0 * srgb_from_linear(i as f32 / (ENCODE_STEPS - 1) as f32))
                .collect(),
            decode: (0..256).map(|i| linear_from_srgb(i as f32 / 255.0)).collect(),
            background: Vec::new(),
            background_size: (0, 0),
            occlusion: Vec::new(),
        }
    }

    pub(super) fn resolve(&mut self, raster: &Raster, image: &mut Image) {
        let (width, height) = (image.width(), image.height());
        self.prepare_background(width, height);
        image.pixels_mut().copy_from_slice(&self.background);
        let drawn = raster.drawn();
        if drawn.left >= drawn.right {
            return;
        }
        let factor = raster.factor();
        self.occlusion = super::occlusion::ambient(raster, std::mem::take(&mut self.occlusion));
        let projection = *raster.sample_projection();
        let lights = Lights {
            key: Vec3::new(-0.62, 0.66, 0.42).normalize(),
            fill: Vec3::new(0.82, -0.05, 0.57).normalize(),
            up: projection.to_eye * projection.up,
        };
        let surfels = raster.surfels();
        let stride = raster.sample_width();
        let share = ((factor * factor) as f32).recip();
        for y in drawn.top / factor..drawn.bottom.div_ceil(factor) {
            for x in drawn.left / factor..drawn.right.div_ceil(factor) {
                let mut light = Vec3::ZERO;
                let mut covered = 0_usize;
                for sub_y in y * factor..(y + 1) * factor {
                    for sub_x in x * factor..(x + 1) * factor {
                        let surfel = &surfels[sub_y * stride + sub_x];
                        if surfel.inverse_depth <= 0.0 {
                            continue;
                        }
                        covered += 1;
                        let ray = Vec3::new(
                            (sub_x as f32 + 0.5 - projection.centre_px.x) / projection.focal_px,
                            (projection.centre_px.y - sub_y as f32 - 0.5) / projection.focal_px,
                            -1.0,
                        );
                        light += shade(surfel, -ray.normalize(), &lights);
                    }
                }
                if covered == 0 {
                    continue;
                }
                let open = 1.0 - f32::from(self.occlusion[y * width + x]) * (1.0 / 255.0);
                let index = y * width + x;
                let mut mean = light * (share * open);
                if covered < factor * factor {
                    mean += self.unpack(self.background[index]) * (1.0 - covered as f32 * share);
                }
                image.pixels_mut()[index] = self.encode(mean, x, y);
            }
        }
    }

    fn unpack(&self, rgb: u32) -> Vec3 {
        let channel = |shift: u32| self.decode[((rgb >> shift) & 0xff) as usize];
        Vec3::new(channel(16), channel(8), channel(0))
    }

    /// 0xRRGGBB with a soft shoulder towards white and a dither of half a level either way.
    fn encode(&self, light: Vec3, x: usize, y: usize) -> u32 {
        let offset = (DITHER[y % 4][x % 4] + 0.5) / 16.0;
        let channel = |value: f32| {
            let step = (shoulder(value) * (ENCODE_STEPS - 1) as f32) as usize;
            (self.encode[step.min(ENCODE_STEPS - 1)] + offset) as u32
        };
        channel(light.x).min(255) << 16 | channel(light.y).min(255) << 8 | channel(light.z).min(255)
    }

    /// Slate with a soft pool of light behind the organ; computed once per size.
    fn prepare_background(&mut self, width: usize, height: usize) {
        if self.background_size == (width, height) {
            return;
        }
        let (edge, middle, floor) = (linear(0x0f_1318), linear(0x34_3d49), linear(0x1a_1f26));
        let mut background = Vec::with_capacity(width * height);
        for y in 0..height {
            for x in 0..width {
                let u = (x as f32 + 0.5) / width as f32 - 0.5;
                let v = (y as f32 + 0.5) / height as f32 - 0.46;
                let distance = (1.5 * u * u + 2.4 * v * v).sqrt();
                let pool = (-(distance * 2.1) * (distance * 2.1)).exp();
                let lower = ((v - 0.1) / 0.45).clamp(0.0, 1.0);
                let base = edge.lerp(floor, lower * lower * 0.8);
                background.push(self.encode(base.lerp(middle, pool), x, y));
            }
        }
        self.background = background;
        self.background_size = (width, height);
    }
}

/// Linear up to 0.7, then bent so that no highlight clips to a flat patch.
fn shoulder(value: f32) -> f32 {
    const KNEE: f32 = 0.7;
    if value > KNEE {
        let over = value - KNEE;
        KNEE + over / (1.0 + over / (1.0 - KNEE))
    } else if value > 0.0 {
        value
    } else {
        0.0
    }
}

/// Light that leaves one sample towards the eye.
fn shade(surfel: &Surfel, to_eye: Vec3, lights: &Lights) -> Vec3 {
    let mut normal = surfel.normal.normalize_or(Vec3::Z);
    let mut facing = normal.dot(to_eye);
    if facing < 0.0 {
        // An interpolated normal may lean away at the rim of a coarse mesh.
        normal = (normal - to_eye * facing).normalize_or(to_eye);
        facing = 0.0;
    }
    let albedo = surfel.albedo;
    let hemisphere = GROUND_COLOUR.lerp(SKY_COLOUR, 0.5 + 0.5 * normal.dot(lights.up));
    if surfel.material == Material::Luminous {
        return albedo * (0.55 + 0.45 * facing) + albedo * hemisphere * 0.2;
    }
    let tissue = surfel.material == Material::Tissue;
    let incidence = normal.dot(lights.key);
    let lambert = incidence.max(0.0);
    let diffuse = if tissue {
        // Light wraps round the terminator, more of it in red: what scattering inside tissue does to the eye.
        let wrap = |amount: f32| ((incidence + amount) / (1.0 + amount)).max(0.0);
        Vec3::new(wrap(0.24), wrap(0.10), wrap(0.08)) * 0.95
    } else {
        Vec3::splat(lambert)
    };
    let fill = normal.dot(lights.fill).max(0.0);
    let mut light = albedo * (KEY_COLOUR * diffuse + FILL_COLOUR * fill + hemisphere);

    // The half vector is not normalised: its squared length goes into the square of the cosine, which is all that is needed.
    let half = lights.key + to_eye;
    let along = normal.dot(half).max(0.0);
    let squared = along * along / half.length_squared().max(1e-6);
    let grazing = 1.0 - facing;
    let fresnel = grazing * grazing * grazing * grazing;
    let (broad, sharp) = match surfel.material {
        Material::Tissue => (0.020, 0.26),
        Material::Polished => (0.25, 1.4),
        Material::Plain | Material::Luminous => (0.05, 0.0),
    };
    let h4 = squared * squared;
    let h16 = (h4 * h4) * (h4 * h4);
    let h64 = (h16 * h16) * (h16 * h16);
    let visible = (lambert * 4.0).min(1.0);
    light += KEY_COLOUR * (visible * (broad * h16 + sharp * h64 * (0.15 + 0.85 * h16 * h16)));
    // The rim stands for the bright surroundings mirrored at a grazing angle, so it fades where the ground would be.
    light + RIM_COLOUR * (fresnel * (0.45 + 0.55 * normal.dot(lights.up)).max(0.0) * 0.8)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lit(normal: Vec3, material: Material) -> Vec3 {
        let lights = Lights { key: Vec3::Y, fill: Vec3::X, up: Vec3::Y };
        shade(&Surfel { inverse_depth: 1.0, normal, albedo: Vec3::splat(0.5), material }, Vec3::Z, &lights)
    }

    #[test]
    fn the_side_towards_the_key_is_brighter() {
        for material in [Material::Plain, Material::Tissue, Material::Polished] {
            let towards = lit(Vec3::new(0.0, 0.8, 0.6), material);
            let away = lit(Vec3::new(0.0, -0.8, 0.6), material);
            assert!(towards.min_element() > 1.5 * away.max_element(), "{material:?}: {towards} {away}");
        }
    }

    #[test]
    fn a_degenerate_normal_still_gives_a_colour() {
        assert!(lit(Vec3::ZERO, Material::Tissue).is_finite());
        assert!(lit(Vec3::new(0.0, 0.0, -1.0), Material::Polished).is_finite());
    }

    #[test]
    fn the_shoulder_is_monotone_and_below_one() {
        let mut last = -1.0;
        for i in 0..500 {
            let value = shoulder(i as f32 * 0.01);
            assert!(value > last && value < 1.0, "{i}: {value} after {last}");
            last = value;
        }
        assert_eq!(shoulder(f32::NAN), 0.0);
    }
}
