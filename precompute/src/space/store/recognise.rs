//! Recognises a `.space` file, complete or damaged. Other files are neither written nor salvaged.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use rusqlite::{Connection, OpenFlags};

use super::error::StoreFault;
use super::reading::{escaped, log_of};
use super::{Store, StoreError};

const MAGIC: &[u8] = b"SQLite format 3\0";

/// Tables that every space has.
const TABLES: [&str; 3] = ["meta", "configuration", "state"];

/// Text that every space contains: a statement of its schema and a key of its meta table. They are on
/// different pages, so one damaged page leaves one of them.
const MARKS: [&[u8]; 2] = [b"CREATE TABLE configuration (", b"displacement_rms_m"];

/// Bytes read at a time. The first of them distinguish text from binary files, several pages of a space.
const PIECE: usize = 1 << 16;

impl Store {
    /// Whether the file is a space: complete, damaged or still empty. No file is created or changed.
    ///
    /// The names of its tables decide. If SQLite cannot read them (a damaged first page, a first commit that
    /// is still in the write-ahead log), the text that every space contains decides.
    pub fn is_space(path: &Path) -> io::Result<bool> {
        let mut head = Vec::with_capacity(PIECE);
        File::open(path)?.take(PIECE as u64).read_to_end(&mut head)?;
        let tables = if head.starts_with(MAGIC) { tables(path).ok() } else { None };
        if let Some(tables) = tables.as_deref().filter(|tables| !tables.is_empty()) {
            return Ok(TABLES.iter().all(|name| tables.iter().any(|table| table == name)));
        }
        // An empty file or a database without tables: a run that was stopped before its first commit.
        if head.is_empty() || tables.is_some() {
            return Ok(true);
        }
        let is_text = !head.contains(&0);
        Ok(!is_text && (has_mark(path)? || log_of(path).exists() && has_mark(&log_of(path))?))
    }

    /// Refuses a file that is not a space. A file that cannot be read is reported by the code that opens it.
    pub(super) fn expect_space(path: &Path) -> Result<(), StoreError> {
        match Self::is_space(path) {
            Ok(false) => Err(StoreFault::NotASpace.at(path)),
            _ => Ok(()),
        }
    }

    /// The same for a file that is to be salvaged: an empty one is refused, too.
    pub(in crate::space) fn expect_saveable(path: &Path) -> Result<(), StoreError> {
        Self::expect_space(path)?;
        if path.metadata().is_ok_and(|file| file.len() == 0) && !log_of(path).exists() {
            return Err(StoreFault::Empty.at(path));
        }
        Ok(())
    }
}

/// Names of the tables, read without the write-ahead log and without locks.
fn tables(path: &Path) -> rusqlite::Result<Vec<String>> {
    let flags =
        OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX | OpenFlags::SQLITE_OPEN_URI;
    let connection = Connection::open_with_flags(format!("file:{}?immutable=1", escaped(path)), flags)?;
    let mut statement = connection.prepare("SELECT name FROM sqlite_schema WHERE type = 'table'")?;
    let names = statement.query_map([], |row| row.get(0))?;
    names.collect()
}

/// Whether the file contains one of the marks.
fn has_mark(path: &Path) -> io::Result<bool> {
    let longest = MARKS.iter().map(|mark| mark.len()).max().unwrap_or(0);
    let (mut file, mut window) = (File::open(path)?, Vec::with_capacity(PIECE + longest));
    loop {
        if file.by_ref().take(PIECE as u64).read_to_end(&mut window)? == 0 {
            return Ok(false);
        }
        if MARKS.iter().any(|mark| window.windows(mark.len()).any(|part| part == *mark)) {
            return Ok(true);
        }
        // A mark may start in this piece and end in the next.
        window.drain(..window.len().saturating_sub(longest));
    }
}
