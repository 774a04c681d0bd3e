//! Lighting: a warm key light, a cool fill light, sky and ground, a rim, specular highlights, and ambient
//! occlusion from the depth buffer.

use super::image::Image;
use super::material::Material;
use super::palette::{linear, linear_from_srgb, srgb_from_linear};
use super::raster::{Raster, Surfel};
use glam::Vec3;

/// Steps of the table from the square root of linear light to sRGB: sRGB is nearly linear in the root.
const ENCODE_STEPS: usize = 4096;
/// Steps per unit of the root: the table ends at 16 times white, above which the result is constant.
const STEPS_PER_ROOT: f32 = 1024.0;
/// Thresholds of a 4 by 4 ordered dither, which avoids bands in dark 8-bit gradients.
const DITHER: [[f32; 4]; 4] =
    [[0.0, 8.0, 2.0, 10.0], [12.0, 4.0, 14.0, 6.0], [3.0, 11.0, 1.0, 9.0], [15.0, 7.0, 13.0, 5.0]];

/// Number of samples shaded at once.
const LANES: usize = 8;

/// Lights and background, with tables for fast encoding.
#[derive(Debug, Clone)]
pub struct Shader {
    encode: Vec<f32>,
    decode: Vec<f32>,
    background: Vec<u32>,
    background_size: (usize, usize),
    occlusion: Vec<u8>,
    row: Vec<Pixel>,
}

/// Call of [`Shader::resolve_rows`] for `pulp`.
struct Resolve<'a> {
    shader: &'a mut Shader,
    raster: &'a Raster,
    image: &'a mut Image,
}

impl pulp::WithSimd for Resolve<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        self.shader.resolve_rows(self.raster, self.image);
    }
}

/// Accumulated light of one pixel.
#[derive(Debug, Clone, Copy, Default)]
struct Pixel {
    light: Vec3,
    samples: u32,
}

impl Default for Shader {
    fn default() -> Self {
        Self::new()
    }
}

