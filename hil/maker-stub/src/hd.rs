//! The functions of HDAPI that the driver uses.

use super::attached;
use super::cable::{Cable, Field};
use core::ffi::{c_char, c_double, c_int, c_uchar, c_uint, c_ulong, c_ushort, c_void};
use core::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

type Callback = unsafe extern "C" fn(*mut c_void) -> c_uint;

const NO_DEVICE: c_uint = 0xFFFF_FFFF;
const INVALID_OPERATION: u32 = 0x102;
const ILLEGAL_BEGIN: u32 = 0x400;
const ILLEGAL_END: u32 = 0x401;
const POSITION: c_uint = 0x2050;
const TRANSFORM: c_uint = 0x2052;
const CURRENT_FORCE: c_uint = 0x2700;
const FORCE_OUTPUT: c_uint = 0x4000;
/// Frames after the start that are damaged.
const DAMAGED: u64 = 2;
/// Time in which the amplifiers come back after an exceeded limit, ns.
const RAMP_NS: f64 = 300e6;

#[repr(C)]
pub struct ErrorInfo {
    code: c_uint,
    internal: c_int,
    device: c_uint,
}

struct Scheduled {
    callback: Callback,
    data: *mut c_void,
}

// SAFETY: only the scheduler's thread uses the data, as the interface says.
unsafe impl Send for Scheduled {}

#[derive(Default)]
struct Library {
    cable: Option<Cable>,
    errors: Vec<u32>,
    /// Errors of the cable that are on the stack already.
    met: u64,
    in_frame: bool,
    force_n: [f64; 3],
    gives_force: bool,
    frames: u64,
    /// Time of the last exceeded limit, ns.
    off_since: Option<u64>,
    scheduled: Option<Scheduled>,
    scheduler: Option<JoinHandle<()>>,
}

static LIBRARY: Mutex<Option<Library>> = Mutex::new(None);
static RUNS: AtomicBool = AtomicBool::new(false);

fn with<T>(act: impl FnOnce(&mut Library) -> T) -> T {
    let mut library: MutexGuard<'_, Option<Library>> = LIBRARY.lock().unwrap_or_else(PoisonError::into_inner);
    act(library.get_or_insert_with(Library::default))
}

/// The library as it was loaded.
pub(crate) fn renew() {
    with(|library| *library = Library::default());
}

impl Library {
    /// Whether a frame is open; else the error of a call outside one.
    fn is_in_frame(&mut self) -> bool {
        if !self.in_frame {
            self.errors.push(INVALID_OPERATION);
        }
        self.in_frame
    }

    /// The share of the force that the amplifiers give.
    fn gain(&self) -> f64 {
        let now_ns = self.cable.as_ref().map_or(0, Cable::time_ns);
        let share = |since: u64| (now_ns.saturating_sub(since) as f64 / RAMP_NS).min(1.0);
        if self.gives_force { self.off_since.map_or(1.0, share) } else { 0.0 }
    }

    fn end(&mut self) {
        if !core::mem::take(&mut self.in_frame) || self.frames <= DAMAGED {
            self.errors.push(ILLEGAL_END);
        }
        let (gain, force_n) = (self.gain(), self.force_n);
        let Some(cable) = &self.cable else { return };
        for (axis, force_n) in (0..).zip(force_n) {
            cable.set_quantity(Field::Force(axis), gain * force_n);
        }
        if force_n.iter().any(|n| gain * n.abs() > 0.0) {
            cable.set_whole(Field::Forced, cable.time_ns());
        }
        cable.set_whole(Field::Frames, self.frames);
        cable.set_whole(Field::MotorsOn, u64::from(self.gives_force));
        let failing = cable.whole(Field::Failing) as u32;
        if failing != 0 {
            self.errors.push(failing);
        }
        let errors = cable.whole(Field::Errors);
        if errors != self.met {
            let code = cable.whole(Field::Error) as u32;
            self.met = errors;
            self.errors.push(code);
            if (0x200..0x300).contains(&code) {
                self.off_since = Some(cable.time_ns());
            }
        }
    }
}

#[unsafe(no_mangle)]
pub extern "C" fn hdInitDevice(_: *const c_char) -> c_uint {
    with(|library| {
        let cable = attached();
        let refused = cable.as_ref().map_or(0x302, |cable| cable.whole(Field::Refused) as u32);
        library.cable = cable;
        if refused != 0 {
            library.errors.push(refused);
            return NO_DEVICE;
        }
        0
    })
}

#[unsafe(no_mangle)]
pub extern "C" fn hdDisableDevice(_: c_uint) {
    with(|library| library.cable = None);
}

#[unsafe(no_mangle)]
pub extern "C" fn hdMakeCurrentDevice(_: c_uint) {}

#[unsafe(no_mangle)]
pub extern "C" fn hdBeginFrame(_: c_uint) {
    with(|library| {
        if library.in_frame {
            library.errors.push(ILLEGAL_BEGIN);
        }
        (library.in_frame, library.force_n) = (true, [0.0; 3]);
        library.frames += 1;
    });
}

#[unsafe(no_mangle)]
pub extern "C" fn hdEndFrame(_: c_uint) {
    with(Library::end);
}

#[unsafe(no_mangle)]
pub extern "C" fn hdEnable(capability: c_uint) {
    with(|library| library.gives_force |= capability == FORCE_OUTPUT);
}

