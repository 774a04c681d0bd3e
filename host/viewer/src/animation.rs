//! Writes an animated GIF frame by frame: one palette for all frames, and for each frame only the rectangle
//! that has changed.

use super::image::Image;
use super::quantise::{COLOURS, Palette};
use std::borrow::Cow;
use std::fs::File;
use std::io::{self, BufWriter, Write as _};

/// Palette index for an unchanged pixel.
const UNCHANGED: u8 = COLOURS as u8;
/// Delay of the last frame, hundredths of a second.
const LAST_DELAY_CS: u16 = 50;

/// Writes a GIF. A frame is written when the next one arrives, because its delay is known only then.
pub struct GifWriter {
    file: Option<BufWriter<File>>,
    film: Option<Film>,
    written: u64,
}

/// State after the first frame.
struct Film {
    encoder: gif::Encoder<BufWriter<File>>,
    palette: Palette,
    size: (u16, u16),
    /// Displayed picture, as palette indices.
    shown: Vec<u8>,
    waiting: gif::Frame<'static>,
    waiting_us: u64,
    /// Total delay written, hundredths of a second.
    written_cs: u64,
    first_us: u64,
}

impl GifWriter {
    /// Starts a film in an empty file.
    pub fn new(file: File) -> Self {
        Self { file: Some(BufWriter::new(file)), film: None, written: 0 }
    }

    /// Number of frames.
    #[must_use]
    pub const fn written(&self) -> u64 {
        self.written
    }

    /// Adds a frame and its time. All frames have the size of the first.
    pub fn write(&mut self, image: &Image, t_us: u64) -> io::Result<()> {
        if let Some(film) = &mut self.film {
            film.write(image, t_us)?;
        } else {
            let file = self.file.take().ok_or(io::ErrorKind::BrokenPipe)?;
            self.film = Some(Film::begin(file, image, t_us)?);
        }
        self.written += 1;
        Ok(())
    }

    /// Writes the pending frame and the trailer. Later frames are refused.
    pub fn finish(&mut self) -> io::Result<()> {
        match self.film.take() {
            Some(film) => film.end(),
            None => Ok(()),
        }
    }
}

impl Drop for GifWriter {
    /// Completes the file on exits that cannot report an error.
    fn drop(&mut self) {
        let _ = self.finish();
    }
}

impl core::fmt::Debug for GifWriter {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("GifWriter").field("written", &self.written).finish_non_exhaustive()
    }
}

impl Film {
    fn begin(file: BufWriter<File>, image: &Image, t_us: u64) -> io::Result<Self> {
        let (Ok(width), Ok(height)) = (u16::try_from(image.width()), u16::try_from(image.height())) else {
            return Err(io::ErrorKind::InvalidInput.into());
        };
        let palette = Palette::new(image);
        let mut encoder = gif::Encoder::new(file, width, height, &palette.bytes()).map_err(into_io)?;
        encoder.set_repeat(gif::Repeat::Infinite).map_err(into_io)?;
        let places = image.pixels().iter().enumerate();
        let index =
            |(at, pixel): (usize, &u32)| palette.index(*pixel, at % image.width(), at / image.width());
        let shown: Vec<u8> = places.map(index).collect();
        let waiting =
            gif::Frame { width, height, buffer: Cow::Owned(shown.clone()), ..gif::Frame::default() };
        let size = (width, height);
        Ok(Self { encoder, palette, size, shown, waiting, waiting_us: t_us, written_cs: 0, first_us: t_us })
    }

    fn write(&mut self, image: &Image, t_us: u64) -> io::Result<()> {
        if (image.width(), image.height()) != (usize::from(self.size.0), usize::from(self.size.1)) {
            return Err(io::ErrorKind::InvalidInput.into());
        }
        let next = self.difference(image);
        // The delay is the difference of rounded times, so rounding does not accumulate. Players treat a
        // delay below 2 as slow.
        let until_cs = t_us.saturating_sub(self.first_us) / 10_000;
        let delay = until_cs.saturating_sub(self.written_cs).clamp(2, u64::from(u16::MAX));
        self.waiting.delay = delay as u16;
        self.encoder.write_frame(&self.waiting).map_err(into_io)?;
        self.written_cs += delay;
        (self.waiting, self.waiting_us) = (next, t_us);
        Ok(())
    }

