//! Text on the picture, in DejaVu Sans Condensed.
//!
//! The font covers Latin with its diacritics, Greek, Cyrillic, Armenian, Georgian and symbols. Characters are
//! placed one by one from left to right, so Hebrew is not reversed and Arabic letters are not joined. A
//! character outside the font, such as Chinese, is drawn as the font's box with a question mark.

use super::image::Image;
use ab_glyph::{Font, FontRef, GlyphId, point};
use std::collections::HashMap;

/// The font file, with its licence beside it.
const FONT: &[u8] = include_bytes!("../font/DejaVuSansCondensed.ttf");
/// Height of a capital, font units.
const CAPITAL: f32 = 1493.0;
/// Horizontal positions of a glyph within a pixel.
const POSITIONS: f32 = 4.0;
/// Colour of a halo and its opacity at one of its eight positions.
const HALO: (u32, f32) = (0x10_0c0a, 0.3);

/// Edge of a line of text at the given position.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Align {
    /// The position is the left end.
    Left,
    /// The position is the middle.
    Centre,
    /// The position is the right end.
    Right,
}

/// Size and colour of a line of text.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TextStyle {
    /// Height of a capital, pixels.
    pub height_px: f32,
    /// 0xRRGGBB.
    pub colour: u32,
    /// Opacity.
    pub alpha: f32,
}

impl TextStyle {
    /// An opaque style.
    #[must_use]
    pub const fn new(height_px: f32, colour: u32) -> Self {
        Self { height_px, colour, alpha: 1.0 }
    }
}

/// Coverage of a drawn glyph, relative to its pen position.
#[derive(Debug, Clone, Default)]
struct Bitmap {
    left: i32,
    top: i32,
    width: usize,
    coverage: Vec<f32>,
}

/// The typeface. Drawn glyphs are kept: a session uses a few sizes and characters, frame after frame.
#[derive(Debug, Clone)]
pub struct Typeface {
    font: FontRef<'static>,
    /// By glyph, height in bits, and position within a pixel.
    drawn: HashMap<(GlyphId, u32, u8), Bitmap>,
}

impl Default for Typeface {
    fn default() -> Self {
        Self::new()
    }
}

impl Typeface {
    /// Reads the tables of the font.
    #[must_use]
    pub fn new() -> Self {
        let font = FontRef::try_from_slice(FONT).expect("the font is part of this crate");
        Self { font, drawn: HashMap::new() }
    }

    /// Width of a line of text, pixels.
    #[must_use]
    pub fn width_px(&self, text: &str, height_px: f32) -> f32 {
        let advance = |character| self.font.h_advance_unscaled(self.font.glyph_id(character));
        text.chars().map(advance).sum::<f32>() * height_px / CAPITAL
    }

    /// Draws one line with its base line at `y` and returns its width in pixels.
    pub fn draw(
        &mut self,
        image: &mut Image,
        text: &str,
        x: f32,
        y: f32,
        align: Align,
        style: TextStyle,
    ) -> f32 {
        let TextStyle { height_px, colour, alpha } = style;
        let width = self.width_px(text, height_px);
        let mut pen = match align {
            Align::Left => x,
            Align::Centre => x - 0.5 * width,
            Align::Right => x - width,
        };
        // A base line between two rows of pixels would blur every horizontal stroke.
        let base = y.round() as i32;
        for character in text.chars() {
            let id = self.font.glyph_id(character);
            let place = (pen * POSITIONS).round() as i32;
            let (whole, part) = (place.div_euclid(POSITIONS as i32), place.rem_euclid(POSITIONS as i32));
            let font = &self.font;
            let key = (id, height_px.to_bits(), part as u8);
            let glyph = self.drawn.entry(key).or_insert_with(|| rasterise(font, id, height_px, part));
            for (row, coverage) in glyph.coverage.chunks_exact(glyph.width.max(1)).enumerate() {
                for (column, covered) in coverage.iter().enumerate().filter(|(_, covered)| **covered > 0.0) {
                    let (x, y) = (whole + glyph.left + column as i32, base + glyph.top + row as i32);
                    image.blend(x, y, colour, covered * alpha);
                }
            }
            pen += self.font.h_advance_unscaled(id) * height_px / CAPITAL;
        }
        width
    }

    /// As [`Self::draw`], with a dark halo for legibility over the organ.
    pub fn draw_with_halo(
        &mut self,
        image: &mut Image,
        text: &str,
        (x, y): (f32, f32),
        align: Align,
        style: TextStyle,
    ) {
        let (colour, alpha) = HALO;
        let reach = (0.12 * style.height_px).max(1.0);
        let dark = TextStyle { colour, alpha: alpha * style.alpha, ..style };
        for (across, down) in [(-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1)] {
            let (x, y) = (x + across as f32 * reach, y + down as f32 * reach);
            self.draw(image, text, x, y, align, dark);
        }
        self.draw(image, text, x, y, align, style);
    }
}

