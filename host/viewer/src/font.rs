//! A single-stroke typeface: glyphs are centre lines, drawn at any size with anti-aliased round strokes.
//!
//! A bitmap font cannot be scaled to the overlay's sizes of 11 to 40 pixels. An outline font would need a
//! font file and its licence for about a hundred glyphs.
//!
//! Design grid: capitals are 12 high, lower case 8, descenders reach -4, caps are round. A stroke is a list
//! of points; the prefix `~` makes it a quadratic B-spline that starts and ends on its end points, `@` a
//! closed one.

use super::image::{Image, StrokeMask};

/// Height of a capital on the design grid.
const CAPITAL: f32 = 12.0;
/// Spacing after every glyph.
const SPACING: f32 = 3.3;
/// Number of segments per B-spline piece.
const PIECES: usize = 6;

/// Glyph, its width and its strokes.
#[rustfmt::skip]
const GLYPHS: &[(char, f32, &str)] = &[
    (' ', 2.2, ""),
    ('0', 7.6, "@0,0 7.6,0 7.6,6 7.6,12 0,12 0,6"),
    ('1', 7.6, "1.4,9.4 4.6,12 4.6,0"),
    ('2', 7.6, "~0.3,9 0.3,12 3.9,12 7.4,12 7.4,9 7.4,7 5,4.6 0.2,0;0.2,0 7.6,0"),
    ('3', 7.6, "~0.5,10 0.9,12 3.7,12 7.2,12 7.2,9.1 7.2,6.5 3.6,6.5 2.6,6.5;~2.6,6.5 3.8,6.5 7.6,6.5 7.6,3.2 7.6,0 3.8,0 0.6,0 0.1,2.4"),
    ('4', 7.6, "5.8,0 5.8,12 0,3.4 7.8,3.4"),
    ('5', 7.6, "6.9,12 1.2,12 0.7,6.4;~0.7,6.4 2,7.7 3.9,7.7 7.6,7.7 7.6,3.8 7.6,0 3.8,0 0.7,0 0.1,2.2"),
    ('6', 7.6, "~6.9,10.8 6.2,12 4.3,12 0,12 0,5 0,0 3.8,0 7.6,0 7.6,3.7 7.6,7.4 3.9,7.4 0.8,7.4 0.1,4.2"),
    ('7', 7.6, "0,12 7.6,12 2.8,0"),
    ('8', 7.6, "@0.5,6.5 7.1,6.5 7.1,12 0.5,12;@0,0 7.6,0 7.6,6.5 0,6.5"),
    ('9', 7.6, "~0.7,1.2 1.4,0 3.3,0 7.6,0 7.6,7 7.6,12 3.8,12 0,12 0,8.3 0,4.6 3.7,4.6 6.8,4.6 7.5,7.8"),
    ('A', 8.4, "0,0 4.2,12 8.4,0;1.5,4 6.9,4"),
    ('B', 7.8, "0,0 0,12 3.8,12;~3.8,12 7.3,12 7.3,9.2 7.3,6.4 3.8,6.4;0,6.4 4,6.4;~4,6.4 7.8,6.4 7.8,3.2 7.8,0 4,0;4,0 0,0"),
    ('C', 8.0, "~8,9.6 7.2,12 4.4,12 0,12 0,6 0,0 4.4,0 7.2,0 8,2.4"),
    ('D', 8.4, "0,0 0,12 3,12;~3,12 8.4,12 8.4,6 8.4,0 3,0;3,0 0,0"),
    ('E', 6.8, "6.8,12 0,12 0,0 6.8,0;0,6.3 5.8,6.3"),
    ('F', 6.6, "6.6,12 0,12 0,0;0,6.3 5.6,6.3"),
    ('G', 8.4, "~8.1,9.6 7.2,12 4.4,12 0,12 0,6 0,0 4.6,0 8.4,0 8.4,3.6;8.4,3.6 8.4,5.6 5,5.6"),
    ('H', 8.0, "0,0 0,12;8,0 8,12;0,6.2 8,6.2"),
    ('I', 0.4, "0.2,0 0.2,12"),
    ('J', 5.6, "5.6,12 5.6,3.6;~5.6,3.6 5.6,0 2.8,0 0.2,0 0,3"),
    ('K', 7.6, "0,0 0,12;7.3,12 0,4.6;2.8,7.3 7.8,0"),
    ('L', 6.6, "0,12 0,0 6.6,0"),
    ('M', 9.4, "0,0 0,12 4.7,3.6 9.4,12 9.4,0"),
    ('N', 8.0, "0,0 0,12 8,0 8,12"),
    ('O', 9.0, "@0,0 9,0 9,6 9,12 0,12 0,6"),
    ('P', 7.6, "0,0 0,12 3.8,12;~3.8,12 7.6,12 7.6,8.7 7.6,5.4 3.8,5.4;3.8,5.4 0,5.4"),
    ('Q', 9.0, "@0,0 9,0 9,6 9,12 0,12 0,6;5.6,3 9,-1"),
    ('R', 7.8, "0,0 0,12 3.8,12;~3.8,12 7.6,12 7.6,8.7 7.6,5.4 3.8,5.4;3.8,5.4 0,5.4;4,5.4 7.8,0"),
    ('S', 7.6, "~7.3,9.8 6.8,12 3.9,12 0.3,12 0.3,9 0.3,6.9 3.9,6.2 7.6,5.5 7.6,3.2 7.6,0 3.8,0 0.6,0 0,2.4"),
    ('T', 8.0, "0,12 8,12;4,12 4,0"),
    ('U', 8.0, "0,12 0,4.4;~0,4.4 0,0 4,0 8,0 8,4.4;8,4.4 8,12"),
    ('V', 8.2, "0,12 4.1,0 8.2,12"),
    ('W', 11.4, "0,12 2.9,0 5.7,10 8.5,0 11.4,12"),
    ('X', 7.8, "0,0 7.8,12;0,12 7.8,0"),
    ('Y', 8.0, "0,12 4,5.6 8,12;4,5.6 4,0"),
    ('Z', 7.6, "0,12 7.6,12 0,0 7.6,0"),
    ('a', 6.6, "@0,0 6.6,0 6.6,4 6.6,8 0,8 0,4;6.6,8 6.6,0"),
    ('b', 6.6, "0,0 0,12;@0,0 6.6,0 6.6,4 6.6,8 0,8 0,4"),
    ('c', 6.0, "~6,6.2 5.4,8 3.4,8 0,8 0,4 0,0 3.4,0 5.4,0 6,1.8"),
    ('d', 6.6, "6.6,0 6.6,12;@0,0 6.6,0 6.6,4 6.6,8 0,8 0,4"),
    ('e', 6.6, "0.1,4.3 6.6,4.3;~6.6,4.3 6.6,8 3.4,8 0,8 0,4 0,0 3.5,0 5.6,0 6.3,1.8"),
    ('f', 4.2, "~4.4,11.8 1.6,12.6 1.6,9;1.6,9 1.6,0;0,8 4,8"),
    ('g', 6.6, "@0,0 6.6,0 6.6,4 6.6,8 0,8 0,4;6.6,8 6.6,-0.6;~6.6,-0.6 6.6,-4 3.4,-4 1.2,-4 0.4,-2.7"),
    ('h', 6.4, "0,0 0,12;~0,4.4 0.4,8 3.5,8 6.4,8 6.4,5;6.4,5 6.4,0"),
    ('i', 0.4, "0.2,0 0.2,8;0.2,11.2 0.2,11.4"),
    ('j', 1.8, "1.6,8 1.6,-1.6;~1.6,-1.6 1.6,-4 -0.8,-3.8;1.6,11.2 1.6,11.4"),
    ('k', 6.2, "0,0 0,12;5.8,8 0,3;2.2,4.9 6.2,0"),
    ('l', 0.4, "0.2,0 0.2,12"),
    ('m', 10.4, "0,0 0,8;~0,4.8 0.3,8 2.9,8 5.2,8 5.2,5.2;5.2,5.2 5.2,0;~5.2,4.8 5.5,8 8.1,8 10.4,8 10.4,5.2;10.4,5.2 10.4,0"),
    ('n', 6.4, "0,0 0,8;~0,4.4 0.4,8 3.5,8 6.4,8 6.4,5;6.4,5 6.4,0"),
    ('o', 7.0, "@0,0 7,0 7,4 7,8 0,8 0,4"),
    ('p', 6.6, "0,-4 0,8;@0,0 6.6,0 6.6,4 6.6,8 0,8 0,4"),
    ('q', 6.6, "6.6,-4 6.6,8;@0,0 6.6,0 6.6,4 6.6,8 0,8 0,4"),
    ('r', 3.8, "0,0 0,8;~0,4.4 0.4,8 2.9,8 3.9,7.8"),
    ('s', 5.8, "~5.6,6.3 5.1,8 3,8 0.3,8 0.3,6 0.3,4.5 3,4.1 5.9,3.6 5.9,2 5.9,0 2.9,0 0.5,0 0,1.7"),
    ('t', 4.4, "1.6,11 1.6,2.6;~1.6,2.6 1.6,0 3.6,0 4.5,0.2;0,8 4.3,8"),
    ('u', 6.4, "0,8 0,3;~0,3 0,0 3,0 6,0 6.4,3.6;6.4,8 6.4,0"),
    ('v', 6.6, "0,8 3.3,0 6.6,8"),
    ('w', 9.4, "0,8 2.4,0 4.7,7 7,0 9.4,8"),
    ('x', 6.2, "0,0 6.2,8;0,8 6.2,0"),
    ('y', 6.8, "0,8 3.5,0.2;6.8,8 2.7,-2.4;~2.7,-2.4 2.1,-4 0.2,-3.9"),
    ('z', 6.0, "0,8 6,8 0,0 6,0"),
    ('.', 0.4, "0.2,0 0.2,0.2"),
    (',', 0.8, "0.7,0.4 0.1,-2"),
    (':', 0.4, "0.2,0.4 0.2,0.6;0.2,7 0.2,7.2"),
    (';', 0.8, "0.7,0.4 0.1,-2;0.6,7 0.6,7.2"),
    ('!', 0.4, "0.2,12 0.2,3.6;0.2,0 0.2,0.2"),
    ('?', 6.4, "~0,9.2 0.2,12 3.2,12 6.4,12 6.4,9.2 6.4,7.4 3.2,6 3.2,3.6;3.2,0 3.2,0.2"),
    ('-', 4.2, "0,4.8 4.2,4.8"),
    ('\u{2013}', 7.0, "0,4.8 7,4.8"),
    ('\u{2212}', 7.0, "0,5.4 7,5.4"),
    ('+', 7.0, "0,5.4 7,5.4;3.5,1.9 3.5,8.9"),
    ('=', 6.6, "0,3.6 6.6,3.6;0,7.2 6.6,7.2"),
    ('\u{d7}', 5.6, "0,2.4 5.6,8;0,8 5.6,2.4"),
    ('/', 5.2, "0,-1.4 5.2,13"),
    ('\\', 5.2, "5.2,-1.4 0,13"),
    ('|', 0.4, "0.2,-2.4 0.2,13.4"),
    ('%', 9.8, "@0,6.6 4.2,6.6 4.2,12 0,12;@5.6,0 9.8,0 9.8,5.4 5.6,5.4;8.6,12 1.2,0"),
    ('(', 2.6, "~2.6,14 0,10.4 0,5.8 0,1.2 2.6,-2.4"),
    (')', 2.6, "~0,14 2.6,10.4 2.6,5.8 2.6,1.2 0,-2.4"),
    ('[', 2.4, "2.4,13.6 0,13.6 0,-2 2.4,-2"),
    (']', 2.4, "0,13.6 2.4,13.6 2.4,-2 0,-2"),
    ('<', 6.2, "6.2,9 0,5.4 6.2,1.8"),
    ('>', 6.2, "0,9 6.2,5.4 0,1.8"),
    ('_', 7.0, "0,-1.6 7,-1.6"),
    ('*', 4.8, "2.4,12 2.4,6.8;0.2,10.7 4.6,8.1;4.6,10.7 0.2,8.1"),
    ('#', 8.0, "2.6,0 3.8,12;5.4,0 6.6,12;0.4,4 8,4;0.8,8 8.4,8"),
    ('\'', 0.4, "0.2,12 0.2,9"),
    ('"', 2.8, "0.2,12 0.2,9;2.6,12 2.6,9"),
    ('\u{b0}', 3.2, "@0,8.6 3.2,8.6 3.2,12.4 0,12.4"),
    ('\u{b7}', 0.4, "0.2,5.2 0.2,5.4"),
    ('\u{b5}', 6.4, "0,8 0,-4;~0,3 0,0 3,0 6,0 6.4,3.6;6.4,8 6.4,0"),
];

