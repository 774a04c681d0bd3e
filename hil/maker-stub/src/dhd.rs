//! The functions of libdhd and libdrd that the driver uses.

use super::attached;
use super::cable::{Cable, Field};
use core::ffi::{c_char, c_double, c_int, c_uchar, c_uint};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

const OMEGA_3: c_int = 33;
const NO_DEVICE: i32 = 5;
const EXPERT_OFF: i32 = 9;
const NOT_IMPLEMENTED: i32 = 10;
const IN_USE: i32 = 20;
/// The device's cause: its watchdog.
const BY_WATCHDOG: u64 = 3;
/// Time between two looks of the firmware.
const FIRMWARE: Duration = Duration::from_micros(500);

#[derive(Default)]
struct Library {
    cable: Option<Cable>,
    error: i32,
    is_expert: bool,
    gives_force: bool,
    off_cause: u64,
    /// Causes of the cable that were met already.
    met: u64,
    force_n: [f64; 3],
    max_force_n: f64,
    has_firmware: bool,
}

static LIBRARY: Mutex<Option<Library>> = Mutex::new(None);

fn with<T>(act: impl FnOnce(&mut Library) -> T) -> T {
    let mut library = LIBRARY.lock().unwrap_or_else(PoisonError::into_inner);
    act(library.get_or_insert_with(Library::default))
}

/// The library as it was loaded.
pub(crate) fn renew() {
    with(|library| *library = Library::default());
}

impl Library {
    fn is(&self, field: Field) -> bool {
        self.cable.as_ref().is_some_and(|cable| cable.whole(field) != 0)
    }

    /// -1 with this error.
    fn fail(&mut self, error: i32) -> c_int {
        self.error = error;
        -1
    }

    /// 0, or -1 of a device that is gone or fails.
    fn reach(&mut self) -> Result<&Cable, c_int> {
        let failing = self.cable.as_ref().map_or(NO_DEVICE, |cable| cable.whole(Field::Failing) as i32);
        if failing != 0 {
            return Err(self.fail(failing));
        }
        Ok(self.cable.as_ref().expect("it does not fail"))
    }

    /// Writes the force of the motors to the cable.
    fn drive(&self) {
        let Some(cable) = &self.cable else { return };
        cable.set_whole(Field::MotorsOn, u64::from(self.gives_force));
        let gain = if self.gives_force { 1.0 } else { 0.0 };
        for (axis, n) in (0..).zip(self.force_n) {
            cable.set_quantity(Field::Force(axis), gain * n);
        }
        if gain * self.force_n.iter().map(|n| n.abs()).sum::<f64>() > 0.0 {
            cable.set_whole(Field::Forced, cable.time_ns());
        }
    }

    fn go_off(&mut self, cause: u64) {
        (self.gives_force, self.off_cause) = (false, cause);
        self.drive();
    }
}

/// What the firmware does by itself.
pub(crate) fn firmware() {
    with(|library| {
        let Some(cable) = &library.cable else { return };
        let (offs, cause) = (cable.whole(Field::Offs), cable.whole(Field::OffCause));
        if offs != library.met {
            library.met = offs;
            library.go_off(cause);
        } else if cable.is_watched_off() {
            library.go_off(BY_WATCHDOG);
        }
    });
}

#[unsafe(no_mangle)]
pub extern "C" fn dhdGetDeviceCount() -> c_int {
    c_int::from(attached().is_some())
}

#[unsafe(no_mangle)]
pub extern "C" fn dhdGetAvailableCount() -> c_int {
    c_int::from(attached().is_some_and(|cable| cable.whole(Field::Refused) != IN_USE as u64))
}

#[unsafe(no_mangle)]
pub extern "C" fn dhdOpenID(_: c_char) -> c_int {
    let begins = with(|library| {
        library.cable = attached();
        let refused = library.cable.as_ref().map_or(NO_DEVICE, |cable| cable.whole(Field::Refused) as i32);
        if refused != 0 {
            return Err(library.fail(refused));
        }
        // Commands of an earlier session do not count.
        if let Some(cable) = &library.cable {
            cable.set_whole(Field::Commanded, cable.time_ns());
            library.met = cable.whole(Field::Offs);
        }
        Ok(!library.is(Field::Stepped) && !core::mem::replace(&mut library.has_firmware, true))
    });
    match begins {
        Err(refused) => return refused,
        Ok(true) => {
            std::thread::spawn(|| {
                loop {
                    firmware();
                    std::thread::sleep(FIRMWARE);
                }
            });
        }
        Ok(false) => {}
    }
    0
}

