//! PNG pictures: a single one as bytes, or numbered frames in a directory.

use super::image::Image;
use std::ffi::OsStr;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

/// Writes `frame_000000.png` and so on. In a directory with frames of other sessions the numbers continue
/// after them; no frame is ever replaced.
///
/// A frame is written under a temporary name and renamed, so a reader never sees an incomplete picture.
#[derive(Debug)]
pub struct FrameWriter {
    directory: PathBuf,
    /// The next number to try.
    next: u64,
    written: u64,
    rows: Vec<u8>,
}

impl FrameWriter {
    /// Creates the directory if it does not exist.
    pub fn new(directory: &Path) -> io::Result<Self> {
        fs::create_dir_all(directory)?;
        let mut next = 0;
        for entry in fs::read_dir(directory)? {
            next = next.max(number(&entry?.file_name()).map_or(0, |number| number + 1));
        }
        Ok(Self { directory: directory.to_owned(), next, written: 0, rows: Vec::new() })
    }

    /// Number of frames written.
    #[must_use]
    pub const fn written(&self) -> u64 {
        self.written
    }

    /// Writes the next frame and returns its path.
    pub fn write(&mut self, image: &Image) -> io::Result<PathBuf> {
        // Frames are written while the haptic thread runs, so fast compression is used.
        let bytes = encoded(image, png::Compression::Fast, &mut self.rows)?;
        let path = self.claimed()?;
        let temporary = path.with_extension("png.part");
        let written = fs::write(&temporary, bytes).and_then(|()| fs::rename(&temporary, &path));
        if let Err(error) = written {
            // The first error is the one to report.
            let _ = (fs::remove_file(&temporary), fs::remove_file(&path));
            return Err(error);
        }
        self.written += 1;
        Ok(path)
    }

    /// Creates an empty file under the next free number, so that a concurrent session cannot take it.
    fn claimed(&mut self) -> io::Result<PathBuf> {
        loop {
            let path = self.directory.join(format!("frame_{:06}.png", self.next));
            self.next += 1;
            match File::create_new(&path) {
                Ok(_) => return Ok(path),
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error),
            }
        }
    }
}

/// The number in the name of a frame.
fn number(name: &OsStr) -> Option<u64> {
    name.to_str()?.strip_prefix("frame_")?.strip_suffix(".png")?.parse().ok()
}

/// Encodes a single picture as PNG with the highest compression.
pub fn still(image: &Image) -> io::Result<Vec<u8>> {
    encoded(image, png::Compression::High, &mut Vec::new())
}

/// The bytes of a PNG file; `rows` is scratch memory.
fn encoded(image: &Image, compression: png::Compression, rows: &mut Vec<u8>) -> io::Result<Vec<u8>> {
    let (Ok(width), Ok(height)) = (u32::try_from(image.width()), u32::try_from(image.height())) else {
        return Err(io::ErrorKind::InvalidInput.into());
    };
    rows.clear();
    rows.extend(image.pixels().iter().flat_map(|pixel| {
        let [_, red, green, blue] = pixel.to_be_bytes();
        [red, green, blue]
    }));
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(compression);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(rows)?;
    writer.finish()?;
    Ok(bytes)
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

    /// Two sessions one after the other, and two at once, in one directory.
    #[test]
    fn sessions_keep_each_others_pictures() {
        let directory = tempfile::tempdir().expect("a temporary directory");
        let [blank, mut dot] = [Image::new(5, 3), Image::new(5, 3)];
        dot.pixels_mut()[0] = 0x00ff_ffff;
        fs::write(directory.path().join("frame_000041.png"), "an earlier one").expect("writable");
        let mut writers = [(); 2].map(|()| FrameWriter::new(directory.path()).expect("writable"));
        for number in 0..3 {
            for (writer, image) in writers.iter_mut().zip([&blank, &dot]) {
                let path = writer.write(image).expect("writable");
                assert_eq!(fs::read(&path).expect("there").len(), encoded_len(image), "{number}");
            }
        }
        let mut names: Vec<_> = fs::read_dir(directory.path())
            .expect("there")
            .map(|entry| entry.expect("an entry").file_name().into_string().expect("text"))
            .collect();
        names.sort_unstable();
        let expected: Vec<String> = (41..48).map(|number| format!("frame_{number:06}.png")).collect();
        assert_eq!(names, expected);
        assert_eq!(fs::read(directory.path().join("frame_000041.png")).expect("there"), b"an earlier one");
        assert_eq!(writers.each_ref().map(FrameWriter::written), [3, 3]);
    }

    fn encoded_len(image: &Image) -> usize {
        encoded(image, png::Compression::Fast, &mut Vec::new()).expect("a picture").len()
    }

    #[test]
    fn an_unwritable_path_is_an_error() {
        let directory = tempfile::tempdir().expect("a temporary directory");
        let file = directory.path().join("file");
        fs::write(&file, "x").expect("writable");
        assert!(FrameWriter::new(&file).is_err());
    }
}
