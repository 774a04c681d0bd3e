//! A Phantom or Touch through OpenHaptics: the library's scheduler calls a cycle of ours, a thousand times a second.
//!
//! One frame a cycle: read the device, publish the sample, set the force of the [`Exchange`], send, and take the errors off the
//! library's stack. All calls of the library for the device are in the cycle, because its scheduler runs.
//!
//! The library resumes by itself after an exceeded limit and after a stall. So the exchange latches both.

use super::api::{Hd, value};
use super::running::Running;
use crate::device::DeviceState;
use crate::device::maker::driven::{Driven, Opened};
use crate::device::maker::exchange::Exchange;
use crate::device::maker::page::Measured;
use crate::device::maker::rotation::orientation_of;
use core::fmt;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use palpate_core::{Vec3, vec3};
use palpate_link::DeviceFault;
use std::ffi::CString;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Cycles without an error before the first sample: those just after the start have damaged positions.
const CLEAN_CYCLES: u32 = 3;
/// Cycles between two looks at the calibration while it is not good.
const CALIBRATION_CYCLES: u32 = 100;
/// Most errors that are taken off the stack in a cycle.
const MOST_ERRORS: u32 = 16;
/// Rate of the scheduler, Hz.
const RATE_HZ: u32 = 1_000;
/// Longest wait for the last cycle.
const STOP_TIMEOUT: Duration = Duration::from_millis(100);
/// No connection to the device.
const COMM_ERROR: u32 = 0x302;
/// Cycles in a row without a connection that are a lost device.
const MOST_LOST: u32 = 3;
/// Already started: the library leaves it on the stack of a first start.
const ALREADY_STARTED: u32 = 0x103;

/// Why a device cannot be opened, in one line with the fix.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum TouchError {
    /// There is no device, or it is in use.
    NoDevice {
        /// The library's number.
        code: u32,
        /// The library's words.
        text: String,
    },
}

impl TouchError {
    /// What to do about an error of the library.
    fn fix(code: u32) -> &'static str {
        match code {
            0x302 | 0x303 => "check cable and power; plug it out and in after a session that was killed",
            0x304 | 0x101 => "end the other program that uses it",
            0x600 => "install the licence of OpenHaptics",
            _ => "check cable, power, and its name in the maker's setup program",
        }
    }
}

impl fmt::Display for TouchError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self::NoDevice { code, text } = self;
        write!(f, "no Touch can be opened ({text}, {code:#x}); {}", Self::fix(*code))
    }
}

impl core::error::Error for TouchError {}

/// What the thread beside the cycles sees of them.
#[derive(Debug, Default)]
struct Seen {
    /// The cycle is to end.
    stopping: AtomicBool,
    /// It has sent its last zero.
    has_stopped: AtomicBool,
    /// The newest error of the library; 0 without one.
    error: AtomicU32,
    /// Whether the stylus has to be put into its inkwell.
    needs_hand: AtomicBool,
}

/// The open device.
#[derive(Debug)]
pub struct Touch {
    hd: Hd,
    device: u32,
    opened: Opened,
    seen: Arc<Seen>,
    running: Option<Running>,
    /// The user has been told to calibrate it.
    told_hand: bool,
}

/// One cycle after another.
struct Cycle {
    hd: Hd,
    device: u32,
    exchange: Exchange,
    clock: Box<dyn Fn() -> u64 + Send>,
    seen: Arc<Seen>,
    clean: u32,
    count: u32,
    is_calibrated: bool,
    /// Cycles in a row without a connection.
    lost: u32,
    /// The motors were switched on, which the loop's first arming does.
    is_on: bool,
}

/// What an error of a frame means; `None` of one that may belong to another call.
fn fault(code: u32) -> Option<DeviceFault> {
    match code {
        0x203 => Some(DeviceFault::Overspeed),
        0x200..=0x204 | 0x300 => Some(DeviceFault::Hardware),
        0x302 | 0x304 => Some(DeviceFault::Watchdog),
        0x303 | 0x305..=0x3ff => Some(DeviceFault::Hardware),
        _ => None,
    }
}

impl Cycle {
    fn run(&mut self) -> bool {
        let now_ns = (self.clock)();
        let is_last = self.seen.stopping.load(Ordering::Acquire);
        self.hd.begin(self.device);
        let position_m: Vec3 = self.hd.doubles(value::POSITION).map(|mm: f64| (1e-3 * mm) as f32);
        let transform: [f64; 16] = self.hd.doubles(value::TRANSFORM);
        let buttons = self.hd.integer(value::BUTTONS) as u32;
        if !self.is_calibrated && self.count.is_multiple_of(CALIBRATION_CYCLES) {
            self.calibrate();
        }
        self.count = self.count.wrapping_add(1);
        let is_clean = self.clean >= CLEAN_CYCLES;
        self.exchange.set_state(match (is_clean, self.is_calibrated) {
            (false, _) => DeviceState::Open,
            (true, false) => DeviceState::Unhomed,
            (true, true) => DeviceState::Homed,
        });
        let force_n = self.exchange.force_n((self.clock)());
        if !self.is_on && self.exchange.is_armed() {
            self.hd.set_enabled(value::FORCE_OUTPUT, true);
            self.is_on = true;
        }
        let force_n = if is_last { vec3::ZERO } else { force_n };
        self.hd.set_force(force_n.map(f64::from));
        self.hd.end(self.device);
        let is_good = self.take_errors(now_ns, is_clean);
        self.clean = if is_good {
            self.clean.saturating_add(1)
        } else if is_clean {
            self.clean
        } else {
            0
        };
        if is_good && is_clean {
            let rows = [0, 1, 2].map(|row| [0, 1, 2].map(|column| transform[4 * column + row]));
            let orientation = orientation_of(rows);
            self.exchange.publish(&Measured {
                t_ns: now_ns,
                position_m,
                orientation,
                buttons,
                rendered_n: None,
            });
        }
        // The library would go on with a cable that is plugged in again; that device is another session's.
        let is_lost = self.lost >= MOST_LOST;
        if is_lost {
            self.exchange.set_state(DeviceState::Disconnected);
            self.exchange.check_loop(now_ns);
        }
        if is_last || is_lost {
            self.seen.has_stopped.store(true, Ordering::Release);
        }
        !is_last && !is_lost
    }

