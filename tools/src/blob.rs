//! Opens a blob for a command.

use std::path::Path;

use palpate_core::Organ;
use palpate_host::BlobFile;

use crate::failure::Failure;

/// Loads the file at `path`.
pub(crate) fn load(path: &Path) -> Result<BlobFile, Failure> {
    BlobFile::load(path).map_err(|error| Failure::file(path, &error))
}

/// Checks a loaded file and returns the view of it that the loop uses.
pub(crate) fn organ<'a>(path: &Path, file: &'a BlobFile) -> Result<Organ<'a>, Failure> {
    Organ::read(file.bytes()).map_err(|error| Failure::input(format!("{}: {error}", path.display())))
}
