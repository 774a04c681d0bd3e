//! Where bytes of the caller become Rust's: the only unsafe blocks of the library.
//!
//! Every function here believes what `palpate.h` asks of the caller: a pointer that is not null is good for the length given with it.

use core::mem::MaybeUninit;
use core::slice;

/// Moves `value` into the caller's memory. `None` if that is null, too small or not aligned for it.
pub(crate) fn place<T>(memory: *mut u8, len: usize, value: T) -> Option<&'static mut T> {
    let good = !memory.is_null() && memory.addr().is_multiple_of(align_of::<T>()) && len >= size_of::<T>();
    if !good {
        return None;
    }
    let place = memory.cast::<MaybeUninit<T>>();
    // SAFETY: not null, aligned and large enough by the check; the caller leaves the memory alone while the handle is in use. Nothing
    // that was there is dropped, and nothing that is put there needs to be.
    Some(unsafe { (*place).write(value) })
}

/// `len` bytes of the caller's. `None` if null.
pub(crate) fn bytes(start: *const u8, len: usize) -> Option<&'static [u8]> {
    if start.is_null() || len > isize::MAX as usize {
        return None;
    }
    // SAFETY: the caller says that `len` bytes may be read from `start` and stay as they are while what is opened on them is in use.
    Some(unsafe { slice::from_raw_parts(start, len) })
}

/// `len` points of the caller's to write to. `None` if null or not aligned.
pub(crate) fn points<'a>(start: *mut [f32; 3], len: usize) -> Option<&'a mut [[f32; 3]]> {
    let too_long = len > isize::MAX as usize / size_of::<[f32; 3]>();
    if start.is_null() || too_long || !start.addr().is_multiple_of(align_of::<[f32; 3]>()) {
        return None;
    }
    // SAFETY: the caller says that `len` points may be written at `start`. They are made zero before anything can read them: what is
    // all zero bits is an f32.
    unsafe {
        start.write_bytes(0, len);
        Some(slice::from_raw_parts_mut(start, len))
    }
}
