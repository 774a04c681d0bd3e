//! The emulated Falcon as the tests of its driver use it: the grip stands still, replies are there at the next
//! read, and a test may hold replies back, block writes or let them fail.

use palpate_hil::falcon::kinematics::Pose;
use palpate_hil::falcon::memory::Link;
use palpate_hil::falcon::{LoaderFault, LoaderOptions};
use palpate_hil::{EmulatedFalcon, FalconConfig, MemoryFtdi, Waypoint};
use palpate_host::device::falcon::Ftdi;
use palpate_host::device::falcon::kinematics::CENTRE_M;
use palpate_host::device::falcon::packet::Request;
use palpate_host::device::hand::Drag;
use palpate_host::{DeviceError, DeviceErrorKind};
use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant};

/// Longest block of a write: a test that waits for it fails instead of hanging.
pub(crate) const STALL: Duration = Duration::from_secs(20);
/// Time for a request and its reply on the UART, us.
const ROUND_TRIP_US: u64 = 300;

/// What a test sets and inspects.
#[derive(Debug, Default)]
pub(crate) struct Script {
    /// Settings in the order of arrival.
    pub settings: Vec<(u8, u16)>,
    /// All bytes written.
    pub written: Vec<u8>,
    /// Valid requests.
    pub requests: Vec<Request>,
    /// Transfers to the host are held back in `held`.
    pub holds: bool,
    pub held: Vec<Vec<u8>>,
    /// Transfers that the driver reads next.
    ready: VecDeque<Vec<u8>>,
    /// A write blocks until there is room.
    pub stalls: bool,
    /// Number of blocked writes.
    pub stalled: u32,
    /// Number of coming writes that fail.
    pub failing_writes: u32,
}

/// The chip.
#[derive(Debug)]
pub(crate) struct Board {
    chip: MemoryFtdi,
    is_virtual: bool,
    script: Mutex<Script>,
    room: Condvar,
}

impl Board {
    fn of(firmware_runs: bool, fault: Option<(LoaderFault, u32)>, is_virtual: bool) -> Arc<Self> {
        let falcon = EmulatedFalcon::new(FalconConfig {
            // No force of these tests moves it.
            drag: Drag { mass_kg: 1e9, damping_n_s_m: 0.0, coulomb_n: 0.0 },
            path: vec![Waypoint { t_us: 0, position_m: CENTRE_M.map(|metres| metres as f32) }],
            raw_offset: [0; 3],
            loader: LoaderOptions { leading_zero: true, fault },
            firmware_runs,
            ..FalconConfig::default()
        });
        let chip = if is_virtual { MemoryFtdi::new(falcon) } else { MemoryFtdi::in_real_time(falcon) };
        Arc::new(Self { chip, is_virtual, script: Mutex::default(), room: Condvar::new() })
    }

    /// A device in the middle of its workspace, with firmware and not homed.
    pub(crate) fn running() -> Arc<Self> {
        Self::of(true, None, true)
    }

    /// The same in real time, for a driver with threads.
    pub(crate) fn in_real_time() -> Arc<Self> {
        Self::of(true, None, false)
    }

    /// The same without firmware. The loader has this fault in a number of loads.
    pub(crate) fn silent(fault: Option<(LoaderFault, u32)>) -> Arc<Self> {
        Self::of(false, fault, true)
    }

    /// A running device whose loader has a fault.
    pub(crate) fn running_with(fault: LoaderFault) -> Arc<Self> {
        Self::of(true, Some((fault, u32::MAX)), true)
    }

    /// Reads or changes the emulated device.
    pub(crate) fn falcon<R>(&self, act: impl FnOnce(&mut EmulatedFalcon) -> R) -> R {
        act(&mut self.chip.falcon())
    }

    /// Reads or changes the script.
    pub(crate) fn with<R>(&self, act: impl FnOnce(&mut Script) -> R) -> R {
        act(&mut self.script.lock().expect("no test panics within"))
    }

    /// Sets the homed axes, one bit each, like the user of the device.
    pub(crate) fn set_homed(&self, bits: u8) {
        self.falcon(|falcon| falcon.set_homed([0, 1, 2].map(|axis| bits >> axis & 1 != 0)));
    }

    /// Homes the device.
    pub(crate) fn home(&self) {
        self.set_homed(0b111);
    }

    /// Lets an encoder miscount.
    pub(crate) fn jump(&self, axis: usize, counts: i32) {
        self.falcon(|falcon| falcon.jump_encoder(axis, counts));
    }

