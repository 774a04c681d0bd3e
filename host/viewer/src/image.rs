//! The picture, and anti-aliased 2-D marks on it.

/// Picture of 0x00RRGGBB pixels, row by row from the top, for the window and the PNG writer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Image {
    width: usize,
    height: usize,
    pixels: Vec<u32>,
}

impl Image {
    /// A black picture.
    #[must_use]
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, pixels: vec![0; width * height] }
    }

    /// Width, pixels.
    #[must_use]
    pub const fn width(&self) -> usize {
        self.width
    }

    /// Height, pixels.
    #[must_use]
    pub const fn height(&self) -> usize {
        self.height
    }

    /// All pixels, row by row.
    #[must_use]
    pub fn pixels(&self) -> &[u32] {
        &self.pixels
    }

    /// All pixels, mutable.
    pub fn pixels_mut(&mut self) -> &mut [u32] {
        &mut self.pixels
    }

    /// One pixel; `None` outside the picture.
    #[must_use]
    pub fn pixel(&self, x: usize, y: usize) -> Option<u32> {
        if x < self.width { self.pixels.get(y * self.width + x).copied() } else { None }
    }

    /// Blends `colour` over one pixel. Pixels outside the picture are ignored.
    pub fn blend(&mut self, x: i32, y: i32, colour: u32, alpha: f32) {
        let (Ok(x), Ok(y)) = (usize::try_from(x), usize::try_from(y)) else { return };
        if x >= self.width || y >= self.height {
            return;
        }
        let pixel = &mut self.pixels[y * self.width + x];
        *pixel = mix(*pixel, colour, alpha);
    }

    /// Blends a rectangle of one colour over the picture.
    pub fn fill_rect(&mut self, x: i32, y: i32, width: i32, height: i32, colour: u32, alpha: f32) {
        for row in y..y + height {
            for column in x..x + width {
                self.blend(column, row, colour, alpha);
            }
        }
    }
}

/// Blend of two colours, channel by channel as stored; sufficient for thin marks.
#[must_use]
pub fn mix(below: u32, above: u32, alpha: f32) -> u32 {
    let weight = (alpha.clamp(0.0, 1.0) * 256.0) as u32;
    // Red and blue are far enough apart to be blended by one multiplication.
    let red_blue = ((below & 0xff_00ff) * (256 - weight) + (above & 0xff_00ff) * weight) >> 8;
    let green = ((below & 0x00_ff00) * (256 - weight) + (above & 0x00_ff00) * weight) >> 8;
    (red_blue & 0xff_00ff) | (green & 0x00_ff00)
}

/// Coverage of a set of strokes inside a rectangle of the picture.
///
/// Overlapping strokes (the joints of a polyline) keep the larger coverage, so the joints of a translucent
/// line are not darker.
#[derive(Debug, Clone, Default)]
pub struct StrokeMask {
    left: i32,
    top: i32,
    width: usize,
    height: usize,
    coverage: Vec<f32>,
}

impl StrokeMask {
    /// Clears the mask and sets its rectangle; the buffer is reused.
    pub fn reset(&mut self, left: i32, top: i32, width: usize, height: usize) {
        (self.left, self.top, self.width, self.height) = (left, top, width, height);
        self.coverage.clear();
        self.coverage.resize(width * height, 0.0);
    }

    /// Adds a segment with round caps; `weight` scales its coverage.
    pub fn segment(&mut self, from: [f32; 2], to: [f32; 2], half_width: f32, weight: f32) {
        self.segment_where(from, to, half_width, |_, _, _| weight);
    }

    /// As [`Self::segment`], with a weight for each pixel from (x, y, fraction along the segment).
    pub fn segment_where(
        &mut self,
        from: [f32; 2],
        to: [f32; 2],
        half_width: f32,
        mut weight: impl FnMut(i32, i32, f32) -> f32,
    ) {
        let reach = half_width + 1.0;
        let along = [to[0] - from[0], to[1] - from[1]];
        let length_squared = along[0] * along[0] + along[1] * along[1];
        let span = |a: f32, b: f32, low: i32, size: usize| {
            let first = ((a.min(b) - reach).floor()).max(low as f32) as i32;
            let last = ((a.max(b) + reach).ceil()).min((low + size as i32) as f32) as i32;
            first..last
        };
        let columns = span(from[0], to[0], self.left, self.width);
        // Half the width of the stroke along a row, and the shift of its middle from row to row.
        let length = length_squared.sqrt();
        let steep = along[1].abs() > 1e-3 * length;
        let (half_row, per_row) =
            if steep { (reach * length / along[1].abs(), along[0] / along[1]) } else { (f32::INFINITY, 0.0) };
        for y in span(from[1], to[1], self.top, self.height) {
            let row = (y - self.top) as usize * self.width;
            let middle = from[0] + (y as f32 + 0.5 - from[1]) * per_row;
            let first = columns.start.max((middle - half_row).floor() as i32);
            let last = columns.end.min((middle + half_row).ceil() as i32);
            for x in first..last {
                let offset = [x as f32 + 0.5 - from[0], y as f32 + 0.5 - from[1]];
                let t = if length_squared > 0.0 {
                    ((offset[0] * along[0] + offset[1] * along[1]) / length_squared).clamp(0.0, 1.0)
                } else {
                    0.0
                };
                let (dx, dy) = (offset[0] - t * along[0], offset[1] - t * along[1]);
                let distance = (dx * dx + dy * dy).sqrt();
                let covered = (half_width + 0.5 - distance).clamp(0.0, 1.0);
                if covered > 0.0 {
                    let cell = &mut self.coverage[row + (x - self.left) as usize];
                    *cell = cell.max(covered * weight(x, y, t));
                }
            }
        }
    }