    /// The position jumps when a calibration is renewed: only without a force, which the state sees to.
    fn calibrate(&mut self) {
        let state = self.hd.calibration();
        if state == value::NEEDS_UPDATE {
            self.hd.calibrate(self.hd.integer(value::CALIBRATION_STYLE) as u32);
        }
        self.is_calibrated = state == value::CALIBRATED;
        self.seen.needs_hand.store(state == value::NEEDS_HAND, Ordering::Relaxed);
    }

    /// Takes the errors of this frame off the stack; whether there was none.
    fn take_errors(&mut self, now_ns: u64, is_clean: bool) -> bool {
        let (mut is_good, mut is_connected) = (true, true);
        for _ in 0..MOST_ERRORS {
            let Some(error) = self.hd.next_error() else { break };
            is_good = false;
            is_connected &= error.code != COMM_ERROR;
            // Those just after the start are nobody's concern.
            if !is_clean {
                continue;
            }
            self.seen.error.store(error.code, Ordering::Relaxed);
            if let Some(fault) = fault(error.code) {
                self.exchange.latch(now_ns, fault);
            }
        }
        self.lost = if is_connected { 0 } else { self.lost + 1 };
        is_good
    }
}

impl Touch {
    /// Opens a device and puts the cycle into the library's scheduler. There is no force before the loop sends one.
    ///
    /// `exchange` gets the largest force that the device states, N.
    pub fn start(
        hd: Hd,
        name: Option<CString>,
        exchange: impl FnOnce(f32) -> Exchange,
        clock: Box<dyn Fn() -> u64 + Send>,
    ) -> Result<Self, TouchError> {
        // Errors of an earlier session.
        while hd.next_error().is_some() {}
        let device = hd.open(name.as_deref()).ok_or_else(|| {
            let code = hd.next_error().map_or(0, |error| error.code);
            TouchError::NoDevice { code, text: hd.error_text(code) }
        })?;
        if let Some(error) = hd.next_error().filter(|error| error.code != ALREADY_STARTED) {
            let text = hd.error_text(error.code);
            hd.close(device);
            return Err(TouchError::NoDevice { code: error.code, text });
        }
        let number = |value: u32| hd.doubles::<1>(value)[0] as f32;
        let opened = Opened {
            name: format!(
                "{} {} (OpenHaptics {})",
                hd.text(value::MODEL),
                hd.text(value::SERIAL),
                hd.text(value::VERSION)
            ),
            max_force_n: number(value::FORCE),
            max_stiffness_n_m: 1e3 * number(value::STIFFNESS),
        };
        hd.set_enabled(value::FORCE_OUTPUT, false);
        hd.set_rate(RATE_HZ);
        let seen = Arc::new(Seen::default());
        let mut cycle = Cycle {
            hd,
            device,
            exchange: exchange(opened.max_force_n),
            clock,
            seen: seen.clone(),
            clean: 0,
            count: 0,
            is_calibrated: false,
            lost: 0,
            is_on: false,
        };
        let running = Running::begin(hd, device, Box::new(move || cycle.run()));
        hd.start();
        Ok(Self { hd, device, opened, seen, running: Some(running), told_hand: false })
    }

    /// Sends a last zero and ends the cycle: a library that calls no cycle any more is waited for only so long.
    pub fn stop(&mut self) {
        self.seen.stopping.store(true, Ordering::Release);
        let give_up = Instant::now() + STOP_TIMEOUT;
        while !self.seen.has_stopped.load(Ordering::Acquire) && Instant::now() < give_up {
            std::thread::sleep(Duration::from_millis(1));
        }
        if let Some(running) = self.running.take() {
            running.end(self.seen.has_stopped.load(Ordering::Acquire));
            self.hd.close(self.device);
        }
    }
}

impl Driven for Touch {
    fn opened(&self) -> &Opened {
        &self.opened
    }

    fn news(&mut self) -> Option<String> {
        let name = &self.opened.name;
        let code = self.seen.error.swap(0, Ordering::Relaxed);
        if code != 0 {
            return Some(format!("{name}: {} ({code:#x})", self.hd.error_text(code)));
        }
        let needs_hand = self.seen.needs_hand.load(Ordering::Relaxed);
        let is_told = core::mem::replace(&mut self.told_hand, needs_hand);
        (needs_hand && !is_told).then(|| format!("put the stylus of {name} into its inkwell to calibrate it"))
    }
}

impl Drop for Touch {
    fn drop(&mut self) {
        self.stop();
    }
}
