//! The serial boot stream of a TI C28x (TI SPRU095), parsed byte by byte, and written for tests.
//!
//! Words have 16 bits, low byte first: the key, eight reserved zero words, the entry address (high, low),
//! then blocks of {count, address high, address low, data}. A count of zero ends the stream.

/// First word of every stream.
const KEY: u16 = 0x08aa;
/// Words between the key and the entry address.
const RESERVED: usize = 8;
/// The processor addresses 4 M words.
const ADDRESS_LIMIT: u32 = 1 << 22;

/// Content of a complete stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Image {
    /// Entry address of the firmware.
    pub entry: u32,
    /// Number of blocks.
    pub blocks: u32,
    /// Number of data words in all blocks.
    pub words: u32,
}

/// Why a stream is invalid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImageError {
    /// The first word is not the key.
    Key(u16),
    /// A reserved word is not zero.
    Reserved(u16),
    /// An address out of range.
    Address(u32),
    /// Bytes after the end.
    Trailing,
}

impl core::fmt::Display for ImageError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Key(word) => write!(f, "the stream begins with {word:#06x}, expected {KEY:#06x}"),
            Self::Reserved(word) => write!(f, "a reserved word is {word:#06x}, expected 0"),
            Self::Address(address) => write!(f, "address {address:#x} is beyond 22 bits"),
            Self::Trailing => f.write_str("bytes after the end of the stream"),
        }
    }
}

impl core::error::Error for ImageError {}

/// The expected word.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Expected {
    Key,
    Reserved { left: usize },
    EntryHigh,
    EntryLow { high: u16 },
    Count,
    AddressHigh { count: u16 },
    AddressLow { count: u16, high: u16 },
    Data { left: u16 },
    Nothing,
}

/// A partly received stream.
#[derive(Debug, Clone)]
pub struct BootStream {
    low: Option<u8>,
    expected: Expected,
    image: Image,
}

impl Default for BootStream {
    fn default() -> Self {
        Self { low: None, expected: Expected::Key, image: Image::default() }
    }
}

impl BootStream {
    /// Takes a byte. Returns the image at the end of the stream.
    pub fn take(&mut self, byte: u8) -> Result<Option<Image>, ImageError> {
        let Some(low) = self.low.take() else {
            self.low = Some(byte);
            return if self.expected == Expected::Nothing { Err(ImageError::Trailing) } else { Ok(None) };
        };
        self.expected = self.after(u16::from_le_bytes([low, byte]))?;
        Ok((self.expected == Expected::Nothing).then_some(self.image))
    }

    fn after(&mut self, word: u16) -> Result<Expected, ImageError> {
        Ok(match self.expected {
            Expected::Key if word == KEY => Expected::Reserved { left: RESERVED },
            Expected::Key => return Err(ImageError::Key(word)),
            Expected::Reserved { .. } if word != 0 => return Err(ImageError::Reserved(word)),
            Expected::Reserved { left: 1 } => Expected::EntryHigh,
            Expected::Reserved { left } => Expected::Reserved { left: left - 1 },
            Expected::EntryHigh => Expected::EntryLow { high: word },
            Expected::EntryLow { high } => {
                self.image.entry = address(high, word, 1)?;
                Expected::Count
            }
            Expected::Count if word == 0 => Expected::Nothing,
            Expected::Count => Expected::AddressHigh { count: word },
            Expected::AddressHigh { count } => Expected::AddressLow { count, high: word },
            Expected::AddressLow { count, high } => {
                address(high, word, count)?;
                self.image.blocks += 1;
                Expected::Data { left: count }
            }
            Expected::Data { left } => {
                self.image.words += 1;
                if left == 1 { Expected::Count } else { Expected::Data { left: left - 1 } }
            }
            Expected::Nothing => return Err(ImageError::Trailing),
        })
    }
}

/// An address that is followed by `words` words.
fn address(high: u16, low: u16, words: u16) -> Result<u32, ImageError> {
    let address = u32::from(high) << 16 | u32::from(low);
    if address.saturating_add(u32::from(words)) > ADDRESS_LIMIT {
        return Err(ImageError::Address(address));
    }
    Ok(address)
}

/// A synthetic stream. The emulated board ignores the data of a valid stream.
#[must_use]
pub fn synthetic_image(entry: u32, blocks: &[(u32, &[u16])]) -> Vec<u8> {
    let halves = |address: u32| [(address >> 16) as u16, address as u16];
    let mut words = vec![KEY];
    words.extend([0; RESERVED]);
    words.extend(halves(entry));
    for (address, data) in blocks {
        words.push(u16::try_from(data.len()).expect("a block of up to 65,535 words"));
        words.extend(halves(*address));
        words.extend(*data);
    }
    words.push(0);
    words.into_iter().flat_map(u16::to_le_bytes).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(bytes: &[u8]) -> Result<Option<Image>, ImageError> {
        let mut stream = BootStream::default();
        let mut image = None;
        for byte in bytes {
            image = stream.take(*byte)?;
        }
        Ok(image)
    }

    fn valid() -> Vec<u8> {
        synthetic_image(0x3f_8000, &[(0x3f_8000, &[1, 2, 3]), (0x8000, &[0xffff; 40])])
    }

    #[test]
    fn a_valid_stream_ends_at_its_last_byte() {
        let bytes = valid();
        assert_eq!(bytes[..4], [0xaa, 0x08, 0, 0]);
        assert_eq!(bytes.len(), 2 * (1 + 8 + 2 + 3 + 3 + 3 + 40 + 1));
        assert_eq!(read(&bytes), Ok(Some(Image { entry: 0x3f_8000, blocks: 2, words: 43 })));
        for len in 0..bytes.len() {
            assert_eq!(read(&bytes[..len]), Ok(None));
        }
    }

    #[test]
    fn each_defect_has_its_error() {
        let mut bytes = valid();
        bytes.push(0);
        assert_eq!(read(&bytes), Err(ImageError::Trailing));
        let damaged = |at: usize, byte| {
            let mut bytes = valid();
            bytes[at] = byte;
            read(&bytes)
        };
        assert_eq!(damaged(0, 0xab), Err(ImageError::Key(0x08ab)));
        assert_eq!(damaged(16, 1), Err(ImageError::Reserved(1)));
        assert_eq!(damaged(18, 0x40), Err(ImageError::Address(0x40_8000)));
        assert_eq!(damaged(24, 0x40), Err(ImageError::Address(0x40_8000)));
        assert!(read(&synthetic_image(0, &[(0x3f_ffff, &[0])])).is_ok_and(|image| image.is_some()));
        assert_eq!(read(&synthetic_image(0, &[(0x3f_ffff, &[0; 2])])), Err(ImageError::Address(0x3f_ffff)));
    }
}
