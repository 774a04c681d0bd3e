//! Memory that two processes share, as words that any thread of either may read and write.

use core::ptr::NonNull;
use core::sync::atomic::AtomicU64;
use nix::fcntl::{FcntlArg, SealFlag, fcntl};
use nix::sys::memfd::{MFdFlags, memfd_create};
use nix::sys::mman::{MapFlags, ProtFlags, mmap, munmap};
use std::ffi::CStr;
use std::fs::File;
use std::io;
use std::num::NonZeroUsize;
use std::os::fd::{AsFd, OwnedFd};

/// Words in shared memory or in this process; at least one. Their number is set once.
#[derive(Debug)]
pub struct SharedWords {
    words: NonNull<[AtomicU64]>,
    is_mapped: bool,
}

// SAFETY: the words are atomic, and the memory stays valid until the only owner is dropped.
unsafe impl Send for SharedWords {}
// SAFETY: as above.
unsafe impl Sync for SharedWords {}

/// Bytes of `len` words.
fn byte_count(len: usize) -> io::Result<NonZeroUsize> {
    let bytes = len.checked_mul(size_of::<AtomicU64>()).and_then(NonZeroUsize::new);
    bytes.ok_or_else(|| io::ErrorKind::InvalidInput.into())
}

impl SharedWords {
    /// Zeroed words in the memory of this process.
    #[must_use]
    pub fn local(len: usize) -> Self {
        let words: Box<[AtomicU64]> = (0..len.max(1)).map(|_| AtomicU64::new(0)).collect();
        Self { words: NonNull::from(Box::leak(words)), is_mapped: false }
    }

    /// Zeroed words that another process can map, and the descriptor to give it. The name is for a list of the
    /// files that a process has open.
    pub fn create(name: &CStr, len: usize) -> io::Result<(Self, OwnedFd)> {
        let fd = memfd_create(name, MFdFlags::MFD_CLOEXEC | MFdFlags::MFD_ALLOW_SEALING)?;
        File::from(fd.try_clone()?).set_len(byte_count(len)?.get() as u64)?;
        // A file that becomes shorter would end the other process in a bus error.
        fcntl(&fd, FcntlArg::F_ADD_SEALS(SealFlag::F_SEAL_SHRINK | SealFlag::F_SEAL_SEAL))?;
        Ok((Self::map(&fd, len)?, fd))
    }

    /// Maps the first `len` words of another process.
    pub fn map(fd: &OwnedFd, len: usize) -> io::Result<Self> {
        let bytes = byte_count(len)?;
        // A mapping beyond the end of the file would end in a bus error.
        if File::from(fd.try_clone()?).metadata()?.len() < bytes.get() as u64 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        let protection = ProtFlags::PROT_READ | ProtFlags::PROT_WRITE;
        // SAFETY: a new mapping at an address that the kernel chooses; no memory of this program changes.
        let memory = unsafe { mmap(None, bytes, protection, MapFlags::MAP_SHARED, fd.as_fd(), 0) }?;
        Ok(Self { words: NonNull::slice_from_raw_parts(memory.cast(), len), is_mapped: true })
    }

    /// The words.
    #[must_use]
    pub fn words(&self) -> &[AtomicU64] {
        // SAFETY: `words` points to its aligned words (pages or a box) until `self` is dropped, any bits are a
        // valid u64, and all access is atomic.
        unsafe { self.words.as_ref() }
    }
}

impl Drop for SharedWords {
    fn drop(&mut self) {
        if self.is_mapped {
            // SAFETY: the mapping was made by `map` with this length, and no reference outlives `self`.
            let _ = unsafe { munmap(self.words.cast(), size_of::<AtomicU64>() * self.words.len()) };
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
        let (ours, fd) = SharedWords::create(c"palpate-test", 3).expect("memory");
        let theirs = SharedWords::map(&fd, 3).expect("the same memory");
        ours.words()[2].store(5, Ordering::Relaxed);
        let read: Vec<u64> = theirs.words().iter().map(|word| word.load(Ordering::Relaxed)).collect();
        assert_eq!(read, [0, 0, 5]);
        assert!(SharedWords::map(&fd, 5).is_err() && SharedWords::map(&fd, 0).is_err());
        assert!(File::from(fd).set_len(8).is_err(), "no process can shorten it");
        assert_eq!(SharedWords::local(2).words()[1].load(Ordering::Relaxed), 0);
    }
}
