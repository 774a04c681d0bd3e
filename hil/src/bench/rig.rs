//! The emulated Falcon of one run, its hand, and its fault.

use super::command::{BenchCommand, Reply, Report};
use super::jump::Jump;
use crate::falcon::descriptors::PACKET_LEN;
use crate::falcon::firmware::is_whole;
use crate::falcon::memory::Link;
use crate::falcon::{
    EmulatedFalcon, FalconConfig, FaultyFtdi, LoaderFault, LoaderOptions, MemoryFtdi, Setup, Stall,
    homing_path,
};
use crate::fault::{FaultKind, Faults};
use crate::mechanism::Waypoint;
use crate::usbredir::UsbDevice;
use palpate_core::vec3;
use palpate_host::device::falcon::Ftdi;
use std::time::Duration;

/// The hand moves by this time for each command, because the guest's clock is not real time: one tick of the
/// driver's loop.
const HAND_STEP: Duration = Duration::from_millis(1);
/// The same during homing, where no force and no tick matters, so that homing takes less time.
pub const HOMING_STEP: Duration = Duration::from_millis(3);
/// How long the cable is out, us: long enough for the guest to detect it.
const UNPLUGGED_US: u64 = 400_000;
/// Bytes of a request that reach the board before the cable is pulled.
const CUT_AFTER_BYTES: usize = 7;
/// Time for these bytes to cross the UART.
const CUT_WAIT: Duration = Duration::from_micros(200);
/// Index of the firmware byte that a faulty loader echoes wrong.
const WRONG_ECHO_AT: usize = 300;
/// Position of the hand above the organ, and its target without resistance when it presses, m.
const ABOVE_M: f32 = 0.120;
const BELOW_M: f32 = 0.103;
/// Time between the two, us.
const STROKE_US: u64 = 200_000;

/// A device, a hand and a fault.
#[derive(Debug)]
pub struct Rig {
    link: FaultyFtdi<MemoryFtdi>,
    seed: u64,
    fault: Option<FaultKind>,
    /// Requests left before the injection.
    countdown: Option<u64>,
    injected: u64,
    /// The fault is being injected, or was.
    is_active: bool,
    /// Start of the time to zero force: the injection of a single fault, or on the UART the first faulty
    /// frame since the last whole reply.
    fault_us: Option<u64>,
    /// Faulty frames counted so far.
    seen: u64,
    stall_in: bool,
    replug_us: Option<u64>,
}

