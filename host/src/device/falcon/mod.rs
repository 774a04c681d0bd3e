//! Novint Falcon: three motors of a delta, behind an FTDI chip on USB.
//!
//! ```text
//! usb (libusb) or an emulator = Ftdi -> line (settings, status bytes) -> packet -> kinematics -> position
//!                                    <- packet <- motor (limits) <- kinematics (J^T) <- force
//! driver: opening, homing, exchange (intake, outlet: without waiting), stopping;  loader, firmware: before the first packet
//! ```

pub mod config;
pub mod driver;
pub mod firmware;
pub mod ftdi;
mod intake;
pub mod kinematics;
pub mod line;
pub mod loader;
pub mod motor;
mod outlet;
pub mod packet;
pub mod usb;

#[cfg(test)]
mod fake;

pub use config::{FalconConfig, FalconError};
pub use driver::Falcon;
pub use firmware::{FirmwareError, Image};
pub use ftdi::Ftdi;
pub use intake::Mode;
pub use usb::UsbFtdi;
