//! One run of a device: up, homed, armed, in touch, struck, safe, and up again only when it is asked for.

mod struck;

use crate::Outcome;
use crate::line::Line;
use crate::patient::Patient;
use crate::waiting::{IMPATIENT, Tally, Waiting};
use core::fmt;
use palpate_core::{Config, Controller, Fault, LimitConfig, Method, Organ, Phase, vec3};
use palpate_hil::bench::{Order, Report, Strike};
use palpate_host::device::DeviceState;
use palpate_host::device::falcon::{Falcon, FalconConfig, FalconError, Image, UsbFtdi};
use palpate_host::device::workspace::Workspace;
use palpate_host::rt::{Clock, Controls, HapticLoop, LoopConfig, Outputs, TickRecord, VirtualClock};
use palpate_host::{Device, DeviceError, DeviceErrorKind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Words of the firmware, which is none.
const FIRMWARE_WORDS: u16 = 500;
/// Limit of the force, N; the device's own is 8.
const MAX_FORCE_N: f32 = 4.0;
/// What the motors' whole counts and f32 add to it, N.
const ROUNDING_N: f32 = 0.05;
/// A touch, N.
const TOUCH_N: f32 = 0.3;
/// Ticks in which the hand must have reached the organ, with room for a machine ten times as fast as ours.
const TOUCH_TICKS: u64 = 20_000;
/// For a device that was plugged in to be there, and to be homed.
const PATIENCE: Duration = Duration::from_secs(60);
/// For a write where nothing is to be lost; where something is it is as long as for a reply.
const PATIENT_WRITE: Duration = Duration::from_secs(2);
/// Ticks in which the hand is above the organ again.
const LIFT_TICKS: u64 = 250;
/// Surface of the organ, and axis into it, in the device's frame.
const SURFACE_M: [f32; 3] = [0.0, 0.0, 0.115];

/// How a fault ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum End {
    /// There was none, or it passed.
    Active,
    /// The controller latched it.
    Latched(Fault),
    /// The device is gone.
    Lost(DeviceErrorKind),
}

impl fmt::Display for End {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Active => f.write_str("active"),
            Self::Latched(fault) => write!(f, "latched:{}", fault.name()),
            Self::Lost(kind) => write!(f, "lost:{kind:?}"),
        }
    }
}

/// The driver as the loop has it.
type Opened = Waiting<Falcon<Patient>>;

/// What a run has shown.
#[derive(Debug, Clone)]
pub(crate) struct Run {
    pub fault: Option<Strike>,
    pub end: End,
    /// Exchanges with a sample, and those without; in a run without a fault those that were checked, in touch.
    pub exchanges: u64,
    pub lost: u64,
    /// Without a sample after that, while it was disarmed and closed: a zero that goes out at once may cost the reply to a request before it.
    pub lost_closing: u64,
    pub mean_us: u64,
    pub longest_us: u64,
    pub struck: u64,
    pub touch_n: f32,
    pub largest_n: f32,
    pub step_n: f32,
    pub unhomed_n: f32,
    /// Ticks from the first one without a sample to a command of zero.
    pub zero_ticks: u64,
    pub zero_ms: Option<f32>,
    pub again_n: f32,
    pub ready: Duration,
    pub loads: u32,
    pub seconds: f32,
}

impl Run {
    const NOTHING: Self = Self {
        fault: None,
        end: End::Active,
        exchanges: 0,
        lost: 0,
        lost_closing: 0,
        mean_us: 0,
        longest_us: 0,
        struck: 0,
        touch_n: 0.0,
        largest_n: 0.0,
        step_n: 0.0,
        unhomed_n: 0.0,
        zero_ticks: 0,
        zero_ms: None,
        again_n: 0.0,
        ready: Duration::ZERO,
        loads: 0,
        seconds: 0.0,
    };

    /// What the exchanges have come to.
    fn count(&mut self, tally: &Tally) {
        self.exchanges = tally.answered.load(Ordering::Relaxed);
        self.lost = tally.lost.load(Ordering::Relaxed);
        self.mean_us = tally.spent_us.load(Ordering::Relaxed) / self.exchanges.max(1);
        self.longest_us = tally.longest_us.load(Ordering::Relaxed);
    }

