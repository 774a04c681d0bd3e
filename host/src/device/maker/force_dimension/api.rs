//! The interface of libdhd and libdrd 3.x, as their headers declare it (dhdc.h, drdc.h).
//!
//! Lengths are metres, forces newtons. A function returns a negative number after an error; its number and its words are kept
//! for each thread. The last argument is the number of the device.
#![allow(unsafe_code)]

use super::super::library::{Library, LibraryError, functions};
use core::ffi::{CStr, c_char, c_double, c_int, c_uchar, c_uint};
use std::path::{Path, PathBuf};

functions! {
    /// The functions of libdhd.
    Functions {
        device_count: dhdGetDeviceCount() -> c_int;
        available_count: dhdGetAvailableCount() -> c_int;
        open: dhdOpenID(c_char) -> c_int;
        close: dhdClose(c_char) -> c_int;
        stop: dhdStop(c_char) -> c_int;
        system_type: dhdGetSystemType(c_char) -> c_int;
        system_name: dhdGetSystemName(c_char) -> *const c_char;
        version: dhdGetSDKVersion(*mut c_int, *mut c_int, *mut c_int, *mut c_int);
        last_error: dhdErrorGetLast() -> c_int;
        last_error_text: dhdErrorGetLastStr() -> *const c_char;
        pose: dhdGetPositionAndOrientationFrame(
            *mut c_double, *mut c_double, *mut c_double, *mut [[c_double; 3]; 3], c_char) -> c_int;
        buttons: dhdGetButtonMask(c_char) -> c_uint;
        set_force: dhdSetForce(c_double, c_double, c_double, c_char) -> c_int;
        enable_force: dhdEnableForce(c_uchar, c_char) -> c_int;
        set_gravity_compensation: dhdSetGravityCompensation(c_int, c_char) -> c_int;
        set_max_force: dhdSetMaxForce(c_double, c_char) -> c_int;
        status: dhdGetStatus(*mut c_int, c_char) -> c_int;
        enable_expert_mode: dhdEnableExpertMode() -> c_int;
        disable_expert_mode: dhdDisableExpertMode() -> c_int;
        set_watchdog: dhdSetWatchdog(c_uchar, c_char) -> c_int;
        watchdog: dhdGetWatchdog(*mut c_uchar, c_char) -> c_int;
        velocity_threshold: dhdGetVelocityThreshold(*mut c_uint, c_char) -> c_int;
    }
}

functions! {
    /// The functions of libdrd, which has those of libdhd, too.
    Regulation {
        open: drdOpenID(c_char) -> c_int;
        close: drdClose(c_char) -> c_int;
        is_initialized: drdIsInitialized(c_char) -> bool;
        initialize: drdAutoInit(c_char) -> c_int;
        stop: drdStop(bool, c_char) -> c_int;
    }
}

/// Room for a status: 16 numbers in 3.10, 17 in 3.16.
const MOST_STATUS: usize = 32;

/// What the status says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Status {
    /// The device has power.
    pub has_power: bool,
    /// It is connected.
    pub is_connected: bool,
    /// Its position is initialised.
    pub is_initialized: bool,
    /// Its motors give forces.
    pub gives_force: bool,
    /// Why they went off: 0 none, 1 button, 2 velocity, 3 watchdog, 4 software, 5 USB, 6 dead man's switch.
    pub off_cause: i32,
}

/// What a position is worth.
#[derive(Debug, Clone, PartialEq)]
pub enum Pose {
    /// Measured now: position, m, and the rows of the rotation of the grip.
    Fresh([f64; 3], [[f64; 3]; 3]),
    /// The library gave one that it had before, to spare the connection.
    Cached,
    /// None.
    Failed(DhdError),
}

/// An error of the library on this thread.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DhdError {
    /// Its number.
    pub code: i32,
    /// Its words.
    pub text: String,
}

/// The library.
#[derive(Debug, Clone, Copy)]
pub struct Dhd {
    functions: Functions,
    regulation: Option<Regulation>,
}

/// An open device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Id(c_char);

