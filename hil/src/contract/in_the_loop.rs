//! Of the contract: the driver with loop and controller, on an organ.

use super::{Broken, ask, kind_of, made, turned};
use crate::fault::Faults;
use crate::rig::{Cut, Kind, Mishap, Rig};
use crate::session::{self, Bench, Session};
use palpate_core::{Fault, Method, Organ, Phase, vec3};
use palpate_host::DeviceErrorKind;
use palpate_host::device::DeviceState;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Presses into the organ until the hand is pushed back; the loop is armed.
fn lean_in(bench: &mut Bench<'_, '_>) -> Result<(), Broken> {
    let path = session::press(bench.rig, 0.006, 0.014);
    bench.rig.follow(path);
    bench.controls.arm();
    let records = bench.run(800)?;
    let last = records.last().map(|record| record.phase);
    ensure!(last == Some(Phase::Active), "{last:?} after 0.8 s of a sound link");
    let felt = bench.rig.felt();
    let out_n = felt.force_n[2];
    ensure!(out_n > 0.3, "pressed in, the hand is not pushed out: {:?} N", felt.force_n);
    Ok(())
}

fn on_golden<T>(
    rig: &mut dyn Rig,
    test: impl FnOnce(&mut Bench<'_, '_>) -> Result<T, Broken>,
) -> Result<T, Broken> {
    let blob = session::golden_organ();
    let organ: Organ<'_> = Organ::read(blob.bytes()).map_err(|error| Broken(error.to_string()))?;
    session::with_loop(rig, &organ, Method::Energy, test)?
}

pub(super) fn nothing_before_arming(kind: Kind) -> Result<(), Broken> {
    let (mut rig, _) = made(kind);
    on_golden(&mut *rig, |bench| {
        let path = session::press(bench.rig, 0.006, 0.014);
        bench.rig.follow(path.clone());
        let records = bench.run(800)?;
        ensure!(records.iter().all(|record| record.phase == Phase::Disarmed), "it armed itself");
        let felt = bench.rig.felt();
        ensure!(felt.largest_motor == 0 && felt.largest_force_n == 0.0, "{felt:?} without being armed");
        // Armed deep inside nothing pushes either: it must come through the surface.
        bench.controls.arm();
        bench.run(50)?;
        ensure!(bench.rig.felt().largest_force_n == 0.0, "{:?} at the moment of arming", bench.rig.felt());
        bench.rig.follow(path);
        bench.run(800)?;
        ensure!(bench.rig.felt().force_n[2] > 0.3, "{:?} N, armed and pressed", bench.rig.felt().force_n);
        Ok(())
    })
}

pub(super) fn zero_after_the_loop(kind: Kind) -> Result<(), Broken> {
    for way in 0..3 {
        let (mut rig, _) = made(kind);
        on_golden(&mut *rig, |bench| {
            lean_in(bench)?;
            let name = match way {
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
                    bench.plant_panic();
                    let ended = catch_unwind(AssertUnwindSafe(|| bench.step().is_ok()));
                    ensure!(ended.is_err(), "no panic");
                    // What a thread's stack would have done while it unwound.
                    bench.end();
                    "a panic"
                }
            };
            let felt = bench.rig.felt();
            ensure!(felt.force_n == vec3::ZERO && felt.off_since_us.is_some(), "after {name}: {felt:?}");
            Ok(())
        })?;
    }
    Ok(())
}

pub(super) fn lost_homing(kind: Kind) -> Result<(), Broken> {
    for mishap in [Mishap::LoseHoming, Mishap::PowerCycle] {
        let (mut rig, _) = made(kind);
        if !rig.strike(mishap) {
            continue;
        }
        let (mut rig, _) = made(kind);
        on_golden(&mut *rig, |bench| {
            lean_in(bench)?;
            bench.rig.strike(mishap);
            let records = bench.run(40)?;
            // The reply that says so is one tick old, and the zero goes with the exchange after that.
            let latched = records.iter().position(|record| matches!(record.phase, Phase::SafeZero(_)));
            let last = records.last().map(|record| (record.phase, record.device));
            ensure!(latched.is_some_and(|tick| tick <= 11), "{mishap:?}: latched after {latched:?} ticks");
            if mishap == Mishap::LoseHoming {
                let wanted = (Phase::SafeZero(Fault::NotReady), DeviceState::Unhomed);
                ensure!(last == Some(wanted), "{mishap:?}: {last:?}");
            }
            ensure!(bench.rig.felt().force_n == vec3::ZERO, "{mishap:?}: {:?}", bench.rig.felt());
            let late = records.iter().skip(4).filter(|record| record.sample.is_some()).count();
            ensure!(late == 0, "{mishap:?}: {late} samples of a device that knows no place");
            // Neither a reset nor arming helps before it is homed.
            bench.controls.reset();
            bench.controls.arm();
            let records = bench.run(40)?;
            let last = records.last().map(|record| record.phase);
            // A device that has become silent is taken for what it was last, and is stale 10 ms later.
            ensure!(last != Some(Phase::Active), "{mishap:?}: armed without being homed");
            let unhomed = |record: &&palpate_host::TickRecord| record.device != DeviceState::Homed;
            let active =
                records.iter().filter(unhomed).filter(|record| record.phase == Phase::Active).count();
            ensure!(active == 0, "{mishap:?}: {active} ticks armed without being homed");
            ensure!(bench.rig.felt().force_n == vec3::ZERO, "{mishap:?}: {:?}", bench.rig.felt());
            Ok(())
        })?;
    }
    Ok(())
}

