//! A device on a serial line, in memory or over a pseudo terminal: all parts but the device itself.

use super::{OpenError, Rig, Traits};
use crate::fault::{FaultCounts, FaultKind, Faults};
use crate::faulty::Faulty;
use crate::force_record::ForceRecord;
use crate::mechanism::{Handle, Waypoint};
use crate::port::{FarEnd, MemoryPort};
use crate::transport::{MemoryTransport, PtyTransport, Transport};
use palpate_core::Vec3;
use palpate_host::Device;
use palpate_host::device::hand::HandConfig;
use palpate_host::device::nonblocking_port::NonBlockingPort;
use palpate_host::device::nonblocking_port::Port;
use palpate_host::device::profile::Profile;
use palpate_host::device::workspace::Workspace;
use serialport::{SerialPort, TTYPort};
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Poll period of the device, us: two microframes of USB.
const STEP_US: u64 = 250;
/// Longest wake-up time of a device on a pseudo terminal of a busy machine.
pub(super) const WAKE_TIMEOUT: Duration = Duration::from_secs(20);
/// Longest wait for bytes in flight in a pseudo terminal of a busy machine.
const MAX_WAIT: Duration = Duration::from_secs(20);

/// An emulated device on a serial line, and how to open its real driver.
pub trait SerialDevice: Send + 'static {
    /// Name for display.
    const NAME: &'static str;

    /// A device that is powered up now, held in the middle of its workspace.
    fn new(profile: &Profile) -> Self;

    /// Name of the bundled profile.
    fn profile() -> &'static str;

    /// Properties of the device; [`SerialRig`] sets whether time is virtual.
    fn traits(profile: &Profile) -> Traits;

    /// Opens the real driver on a port.
    fn open(
        port: Box<dyn Port>,
        profile: &Profile,
        workspace: Workspace,
    ) -> Result<Box<dyn Device>, OpenError>;

    /// Serves all input up to `now_us` and advances to it.
    fn poll(&mut self, now_us: u64, link: &mut dyn Transport) -> io::Result<()>;

    /// The handle with the hand on it.
    fn handle(&self) -> &Handle;

    /// The handle with the hand on it.
    fn handle_mut(&mut self) -> &mut Handle;

    /// Position reported by the encoders, m.
    fn reported_m(&self) -> Vec3;

    /// Presses these buttons.
    fn press(&mut self, buttons: u8);

    /// Lets the encoder of an axis miscount by about `by_m` at the handle.
    fn jump(&mut self, axis: usize, by_m: f32);

    /// Loses its power for a moment.
    fn power_cycle(&mut self);

    /// Loses its homing. Returns false if it has none.
    fn lose_homing(&mut self) -> bool;

    /// Whether its own watchdog has latched; always false without one.
    fn has_latched(&self) -> bool {
        false
    }
}

/// The handle of the profile's mechanism, held without tremor in the middle of the workspace.
pub(super) fn held_in_the_middle(profile: &Profile) -> Handle {
    let drag = super::drag(profile);
    let hand = HandConfig { persistence: 0.0, tremor_m: 0.0, ..HandConfig::default() };
    let middle = Waypoint { t_us: 0, position_m: profile.workspace.device_origin_m };
    Handle::held(hand, drag, vec![middle])
}

/// Transport of the bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wire {
    /// Memory, on virtual time.
    Memory,
    /// A pseudo terminal. Both sides run in lockstep, so the load of the machine has no effect.
    Pty,
}

/// The device's end of the transport.
type Line = Faulty<Box<dyn Transport + Send>>;

/// The device and its end of the line.
struct DeviceSide<E> {
    device: E,
    /// `None` while the cable is out.
    line: Option<Line>,
    now_us: u64,
}

impl<E: SerialDevice> FarEnd for DeviceSide<E> {
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

impl<E: SerialDevice> DeviceSide<E> {
    fn poll(&mut self) {
        let polled = match &mut self.line {
            Some(line) => self.device.poll(self.now_us, line),
            None => self.device.poll(self.now_us, &mut FixedInput(&[])),
        };
        // A driver that closes its end of the terminal counts as a pulled cable.
        if polled.is_err() {
            self.line = None;
        }
    }
}

/// A line with a fixed input, which discards all output.
struct FixedInput<'a>(&'a [u8]);

impl Transport for FixedInput<'_> {
    fn receive(&mut self, _now_us: u64, buffer: &mut [u8]) -> io::Result<usize> {
        io::Read::read(&mut self.0, buffer)
    }

    fn send(&mut self, _now_us: u64, _frame: &[u8]) -> io::Result<()> {
        Ok(())
    }
}

