//! PNG frames in a directory. Each is written under a temporary name and renamed, so a reader never sees an
//! incomplete file.

use super::image::Image;
use std::fs::{self, File};
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};

/// Writes `frame_000000.png` and so on.
#[derive(Debug)]
pub struct FrameWriter {
    directory: PathBuf,
    written: u64,
    rows: Vec<u8>,
}

impl FrameWriter {
    /// Creates the directory if it does not exist.
    pub fn new(directory: &Path) -> io::Result<Self> {
        fs::create_dir_all(directory)?;
        Ok(Self { directory: directory.to_owned(), written: 0, rows: Vec::new() })
    }

    /// Number of frames written.
    #[must_use]
    pub const fn written(&self) -> u64 {
        self.written
    }

    /// Writes the next frame and returns its path.
    pub fn write(&mut self, image: &Image) -> io::Result<PathBuf> {
        let path = self.directory.join(format!("frame_{:06}.png", self.written));
        write_png(image, &path, &mut self.rows)?;
        self.written += 1;
        Ok(path)
    }
}

/// Writes a single picture with the highest compression.
pub fn write_still(image: &Image, path: &Path) -> io::Result<()> {
    write(image, path, png::Compression::High, &mut Vec::new())
}

/// Writes one frame of many; `rows` is scratch memory.
///
/// Frames are written while the haptic thread runs, so fast compression is used.
pub fn write_png(image: &Image, path: &Path, rows: &mut Vec<u8>) -> io::Result<()> {
    write(image, path, png::Compression::Fast, rows)
}

fn write(image: &Image, path: &Path, compression: png::Compression, rows: &mut Vec<u8>) -> io::Result<()> {
    let (Ok(width), Ok(height)) = (u32::try_from(image.width()), u32::try_from(image.height())) else {
        return Err(io::ErrorKind::InvalidInput.into());
    };
    rows.clear();
    rows.extend(image.pixels().iter().flat_map(|pixel| {
        let [_, red, green, blue] = pixel.to_be_bytes();
        [red, green, blue]
    }));
    let temporary = path.with_extension("png.part");
    let mut encoder = png::Encoder::new(BufWriter::new(File::create(&temporary)?), width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(compression);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(rows)?;
    writer.finish()?;
    fs::rename(&temporary, path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_decodes_to_the_same_pixels_and_leaves_no_part_file() {
        let directory = tempfile::tempdir().expect("a temporary directory");
        let mut image = Image::new(5, 3);
        for (i, pixel) in image.pixels_mut().iter_mut().enumerate() {
            *pixel = 0x01_0203 * i as u32;
        }
        let mut writer = FrameWriter::new(&directory.path().join("frames")).expect("writable");
        let path = writer.write(&image).expect("writable");
        let second = writer.write(&image).expect("writable");
        assert!(path.ends_with("frame_000000.png") && second.ends_with("frame_000001.png"));
        assert_eq!(writer.written(), 2);

        let decoder = png::Decoder::new(io::BufReader::new(File::open(&path).expect("written")));
        let mut reader = decoder.read_info().expect("a PNG");
        let mut bytes = vec![0; reader.output_buffer_size().expect("small")];
        let info = reader.next_frame(&mut bytes).expect("a frame");
        assert_eq!((info.width, info.height), (5, 3));
        let pixels: Vec<u32> =
            bytes.chunks_exact(3).map(|rgb| u32::from_be_bytes([0, rgb[0], rgb[1], rgb[2]])).collect();
        assert_eq!(pixels, image.pixels());
        let names: Vec<_> = fs::read_dir(directory.path().join("frames")).expect("there").collect();
        assert_eq!(names.len(), 2);
    }

    #[test]
    fn an_unwritable_path_is_an_error() {
        let directory = tempfile::tempdir().expect("a temporary directory");
        let file = directory.path().join("file");
        fs::write(&file, "x").expect("writable");
        assert!(FrameWriter::new(&file).is_err());
    }
}
