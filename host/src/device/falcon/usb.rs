//! A real FTDI chip, through libusb.
//!
//! It uses its own libusb context: the global one panics in `rusb` where there is no usbfs.

use super::ftdi::Ftdi;
use crate::device::fence::{GuardPath, Wire};
use crate::device::{DeviceError, DeviceErrorKind};
use crate::sys;
use core::fmt;
use core::time::Duration;
use rusb::{Context, DeviceHandle, UsbContext};
use std::fs::File;
use std::io;
use std::time::Instant;

/// FTDI's vendor id.
pub const VENDOR_ID: u16 = 0x0403;
/// Novint's product id of the Falcon.
pub const PRODUCT_ID: u16 = 0xCB48;
const INTERFACE: u8 = 0;
const BULK_IN: u8 = 0x81;
const BULK_OUT: u8 = 0x02;
/// A vendor request to the device, without data.
const REQUEST_TYPE: u8 = 0x40;
const CONTROL_TIMEOUT: Duration = Duration::from_secs(1);
/// How long to search for the device. Right after it was plugged in, opening, configuring and claiming can
/// fail.
const SEARCH_TIMEOUT: Duration = Duration::from_secs(1);
/// Pause between two searches.
const SEARCH_PAUSE: Duration = Duration::from_millis(50);

/// Reason why the chip cannot be opened.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UsbError {
    /// The system has no USB.
    NoUsb,
    /// There is no Falcon.
    NotFound,
    /// This user may not open it.
    Denied,
    /// Another program uses it.
    Busy,
    /// Anything else.
    Device(DeviceError),
}

impl fmt::Display for UsbError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoUsb => {
                f.write_str("this system has no USB for programs (no usbfs); use a system with /dev/bus/usb")
            }
            Self::NotFound => write!(
                f,
                "no Falcon ({VENDOR_ID:04x}:{PRODUCT_ID:04x}) on USB; check the cable and its own power supply"
            ),
            Self::Denied => f.write_str(
                "no permission to open the Falcon; join the group palpate, install host/deploy/72-palpate.rules \
                 (docs/devices.md, Permissions) and connect it again",
            ),
            Self::Busy => f.write_str("the Falcon is in use by another program; end it"),
            Self::Device(error) => write!(f, "the Falcon cannot be opened: {error}; connect it again"),
        }
    }
}

impl core::error::Error for UsbError {}

impl UsbError {
    fn from_file(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::PermissionDenied => Self::Denied,
            // Unplugged since the search.
            io::ErrorKind::NotFound => Self::NotFound,
            _ => Self::Device(error.into()),
        }
    }
}

impl From<rusb::Error> for UsbError {
    fn from(error: rusb::Error) -> Self {
        match error {
            rusb::Error::Access => Self::Denied,
            rusb::Error::Busy => Self::Busy,
            _ => Self::Device(from_usb(error)),
        }
    }
}

/// Converts an error of the crate.
fn from_usb(error: rusb::Error) -> DeviceError {
    DeviceError::new(match error {
        rusb::Error::Timeout | rusb::Error::Interrupted => DeviceErrorKind::Timeout,
        rusb::Error::Overflow => DeviceErrorKind::BadFrame,
        rusb::Error::NoDevice | rusb::Error::Io | rusb::Error::Pipe | rusb::Error::NotFound => {
            DeviceErrorKind::Disconnected
        }
        rusb::Error::Access => DeviceErrorKind::Denied,
        rusb::Error::Busy => DeviceErrorKind::InUse,
        rusb::Error::NotSupported | rusb::Error::InvalidParam | rusb::Error::BadDescriptor => {
            DeviceErrorKind::Unsupported
        }
        rusb::Error::NoMem | rusb::Error::Other => DeviceErrorKind::Io,
    })
}

