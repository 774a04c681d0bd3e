//! The interface of OpenHaptics HDAPI, as its headers declare it (hdDevice.h, hdScheduler.h, hdDefines.h).
//!
//! Types: HHD, HDenum, HDerror, HDCallbackCode are u32, HDint i32, HDboolean u8, HDushort u16, HDulong and a handle of the
//! scheduler are C's long. Lengths are millimetres, forces newtons.
#![allow(unsafe_code)]

use super::super::library::{Library, LibraryError, functions};
use core::ffi::{CStr, c_char, c_double, c_int, c_uchar, c_uint, c_ulong, c_ushort, c_void};
use std::path::{Path, PathBuf};

/// A callback of the scheduler: returns [`CALLBACK_DONE`] or [`CALLBACK_CONTINUE`].
pub type Callback = unsafe extern "C" fn(*mut c_void) -> c_uint;

/// The callback is not called again.
pub const CALLBACK_DONE: c_uint = 0;
/// The callback is called in every cycle.
pub const CALLBACK_CONTINUE: c_uint = 1;

/// An error of the library's stack.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ErrorInfo {
    /// The error.
    pub code: c_uint,
    /// The maker's own code.
    pub internal: c_int,
    /// The device.
    pub device: c_uint,
}

functions! {
    /// The functions of libHD.
    Functions {
        init_device: hdInitDevice(*const c_char) -> c_uint;
        disable_device: hdDisableDevice(c_uint);
        make_current: hdMakeCurrentDevice(c_uint);
        begin_frame: hdBeginFrame(c_uint);
        end_frame: hdEndFrame(c_uint);
        enable: hdEnable(c_uint);
        disable: hdDisable(c_uint);
        is_enabled: hdIsEnabled(c_uint) -> c_uchar;
        get_integers: hdGetIntegerv(c_uint, *mut c_int);
        get_doubles: hdGetDoublev(c_uint, *mut c_double);
        set_doubles: hdSetDoublev(c_uint, *const c_double);
        get_string: hdGetString(c_uint) -> *const c_char;
        get_error: hdGetError() -> ErrorInfo;
        get_error_string: hdGetErrorString(c_uint) -> *const c_char;
        check_calibration: hdCheckCalibration() -> c_uint;
        update_calibration: hdUpdateCalibration(c_uint);
        start_scheduler: hdStartScheduler();
        stop_scheduler: hdStopScheduler();
        set_scheduler_rate: hdSetSchedulerRate(c_ulong);
        schedule: hdScheduleAsynchronous(Callback, *mut c_void, c_ushort) -> c_ulong;
        unschedule: hdUnschedule(c_ulong);
    }
}

/// What can be read or set; the numbers of the interface.
pub mod value {
    /// Bits of the buttons, integer.
    pub const BUTTONS: u32 = 0x2000;
    /// Position, 3 doubles, mm.
    pub const POSITION: u32 = 0x2050;
    /// Transform of the stylus, 16 doubles by columns, mm.
    pub const TRANSFORM: u32 = 0x2052;
    /// Model of the device, text.
    pub const MODEL: u32 = 0x2501;
    /// Serial number, text.
    pub const SERIAL: u32 = 0x2504;
    /// Version of the interface, text.
    pub const VERSION: u32 = 0x2500;
    /// Largest stiffness, double, N/mm.
    pub const STIFFNESS: u32 = 0x2602;
    /// Largest force, double, N.
    pub const FORCE: u32 = 0x2603;
    /// The force of this frame, 3 doubles, N.
    pub const CURRENT_FORCE: u32 = 0x2700;
    /// Capability: forces.
    pub const FORCE_OUTPUT: u32 = 0x4000;
    /// How the device is calibrated, integer: bits of the styles.
    pub const CALIBRATION_STYLE: u32 = 0x2555;
    /// Calibration: good, to be renewed, to be done by hand.
    pub const CALIBRATED: u32 = 0x5000;
    /// See [`CALIBRATED`].
    pub const NEEDS_UPDATE: u32 = 0x5001;
    /// See [`CALIBRATED`].
    pub const NEEDS_HAND: u32 = 0x5002;
}

/// A handle that is none.
pub const NO_DEVICE: u32 = 0xFFFF_FFFF;
/// The SDK's handles are small; others are left-overs of a failed opening.
const MOST_DEVICES: u32 = 1_024;
/// The most numbers that a value has.
const MOST: usize = 32;
/// The highest priority of a callback.
const HIGHEST: c_ushort = 65_535;

/// The library.
#[derive(Debug, Clone, Copy)]
pub struct Hd {
    functions: Functions,
}

/// A callback in the scheduler.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Scheduled(c_ulong);

impl Hd {
    /// Loads libHD: the given file, or the installed one of version 3.4 or 3.0.
    pub fn load(given: Option<&Path>) -> Result<(Self, PathBuf), LibraryError> {
        let names = ["libHD.so.3.4", "libHD.so.3.0", "libHD.so", "/usr/lib/libHD.so"].map(PathBuf::from);
        let (library, file) = Library::load("OpenHaptics (libHD)", given, &names)?;
        Ok((Self { functions: Functions::find(&library, &file)? }, file))
    }

    /// Functions of another origin, with the same signatures.
    #[must_use]
    pub const fn of(functions: Functions) -> Self {
        Self { functions }
    }