    /// The rectangle that has changed; unchanged pixels in it are transparent.
    fn difference(&mut self, image: &Image) -> gif::Frame<'static> {
        let width = image.width();
        let mut indices = vec![UNCHANGED; self.shown.len()];
        let (mut left, mut top, mut right, mut bottom) = (width, image.height(), 0, 0);
        for (at, pixel) in image.pixels().iter().enumerate() {
            let (x, y) = (at % width, at / width);
            let index = self.palette.index(*pixel, x, y);
            if index != self.shown[at] {
                (self.shown[at], indices[at]) = (index, index);
                (left, right, top, bottom) = (left.min(x), right.max(x + 1), top.min(y), bottom.max(y + 1));
            }
        }
        if left >= right {
            // A frame must have at least one pixel.
            (left, top, right, bottom) = (0, 0, 1, 1);
        }
        let rows = (top..bottom).flat_map(|y| &indices[y * width + left..y * width + right]);
        gif::Frame {
            left: left as u16,
            top: top as u16,
            width: (right - left) as u16,
            height: (bottom - top) as u16,
            transparent: Some(UNCHANGED),
            buffer: Cow::Owned(rows.copied().collect()),
            ..gif::Frame::default()
        }
    }

    fn end(mut self) -> io::Result<()> {
        self.waiting.delay = LAST_DELAY_CS;
        self.encoder.write_frame(&self.waiting).map_err(into_io)?;
        self.encoder.into_inner().map_err(into_io)?.flush()
    }
}

fn into_io(error: gif::EncodingError) -> io::Error {
    match error {
        gif::EncodingError::Io(error) => error,
        error => io::Error::new(io::ErrorKind::InvalidData, error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    /// A red square that moves over a slate background.
    fn picture(at: usize) -> Image {
        let mut image = Image::new(60, 40);
        image.pixels_mut().fill(0x20_282f);
        image.fill_rect(at as i32, 10, 12, 12, 0xb0_3020, 1.0);
        image
    }

    /// Decodes every frame onto the previous one, like a player, with its delay.
    fn played(path: &Path) -> Vec<(Vec<[u8; 3]>, u16)> {
        let mut options = gif::DecodeOptions::new();
        options.set_color_output(gif::ColorOutput::Indexed);
        let mut decoder = options.read_info(File::open(path).expect("written")).expect("a GIF");
        let palette = decoder.global_palette().expect("a global palette").to_vec();
        let mut canvas = vec![0_u8; 60 * 40];
        let mut frames = Vec::new();
        while let Some(frame) = decoder.read_next_frame().expect("valid") {
            for (at, index) in frame.buffer.iter().enumerate() {
                let (x, y) = (at % usize::from(frame.width), at / usize::from(frame.width));
                if frame.transparent != Some(*index) {
                    canvas[(y + usize::from(frame.top)) * 60 + x + usize::from(frame.left)] = *index;
                }
            }
            let colour = |index: &u8| [0, 1, 2].map(|channel| palette[3 * usize::from(*index) + channel]);
            frames.push((canvas.iter().map(colour).collect(), frame.delay));
        }
        frames
    }

    #[test]
    fn a_film_keeps_the_pictures_and_their_times() {
        let directory = tempfile::tempdir().expect("a temporary directory");
        let path = directory.path().join("film.gif");
        let mut writer = GifWriter::new(File::create(&path).expect("writable"));
        let times_us = [5_000_000, 5_083_000, 5_166_000, 5_166_000 + 400_000];
        let drawn = [3, 9, 9, 30].map(picture);
        for (image, t_us) in drawn.iter().zip(times_us) {
            writer.write(image, t_us).expect("writable");
        }
        assert_eq!(writer.written(), 4);
        writer.finish().expect("writable");
        let frames = played(&path);
        let delays: Vec<u16> = frames.iter().map(|(_, delay)| *delay).collect();
        assert_eq!(delays, [8, 8, 40, LAST_DELAY_CS]);
        for ((pixels, _), image) in frames.iter().zip(&drawn) {
            for (found, pixel) in pixels.iter().zip(image.pixels()) {
                for (channel, shift) in found.iter().zip([16, 8, 0]) {
                    assert!((i32::from(*channel) - (pixel >> shift & 255) as i32).abs() <= 12, "{found:?}");
                }
            }
        }
    }

    #[test]
    fn a_dropped_film_is_complete_and_another_size_is_refused() {
        let directory = tempfile::tempdir().expect("a temporary directory");
        let path = directory.path().join("film.gif");
        let mut writer = GifWriter::new(File::create(&path).expect("writable"));
        writer.write(&picture(1), 0).expect("writable");
        writer.write(&picture(5), 100_000).expect("writable");
        assert!(writer.write(&Image::new(61, 40), 200_000).is_err());
        drop(writer);
        assert_eq!(played(&path).len(), 2);
    }
}