/// Performs a transfer on a pipe. A halted pipe stays halted, even if it is closed and opened, until the halt
/// is cleared: then the halt is cleared and the transfer repeated once. The device did not accept the failed
/// transfer, so nothing is sent twice.
fn retry_after_halt<T>(
    mut transfer: impl FnMut() -> rusb::Result<T>,
    clear: impl FnOnce() -> rusb::Result<()>,
) -> Result<T, DeviceError> {
    match transfer() {
        Err(rusb::Error::Pipe) => clear().and_then(|()| transfer()),
        done => done,
    }
    .map_err(from_usb)
}

/// Whole milliseconds, at least one: libusb takes zero as no timeout.
fn at_least_a_millisecond(timeout: Duration) -> Duration {
    timeout.max(Duration::from_millis(1))
}

/// An open chip. libusb permits reading and writing from two threads at a time.
pub struct UsbFtdi {
    /// Closed before the file.
    handle: DeviceHandle<Context>,
    /// The device file, opened here and not by libusb, so that a guard can have a duplicate.
    file: File,
}

impl fmt::Debug for UsbFtdi {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("UsbFtdi").finish_non_exhaustive()
    }
}

impl UsbFtdi {
    /// Opens the first Falcon found. Blocks for up to a second if there is none.
    pub fn open() -> Result<Self, UsbError> {
        let give_up = Instant::now() + SEARCH_TIMEOUT;
        loop {
            let error = match Self::try_open() {
                Ok(chip) => return Ok(chip),
                // The USB system does not appear within a second.
                Err(UsbError::NoUsb) => return Err(UsbError::NoUsb),
                Err(error) => error,
            };
            if Instant::now() >= give_up {
                return Err(error);
            }
            std::thread::sleep(SEARCH_PAUSE);
        }
    }

    fn try_open() -> Result<Self, UsbError> {
        let context = Context::new().map_err(|_| UsbError::NoUsb)?;
        let devices = context.devices()?;
        // A device whose descriptor cannot be read is skipped.
        let is_falcon = |device: &rusb::Device<Context>| {
            let ids = device.device_descriptor().map(|d| (d.vendor_id(), d.product_id()));
            ids == Ok((VENDOR_ID, PRODUCT_ID))
        };
        let device = devices.iter().find(is_falcon).ok_or(UsbError::NotFound)?;
        let file = device_file(&device).map_err(UsbError::from_file)?;
        let handle = sys::usb::open_device(&context, &file)?;
        if handle.active_configuration()? == 0 {
            handle.set_active_configuration(1)?;
        }
        // Linux binds the chip to its serial driver; the driver is restored when the handle is closed.
        match handle.set_auto_detach_kernel_driver(true) {
            Ok(()) | Err(rusb::Error::NotSupported) => {}
            Err(error) => return Err(error.into()),
        }
        handle.claim_interface(INTERFACE)?;
        // Clear halts of an earlier session. If that fails, the first transfer reports it.
        for endpoint in [BULK_IN, BULK_OUT] {
            let _ = handle.clear_halt(endpoint);
        }
        Ok(Self { handle, file })
    }
}

/// Opens the file of a device: /dev/bus/usb/BUS/DEVICE.
fn device_file(device: &rusb::Device<Context>) -> io::Result<File> {
    let path = format!("/dev/bus/usb/{:03}/{:03}", device.bus_number(), device.address());
    File::options().read(true).write(true).open(path)
}

impl Ftdi for UsbFtdi {
    fn control(&self, request: u8, value: u16) -> Result<(), DeviceError> {
        self.handle
            .write_control(REQUEST_TYPE, request, value, 0, &[], CONTROL_TIMEOUT)
            .map(|_| ())
            .map_err(from_usb)
    }

    fn write(&self, bytes: &[u8], timeout: Duration) -> Result<usize, DeviceError> {
        let timeout = at_least_a_millisecond(timeout);
        retry_after_halt(
            || self.handle.write_bulk(BULK_OUT, bytes, timeout),
            || self.handle.clear_halt(BULK_OUT),
        )
    }

    fn read(&self, buffer: &mut [u8], timeout: Duration) -> Result<usize, DeviceError> {
        let timeout = at_least_a_millisecond(timeout);
        retry_after_halt(
            || self.handle.read_bulk(BULK_IN, buffer, timeout),
            || self.handle.clear_halt(BULK_IN),
        )
    }