#[unsafe(no_mangle)]
pub extern "C" fn hdDisable(capability: c_uint) {
    with(|library| library.gives_force &= capability != FORCE_OUTPUT);
}

#[unsafe(no_mangle)]
pub extern "C" fn hdIsEnabled(capability: c_uint) -> c_uchar {
    with(|library| u8::from(library.gives_force && capability == FORCE_OUTPUT))
}

/// # Safety
///
/// `to` has room for one number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hdGetIntegerv(_: c_uint, to: *mut c_int) {
    let buttons = with(|library| library.cable.as_ref().map_or(0, |cable| cable.whole(Field::Buttons)));
    // SAFETY: the caller's.
    unsafe { *to = buttons as c_int }
}

/// # Safety
///
/// `to` has room for the numbers of the value.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hdGetDoublev(value: c_uint, to: *mut c_double) {
    let numbers = with(|library| -> Vec<f64> {
        let position = |library: &mut Library| -> Vec<f64> {
            let cable = library.cable.as_ref();
            (0..3).map(|axis| cable.map_or(0.0, |cable| cable.quantity(Field::Position(axis)))).collect()
        };
        match value {
            POSITION if library.is_in_frame() => position(library),
            TRANSFORM if library.is_in_frame() => {
                let mut transform = vec![1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];
                transform.extend(position(library));
                transform.push(1.0);
                transform
            }
            0x2602 => vec![0.5],
            0x2603 => vec![3.3],
            0x2604 => vec![0.88],
            _ => Vec::new(),
        }
    });
    for (at, number) in numbers.into_iter().enumerate() {
        // SAFETY: the caller's.
        unsafe { *to.add(at) = number }
    }
}

/// # Safety
///
/// `from` has the numbers of the value.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn hdSetDoublev(value: c_uint, from: *const c_double) {
    // SAFETY: the caller's; a force has three.
    let numbers = core::array::from_fn(|axis| unsafe { *from.add(axis) });
    with(|library| {
        if value == CURRENT_FORCE && library.is_in_frame() {
            library.force_n = numbers;
        }
    });
}

#[unsafe(no_mangle)]
pub extern "C" fn hdGetString(value: c_uint) -> *const c_char {
    match value {
        0x2500 => c"3.4.0".as_ptr(),
        0x2501 => c"Touch".as_ptr(),
        _ => c"emulated".as_ptr(),
    }
}

#[unsafe(no_mangle)]
pub extern "C" fn hdGetError() -> ErrorInfo {
    ErrorInfo { code: with(|library| library.errors.pop().unwrap_or(0)), internal: 0, device: 0 }
}

#[unsafe(no_mangle)]
pub extern "C" fn hdGetErrorString(code: c_uint) -> *const c_char {
    match code {
        0x200 => c"the motors are warm".as_ptr(),
        0x203 => c"the velocity limit is exceeded".as_ptr(),
        0x302 => c"communication error".as_ptr(),
        _ => c"an error of the emulated library".as_ptr(),
    }
}

#[unsafe(no_mangle)]
pub extern "C" fn hdCheckCalibration() -> c_uint {
    let state = with(|library| library.cable.as_ref().map_or(0, |cable| cable.whole(Field::Calibration)));
    if state == 0 { 0x5000 } else { state as c_uint }
}

#[unsafe(no_mangle)]
pub extern "C" fn hdUpdateCalibration(_: c_uint) {
    with(|library| library.cable.as_ref().map(|cable| cable.set_whole(Field::Calibration, 0)));
}

#[unsafe(no_mangle)]
pub extern "C" fn hdSetSchedulerRate(_: c_ulong) {}

#[unsafe(no_mangle)]
pub extern "C" fn hdScheduleAsynchronous(callback: Callback, data: *mut c_void, _: c_ushort) -> c_ulong {
    with(|library| library.scheduled = Some(Scheduled { callback, data }));
    1
}

#[unsafe(no_mangle)]
pub extern "C" fn hdUnschedule(_: c_ulong) {
    with(|library| library.scheduled = None);
}

/// A cycle of the scheduler; false while it stands still or has nothing to call.
pub(crate) fn cycle() -> bool {
    let scheduled = with(|library| {
        let stands_still = library.cable.as_ref().is_some_and(|cable| cable.whole(Field::Stalled) != 0);
        if stands_still { None } else { library.scheduled.take() }
    });
    let Some(scheduled) = scheduled else { return false };
    // SAFETY: as it was scheduled.
    let goes_on = unsafe { (scheduled.callback)(scheduled.data) } != 0;
    with(|library| {
        if goes_on {
            library.scheduled = Some(scheduled);
        }
    });
    true
}

#[unsafe(no_mangle)]
pub extern "C" fn hdStartScheduler() {
    if with(|library| library.cable.as_ref().is_some_and(|cable| cable.whole(Field::Stepped) != 0)) {
        return;
    }
    RUNS.store(true, Ordering::Release);
    let scheduler = std::thread::spawn(|| {
        let mut due = Instant::now();
        while RUNS.load(Ordering::Acquire) {
            due += Duration::from_millis(1);
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
            cycle();
            // After a stall it does not catch up.
            due = due.max(Instant::now() - Duration::from_millis(1));
        }
    });
    with(|library| library.scheduler = Some(scheduler));
}

#[unsafe(no_mangle)]
pub extern "C" fn hdStopScheduler() {
    RUNS.store(false, Ordering::Release);
    if let Some(scheduler) = with(|library| library.scheduler.take()) {
        let _ = scheduler.join();
    }
}
