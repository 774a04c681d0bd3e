//! A fault during a touch: checks its outcome, that nothing resumes without a reset, and that a reset
//! restores the force.

use super::{Bench, LIFT_TICKS, Opened, Session, TIMEOUT, check};
use crate::Outcome;
use crate::wait_for_reply::{ExchangeCounts, SHORT_TIMEOUT, WaitForReply};
use palpate_core::{Fault, Phase, vec3};
use palpate_hil::bench::{BenchCommand, BenchRun, HOMING_STEP};
use palpate_hil::fault::FaultKind;
use palpate_hil::matrix::Ended;
use palpate_host::DeviceErrorKind;
use palpate_host::device::DeviceState;
use palpate_host::rt::{Controls, VirtualClock};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Ticks with a force after the last sample: the controller holds the force for three.
const ZERO_TICKS: u64 = 3;
/// Ticks for the outcome of a fault, which is injected within 60 requests.
const FAULT_TICKS: u64 = 400;
/// Ticks after a latched fault until the force at the grip is zero as well.
const AFTER_TICKS: u64 = 10;
/// Ticks that arming is checked for.
const ARMED_TICKS: u64 = 20;

/// Duration of the homing motion and a margin. A stopped machine does not finish it sooner, and the rest of
/// the motion would home a board that is opened again.
const HOMING: Duration = Duration::from_millis(1_600);

/// State of the device after a latched fault, from the driver's state and the true one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum DeviceAfterLatch {
    /// Homed, as before.
    Sound,
    /// The board lost its homing, and the driver reports it.
    Unhomed,
    /// The board reports homed, and the driver rejects that.
    Doubted,
    /// The board has no firmware. The driver gets no reply and cannot detect that.
    Silent,
}

impl DeviceAfterLatch {
    const fn of(driver: DeviceState, board_is_homed: bool) -> Self {
        match (driver, board_is_homed) {
            (DeviceState::Homed, true) => Self::Sound,
            (DeviceState::Homed, false) => Self::Silent,
            (_, true) => Self::Doubted,
            (_, false) => Self::Unhomed,
        }
    }
}

