//! A device on a serial line, in memory or over a pseudo terminal: everything but the device itself.

use super::{Cut, Mishap, OpenError, Rig, Traits};
use crate::fault::{FaultCounts, Faults};
use crate::faulty::Faulty;
use crate::felt::Felt;
use crate::mechanism::{Handle, Waypoint};
use crate::port::{FarEnd, MemoryPort};
use crate::transport::{MemoryTransport, PtyTransport, Transport};
use palpate_core::Vec3;
use palpate_host::Device;
use palpate_host::device::hand::HandConfig;
use palpate_host::device::nonblocking_port::NonBlockingPort;
use palpate_host::device::profile::Profile;
use palpate_host::device::workspace::Workspace;
use serialport::{SerialPort, TTYPort};
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// How often the device looks at its line, us: a microframe of USB.
const STEP_US: u64 = 250;
/// Longest time in which a device is to wake up on a pseudo terminal of a busy machine.
pub(super) const WAKE: Duration = Duration::from_secs(20);
/// How long bytes known to be on their way through the terminal of a busy machine are waited for.
const CERTAIN: Duration = Duration::from_secs(20);

/// An emulated device that speaks over a serial line, and how its real driver is opened.
pub trait SerialDevice: Send + 'static {
    /// Name for people.
    const NAME: &'static str;

    /// A device that has just been given power, and a hand that holds it in its middle.
    fn new(profile: &Profile) -> Self;

    /// Name of the bundled profile.
    fn profile() -> &'static str;

    /// What it needs and how exact it is; [`SerialRig`] says whether time is virtual.
    fn traits(profile: &Profile) -> Traits;

    /// Opens the real driver on a port.
    fn open(
        port: Box<dyn SerialPort>,
        profile: &Profile,
        workspace: Workspace,
    ) -> Result<Box<dyn Device>, OpenError>;

    /// Serves everything that has come over the line by `now_us`, and moves on to then.
    fn poll(&mut self, now_us: u64, link: &mut dyn Transport) -> io::Result<()>;

    /// The handle with the hand on it.
    fn handle(&self) -> &Handle;

    /// The handle with the hand on it.
    fn handle_mut(&mut self) -> &mut Handle;

    /// Where its encoders say that the handle is, m.
    fn reported_m(&self) -> Vec3;

    /// The hand holds these buttons.
    fn press(&mut self, buttons: u8);

    /// Something happens to it. False if it cannot happen to this one.
    fn strike(&mut self, mishap: Mishap) -> bool;

    /// Whether its own watchdog has ended the session; never, where it has none.
    fn has_latched(&self) -> bool {
        false
    }
}

/// A steady hand that holds the handle of a profile's mechanism in the middle of its workspace.
pub(super) fn held_in_the_middle(profile: &Profile) -> Handle {
    let drag = super::drag(profile);
    let hand = HandConfig { persistence: 0.0, tremor_m: 0.0, ..HandConfig::default() };
    let middle = Waypoint { t_us: 0, position_m: profile.workspace.device_origin_m };
    Handle::held(hand, drag, vec![middle])
}

/// What carries the bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wire {
    /// Memory, on virtual time.
    Memory,
    /// A pseudo terminal of the kernel; the two sides go in step all the same, so a busy machine changes nothing.
    Pty,
}

/// The device's end of either.
type Line = Faulty<Box<dyn Transport + Send>>;

/// The device with its end of the line.
struct Far<E> {
    device: E,
    /// Nothing while the cable is out.
    line: Option<Line>,
    now_us: u64,
}

impl<E: SerialDevice> FarEnd for Far<E> {
    fn now_us(&self) -> u64 {
        self.now_us
    }

    fn advance(&mut self, until_us: u64) {
        while self.now_us < until_us {
            self.now_us = (self.now_us + STEP_US).min(until_us);
            self.poll();
        }
    }
}

impl<E: SerialDevice> Far<E> {
    fn poll(&mut self) {
        let polled = match &mut self.line {
            Some(line) => self.device.poll(self.now_us, line),
            None => self.device.poll(self.now_us, &mut Given(&[])),
        };
        // A driver that has closed its end of a terminal is a cable pulled.
        if polled.is_err() {
            self.line = None;
        }
    }
}

/// A line on which nothing comes but these bytes, and nothing goes anywhere.
struct Given<'a>(&'a [u8]);

impl Transport for Given<'_> {
    fn receive(&mut self, _now_us: u64, buffer: &mut [u8]) -> io::Result<usize> {
        io::Read::read(&mut self.0, buffer)
    }

    fn send(&mut self, _now_us: u64, _frame: &[u8]) -> io::Result<()> {
        Ok(())
    }
}

/// A device on a serial line.
pub struct SerialRig<E> {
    far: Arc<Mutex<Far<E>>>,
    wire: Wire,
    profile: Profile,
    seed: u64,
    /// Whether the port that was opened last is still there.
    plugged: Arc<AtomicBool>,
    cable_in: bool,
    /// A second handle of the driver's end of a pseudo terminal: to see what has come through.
    driver_end: Option<TTYPort>,
    opened_us: u64,
}

impl<E: SerialDevice> SerialRig<E> {
    /// A device that has just been plugged in.
    ///
    /// # Panics
    ///
    /// If its profile is not among the bundled ones.
    #[must_use]
    pub fn new(wire: Wire, seed: u64) -> Self {
        let profile = Profile::bundled(E::profile()).expect("an emulated device has a bundled profile");
        Self::of(profile, wire, seed)
    }

    /// A device of this profile that has just been plugged in.
    #[must_use]
    pub(super) fn of(profile: Profile, wire: Wire, seed: u64) -> Self {
        Self {
            far: Arc::new(Mutex::new(Far { device: E::new(&profile), line: None, now_us: 0 })),
            wire,
            profile,
            seed,
            plugged: Arc::default(),
            cable_in: true,
            driver_end: None,
            opened_us: 0,
        }
    }