/// Glyph for a character that the typeface does not have.
const MISSING: (f32, &str) = (6.0, "0,0 6,0 6,12 0,12 0,0");

#[derive(Debug, Clone)]
struct Glyph {
    width: f32,
    polylines: Vec<Vec<[f32; 2]>>,
}

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

/// Size, weight and colour of a line of text.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TextStyle {
    /// Height of a capital, pixels.
    pub height_px: f32,
    /// Width of the stroke as a share of the capital height; 0.11 is a regular weight.
    pub weight: f32,
    /// 0xRRGGBB.
    pub colour: u32,
    /// Opacity.
    pub alpha: f32,
}

impl TextStyle {
    /// Regular weight, opaque.
    #[must_use]
    pub const fn new(height_px: f32, colour: u32) -> Self {
        Self { height_px, weight: 0.115, colour, alpha: 1.0 }
    }

    /// The same style with another weight.
    #[must_use]
    pub const fn weight(self, weight: f32) -> Self {
        Self { weight, ..self }
    }
}

/// The typeface with flattened glyphs.
#[derive(Debug, Clone)]
pub struct Typeface {
    // Sorted by character.
    glyphs: Vec<(char, Glyph)>,
    missing: Glyph,
    mask: StrokeMask,
}

impl Default for Typeface {
    fn default() -> Self {
        Self::new()
    }
}