    /// Exchanges a second.
    pub(crate) fn rate_hz(&self) -> f64 {
        1e6 / self.mean_us.max(1) as f64
    }
}

impl fmt::Display for Run {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { fault, end, exchanges, lost, lost_closing, mean_us, longest_us, struck, ready, .. } = self;
        let fault = fault.map_or("none", Strike::name);
        write!(
            f,
            "fault={fault} end={end} struck={struck} ready_ms={} loads={} ",
            ready.as_millis(),
            self.loads
        )?;
        write!(
            f,
            "exchanges={exchanges} lost={lost} lost_closing={lost_closing} mean_us={mean_us} longest_us={longest_us} "
        )?;
        write!(
            f,
            "touch_n={:.2} largest_n={:.2} step_n={:.2} unhomed_n={:.2} ",
            self.touch_n, self.largest_n, self.step_n, self.unhomed_n
        )?;
        match self.zero_ms {
            Some(zero_ms) => write!(f, "zero_ms={zero_ms:.0} ")?,
            None => f.write_str("zero_ms=- ")?,
        }
        write!(f, "zero_ticks={} again_n={:.2} seconds={:.1}", self.zero_ticks, self.again_n, self.seconds)
    }
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
        Ok(self.records.pop().expect("one record a tick"))
    }

    /// A tick that must not end the session, and whose force must be right.
    fn tick(&mut self) -> Outcome<TickRecord> {
        let record = self.step().map_err(|error| format!("the device is lost: {error}"))?;
        self.judge(&record)?;
        Ok(record)
    }

    /// Finite, within the limit, no step beyond the slew limit, zero unless active and homed.
    fn judge(&mut self, record: &TickRecord) -> Outcome<()> {
        let force_n = record.hand_force_n;
        let step_n = vec3::distance(force_n, self.before_n);
        self.before_n = force_n;
        check(vec3::is_finite(force_n) && vec3::norm(force_n) <= MAX_FORCE_N, || format!("{force_n:?} N"))?;
        check(force_n == vec3::ZERO || step_n <= 2.001, || format!("a step of {step_n} N in a tick"))?;
        let may = record.phase == Phase::Active && record.device == DeviceState::Homed;
        check(may || force_n == vec3::ZERO, || {
            format!("{force_n:?} N while {:?}, {:?}", record.phase, record.device)
        })
    }

    fn ticks(&mut self, count: u64) -> Outcome<Vec<TickRecord>> {
        (0..count).map(|_| self.tick()).collect()
    }
}

/// What all runs share.
pub(crate) struct Bench<'o> {
    organ: &'o Organ<'o>,
    line: Line,
    begun: Instant,
    /// The record may hold a force from a moment at which homing was lost.
    unhomed_passes: bool,
}

impl<'o> Bench<'o> {
    pub(crate) const fn new(organ: &'o Organ<'o>, line: Line, begun: Instant) -> Self {
        Self { organ, line, begun, unhomed_passes: false }
    }

    pub(crate) fn order(&mut self, order: Order) -> Outcome<()> {
        self.line.order(order)
    }

    fn say(&self, step: impl fmt::Display) {
        println!("[{:8.3}] {step}", self.begun.elapsed().as_secs_f64());
    }

    fn config(&self) -> FalconConfig {
        // Device z is the outward normal of the first active node, and the device's origin lies on the surface there.
        let space = &self.organ.spaces[0];
        let normal = space.outward_normal;
        let first = vec3::normalize_or_zero(vec3::cross([0.3, 0.9, 0.1], normal));
        let second = vec3::cross(normal, first);
        let workspace = Workspace {
            axes: [0, 1, 2].map(|i: usize| [first[i], second[i], normal[i]]),
            device_origin_m: SURFACE_M,
            model_origin_m: space.rest_position_m,
            ..Workspace::default()
        };
        FalconConfig { workspace, ..FalconConfig::default() }
    }