/// The lights in the eye frame.
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
    /// Computes the tables.
    #[must_use]
    pub fn new() -> Self {
        Self {
            encode: (0..ENCODE_STEPS)
                .map(|i| (i as f32 + 0.5) / STEPS_PER_ROOT)
                .map(|root| (255.0 * srgb_from_linear(shoulder(root * root))).min(254.99))
                .collect(),
            decode: (0..256).map(|i| linear_from_srgb(i as f32 / 255.0)).collect(),
            background: Vec::new(),
            background_size: (0, 0),
            occlusion: Vec::new(),
            row: Vec::new(),
        }
    }

    /// Shades the visible samples over the background.
    pub fn resolve(&mut self, raster: &Raster, image: &mut Image) {
        let (width, height) = (image.width(), image.height());
        self.prepare_background(width, height);
        image.pixels_mut().copy_from_slice(&self.background);
        let drawn = raster.drawn();
        if drawn.left >= drawn.right {
            return;
        }
        self.occlusion = super::occlusion::ambient(raster, std::mem::take(&mut self.occlusion));
        self.row.resize(width, Pixel::default());
        // Compiled for several vector instruction sets; selected at run time.
        pulp::Arch::new().dispatch(Resolve { shader: self, raster, image });
    }

    #[inline(always)]
    fn resolve_rows(&mut self, raster: &Raster, image: &mut Image) {
        let (width, factor, drawn) = (image.width(), raster.factor(), raster.drawn());
        let projection = *raster.sample_projection();
        let lights = Lights {
            key: Vec3::new(-0.62, 0.66, 0.42).normalize(),
            fill: Vec3::new(0.82, -0.05, 0.57).normalize(),
            up: projection.to_eye * projection.up,
        };
        let (left, right) = (drawn.left / factor, drawn.right.div_ceil(factor));
        for y in drawn.top / factor..drawn.bottom.div_ceil(factor) {
            self.row[left..right].fill(Pixel::default());
            for sub_y in y * factor..(y + 1) * factor {
                self.light_row(raster, (left * factor, right * factor), sub_y, &lights);
            }
            self.encode_row(image, (left, right), (y, width), factor);
        }
    }

    /// Adds the light of one row of samples to its pixels.
    #[inline(always)]
    fn light_row(&mut self, raster: &Raster, (left, right): (usize, usize), sub_y: usize, lights: &Lights) {
        let projection = raster.sample_projection();
        let to_ray = projection.focal_px.recip();
        let ray_y = (projection.centre_px.y - sub_y as f32 - 0.5) * to_ray;
        let samples = &raster.surfels()[sub_y * raster.sample_width()..][left..right];
        let factor = raster.factor();
        for (block, surfels) in samples.chunks(LANES).enumerate() {
            let first = left + block * LANES;
            let covered = surfels.iter().filter(|surfel| surfel.inverse_depth > 0.0).count();
            if covered == 0 {
                continue;
            }
            let ray_x = (first as f32 + 0.5 - projection.centre_px.x) * to_ray;
            let ray = (ray_x, ray_y, to_ray);
            let (mut shaded, mut light) = (None, [[0.0; LANES]; 3]);
            for (lane, surfel) in surfels.iter().enumerate() {
                if surfel.inverse_depth <= 0.0 {
                    continue;
                }
                // Nearly all blocks have one material.
                if shaded != Some(surfel.material) {
                    light = shade_block(surfels, ray, lights, &Reflectance::of(surfel.material));
                    shaded = Some(surfel.material);
                }
                let own = Vec3::new(light[0][lane], light[1][lane], light[2][lane]);
                if factor == 1 {
                    // Store without reading: a sum would wait for its own last store.
                    self.row[first + lane] = Pixel { light: own, samples: 1 };
                    continue;
                }
                let pixel = &mut self.row[(first + lane) / factor];
                pixel.light += own;
                pixel.samples += 1;
            }
        }
    }

    /// Blends one row over the background.
    #[inline(always)]
    fn encode_row(
        &self,
        image: &mut Image,
        (left, right): (usize, usize),
        (y, width): (usize, usize),
        factor: usize,
    ) {
        let share = ((factor * factor) as f32).recip();
        let row = y * width;
        let pixels = &mut image.pixels_mut()[row + left..row + right];
        let occlusion = &self.occlusion[row + left..row + right];
        for (lane, (pixel, closed)) in pixels.iter_mut().zip(occlusion).enumerate() {
            let Pixel { light, samples } = self.row[left + lane];
            if samples == 0 {
                continue;
            }
            let open = 1.0 - f32::from(*closed) * (1.0 / 255.0);
            let mut mean = light * (share * open);
            if (samples as usize) < factor * factor {
                mean += self.unpack(*pixel) * (1.0 - samples as f32 * share);
            }
            *pixel = self.encode(mean, left + lane, y);
        }
    }

    fn unpack(&self, rgb: u32) -> Vec3 {
        let channel = |shift: u32| self.decode[((rgb >> shift) & 0xff) as usize];
        Vec3::new(channel(16), channel(8), channel(0))
    }

    /// 0xRRGGBB with a soft shoulder towards white and a dither of half a level in either direction.
    #[inline(always)]
    fn encode(&self, light: Vec3, x: usize, y: usize) -> u32 {
        let offset = (DITHER[y % 4][x % 4] + 0.5) / 16.0;
        let channel = |value: f32| {
            let step = (value.max(0.0).sqrt() * STEPS_PER_ROOT) as i32 as usize;
            // At most 255 including the offset: the table ends below white.
            (self.encode[step.min(ENCODE_STEPS - 1)] + offset) as i32 as u32
        };
        channel(light.x) << 16 | channel(light.y) << 8 | channel(light.z)
    }

    /// Slate with a soft light spot behind the organ; computed once per size.
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

/// Linear up to 0.7, then compressed so that highlights do not clip.
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

