//! Colours: conversions between sRGB, linear light and OKLab, the displacement colour map, and the colours of
//! text.

use glam::Vec3;

/// Names and values, 0xRRGGBB.
pub(super) const BRIGHT: u32 = 0xed_f1f5;
/// Labels, 0xRRGGBB.
pub(super) const MUTED: u32 = 0x93_9eab;
/// Rules of charts, 0xRRGGBB.
pub(super) const FAINT: u32 = 0x5a_6572;
/// A value in order, 0xRRGGBB.
pub(super) const GOOD: u32 = 0x7f_d8a6;
/// A value that needs attention, 0xRRGGBB.
pub(super) const WAITING: u32 = 0xf0_c268;
/// A fault, 0xRRGGBB.
pub(super) const BAD: u32 = 0xff_6f61;

/// Entries of the colour map's look-up table.
const MAP_SIZE: usize = 256;

/// sRGB (0..1) of one channel from linear light.
#[must_use]
pub fn srgb_from_linear(linear: f32) -> f32 {
    if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

/// Linear light of one channel from sRGB (0..1).
#[must_use]
pub fn linear_from_srgb(srgb: f32) -> f32 {
    if srgb <= 0.040_45 { srgb / 12.92 } else { ((srgb + 0.055) / 1.055).powf(2.4) }
}

/// Linear light from 0xRRGGBB.
#[must_use]
pub fn linear(rgb: u32) -> Vec3 {
    let channel = |shift: u32| linear_from_srgb(((rgb >> shift) & 0xff) as f32 / 255.0);
    Vec3::new(channel(16), channel(8), channel(0))
}

/// 0xRRGGBB from linear light, clamped.
#[must_use]
pub fn packed(linear: Vec3) -> u32 {
    let channel = |value: f32| (srgb_from_linear(value.clamp(0.0, 1.0)) * 255.0 + 0.5) as u32;
    channel(linear.x) << 16 | channel(linear.y) << 8 | channel(linear.z)
}

/// Linear light from OKLab (Ottosson 2020): lightness, green-red, blue-yellow.
#[must_use]
pub fn linear_from_oklab(lab: Vec3) -> Vec3 {
    let cube = |value: f32| value * value * value;
    let long = cube(lab.x + 0.396_337_78 * lab.y + 0.215_803_76 * lab.z);
    let medium = cube(lab.x - 0.105_561_346 * lab.y - 0.063_854_17 * lab.z);
    let short = cube(lab.x - 0.089_484_18 * lab.y - 1.291_485_5 * lab.z);
    Vec3::new(
        4.076_741_7 * long - 3.307_711_6 * medium + 0.230_969_94 * short,
        -1.268_438 * long + 2.609_757_4 * medium - 0.341_319_4 * short,
        -0.004_196_086_3 * long - 0.703_418_6 * medium + 1.707_614_7 * short,
    )
}

/// Colour map of the displacement: from the dark red of liver at rest through orange to pale yellow.
///
/// The OKLab lightness rises linearly from 0.37 to 0.93 while the hue changes from red to yellow. Equal steps
/// of displacement are perceived as equal steps, and the map is readable in greyscale print. Common maps
/// start almost black, which would hide an organ at rest in a dark picture.
#[derive(Debug, Clone)]
pub struct ColourMap {
    table: Vec<Vec3>,
}

impl Default for ColourMap {
    fn default() -> Self {
        Self::new()
    }
}

impl ColourMap {
    /// Computes the table.
    #[must_use]
    pub fn new() -> Self {
        let table = (0..MAP_SIZE).map(|i| Self::exact(i as f32 / (MAP_SIZE - 1) as f32)).collect();
        Self { table }
    }

    fn exact(t: f32) -> Vec3 {
        let lightness = 0.37 + 0.56 * t;
        let hue = (28.0 + 77.0 * t).to_radians();
        // The chroma rises to the maximum of sRGB at medium lightness and decreases towards pale yellow.
        let chroma = 0.090 + 0.30 * t * (1.0 - t) * (1.0 - 0.25 * t) + 0.015 * t;
        let lab = Vec3::new(lightness, chroma * hue.cos(), chroma * hue.sin());
        linear_from_oklab(lab).clamp(Vec3::ZERO, Vec3::ONE)
    }

    /// Linear light of the colour at `t` in 0..1. Values out of range are clamped; NaN gives the colour of 0.
    #[must_use]
    pub fn linear(&self, t: f32) -> Vec3 {
        let position = t.clamp(0.0, 1.0) * (MAP_SIZE - 1) as f32;
        let low = (position as usize).min(MAP_SIZE - 2);
        let fraction = if position.is_finite() { position - low as f32 } else { 0.0 };
        self.table[low].lerp(self.table[low + 1], fraction)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_round_trip() {
        for value in 0..=0xff_u32 {
            let grey = value << 16 | value << 8 | value;
            assert_eq!(packed(linear(grey)), grey);
        }
    }

    #[test]
    fn oklab_white_and_grey_are_neutral() {
        let white = linear_from_oklab(Vec3::new(1.0, 0.0, 0.0));
        assert!((white - Vec3::ONE).abs().max_element() < 1e-3, "{white}");
    }

    /// The perceived lightness rises monotonically, in nearly equal steps.
    #[test]
    fn lightness_rises_evenly() {
        let map = ColourMap::new();
        let lightness = |t: f32| {
            let colour = map.linear(t);
            let luminance = colour.dot(Vec3::new(0.2126, 0.7152, 0.0722));
            116.0 * luminance.cbrt() - 16.0
        };
        let steps: Vec<f32> =
            (0..20).map(|i| lightness((i + 1) as f32 / 20.0) - lightness(i as f32 / 20.0)).collect();
        let mean = steps.iter().sum::<f32>() / steps.len() as f32;
        for step in &steps {
            assert!(*step > 0.6 * mean && *step < 1.4 * mean, "{step} against a mean of {mean}: {steps:?}");
        }
    }

    #[test]
    fn the_map_accepts_any_number() {
        let map = ColourMap::new();
        assert_eq!(map.linear(f32::NAN), map.linear(0.0));
        assert_eq!(map.linear(-3.0), map.linear(0.0));
        assert_eq!(map.linear(f32::INFINITY), map.linear(1.0));
    }
}
