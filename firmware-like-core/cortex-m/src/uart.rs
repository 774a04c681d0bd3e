//! The UART of ARM's Cortex-M System Design Kit, as in QEMU's mps2 boards: polled, one byte in each
//! direction.
#![allow(unsafe_code, reason = "registers are addresses that no variable owns")]

use core::ptr;

/// UART 0.
const BASE: usize = 0x4000_4000;
const DATA: *mut u32 = BASE as *mut u32;
const STATE: *const u32 = (BASE + 4) as *const u32;
const CONTROL: *mut u32 = (BASE + 8) as *mut u32;
const DIVISOR: *mut u32 = (BASE + 16) as *mut u32;

const TX_FULL: u32 = 1;
const RX_FULL: u32 = 2;
const TX_AND_RX: u32 = 3;

/// The port; its owner may read and write.
#[derive(Debug)]
pub struct Uart(());

impl Uart {
    /// Enables the port at 1.5625 Mbaud with a 25 MHz clock; QEMU ignores the rate.
    ///
    /// The processor's peripherals exist only once, so a reference to them proves that this is the only port.
    pub fn new(_: &cortex_m::Peripherals) -> Self {
        // SAFETY: two registers of UART 0 of this board, aligned, written as in the manual. The same holds
        // below.
        unsafe {
            ptr::write_volatile(DIVISOR, 16);
            ptr::write_volatile(CONTROL, TX_AND_RX);
        }
        Self(())
    }

    /// The next byte, or `None` if none has arrived.
    pub fn read(&mut self) -> Option<u8> {
        // SAFETY: see `new`.
        unsafe { (ptr::read_volatile(STATE) & RX_FULL != 0).then(|| ptr::read_volatile(DATA) as u8) }
    }

    /// Sends a byte. Returns false, without effect, while the previous byte is being sent.
    pub fn write(&mut self, byte: u8) -> bool {
        // SAFETY: see `new`.
        unsafe {
            let free = ptr::read_volatile(STATE) & TX_FULL == 0;
            if free {
                ptr::write_volatile(DATA, byte.into());
            }
            free
        }
    }
}