#[unsafe(no_mangle)]
pub extern "C" fn dhdClose(_: c_char) -> c_int {
    with(|library| library.cable = None);
    0
}

#[unsafe(no_mangle)]
pub extern "C" fn dhdStop(_: c_char) -> c_int {
    with(|library| library.go_off(4));
    0
}

#[unsafe(no_mangle)]
pub extern "C" fn dhdGetSystemType(_: c_char) -> c_int {
    let kind = with(|library| library.cable.as_ref().map_or(0, |cable| cable.whole(Field::Kind)));
    if kind == 0 { OMEGA_3 } else { kind as c_int }
}

#[unsafe(no_mangle)]
pub extern "C" fn dhdGetSystemName(id: c_char) -> *const c_char {
    match dhdGetSystemType(id) {
        OMEGA_3 => c"omega.3".as_ptr(),
        104 => c"sigma.7".as_ptr(),
        _ => c"another device".as_ptr(),
    }
}

/// # Safety
///
/// Four places for numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dhdGetSDKVersion(a: *mut c_int, b: *mut c_int, c: *mut c_int, d: *mut c_int) {
    for (to, number) in [(a, 3), (b, 16), (c, 0), (d, 0)] {
        // SAFETY: the caller's.
        unsafe { *to = number }
    }
}

#[unsafe(no_mangle)]
pub extern "C" fn dhdErrorGetLast() -> c_int {
    with(|library| library.error)
}

#[unsafe(no_mangle)]
pub extern "C" fn dhdErrorGetLastStr() -> *const c_char {
    match dhdErrorGetLast() {
        2 => c"communication error".as_ptr(),
        NO_DEVICE => c"no device found".as_ptr(),
        7 => c"timeout".as_ptr(),
        _ => c"an error of the emulated library".as_ptr(),
    }
}

/// # Safety
///
/// Places for three numbers and a matrix.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dhdGetPositionAndOrientationFrame(
    x: *mut c_double,
    y: *mut c_double,
    z: *mut c_double,
    frame: *mut [[c_double; 3]; 3],
    _: c_char,
) -> c_int {
    with(|library| {
        let cable = match library.reach() {
            Ok(cable) => cable,
            Err(failed) => return failed,
        };
        for (axis, to) in (0..).zip([x, y, z]) {
            // SAFETY: the caller's.
            unsafe { *to = cable.quantity(Field::Position(axis)) }
        }
        let (sine, cosine) = cable.quantity(Field::Turn).sin_cos();
        // SAFETY: the caller's.
        unsafe { *frame = [[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]] }
        c_int::from(cable.whole(Field::Cached) != 0)
    })
}

#[unsafe(no_mangle)]
pub extern "C" fn dhdGetButtonMask(_: c_char) -> c_uint {
    with(|library| library.cable.as_ref().map_or(0, |cable| cable.whole(Field::Buttons) as c_uint))
}

#[unsafe(no_mangle)]
pub extern "C" fn dhdSetForce(x: c_double, y: c_double, z: c_double, _: c_char) -> c_int {
    with(|library| {
        let (now_ns, frames) = match library.reach() {
            Ok(cable) => (cable.time_ns(), cable.whole(Field::Frames)),
            Err(failed) => return failed,
        };
        if let Some(cable) = &library.cable {
            cable.set_whole(Field::Frames, frames + 1);
            cable.set_whole(Field::Commanded, now_ns);
        }
        let size = (x * x + y * y + z * z).sqrt();
        let is_scaled = library.max_force_n > 0.0 && size > library.max_force_n;
        let gain = if is_scaled { library.max_force_n / size } else { 1.0 };
        library.force_n = [gain * x, gain * y, gain * z];
        library.drive();
        if is_scaled { 2 } else { 0 }
    })
}

