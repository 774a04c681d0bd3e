//! A palette of 255 colours for a whole film: median cut over the colours of the first picture and those
//! expected later.
//!
//! The crate `color_quant` was tried on the same samples: its network moves rare colours towards frequent ones,
//! and the force was drawn 40 of 255 levels off in red, where a median cut stays within 24.

use super::image::Image;
use super::palette::{ColourMap, packed};
use super::scene::{ACTIVE_COLOUR, FIXED_COLOUR, FORCE_COLOUR};

/// Number of colours; one more index is reserved for unchanged pixels.
pub(super) const COLOURS: usize = 255;
/// Levels per channel in the histogram and the look-up table.
const LEVELS: usize = 32;

/// Thresholds of the ordered dither, 0 to 15.
const DITHER: [[i32; 4]; 4] = [[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]];

/// A palette and its nearest-colour table.
#[derive(Debug, Clone)]
pub(super) struct Palette {
    colours: Vec<[u8; 3]>,
    nearest: Vec<u8>,
}

impl Palette {
    /// The palette of a film that begins with this picture.
    pub(super) fn new(first: &Image) -> Self {
        let mut weight = vec![0.0_f32; LEVELS * LEVELS * LEVELS];
        let mut seen = vec![0_u32; weight.len()];
        for (at, pixel) in first.pixels().iter().enumerate() {
            seen[dithered(*pixel, at % first.width(), at / first.width())] += 1;
        }
        // The square root reduces the weight of the large dark background.
        weight.iter_mut().zip(&seen).for_each(|(weight, seen)| *weight = (*seen as f32).sqrt());
        for colour in expected() {
            weight[cell(colour)] += 12.0;
        }
        let mut cells: Vec<([i32; 3], f32)> = weight
            .iter()
            .enumerate()
            .filter(|(_, weight)| **weight > 0.0)
            .map(|(index, weight)| (place(index), *weight))
            .collect();
        let colours = median_cut(&mut cells);
        let nearest = (0..weight.len()).map(|index| nearest(&colours, place(index))).collect();
        Self { colours, nearest }
    }

    /// Red, green and blue of every colour.
    pub(super) fn bytes(&self) -> Vec<u8> {
        let mut bytes = self.colours.as_flattened().to_vec();
        bytes.resize(3 * (COLOURS + 1), 0);
        bytes
    }

    /// Palette index of a pixel at a position.
    pub(super) fn index(&self, pixel: u32, x: usize, y: usize) -> u8 {
        self.nearest[dithered(pixel, x, y)]
    }
}

/// Colours that may occur later: the whole colour map at several brightnesses, and the markers.
fn expected() -> impl Iterator<Item = u32> {
    let map = ColourMap::new();
    let shades = [0.08, 0.2, 0.4, 0.7, 1.0, 1.3];
    let tissue = (0..=20).flat_map(move |i| {
        let colour = map.linear(i as f32 / 20.0);
        shades.map(|shade| packed(colour * shade))
    });
    tissue.chain([FORCE_COLOUR, ACTIVE_COLOUR, FIXED_COLOUR, 0x00_0000, 0xff_ffff])
}

/// Histogram cell of a pixel after ordered dithering of half a cell in either direction, which avoids bands.
/// The pattern is fixed to the picture, so static parts do not change between frames.
fn dithered(pixel: u32, x: usize, y: usize) -> usize {
    let offset = DITHER[y % 4][x % 4] / 2 - 4;
    let channel = |shift: u32| ((pixel >> shift & 255) as i32 + offset).clamp(0, 255) as u32;
    cell(channel(16) << 16 | channel(8) << 8 | channel(0))
}

fn cell(pixel: u32) -> usize {
    let level = |shift: u32| (pixel >> (shift + 3) & 31) as usize;
    (level(16) * LEVELS + level(8)) * LEVELS + level(0)
}

/// Centre of a histogram cell, 0 to 255 per channel.
fn place(index: usize) -> [i32; 3] {
    [index / (LEVELS * LEVELS), index / LEVELS % LEVELS, index % LEVELS].map(|level| 8 * level as i32 + 4)
}

