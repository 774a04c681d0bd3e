//! Why a store cannot be used, with the remedy.

use std::path::{Path, PathBuf};

use rusqlite::ErrorCode;

/// Why a store cannot be used.
#[derive(Debug)]
pub enum StoreError {
    /// SQLite reports an error.
    Sqlite {
        /// The file.
        path: PathBuf,
        /// The error.
        error: rusqlite::Error,
    },
    /// The operating system reports an error.
    Io {
        /// The file.
        path: PathBuf,
        /// The error.
        error: std::io::Error,
    },
    /// The file has a write-ahead log and lies in a folder without write permission.
    LogBeside {
        /// The file.
        path: PathBuf,
    },
    /// A run was stopped before its first commit.
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// The file is not a space.
    NotASpace {
        /// The file.
        path: PathBuf,
    },
    /// Another process writes the file.
    InUse {
        /// The file.
        path: PathBuf,
    },
    /// The file belongs to another scene, mesh or solver.
    Mismatch {
        /// The file.
        path: PathBuf,
        /// The property that differs.
        what: &'static str,
        /// Value in the file.
        stored: String,
        /// Value of this run.
        wanted: String,
    },
    /// The held-out positions of the file were drawn by another rule.
    Drawn {
        /// The file.
        path: PathBuf,
        /// Value in the file.
        stored: String,
        /// Value of this run.
        wanted: String,
    },
    /// A result with a number that is infinite or NaN, which is not written.
    NotFinite {
        /// The file.
        path: PathBuf,
        /// The result.
        what: String,
    },
    /// A value in the file is invalid.
    Corrupt {
        /// The file.
        path: PathBuf,
        /// The value.
        what: String,
    },
}

/// Whether the disk is full. SQLite reports a full disk under a separate code for the index of the log.
fn is_full_disk(error: &rusqlite::Error) -> bool {
    error.sqlite_error_code() == Some(ErrorCode::DiskFull)
        || error.sqlite_error().is_some_and(|e| e.extended_code == rusqlite::ffi::SQLITE_IOERR_SHMSIZE)
}

/// How to salvage a damaged file.
const SALVAGE: &str = "run the same precompute with --salvage to save what is intact";

impl StoreError {
    pub(super) fn sqlite(path: &Path, error: rusqlite::Error) -> Self {
        Self::Sqlite { path: path.to_path_buf(), error }
    }

    /// Whether the machine or the computation failed, not the input.
    pub fn is_of_the_machine(&self) -> bool {
        let Self::Sqlite { error, .. } = self else { return matches!(self, Self::NotFinite { .. }) };
        matches!(error.sqlite_error_code(), Some(ErrorCode::DiskFull | ErrorCode::SystemIoFailure))
    }

    /// Whether the file itself is damaged, so that a salvage makes sense.
    pub fn is_damage(&self) -> bool {
        match self {
            Self::Corrupt { .. } => true,
            Self::Sqlite { error, .. } => {
                matches!(
                    error.sqlite_error_code(),
                    Some(ErrorCode::DatabaseCorrupt | ErrorCode::NotADatabase)
                ) || matches!(error, rusqlite::Error::InvalidColumnType(..))
            }
            _ => false,
        }
    }
}

impl std::fmt::Display for StoreError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Sqlite { path, error } => {
                let path = path.display();
                match error.sqlite_error_code() {
                    _ if is_full_disk(error) => write!(
                        f,
                        "{path}: the disk is full; earlier results are kept: free some space and run the same command again"
                    ),
                    Some(ErrorCode::ReadOnly | ErrorCode::PermissionDenied) => {
                        write!(f, "{path}: is not writable ({error}); choose a writable folder with --out")
                    }
                    Some(ErrorCode::CannotOpen) => {
                        write!(
                            f,
                            "{path}: cannot be opened (SQLite: unable to open database file); check that its folder exists and is writable, or choose another"
                        )
                    }
                    Some(ErrorCode::SystemIoFailure) => write!(
                        f,
                        "{path}: the disk failed ({error}); earlier results are kept: check its free space and its state, and run the same command again"
                    ),
                    Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => {
                        write!(f, "{path}: another process is writing it; wait for it or stop it")
                    }
                    _ if self.is_damage() => write!(f, "{path}: is damaged ({error}); {SALVAGE}"),
                    _ => write!(f, "{path}: {error}; check the disk, and that it is a .space file"),
                }
            }
            Self::Io { path, error } => {
                write!(f, "{}: {error}; check the name, the folder and its permissions", path.display())
            }
            Self::Empty { path } => {
                write!(
                    f,
                    "{}: contains no configuration yet; run `palpate precompute` with it as --out",
                    path.display()
                )
            }
            Self::NotASpace { path } => {
                write!(f, "{}: is not a .space file; check the name, or choose another", path.display())
            }
            Self::LogBeside { path } => {
                let path = path.display();
                write!(
                    f,
                    "{path}: its last commits are in {path}-wal, and its folder is not writable; copy both files to a writable folder"
                )
            }
            Self::InUse { path } => {
                write!(f, "{}: another process is writing it; wait for it or stop it", path.display())
            }
            Self::Mismatch { path, what, stored, wanted } => write!(
                f,
                "{}: was made with a different {what} ({stored}, now {wanted}); give --out another name or delete the file",
                path.display()
            ),
            Self::Drawn { path, stored, wanted } => write!(
                f,
                "{}: contains held-out positions of a different draw ({stored}; now {wanted}); use the same draw, or --again for a new one",
                path.display()
            ),
            Self::NotFinite { path, what } => write!(
                f,
                "{}: {what} has a number that is not finite, and is not stored; please report it with the scene",
                path.display()
            ),
            Self::Corrupt { path, what } => write!(f, "{}: {what}; {SALVAGE}", path.display()),
        }
    }
}

impl std::error::Error for StoreError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Sqlite { error, .. } => Some(error),
            Self::Io { error, .. } => Some(error),
            _ => None,
        }
    }
}
