//! Why a store cannot be used, with the remedy.

use std::path::{Path, PathBuf};

use rusqlite::ErrorCode;

/// A file and why it cannot be used as a store.
#[derive(Debug, thiserror::Error)]
#[error("{}: {fault}", path.display())]
pub struct StoreError {
    path: PathBuf,
    #[source]
    fault: StoreFault,
}

/// Why a file cannot be used as a store.
#[derive(Debug, thiserror::Error)]
pub(in crate::space) enum StoreFault {
    /// SQLite reports an error.
    #[error("{}", of_sqlite(.0))]
    Sqlite(#[source] rusqlite::Error),
    /// The operating system reports an error.
    #[error("{0}; check the name, the folder and its permissions")]
    Io(#[source] std::io::Error),
    /// The file has this write-ahead log and lies in a folder without write permission.
    #[error(
        "its last commits are in {}, and its folder is not writable; copy both files to a writable folder",
        .0.display()
    )]
    LogBeside(PathBuf),
    /// A run was stopped before its first commit.
    #[error("contains no configuration yet; run `palpate precompute` with it as --out")]
    Empty,
    #[error("is not a .space file; check the name, or choose another")]
    NotASpace,
    /// A file that was to be salvaged.
    #[error("is not damaged; run the same command without --salvage")]
    NotDamaged,
    #[error("another process is writing it; wait for it or stop it")]
    InUse,
    /// The file belongs to another scene, mesh or solver.
    #[error(
        "was made with a different {what} ({stored}, now {wanted}); give --out another name or delete the file"
    )]
    Mismatch { what: &'static str, stored: String, wanted: String },
    /// The held-out positions of the file were drawn by another rule.
    #[error(
        "contains held-out positions of a different draw ({stored}; now {wanted}); use the same draw, or --again \
         for a new one"
    )]
    Drawn { stored: String, wanted: String },
    /// A result with a number that is infinite or NaN, which is not written.
    #[error("{0} has a number that is not finite, and is not stored; please report it with the scene")]
    NotFinite(String),
    /// A value in the file is invalid.
    #[error("{0}; {SALVAGE}")]
    Corrupt(String),
}

/// How to salvage a damaged file.
const SALVAGE: &str = "run the same precompute with --salvage to save what is intact";

fn of_sqlite(error: &rusqlite::Error) -> String {
    // SQLite reports a full disk under a separate code for the index of the log.
    let is_full = error.sqlite_error_code() == Some(ErrorCode::DiskFull)
        || error.sqlite_error().is_some_and(|e| e.extended_code == rusqlite::ffi::SQLITE_IOERR_SHMSIZE);
    let is_damage =
        matches!(error.sqlite_error_code(), Some(ErrorCode::DatabaseCorrupt | ErrorCode::NotADatabase))
            || matches!(error, rusqlite::Error::InvalidColumnType(..));
    match error.sqlite_error_code() {
        _ if is_full => {
            "the disk is full; earlier results are kept: free some space and run the same command again".into()
        }
        Some(ErrorCode::ReadOnly | ErrorCode::PermissionDenied) => {
            format!("is not writable ({error}); choose a writable folder with --out")
        }
        Some(ErrorCode::CannotOpen) => {
            "cannot be opened (SQLite: unable to open database file); check that its folder exists and is writable, or \
             choose another"
                .into()
        }
        Some(ErrorCode::SystemIoFailure) => format!(
            "the disk failed ({error}); earlier results are kept: check its free space and its state, and run the same \
             command again"
        ),
        Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => StoreFault::InUse.to_string(),
        _ if is_damage => format!("is damaged ({error}); {SALVAGE}"),
        _ => format!("{error}; check the disk, and that it is a .space file"),
    }
}

impl StoreFault {
    /// The error of this fault in the file at `path`.
    pub(in crate::space) fn at(self, path: &Path) -> StoreError {
        StoreError { path: path.to_path_buf(), fault: self }
    }
}

impl StoreError {
    pub(in crate::space) fn fault(&self) -> &StoreFault {
        &self.fault
    }

    /// Whether the machine or the computation failed, not the input.
    pub(crate) fn is_of_the_machine(&self) -> bool {
        let StoreFault::Sqlite(error) = &self.fault else {
            return matches!(self.fault, StoreFault::NotFinite(_));
        };
        matches!(error.sqlite_error_code(), Some(ErrorCode::DiskFull | ErrorCode::SystemIoFailure))
    }
}