impl Typeface {
    /// Flattens every glyph.
    #[must_use]
    pub fn new() -> Self {
        let mut glyphs: Vec<(char, Glyph)> =
            GLYPHS.iter().map(|&(character, width, strokes)| (character, flatten(width, strokes))).collect();
        glyphs.sort_by_key(|(character, _)| *character);
        Self { glyphs, missing: flatten(MISSING.0, MISSING.1), mask: StrokeMask::default() }
    }

    fn glyph(&self, character: char) -> &Glyph {
        match self.glyphs.binary_search_by_key(&character, |(candidate, _)| *candidate) {
            Ok(found) => &self.glyphs[found].1,
            Err(_) => &self.missing,
        }
    }

    /// Width of a line of text, pixels.
    #[must_use]
    pub fn width_px(&self, text: &str, height_px: f32) -> f32 {
        let units: f32 = text.chars().map(|character| self.glyph(character).width + SPACING).sum();
        (units - SPACING).max(0.0) * height_px / CAPITAL
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
        let width = self.width_px(text, style.height_px);
        let scale = style.height_px / CAPITAL;
        let half_width = (0.5 * style.weight * style.height_px).max(0.5);
        let mut mask = std::mem::take(&mut self.mask);
        let left = match align {
            Align::Left => x,
            Align::Centre => x - 0.5 * width,
            Align::Right => x - width,
        };
        let margin = half_width + 2.0;
        let top = y - 14.5 * scale - margin;
        mask.reset(
            (left - margin - scale) as i32,
            top as i32,
            (width + 2.0 * (margin + scale)) as usize + 2,
            (19.5 * scale + 2.0 * margin) as usize + 2,
        );
        let mut pen = left;
        for character in text.chars() {
            let glyph = self.glyph(character);
            for polyline in &glyph.polylines {
                for pair in polyline.windows(2) {
                    let place = |point: [f32; 2]| [pen + point[0] * scale, y - point[1] * scale];
                    mask.segment(place(pair[0]), place(pair[1]), half_width, 1.0);
                }
            }
            pen += (glyph.width + SPACING) * scale;
        }
        mask.paint(image, style.colour, style.alpha);
        self.mask = mask;
        width
    }
}