impl Bench<'_> {
    /// Injects the fault, checks its outcome, and checks that nothing resumes by itself.
    pub(super) fn run_fault(
        &mut self,
        mut session: Session<'_, '_, Opened>,
        controls: &Controls,
        fault: FaultKind,
        run: &mut BenchRun,
        counts: &Arc<ExchangeCounts>,
    ) -> Outcome<()> {
        let loads = self.line.report()?.loads;
        // A wrong echo happened during the load and costs no reply now.
        counts.injected.store(fault != FaultKind::WrongEcho, Ordering::Relaxed);
        self.command(BenchCommand::Inject)?;
        // The request in flight when homing is lost carries a force.
        self.unhomed_force_allowed = fault == FaultKind::HomingLost;
        self.step_until_end(&mut session, run, counts)?;
        check(run.zero_ticks <= ZERO_TICKS, || {
            format!("a force {} ticks after the last sample", run.zero_ticks)
        })?;
        check(fault.allows_on_bench(run.ended), || format!("{fault} ended as {}", run.ended.name()))?;
        self.log(format_args!("{fault}: {}", run.ended.name()));
        let is_lost = run.ended == Ended::Lost;
        // Dropping a lost device sends zero if the link still works.
        let mut session = if is_lost {
            drop(session);
            None
        } else {
            Some(session)
        };
        let mut report = self.check_limits()?;
        run.injected = report.injected;
        (run.largest_n, run.step_n) = (report.largest_n, report.step_n);
        check(fault == FaultKind::WrongEcho || report.injected > 0, || "no fault was injected".into())?;
        if is_lost && !fault.keeps_power() {
            report = self.check_zero("after the loss of the device")?;
        } else if run.ended != Ended::Recovered && !is_lost {
            report = self.check_zero("after a latched fault")?;
        }
        self.command(BenchCommand::ClearFaults)?;

        if let (Some(latched), true) = (&mut session, run.ended != Ended::Recovered) {
            let state = self.state_after_latch(latched, fault)?;
            self.stays_latched(latched, controls, state)?;
            if matches!(state, DeviceAfterLatch::Doubted | DeviceAfterLatch::Silent) {
                session = None;
                report = self.check_zero("after closing")?;
            }
        }

        // A lost device is opened again while the hand still presses. It must give no force.
        let (clock, fresh) = (VirtualClock::default(), Controls::default());
        let (mut session, controls) = match session {
            Some(session) => (session, controls),
            None => {
                let device = WaitForReply { device: self.open(SHORT_TIMEOUT)?, counts: Arc::clone(counts) };
                let now = self.line.report()?.loads;
                check(now > loads, || "opened without a firmware load: the old homing is kept".into())?;
                let mut session = self.session(device, &clock, &fresh);
                if fault.keeps_power() {
                    // The device has no watchdog: the first request that arrives removes the force.
                    report = self.check_zero("after plugging in")?;
                }
                self.nothing_by_itself(&mut session)?;
                self.homes_again(&mut session, &fresh)?;
                (session, &fresh)
            }
        };
        // A fault from which the loop recovered has no time to zero.
        run.zero_ms = report.zero_ms.filter(|_| run.ended != Ended::Recovered);
        counts.injected.store(false, Ordering::Relaxed);
        self.command(BenchCommand::Lift)?;
        session.ticks(LIFT_TICKS)?;
        run.again_n = self.touch(&mut session, controls)?;
        self.finish(session, controls, run)
    }

    /// Ticks until the fault ends the session, or until its time is over.
    fn step_until_end(
        &self,
        session: &mut Session<'_, '_, Opened>,
        run: &mut BenchRun,
        counts: &ExchangeCounts,
    ) -> Outcome<()> {
        let mut since = None;
        run.ended = Ended::Recovered;
        for tick in 0..FAULT_TICKS {
            match session.step() {
                Err(error) => {
                    run.ended = Ended::Lost;
                    let is_disconnected = error.kind() == DeviceErrorKind::Disconnected;
                    check(is_disconnected, || format!("lost by {error}, not by the cable"))?;
                    return check(counts.disconnected.load(Ordering::Relaxed), || {
                        "lost, but the state is not disconnected".into()
                    });
                }
                Ok(record) => {
                    session.judge(&record)?;
                    // Ticks without a sample until the force is zero.
                    since = if record.sample.is_some() { None } else { since.or(Some(tick)) };
                    let age = since.map_or(0, |since| tick - since);
                    if record.hand_force_n != vec3::ZERO {
                        run.zero_ticks = run.zero_ticks.max(age);
                    }
                    if let Phase::SafeZero(fault) = record.phase {
                        run.ended = Ended::Latched(fault);
                        return session.ticks(AFTER_TICKS).map(drop);
                    }
                }
            }
        }
        Ok(())
    }

    /// Determines the state after a latched fault, and checks that the fault may leave it.
    fn state_after_latch(
        &mut self,
        session: &mut Session<'_, '_, Opened>,
        fault: FaultKind,
    ) -> Outcome<DeviceAfterLatch> {
        let device = session.ticks(AFTER_TICKS)?.last().map_or(DeviceState::Disconnected, |it| it.device);
        let state = DeviceAfterLatch::of(device, self.line.report()?.homed);
        let is_allowed = match fault {
            FaultKind::HomingLost => state == DeviceAfterLatch::Unhomed,
            FaultKind::EncoderJump => state == DeviceAfterLatch::Doubted,
            FaultKind::PowerCycle => state == DeviceAfterLatch::Silent,
            // Three corrupted positions in a row look like an encoder jump.
            FaultKind::CorruptReply | FaultKind::RandomMix => {
                matches!(state, DeviceAfterLatch::Sound | DeviceAfterLatch::Doubted)
            }
            _ => state == DeviceAfterLatch::Sound,
        };
        check(is_allowed, || format!("{fault} led to {state:?}")).map(|()| state)
    }

    /// Checks that a latched fault stays, and that the device gives no force before the fault is corrected.
    fn stays_latched(
        &mut self,
        session: &mut Session<'_, '_, Opened>,
        controls: &Controls,
        state: DeviceAfterLatch,
    ) -> Outcome<()> {
        self.command(BenchCommand::ResetRecord)?;
        self.unhomed_force_allowed = false;
        // The hand moves only while the device is driven, and a board without firmware is not. It presses
        // after the next load.
        if state != DeviceAfterLatch::Silent {
            self.lifts_and_presses(session)?;
        }
        let record = session.tick()?;
        check(matches!(record.phase, Phase::SafeZero(_)), || format!("{:?}, not latched", record.phase))?;
        controls.arm();
        let armed = session.ticks(ARMED_TICKS)?;
        let is_latched = armed.iter().all(|record| matches!(record.phase, Phase::SafeZero(_)));
        check(is_latched, || "arming cleared a latched fault".into())?;
        self.check_no_force("with a latched fault")?;
        match state {
            DeviceAfterLatch::Sound => Ok(()),
            DeviceAfterLatch::Unhomed => self.homes_again(session, controls),
            DeviceAfterLatch::Doubted => {
                self.does_not_arm(session, controls)?;
                // The hand moves through the homing motion. The board is homed already, so its report does
                // not change, and the driver rejects it.
                self.command(BenchCommand::Home)?;
                let mut moved = Duration::ZERO;
                while moved < HOMING {
                    let start = Instant::now();
                    let device = session.tick()?.device;
                    check(device == DeviceState::Unhomed, || format!("{device:?} after an encoder jump"))?;
                    moved += start.elapsed().min(HOMING_STEP);
                }
                self.does_not_arm(session, controls)
            }
            DeviceAfterLatch::Silent => {
                controls.reset();
                session.ticks(2)?;
                controls.arm();
                // The driver still reports homed, so the loop arms. It renders nothing without a sample, and
                // latches again.
                let phase = session.ticks(ARMED_TICKS)?.last().map(|record| record.phase);
                check(phase == Some(Phase::SafeZero(Fault::Stale)), || format!("{phase:?} without replies"))?;
                self.check_no_force("without replies")
            }
        }
    }

    /// Lifts and presses: a controller that had armed itself would render the surface on the way.
    fn lifts_and_presses(&mut self, session: &mut Session<'_, '_, Opened>) -> Outcome<()> {
        for stroke in [BenchCommand::Lift, BenchCommand::Press] {
            self.command(stroke)?;
            let records = session.ticks(LIFT_TICKS)?;
            let is_active = records.iter().any(|record| record.phase == Phase::Active);
            check(!is_active, || "the loop armed itself".into())?;
        }
        self.check_no_force("without arming")
    }

    /// Checks that a device that is opened again counts as not homed and gives no force.
    fn nothing_by_itself(&mut self, session: &mut Session<'_, '_, Opened>) -> Outcome<()> {
        self.command(BenchCommand::ResetRecord)?;
        self.unhomed_force_allowed = false;
        self.lifts_and_presses(session)?;
        let device = session.tick()?.device;
        check(device == DeviceState::Unhomed, || format!("{device:?}, expected Unhomed"))
    }

    /// Checks that a device that is not homed cannot be armed.
    fn does_not_arm(&mut self, session: &mut Session<'_, '_, Opened>, controls: &Controls) -> Outcome<()> {
        controls.reset();
        session.ticks(2)?;
        controls.arm();
        let armed = session.ticks(ARMED_TICKS)?;
        let is_disarmed = armed.iter().all(|record| record.phase == Phase::Disarmed);
        check(is_disarmed, || "armed without homing".into())?;
        self.check_no_force("without homing")
    }

    /// Homes the device again; neither arming before nor homing gives a force.
    fn homes_again(&mut self, session: &mut Session<'_, '_, Opened>, controls: &Controls) -> Outcome<()> {
        self.does_not_arm(session, controls)?;
        self.command(BenchCommand::Home)?;
        let until = Instant::now() + TIMEOUT;
        while session.tick()?.device != DeviceState::Homed {
            check(Instant::now() < until, || "homing timed out".into())?;
        }
        session.ticks(ARMED_TICKS)?;
        self.check_no_force("without arming after homing")?;
        self.log("homed again");
        Ok(())
    }
}
