//! The firmware image: a boot stream of the TI C28x, checked before it is sent.
//!
//! Little-endian words: the key 0x08AA, eight reserved words of zero, the entry address (high, low), then
//! blocks of {count, address high, address low, data}, ended by a count of 0. Source: TI SPRU095 (serial boot
//! loader). Palpate contains no firmware, because the maker's licence does not permit it; the user gives the
//! path of a file.

use core::fmt;

/// First word: the key of a boot stream of 8-bit bytes.
const KEY: u16 = 0x08AA;
/// Number of reserved zero words after it.
const RESERVED: usize = 8;
/// Largest image, bytes: twice all the memory of the processor (128 Ki words).
const MAX_LEN: usize = 512 * 1024;

/// Defect of an image. Positions are in bytes from the start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FirmwareError {
    /// Longer than the processor's memory.
    TooLong {
        /// Size, bytes.
        len: usize,
    },
    /// The first word is not the key.
    Key {
        /// The word found, if the image has one.
        found: Option<u16>,
    },
    /// A reserved word that is not zero.
    Reserved {
        /// Position.
        at: usize,
    },
    /// The image ends within its header or a block.
    CutOff {
        /// Position at which more data is expected.
        at: usize,
    },
    /// All blocks are empty: nothing would be loaded.
    Empty,
    /// Data follows the end.
    Trailing {
        /// Position.
        at: usize,
    },
}

impl fmt::Display for FirmwareError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::TooLong { len } => write!(f, "{len} bytes exceed the memory of the device")?,
            Self::Key { found: Some(key) } => write!(f, "begins with {key:#06x} instead of {KEY:#06x}")?,
            Self::Key { found: None } => f.write_str("is empty")?,
            Self::Reserved { at } => write!(f, "the reserved word at byte {at} is not zero")?,
            Self::CutOff { at } => write!(f, "ends at byte {at}, within its header or a block")?,
            Self::Empty => f.write_str("holds no block")?,
            Self::Trailing { at } => write!(f, "continues after its end at byte {at}")?,
        }
        f.write_str("; give the Falcon's firmware as a C28x boot stream, complete and unchanged")
    }
}

impl core::error::Error for FirmwareError {}

/// A checked image.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Image {
    bytes: Vec<u8>,
    entry: u32,
    blocks: usize,
}

impl Image {
    /// Checks an image.
    pub fn new(bytes: Vec<u8>) -> Result<Self, FirmwareError> {
        if bytes.len() > MAX_LEN {
            return Err(FirmwareError::TooLong { len: bytes.len() });
        }
        let mut stream = Words { bytes: &bytes, at: 0 };
        match stream.next() {
            Ok(KEY) => {}
            found => return Err(FirmwareError::Key { found: found.ok() }),
        }
        for _ in 0..RESERVED {
            let at = stream.at;
            if stream.next()? != 0 {
                return Err(FirmwareError::Reserved { at });
            }
        }
        let entry = stream.address()?;
        let mut blocks = 0;
        loop {
            let words = stream.next()?;
            if words == 0 {
                break;
            }
            stream.address()?;
            stream.skip(words)?;
            blocks += 1;
        }
        let end = stream.at;
        if blocks == 0 {
            return Err(FirmwareError::Empty);
        }
        if end != bytes.len() {
            return Err(FirmwareError::Trailing { at: end });
        }
        Ok(Self { bytes, entry, blocks })
    }

    /// The bytes to send.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Entry address of the program.
    #[must_use]
    pub const fn entry(&self) -> u32 {
        self.entry
    }

    /// Number of memory blocks.
    #[must_use]
    pub const fn blocks(&self) -> usize {
        self.blocks
    }

    /// An image that no processor can run, for tests and emulators: two blocks with `words` counting words in
    /// total.
    ///
    /// # Panics
    ///
    /// If there are fewer than two words, or more than fit into two blocks.
    #[must_use]
    pub fn synthetic(words: u16) -> Self {
        assert!(words >= 2, "two blocks need two words");
        let first = words / 2;
        let mut stream = vec![KEY];
        stream.extend([0; RESERVED]);
        stream.extend([0x003F, 0x8000]);
        for (address, block) in [(0x8000, 0..first), (0xA000, first..words)] {
            stream.extend([block.len() as u16, 0x003F, address]);
            stream.extend(block.map(|word| word.wrapping_mul(0x0101)));
        }
        stream.push(0);
        let bytes = stream.into_iter().flat_map(u16::to_le_bytes).collect();
        Self::new(bytes).expect("a valid image")
    }
}

/// Iterator over little-endian words.
#[derive(Debug)]
struct Words<'b> {
    bytes: &'b [u8],
    at: usize,
}

impl Words<'_> {
    fn next(&mut self) -> Result<u16, FirmwareError> {
        let word = self.bytes.get(self.at..).and_then(|rest| rest.first_chunk());
        let word = word.ok_or(FirmwareError::CutOff { at: self.bytes.len() })?;
        self.at += 2;
        Ok(u16::from_le_bytes(*word))
    }

    fn address(&mut self) -> Result<u32, FirmwareError> {
        Ok(u32::from(self.next()?) << 16 | u32::from(self.next()?))
    }

    fn skip(&mut self, words: u16) -> Result<(), FirmwareError> {
        self.at += 2 * usize::from(words);
        if self.at > self.bytes.len() {
            return Err(FirmwareError::CutOff { at: self.bytes.len() });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_valid_image_is_accepted_unchanged() {
        let image = Image::synthetic(1000);
        assert_eq!((image.entry(), image.blocks()), (0x003F_8000, 2));
        // Key, reserved words, entry, two block headers, the words and the end.
        assert_eq!(image.bytes().len(), 2 * (1 + 8 + 2 + 2 * 3 + 1000 + 1));
        assert_eq!(image.bytes()[..4], [0xAA, 0x08, 0, 0]);
        assert_eq!(Image::new(image.bytes().to_vec()), Ok(image));
    }

    #[test]
    fn a_truncated_image_is_refused() {
        let whole = Image::synthetic(20);
        for len in 0..whole.bytes().len() {
            let error = Image::new(whole.bytes()[..len].to_vec()).expect_err("cut");
            let expected =
                if len < 2 { FirmwareError::Key { found: None } } else { FirmwareError::CutOff { at: len } };
            assert_eq!(error, expected, "{len}");
        }
    }

    #[test]
    fn errors_are_one_line_and_name_the_fix() {
        let with = |change: &dyn Fn(&mut Vec<u8>)| {
            let mut bytes = Image::synthetic(20).bytes().to_vec();
            change(&mut bytes);
            Image::new(bytes).expect_err("wrong")
        };
        let errors = [
            (with(&|b| b[1] = 0x10), FirmwareError::Key { found: Some(0x10AA) }),
            (with(&|b| b[7] = 1), FirmwareError::Reserved { at: 6 }),
            (with(&|b| b.push(0)), FirmwareError::Trailing { at: 76 }),
            (with(&|b| b.truncate(30)), FirmwareError::CutOff { at: 30 }),
            (with(&|b| b[22..].fill(0)), FirmwareError::Empty),
            (with(&|b| b.resize(MAX_LEN + 1, 0)), FirmwareError::TooLong { len: MAX_LEN + 1 }),
        ];
        for (error, expected) in errors {
            assert_eq!(error, expected);
            let text = error.to_string();
            assert!(!text.contains('\n') && text.contains("; give"), "{text}");
        }
    }
}
