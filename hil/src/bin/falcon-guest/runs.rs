//! One run of a device: open, home, arm, touch, inject the fault, reach zero force, and render again only
//! after a reset and arming.

mod faulted;

use crate::Outcome;
use crate::line::Line;
use crate::timeout_ftdi::TimeoutFtdi;
use crate::wait_for_reply::{ExchangeCounts, SHORT_TIMEOUT, WaitForReply};
use core::fmt;
use palpate_core::{Controller, Method, Organ, Phase, vec3};
use palpate_hil::bench::{BenchCommand, BenchRun, Report};
use palpate_hil::fault::FaultKind;
use palpate_host::device::DeviceState;
use palpate_host::device::falcon::{Falcon, FalconConfig, FalconError, Image, UsbFtdi};
use palpate_host::device::profile::Profile;
use palpate_host::device::workspace::Workspace;
use palpate_host::rt::{Clock, Controls, HapticLoop, LoopConfig, Outputs, TickRecord, VirtualClock};
use palpate_host::settings::controller_config;
use palpate_host::{Device, DeviceError};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Number of words of the synthetic firmware.
const FIRMWARE_WORDS: u16 = 500;
/// Force limit, N; the device's own limit is 8 N.
const MAX_FORCE_N: f32 = 4.0;
/// Rounding error of the motors' whole counts and of f32, N.
const ROUNDING_N: f32 = 0.05;
/// Least force that counts as touch, N.
const TOUCH_N: f32 = 0.3;
/// Ticks within which the hand must reach the organ, with a tenfold margin for the speed of the machine.
const TOUCH_TICKS: u64 = 20_000;
/// Longest time until a plugged device is found, and until it is homed.
const TIMEOUT: Duration = Duration::from_secs(60);
/// Write timeout where no transfer may be lost. With a fault it is as short as that of a reply.
const LONG_WRITE_TIMEOUT: Duration = Duration::from_secs(2);
/// Ticks until the hand is above the organ again.
const LIFT_TICKS: u64 = 250;
/// Surface of the organ on the axis into it, device frame.
const SURFACE_M: [f32; 3] = [0.0, 0.0, 0.115];

/// The driver as the loop uses it.
type Opened = WaitForReply<Falcon<TimeoutFtdi>>;

/// Copies the counts of the exchanges.
fn count(run: &mut BenchRun, counts: &ExchangeCounts) {
    run.exchanges = counts.answered.load(Ordering::Relaxed);
    run.lost = counts.lost.load(Ordering::Relaxed);
    run.mean_us = counts.total_us.load(Ordering::Relaxed) / run.exchanges.max(1);
    run.longest_us = counts.longest_us.load(Ordering::Relaxed);
}

fn check(is: bool, what: impl FnOnce() -> String) -> Outcome<()> {
    if is { Ok(()) } else { Err(what()) }
}

/// The loop on its virtual clock.
struct Session<'l, 'o, D: Device> {
    haptic: HapticLoop<'l, 'o, 'o, D, &'l VirtualClock>,
    clock: &'l VirtualClock,
    records: rtrb::Consumer<TickRecord>,
    index: u64,
    before_n: [f32; 3],
}

impl<D: Device> Session<'_, '_, D> {
    fn step(&mut self) -> Result<TickRecord, DeviceError> {
        self.index += 1;
        let deadline_ns = self.index * 1_000_000;
        self.clock.wait_until(deadline_ns, 0);
        self.haptic.tick(self.index, 0, deadline_ns)?;
        Ok(self.records.pop().expect("one record per tick"))
    }

    /// One tick. The device must not be lost, and the force must be valid.
    fn tick(&mut self) -> Outcome<TickRecord> {
        let record = self.step().map_err(|error| format!("the device is lost: {error}"))?;
        self.judge(&record)?;
        Ok(record)
    }

    /// Checks that the force is finite, within the force and slew limits, and zero unless active and homed.
    fn judge(&mut self, record: &TickRecord) -> Outcome<()> {
        let force_n = record.hand_force_n;
        let step_n = vec3::distance(force_n, self.before_n);
        self.before_n = force_n;
        check(vec3::is_finite(force_n) && vec3::norm(force_n) <= MAX_FORCE_N, || format!("{force_n:?} N"))?;
        check(force_n == vec3::ZERO || step_n <= 2.001, || format!("a step of {step_n} N in one tick"))?;
        let is_allowed = record.phase == Phase::Active && record.device == DeviceState::Homed;
        check(is_allowed || force_n == vec3::ZERO, || {
            format!("{force_n:?} N while {:?}, {:?}", record.phase, record.device)
        })
    }

    fn ticks(&mut self, count: u64) -> Outcome<Vec<TickRecord>> {
        (0..count).map(|_| self.tick()).collect()
    }
}

/// State of all runs.
pub(crate) struct Bench<'o> {
    organ: &'o Organ<'o>,
    line: Line,
    start: Instant,
    /// The record may hold a force from before homing was lost.
    unhomed_force_allowed: bool,
}

