//! The driver on a table of functions in place of the library, cycle by cycle.
#![allow(unsafe_code)]

use super::api::{Callback, ErrorInfo, Functions, Hd, NO_DEVICE, value};
use super::driver::{Touch, TouchError};
use crate::device::DeviceState;
use crate::device::maker::driven::Driven;
use crate::device::maker::exchange::Exchange;
use crate::device::maker::page::{Force, Page, SessionEnd};
use core::ffi::{c_char, c_double, c_int, c_uchar, c_uint, c_ulong, c_ushort, c_void};
use palpate_core::{Orientation, vec3};
use palpate_link::DeviceFault;
use std::cell::RefCell;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

const MS: u64 = 1_000_000;

/// What the emulated library holds: one for each test's thread.
struct Fake {
    handle: u32,
    opening_error: Option<u32>,
    errors: Vec<u32>,
    position_mm: [f64; 3],
    /// By columns.
    transform: [f64; 16],
    calibration: u32,
    callback: Option<(Callback, *mut c_void)>,
    is_running: bool,
    in_frame: bool,
    force_n: [f64; 3],
    sent_n: Vec<[f64; 3]>,
    closed: u32,
}

thread_local! {
    static FAKE: RefCell<Fake> = const {
        RefCell::new(Fake {
            handle: 0,
            opening_error: None,
            errors: Vec::new(),
            position_mm: [0.0; 3],
            transform: [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0],
            calibration: value::CALIBRATED,
            callback: None,
            is_running: false,
            in_frame: false,
            force_n: [0.0; 3],
            sent_n: Vec::new(),
            closed: 0,
        })
    };
}

fn fake<T>(with: impl FnOnce(&mut Fake) -> T) -> T {
    FAKE.with_borrow_mut(with)
}

unsafe extern "C" fn init_device(_: *const c_char) -> c_uint {
    fake(|fake| {
        fake.errors.extend(fake.opening_error);
        fake.handle
    })
}
unsafe extern "C" fn disable_device(_: c_uint) {
    fake(|fake| fake.closed += 1);
}
unsafe extern "C" fn nothing(_: c_uint) {}
unsafe extern "C" fn begin_frame(_: c_uint) {
    fake(|fake| {
        // A frame in a frame is an error; each begins without a force.
        if fake.in_frame {
            fake.errors.push(0x400);
        }
        (fake.in_frame, fake.force_n) = (true, [0.0; 3]);
    });
}
unsafe extern "C" fn end_frame(_: c_uint) {
    fake(|fake| {
        if !core::mem::take(&mut fake.in_frame) {
            fake.errors.push(0x401);
        }
        fake.sent_n.push(fake.force_n);
    });
}
unsafe extern "C" fn is_enabled(_: c_uint) -> c_uchar {
    1
}
unsafe extern "C" fn get_integers(_: c_uint, to: *mut c_int) {
    // SAFETY: the driver gives room for 32.
    unsafe { *to = 2 }
}
unsafe extern "C" fn get_doubles(what: c_uint, to: *mut c_double) {
    let numbers: Vec<f64> = fake(|fake| match what {
        value::POSITION => fake.position_mm.to_vec(),
        value::TRANSFORM => fake.transform.to_vec(),
        value::FORCE => vec![3.3],
        value::STIFFNESS => vec![0.5],
        _ => vec![],
    });
    for (n, number) in numbers.into_iter().enumerate() {
        // SAFETY: as above.
        unsafe { *to.add(n) = number }
    }
}
unsafe extern "C" fn set_doubles(what: c_uint, from: *const c_double) {
    assert_eq!(what, value::CURRENT_FORCE);
    // SAFETY: a force has three numbers.
    let force_n = core::array::from_fn(|n| unsafe { *from.add(n) });
    fake(|fake| fake.force_n = force_n);
}
unsafe extern "C" fn get_string(_: c_uint) -> *const c_char {
    c"Touch".as_ptr()
}
unsafe extern "C" fn get_error() -> ErrorInfo {
    ErrorInfo { code: fake(|fake| fake.errors.pop().unwrap_or(0)), internal: 0, device: 0 }
}
unsafe extern "C" fn check_calibration() -> c_uint {
    fake(|fake| fake.calibration)
}
unsafe extern "C" fn start_scheduler() {
    fake(|fake| fake.is_running = true);
}
unsafe extern "C" fn stop_scheduler() {
    fake(|fake| fake.is_running = false);
}
unsafe extern "C" fn set_rate(_: c_ulong) {}
unsafe extern "C" fn schedule(callback: Callback, data: *mut c_void, _: c_ushort) -> c_ulong {
    fake(|fake| fake.callback = Some((callback, data)));
    1
}
unsafe extern "C" fn unschedule(_: c_ulong) {
    fake(|fake| fake.callback = None);
}

