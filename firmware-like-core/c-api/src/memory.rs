//! Conversion of the caller's memory into Rust references.
//!
//! Every function here relies on the rule of `palpate.h` that a pointer that is not null is valid for the
//! length given with it. The four exported functions that receive such pointers are therefore unsafe and
//! require the same of their callers.

use core::mem::MaybeUninit;
use core::slice;

/// Moves `value` into the caller's memory. `None` if the memory is null, too small or not aligned for the
/// value.
///
/// # Safety
///
/// If `memory` is not null, `len` bytes may be written there, and only through the returned reference while
/// it is used.
pub(crate) unsafe fn place<T>(memory: *mut u8, len: usize, value: T) -> Option<&'static mut T> {
    let good = !memory.is_null() && memory.addr().is_multiple_of(align_of::<T>()) && len >= size_of::<T>();
    if !good {
        return None;
    }
    let place = memory.cast::<MaybeUninit<T>>();
    // SAFETY: the pointer is not null, aligned and points to enough memory, by the check. The caller does not
    // access the memory while the handle is used. The old content is not dropped, and the new one does not
    // need to be.
    Some(unsafe { (*place).write(value) })
}

/// A slice of `len` bytes of the caller. `None` if the pointer is null.
///
/// # Safety
///
/// If `start` is not null, `len` bytes may be read there and do not change while the returned slice is used.
pub(crate) unsafe fn bytes(start: *const u8, len: usize) -> Option<&'static [u8]> {
    if start.is_null() || len > isize::MAX as usize {
        return None;
    }
    // SAFETY: by contract `len` bytes may be read at `start` and do not change while the objects opened on
    // them are used.
    Some(unsafe { slice::from_raw_parts(start, len) })
}

/// A writable slice of `len` words of the caller. `None` if the pointer is null or not aligned.
///
/// # Safety
///
/// If `start` is not null, `len` words may be written there, and only through the returned slice while it is
/// used.
pub(crate) unsafe fn words(start: *mut u32, len: usize) -> Option<&'static mut [u32]> {
    let too_long = len > isize::MAX as usize / size_of::<u32>();
    if start.is_null() || too_long || !start.addr().is_multiple_of(align_of::<u32>()) {
        return None;
    }
    // SAFETY: by contract `len` words may be written at `start`. They are set to zero before they can be
    // read.
    unsafe {
        start.write_bytes(0, len);
        Some(slice::from_raw_parts_mut(start, len))
    }
}

/// A writable slice of `len` points of the caller. `None` if the pointer is null or not aligned.
///
/// # Safety
///
/// If `start` is not null, `len` points may be written there, and only through the returned slice while it is
/// used.
pub(crate) unsafe fn points<'a>(start: *mut [f32; 3], len: usize) -> Option<&'a mut [[f32; 3]]> {
    let too_long = len > isize::MAX as usize / size_of::<[f32; 3]>();
    if start.is_null() || too_long || !start.addr().is_multiple_of(align_of::<[f32; 3]>()) {
        return None;
    }
    // SAFETY: by contract `len` points may be written at `start`. They are set to zero before they can be
    // read; all zero bits are a valid f32.
    unsafe {
        start.write_bytes(0, len);
        Some(slice::from_raw_parts_mut(start, len))
    }
}
