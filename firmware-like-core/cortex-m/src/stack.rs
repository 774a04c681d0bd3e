//! How much of the stack was ever used.
#![allow(unsafe_code, reason = "the stack is memory that no variable owns")]

/// What cortex-m-rt paints the stack with before `main`.
const PAINT: u32 = cortex_m_rt::STACK_PAINT_VALUE;

unsafe extern "C" {
    // From the linker script: the words between them are the stack's.
    static _stack_end: u32;
    static _stack_start: u32;
}

/// Bytes from the top of the stack down to the lowest word that was written.
pub fn high_water_bytes() -> u32 {
    let (low, high) = (&raw const _stack_end, &raw const _stack_start);
    let mut word = low;
    // SAFETY: both are aligned addresses of the same RAM, and every word between them may be read; what is above the stack pointer is
    // only compared. Volatile: the paint was not written by Rust.
    while word < high && unsafe { word.read_volatile() } == PAINT {
        word = word.wrapping_add(1);
    }
    (high.addr() - word.addr()) as u32
}