impl<'o> Bench<'o> {
    pub(crate) const fn new(organ: &'o Organ<'o>, line: Line, start: Instant) -> Self {
        Self { organ, line, start, unhomed_force_allowed: false }
    }

    pub(crate) fn command(&mut self, command: BenchCommand) -> Outcome<()> {
        self.line.command(command)
    }

    fn log(&self, step: impl fmt::Display) {
        println!("[{:8.3}] {step}", self.start.elapsed().as_secs_f64());
    }

    fn config(&self) -> FalconConfig {
        // Device z is the outward normal of the first active node. The device's origin lies on the surface
        // there.
        let space = &self.organ.spaces[0];
        let normal = space.active.outward_normal;
        let first = vec3::normalize_or_zero(vec3::cross([0.3, 0.9, 0.1], normal));
        let second = vec3::cross(normal, first);
        let workspace = Workspace {
            axes: [0, 1, 2].map(|i: usize| [first[i], second[i], normal[i]]),
            device_origin_m: SURFACE_M,
            model_origin_m: space.active.rest_position_m,
            ..Workspace::default()
        };
        FalconConfig { workspace, ..FalconConfig::default() }
    }

    /// Opens the driver on a freshly plugged device, with this write timeout.
    fn open(&self, write: Duration) -> Outcome<Falcon<TimeoutFtdi>> {
        let image = Image::synthetic(FIRMWARE_WORDS);
        let until = Instant::now() + TIMEOUT;
        let open = || {
            let chip = UsbFtdi::open().map_err(FalconError::Usb)?;
            Falcon::start(Arc::new(TimeoutFtdi::new(chip, write)), self.config(), Some(&image))
        };
        loop {
            match open() {
                Ok(falcon) => return Ok(falcon),
                Err(error) if Instant::now() >= until => return Err(format!("opening failed: {error}")),
                Err(error) => self.log(format_args!("retrying: {error}")),
            }
        }
    }

    fn home(&mut self, falcon: &mut Falcon<TimeoutFtdi>) -> Outcome<()> {
        let stop = Arc::new(AtomicBool::new(false));
        let alarm = Arc::clone(&stop);
        std::thread::spawn(move || {
            std::thread::sleep(TIMEOUT);
            alarm.store(true, Ordering::Relaxed);
        });
        match falcon.home(&stop) {
            Ok(true) => {
                let homed = self.line.report()?.homed;
                check(homed, || "the driver reports homed, the device does not".into())?;
                // Ends the homing motion; the hand waits above the organ.
                self.command(BenchCommand::Lift)
            }
            Ok(false) => Err("homing timed out".into()),
            Err(error) => Err(format!("lost during homing: {error}")),
        }
    }

