//! Novint Falcon: three motors of a delta, behind an FTDI chip on USB.

pub mod ftdi;

pub use ftdi::Ftdi;