/// A silence that is latched, ticks.
const STALE_TICKS: u64 = 14;

/// Armed inside nothing pushes until the hand enters anew, so it does.
pub(super) fn latched_stays(kind: Kind) -> Result<(), Broken> {
    let (mut rig, _) = made(kind);
    on_golden(&mut *rig, |bench| {
        lean_in(bench)?;
        bench.rig.set_faults(Faults::NONE, Faults { drop: 1.0, ..Faults::NONE });
        // Long enough to be stale, and too short for a device link to call its session lost.
        let records = bench.run(STALE_TICKS)?;
        let latched = Some(Phase::SafeZero(Fault::Stale));
        let last = records.last().map(|record| record.phase);
        ensure!(last == latched, "{last:?} after {STALE_TICKS} ms of silence");
        bench.rig.set_faults(Faults::NONE, Faults::NONE);
        let mut records = bench.run(60)?;
        bench.rig.forget();
        let path = session::press_anew(bench.rig, 0.006, 0.014);
        bench.rig.follow(path);
        records.extend(bench.run(session::ANEW_TICKS)?);
        let sampled = records.iter().filter(|record| record.sample.is_some()).count();
        ensure!(sampled > 150, "{sampled} samples of a link that is sound again");
        let left = records.iter().map(|record| record.phase).find(|phase| Some(*phase) != latched);
        ensure!(left.is_none(), "{left:?} after a latched fault, without a reset");
        let felt = bench.rig.felt();
        ensure!(
            felt.force_n == vec3::ZERO && felt.largest_force_n == 0.0,
            "{felt:?} after a latched fault, pressed anew"
        );
        // The same way gives a force once somebody has reset and armed.
        bench.controls.reset();
        bench.run(2)?;
        bench.controls.arm();
        let path = session::press_anew(bench.rig, 0.006, 0.014);
        bench.rig.follow(path);
        bench.run(session::ANEW_TICKS)?;
        let felt = bench.rig.felt();
        ensure!(felt.force_n[2] > 0.3, "{:?} N, reset, armed and pressed anew", felt.force_n);
        Ok(())
    })
}

pub(super) fn unplugged_is_gone(kind: Kind) -> Result<(), Broken> {
    for cut in [Cut::Between, Cut::MidFrame] {
        let (mut rig, traits) = made(kind);
        {
            let mut session = Session::homed(&mut *rig, turned(&traits))?;
            ask(&mut session, [1.0, 1.0, 1.0], 10)?;
            // The request is on its way when the cable goes.
            let now_us = session.now_us();
            let _ = session.device().exchange(now_us, [1.0, 1.0, 1.0]);
            session.rig.unplug(cut);
            session.pass(1_000);
            let gone =
                (0..5).any(|_| kind_of(session.tick([1.0, 1.0, 1.0])) == Some(DeviceErrorKind::Disconnected));
            ensure!(gone, "{cut:?}: five exchanges after the cable was pulled it is not said to be gone");
            session.rig.replug();
            let before = session.rig.felt().commands;
            for _ in 0..50 {
                let kind = kind_of(session.tick([1.0, 1.0, 1.0]));
                ensure!(
                    kind == Some(DeviceErrorKind::Disconnected),
                    "{cut:?}: {kind:?} from a driver that is lost"
                );
            }
            let after = session.rig.felt().commands;
            ensure!(after == before, "{cut:?}: a lost driver commands the motors of a device put in again");
        }
        // Opened anew it has no force, and gets none before it is homed and armed.
        rig.forget();
        on_golden(&mut *rig, |bench| {
            let felt = bench.rig.felt();
            ensure!(felt.force_n == vec3::ZERO, "{cut:?}: opened and homed, {felt:?}");
            let path = session::press(bench.rig, 0.006, 0.014);
            bench.rig.follow(path);
            let records = bench.run(800)?;
            ensure!(
                records.iter().all(|record| record.phase == Phase::Disarmed),
                "{cut:?}: it went on by itself"
            );
            ensure!(bench.rig.felt().force_n == vec3::ZERO, "{cut:?}: {:?}", bench.rig.felt());
            lean_in(bench)
        })?;
    }
    Ok(())
}