    /// Lets the encoders report these counts.
    pub(crate) fn set_counts(&self, counts: [i32; 3]) {
        self.falcon(|falcon| {
            let before = falcon.firmware().expect("it runs").reported();
            (0..3).for_each(|axis| falcon.jump_encoder(axis, counts[axis] - before[axis]));
        });
    }

    /// Lets the encoders report this position.
    pub(crate) fn move_hand(&self, position_m: [f64; 3]) {
        let position_m = position_m.map(|metres| metres as f32);
        self.set_counts(Pose::at(position_m).expect("within reach").counts());
    }

    /// Sends bytes to the driver without a request; replies that are held back are lost.
    pub(crate) fn send(&self, bytes: &[u8]) {
        self.take_held();
        self.falcon(|falcon| {
            falcon.send_noise(bytes);
            // A part of a packet waits for the chip's latency timer of 1 ms.
            falcon.advance(falcon.now_us() + 2_000);
        });
        self.release(1);
    }

    /// Takes the first reply that is held back, with its status bytes, and loses the others.
    pub(crate) fn take_held(&self) -> Option<Vec<u8>> {
        self.receive();
        self.with(|script| script.held.drain(..).next())
    }

    fn answer(&self) {
        if self.is_virtual {
            self.falcon(|falcon| falcon.advance(falcon.now_us() + ROUND_TRIP_US));
        }
    }

    /// Holds back the replies to all further requests.
    pub(crate) fn hold(&self) {
        self.receive();
        self.with(|script| {
            script.ready.extend(script.held.drain(..));
            script.holds = true;
        });
    }

    /// Lets the driver read the first replies that are held back; the others are lost.
    pub(crate) fn release(&self, count: usize) {
        self.receive();
        self.with(|script| script.ready.extend(script.held.drain(..).take(count)));
    }

    /// Moves what the chip has received to the held replies.
    fn receive(&self) {
        let mut buffer = [0; 512];
        while let Ok(count) = self.chip.read(&mut buffer, Duration::ZERO) {
            if count > 2 {
                self.with(|script| script.held.push(buffer[..count].to_vec()));
            }
        }
    }

    pub(crate) fn unplug(&self) {
        self.chip.unplug();
    }

    /// Releases the blocked write.
    pub(crate) fn make_room(&self) {
        self.with(|script| script.stalls = false);
        self.room.notify_all();
    }

    /// The last request.
    pub(crate) fn last(&self) -> Request {
        self.with(|script| *script.requests.last().expect("a request"))
    }

    /// Number of requests.
    pub(crate) fn count(&self) -> usize {
        self.with(|script| script.requests.len())
    }

    /// Firmware loads started.
    pub(crate) fn loads(&self) -> u32 {
        self.falcon(|falcon| falcon.loader().loads())
    }
}

/// Waits for an event in real time.
#[track_caller]
pub(crate) fn wait(done: impl Fn() -> bool) {
    let started = Instant::now();
    while !done() {
        assert!(started.elapsed() < STALL, "the event does not happen");
        std::thread::sleep(Duration::from_micros(200));
    }
}

impl Ftdi for Board {
    fn control(&self, request: u8, value: u16) -> Result<(), DeviceError> {
        self.with(|script| script.settings.push((request, value)));
        self.chip.control(request, value)
    }

    fn write(&self, bytes: &[u8], timeout: Duration) -> Result<usize, DeviceError> {
        assert!(!timeout.is_zero(), "libusb takes zero as no timeout");
        let mut script = self.script.lock().expect("no test panics within");
        script.stalled += 1;
        // Block longer than the timeout: the tests do not depend on its length.
        let (mut script, _) = self
            .room
            .wait_timeout_while(script, STALL, |script| script.stalls)
            .expect("no test panics within");
        script.stalled -= 1;
        if script.failing_writes > 0 {
            script.failing_writes -= 1;
            return Err(DeviceError::new(DeviceErrorKind::Timeout));
        }
        script.written.extend(bytes);
        script.requests.extend(<&[u8; 16]>::try_from(bytes).ok().and_then(Request::decode));
        drop(script);
        let sent = self.chip.write(bytes, timeout);
        self.answer();
        sent
    }

    fn read(&self, buffer: &mut [u8], timeout: Duration) -> Result<usize, DeviceError> {
        if let Some(bytes) = self.with(|script| script.ready.pop_front()) {
            buffer[..bytes.len()].copy_from_slice(&bytes);
            return Ok(bytes.len());
        }
        if self.with(|script| script.holds) {
            self.receive();
            return Err(DeviceError::new(DeviceErrorKind::Timeout));
        }
        self.chip.read(buffer, timeout)
    }
}
