//! USB device files: the descriptor stays ours, so that the guard can hold a duplicate.

use nix::errno::Errno;
use nix::libc::{c_int, c_uint, c_void};
use rusb::{Context, DeviceHandle, UsbContext};
use std::fs::File;
use std::io;
use std::os::fd::{AsRawFd, BorrowedFd};
use std::time::Duration;

/// `struct usbdevfs_bulktransfer` of linux/usbdevice_fs.h.
#[repr(C)]
struct BulkTransfer {
    endpoint: c_uint,
    len: c_uint,
    timeout_ms: c_uint,
    data: *mut c_void,
}

/// USBDEVFS_BULK and USBDEVFS_CLEAR_HALT.
mod ioctl {
    #![allow(missing_docs)]
    nix::ioctl_readwrite!(bulk, b'U', 2, super::BulkTransfer);
    nix::ioctl_read!(clear_halt, b'U', 21, nix::libc::c_uint);
}

/// Opens a device of libusb by an open device file, which must outlive the handle. libusb does not close it.
pub fn open_device(context: &Context, file: &File) -> rusb::Result<DeviceHandle<Context>> {
    // SAFETY: the descriptor is open, and [`crate::device::falcon::UsbFtdi`] closes the handle before the file.
    unsafe { context.open_device_with_fd(file.as_raw_fd()) }
}

/// Writes to a bulk pipe and waits for the end of the transfer, past libusb: a second libusb on the same
/// descriptor would reap the transfers of the first. A halted pipe is cleared and the transfer repeated once.
pub fn write_bulk(fd: BorrowedFd<'_>, endpoint: u8, bytes: &[u8], timeout: Duration) -> io::Result<usize> {
    let once = || {
        let mut transfer = BulkTransfer {
            endpoint: endpoint.into(),
            len: bytes.len() as c_uint,
            timeout_ms: timeout.as_millis().max(1) as c_uint,
            data: bytes.as_ptr().cast_mut().cast(),
        };
        // SAFETY: the structure and the bytes outlive the call, which ends with the transfer, and the kernel
        // only reads the bytes of an OUT endpoint.
        unsafe { ioctl::bulk(fd.as_raw_fd(), &mut transfer) }
    };
    let count: c_int = match once() {
        Err(Errno::EPIPE) => {
            let mut endpoint = c_uint::from(endpoint);
            // SAFETY: the kernel reads one unsigned integer, which outlives the call.
            unsafe { ioctl::clear_halt(fd.as_raw_fd(), &mut endpoint) }?;
            // Halted again: not gone, so the caller may repeat it.
            once().map_err(|errno| if errno == Errno::EPIPE { Errno::ETIMEDOUT } else { errno })
        }
        done => done,
    }?;
    Ok(count as usize)
}
