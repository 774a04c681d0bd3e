//! The exchange with an open device, on a thread of ours: a call of the library is a USB transfer, whose time has no bound.

use super::api::{Dhd, DhdError, Id, Pose, Status};
use super::model::Family;
use super::opening::{self, Found, OpenError};
use crate::device::DeviceState;
use crate::device::maker::cycles::{Cycle, Cycles};
use crate::device::maker::driven::{Driven, Opened};
use crate::device::maker::exchange::Exchange;
use crate::device::maker::page::Measured;
use crate::device::maker::rotation::orientation_of;
use palpate_core::{Vec3, vec3};
use palpate_link::DeviceFault;
use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};

/// Cycles between two looks at the state: 2 ms.
const STATUS_CYCLES: u32 = 4;
/// Cycles in a row with an error that are a fault.
const MOST_FAILURES: u32 = 3;
/// Looks in a row that find the motors off without a cause, which are a fault: 50 ms, for they go on with a delay.
const MOST_OFF: u32 = 25;
/// The library has no such device any more.
const NO_DEVICE: i32 = 5;

/// Lines for the user, which any thread adds.
type News = Arc<Mutex<VecDeque<String>>>;

fn tell(news: &News, line: String) {
    news.lock().unwrap_or_else(PoisonError::into_inner).push_back(line);
}

/// The open device. A last zero is sent, and it is closed, when this is dropped.
#[derive(Debug)]
pub struct ForceDimension {
    dhd: Dhd,
    id: Id,
    opened: Opened,
    news: News,
    cycles: Option<Cycles>,
}

/// The exchange.
pub struct Exchanging {
    dhd: Dhd,
    id: Id,
    name: String,
    exchange: Exchange,
    clock: Box<dyn Fn() -> u64 + Send>,
    news: News,
    count: u32,
    /// Exchanges in a row with an error, and looks at the state.
    failures: u32,
    blind: u32,
    is_lost: bool,
    /// The motors were switched on.
    is_on: bool,
    /// The device has said since then that they are.
    was_on: bool,
    /// Looks in a row that found them off.
    off: u32,
}

impl core::fmt::Debug for Exchanging {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Exchanging").field("name", &self.name).finish_non_exhaustive()
    }
}

/// What a cause of motors that went off means, and its words.
const fn off(cause: i32) -> (DeviceFault, &'static str) {
    match cause {
        1 => (DeviceFault::Hardware, "its force button was pressed"),
        2 => (DeviceFault::Overspeed, "it was faster than its velocity threshold"),
        3 => (DeviceFault::Watchdog, "its watchdog had no command for 10 ms"),
        4 => (DeviceFault::Hardware, "its software switched them off"),
        5 => (DeviceFault::Watchdog, "its USB connection was lost"),
        6 => (DeviceFault::Hardware, "its dead man's switch was released"),
        _ => (DeviceFault::Hardware, "it gives no cause"),
    }
}

impl Exchanging {
    /// Opens a device. There is no force before the loop sends one.
    ///
    /// `exchange` gets the largest force that the device states: it states none.
    pub fn open(
        dhd: Dhd,
        (family, may_move): (Family, bool),
        max_force_n: f32,
        exchange: impl FnOnce(f32) -> Exchange,
        clock: Box<dyn Fn() -> u64 + Send>,
    ) -> Result<(Self, Opened), OpenError> {
        let Found { id, name, remarks } = opening::open(&dhd, family, may_move, max_force_n)?;
        let news: News = Arc::new(Mutex::new(remarks.into()));
        let opened = Opened { name: name.clone(), max_force_n: 0.0, max_stiffness_n_m: 0.0 };
        let exchange = exchange(opened.max_force_n);
        let cycle = Self {
            dhd,
            id,
            name,
            exchange,
            clock,
            news,
            count: 0,
            failures: 0,
            blind: 0,
            is_lost: false,
            is_on: false,
            was_on: false,
            off: 0,
        };
        Ok((cycle, opened))
    }

    /// Sends a force. The motors go on at a zero one, when the loop is armed: also after they have gone off.
    fn send(&mut self, force_n: Vec3) -> Result<(), DhdError> {
        if self.is_on {
            return self.dhd.set_force(self.id, force_n.map(f64::from));
        }
        self.dhd.set_force(self.id, [0.0; 3])?;
        if self.exchange.is_armed() && !self.is_lost {
            self.dhd.enable_force(self.id, true)?;
            (self.is_on, self.was_on) = (true, false);
        }
        Ok(())
    }

