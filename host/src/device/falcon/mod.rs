//! Novint Falcon: a delta mechanism with three motors, behind an FTDI chip on USB.
//!
//! ```text
//! usb (libusb) or an emulator = Ftdi -> line (settings, status bytes) -> packet -> kinematics -> position
//!                                    <- packet <- motor (limits) <- kinematics (J^T) <- force
//! driver: opening, homing, exchange (reply_reader, request_writer), stopping;  loader, firmware: start-up
//! ```

pub mod config;
pub mod driver;
pub mod firmware;
pub mod ftdi;
pub mod kinematics;
pub mod line;
pub mod loader;
pub mod motor;
pub mod packet;
mod reply_reader;
mod request_writer;
pub mod usb;

pub use config::{FalconConfig, FalconError};
pub use driver::Falcon;
pub use firmware::{FirmwareError, Image};
pub use ftdi::Ftdi;
pub use reply_reader::Mode;
pub use usb::UsbFtdi;
