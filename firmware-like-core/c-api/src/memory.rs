//! Where bytes of the caller become Rust's.
//!
//! Every function here believes what `palpate.h` asks of the caller: a pointer that is not null is good for the length given with it. The
//! four exported functions that take such pointers are unsafe for that reason, and pass the promise on.

use core::mem::MaybeUninit;
use core::slice;

/// Moves `value` into the caller's memory. `None` if that is null, too small or not aligned for it.
///
/// # Safety
///
/// If not null, `len` bytes at `memory` are the caller's to write, and nobody else's while what is returned is in use.
pub(crate) unsafe fn place<T>(memory: *mut u8, len: usize, value: T) -> Option<&'static mut T> {
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
///
/// # Safety
///
/// If not null, `len` bytes may be read at `start`, and stay as they are while what is returned is in use.
pub(crate) unsafe fn bytes(start: *const u8, len: usize) -> Option<&'static [u8]> {
    if start.is_null() || len > isize::MAX as usize {
        return None;
    }
    // SAFETY: the caller says that `len` bytes may be read from `start` and stay as they are while what is opened on them is in use.
    Some(unsafe { slice::from_raw_parts(start, len) })
}

/// `len` words of the caller's to write to. `None` if null or not aligned.
///
/// # Safety
///
/// If not null, `len` words may be written at `start`, by nobody else while what is returned is in use.
pub(crate) unsafe fn words(start: *mut u32, len: usize) -> Option<&'static mut [u32]> {
    let too_long = len > isize::MAX as usize / size_of::<u32>();
    if start.is_null() || too_long || !start.addr().is_multiple_of(align_of::<u32>()) {
        return None;
    }
    // SAFETY: the caller says that `len` words may be written at `start`. They are made zero before anything can read them.
    unsafe {
        start.write_bytes(0, len);
        Some(slice::from_raw_parts_mut(start, len))
    }
}

/// `len` points of the caller's to write to. `None` if null or not aligned.
///
/// # Safety
///
/// If not null, `len` points may be written at `start`, by nobody else while what is returned is in use.
pub(crate) unsafe fn points<'a>(start: *mut [f32; 3], len: usize) -> Option<&'a mut [[f32; 3]]> {
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