    /// Counts an error; several in a row are a fault.
    fn fail(&mut self, now_ns: u64, error: &DhdError) {
        self.failures += 1;
        if error.code == NO_DEVICE || self.failures >= MOST_FAILURES || self.blind >= MOST_FAILURES {
            self.latch(now_ns, DeviceFault::Watchdog, &format!("{} (error {})", error.text, error.code));
            self.is_lost |= error.code == NO_DEVICE;
            // By another call, whether or not it arrives.
            let _ = self.dhd.enable_force(self.id, false);
            self.is_on = false;
        }
    }

    fn lose(&mut self, now_ns: u64) {
        self.is_lost = true;
        self.latch(now_ns, DeviceFault::Watchdog, off(5).1);
    }

    fn latch(&mut self, now_ns: u64, fault: DeviceFault, why: &str) {
        if self.exchange.fault().is_none() {
            tell(&self.news, format!("{}: {why}", self.name));
        }
        self.exchange.latch(now_ns, fault);
    }

    /// The motors went off by themselves, or the position is no longer initialised.
    fn check(&mut self, now_ns: u64) {
        match self.dhd.status(self.id) {
            Ok(Status { is_connected: false, .. }) => self.lose(now_ns),
            // The cause of an earlier loss stays until the motors go on.
            Ok(Status { gives_force: false, off_cause: 5, .. }) if self.was_on => self.lose(now_ns),
            Ok(Status { gives_force: false, off_cause, .. }) if self.is_on => {
                self.off += 1;
                if (off_cause != 0 && self.was_on) || self.off >= MOST_OFF {
                    let (fault, why) = off(off_cause);
                    (self.is_on, self.was_on) = (false, false);
                    self.latch(now_ns, fault, &format!("its motors went off: {why}"));
                }
            }
            Ok(Status { is_initialized, gives_force, .. }) => {
                self.off = 0;
                self.was_on |= gives_force && self.is_on;
                let state = if is_initialized { DeviceState::Homed } else { DeviceState::Unhomed };
                self.exchange.set_state(state);
            }
            Err(error) => {
                self.blind += 1;
                if self.blind >= MOST_FAILURES {
                    self.fail(now_ns, &error);
                }
                return;
            }
        }
        self.blind = 0;
    }
}

impl Cycle for Exchanging {
    fn run(&mut self) {
        let now_ns = (self.clock)();
        // A device that comes back is another session's.
        if self.is_lost {
            self.exchange.set_state(DeviceState::Disconnected);
            self.exchange.force_n(now_ns);
            return;
        }
        if self.count.is_multiple_of(STATUS_CYCLES) {
            self.check(now_ns);
        }
        self.count = self.count.wrapping_add(1);
        let pose = self.dhd.pose(self.id);
        let buttons = self.dhd.buttons(self.id);
        let force_n = self.exchange.force_n((self.clock)());
        let sent = self.send(force_n);
        match (pose, sent) {
            (_, Err(error)) | (Pose::Failed(error), Ok(())) => self.fail(now_ns, &error),
            (Pose::Cached, Ok(())) => self.failures = 0,
            (Pose::Fresh(position_m, rows), Ok(())) => {
                self.failures = 0;
                let position_m: Vec3 = position_m.map(|m| m as f32);
                if vec3::is_finite(position_m) && !self.is_lost {
                    let orientation = orientation_of(rows);
                    self.exchange.publish(&Measured {
                        t_ns: now_ns,
                        position_m,
                        orientation,
                        buttons,
                        rendered_n: None,
                    });
                }
            }
        }
    }

    fn close(&mut self) {
        let _ = self.dhd.set_force(self.id, [0.0; 3]);
        let _ = self.dhd.enable_force(self.id, false);
        self.dhd.close(self.id);
    }
}

impl ForceDimension {
    /// Starts the exchange on its thread.
    pub fn start((cycle, opened): (Exchanging, Opened), fifo_priority: Option<i32>) -> io::Result<Self> {
        let (dhd, id, news) = (cycle.dhd, cycle.id, cycle.news.clone());
        let cycles = Some(Cycles::start(Box::new(cycle), fifo_priority)?);
        Ok(Self { dhd, id, opened, news, cycles })
    }
}

impl Driven for ForceDimension {
    fn opened(&self) -> &Opened {
        &self.opened
    }

    fn news(&mut self) -> Option<String> {
        self.news.lock().unwrap_or_else(PoisonError::into_inner).pop_front()
    }
}

impl Drop for ForceDimension {
    /// The motors go off by a call of this thread, whether or not the other one still answers.
    fn drop(&mut self) {
        let _ = self.dhd.enable_force(self.id, false);
        self.cycles = None;
    }
}
