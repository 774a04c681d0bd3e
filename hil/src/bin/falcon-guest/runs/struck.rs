//! A fault in the middle of a touch: what came of it, that nothing goes on by itself, and how it goes on when it is asked for.

use super::{Bench, End, LIFT_TICKS, Opened, PATIENCE, Run, Session, check};
use crate::Outcome;
use crate::waiting::{IMPATIENT, Tally, Waiting};
use palpate_core::{Fault, Phase, vec3};
use palpate_hil::bench::{HOMING_MOVES, Order, Strike};
use palpate_host::DeviceErrorKind;
use palpate_host::device::DeviceState;
use palpate_host::rt::{Controls, VirtualClock};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Ticks with a force after the last sample: the controller holds it for three.
const ZERO_TICKS: u64 = 3;
/// Ticks in which a fault shows what comes of it: it strikes within 60 requests.
const STRUCK_TICKS: u64 = 400;
/// Ticks after a latched fault, for the force to be gone at the grip too.
const AFTER_TICKS: u64 = 10;
/// Ticks in which nothing may come of being armed.
const ARMED_TICKS: u64 = 20;

/// All that the hand does when it homes, and a little more: on a machine that stands still it is not done sooner, and what is left of it would home a board
/// that is opened anew.
const HOMING: Duration = Duration::from_millis(1_600);

/// What a latched fault has left, by what the driver says of the device and what is true.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Left {
    /// Homed, as it was.
    Sound,
    /// The board has forgotten its homing, and the driver knows.
    Unhomed,
    /// The board says that it is homed, and the driver does not believe it.
    Doubted,
    /// The board runs no firmware any more. A driver that hears nothing cannot know.
    Silent,
}

impl Left {
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
    /// The fault, what came of it, and that nothing goes on by itself.
    pub(super) fn struck(
        &mut self,
        mut session: Session<'_, '_, Opened>,
        controls: &Controls,
        fault: Strike,
        run: &mut Run,
        tally: &Arc<Tally>,
    ) -> Outcome<()> {
        let loads = self.line.report()?.loads;
        // A wrong echo was long ago, and takes no reply away.
        tally.struck.store(fault != Strike::WrongEcho, Ordering::Relaxed);
        self.order(Order::Strike)?;
        // The request that is on its way when homing is lost has a force, and cannot know.
        self.unhomed_passes = fault == Strike::Homing;
        self.strikes(&mut session, run, tally)?;
        check(run.zero_ticks <= ZERO_TICKS, || {
            format!("a force {} ticks after the last sample", run.zero_ticks)
        })?;
        check(as_expected(fault, run.end), || format!("{} ended in {}", fault.name(), run.end))?;
        self.say(format_args!("{}: {}", fault.name(), run.end));
        let is_lost = matches!(run.end, End::Lost(_));
        // Whoever loses a device lets go of it: that sends zero if there is still a way.
        let mut session = if is_lost {
            drop(session);
            None
        } else {
            Some(session)
        };
        let mut report = self.safe()?;
        run.struck = report.struck;
        (run.largest_n, run.step_n) = (report.largest_n, report.step_n);
        check(fault == Strike::WrongEcho || report.struck > 0, || "the fault did not strike".into())?;
        if is_lost && !fault.is_pulled() {
            report = self.off("after the device was lost")?;
        } else if run.end != End::Active && !is_lost {
            report = self.off("after a fault was latched")?;
        }
        self.order(Order::Calm)?;

        if let (Some(kept), true) = (&mut session, run.end != End::Active) {
            let left = self.left(kept, fault)?;
            self.latched(kept, controls, left)?;
            if matches!(left, Left::Doubted | Left::Silent) {
                session = None;
                report = self.off("after it was closed")?;
            }
        }

        // The device is up again where it was lost, and the hand still presses: nothing may come of it.
        let (clock, fresh) = (VirtualClock::default(), Controls::default());
        let (mut session, controls) = match session {
            Some(session) => (session, controls),
            None => {
                let device = Waiting { device: self.open(IMPATIENT)?, tally: Arc::clone(tally) };
                let now = self.line.report()?.loads;
                check(now > loads, || "opened again without new firmware: its homing is of before".into())?;
                let mut session = self.session(device, &clock, &fresh);
                if fault.is_pulled() {
                    // Without a watchdog in the device it is the first request that gets through which takes the force away.
                    report = self.off("after the cable was in again")?;
                }
                self.nothing_by_itself(&mut session)?;
                self.homed_again(&mut session, &fresh)?;
                (session, &fresh)
            }
        };
        // What was ridden out led to no zero, whatever has taken the force away since.
        run.zero_ms = report.zero_ms.filter(|_| run.end != End::Active);
        tally.struck.store(false, Ordering::Relaxed);
        self.order(Order::Lift)?;
        session.ticks(LIFT_TICKS)?;
        run.again_n = self.touch(&mut session, controls)?;
        self.done(session, controls, run)
    }