fn rasterise(font: &FontRef<'_>, id: GlyphId, height_px: f32, part: i32) -> Bitmap {
    let scale = height_px / CAPITAL * font.height_unscaled();
    let glyph = id.with_scale_and_position(scale, point(part as f32 / POSITIONS, 0.0));
    // A space has no outline.
    let Some(outline) = font.outline_glyph(glyph) else { return Bitmap::default() };
    let bounds = outline.px_bounds();
    let width = bounds.width() as usize;
    let mut coverage = vec![0.0; width * bounds.height() as usize];
    outline.draw(|x, y, covered| coverage[y as usize * width + x as usize] = covered.min(1.0));
    Bitmap { left: bounds.min.x as i32, top: bounds.min.y as i32, width, coverage }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A name in any of these scripts is drawn, and what the font lacks is a visible box.
    #[test]
    fn the_font_has_the_scripts_of_names_and_a_box_for_the_others() {
        let mut face = Typeface::new();
        let ascii: String = (' '..='~').collect();
        let signs = "\u{2013}\u{2212}\u{d7}\u{b0}\u{b7}\u{b5}\u{2192}\u{2264}\u{221e}";
        for text in [
            ascii.as_str(),
            signs,
            "Játra žluč Žlučník Łódź İğne Størrelse façade Würfel Æsir œsophage Gan mật",
            "Ήπαρ σπλήν νεφρός ΑΒΓΔΩ αβγδω",
            "Печень селезёнка Ґудзик Ђорђе љубав",
            "Լյարդ ღვიძლი",
        ] {
            let missing: String = text.chars().filter(|c| face.font.glyph_id(*c).0 == 0).collect();
            assert!(missing.is_empty(), "{missing}");
        }
        let mut image = Image::new(40, 40);
        let style = TextStyle::new(16.0, 0xff_ffff);
        assert!(face.draw(&mut image, "\u{809d}", 4.0, 30.0, Align::Left, style) > 8.0);
        assert!(image.pixels().iter().filter(|pixel| **pixel > 0x80_0000).count() > 40);
    }

    #[test]
    fn a_capital_has_the_height_of_its_style() {
        for height_px in [8.0, 12.0, 29.0] {
            let mut image = Image::new(60, 60);
            let style = TextStyle::new(height_px, 0xff_ffff);
            Typeface::new().draw(&mut image, "H", 5.0, 50.0, Align::Left, style);
            let rows = (0..60).filter(|&y| (0..60).any(|x| image.pixel(x, y) > Some(0x80_0000)));
            assert_eq!(rows.count() as f32, height_px);
        }
    }

    #[test]
    fn digits_have_equal_widths() {
        let face = Typeface::new();
        let widths: Vec<f32> = ('0'..='9').map(|digit| face.width_px(&digit.to_string(), 12.0)).collect();
        assert!(widths.iter().all(|width| *width == widths[0]), "{widths:?}");
    }

    #[test]
    fn alignment_shifts_the_text() {
        let mut face = Typeface::new();
        let ink = |face: &mut Typeface, align| {
            let mut image = Image::new(200, 40);
            let style = TextStyle::new(16.0, 0xff_ffff);
            let width = face.draw(&mut image, "WWW", 100.0, 30.0, align, style);
            let columns: Vec<usize> =
                (0..200).filter(|&x| (0..40).any(|y| image.pixel(x, y) != Some(0))).collect();
            (columns[0] as f32, columns[columns.len() - 1] as f32, width)
        };
        let (left, right, width) = ink(&mut face, Align::Left);
        assert!((left - 100.0).abs() < 2.0 && (right - 100.0 - width).abs() < 2.5);
        let (left, right, _) = ink(&mut face, Align::Right);
        assert!((right - 100.0).abs() < 2.0 && (left - 100.0 + width).abs() < 2.5);
    }

    /// A glyph drawn again, from the cache and a whole number of pixels away, is the same.
    #[test]
    fn text_does_not_change_with_its_place() {
        let mut face = Typeface::new();
        let style = TextStyle { alpha: 0.8, ..TextStyle::new(9.5, 0xff_ffff) };
        let mut drawn = |x: f32| {
            let mut image = Image::new(120, 30);
            face.draw(&mut image, "Ångström", x, 20.0, Align::Left, style);
            image
        };
        let (first, moved) = (drawn(3.25), drawn(13.25));
        for y in 0..30 {
            for x in 0..110 {
                assert_eq!(first.pixel(x, y), moved.pixel(x + 10, y));
            }
        }
    }
}