fn flatten(width: f32, strokes: &str) -> Glyph {
    let polylines = strokes
        .split(';')
        .filter(|stroke| !stroke.is_empty())
        .map(|stroke| match stroke.split_at(1) {
            ("~", points) => open_spline(&parse(points)),
            ("@", points) => closed_spline(&parse(points)),
            _ => parse(stroke),
        })
        .collect();
    Glyph { width, polylines }
}

fn parse(points: &str) -> Vec<[f32; 2]> {
    points
        .split_whitespace()
        .filter_map(|pair| {
            let (x, y) = pair.split_once(',')?;
            Some([x.parse().ok()?, y.parse().ok()?])
        })
        .collect()
}

/// Quadratic Bezier piece from `a` to `c` with control point `b`, without its first point.
fn piece(a: [f32; 2], b: [f32; 2], c: [f32; 2]) -> impl Iterator<Item = [f32; 2]> {
    (1..=PIECES).map(move |step| {
        let t = step as f32 / PIECES as f32;
        let blend =
            |axis: usize| (1.0 - t) * (1.0 - t) * a[axis] + 2.0 * t * (1.0 - t) * b[axis] + t * t * c[axis];
        [blend(0), blend(1)]
    })
}

fn middle(a: [f32; 2], b: [f32; 2]) -> [f32; 2] {
    [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])]
}