    fn guard_path(&self) -> io::Result<Option<GuardPath>> {
        let fd = self.file.try_clone()?.into();
        Ok(Some(GuardPath { fd, wire: Wire::UsbBulk { endpoint: BULK_OUT } }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_map_to_a_kind_and_only_timeout_and_overflow_are_transient() {
        use rusb::Error as E;
        for (error, kind) in [
            (E::Timeout, DeviceErrorKind::Timeout),
            (E::NoDevice, DeviceErrorKind::Disconnected),
            (E::Io, DeviceErrorKind::Disconnected),
            (E::Pipe, DeviceErrorKind::Disconnected),
            (E::Access, DeviceErrorKind::Denied),
            (E::NotSupported, DeviceErrorKind::Unsupported),
            (E::Overflow, DeviceErrorKind::BadFrame),
        ] {
            assert_eq!(from_usb(error).kind(), kind);
        }
        assert_eq!(UsbError::from(E::Access), UsbError::Denied);
        // What libusb makes of EBUSY, the answer to the claim of an interface that another session has claimed.
        assert_eq!(UsbError::from(E::Busy), UsbError::Busy);
        assert_eq!(UsbError::Busy.to_string(), "the Falcon is in use by another program; end it");
    }

    /// The result, the number of attempts and the number of cleared halts.
    fn attempts(
        answers: &[rusb::Result<usize>],
        cleared: rusb::Result<()>,
    ) -> (Result<usize, DeviceErrorKind>, usize, u32) {
        let (mut tries, mut clears) = (0, 0);
        let transfer = || {
            tries += 1;
            answers[tries - 1]
        };
        let clear = || {
            clears += 1;
            cleared
        };
        let done = retry_after_halt(transfer, clear).map_err(|error| error.kind());
        (done, tries, clears)
    }

    #[test]
    fn a_halted_pipe_is_cleared_and_the_transfer_repeated_once() {
        use rusb::Error as E;
        let disconnected = Err(DeviceErrorKind::Disconnected);
        assert_eq!(attempts(&[Ok(16)], Ok(())), (Ok(16), 1, 0));
        assert_eq!(attempts(&[Err(E::Pipe), Ok(16)], Ok(())), (Ok(16), 2, 1));
        assert_eq!(attempts(&[Err(E::Pipe); 2], Ok(())), (disconnected, 2, 1), "bounded");
        assert_eq!(attempts(&[Err(E::Pipe)], Err(E::NoDevice)), (disconnected, 1, 1));
        assert_eq!(attempts(&[Err(E::Pipe), Err(E::Timeout)], Ok(())), (Err(DeviceErrorKind::Timeout), 2, 1));
        assert_eq!(attempts(&[Err(E::Timeout)], Ok(())), (Err(DeviceErrorKind::Timeout), 1, 0));
    }

    #[test]
    fn no_timeout_is_infinite() {
        assert_eq!(at_least_a_millisecond(Duration::ZERO), Duration::from_millis(1));
        assert_eq!(at_least_a_millisecond(Duration::from_nanos(1)), Duration::from_millis(1));
        assert_eq!(at_least_a_millisecond(Duration::from_millis(20)), Duration::from_millis(20));
    }

    #[test]
    fn errors_are_one_line_and_name_the_fix() {
        let lost = UsbError::Device(DeviceError::new(DeviceErrorKind::Io));
        for error in [UsbError::NoUsb, UsbError::NotFound, UsbError::Denied, UsbError::Busy, lost] {
            let text = error.to_string();
            assert!(!text.contains('\n') && text.contains("; "), "{text}");
        }
    }

    /// Without USB, or without a Falcon, opening returns an error: it neither panics nor hangs.
    #[test]
    fn opening_returns_on_every_system() {
        let started = Instant::now();
        let _ = UsbFtdi::open();
        assert!(started.elapsed() < Duration::from_secs(10));
    }
}
