//! The files of one command: its inputs, and the only way to write its outputs.
//!
//! A command registers its inputs with [`Files`] and then requests each [`Output`], both before any long
//! work. An output is refused if it is the same file as an input or as another output, if an existing file of
//! another kind would be replaced without `--force`, or if the file cannot be created. Only [`Files`] creates
//! an [`Output`].

mod kind;
mod output;

use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use clap::Args as ClapArgs;
use palpate_precompute::scene::Scene;

use crate::failure::Failure;
pub(crate) use kind::FileKind;
pub(crate) use output::{Folder, Output, Stream};

/// The option of every command that writes files.
#[derive(Debug, Clone, Copy, Default, ClapArgs)]
pub(crate) struct Replace {
    /// Replace existing files of another kind; an input is never replaced
    #[arg(long, hide_short_help = true)]
    force: bool,
}

/// The name of standard input and standard output on the command line.
pub(crate) const STANDARD: &str = "-";

/// Suffixes of the files that SQLite keeps beside a database.
const BESIDE_A_SPACE: [&str; 3] = ["-wal", "-shm", "-journal"];

/// The inputs and outputs of a command.
#[derive(Debug, Default)]
pub(crate) struct Files {
    force: bool,
    known: Vec<Known>,
}

/// An input or output of the command.
#[derive(Debug)]
struct Known {
    /// The option that names an output; none for an input.
    option: Option<&'static str>,
    /// The path as given.
    shown: PathBuf,
    identity: Identity,
}

/// Identifies a file: its path with all links followed, and its device and inode if it exists.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Identity {
    place: PathBuf,
    inode: Option<(u64, u64)>,
}

impl Identity {
    fn of(path: &Path) -> io::Result<Self> {
        let place = resolved(path)?;
        let inode = place.metadata().ok().map(|there| (there.dev(), there.ino()));
        Ok(Self { place, inode })
    }

    fn is(&self, other: &Self) -> bool {
        self.place == other.place || (self.inode.is_some() && self.inode == other.inode)
    }
}

/// Largest number of links followed, as in the kernel.
const MAX_LINKS: usize = 40;

/// `path` with all links followed. The file need not exist, its folder must.
fn resolved(path: &Path) -> io::Result<PathBuf> {
    let mut path = path.to_path_buf();
    for _ in 0..MAX_LINKS {
        if let Ok(place) = path.canonicalize() {
            return Ok(place);
        }
        let Ok(target) = std::fs::read_link(&path) else { break };
        path = path.parent().unwrap_or(Path::new("")).join(target);
    }
    let name = path.file_name().ok_or(io::ErrorKind::InvalidInput)?;
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    Ok(folder.canonicalize()?.join(name))
}

impl Files {
    /// No files yet.
    pub(crate) fn new(replace: Replace) -> Self {
        Self { force: replace.force, known: Vec::new() }
    }

    /// Registers an input. A missing file is ignored here; opening it reports the error.
    pub(crate) fn read(&mut self, path: &Path) {
        self.know(None, path);
    }

    /// Registers a scene and every file that it names.
    pub(crate) fn read_scene(&mut self, path: &Path) -> Result<(), Failure> {
        Scene::load(path)?.files().iter().for_each(|file| self.read(file));
        Ok(())
    }

    /// Registers a space that is read and may get more rows, with the files that SQLite keeps beside it.
    pub(crate) fn update_space(&mut self, path: &Path) -> Output {
        self.read(path);
        beside(path).iter().for_each(|file| self.read(file));
        Output::at(path, path)
    }

    fn know(&mut self, option: Option<&'static str>, path: &Path) {
        if let Ok(identity) = Identity::of(path) {
            self.known.push(Known { option, shown: path.to_path_buf(), identity });
        }
    }