const FUNCTIONS: Functions = Functions {
    init_device,
    disable_device,
    make_current: nothing,
    begin_frame,
    end_frame,
    enable: nothing,
    disable: nothing,
    is_enabled,
    get_integers,
    get_doubles,
    set_doubles,
    get_string,
    get_error,
    get_error_string: get_string,
    check_calibration,
    update_calibration: nothing,
    start_scheduler,
    stop_scheduler,
    set_scheduler_rate: set_rate,
    schedule,
    unschedule,
};

struct Bench {
    touch: Touch,
    session: SessionEnd,
    now_ns: Arc<AtomicU64>,
}

fn open() -> Result<Bench, TouchError> {
    let (page, now_ns) = (Page::local(), Arc::new(AtomicU64::new(MS)));
    let clock = {
        let now_ns = now_ns.clone();
        Box::new(move || now_ns.load(Ordering::Relaxed))
    };
    let proxy = page.clone().proxy();
    let touch = Touch::start(Hd::of(FUNCTIONS), None, |stated_n| Exchange::new(proxy, stated_n), clock)?;
    Ok(Bench { touch, session: page.session(), now_ns })
}

impl Bench {
    /// A tick of the loop and a cycle of the library, `ms` after the last ones; the force that was sent.
    fn after(&mut self, ms: u64, force_n: [f32; 3]) -> [f64; 3] {
        let now_ns = self.now_ns.fetch_add(ms * MS, Ordering::Relaxed) + ms * MS;
        self.session.send(Force { t_ns: now_ns, force_n, is_armed: true });
        let scheduled = fake(|fake| fake.callback.filter(|_| fake.is_running));
        if let Some((callback, data)) = scheduled {
            // SAFETY: scheduled with this data, on this thread.
            unsafe { callback(data) };
        }
        fake(|fake| fake.sent_n.last().copied().unwrap_or_default())
    }

    fn ready() -> Self {
        let mut bench = open().expect("it opens");
        for _ in 0..5 {
            bench.after(1, [0.0; 3]);
        }
        assert_eq!(bench.session.health().state, DeviceState::Homed);
        bench
    }
}

#[test]
fn a_cycle_sends_the_force_and_publishes_the_position() {
    let mut bench = Bench::ready();
    assert_eq!(bench.touch.opened().max_stiffness_n_m, 500.0);
    let quarter = [0.0, 1.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 5.0, 6.0, 7.0, 1.0];
    fake(|fake| (fake.position_mm, fake.transform) = ([10.0, -20.0, 30.0], quarter));
    assert_eq!(bench.after(1, [1.0, -0.5, 0.25]), [1.0, -0.5, 0.25]);
    let measured = bench.session.measured();
    assert_eq!((measured.t_ns, measured.buttons), (bench.now_ns.load(Ordering::Relaxed), 2));
    assert!(vec3::distance(measured.position_m, [0.01, -0.02, 0.03]) < 1e-8);
    let about_z = Orientation::of_vector([0.0, 0.0, core::f32::consts::FRAC_PI_2]);
    assert!(vec3::distance(measured.orientation.xyz, about_z.xyz) < 1e-6, "{measured:?}");
    let [x, ..] = bench.after(1, [50.0, 0.0, 0.0]);
    assert!(x <= 3.3 && x > 3.299, "the limit that it has read: {x}");
    drop(bench);
    assert!(fake(|fake| fake.callback.is_none() && !fake.is_running && fake.closed == 1));
}

