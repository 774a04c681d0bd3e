//! Contract checks of the driver with loop and controller, on an organ.

use super::{Violation, error_kind, hold_force, new_rig, permuted};
use crate::fault::FaultKind;
use crate::fault::Faults;
use crate::rig::{Rig, RigKind};
use crate::session::{self, Bench, Session};
use palpate_core::{Fault, Method, Organ, Phase, vec3};
use palpate_host::DeviceErrorKind;
use palpate_host::device::DeviceState;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Arms the loop and presses into the organ until the organ pushes the hand back.
fn press_in(bench: &mut Bench<'_, '_>) -> Result<(), Violation> {
    let path = session::press(bench.rig, 0.006, 0.014);
    bench.rig.follow(path);
    bench.controls.arm();
    let records = bench.run(800)?;
    let last = records.last().map(|record| record.phase);
    ensure!(last == Some(Phase::Active), "{last:?} after 0.8 s of a fault-free link");
    let felt = bench.rig.force_record();
    let out_n = felt.force_n[2];
    ensure!(out_n > 0.3, "the organ does not push the hand out: {:?} N", felt.force_n);
    Ok(())
}

fn on_golden<T>(
    rig: &mut dyn Rig,
    test: impl FnOnce(&mut Bench<'_, '_>) -> Result<T, Violation>,
) -> Result<T, Violation> {
    let blob = session::golden_organ();
    let organ: Organ<'_> = Organ::read(blob.bytes()).map_err(|error| Violation(error.to_string()))?;
    session::with_loop(rig, &organ, Method::Energy, test)?
}

pub(super) fn nothing_before_arming(kind: RigKind) -> Result<(), Violation> {
    let (mut rig, _) = new_rig(kind);
    on_golden(&mut *rig, |bench| {
        let path = session::press(bench.rig, 0.006, 0.014);
        bench.rig.follow(path.clone());
        let records = bench.run(800)?;
        ensure!(records.iter().all(|record| record.phase == Phase::Disarmed), "the loop armed itself");
        let felt = bench.rig.force_record();
        ensure!(felt.largest_motor == 0 && felt.largest_force_n == 0.0, "{felt:?} without arming");
        // Armed below the surface, the controller renders nothing until the hand crosses the surface.
        bench.controls.arm();
        bench.run(50)?;
        ensure!(
            bench.rig.force_record().largest_force_n == 0.0,
            "{:?} at the moment of arming",
            bench.rig.force_record()
        );
        bench.rig.follow(path);
        bench.run(800)?;
        ensure!(
            bench.rig.force_record().force_n[2] > 0.3,
            "{:?} N, armed and pressed",
            bench.rig.force_record().force_n
        );
        Ok(())
    })
}

pub(super) fn zero_after_the_loop(kind: RigKind) -> Result<(), Violation> {
    for case in 0..3 {
        let (mut rig, _) = new_rig(kind);
        on_golden(&mut *rig, |bench| {
            press_in(bench)?;
            let name = match case {
                0 => {
                    bench.controls.disarm();
                    bench.run(2)?;
                    "disarming"
                }
                1 => {
                    bench.end();
                    "the end of the loop"
                }
                _ => {
                    bench.panic_in_next_exchange();
                    let ended = catch_unwind(AssertUnwindSafe(|| bench.step().is_ok()));
                    ensure!(ended.is_err(), "no panic");
                    // As unwinding the thread's stack would do.
                    bench.end();
                    "a panic"
                }
            };
            let felt = bench.rig.force_record();
            ensure!(felt.force_n == vec3::ZERO && felt.off_since_us.is_some(), "after {name}: {felt:?}");
            Ok(())
        })?;
    }
    Ok(())
}

pub(super) fn lost_homing(kind: RigKind) -> Result<(), Violation> {
    for fault in [FaultKind::HomingLost, FaultKind::PowerCycle] {
        let (mut rig, _) = new_rig(kind);
        if !rig.inject(fault) {
            continue;
        }
        let (mut rig, _) = new_rig(kind);
        on_golden(&mut *rig, |bench| {
            press_in(bench)?;
            bench.rig.inject(fault);
            let records = bench.run(40)?;
            // The loss is reported one tick late, and the next exchange sends the zero.
            let latched = records.iter().position(|record| matches!(record.phase, Phase::SafeZero(_)));
            let last = records.last().map(|record| (record.phase, record.device));
            ensure!(latched.is_some_and(|tick| tick <= 11), "{fault:?}: latched after {latched:?} ticks");
            if fault == FaultKind::HomingLost {
                let expected = (Phase::SafeZero(Fault::NotReady), DeviceState::Unhomed);
                ensure!(last == Some(expected), "{fault:?}: {last:?}");
            }
            ensure!(
                bench.rig.force_record().force_n == vec3::ZERO,
                "{fault:?}: {:?}",
                bench.rig.force_record()
            );
            let late = records.iter().skip(4).filter(|record| record.sample.is_some()).count();
            ensure!(late == 0, "{fault:?}: {late} samples of a device that is not homed");
            // Neither a reset nor arming gives a force before homing.
            bench.controls.reset();
            bench.controls.arm();
            let records = bench.run(40)?;
            let last = records.last().map(|record| record.phase);
            // A silent device keeps its last state and is stale 10 ms later.
            ensure!(last != Some(Phase::Active), "{fault:?}: armed without homing");
            let unhomed = |record: &&palpate_host::TickRecord| record.device != DeviceState::Homed;
            let active =
                records.iter().filter(unhomed).filter(|record| record.phase == Phase::Active).count();
            ensure!(active == 0, "{fault:?}: {active} ticks armed without homing");
            ensure!(
                bench.rig.force_record().force_n == vec3::ZERO,
                "{fault:?}: {:?}",
                bench.rig.force_record()
            );
            Ok(())
        })?;
    }
    Ok(())
}

