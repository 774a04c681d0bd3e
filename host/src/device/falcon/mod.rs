//! Novint Falcon: three motors of a delta, behind an FTDI chip on USB.

pub mod ftdi;
pub mod kinematics;
pub mod motor;
pub mod packet;

pub use ftdi::Ftdi;