#[test]
fn damaged_first_frames_and_a_missing_calibration_give_no_force() {
    fake(|fake| fake.calibration = value::NEEDS_HAND);
    let mut bench = open().expect("it opens");
    for _ in 0..3 {
        fake(|fake| fake.errors.push(0x401));
        assert_eq!(bench.after(1, [1.0, 0.0, 0.0]), [0.0; 3]);
    }
    assert_eq!((bench.session.health().state, bench.session.measured().t_ns), (DeviceState::Open, 0));
    // The errors of these frames are nobody's concern.
    assert!(bench.touch.news().is_some_and(|line| line.contains("inkwell")));
    assert!((0..50).all(|_| bench.after(1, [1.0, 0.0, 0.0]) == [0.0; 3]));
    assert_eq!(bench.session.health().state, DeviceState::Unhomed);
    assert_eq!(bench.touch.news(), None, "told once");
    fake(|fake| fake.calibration = value::CALIBRATED);
    for _ in 0..100 {
        bench.after(1, [1.0, 0.0, 0.0]);
    }
    assert_eq!(bench.after(1, [1.0, 0.0, 0.0]), [1.0, 0.0, 0.0]);
    assert_eq!(bench.touch.news(), None);
}

/// The library ramps its forces back by itself after an exceeded limit and after a stall.
#[test]
fn errors_and_stalls_are_latched_until_the_reset() {
    for (code, fault) in [
        (0x200, DeviceFault::Hardware),
        (0x201, DeviceFault::Hardware),
        (0x203, DeviceFault::Overspeed),
        (0x300, DeviceFault::Hardware),
        (0x204, DeviceFault::Hardware),
        (0x302, DeviceFault::Watchdog),
        (0x303, DeviceFault::Hardware),
        (0x304, DeviceFault::Watchdog),
        (0, DeviceFault::Watchdog),
    ] {
        let mut bench = Bench::ready();
        assert_eq!(bench.after(1, [1.0, 0.0, 0.0]), [1.0, 0.0, 0.0]);
        if code == 0 {
            bench.after(12, [1.0, 0.0, 0.0]);
        } else {
            fake(|fake| fake.errors.push(code));
            bench.after(1, [1.0, 0.0, 0.0]);
            assert!(bench.touch.news().is_some_and(|line| line.contains(&format!("({code:#x})"))));
        }
        assert!((0..20).all(|_| bench.after(1, [1.0, 0.0, 0.0]) == [0.0; 3]), "{code:#x}");
        assert_eq!(bench.session.health().fault, Some(fault), "{code:#x}");
        bench.session.reset(bench.session.health().latch);
        bench.after(1, [1.0, 0.0, 0.0]);
        assert_eq!(bench.after(1, [1.0, 0.0, 0.0]), [1.0, 0.0, 0.0], "{code:#x}");
    }
    // An error that may belong to another call is no fault.
    let mut bench = Bench::ready();
    fake(|fake| fake.errors.push(0x100));
    bench.after(1, [1.0, 0.0, 0.0]);
    assert_eq!(bench.after(1, [1.0, 0.0, 0.0]), [1.0, 0.0, 0.0]);
}

#[test]
fn a_device_that_cannot_be_opened_is_one_line_with_the_fix() {
    for (handle, code, fix) in
        [(NO_DEVICE, 0x302, "cable"), (5_000, 0x304, "other program"), (0, 0x600, "licence")]
    {
        // What is on the stack before belongs to an earlier session.
        fake(|fake| (fake.handle, fake.opening_error, fake.errors) = (handle, Some(code), vec![0x102]));
        let line = open().err().expect("refused").to_string();
        assert!(line.contains(fix) && line.contains(&format!("{code:#x}")) && !line.contains('\n'), "{line}");
        assert!(fake(|fake| fake.callback.is_none() && !fake.is_running));
    }
    fake(|fake| (fake.handle, fake.opening_error) = (0, Some(0x103)));
    assert!(open().is_ok(), "already started: a left-over");
}