/// Strength of each kind of reflection of a material.
#[derive(Debug, Clone, Copy)]
struct Reflectance {
    /// Diffuse light of the key.
    diffuse: f32,
    /// Wrap of that light round the terminator, by colour.
    wrap: [f32; 3],
    /// Light of the fill, and of the rim.
    around: f32,
    /// Light of sky and ground.
    sky: f32,
    /// Broad and sharp highlight.
    gloss: [f32; 2],
    /// Light of its own.
    glow: f32,
}

impl Reflectance {
    const fn of(material: Material) -> Self {
        let plain =
            Self { diffuse: 1.0, wrap: [0.0; 3], around: 1.0, sky: 1.0, gloss: [0.05, 0.0], glow: 0.0 };
        match material {
            Material::Plain => plain,
            // More wrap in red approximates scattering inside tissue.
            Material::Tissue => {
                Self { diffuse: 0.95, wrap: [0.24, 0.10, 0.08], gloss: [0.020, 0.26], ..plain }
            }
            Material::Polished => Self { gloss: [0.25, 1.4], ..plain },
            Material::Luminous => {
                Self { diffuse: 0.0, around: 0.0, sky: 0.2, gloss: [0.0; 2], glow: 1.0, ..plain }
            }
        }
    }
}

/// Light, by colour, of up to [`LANES`] samples of one row as if all were of one material.
///
/// Lanes without a sample contain arbitrary values that are not read. There is one array per component, so
/// that the compiler turns the loop into vector instructions.
#[inline(always)]
fn shade_block(
    surfels: &[Surfel],
    (ray_x, ray_y, step): (f32, f32, f32),
    lights: &Lights,
    reflectance: &Reflectance,
) -> [[f32; LANES]; 3] {
    let [mut normal, mut albedo, mut light] = [[[0.0; LANES]; 3]; 3];
    for (lane, surfel) in surfels.iter().enumerate().take(LANES) {
        for axis in 0..3 {
            normal[axis][lane] = surfel.normal[axis];
            albedo[axis][lane] = surfel.albedo[axis];
        }
    }
    for lane in 0..LANES {
        let normal = Vec3::new(normal[0][lane], normal[1][lane], normal[2][lane]);
        let albedo = Vec3::new(albedo[0][lane], albedo[1][lane], albedo[2][lane]);
        let ray = Vec3::new(ray_x + lane as f32 * step, ray_y, -1.0);
        let own = shade(normal, albedo, ray, lights, reflectance);
        [light[0][lane], light[1][lane], light[2][lane]] = own.to_array();
    }
    light
}

/// Light of one sample towards the eye, seen along `ray`. Without branches, see [`shade_block`].
#[inline(always)]
fn shade(normal: Vec3, albedo: Vec3, ray: Vec3, lights: &Lights, reflectance: &Reflectance) -> Vec3 {
    let to_eye = -ray * ray.length_recip();
    let normal = unit(normal);
    let facing = normal.dot(to_eye);
    // At the rim of a coarse mesh an interpolated normal may face away.
    let normal = unit(normal - to_eye * (facing - at_least(facing, 0.0)));
    let facing = at_least(facing, 0.0);
    let incidence = normal.dot(lights.key);
    let upward = normal.dot(lights.up);

    let wrapped = |wrap: f32| at_least(incidence + wrap, 0.0) * (reflectance.diffuse / (1.0 + wrap));
    let [r, g, b] = reflectance.wrap;
    let diffuse = Vec3::new(wrapped(r), wrapped(g), wrapped(b));
    let fill = reflectance.around * at_least(normal.dot(lights.fill), 0.0);
    let hemisphere = reflectance.sky * GROUND_COLOUR.lerp(SKY_COLOUR, 0.5 + 0.5 * upward);
    let glow = reflectance.glow * (0.55 + 0.45 * facing);

    // The half vector is not normalised: only the square of the cosine is needed, which uses its squared
    // length.
    let half = lights.key + to_eye;
    let along = at_least(normal.dot(half), 0.0);
    let squared = along * along / at_least(half.length_squared(), 1e-6);
    let h4 = squared * squared;
    let h16 = (h4 * h4) * (h4 * h4);
    let h64 = (h16 * h16) * (h16 * h16);
    let visible = 1.0 - at_least(1.0 - 4.0 * at_least(incidence, 0.0), 0.0);
    let [broad, sharp] = reflectance.gloss;
    let gloss = visible * (broad * h16 + sharp * h64 * (0.15 + 0.85 * h16 * h16));
    // The rim models the bright surroundings reflected at a grazing angle, so it fades towards the ground.
    let grazing = 1.0 - facing;
    let fresnel = (grazing * grazing) * (grazing * grazing);
    let rim = reflectance.around * 0.8 * fresnel * at_least(0.45 + 0.55 * upward, 0.0);

    let lit = KEY_COLOUR * diffuse + FILL_COLOUR * fill + hemisphere + glow;
    albedo * lit + KEY_COLOUR * gloss + RIM_COLOUR * rim
}

