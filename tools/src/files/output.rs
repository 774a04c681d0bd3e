//! One output of a command: a file that is written completely or not at all.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use palpate_precompute::write_atomically;

use super::{FileKind, beside};
use crate::failure::Failure;

/// A file that [`Files`](super::Files) allows the command to write.
#[derive(Debug, Clone)]
pub(crate) struct Output {
    /// The path as given.
    shown: PathBuf,
    /// The path with all links followed, so that a link is kept.
    place: PathBuf,
}

impl Output {
    pub(super) fn at(shown: &Path, place: &Path) -> Self {
        Self { shown: shown.to_path_buf(), place: place.to_path_buf() }
    }

    /// A file in a temporary folder of this process.
    #[cfg(test)]
    pub(crate) fn in_scratch(folder: &tempfile::TempDir, name: &str) -> Self {
        let path = folder.path().join(name);
        Self::at(&path, &path)
    }

    /// The path as given.
    pub(crate) fn path(&self) -> &Path {
        &self.shown
    }

    /// Whether it is a device or a pipe, which is written in place.
    pub(super) fn is_direct(&self) -> bool {
        self.place.metadata().is_ok_and(|there| !there.is_file() && !there.is_dir())
    }

    /// Kind of the existing file, if there is one.
    pub(super) fn found(&self) -> Result<Option<FileKind>, Failure> {
        if self.is_direct() || !self.place.exists() {
            return Ok(None);
        }
        FileKind::of(&self.place).map(Some).map_err(|error| self.failure(&error))
    }

    /// Creates and deletes an unnamed file in the folder, to report a read-only folder before the work.
    pub(super) fn probe(&self) -> Result<(), Failure> {
        if self.is_direct() {
            return Ok(());
        }
        let folder = self.place.parent().unwrap_or(Path::new("/"));
        tempfile::tempfile_in(folder).map(drop).map_err(|error| self.failure(&error))
    }

    /// An error of this file as a failure of the command.
    pub(crate) fn failure(&self, error: &io::Error) -> Failure {
        Failure::file(&self.shown, error)
    }

    /// Writes the file under a temporary name, then renames it.
    pub(crate) fn put(&self, bytes: &[u8]) -> Result<(), Failure> {
        write_atomically(&self.place, bytes).map_err(|error| self.failure(&error))
    }

    /// Opens the file for writing in pieces, under a temporary name until [`Stream::finish`].
    pub(crate) fn stream(&self) -> Result<Stream, Failure> {
        let temporary = (!self.is_direct()).then(|| {
            let mut name = self.place.file_name().unwrap_or_default().to_os_string();
            name.push(format!(".{}.part", std::process::id()));
            self.place.with_file_name(name)
        });
        let file = File::create(temporary.as_ref().unwrap_or(&self.place));
        let file = BufWriter::new(file.map_err(|error| self.failure(&error))?);
        Ok(Stream { output: self.clone(), temporary, file })
    }

    /// Deletes the file, if it exists and is not a device.
    pub(crate) fn remove(&self) -> Result<(), Failure> {
        if self.is_direct() {
            return Ok(());
        }
        match std::fs::remove_file(&self.place) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(self.failure(&error)),
            _ => Ok(()),
        }
    }

    /// Deletes a database with the files that SQLite keeps beside it.
    pub(crate) fn remove_database(&self) -> Result<(), Failure> {
        self.remove()?;
        beside(&self.shown).iter().try_for_each(|path| Self::at(path, path).remove())
    }

    /// Creates the file under its own name; it must not exist. What is written before an error is kept.
    pub(crate) fn create_new(&self) -> Result<File, Failure> {
        let file = if self.is_direct() { File::create(&self.place) } else { File::create_new(&self.place) };
        file.map_err(|error| self.failure(&error))
    }
}

/// A file being written; it is deleted if it is dropped before [`Stream::finish`].
#[derive(Debug)]
pub(crate) struct Stream {
    output: Output,
    temporary: Option<PathBuf>,
    file: BufWriter<File>,
}

impl Stream {
    /// Renames the complete file.
    pub(crate) fn finish(mut self) -> Result<(), Failure> {
        let written = self.file.flush().and_then(|()| match &self.temporary {
            Some(temporary) => std::fs::rename(temporary, &self.output.place),
            None => Ok(()),
        });
        written.map_err(|error| self.output.failure(&error))?;
        self.temporary = None;
        Ok(())
    }
}

impl Write for Stream {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        if let Some(temporary) = &self.temporary {
            // The first error is the one to report.
            let _ = std::fs::remove_file(temporary);
        }
    }
}

/// A folder in which [`Files`](super::Files) allows the command to write.
#[derive(Debug, Clone)]
pub(crate) struct Folder(PathBuf);

impl Folder {
    pub(super) fn of(path: &Path) -> Self {
        Self(path.to_path_buf())
    }

    /// The folder.
    pub(crate) fn path(&self) -> &Path {
        &self.0
    }

    /// An output in the folder; `name` is one that the folder was checked for.
    pub(crate) fn file(&self, name: &str) -> Output {
        let path = self.0.join(name);
        Output::at(&path, &path)
    }
}