impl Dhd {
    /// Loads libdrd, which has the functions of libdhd, else libdhd: the given file, or an installed one of version 3.
    pub fn load(given: Option<&Path>) -> Result<(Self, PathBuf), LibraryError> {
        let (library, file) = Library::load("Force Dimension's SDK (libdrd, libdhd)", given, &names())?;
        let functions = Functions::find(&library, &file)?;
        Ok((Self { functions, regulation: Regulation::find(&library, &file).ok() }, file))
    }

    /// Functions of another origin, with the same signatures.
    #[must_use]
    pub const fn of(functions: Functions, regulation: Option<Regulation>) -> Self {
        Self { functions, regulation }
    }

    /// The version of the library.
    #[must_use]
    pub fn version(&self) -> String {
        let mut parts = [0; 4];
        let [major, minor, release, revision] = &mut parts;
        // SAFETY: four places for numbers.
        unsafe { (self.functions.version)(major, minor, release, revision) };
        format!("{}.{}.{}", parts[0], parts[1], parts[2])
    }

    /// Devices that are connected, and those of them that no other program has.
    #[must_use]
    pub fn counts(&self) -> (u32, u32) {
        // SAFETY: no argument.
        let (all, free) = unsafe { ((self.functions.device_count)(), (self.functions.available_count)()) };
        (u32::try_from(all).unwrap_or(0), u32::try_from(free).unwrap_or(0))
    }

    /// Opens the device with a number of [`Dhd::counts`].
    pub fn open(&self, number: u32) -> Result<Id, DhdError> {
        let number = c_char::try_from(number).unwrap_or(c_char::MAX);
        let open = self.regulation.map_or(self.functions.open, |regulation| regulation.open);
        // SAFETY: any number is a device or an error.
        let id = unsafe { open(number) };
        c_char::try_from(id).ok().filter(|id| *id >= 0).map(Id).ok_or_else(|| self.error())
    }

    /// Closes a device.
    pub fn close(&self, Id(id): Id) {
        let close = self.regulation.map_or(self.functions.close, |regulation| regulation.close);
        // SAFETY: an open device, or an error.
        unsafe {
            (self.functions.stop)(id);
            close(id);
        }
    }

    /// Type and name of a device.
    #[must_use]
    pub fn model(&self, Id(id): Id) -> (i32, String) {
        // SAFETY: as above.
        unsafe { ((self.functions.system_type)(id), copied((self.functions.system_name)(id))) }
    }

    /// The newest error of this thread.
    #[must_use]
    pub fn error(&self) -> DhdError {
        // SAFETY: no argument.
        let (code, text) = unsafe { ((self.functions.last_error)(), (self.functions.last_error_text)()) };
        DhdError { code, text: copied(text) }
    }

    /// Result of a call: 0, or 2 for a force that was scaled to what the motors can give.
    fn done(&self, result: c_int) -> Result<(), DhdError> {
        if result < 0 { Err(self.error()) } else { Ok(()) }
    }

    /// Position and rotation of the grip.
    #[must_use]
    pub fn pose(&self, Id(id): Id) -> Pose {
        const TIMEGUARD: c_int = 1;
        let (mut position_m, mut rows) = ([0.0; 3], [[0.0; 3]; 3]);
        let [x, y, z] = &mut position_m;
        // SAFETY: places for three numbers and a matrix.
        match unsafe { (self.functions.pose)(x, y, z, &raw mut rows, id) } {
            TIMEGUARD => Pose::Cached,
            result if result < 0 => Pose::Failed(self.error()),
            _ => Pose::Fresh(position_m, rows),
        }
    }

    /// Bits of the buttons; none if the call fails, which sets all of them.
    #[must_use]
    pub fn buttons(&self, Id(id): Id) -> u32 {
        // SAFETY: an open device, or an error.
        let mask = unsafe { (self.functions.buttons)(id) };
        if mask == u32::MAX { 0 } else { mask }
    }

    /// Sends a force, N.
    pub fn set_force(&self, Id(id): Id, [x, y, z]: [f64; 3]) -> Result<(), DhdError> {
        // SAFETY: as above.
        self.done(unsafe { (self.functions.set_force)(x, y, z, id) })
    }

    /// Switches the motors. From any thread.
    pub fn enable_force(&self, Id(id): Id, is_enabled: bool) -> Result<(), DhdError> {
        // SAFETY: as above.
        self.done(unsafe { (self.functions.enable_force)(u8::from(is_enabled), id) })
    }

