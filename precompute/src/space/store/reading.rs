//! Opening a store to read it, wherever it lies.

use std::path::{Path, PathBuf};

use rusqlite::{Connection, ErrorCode, OpenFlags};

use super::StoreError;

/// A read-only connection.
///
/// SQLite reads a file with a write-ahead log by way of a `-shm` file beside it, which it cannot make in a folder that may
/// not be written. Where no log is left over, nobody writes the file and it can be read as it is (`immutable`).
pub(super) fn connect(path: &Path) -> Result<Connection, StoreError> {
    let at = |error| StoreError::sqlite(path, error);
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
    if log_of(path).metadata().is_ok_and(|log| log.len() > 0) {
        return Err(StoreError::LogBeside { path: path.to_path_buf() });
    }
    let uri = format!("file:{}?immutable=1", escaped(path));
    Connection::open_with_flags(uri, flags | OpenFlags::SQLITE_OPEN_URI).and_then(probed).map_err(at)
}

/// SQLite opens a file when it is first asked for something.
fn probed(connection: Connection) -> rusqlite::Result<Connection> {
    connection.query_row("SELECT count(*) FROM sqlite_schema", [], |_| Ok(()))?;
    Ok(connection)
}

/// The write-ahead log of `path`.
pub(super) fn log_of(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_os_string();
    name.push("-wal");
    name.into()
}

/// A path as part of a URI.
pub(super) fn escaped(path: &Path) -> String {
    let plain = |b: u8| b.is_ascii_alphanumeric() || b"/._-".contains(&b);
    let bytes = path.as_os_str().as_encoded_bytes();
    bytes.iter().map(|&b| if plain(b) { char::from(b).to_string() } else { format!("%{b:02X}") }).collect()
}
