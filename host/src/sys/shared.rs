//! Memory that two processes share, as words that any thread of either may read and write.

use core::ptr::NonNull;
use core::sync::atomic::AtomicU64;
use nix::sys::memfd::{MFdFlags, memfd_create};
use nix::sys::mman::{MapFlags, ProtFlags, mmap, munmap};
use std::fs::File;
use std::io;
use std::num::NonZeroUsize;
use std::os::fd::{AsFd, OwnedFd};

/// `N` words, in shared memory or in this process.
#[derive(Debug)]
pub struct SharedWords<const N: usize> {
    words: NonNull<[AtomicU64; N]>,
    is_mapped: bool,
}

// SAFETY: the words are atomic, and the memory stays valid until the only owner is dropped.
unsafe impl<const N: usize> Send for SharedWords<N> {}
// SAFETY: as above.
unsafe impl<const N: usize> Sync for SharedWords<N> {}

impl<const N: usize> SharedWords<N> {
    const BYTES: NonZeroUsize = NonZeroUsize::new(8 * N).expect("at least one word");

    /// Zeroed words in the memory of this process.
    #[must_use]
    pub fn local() -> Self {
        let words = Box::new([const { AtomicU64::new(0) }; N]);
        Self { words: NonNull::from(Box::leak(words)), is_mapped: false }
    }

    /// Zeroed words that another process can map, and the descriptor to give it.
    pub fn create() -> io::Result<(Self, OwnedFd)> {
        let fd = memfd_create(c"palpate-guard", MFdFlags::MFD_CLOEXEC)?;
        File::from(fd.try_clone()?).set_len(Self::BYTES.get() as u64)?;
        Ok((Self::map(&fd)?, fd))
    }

    /// Maps the words of another process.
    pub fn map(fd: &OwnedFd) -> io::Result<Self> {
        // A mapping beyond the end of the file would end in a bus error.
        if File::from(fd.try_clone()?).metadata()?.len() < Self::BYTES.get() as u64 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        let protection = ProtFlags::PROT_READ | ProtFlags::PROT_WRITE;
        // SAFETY: a new mapping at an address that the kernel chooses; no memory of this program changes.
        let memory = unsafe { mmap(None, Self::BYTES, protection, MapFlags::MAP_SHARED, fd.as_fd(), 0) }?;
        Ok(Self { words: memory.cast(), is_mapped: true })
    }

    /// The words.
    #[must_use]
    pub fn words(&self) -> &[AtomicU64; N] {
        // SAFETY: `words` points to N aligned words (a page or a box) until `self` is dropped, any bits are a
        // valid u64, and all access is atomic.
        unsafe { self.words.as_ref() }
    }
}

impl<const N: usize> Drop for SharedWords<N> {
    fn drop(&mut self) {
        if self.is_mapped {
            // SAFETY: the mapping was made by `map` with this length, and no reference outlives `self`.
            let _ = unsafe { munmap(self.words.cast(), Self::BYTES.get()) };
        } else {
            // SAFETY: the pointer is that of the box leaked in `local`, and no reference outlives `self`.
            drop(unsafe { Box::from_raw(self.words.as_ptr()) });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::sync::atomic::Ordering;

    #[test]
    fn words_are_zero_and_shared_and_a_short_file_is_refused() {
        let (ours, fd) = SharedWords::<3>::create().expect("memory");
        let theirs = SharedWords::<3>::map(&fd).expect("the same memory");
        ours.words()[2].store(5, Ordering::Relaxed);
        assert_eq!(theirs.words().each_ref().map(|word| word.load(Ordering::Relaxed)), [0, 0, 5]);
        assert!(SharedWords::<5>::map(&fd).is_err());
        assert_eq!(SharedWords::<2>::local().words()[1].load(Ordering::Relaxed), 0);
    }
}
