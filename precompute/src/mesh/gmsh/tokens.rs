//! The numbers of a Gmsh file, as words of lines or as bytes.
//!
//! The reader of sections is the same for both. Section names, physical names and the counts of version 2.2
//! are lines of text also in a binary file.

use std::path::Path;
use std::str::FromStr;

use crate::error::InputError;
use crate::mesh::lines::{DAMAGED, Lines, Words};

pub(super) const TRUNCATED: &str = "it is truncated: export or copy it again";

/// A source of numbers. A record is what a text file has on one line: a node, an element, or a header.
pub(super) trait Tokens {
    const IS_BINARY: bool;

    /// The next non-empty line of text, trimmed; `None` at the end of the file.
    fn line(&mut self) -> Option<String>;

    /// Skips the rest of a section including its last line `end`; false if there is none.
    fn skip(&mut self, end: &str) -> bool;

    /// Reads the mark of the byte order, which follows the format's line in a binary file.
    fn byte_order(&mut self) -> Result<(), InputError>;

    /// Begins a record; an error at the end of the file names `wanted`.
    fn record(&mut self, wanted: &str) -> Result<(), InputError>;

    /// The next number of the record that has 32 bits in a binary file.
    fn int<T: FromStr + TryFrom<i32>>(&mut self, wanted: &str) -> Result<T, InputError>;

    /// The next number of the record that has 64 bits in a binary file.
    fn size<T: FromStr + TryFrom<u64>>(&mut self, wanted: &str) -> Result<T, InputError>;

    fn real(&mut self, wanted: &str) -> Result<f64, InputError>;

    /// Whether the record can have another number. A binary file has all that the format defines.
    fn is_more(&self) -> bool;

    /// Ends a record; an error if the line has more numbers.
    fn end(&mut self) -> Result<(), InputError>;

    /// Number of the current line, in a text file.
    fn at(&self) -> Option<usize>;
}

pub(super) struct Text<'a> {
    lines: Lines<'a>,
    words: Option<Words<'a>>,
}

impl<'a> Text<'a> {
    pub(super) fn new(file: &'a Path, text: &'a str) -> Self {
        Self { lines: Lines::new(file, text, None), words: None }
    }

    fn words(&mut self) -> &mut Words<'a> {
        self.words.as_mut().expect("a record was begun")
    }
}

impl Tokens for Text<'_> {
    const IS_BINARY: bool = false;

    fn line(&mut self) -> Option<String> {
        let line = self.lines.next_line()?;
        self.words = Some(line.words());
        Some(line.text.to_owned())
    }

    fn skip(&mut self, end: &str) -> bool {
        while let Some(line) = self.lines.next_line() {
            if line.text == end {
                return true;
            }
        }
        false
    }

    fn byte_order(&mut self) -> Result<(), InputError> {
        Ok(())
    }

    fn record(&mut self, wanted: &str) -> Result<(), InputError> {
        self.words = Some(self.lines.expect_line(wanted)?.words());
        Ok(())
    }

    fn int<T: FromStr + TryFrom<i32>>(&mut self, wanted: &str) -> Result<T, InputError> {
        self.words().number(wanted)
    }

    fn size<T: FromStr + TryFrom<u64>>(&mut self, wanted: &str) -> Result<T, InputError> {
        self.words().number(wanted)
    }

    fn real(&mut self, wanted: &str) -> Result<f64, InputError> {
        self.words().number(wanted)
    }

    fn is_more(&self) -> bool {
        self.words.as_ref().is_some_and(|words| words.left() > 0)
    }

    fn end(&mut self) -> Result<(), InputError> {
        self.words().end()
    }

    fn at(&self) -> Option<usize> {
        self.words.as_ref().and_then(|words| words.line.number)
    }
}

pub(super) struct Binary<'a> {
    file: &'a Path,
    rest: &'a [u8],
    little_endian: bool,
}

impl<'a> Binary<'a> {
    pub(super) fn new(file: &'a Path, bytes: &'a [u8]) -> Self {
        Self { file, rest: bytes, little_endian: true }
    }

    fn take<const N: usize>(&mut self, wanted: &str) -> Result<[u8; N], InputError> {
        let Some((&bytes, rest)) = self.rest.split_first_chunk() else {
            let what = format!("the file ends where {wanted} should follow");
            return Err(InputError::new(self.file, what, TRUNCATED));
        };
        self.rest = rest;
        let mut bytes: [u8; N] = bytes;
        if !self.little_endian {
            bytes.reverse();
        }
        Ok(bytes)
    }

    fn wrong(&self, wanted: &str, found: impl std::fmt::Display) -> InputError {
        InputError::new(self.file, format!("expected {wanted}, found {found}"), DAMAGED)
    }
}

impl Tokens for Binary<'_> {
    const IS_BINARY: bool = true;

    fn line(&mut self) -> Option<String> {
        // The line break after a block of numbers comes before the next line.
        self.rest = self.rest.trim_ascii_start();
        if self.rest.is_empty() {
            return None;
        }
        let end = self.rest.iter().position(|&byte| byte == b'\n').map_or(self.rest.len(), |at| at + 1);
        let (line, rest) = self.rest.split_at(end);
        self.rest = rest;
        Some(String::from_utf8_lossy(line).trim().to_owned())
    }

    fn skip(&mut self, end: &str) -> bool {
        let at = self.rest.windows(end.len()).position(|window| window == end.as_bytes());
        self.rest = at.map_or(&[], |at| &self.rest[at + end.len()..]);
        at.is_some()
    }

    fn byte_order(&mut self) -> Result<(), InputError> {
        let mark = self.take::<4>("the mark of the byte order")?;
        self.little_endian = match (u32::from_le_bytes(mark), u32::from_be_bytes(mark)) {
            (1, _) => true,
            (_, 1) => false,
            (mark, _) => return Err(self.wrong("the mark 1 of the byte order", mark)),
        };
        Ok(())
    }

    fn record(&mut self, _wanted: &str) -> Result<(), InputError> {
        Ok(())
    }

    fn int<T: FromStr + TryFrom<i32>>(&mut self, wanted: &str) -> Result<T, InputError> {
        let number = i32::from_le_bytes(self.take(wanted)?);
        T::try_from(number).map_err(|_| self.wrong(wanted, number))
    }

    fn size<T: FromStr + TryFrom<u64>>(&mut self, wanted: &str) -> Result<T, InputError> {
        let number = u64::from_le_bytes(self.take(wanted)?);
        T::try_from(number).map_err(|_| self.wrong(wanted, number))
    }

    fn real(&mut self, wanted: &str) -> Result<f64, InputError> {
        self.take(wanted).map(f64::from_le_bytes)
    }

    fn is_more(&self) -> bool {
        true
    }

    fn end(&mut self) -> Result<(), InputError> {
        Ok(())
    }

    fn at(&self) -> Option<usize> {
        None
    }
}