/// Quadratic B-spline that starts and ends on the first and last control point.
fn open_spline(control: &[[f32; 2]]) -> Vec<[f32; 2]> {
    let [first, .., last] = control else { return control.to_vec() };
    let mut curve = vec![*first];
    let mut start = *first;
    for (i, corner) in control.iter().enumerate().skip(1).take(control.len().saturating_sub(2)) {
        let end = if i + 2 == control.len() { *last } else { middle(*corner, control[i + 1]) };
        curve.extend(piece(start, *corner, end));
        start = end;
    }
    curve
}

/// Closed quadratic B-spline: passes through the middle of every side of its control polygon.
fn closed_spline(control: &[[f32; 2]]) -> Vec<[f32; 2]> {
    let n = control.len();
    let mut curve = vec![middle(control[n - 1], control[0])];
    for i in 0..n {
        let start = middle(control[(i + n - 1) % n], control[i]);
        curve.extend(piece(start, control[i], middle(control[i], control[(i + 1) % n])));
    }
    curve
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_glyph_has_strokes_inside_its_cell_and_every_number_parses() {
        let face = Typeface::new();
        assert_eq!(face.glyphs.len(), GLYPHS.len());
        for (character, glyph) in &face.glyphs {
            assert!(*character == ' ' || !glyph.polylines.is_empty(), "{character}");
            for point in glyph.polylines.iter().flatten() {
                assert!(point[0] >= -1.0 && point[0] <= glyph.width + 0.6, "{character} {point:?}");
                assert!(point[1] >= -4.1 && point[1] <= 14.1, "{character} {point:?}");
            }
        }
        for (character, _, strokes) in GLYPHS {
            let written = strokes.split([';', ' ']).filter(|pair| !pair.is_empty()).count();
            let parsed: usize =
                strokes.split(';').map(|stroke| parse(stroke.trim_start_matches(['~', '@'])).len()).sum();
            assert_eq!(written, parsed, "{character}");
        }
    }

    #[test]
    fn the_printable_ascii_characters_exist() {
        let face = Typeface::new();
        let needed =
            "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789 .,:;!?-+=/%()[]<>_*#'\"|\\";
        for character in needed.chars() {
            assert!(face.glyphs.iter().any(|(candidate, _)| *candidate == character), "{character}");
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
            let width = face.draw(&mut image, "HHH", 100.0, 30.0, align, style);
            let columns: Vec<usize> =
                (0..200).filter(|&x| (0..40).any(|y| image.pixel(x, y) != Some(0))).collect();
            (columns[0] as f32, columns[columns.len() - 1] as f32, width)
        };
        let (left, right, width) = ink(&mut face, Align::Left);
        assert!((left - 100.0).abs() < 2.0 && (right - 100.0 - width).abs() < 2.5);
        let (left, right, _) = ink(&mut face, Align::Right);
        assert!((right - 100.0).abs() < 2.0 && (left - 100.0 + width).abs() < 2.5);
    }
}