#[inline(always)]
fn unit(vector: Vec3) -> Vec3 {
    vector * at_least(vector.length_squared(), 1e-30).sqrt().recip()
}

/// Larger of two values in one instruction; `f32::max` needs more because it does not propagate NaN.
#[inline(always)]
fn at_least(value: f32, low: f32) -> f32 {
    if value > low { value } else { low }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lit(normal: Vec3, material: Material) -> Vec3 {
        let lights = Lights { key: Vec3::Y, fill: Vec3::X, up: Vec3::Y };
        shade(normal, Vec3::splat(0.5), -Vec3::Z, &lights, &Reflectance::of(material))
    }

    #[test]
    fn the_side_towards_the_key_is_brighter() {
        for material in [Material::Plain, Material::Tissue, Material::Polished] {
            let towards = lit(Vec3::new(0.0, 0.8, 0.6), material);
            let away = lit(Vec3::new(0.0, -0.8, 0.6), material);
            assert!(towards.min_element() > 1.5 * away.max_element(), "{material:?}: {towards} {away}");
        }
    }

    /// The lanes of a block do not depend on each other, and a luminous mark is lit from everywhere.
    #[test]
    fn blocks_are_shaded_as_single_samples() {
        let up = Vec3::new(0.1, 0.9, 0.3).normalize();
        let lights = Lights { key: Vec3::new(-0.6, 0.7, 0.4).normalize(), fill: Vec3::X, up };
        let angle = |i: usize, rate: f32| (i as f32 * rate).sin();
        let surfels: Vec<Surfel> = (0..LANES)
            .map(|i| Surfel {
                inverse_depth: 1.0,
                // Some face away from the eye.
                normal: 3.0 * Vec3::new(angle(i, 1.7), angle(i, 2.9), angle(i, 0.9)),
                albedo: Vec3::new(0.5, 0.3 + 0.02 * i as f32, 0.2),
                material: Material::Tissue,
            })
            .collect();
        let (ray_x, ray_y, step) = (-0.3, 0.2, 0.04);
        for material in [Material::Plain, Material::Tissue, Material::Polished, Material::Luminous] {
            let reflectance = Reflectance::of(material);
            let light = shade_block(&surfels, (ray_x, ray_y, step), &lights, &reflectance);
            for (lane, surfel) in surfels.iter().enumerate() {
                let ray = Vec3::new(ray_x + lane as f32 * step, ray_y, -1.0);
                let one = shade(surfel.normal, surfel.albedo, ray, &lights, &reflectance);
                let many = Vec3::from_array(light.map(|colour| colour[lane]));
                assert!((one - many).length() < 1e-5, "{lane}: {one} {many}");
            }
            let broken = Surfel { normal: Vec3::ZERO, ..surfels[1] };
            let light = shade_block(&[broken], (ray_x, ray_y, step), &lights, &reflectance);
            assert!(light.iter().all(|colour| colour[0].is_finite()), "{light:?}");
        }
        let glow = |normal| lit(normal, Material::Luminous).max_element();
        assert!(glow(-Vec3::Y) > 0.5 * glow(Vec3::Y), "{} {}", glow(-Vec3::Y), glow(Vec3::Y));
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