    /// Ticks until the fault has ended the session, or has had its time.
    fn strikes(&self, session: &mut Session<'_, '_, Opened>, run: &mut Run, tally: &Tally) -> Outcome<()> {
        let mut since = None;
        run.end = End::Active;
        for tick in 0..STRUCK_TICKS {
            match session.step() {
                Err(error) => {
                    run.end = End::Lost(error.kind());
                    return check(tally.gone.load(Ordering::Relaxed), || {
                        "it is lost, and does not say disconnected".into()
                    });
                }
                Ok(record) => {
                    session.judge(&record)?;
                    // Ticks without a sample until the force is gone.
                    since = if record.sample.is_some() { None } else { since.or(Some(tick)) };
                    let age = since.map_or(0, |since| tick - since);
                    if record.hand_force_n != vec3::ZERO {
                        run.zero_ticks = run.zero_ticks.max(age);
                    }
                    if let Phase::SafeZero(fault) = record.phase {
                        run.end = End::Latched(fault);
                        return session.ticks(AFTER_TICKS).map(drop);
                    }
                }
            }
        }
        Ok(())
    }

    /// What a latched fault has left of the device; the fault must be one that may.
    fn left(&mut self, session: &mut Session<'_, '_, Opened>, fault: Strike) -> Outcome<Left> {
        let device = session.ticks(AFTER_TICKS)?.last().map_or(DeviceState::Disconnected, |it| it.device);
        let left = Left::of(device, self.line.report()?.homed);
        let may = match fault {
            Strike::Homing => left == Left::Unhomed,
            Strike::EncoderJump => left == Left::Doubted,
            Strike::PowerCycle => left == Left::Silent,
            // Three damaged positions in a row cannot be told from an encoder that has miscounted.
            Strike::CorruptReply | Strike::Noise => matches!(left, Left::Sound | Left::Doubted),
            _ => left == Left::Sound,
        };
        check(may, || format!("{} left it {left:?}", fault.name())).map(|()| left)
    }

    /// A latched fault stays, and what it has left of the device gives no force before it is made good.
    fn latched(
        &mut self,
        session: &mut Session<'_, '_, Opened>,
        controls: &Controls,
        left: Left,
    ) -> Outcome<()> {
        self.order(Order::Forget)?;
        self.unhomed_passes = false;
        // A hand goes on only while the device is driven, and one without firmware is not: it presses anew once there is some again.
        if left != Left::Silent {
            self.presses_anew(session)?;
        }
        let record = session.tick()?;
        check(matches!(record.phase, Phase::SafeZero(_)), || format!("{:?}, not latched", record.phase))?;
        controls.arm();
        let armed = session.ticks(ARMED_TICKS)?;
        let is_latched = armed.iter().all(|record| matches!(record.phase, Phase::SafeZero(_)));
        check(is_latched, || "a latched fault can be armed away".into())?;
        self.nothing("though the fault was latched")?;
        match left {
            Left::Sound => Ok(()),
            Left::Unhomed => self.homed_again(session, controls),
            Left::Doubted => {
                self.does_not_arm(session, controls)?;
                // The hand homes it. The board, homed already, has nothing new to say, and what it says is not believed.
                self.order(Order::Home)?;
                let mut moved = Duration::ZERO;
                while moved < HOMING {
                    let begun = Instant::now();
                    let device = session.tick()?.device;
                    check(device == DeviceState::Unhomed, || format!("{device:?} after a miscount"))?;
                    moved += begun.elapsed().min(HOMING_MOVES);
                }
                self.does_not_arm(session, controls)
            }
            Left::Silent => {
                controls.reset();
                session.ticks(2)?;
                controls.arm();
                // It arms, because nobody has heard otherwise, renders nothing without a sample, and is latched again.
                let phase = session.ticks(ARMED_TICKS)?.last().map(|record| record.phase);
                check(phase == Some(Phase::SafeZero(Fault::Stale)), || format!("{phase:?} in silence"))?;
                self.nothing("though it says nothing")
            }
        }
    }