    /// An output at `path`, given by `option` on the command line. An existing file of the same kind is
    /// replaced.
    pub(crate) fn write(
        &mut self,
        option: &'static str,
        path: &Path,
        kind: FileKind,
    ) -> Result<Output, Failure> {
        let output = self.place(option, path)?;
        if let Some(found) = output.found()?.filter(|found| ![FileKind::Empty, kind].contains(found)) {
            let shown = path.display();
            let (found, wanted) = (found.name(), kind.name());
            // A space is opened and extended, never written as a whole.
            if kind == FileKind::Space {
                return Err(Failure::input(format!(
                    "{option} {shown}: is {found}, not {wanted}; choose another name"
                )));
            }
            if !self.force {
                return Err(Failure::input(format!(
                    "{option} {shown}: is {found}, not {wanted}; choose another name, or replace it with --force"
                )));
            }
        }
        if kind == FileKind::Space {
            beside(path).iter().for_each(|file| self.know(Some(option), file));
        } else {
            output.probe()?;
        }
        Ok(output)
    }

    /// A table at `path`; `None` for standard output, if there is no path or it is `-`.
    pub(crate) fn table(
        &mut self,
        option: &'static str,
        path: Option<&Path>,
    ) -> Result<Option<Output>, Failure> {
        let path = path.filter(|path| *path != Path::new(STANDARD));
        path.map(|path| self.write(option, path, FileKind::Table)).transpose()
    }

    /// An output that must not exist: a recording or film of a session, which cannot be repeated.
    pub(crate) fn write_new(&mut self, option: &'static str, path: &Path) -> Result<Output, Failure> {
        let output = self.place(option, path)?;
        if output.found()?.is_some_and(|found| found != FileKind::Empty) {
            return Err(Failure::input(format!(
                "{option} {}: already exists, and recordings and films are never replaced; choose another name",
                path.display()
            )));
        }
        output.probe()?;
        Ok(output)
    }

    /// Refuses a folder of outputs at `path` if a file is there.
    pub(crate) fn not_a_file(option: &'static str, path: &Path) -> Result<(), Failure> {
        if path.is_file() {
            return Err(Failure::input(format!("{option} {}: is a file; give a folder", path.display())));
        }
        Ok(())
    }

    /// A folder of outputs, created if it does not exist. `kind_of` gives the kind of each file name that the
    /// command may write; existing files of these names are checked like single outputs.
    pub(crate) fn folder(
        &mut self,
        option: &'static str,
        path: &Path,
        kind_of: impl Fn(&str) -> Option<FileKind>,
    ) -> Result<Folder, Failure> {
        Self::not_a_file(option, path)?;
        let named = |error: &io::Error| Failure::file(path, error);
        std::fs::create_dir_all(path).map_err(|error| named(&error))?;
        let mut names = std::fs::read_dir(path)
            .and_then(|entries| entries.map(|entry| Ok(entry?.file_name())).collect::<io::Result<Vec<_>>>())
            .map_err(|error| named(&error))?;
        names.sort_unstable();
        for name in names {
            if let Some(kind) = name.to_str().and_then(&kind_of) {
                self.write(option, &path.join(&name), kind)?;
            }
        }
        Ok(Folder::of(path))
    }

    /// Registers an output that is neither an input nor another output.
    fn place(&mut self, option: &'static str, path: &Path) -> Result<Output, Failure> {
        let identity = Identity::of(path).map_err(|error| Failure::file(path, &error))?;
        let output = Output::at(path, &identity.place);
        if path.is_dir() {
            return Err(Failure::input(format!(
                "{option} {}: is a folder; give the name of a file",
                path.display()
            )));
        }
        // Writing to a device or a pipe replaces no file.
        if output.is_direct() {
            return Ok(output);
        }
        if let Some(same) = self.known.iter().find(|known| known.identity.is(&identity)) {
            let (shown, other) = (path.display(), same.shown.display());
            return Err(Failure::input(match same.option {
                None => format!(
                    "{option} {shown}: is the input {other}, which would be overwritten; choose another name"
                ),
                Some(of) => format!("{option} {shown}: is the output {of} {other}, too; choose another name"),
            }));
        }
        self.known.push(Known { option: Some(option), shown: path.to_path_buf(), identity });
        Ok(output)
    }
}

/// The files that SQLite keeps beside the database at `path`.
fn beside(path: &Path) -> [PathBuf; 3] {
    BESIDE_A_SPACE.map(|suffix| {
        let mut name = path.as_os_str().to_os_string();
        name.push(suffix);
        name.into()
    })
}

#[cfg(test)]
mod tests;
