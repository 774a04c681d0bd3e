//! Lighting: a warm key light, a cool fill light, sky and ground, a rim, specular highlights, and ambient
//! occlusion from the depth buffer.

use super::image::Image;
use super::lanes::{LANES, Lanes, dot, unit};
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
/// Wrap of the diffuse light round the terminator of tissue, by colour.
const TISSUE_WRAP: [f32; 3] = [0.24, 0.10, 0.08];
/// Strength of the broad and the sharp highlight of tissue.
const TISSUE_GLOSS: (f32, f32) = (0.020, 0.26);
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
            // Nearly all samples are tissue; the others are recomputed one by one.
            let light = shade_tissue(surfels, (ray_x, ray_y, to_ray), lights);
            for (lane, surfel) in surfels.iter().enumerate() {
                if surfel.inverse_depth <= 0.0 {
                    continue;
                }
                let own = if surfel.material == Material::Tissue {
                    Vec3::new(light[0].0[lane], light[1].0[lane], light[2].0[lane])
                } else {
                    let ray = Vec3::new(ray_x + lane as f32 * to_ray, ray_y, -1.0);
                    shade(surfel, -ray.normalize(), lights)
                };
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

/// Light of tissue for up to [`LANES`] samples of one row, by colour: the vectorised form of [`shade`].
///
/// Lanes without a sample contain arbitrary values that are not read.
#[inline(always)]
fn shade_tissue(surfels: &[Surfel], (ray_x, ray_y, step): (f32, f32, f32), lights: &Lights) -> [Lanes; 3] {
    let mut normal = [Lanes::of(0.0); 3];
    let mut albedo = [Lanes::of(0.0); 3];
    for (lane, surfel) in surfels.iter().enumerate().take(LANES) {
        for axis in 0..3 {
            normal[axis].0[lane] = surfel.normal[axis];
            albedo[axis].0[lane] = surfel.albedo[axis];
        }
    }
    let mut x = Lanes::of(ray_x);
    x.0.iter_mut().enumerate().for_each(|(lane, x)| *x += lane as f32 * step);
    let y = Lanes::of(ray_y);
    let one = Lanes::of(1.0);
    let nothing = Lanes::of(0.0);

    let inverse = one / (x * x + y * y + one).root();
    let eye = [nothing - x * inverse, nothing - y * inverse, inverse];
    let n = unit(normal);
    let facing = dot(n, eye);
    // At the rim of a coarse mesh an interpolated normal may face away.
    let away = facing.at_most(0.0);
    let n = unit([n[0] - eye[0] * away, n[1] - eye[1] * away, n[2] - eye[2] * away]);
    let facing = facing.at_least(0.0);

    let [key, fill, up] = [lights.key, lights.fill, lights.up].map(|light| light.to_array().map(Lanes::of));
    let incidence = dot(n, key);
    let filled = dot(n, fill).at_least(0.0);
    let upward = dot(n, up);
    let sky = upward * Lanes::of(0.5) + Lanes::of(0.5);
    let half = [key[0] + eye[0], key[1] + eye[1], key[2] + eye[2]];
    let along = dot(n, half).at_least(0.0);
    let squared = along * along / dot(half, half).at_least(1e-6);
    let h4 = squared * squared;
    let h16 = (h4 * h4) * (h4 * h4);
    let h64 = (h16 * h16) * (h16 * h16);
    let visible = (incidence.at_least(0.0) * Lanes::of(4.0)).at_most(1.0);
    let sharp = h64 * (Lanes::of(0.15) + Lanes::of(0.85) * h16 * h16);
    let gloss = visible * (Lanes::of(TISSUE_GLOSS.0) * h16 + Lanes::of(TISSUE_GLOSS.1) * sharp);
    let grazing = one - facing;
    let fresnel = (grazing * grazing) * (grazing * grazing);
    let rim = fresnel * (Lanes::of(0.45) + Lanes::of(0.55) * upward).at_least(0.0) * Lanes::of(0.8);
    core::array::from_fn(|colour| {
        let wrap = TISSUE_WRAP[colour];
        let diffuse = (incidence + Lanes::of(wrap)).at_least(0.0) * Lanes::of(0.95 / (1.0 + wrap));
        let hemisphere = Lanes::of(GROUND_COLOUR[colour]) * (one - sky) + Lanes::of(SKY_COLOUR[colour]) * sky;
        let lit =
            Lanes::of(KEY_COLOUR[colour]) * diffuse + Lanes::of(FILL_COLOUR[colour]) * filled + hemisphere;
        albedo[colour] * lit + Lanes::of(KEY_COLOUR[colour]) * gloss + Lanes::of(RIM_COLOUR[colour]) * rim
    })
}

/// Light from one sample towards the eye.
fn shade(surfel: &Surfel, to_eye: Vec3, lights: &Lights) -> Vec3 {
    let mut normal = surfel.normal.normalize_or(Vec3::Z);
    let mut facing = normal.dot(to_eye);
    if facing < 0.0 {
        // At the rim of a coarse mesh an interpolated normal may face away.
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
        // Diffuse light wraps round the terminator, more in red, which approximates scattering inside tissue.
        let wrap = |amount: f32| ((incidence + amount) / (1.0 + amount)).max(0.0);
        Vec3::from_array(TISSUE_WRAP.map(wrap)) * 0.95
    } else {
        Vec3::splat(lambert)
    };
    let fill = normal.dot(lights.fill).max(0.0);
    let mut light = albedo * (KEY_COLOUR * diffuse + FILL_COLOUR * fill + hemisphere);

    // The half vector is not normalised: only the square of the cosine is needed, which uses its squared
    // length.
    let half = lights.key + to_eye;
    let along = normal.dot(half).max(0.0);
    let squared = along * along / half.length_squared().max(1e-6);
    let grazing = 1.0 - facing;
    let fresnel = grazing * grazing * grazing * grazing;
    let (broad, sharp) = match surfel.material {
        Material::Tissue => TISSUE_GLOSS,
        Material::Polished => (0.25, 1.4),
        Material::Plain | Material::Luminous => (0.05, 0.0),
    };
    let h4 = squared * squared;
    let h16 = (h4 * h4) * (h4 * h4);
    let h64 = (h16 * h16) * (h16 * h16);
    let visible = (lambert * 4.0).min(1.0);
    light += KEY_COLOUR * (visible * (broad * h16 + sharp * h64 * (0.15 + 0.85 * h16 * h16)));
    // The rim models the bright surroundings reflected at a grazing angle, so it fades towards the ground.
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

    /// The vectorised code must equal the code for one sample.
    #[test]
    fn rows_of_tissue_are_shaded_as_single_samples() {
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
        let light = shade_tissue(&surfels, (ray_x, ray_y, step), &lights);
        for (lane, surfel) in surfels.iter().enumerate().skip(1) {
            let ray = Vec3::new(ray_x + lane as f32 * step, ray_y, -1.0);
            let one = shade(surfel, -ray.normalize(), &lights);
            let many = Vec3::new(light[0].0[lane], light[1].0[lane], light[2].0[lane]);
            assert!((one - many).length() < 1e-5, "{lane}: {one} {many}");
        }
        let broken = Surfel { normal: Vec3::ZERO, ..surfels[1] };
        let light = shade_tissue(&[broken], (ray_x, ray_y, step), &lights);
        assert!(light.iter().all(|colour| colour.0[0].is_finite()), "{light:?}");
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