    fn far(&self) -> MutexGuard<'_, Far<E>> {
        self.far.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn connect(&self, transport: Box<dyn Transport + Send>) {
        self.far().line = Some(Faulty::new(transport, Faults::NONE, self.seed));
    }

    /// The terminal hands bytes on late, in real time: done when the driver can read what it got. Anything else would add silence to the line
    /// in virtual time.
    fn advance_terminal(&self, until_us: u64, driver_end: &TTYPort) {
        let delivered = |far: &Far<E>| far.line.as_ref().map_or(0, Line::delivered);
        let mut far = self.far();
        // The driver has read all there was, so what it may read next is what is delivered now.
        let Ok(unread) = driver_end.bytes_to_read() else { return far.advance(until_us) };
        let before = delivered(&far);
        far.advance(until_us);
        let expected = u64::from(unread) + delivered(&far) - before;
        let patience = Instant::now() + CERTAIN;
        while driver_end.bytes_to_read().is_ok_and(|count| u64::from(count) < expected) {
            assert!(Instant::now() < patience, "bytes lost in the terminal");
            std::thread::yield_now();
        }
    }
}

impl<E: SerialDevice> Rig for SerialRig<E> {
    fn name(&self) -> String {
        let wire = match self.wire {
            Wire::Memory => "in memory",
            Wire::Pty => "over a pseudo terminal",
        };
        format!("{} {wire}", E::NAME)
    }

    fn profile(&self) -> &Profile {
        &self.profile
    }

    fn traits(&self) -> Traits {
        Traits { virtual_time: self.wire == Wire::Memory, ..E::traits(&self.profile) }
    }

    fn open(&mut self, workspace: Workspace) -> Result<Box<dyn Device>, OpenError> {
        if !self.cable_in {
            return Err(io::Error::from(io::ErrorKind::NotFound).into());
        }
        self.plugged = Arc::new(AtomicBool::new(true));
        let opened = match self.wire {
            Wire::Memory => {
                let (line, driver) = MemoryTransport::pair();
                self.connect(Box::new(line));
                let far = Arc::clone(&self.far) as Arc<Mutex<dyn FarEnd>>;
                let port = MemoryPort::new(driver, far, Arc::clone(&self.plugged));
                E::open(Box::new(port), &self.profile, workspace)
            }
            Wire::Pty => {
                let (line, driver) = PtyTransport::pair()?;
                self.driver_end = Some(driver.try_clone_native()?);
                let port = Box::new(NonBlockingPort::from_port(driver)?);
                self.connect(Box::new(line));
                let woken = AtomicBool::new(false);
                std::thread::scope(|scope| {
                    scope.spawn(|| {
                        while !woken.load(Ordering::Relaxed) {
                            self.far().poll();
                            std::thread::sleep(Duration::from_micros(200));
                        }
                    });
                    let opened = E::open(port, &self.profile, workspace);
                    woken.store(true, Ordering::Relaxed);
                    opened
                })
            }
        };
        let opened_us = self.far().now_us;
        self.opened_us = opened_us;
        let device = opened?;
        // What opening has sent last has no reader yet.
        self.advance(0);
        Ok(device)
    }

    fn advance(&mut self, now_us: u64) {
        let until_us = self.opened_us + now_us;
        match &self.driver_end {
            Some(driver_end) => self.advance_terminal(until_us, driver_end),
            None => self.far().advance(until_us),
        }
    }

    fn now_us(&self) -> u64 {
        self.far().now_us - self.opened_us
    }

    fn felt(&self) -> Felt {
        self.far().device.handle().felt().on_clock(self.opened_us)
    }

    fn forget(&mut self) {
        self.far().device.handle_mut().forget();
    }

    fn position_m(&self) -> Vec3 {
        self.far().device.handle().position_m()
    }

    fn reported_m(&self) -> Vec3 {
        self.far().device.reported_m()
    }

    fn follow(&mut self, path: Vec<Waypoint>) {
        self.far().device.handle_mut().follow(path);
    }

    fn press(&mut self, buttons: u8) {
        self.far().device.press(buttons);
    }

    fn set_faults(&mut self, to_device: Faults, to_host: Faults) {
        if let Some(line) = &mut self.far().line {
            line.set_faults_each(to_device, to_host);
        }
    }

    fn counts(&self) -> FaultCounts {
        self.far().line.as_ref().map_or_else(FaultCounts::default, Line::counts)
    }

    fn counts_each(&self) -> Option<[FaultCounts; 2]> {
        self.far().line.as_ref().map(Line::counts_each)
    }

    fn heard_us(&self) -> Option<u64> {
        let heard_us = self.far().line.as_ref().and_then(Line::heard_us);
        heard_us.map(|us| us.saturating_sub(self.opened_us))
    }

    fn unplug(&mut self, cut: Cut) {
        self.plugged.store(false, Ordering::Relaxed);
        self.cable_in = false;
        let mut far = self.far();
        let (now_us, mut request) = (far.now_us, [0; 256]);
        if let (Some(mut line), Cut::MidFrame) = (far.line.take(), cut) {
            let count = line.receive(now_us, &mut request).unwrap_or(0);
            // Half of it has come through.
            let half = request.get(..count / 2).unwrap_or_default();
            let _ = far.device.poll(now_us, &mut Given(half));
        }
        drop(far);
        self.driver_end = None;
    }

    fn replug(&mut self) {
        self.cable_in = true;
    }

    fn strike(&mut self, mishap: Mishap) -> bool {
        self.far().device.strike(mishap)
    }
}