    /// From a cable that was just put in to a driver that speaks with the firmware, and whose writes may take so long.
    fn open(&self, write: Duration) -> Outcome<Falcon<Patient>> {
        let image = Image::synthetic(FIRMWARE_WORDS);
        let until = Instant::now() + PATIENCE;
        let open = || {
            let chip = UsbFtdi::open().map_err(FalconError::Usb)?;
            Falcon::start(Arc::new(Patient::new(chip, write, Duration::MAX)), self.config(), Some(&image))
        };
        loop {
            match open() {
                Ok(falcon) => return Ok(falcon),
                Err(error) if Instant::now() >= until => return Err(format!("it cannot be opened: {error}")),
                Err(error) => self.say(format_args!("not yet: {error}")),
            }
        }
    }

    fn home(&mut self, falcon: &mut Falcon<Patient>) -> Outcome<()> {
        let stop = Arc::new(AtomicBool::new(false));
        let alarm = Arc::clone(&stop);
        std::thread::spawn(move || {
            std::thread::sleep(PATIENCE);
            alarm.store(true, Ordering::Relaxed);
        });
        match falcon.home(&stop) {
            Ok(true) => {
                let homed = self.line.report()?.homed;
                check(homed, || "the driver says homed, the device does not".into())?;
                // Enough of what the hand does when it homes: it is to wait above the organ.
                self.order(Order::Lift)
            }
            Ok(false) => Err("it was not homed in time".into()),
            Err(error) => Err(format!("lost while it was homed: {error}")),
        }
    }