    /// Out of the organ and in again: a controller that had armed itself would feel the surface on the way.
    fn presses_anew(&mut self, session: &mut Session<'_, '_, Opened>) -> Outcome<()> {
        for stroke in [Order::Lift, Order::Press] {
            self.order(stroke)?;
            let records = session.ticks(LIFT_TICKS)?;
            let is_active = records.iter().any(|record| record.phase == Phase::Active);
            check(!is_active, || "it has armed itself".into())?;
        }
        self.nothing("though nobody has armed it")
    }

    /// A device that was opened anew counts for not homed, whatever it has kept, and does nothing.
    fn nothing_by_itself(&mut self, session: &mut Session<'_, '_, Opened>) -> Outcome<()> {
        self.order(Order::Forget)?;
        self.unhomed_passes = false;
        self.presses_anew(session)?;
        let device = session.tick()?.device;
        check(device == DeviceState::Unhomed, || format!("{device:?}, not unhomed"))
    }

    /// What is not homed is not armed.
    fn does_not_arm(&mut self, session: &mut Session<'_, '_, Opened>, controls: &Controls) -> Outcome<()> {
        controls.reset();
        session.ticks(2)?;
        controls.arm();
        let armed = session.ticks(ARMED_TICKS)?;
        let is_disarmed = armed.iter().all(|record| record.phase == Phase::Disarmed);
        check(is_disarmed, || "it arms though it is not homed any more".into())?;
        self.nothing("though it is not homed any more")
    }

    /// Neither being armed gives an unhomed device a force, nor being homed again.
    fn homed_again(&mut self, session: &mut Session<'_, '_, Opened>, controls: &Controls) -> Outcome<()> {
        self.does_not_arm(session, controls)?;
        self.order(Order::Home)?;
        let until = Instant::now() + PATIENCE;
        while session.tick()?.device != DeviceState::Homed {
            check(Instant::now() < until, || "it was not homed again in time".into())?;
        }
        session.ticks(ARMED_TICKS)?;
        self.nothing("though nobody has armed it since it was homed again")?;
        self.say("homed again");
        Ok(())
    }
}

/// What a fault may end in.
fn as_expected(fault: Strike, end: End) -> bool {
    match fault {
        Strike::WrongEcho | Strike::DropRequest | Strike::DropReply => end == End::Active,
        Strike::UnplugMidFrame | Strike::Replug | Strike::UnplugPower => {
            end == End::Lost(DeviceErrorKind::Disconnected)
        }
        Strike::Silence | Strike::PowerCycle => end == End::Latched(Fault::Stale),
        Strike::Homing | Strike::EncoderJump => end == End::Latched(Fault::NotReady),
        // A bit that flips may be that of an axis that is homed.
        Strike::CorruptReply | Strike::Noise => {
            matches!(end, End::Active | End::Latched(Fault::Stale | Fault::NotReady))
        }
        // Whether too much is lost in a row depends on the time. A halted pipe is cleared by the driver.
        Strike::Babble
        | Strike::Delay
        | Strike::Stall
        | Strike::Duplicate
        | Strike::Truncate
        | Strike::Reorder
        | Strike::StallIn
        | Strike::StallOut => {
            matches!(end, End::Active | End::Latched(Fault::Stale))
        }
    }
}
