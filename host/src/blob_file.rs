//! Loads a blob into memory with the alignment that the reader requires.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use palpate_core::{AlignedBytes, Method};

/// The methods in the order in which a session prefers them: the most accurate with a cost independent of the grid,
/// its fit, then the others.
pub const PREFERENCE: [Method; 8] = [
    Method::Energy,
    Method::Kernel,
    Method::Hermite,
    Method::Tricubic,
    Method::RbfCubic,
    Method::RbfLinear,
    Method::Hybrid,
    Method::Trilinear,
];

/// Bytes of one blob at an address divisible by eight, for an `Organ` to borrow.
///
/// The file is read, not memory-mapped: a page fault in the haptic loop costs more than the memory, and a
/// change of the file would change data that is already checked.
#[derive(Debug, Clone)]
pub struct BlobFile {
    bytes: AlignedBytes,
}

impl BlobFile {
    /// Reads a whole file.
    pub fn load(path: &Path) -> io::Result<Self> {
        Self::of_file(File::open(path)?)
    }

    /// Reads an open file from where it stands to the length that it has now.
    pub fn of_file(mut file: File) -> io::Result<Self> {
        let len = usize::try_from(file.metadata()?.len()).map_err(|_| io::ErrorKind::OutOfMemory)?;
        let mut bytes = AlignedBytes::zeroed(len);
        file.read_exact(&mut bytes)?;
        Ok(Self { bytes })
    }

    /// Copies bytes that are in memory.
    #[must_use]
    pub fn of(bytes: &[u8]) -> Self {
        Self { bytes: AlignedBytes::from(bytes) }
    }

    /// BLAKE3 hash of the file, hexadecimal. Recordings identify their blob by it.
    #[must_use]
    pub fn blake3(&self) -> String {
        blake3::hash(self.bytes()).to_hex().to_string()
    }

    /// The file, byte for byte.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate_core::{BlobError, Organ};

    #[test]
    fn any_length_is_kept_exactly() {
        let directory = tempfile::tempdir().expect("a temporary directory");
        for len in [0_usize, 1, 7, 8, 9, 4097] {
            let path = directory.path().join(format!("{len}"));
            let bytes: Vec<u8> = (0..len).map(|i| i as u8).collect();
            std::fs::write(&path, &bytes).expect("writable");
            assert_eq!(BlobFile::load(&path).expect("readable").bytes(), bytes);
        }
        assert!(BlobFile::load(&directory.path().join("missing")).is_err());
    }

    #[test]
    fn a_loaded_blob_opens_and_a_truncated_one_is_refused() {
        let directory = tempfile::tempdir().expect("a temporary directory");
        let path = directory.path().join("organ.blob");
        let blob = crate::synthetic::organ(&crate::synthetic::Shape::default());
        std::fs::write(&path, &*blob).expect("writable");
        let file = BlobFile::load(&path).expect("readable");
        let organ: Organ<'_> = Organ::read(file.bytes()).expect("a valid blob");
        assert_eq!(organ.spaces.len(), 3);
        std::fs::write(&path, &blob[..blob.len() - 5]).expect("writable");
        let file = BlobFile::load(&path).expect("readable");
        assert!(matches!(<Organ<'_>>::read(file.bytes()), Err(BlobError::Truncated { .. })));
    }
}