    fn session<'l, D: Device>(
        &self,
        device: D,
        clock: &'l VirtualClock,
        controls: &'l Controls,
    ) -> Session<'l, 'o, D> {
        let falcon = Profile::bundled("falcon").expect("bundled");
        let workspace = self.config().workspace;
        let profile = Profile { max_force_n: MAX_FORCE_N, workspace, ..falcon };
        let config = controller_config(&[self.organ], Method::Hybrid, &device.info(), Some(&profile));
        let controller = Controller::new(self.organ, config).expect("the golden blob contains the method");
        let (producer, records) = rtrb::RingBuffer::new(64);
        let (latest, _) = triple_buffer::triple_buffer(&TickRecord::EMPTY);
        let outputs = Outputs { records: producer, latest };
        let haptic = HapticLoop::new(controller, device, clock, LoopConfig::default(), controls, outputs);
        Session { haptic, clock, records, index: 0, before_n: vec3::ZERO }
    }

    /// Checks the limits that the force on the hand must never exceed.
    fn check_limits(&mut self) -> Outcome<Report> {
        let report = self.line.report()?;
        check(report.unhomed_n == 0.0 || self.unhomed_force_allowed, || {
            format!("{} N before homing", report.unhomed_n)
        })?;
        let limit_n = MAX_FORCE_N + ROUNDING_N;
        check(report.largest_n <= limit_n, || format!("{} N at the grip", report.largest_n))?;
        Ok(report)
    }

    fn check_zero(&mut self, when: &str) -> Outcome<Report> {
        let report = self.check_limits()?;
        check(report.force_n == 0.0, || format!("{} N at the grip {when}", report.force_n))?;
        Ok(report)
    }

    /// Checks that no force was recorded since the last reset of the record.
    fn check_no_force(&mut self, when: &str) -> Outcome<()> {
        let report = self.check_zero(when)?;
        check(report.largest_n == 0.0, || format!("{} N at the grip {when}", report.largest_n))
    }

    /// Arms above the organ; the hand presses until controller and hand record a force.
    fn touch<D: Device>(&mut self, session: &mut Session<'_, '_, D>, controls: &Controls) -> Outcome<f32> {
        controls.reset();
        controls.arm();
        let armed = session.ticks(2)?;
        check(armed.last().is_some_and(|record| record.phase == Phase::Active), || "arming failed".into())?;
        self.command(BenchCommand::Press)?;
        for _ in 0..TOUCH_TICKS / 100 {
            let records = session.ticks(100)?;
            let phase = records.last().map_or(Phase::Disarmed, |record| record.phase);
            check(phase == Phase::Active, || format!("{phase:?} during the press"))?;
            let felt = records.iter().any(|record| vec3::norm(record.hand_force_n) > TOUCH_N);
            let report = self.check_limits()?;
            if felt && report.push_n > TOUCH_N {
                return Ok(report.push_n);
            }
            check(report.push_n > -TOUCH_N, || format!("the organ pulls: {} N", report.push_n))?;
        }
        Err("no contact force at the organ".into())
    }

    /// One complete run.
    pub(crate) fn run(&mut self, seed: u64, exchanges: u64) -> Outcome<BenchRun> {
        let fault = FaultKind::of_seed(seed);
        self.log(format_args!(
            "seed {seed}, fault {}",
            fault.map_or("none".into(), |fault| fault.to_string())
        ));
        self.command(BenchCommand::Plug { seed })?;
        let plugged = Instant::now();
        self.unhomed_force_allowed = false;
        let falcon = self.open(if fault.is_some() { SHORT_TIMEOUT } else { LONG_WRITE_TIMEOUT })?;
        let mut run =
            BenchRun { seed, fault, ready_ms: plugged.elapsed().as_millis() as u64, ..BenchRun::default() };
        let loads = self.line.report()?.loads;
        // On a busy machine a late echo makes the driver send the firmware again. A wrong echo always does.
        let min_loads = if fault == Some(FaultKind::WrongEcho) { 2 } else { 1 };
        check(loads >= min_loads, || format!("{loads} firmware loads, expected at least {min_loads}"))?;
        run.loads = loads;
        self.log(format_args!("open after {} ms, firmware sent {loads} times", run.ready_ms));

        let counts = Arc::new(ExchangeCounts::default());
        let mut device = WaitForReply { device: falcon, counts: Arc::clone(&counts) };
        self.no_force_before_homing(&mut device)?;
        self.home(&mut device.device)?;
        self.log("homed");
        let (clock, controls) = (VirtualClock::default(), Controls::default());
        let mut session = self.session(device, &clock, &controls);
        let records = session.ticks(LIFT_TICKS)?;
        let is_disarmed = records.iter().all(|record| record.phase == Phase::Disarmed);
        check(is_disarmed, || "the loop armed itself".into())?;
        self.check_no_force("before arming")?;
        run.touch_n = self.touch(&mut session, &controls)?;
        self.log(format_args!("armed and in touch, {:.2} N", run.touch_n));

        match fault {
            None => {
                self.touch_repeatedly(&mut session, &counts, exchanges)?;
                count(&mut run, &counts);
                check(run.lost == 0, || format!("{} exchanges lost", run.lost))?;
                self.finish(session, &controls, &mut run)?;
                run.lost_closing = counts.lost.load(Ordering::Relaxed) - run.lost;
            }
            Some(fault) => {
                self.run_fault(session, &controls, fault, &mut run, &counts)?;
                count(&mut run, &counts);
            }
        }
        run.seconds = plugged.elapsed().as_secs_f32();
        Ok(run)
    }

    /// Checks that arming gives no force before the device is homed.
    fn no_force_before_homing(&mut self, device: &mut Opened) -> Outcome<()> {
        let (clock, controls) = (VirtualClock::default(), Controls::default());
        let mut session = self.session(device, &clock, &controls);
        for _ in 0..20 {
            controls.arm();
            let record = session.tick()?;
            check(record.device != DeviceState::Homed, || "homed is reported before homing".into())?;
            check(record.phase == Phase::Disarmed, || "armed before homing".into())?;
        }
        drop(session);
        self.check_no_force("before homing")
    }

    /// Moves in and out of the organ until `exchanges` exchanges are done.
    fn touch_repeatedly(
        &mut self,
        session: &mut Session<'_, '_, Opened>,
        counts: &ExchangeCounts,
        exchanges: u64,
    ) -> Outcome<()> {
        let mut next = BenchCommand::Lift;
        while counts.answered.load(Ordering::Relaxed) < exchanges {
            self.command(next)?;
            next = if next == BenchCommand::Lift { BenchCommand::Press } else { BenchCommand::Lift };
            session.ticks(1_000)?;
            self.check_limits()?;
        }
        Ok(())
    }

    /// Disarms, then closes the device: zero force after both.
    fn finish<D: Device>(
        &mut self,
        mut session: Session<'_, '_, D>,
        controls: &Controls,
        run: &mut BenchRun,
    ) -> Outcome<()> {
        controls.disarm();
        session.ticks(5)?;
        self.check_zero("after disarming")?;
        // Touches once more, so that closing has a force to remove.
        self.command(BenchCommand::Lift)?;
        session.ticks(LIFT_TICKS)?;
        self.touch(&mut session, controls)?;
        drop(session);
        let report = self.check_zero("after closing")?;
        run.largest_n = run.largest_n.max(report.largest_n);
        run.step_n = run.step_n.max(report.step_n);
        run.unhomed_n = run.unhomed_n.max(report.unhomed_n);
        self.log("disarmed, closed: no force");
        Ok(())
    }
}