    fn session<'l, D: Device>(
        &self,
        device: D,
        clock: &'l VirtualClock,
        controls: &'l Controls,
    ) -> Session<'l, 'o, D> {
        let limits = LimitConfig { max_force_n: MAX_FORCE_N, ..LimitConfig::default() };
        let config = Config { limits, ..Config::new(Method::Hybrid) };
        let controller = Controller::new(self.organ, config).expect("the golden blob has the method");
        let (producer, records) = rtrb::RingBuffer::new(64);
        let (latest, _) = triple_buffer::triple_buffer(&TickRecord::EMPTY);
        let outputs = Outputs { records: producer, latest };
        let haptic = HapticLoop::new(controller, device, clock, LoopConfig::default(), controls, outputs);
        Session { haptic, clock, records, index: 0, before_n: vec3::ZERO }
    }

    /// What the hand must never have felt.
    fn safe(&mut self) -> Outcome<Report> {
        let report = self.line.report()?;
        check(report.unhomed_n == 0.0 || self.unhomed_passes, || {
            format!("{} N before it was homed", report.unhomed_n)
        })?;
        let limit_n = MAX_FORCE_N + ROUNDING_N;
        check(report.largest_n <= limit_n, || format!("{} N at the grip", report.largest_n))?;
        Ok(report)
    }

    fn off(&mut self, when: &str) -> Outcome<Report> {
        let report = self.safe()?;
        check(report.force_n == 0.0, || format!("{} N at the grip {when}", report.force_n))?;
        Ok(report)
    }

    /// Not a newton since the record was begun anew.
    fn nothing(&mut self, when: &str) -> Outcome<()> {
        let report = self.off(when)?;
        check(report.largest_n == 0.0, || format!("{} N at the grip {when}", report.largest_n))
    }

    /// Armed above the organ; the hand presses until both feel it.
    fn touch<D: Device>(&mut self, session: &mut Session<'_, '_, D>, controls: &Controls) -> Outcome<f32> {
        controls.reset();
        controls.arm();
        let armed = session.ticks(2)?;
        check(armed.last().is_some_and(|record| record.phase == Phase::Active), || "it does not arm".into())?;
        self.order(Order::Press)?;
        for _ in 0..TOUCH_TICKS / 100 {
            let records = session.ticks(100)?;
            let phase = records.last().map_or(Phase::Disarmed, |record| record.phase);
            check(phase == Phase::Active, || format!("{phase:?} while it was pressed"))?;
            let felt = records.iter().any(|record| vec3::norm(record.hand_force_n) > TOUCH_N);
            let report = self.safe()?;
            if felt && report.push_n > TOUCH_N {
                return Ok(report.push_n);
            }
            check(report.push_n > -TOUCH_N, || format!("the organ pulls: {} N", report.push_n))?;
        }
        Err("nothing was felt where the organ is".into())
    }

    /// The whole of a run.
    pub(crate) fn run(&mut self, seed: u64, exchanges: u64) -> Outcome<Run> {
        let fault = Strike::of(seed);
        self.say(format_args!("seed {seed}, fault {}", fault.map_or("none", Strike::name)));
        self.order(Order::Plug { seed })?;
        let plugged = Instant::now();
        self.unhomed_passes = false;
        let falcon = self.open(if fault.is_some() { IMPATIENT } else { PATIENT_WRITE })?;
        let mut run = Run { fault, ready: plugged.elapsed(), ..Run::NOTHING };
        let loads = self.line.report()?.loads;
        // A machine so busy that an echo comes late makes the driver send it once more; a wrong echo always.
        let least = if fault == Some(Strike::WrongEcho) { 2 } else { 1 };
        check(loads >= least, || format!("{loads} loads of firmware, not {least} at least"))?;
        run.loads = loads;
        self.say(format_args!("open after {} ms, firmware sent {loads} times", run.ready.as_millis()));

        let tally = Arc::new(Tally::default());
        let mut device = Waiting { device: falcon, tally: Arc::clone(&tally) };
        self.not_before_homing(&mut device)?;
        self.home(&mut device.device)?;
        self.say("homed");
        let (clock, controls) = (VirtualClock::default(), Controls::default());
        let mut session = self.session(device, &clock, &controls);
        let records = session.ticks(LIFT_TICKS)?;
        let is_disarmed = records.iter().all(|record| record.phase == Phase::Disarmed);
        check(is_disarmed, || "it has armed itself".into())?;
        self.nothing("before it was armed")?;
        run.touch_n = self.touch(&mut session, &controls)?;
        self.say(format_args!("armed and in touch, {:.2} N", run.touch_n));

        match fault {
            None => {
                self.long(&mut session, &tally, exchanges)?;
                run.count(&tally);
                check(run.lost == 0, || format!("{} exchanges lost", run.lost))?;
                self.done(session, &controls, &mut run)?;
                run.lost_closing = tally.lost.load(Ordering::Relaxed) - run.lost;
            }
            Some(fault) => {
                self.struck(session, &controls, fault, &mut run, &tally)?;
                run.count(&tally);
            }
        }
        run.seconds = plugged.elapsed().as_secs_f32();
        Ok(run)
    }

    /// Neither arming nor anything else gives a force before the device is homed.
    fn not_before_homing(&mut self, device: &mut Opened) -> Outcome<()> {
        let (clock, controls) = (VirtualClock::default(), Controls::default());
        let mut session = self.session(device, &clock, &controls);
        for _ in 0..20 {
            controls.arm();
            let record = session.tick()?;
            check(record.device != DeviceState::Homed, || "it says homed before it is".into())?;
            check(record.phase == Phase::Disarmed, || "it arms before it is homed".into())?;
        }
        drop(session);
        self.nothing("before it was homed")
    }

    /// In and out of the organ, until so many exchanges are done.
    fn long(&mut self, session: &mut Session<'_, '_, Opened>, tally: &Tally, exchanges: u64) -> Outcome<()> {
        let mut next = Order::Lift;
        while tally.answered.load(Ordering::Relaxed) < exchanges {
            self.order(next)?;
            next = if next == Order::Lift { Order::Press } else { Order::Lift };
            session.ticks(1_000)?;
            self.safe()?;
        }
        Ok(())
    }

    /// Disarmed, and then closed: no force after either.
    fn done<D: Device>(
        &mut self,
        mut session: Session<'_, '_, D>,
        controls: &Controls,
        run: &mut Run,
    ) -> Outcome<()> {
        controls.disarm();
        session.ticks(5)?;
        self.off("after it was disarmed")?;
        // Once more with a force, so that the end has something to take away.
        self.order(Order::Lift)?;
        session.ticks(LIFT_TICKS)?;
        self.touch(&mut session, controls)?;
        drop(session);
        let report = self.off("after the end")?;
        run.largest_n = run.largest_n.max(report.largest_n);
        run.step_n = run.step_n.max(report.step_n);
        run.unhomed_n = run.unhomed_n.max(report.unhomed_n);
        self.say("disarmed, closed: no force");
        Ok(())
    }
}