/// A device on a serial line.
pub struct SerialRig<E> {
    far: Arc<Mutex<DeviceSide<E>>>,
    wire: Wire,
    profile: Profile,
    seed: u64,
    /// Whether the latest port is still plugged in.
    plugged: Arc<AtomicBool>,
    cable_in: bool,
    /// A second handle of the driver's end of the pseudo terminal, to count the received bytes.
    driver_end: Option<TTYPort>,
    /// A second handle of the driver's end in memory, for the guard's message.
    past_driver: Option<MemoryPort>,
    opened_us: u64,
}

impl<E: SerialDevice> SerialRig<E> {
    /// A device that was just plugged in.
    ///
    /// # Panics
    ///
    /// If its profile is not bundled.
    #[must_use]
    pub fn new(wire: Wire, seed: u64) -> Self {
        let profile = Profile::bundled(E::profile()).expect("an emulated device has a bundled profile");
        Self::of(profile, wire, seed)
    }

    /// A device with this profile that was just plugged in.
    #[must_use]
    pub(super) fn of(profile: Profile, wire: Wire, seed: u64) -> Self {
        Self {
            far: Arc::new(Mutex::new(DeviceSide { device: E::new(&profile), line: None, now_us: 0 })),
            wire,
            profile,
            seed,
            plugged: Arc::default(),
            cable_in: true,
            driver_end: None,
            past_driver: None,
            opened_us: 0,
        }
    }

    fn far(&self) -> MutexGuard<'_, DeviceSide<E>> {
        self.far.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn connect(&self, transport: Box<dyn Transport + Send>) {
        self.far().line = Some(Faulty::new(transport, Faults::NONE, self.seed));
    }

    /// Advances until the driver can read all delivered bytes. A terminal forwards bytes late, in real time,
    /// which would add silence to the line in virtual time.
    fn advance_terminal(&self, until_us: u64, driver_end: &TTYPort) {
        let delivered = |far: &DeviceSide<E>| far.line.as_ref().map_or(0, Line::delivered);
        let mut far = self.far();
        // The driver has read all earlier bytes, so it reads next what is delivered now.
        let Ok(unread) = driver_end.bytes_to_read() else { return far.advance(until_us) };
        let before = delivered(&far);
        far.advance(until_us);
        let expected = u64::from(unread) + delivered(&far) - before;
        let deadline = Instant::now() + MAX_WAIT;
        while driver_end.bytes_to_read().is_ok_and(|count| u64::from(count) < expected) {
            assert!(Instant::now() < deadline, "bytes lost in the terminal");
            std::thread::yield_now();
        }
    }

    fn unplug(&mut self, is_mid_frame: bool) {
        self.plugged.store(false, Ordering::Relaxed);
        self.cable_in = false;
        let mut far = self.far();
        let (now_us, mut request) = (far.now_us, [0; 256]);
        if let (Some(mut line), true) = (far.line.take(), is_mid_frame) {
            let count = line.receive(now_us, &mut request).unwrap_or(0);
            // Half of the request arrives.
            let half = request.get(..count / 2).unwrap_or_default();
            let _ = far.device.poll(now_us, &mut FixedInput(half));
        }
        drop(far);
        self.driver_end = None;
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
                self.past_driver = Some(port.clone());
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
        // The last bytes sent during opening have not been read yet.
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

    fn force_record(&self) -> ForceRecord {
        self.far().device.handle().force_record().on_clock(self.opened_us)
    }

    fn reset_record(&mut self) {
        self.far().device.handle_mut().reset_record();
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

    fn last_received_us(&self) -> Option<u64> {
        let last_received_us = self.far().line.as_ref().and_then(Line::last_received_us);
        last_received_us.map(|us| us.saturating_sub(self.opened_us))
    }

    fn replug(&mut self) {
        self.cable_in = true;
    }

    fn write_past_driver(&mut self, message: &[u8]) -> Result<(), OpenError> {
        let port = self.past_driver.as_mut().ok_or("the device was not opened")?;
        Ok(io::Write::write_all(port, message)?)
    }

    fn inject(&mut self, fault: FaultKind) -> bool {
        match fault {
            FaultKind::UnplugMidFrame | FaultKind::Replug => self.unplug(fault == FaultKind::UnplugMidFrame),
            FaultKind::HomingLost => return self.far().device.lose_homing(),
            FaultKind::PowerCycle => self.far().device.power_cycle(),
            _ => return false,
        }
        true
    }

    fn jump_encoder(&mut self, axis: usize, by_m: f32) {
        self.far().device.jump(axis, by_m);
    }
}
