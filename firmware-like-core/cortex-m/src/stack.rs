//! High-water mark of the stack.
#![allow(unsafe_code, reason = "the stack is memory that no variable owns")]

/// The value with which cortex-m-rt fills the stack before `main`.
const PAINT: u32 = cortex_m_rt::STACK_PAINT_VALUE;

unsafe extern "C" {
    // From the linker script: the ends of the stack.
    static _stack_end: u32;
    static _stack_start: u32;
}

/// Number of bytes from the top of the stack to the lowest word written.
pub fn high_water_bytes() -> u32 {
    let (low, high) = (&raw const _stack_end, &raw const _stack_start);
    let mut word = low;
    // SAFETY: both are aligned addresses of the same RAM, and every word between them may be read; words
    // above the stack pointer are only compared. Volatile because the fill value was not written by Rust.
    while word < high && unsafe { word.read_volatile() } == PAINT {
        word = word.wrapping_add(1);
    }
    (high.addr() - word.addr()) as u32
}