    /// Limits the force, N, and switches the compensation of the arm's weight on.
    pub fn configure(&self, Id(id): Id, max_force_n: f64) -> Result<(), DhdError> {
        // SAFETY: as above.
        self.done(unsafe { (self.functions.set_max_force)(max_force_n, id) })?;
        // SAFETY: as above.
        self.done(unsafe { (self.functions.set_gravity_compensation)(1, id) })
    }

    /// The state of the device.
    pub fn status(&self, Id(id): Id) -> Result<Status, DhdError> {
        let mut numbers = [0; MOST_STATUS];
        // SAFETY: room for more than the library writes.
        self.done(unsafe { (self.functions.status)(numbers.as_mut_ptr(), id) })?;
        Ok(Status {
            has_power: numbers[0] != 0,
            is_connected: numbers[1] != 0,
            is_initialized: numbers[3] != 0,
            gives_force: numbers[5] != 0,
            off_cause: numbers[14],
        })
    }

    /// Sets the watchdog of the firmware, in steps of 125 us, and returns what the device has then.
    pub fn set_watchdog(&self, Id(id): Id, steps: u8) -> Result<u8, DhdError> {
        // SAFETY: no argument.
        self.done(unsafe { (self.functions.enable_expert_mode)() })?;
        // SAFETY: an open device, or an error.
        let set = self.done(unsafe { (self.functions.set_watchdog)(steps, id) });
        // SAFETY: no argument.
        self.done(unsafe { (self.functions.disable_expert_mode)() })?;
        set?;
        let mut found = 0;
        // SAFETY: a place for a number.
        self.done(unsafe { (self.functions.watchdog)(&mut found, id) })?;
        Ok(found)
    }

    /// The speed beyond which the device brakes, in its own steps; 0 if it does not.
    pub fn velocity_threshold(&self, Id(id): Id) -> Result<u32, DhdError> {
        let mut found = 0;
        // SAFETY: a place for a number.
        self.done(unsafe { (self.functions.velocity_threshold)(&mut found, id) })?;
        Ok(found)
    }

    /// Whether the position is initialised; without libdrd the status says so.
    #[must_use]
    pub fn is_initialized(&self, id: Id) -> bool {
        match self.regulation {
            // SAFETY: an open device, or an error.
            Some(regulation) => unsafe { (regulation.is_initialized)(id.0) },
            None => self.status(id).is_ok_and(|status| status.is_initialized),
        }
    }

    /// Whether the library can initialise the position, by which the arm moves.
    #[must_use]
    pub const fn can_move(&self) -> bool {
        self.regulation.is_some()
    }

    /// Lets the arm move by itself to initialise its position, and leaves the motors off.
    pub fn initialize_by_moving(&self, Id(id): Id) -> Result<(), DhdError> {
        let Some(regulation) = self.regulation else { return Err(self.error()) };
        // SAFETY: an open device, or an error.
        let moved = self.done(unsafe { (regulation.initialize)(id) });
        // SAFETY: as above.
        self.done(unsafe { (regulation.stop)(false, id) }).and(moved)
    }
}

/// Where the library is looked for: the folder of the SDK, then the loader's.
fn names() -> Vec<PathBuf> {
    let sdk = ["FDSDK", "FORCEDIM_SDK"].into_iter().filter_map(std::env::var_os);
    let folders = sdk.map(|root| PathBuf::from(root).join("lib/release/lin-x86_64-gcc"));
    let local = std::env::var_os("HOME").map(|home| PathBuf::from(home).join(".local/lib"));
    let folders = folders.chain([PathBuf::new(), "/usr/local/lib".into()]).chain(local);
    folders.flat_map(|folder| ["libdrd.so.3", "libdhd.so.3"].map(|name| folder.join(name))).collect()
}

/// A text of the library, which keeps it.
fn copied(text: *const c_char) -> String {
    if text.is_null() {
        return String::new();
    }
    // SAFETY: a text of the library that ends with a zero and stays.
    unsafe { CStr::from_ptr(text) }.to_string_lossy().into_owned()
}