/// Ticks of silence that are latched.
const STALE_TICKS: u64 = 14;

/// The hand leaves the organ and enters it again, because a controller that is armed inside renders nothing.
pub(super) fn latched_stays(kind: RigKind) -> Result<(), Violation> {
    let (mut rig, _) = new_rig(kind);
    on_golden(&mut *rig, |bench| {
        press_in(bench)?;
        bench.rig.set_faults(Faults::NONE, Faults { drop: 1.0, ..Faults::NONE });
        // Long enough to be stale, and too short for the device link to lose its session.
        let records = bench.run(STALE_TICKS)?;
        let latched = Some(Phase::SafeZero(Fault::Stale));
        let last = records.last().map(|record| record.phase);
        ensure!(last == latched, "{last:?} after {STALE_TICKS} ms of silence");
        bench.rig.set_faults(Faults::NONE, Faults::NONE);
        let mut records = bench.run(60)?;
        bench.rig.reset_record();
        let path = session::press_again(bench.rig, 0.006, 0.014);
        bench.rig.follow(path);
        records.extend(bench.run(session::PRESS_AGAIN_TICKS)?);
        let sampled = records.iter().filter(|record| record.sample.is_some()).count();
        ensure!(sampled > 150, "{sampled} samples of a link without faults");
        let left = records.iter().map(|record| record.phase).find(|phase| Some(*phase) != latched);
        ensure!(left.is_none(), "{left:?} after a latched fault, without a reset");
        let felt = bench.rig.force_record();
        ensure!(
            felt.force_n == vec3::ZERO && felt.largest_force_n == 0.0,
            "{felt:?} after a latched fault and a new press"
        );
        // The same press gives a force after a reset and arming.
        bench.controls.reset();
        bench.run(2)?;
        bench.controls.arm();
        let path = session::press_again(bench.rig, 0.006, 0.014);
        bench.rig.follow(path);
        bench.run(session::PRESS_AGAIN_TICKS)?;
        let felt = bench.rig.force_record();
        ensure!(felt.force_n[2] > 0.3, "{:?} N, after a reset, arming and a new press", felt.force_n);
        Ok(())
    })
}

pub(super) fn unplugged_is_gone(kind: RigKind) -> Result<(), Violation> {
    for cut in [FaultKind::Replug, FaultKind::UnplugMidFrame] {
        let (mut rig, traits) = new_rig(kind);
        {
            let mut session = Session::homed(&mut *rig, permuted(&traits))?;
            hold_force(&mut session, [1.0, 1.0, 1.0], 10)?;
            // A request is in flight when the cable is pulled.
            let now_us = session.now_us();
            let _ = session.device().exchange(now_us, [1.0, 1.0, 1.0]);
            session.rig.inject(cut);
            session.pass(1_000);
            let is_disconnected = (0..5)
                .any(|_| error_kind(session.tick([1.0, 1.0, 1.0])) == Some(DeviceErrorKind::Disconnected));
            ensure!(is_disconnected, "{cut:?}: not reported as disconnected five exchanges after unplugging");
            session.rig.replug();
            let before = session.rig.force_record().commands;
            for _ in 0..50 {
                let kind = error_kind(session.tick([1.0, 1.0, 1.0]));
                ensure!(kind == Some(DeviceErrorKind::Disconnected), "{cut:?}: {kind:?} from a lost driver");
            }
            let after = session.rig.force_record().commands;
            ensure!(after == before, "{cut:?}: a lost driver commands the motors after replugging");
        }
        // Opened again the device has no force, and gets none before homing and arming.
        rig.reset_record();
        on_golden(&mut *rig, |bench| {
            let felt = bench.rig.force_record();
            ensure!(felt.force_n == vec3::ZERO, "{cut:?}: opened and homed, {felt:?}");
            let path = session::press(bench.rig, 0.006, 0.014);
            bench.rig.follow(path);
            let records = bench.run(800)?;
            ensure!(
                records.iter().all(|record| record.phase == Phase::Disarmed),
                "{cut:?}: the loop resumed by itself"
            );
            ensure!(
                bench.rig.force_record().force_n == vec3::ZERO,
                "{cut:?}: {:?}",
                bench.rig.force_record()
            );
            press_in(bench)
        })?;
    }
    Ok(())
}