    /// Opens the device with a name, or the default one; `None` without one, and the error is on the stack.
    #[must_use]
    pub fn open(&self, name: Option<&CStr>) -> Option<u32> {
        let name = name.map_or(core::ptr::null(), CStr::as_ptr);
        // SAFETY: a text that outlives the call, or null for the default device.
        let device = unsafe { (self.functions.init_device)(name) };
        (device != NO_DEVICE && device <= MOST_DEVICES).then_some(device)
    }

    /// Closes a device.
    pub fn close(&self, device: u32) {
        // SAFETY: any number is a handle or an error on the stack.
        unsafe { (self.functions.disable_device)(device) }
    }

    /// Begins a frame: reads the device, and its force is zero unless one is set before the end.
    pub fn begin(&self, device: u32) {
        // SAFETY: as above.
        unsafe {
            (self.functions.make_current)(device);
            (self.functions.begin_frame)(device);
        }
    }

    /// Ends a frame: sends its force.
    pub fn end(&self, device: u32) {
        // SAFETY: as above.
        unsafe { (self.functions.end_frame)(device) }
    }

    /// Switches a capability of the current device.
    pub fn set_enabled(&self, capability: u32, is_enabled: bool) {
        let set = if is_enabled { self.functions.enable } else { self.functions.disable };
        // SAFETY: an unknown capability is an error on the stack.
        unsafe { set(capability) }
    }

    /// Whether a capability of the current device is on.
    #[must_use]
    pub fn is_enabled(&self, capability: u32) -> bool {
        // SAFETY: as above.
        unsafe { (self.functions.is_enabled)(capability) != 0 }
    }

    /// An integer of the current device.
    #[must_use]
    pub fn integer(&self, value: u32) -> i32 {
        let mut numbers = [0; MOST];
        // SAFETY: no value of the interface has more than 16 numbers.
        unsafe { (self.functions.get_integers)(value, numbers.as_mut_ptr()) };
        numbers[0]
    }

    /// Numbers of the current device; zeros where it gives none.
    #[must_use]
    pub fn doubles<const N: usize>(&self, value: u32) -> [f64; N] {
        const { assert!(N <= MOST) }
        let mut numbers = [0.0; MOST];
        // SAFETY: as above.
        unsafe { (self.functions.get_doubles)(value, numbers.as_mut_ptr()) };
        core::array::from_fn(|n| numbers[n])
    }

    /// The force of the present frame, N.
    pub fn set_force(&self, force_n: [f64; 3]) {
        // SAFETY: the value has three numbers.
        unsafe { (self.functions.set_doubles)(value::CURRENT_FORCE, force_n.as_ptr()) }
    }

    /// A text of the current device; empty where it has none.
    #[must_use]
    pub fn text(&self, value: u32) -> String {
        // SAFETY: an unknown value is an error on the stack.
        copied(unsafe { (self.functions.get_string)(value) })
    }

    /// The newest error, which the stack then forgets.
    #[must_use]
    pub fn next_error(&self) -> Option<ErrorInfo> {
        // SAFETY: no argument.
        Some(unsafe { (self.functions.get_error)() }).filter(|error| error.code != 0)
    }

    /// An error in words.
    #[must_use]
    pub fn error_text(&self, code: u32) -> String {
        // SAFETY: any number has a text, or none.
        copied(unsafe { (self.functions.get_error_string)(code) })
    }

    /// The state of the calibration of the current device.
    #[must_use]
    pub fn calibration(&self) -> u32 {
        // SAFETY: no argument.
        unsafe { (self.functions.check_calibration)() }
    }

    /// Calibrates the current device by a style.
    pub fn calibrate(&self, style: u32) {
        // SAFETY: an unknown style is an error on the stack.
        unsafe { (self.functions.update_calibration)(style) }
    }

    /// Sets the rate of the scheduler, Hz.
    pub fn set_rate(&self, hz: u32) {
        // SAFETY: a rate that it has not is an error on the stack.
        unsafe { (self.functions.set_scheduler_rate)(c_ulong::from(hz)) }
    }

    /// Starts the scheduler, and with it the forces.
    pub fn start(&self) {
        // SAFETY: no argument.
        unsafe { (self.functions.start_scheduler)() }
    }

    /// Stops the scheduler: no callback runs any more.
    pub fn stop(&self) {
        // SAFETY: no argument.
        unsafe { (self.functions.stop_scheduler)() }
    }

    /// Calls `callback` with `data` in every cycle of the scheduler.
    ///
    /// # Safety
    ///
    /// `data` is what the callback expects, and stays valid until it has returned [`CALLBACK_DONE`] or the scheduler is
    /// stopped.
    pub unsafe fn schedule(&self, callback: Callback, data: *mut c_void) -> Scheduled {
        // SAFETY: the caller's.
        Scheduled(unsafe { (self.functions.schedule)(callback, data, HIGHEST) })
    }

    /// Removes a callback.
    pub fn unschedule(&self, scheduled: Scheduled) {
        // SAFETY: a handle of `schedule`; one that has ended is an error on the stack.
        unsafe { (self.functions.unschedule)(scheduled.0) }
    }
}

/// A text of the library, which keeps it.
fn copied(text: *const c_char) -> String {
    if text.is_null() {
        return String::new();
    }
    // SAFETY: a text of the library that ends with a zero and stays.
    unsafe { CStr::from_ptr(text) }.to_string_lossy().into_owned()
}

const _: () = {
    assert!(size_of::<ErrorInfo>() == 12 && core::mem::offset_of!(ErrorInfo, device) == 8);
    assert!(size_of::<c_ulong>() == 8, "C's long has 8 bytes on Linux");
};
