//! Recognises a `.space` file, complete or damaged. Other files are neither written nor salvaged.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek};
use std::path::Path;

use rusqlite::{Connection, OpenFlags};

use super::error::StoreFault;
use super::reading::{escaped, log_of};
use super::{Store, StoreError};

const MAGIC: &[u8] = b"SQLite format 3\0";

/// First bytes of a write-ahead log, apart from the lowest bit of the last one.
const LOG_MAGIC: &[u8] = &[0x37, 0x7f, 0x06, 0x82];

/// Tables that every space has.
const TABLES: [&str; 3] = ["meta", "configuration", "state"];

/// A statement that only the tables of a space accept.
const COLUMNS: &str = "SELECT active, i, j, k, attempt, tag, parent_i, residual_n FROM configuration";

/// Text that every space contains: a statement of its schema and a key of its meta table. They are on
/// different pages, so one damaged page leaves one of them.
const MARKS: [&[u8]; 2] = [b"CREATE TABLE configuration (", b"displacement_rms_m"];

/// Size of a page of the database.
const PAGE: usize = 4096;

impl Store {
    /// Whether the file is a space: complete, damaged or still empty. No file is created or changed.
    ///
    /// The names of its tables decide. If SQLite cannot read them (a damaged first page, a first commit that
    /// is still in the write-ahead log), the text that every space contains decides.
    pub fn is_space(path: &Path) -> io::Result<bool> {
        let mut head = Vec::with_capacity(MAGIC.len());
        File::open(path)?.take(MAGIC.len() as u64).read_to_end(&mut head)?;
        let tables = if head == MAGIC { tables(path).ok() } else { None };
        if let Some(tables) = tables.as_deref().filter(|tables| !tables.is_empty()) {
            return Ok(TABLES.iter().all(|name| tables.iter().any(|table| table == name)));
        }
        // An empty file or a database without tables: a run that was stopped before its first commit.
        if head.is_empty() || tables.is_some() {
            return Ok(true);
        }
        Ok(has_mark(path)? || log_of(path).exists() && has_mark(&log_of(path))?)
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

/// Names of the tables, read without the write-ahead log and without locks. `configuration` is only among
/// them with the columns of a space.
fn tables(path: &Path) -> rusqlite::Result<Vec<String>> {
    let flags =
        OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX | OpenFlags::SQLITE_OPEN_URI;
    let connection = Connection::open_with_flags(format!("file:{}?immutable=1", escaped(path)), flags)?;
    let mut statement = connection.prepare("SELECT name FROM sqlite_schema WHERE type = 'table'")?;
    let mut names = statement.query_map([], |row| row.get(0))?.collect::<rusqlite::Result<Vec<String>>>()?;
    names.retain(|name| name != TABLES[1] || connection.prepare(COLUMNS).is_ok());
    Ok(names)
}

/// Whether a page of the database or the write-ahead log contains one of the marks. Other files that contain
/// the text, such as this program or an archive of spaces, have no such pages.
fn has_mark(path: &Path) -> io::Result<bool> {
    let mut file = BufReader::new(File::open(path)?);
    let mut head = Vec::with_capacity(32);
    file.by_ref().take(32).read_to_end(&mut head)?;
    let is_log =
        head.starts_with(&LOG_MAGIC[..3]) && head.get(3).is_some_and(|byte| byte | 1 == LOG_MAGIC[3] | 1);
    if !is_log {
        file.rewind()?;
    }
    // A frame of the log is a header of 24 bytes and a page.
    let (before, mut piece) = (if is_log { 24 } else { 0 }, Vec::with_capacity(PAGE + 24));
    loop {
        piece.clear();
        if file.by_ref().take((before + PAGE) as u64).read_to_end(&mut piece)? < before + PAGE {
            return Ok(false);
        }
        let page = &piece[before..];
        let marked = || MARKS.iter().any(|mark| page.windows(mark.len()).any(|part| part == *mark));
        if (is_node(page, 0) || is_node(page, 100)) && marked() {
            return Ok(true);
        }
    }
}

/// Whether a page of SQLite may have the header of a node at this place: kind, cells and their start.
fn is_node(page: &[u8], at: usize) -> bool {
    let [kind, _, _, c1, c0, s1, s0, free] = page[at..at + 8] else { return false };
    let (cells, start) = (usize::from(u16::from_be_bytes([c1, c0])), u16::from_be_bytes([s1, s0]));
    let first = at + if kind < 8 { 12 } else { 8 } + 2 * cells;
    matches!(kind, 2 | 5 | 10 | 13) && cells > 0 && (first..=PAGE).contains(&start.into()) && free <= 60
}
