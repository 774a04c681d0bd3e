//! A small writer of blobs. The real one is in `palpate-precompute`.

use palpate_core::AlignedBytes;
use palpate_core::format::{self, PlaneRef, Preamble, SpaceHeader};

/// A blob before it is written.
pub struct Draft {
    pub preamble: Preamble,
    pub spaces: Vec<SpaceHeader>,
    pub area: Area,
}

impl Draft {
    pub fn write(&self) -> AlignedBytes {
        let mut header = postcard::to_allocvec(&self.preamble).expect("serialised");
        for space in &self.spaces {
            header.extend(postcard::to_allocvec(space).expect("serialised"));
        }
        let mut bytes = Vec::new();
        format::write(&header, &self.area.bytes, |piece| bytes.extend_from_slice(piece))
            .expect("a short header");
        AlignedBytes::from(&bytes)
    }
}

/// The plane area of a blob.
#[derive(Default)]
pub struct Area {
    pub bytes: Vec<u8>,
}

impl Area {
    /// Adds a plane.
    pub fn push<T: bytemuck::Pod>(&mut self, plane: &[T]) -> PlaneRef {
        self.bytes.resize(self.bytes.len().next_multiple_of(format::ALIGNMENT), 0);
        let offset = self.bytes.len() as u32;
        self.bytes.extend_from_slice(bytemuck::cast_slice(plane));
        PlaneRef { offset, len: plane.len() as u32 }
    }

    /// The bytes of a plane of elements of `size` bytes, to be changed.
    pub fn plane(&mut self, plane: PlaneRef, size: usize) -> &mut [u8] {
        &mut self.bytes[plane.offset as usize..][..plane.len as usize * size]
    }
}

/// Sets the checksum to that of the bytes.
pub fn sign(bytes: &mut [u8]) {
    let end = bytes.len() - 4;
    let checksum = format::CHECKSUM.checksum(&bytes[..end]);
    bytes[end..].copy_from_slice(&checksum.to_le_bytes());
}
