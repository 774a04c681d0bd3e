//! Opens a store for reading, in any folder.

use std::path::{Path, PathBuf};

use rusqlite::{Connection, ErrorCode, OpenFlags};

use super::error::{StoreError, StoreFault};

/// A read-only connection.
///
/// For a file with a write-ahead log SQLite needs a `-shm` file beside it, which it cannot create in a folder
/// without write permission. If no log exists, no process writes the file, and it is opened as `immutable`.
pub(super) fn connect(path: &Path) -> Result<Connection, StoreError> {
    let at = |error| StoreFault::Sqlite(error).at(path);
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let plain = Connection::open_with_flags(path, flags).and_then(probed);
    let refused = match plain {
        Ok(connection) => return Ok(connection),
        Err(error) => error,
    };
    let in_the_way = [ErrorCode::CannotOpen, ErrorCode::ReadOnly].map(Some);
    if !in_the_way.contains(&refused.sqlite_error_code()) || std::fs::File::open(path).is_err() {
        return Err(at(refused));
    }
    let log = log_of(path);
    if log.metadata().is_ok_and(|log| log.len() > 0) {
        return Err(StoreFault::LogBeside(log).at(path));
    }
    let uri = format!("file:{}?immutable=1", escaped(path));
    Connection::open_with_flags(uri, flags | OpenFlags::SQLITE_OPEN_URI).and_then(probed).map_err(at)
}

/// Runs a first query, because SQLite opens a file only then.
fn probed(connection: Connection) -> rusqlite::Result<Connection> {
    connection.query_row("SELECT count(*) FROM sqlite_schema", [], |_| Ok(()))?;
    Ok(connection)
}

/// Path of the write-ahead log of `path`.
pub(super) fn log_of(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_os_string();
    name.push("-wal");
    name.into()
}

/// The path, escaped for a URI.
pub(super) fn escaped(path: &Path) -> String {
    let plain = |b: u8| b.is_ascii_alphanumeric() || b"/._-".contains(&b);
    let bytes = path.as_os_str().as_encoded_bytes();
    bytes.iter().map(|&b| if plain(b) { char::from(b).to_string() } else { format!("%{b:02X}") }).collect()
}