impl Rig {
    /// The device of a run, in real time. Its cable is out at first.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        let fault = FaultKind::of_seed(seed);
        let loader_fault = (fault == Some(FaultKind::WrongEcho))
            .then_some((LoaderFault::WrongEcho { at: WRONG_ECHO_AT }, 1));
        let loader = LoaderOptions { leading_zero: seed % 2 == 1, fault: loader_fault };
        let mut falcon = EmulatedFalcon::new(FalconConfig { loader, ..FalconConfig::default() });
        falcon.freeze_without_commands(HOMING_STEP);
        falcon.unplug();
        Self {
            link: FaultyFtdi::new(MemoryFtdi::in_real_time(falcon), seed),
            seed,
            fault,
            countdown: None,
            injected: 0,
            is_active: false,
            fault_us: None,
            seen: 0,
            stall_in: false,
            replug_us: Some(UNPLUGGED_US),
        }
    }

    /// A device whose cable stays out until a command plugs it in. A guest that misses a cable pulled during
    /// its start needs half a minute to find the device.
    #[must_use]
    pub fn unplugged() -> Self {
        Self { replug_us: None, ..Self::new(0) }
    }

    /// Whether the cable is in.
    #[must_use]
    pub fn is_plugged(&self) -> bool {
        self.link.inner().falcon().is_plugged()
    }

    /// Plugs the cable in when it is due.
    pub fn poll(&mut self) {
        if self.replug_us.is_some_and(|due_us| due_us <= self.link.now_us()) {
            self.replug_us = None;
            self.link.replug();
            self.link.reopen().expect("the cable is in");
        }
    }

    /// Executes a command.
    pub fn execute(&mut self, command: BenchCommand) -> Reply {
        match command {
            BenchCommand::Plug { seed } => *self = Self::new(seed),
            BenchCommand::Home => self.moves(homing_path(), HOMING_STEP),
            BenchCommand::Press => self.stroke(BELOW_M),
            BenchCommand::Lift => self.stroke(ABOVE_M),
            // Without a device fault the host process is the one at fault, from now on.
            BenchCommand::Inject if self.fault.is_none() => self.fault_us = Some(self.link.now_us()),
            BenchCommand::Inject => self.countdown = Some(FaultKind::delay_requests(self.seed)),
            BenchCommand::ClearFaults => {
                self.countdown = None;
                self.link.set_faults(Faults::NONE, Faults::NONE);
            }
            BenchCommand::ResetRecord => self.link.inner().falcon().reset_record(),
            BenchCommand::Report => return Reply::Report(self.report()),
            BenchCommand::End => {}
        }
        Reply::Ok
    }

    /// Moves from the present position of the grip, so that its path is continuous.
    fn stroke(&self, to_m: f32) {
        let from = Waypoint { t_us: 0, position_m: self.link.inner().falcon().position_m() };
        self.moves(vec![from, Waypoint { t_us: STROKE_US, position_m: [0.0, 0.0, to_m] }], HAND_STEP);
    }

    fn moves(&self, path: Vec<Waypoint>, each_command: Duration) {
        let mut falcon = self.link.inner().falcon();
        falcon.freeze_without_commands(each_command);
        falcon.follow(path);
    }

    /// The true state of the device and the hand.
    #[must_use]
    pub fn report(&self) -> Report {
        let falcon = self.link.inner().falcon();
        let felt = falcon.force_record();
        let zero_us =
            self.fault_us.zip(felt.off_since_us).map(|(injected, off)| off.saturating_sub(injected));
        Report {
            plugged: falcon.is_plugged(),
            homed: falcon.is_homed(),
            loads: falcon.loader().loads(),
            requests: falcon.firmware().map_or(0, |firmware| firmware.requests()),
            force_n: vec3::norm(felt.force_n),
            push_n: felt.force_n[2],
            largest_n: felt.largest_force_n,
            step_n: felt.largest_step_n,
            unhomed_n: felt.largest_unhomed_n,
            injected: self.injected + self.wire_fault_count(),
            zero_ms: zero_us.map(|us| us as f32 * 1e-3),
        }
    }

    /// Number of faulty frames and stalls on the UART.
    fn wire_fault_count(&self) -> u64 {
        let (to_device, to_host) = self.link.counts();
        (to_device + to_host).total()
    }

    /// Updates the start of the time to zero force after a transfer, which may have carried a whole reply.
    /// While some frames pass, the first faulty frame is not the one after which the motors stay off.
    fn update_fault_time(&mut self, is_whole: bool) {
        let off = self.link.inner().falcon().force_record().off_since_us.is_some();
        if !self.fault.is_some_and(FaultKind::affects_wire) || off {
            return;
        }
        if is_whole {
            self.fault_us = None;
        }
        let injected = self.wire_fault_count();
        if injected > core::mem::replace(&mut self.seen, injected) {
            self.fault_us.get_or_insert_with(|| self.link.now_us());
        }
    }

    /// Injects a due fault into a request. Returns the outcome of the transfer if the fault decides it.
    fn inject_into(&mut self, bytes: &[u8]) -> Option<Result<usize, Stall>> {
        let remaining = self.countdown.as_mut()?;
        if *remaining > 0 {
            *remaining -= 1;
            return None;
        }
        self.countdown = None;
        let fault = self.fault?;
        self.is_active = true;
        if fault.affects_wire() {
            // The link counts the faults on the UART.
            let (to_device, to_host) = fault.wire_faults();
            self.link.set_faults(to_device, to_host);
            return None;
        }
        self.fault_us = Some(self.link.now_us());
        self.injected += 1;
        match fault {
            FaultKind::DropRequest => return Some(Ok(bytes.len())),
            FaultKind::StallOut => return Some(Err(Stall)),
            FaultKind::StallIn => self.stall_in = true,
            FaultKind::HomingLost => self.link.inner().falcon().lose_homing(),
            FaultKind::PowerCycle => self.link.inner().falcon().power_cycle(),
            FaultKind::EncoderJump => {
                let mut falcon = self.link.inner().falcon();
                let jump = Jump::of(self.seed, falcon.counts()).expect("one sign is within reach");
                falcon.jump_encoder(jump.axis, jump.counts);
            }
            FaultKind::UnplugMidFrame | FaultKind::Replug | FaultKind::UnplugPower => {
                if fault != FaultKind::Replug {
                    self.link.inner().falcon().bulk_out(&bytes[..bytes.len().min(CUT_AFTER_BYTES)]);
                }
                // The bytes already on the UART arrive.
                std::thread::sleep(CUT_WAIT);
                self.replug_us = Some(self.link.now_us() + UNPLUGGED_US);
                self.link.unplug();
                if fault == FaultKind::UnplugPower {
                    self.link.inner().falcon().power_cycle();
                }
                return Some(Ok(0));
            }
            _ => {}
        }
        None
    }
}

impl UsbDevice for Rig {
    fn control(&mut self, setup: Setup, data: &[u8]) -> Result<Vec<u8>, Stall> {
        // Requests of the chip pass through the faulty link, because a purge also discards what that holds.
        if setup == Setup::vendor(setup.request, setup.value) {
            let set = self.link.control(setup.request, setup.value);
            return set.map(|()| Vec::new()).map_err(|_| Stall);
        }
        self.link.inner().falcon().control(setup, data)
    }

    fn bulk_out(&mut self, bytes: &[u8]) -> Result<usize, Stall> {
        if !self.is_plugged() {
            // The transfer is lost until the guest detects the unplugging.
            return Ok(0);
        }
        if let Some(outcome) = self.inject_into(bytes) {
            return outcome;
        }
        if self.is_active {
            // A fault acts on the whole frame, whether the chip has room for it or not.
            let written = self.link.write(bytes, Duration::ZERO).map_err(|_| Stall);
            self.update_fault_time(false);
            return written;
        }
        Ok(self.link.inner().falcon().bulk_out(bytes))
    }

    fn bulk_in(&mut self, max: usize) -> Result<Option<Vec<u8>>, Stall> {
        if !self.is_plugged() {
            return Ok(None);
        }
        if core::mem::take(&mut self.stall_in) {
            return Err(Stall);
        }
        let mut buffer = vec![0; max];
        debug_assert!(max >= PACKET_LEN);
        let read = self.link.read(&mut buffer, Duration::ZERO);
        if self.fault == Some(FaultKind::DropReply) && self.link.counts().1.dropped > 0 {
            // One lost reply is enough.
            self.link.set_faults(Faults::NONE, Faults::NONE);
        }
        match read {
            Ok(count) => {
                buffer.truncate(count);
                self.update_fault_time(is_whole(&buffer));
                Ok(Some(buffer))
            }
            Err(error) if error.kind().is_transient() => Ok(None),
            Err(_) => Err(Stall),
        }
    }
}