#[unsafe(no_mangle)]
pub extern "C" fn dhdEnableForce(is_enabled: c_uchar, _: c_char) -> c_int {
    with(|library| {
        if let Err(failed) = library.reach() {
            return failed;
        }
        if is_enabled == 0 {
            library.go_off(4);
        } else {
            (library.gives_force, library.off_cause) = (true, 0);
            library.drive();
        }
        0
    })
}

#[unsafe(no_mangle)]
pub extern "C" fn dhdSetGravityCompensation(_: c_int, _: c_char) -> c_int {
    with(|library| library.reach().map_or_else(|failed| failed, |_| 0))
}

#[unsafe(no_mangle)]
pub extern "C" fn dhdSetMaxForce(limit_n: c_double, _: c_char) -> c_int {
    with(|library| {
        library.max_force_n = limit_n;
        if let Some(cable) = &library.cable {
            cable.set_quantity(Field::MaxForce, limit_n);
        }
        library.reach().map_or_else(|failed| failed, |_| 0)
    })
}

/// # Safety
///
/// Room for 17 numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dhdGetStatus(to: *mut c_int, _: c_char) -> c_int {
    with(|library| {
        if let Err(failed) = library.reach() {
            return failed;
        }
        let mut numbers = [0; 17];
        numbers[0] = c_int::from(!library.is(Field::Unpowered));
        numbers[1] = 1;
        numbers[2] = 1;
        numbers[3] = c_int::from(!library.is(Field::Uninitialized));
        numbers[5] = c_int::from(library.gives_force);
        numbers[14] = library.off_cause as c_int;
        for (at, number) in numbers.into_iter().enumerate() {
            // SAFETY: the caller's.
            unsafe { *to.add(at) = number }
        }
        0
    })
}

#[unsafe(no_mangle)]
pub extern "C" fn dhdEnableExpertMode() -> c_int {
    with(|library| library.is_expert = true);
    0
}

#[unsafe(no_mangle)]
pub extern "C" fn dhdDisableExpertMode() -> c_int {
    with(|library| library.is_expert = false);
    0
}

#[unsafe(no_mangle)]
pub extern "C" fn dhdSetWatchdog(steps: c_uchar, _: c_char) -> c_int {
    with(|library| {
        if library.is(Field::Unwatched) {
            return library.fail(NOT_IMPLEMENTED);
        }
        if !library.is_expert {
            return library.fail(EXPERT_OFF);
        }
        if let Some(cable) = &library.cable {
            let fixed = cable.whole(Field::FixedWatchdog);
            cable.set_whole(Field::Watchdog, if fixed == 0 { steps.into() } else { fixed });
        }
        0
    })
}

/// # Safety
///
/// A place for a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dhdGetWatchdog(to: *mut c_uchar, _: c_char) -> c_int {
    // SAFETY: the caller's.
    unsafe {
        *to = with(|library| library.cable.as_ref().map_or(0, |cable| cable.whole(Field::Watchdog) as u8))
    }
    0
}

/// # Safety
///
/// A place for a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dhdGetVelocityThreshold(to: *mut c_uint, _: c_char) -> c_int {
    // SAFETY: the caller's.
    unsafe { *to = if with(|library| library.is(Field::Unbraked)) { 0 } else { 20 } }
    0
}

#[unsafe(no_mangle)]
pub extern "C" fn drdOpenID(number: c_char) -> c_int {
    dhdOpenID(number)
}

#[unsafe(no_mangle)]
pub extern "C" fn drdClose(id: c_char) -> c_int {
    dhdClose(id)
}

#[unsafe(no_mangle)]
pub extern "C" fn drdIsInitialized(_: c_char) -> bool {
    with(|library| !library.is(Field::Uninitialized))
}

#[unsafe(no_mangle)]
pub extern "C" fn drdAutoInit(_: c_char) -> c_int {
    with(|library| {
        let Some(cable) = &library.cable else { return library.fail(NO_DEVICE) };
        cable.set_whole(Field::Motions, cable.whole(Field::Motions) + 1);
        cable.set_whole(Field::Uninitialized, 0);
        0
    })
}

#[unsafe(no_mangle)]
pub extern "C" fn drdStop(_: bool, _: c_char) -> c_int {
    0
}
