//! Checks the files that tests/viewer/check-window has written to a folder: the program's screenshots, and
//! dumps of the X server's screen at the same times.
//!
//! Prints one line per check; the exit code is 1 if a check fails.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

type Failure = Box<dyn core::error::Error>;

/// The area of the picture with the organ, without charts and timing, which change continuously.
const ORGAN: [usize; 4] = [300, 30, 900, 550];
/// The area with the help.
const HELP: [usize; 4] = [28, 106, 250, 420];

fn main() -> Result<(), Failure> {
    let folder = std::env::args_os().nth(1).ok_or("give the folder")?;
    let folder = Path::new(&folder);
    let shot = |number: u32| png(&folder.join(format!("frame_{number:06}.png")));
    let (rest, pressed, without) = (shot(0)?, shot(1)?, shot(2)?);
    let mut failed = 0;
    let mut check = |what: &str, found: String, passes: bool| {
        println!("{}  {what}: {found}", if passes { "ok    " } else { "FAILED" });
        failed += u32::from(!passes);
    };
    let size = |picture: &Picture| format!("{} x {}", picture.width, picture.pixels.len() / picture.width);
    check("size of the screenshot", size(&rest), size(&rest) == "1280 x 720");

    // The screen shows the picture of the program.
    for (name, own, limit) in [("rest", &rest, 0), ("pressed", &pressed, 3_000)] {
        let screen = xwd(&folder.join(format!("{name}.xwd")))?;
        let differences = own.differing(&screen, ORGAN, if limit == 0 { 0 } else { 8 });
        check(
            &format!("{name}: pixels that differ on the screen"),
            differences.to_string(),
            differences <= limit,
        );
    }

    let red = |[r, g, b]: [i32; 3]| r > 60 && r > 2 * g && r > 2 * b;
    let yellow = |[r, g, b]: [i32; 3]| r > 200 && g > 140 && r - b > 60;
    let cyan = |[r, g, b]: [i32; 3]| b > 150 && g > 130 && b - r > 60;
    let found = rest.count(ORGAN, red);
    check("rest: red pixels of the organ", found.to_string(), found > 50_000);
    let found = rest.count(ORGAN, cyan);
    check("rest: no force", found.to_string(), found < 50);
    let found = [&rest, &pressed].map(|picture| picture.count(ORGAN, yellow));
    check(
        "pressed: bright pixels",
        format!("{} (at rest {})", found[1], found[0]),
        found[1] > found[0] + 1_000,
    );
    let found = pressed.count(ORGAN, cyan);
    check("pressed: pixels of the force", found.to_string(), found > 300);
    let found = pressed.differing(&without, HELP, 8);
    check("H: pixels that change in the area of the help", found.to_string(), found > 5_000);

    if failed > 0 { Err(format!("{failed} checks failed").into()) } else { Ok(()) }
}

struct Picture {
    width: usize,
    pixels: Vec<[i32; 3]>,
}

impl Picture {
    fn inside(&self, [left, top, right, bottom]: [usize; 4]) -> impl Iterator<Item = [i32; 3]> + '_ {
        self.pixels
            .chunks(self.width)
            .take(bottom)
            .skip(top)
            .flat_map(move |row| row[left..right].iter().copied())
    }

    fn count(&self, part: [usize; 4], is: impl Fn([i32; 3]) -> bool) -> usize {
        self.inside(part).filter(|pixel| is(*pixel)).count()
    }

    fn differing(&self, other: &Self, part: [usize; 4], slack: i32) -> usize {
        let differs =
            |(a, b): &([i32; 3], [i32; 3])| (0..3).any(|channel| (a[channel] - b[channel]).abs() > slack);
        self.inside(part).zip(other.inside(part)).filter(differs).count()
    }
}

fn png(path: &Path) -> Result<Picture, Failure> {
    let file = File::open(path).map_err(|error| format!("{}: {error}", path.display()))?;
    let mut reader = png::Decoder::new(BufReader::new(file)).read_info()?;
    let mut bytes = vec![0; reader.output_buffer_size().ok_or("too large")?];
    let info = reader.next_frame(&mut bytes)?;
    let pixels = bytes.chunks_exact(3).map(|rgb| [0, 1, 2].map(|channel| i32::from(rgb[channel]))).collect();
    Ok(Picture { width: info.width as usize, pixels })
}

/// Parses the dump of a screen: a big-endian header (XWDFile.h), then colours, then blue, green, red, unused
/// for each pixel.
fn xwd(path: &Path) -> Result<Picture, Failure> {
    let bytes = std::fs::read(path).map_err(|error| format!("{}: {error}", path.display()))?;
    let field = |index: usize| -> Result<usize, Failure> {
        let four: [u8; 4] = bytes.get(4 * index..4 * index + 4).ok_or("a short dump")?.try_into()?;
        Ok(u32::from_be_bytes(four) as usize)
    };
    let (header, width, height, line, colours) = (field(0)?, field(4)?, field(5)?, field(12)?, field(19)?);
    if field(11)? != 32 {
        return Err("a screen of 24 bits in 32 is needed".into());
    }
    let start = header + 12 * colours;
    let rows = bytes.get(start..start + line * height).ok_or("a short dump")?.chunks_exact(line);
    let pixel = |bgr: &[u8]| [2, 1, 0].map(|channel| i32::from(bgr[channel]));
    Ok(Picture { width, pixels: rows.flat_map(|row| row[..4 * width].chunks_exact(4).map(pixel)).collect() })
}
