//! Aligned bytes: the planes of a blob are used in place, and those of f64 need an address divisible by 8.

#[cfg(feature = "alloc")]
use alloc::vec::Vec;
#[cfg(feature = "alloc")]
use core::ops::{Deref, DerefMut};

/// A value at an address divisible by 64, for a blob that is compiled into the program.
///
/// ```
/// use palpate_core::{Aligned, Organ};
///
/// static BLOB: &Aligned<[u8]> = &Aligned(*include_bytes!("../../golden/organ-514.blob"));
/// let organ: Organ = Organ::read(&BLOB.0)?;
/// # Ok::<(), palpate_core::BlobError>(())
/// ```
#[repr(C, align(64))]
#[derive(Debug, Clone, Copy)]
pub struct Aligned<T: ?Sized>(pub T);

/// Bytes on the heap at an address divisible by 8, for a blob that is read at run time. Needs the feature
/// `alloc`.
#[cfg(feature = "alloc")]
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct AlignedBytes {
    words: Vec<u64>,
    len: usize,
}

#[cfg(feature = "alloc")]
impl AlignedBytes {
    /// `len` bytes, all zero, for the caller to overwrite.
    pub fn zeroed(len: usize) -> Self {
        Self { words: alloc::vec![0; len.div_ceil(8)], len }
    }
}

#[cfg(feature = "alloc")]
impl<B: AsRef<[u8]> + ?Sized> From<&B> for AlignedBytes {
    fn from(bytes: &B) -> Self {
        let mut copy = Self::zeroed(bytes.as_ref().len());
        copy.copy_from_slice(bytes.as_ref());
        copy
    }
}

#[cfg(feature = "alloc")]
impl Deref for AlignedBytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        bytemuck::cast_slice(&self.words).get(..self.len).unwrap_or_default()
    }
}

#[cfg(feature = "alloc")]
impl DerefMut for AlignedBytes {
    fn deref_mut(&mut self) -> &mut [u8] {
        bytemuck::cast_slice_mut(&mut self.words).get_mut(..self.len).unwrap_or_default()
    }
}