/// Splits the box with the largest variance until there are enough; each colour is the mean of its box.
fn median_cut(cells: &mut [([i32; 3], f32)]) -> Vec<[u8; 3]> {
    // Start, end, and reduction of the variance by a split.
    let mut boxes = vec![(0, cells.len(), spread(cells).1)];
    while boxes.len() < COLOURS {
        let widest = (0..boxes.len()).max_by(|a, b| boxes[*a].2.total_cmp(&boxes[*b].2));
        let Some((index, (start, end, gain))) = widest.map(|index| (index, boxes[index])) else { break };
        if gain <= 0.0 {
            break;
        }
        let part = &mut cells[start..end];
        let axis = spread(part).0;
        part.sort_by_key(|(place, _)| place[axis]);
        let half = 0.5 * part.iter().map(|(_, weight)| weight).sum::<f32>();
        let mut sum = 0.0;
        let cut = part.iter().position(|(_, weight)| {
            sum += weight;
            sum >= half
        });
        let cut = start + cut.unwrap_or(0).clamp(0, part.len() - 2) + 1;
        boxes[index] = (start, cut, spread(&cells[start..cut]).1);
        boxes.push((cut, end, spread(&cells[cut..end]).1));
    }
    boxes.iter().map(|(start, end, _)| mean(&cells[*start..*end])).collect()
}

/// Axis with the largest extent of a box, and the weighted variance along it.
fn spread(cells: &[([i32; 3], f32)]) -> (usize, f32) {
    let total: f32 = cells.iter().map(|(_, weight)| weight).sum();
    let variance = |axis: usize| {
        let of = |place: &[i32; 3]| place[axis] as f32;
        let middle = cells.iter().map(|(place, weight)| of(place) * weight).sum::<f32>() / total;
        cells.iter().map(|(place, weight)| (of(place) - middle).powi(2) * weight).sum::<f32>()
    };
    let variances = [0, 1, 2].map(variance);
    let axis = (0..3).max_by(|a, b| variances[*a].total_cmp(&variances[*b])).unwrap_or(0);
    (axis, if cells.len() < 2 { 0.0 } else { variances[axis] })
}

fn mean(cells: &[([i32; 3], f32)]) -> [u8; 3] {
    let total: f32 = cells.iter().map(|(_, weight)| weight).sum();
    core::array::from_fn(|axis| {
        let sum: f32 = cells.iter().map(|(place, weight)| place[axis] as f32 * weight).sum();
        (sum / total.max(1e-9)).round() as u8
    })
}

fn nearest(colours: &[[u8; 3]], place: [i32; 3]) -> u8 {
    let distance = |colour: &[u8; 3]| -> i32 {
        // Weights of perception: green highest, blue lowest.
        (0..3).map(|axis| [3, 4, 2][axis] * (i32::from(colour[axis]) - place[axis]).pow(2)).sum()
    };
    let best = colours.iter().enumerate().min_by_key(|(_, colour)| distance(colour));
    best.map_or(0, |(index, _)| index as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The mean over the dither pattern is the colour itself, also between two cells.
    #[test]
    fn a_smooth_grey_stays_smooth() {
        let mut image = Image::new(256, 16);
        for (at, pixel) in image.pixels_mut().iter_mut().enumerate() {
            *pixel = 0x01_0101 * (at as u32 % 256);
        }
        let palette = Palette::new(&image);
        for level in 8..248_u32 {
            let places = (0..16).map(|place| (place % 4, place / 4));
            let shown =
                places.map(|(x, y)| palette.colours[usize::from(palette.index(0x01_0101 * level, x, y))][1]);
            let mean = shown.map(f32::from).sum::<f32>() / 16.0;
            assert!((mean - level as f32).abs() < 2.5, "{level} as {mean}");
        }
    }

    #[test]
    fn colours_of_the_picture_and_expected_colours_are_matched() {
        let mut image = Image::new(64, 64);
        for (i, pixel) in image.pixels_mut().iter_mut().enumerate() {
            let level = (i % 64) as u32 / 2;
            *pixel = level << 16 | (level + 4) << 8 | (level + 9);
        }
        let palette = Palette::new(&image);
        assert!(palette.colours.len() <= COLOURS && palette.bytes().len() == 768);
        let later: Vec<u32> = expected().collect();
        for pixel in image.pixels().iter().chain(&later) {
            let found = palette.colours[usize::from(palette.index(*pixel, 1, 2))];
            for (channel, shift) in found.into_iter().zip([16, 8, 0]) {
                let error = (i32::from(channel) - (pixel >> shift & 255) as i32).abs();
                assert!(error <= 24, "{pixel:06x} as {found:?}");
            }
        }
    }
}