    /// Adds a polyline.
    pub fn polyline(&mut self, points: &[[f32; 2]], half_width: f32) {
        for pair in points.windows(2) {
            self.segment(pair[0], pair[1], half_width, 1.0);
        }
    }

    /// Coverage rows with their positions: (x of the first pixel, y, coverages).
    pub fn rows(&self) -> impl Iterator<Item = (i32, i32, &[f32])> {
        let top = self.top;
        let left = self.left;
        self.coverage
            .chunks_exact(self.width.max(1))
            .enumerate()
            .map(move |(row, coverage)| (left, top + row as i32, coverage))
    }

    /// Blends the mask over the picture in one colour.
    pub fn paint(&self, image: &mut Image, colour: u32, alpha: f32) {
        for (left, y, row) in self.rows() {
            for (column, coverage) in row.iter().enumerate() {
                if *coverage > 0.0 {
                    image.blend(left + column as i32, y, colour, coverage * alpha);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blending_is_exact_at_both_ends_and_stays_between() {
        assert_eq!(mix(0x12_3456, 0xfe_dcba, 0.0), 0x12_3456);
        assert_eq!(mix(0x12_3456, 0xfe_dcba, 1.0), 0xfe_dcba);
        assert_eq!(mix(0x00_0000, 0xff_ffff, 0.5), 0x7f_7f7f);
    }

    #[test]
    fn marks_outside_the_picture_are_ignored() {
        let mut image = Image::new(4, 3);
        image.fill_rect(-5, -5, 20, 20, 0xff_ffff, 1.0);
        image.blend(4, 0, 0, 1.0);
        assert!(image.pixels().iter().all(|&pixel| pixel == 0xff_ffff));
        assert_eq!(image.pixel(4, 0), None);
    }

    #[test]
    fn a_horizontal_stroke_covers_its_own_row_only() {
        let mut mask = StrokeMask::default();
        mask.reset(0, 0, 12, 7);
        mask.segment([2.0, 3.5], [9.0, 3.5], 0.5, 1.0);
        let mut image = Image::new(12, 7);
        mask.paint(&mut image, 0xff_ffff, 1.0);
        assert_eq!(image.pixel(5, 3), Some(0xff_ffff));
        assert_eq!(image.pixel(5, 2), Some(0));
        assert_eq!(image.pixel(5, 4), Some(0));
        assert_eq!(image.pixel(11, 3), Some(0));
    }

    /// Only part of each row is evaluated. For every slope this part must contain the whole stroke.
    #[test]
    fn a_stroke_covers_every_pixel_near_its_line() {
        for (from, to) in [
            ([3.0, 4.0], [33.0, 21.0]),
            ([30.0, 2.0], [6.0, 27.0]),
            ([20.0, 2.0], [20.01, 28.0]),
            ([4.0, 15.0], [35.0, 15.02]),
            ([12.0, 12.0], [12.0, 12.0]),
        ] {
            let mut mask = StrokeMask::default();
            mask.reset(0, 0, 40, 30);
            mask.segment(from, to, 1.5, 1.0);
            let along = [to[0] - from[0], to[1] - from[1]];
            let squared = (along[0] * along[0] + along[1] * along[1]).max(1e-9);
            for (_, y, row) in mask.rows() {
                for (x, coverage) in row.iter().enumerate() {
                    let offset = [x as f32 + 0.5 - from[0], y as f32 + 0.5 - from[1]];
                    let t = ((offset[0] * along[0] + offset[1] * along[1]) / squared).clamp(0.0, 1.0);
                    let distance = (offset[0] - t * along[0]).hypot(offset[1] - t * along[1]);
                    let expected = (2.0 - distance).clamp(0.0, 1.0);
                    assert!((coverage - expected).abs() < 1e-3, "{from:?} {to:?}: {x} {y} {coverage}");
                }
            }
        }
    }

    #[test]
    fn joints_of_a_translucent_line_are_not_darker() {
        let mut mask = StrokeMask::default();
        mask.reset(0, 0, 20, 5);
        mask.polyline(&[[1.0, 2.5], [10.0, 2.5], [19.0, 2.5]], 0.5);
        let mut image = Image::new(20, 5);
        mask.paint(&mut image, 0xff_ffff, 0.5);
        assert_eq!(image.pixel(9, 2), image.pixel(5, 2));
        assert_eq!(image.pixel(10, 2), image.pixel(5, 2));
    }
}
