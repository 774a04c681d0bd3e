//! Contract checks of the force at the motors, with the driver alone.

use super::samples::every_fault;
use super::{Violation, hold_force, in_device, new_rig, permuted};
use crate::fault::Faults;
use crate::rig::RigKind;
use crate::session::Session;
use palpate_core::vec3;
use palpate_host::DeviceError;
use palpate_host::device::DeviceState;
use palpate_host::device::fence::{Fence, MAX_ZERO_MESSAGE};

pub(super) fn says_what_it_is(kind: RigKind) -> Result<(), Violation> {
    let (mut rig, traits) = new_rig(kind);
    let max_force_n = rig.profile().max_force_n;
    let mut session = Session::homed(&mut *rig, permuted(&traits))?;
    let info = session.device().info();
    ensure!(!info.name.is_empty(), "the device has no name");
    ensure!(!info.self_arming, "a device with motors is self-arming");
    ensure!(info.max_force_n == max_force_n, "{} N, expected {max_force_n} N", info.max_force_n);
    ensure!(info.max_stiffness_n_m > 0.0 && info.resolution_m > 0.0, "{info:?}");
    if traits.behind_library {
        return Ok(());
    }
    let (fence, mut message) = (Fence::default(), [0; MAX_ZERO_MESSAGE]);
    session.device().guard_path(&fence).map_err(DeviceError::from)?;
    ensure!(fence.page().zero_message(&mut message) > 0, "no message for a guard");
    Ok(())
}

pub(super) fn forces_arrive(kind: RigKind) -> Result<(), Violation> {
    let (mut rig, traits) = new_rig(kind);
    let mut session = Session::homed(&mut *rig, permuted(&traits))?;
    let requested = [
        [1.5, 0.0, 0.0],
        [-1.5, 0.0, 0.0],
        [0.0, 1.5, 0.0],
        [0.0, -1.5, 0.0],
        [0.0, 0.0, 1.5],
        [0.0, 0.0, -1.5],
        [0.7, -1.1, 2.0],
    ];
    for requested_n in requested {
        hold_force(&mut session, requested_n, 4)?;
        let (felt_n, expected_n) = (session.rig.force_record().force_n, in_device(requested_n));
        // The torques were computed for the sampled position, and the grip has moved since.
        let max_n = traits.motor_step_n + 0.01 * vec3::norm(requested_n);
        ensure!(
            vec3::distance(felt_n, expected_n) <= max_n,
            "{felt_n:?} N at the hand, expected {expected_n:?} N"
        );
        hold_force(&mut session, vec3::ZERO, 30)?;
        let felt = session.rig.force_record();
        ensure!(felt.force_n == vec3::ZERO && felt.off_since_us.is_some(), "{felt:?} with zero requested");
    }
    // A constant force moves the hand along its direction.
    for axis in 0..3 {
        let mut requested_n = vec3::ZERO;
        requested_n[axis] = 2.0;
        let before_m = session.rig.position_m();
        hold_force(&mut session, requested_n, 200)?;
        let moved_m = vec3::sub(session.rig.position_m(), before_m);
        let along_m = vec3::dot(moved_m, in_device(requested_n)) / 2.0;
        ensure!(
            along_m > 0.9 * vec3::norm(moved_m) && along_m > 1e-3,
            "{requested_n:?} N moved it by {moved_m:?}"
        );
        hold_force(&mut session, vec3::ZERO, 300)?;
    }
    Ok(())
}

pub(super) fn nothing_before_homing(kind: RigKind) -> Result<(), Violation> {
    let (mut rig, traits) = new_rig(kind);
    let mut session = Session::open(&mut *rig, permuted(&traits))?;
    ensure!(session.rig.force_record().largest_force_n == 0.0, "opening caused a force");
    if !traits.homes {
        ensure!(session.state() == DeviceState::Homed, "{:?}", session.state());
        return Ok(());
    }
    ensure!(session.state() != DeviceState::Homed, "homed before any exchange");
    let mut unhomed_ticks = 0;
    for _ in 0..5_000 {
        let sample = session.tick([3.0, -2.0, 4.0])?;
        if session.state() == DeviceState::Homed {
            break;
        }
        unhomed_ticks += 1;
        ensure!(sample.is_none(), "{sample:?} before homing");
        let felt = session.rig.force_record();
        ensure!(felt.largest_force_n == 0.0 && felt.largest_motor == 0, "{felt:?} before homing");
    }
    ensure!(session.state() == DeviceState::Homed && unhomed_ticks > 10, "homed after {unhomed_ticks} ticks");
    hold_force(&mut session, [3.0, -2.0, 4.0], 20)?;
    let felt = session.rig.force_record();
    ensure!(felt.largest_unhomed_n == 0.0, "{felt:?}");
    ensure!(felt.force_n != vec3::ZERO, "no force after homing");
    Ok(())
}

pub(super) fn never_beyond_the_limit(kind: RigKind) -> Result<(), Violation> {
    let (mut rig, traits) = new_rig(kind);
    let limit_n = rig.profile().max_force_n;
    let mut session = Session::homed(&mut *rig, permuted(&traits))?;
    let (inf, nan, max) = (f32::INFINITY, f32::NAN, f32::MAX);
    let requested = [
        [max, 0.0, 0.0],
        [max, max, -max],
        [1e6, -1e6, 1e6],
        [0.0, -33.0, 0.0],
        [-limit_n, -limit_n, -limit_n],
        [limit_n, limit_n, limit_n],
        [32.768, -32.769, 65.536],
        [inf, 0.0, 0.0],
        [-inf, 1.0, 1.0],
        [nan, 0.0, 0.0],
        [nan, nan, nan],
        [1.0, nan, -inf],
    ];
    for requested_n in requested {
        session.rig.reset_record();
        hold_force(&mut session, requested_n, 4)?;
        let felt = session.rig.force_record();
        let max_n = limit_n + traits.motor_step_n;
        ensure!(felt.largest_force_n <= max_n, "{} N with {requested_n:?} N requested", felt.largest_force_n);
        ensure!(felt.force_n.iter().all(|component| component.is_finite()), "{felt:?}");
        if !vec3::is_finite(requested_n) {
            ensure!(
                felt.force_n == vec3::ZERO,
                "{requested_n:?} is not finite, and {:?} N at the hand",
                felt.force_n
            );
        } else {
            // The clamp shortens the force and keeps its direction.
            let requested_n = requested_n
                .map(|component| component / requested_n.iter().fold(0.0, |m: f32, c| m.max(c.abs())));
            let along_n = vec3::dot(vec3::normalize_or_zero(in_device(requested_n)), felt.force_n);
            ensure!(along_n > 0.99 * limit_n.min(1.0), "{:?} N with {requested_n:?} requested", felt.force_n);
        }
        hold_force(&mut session, vec3::ZERO, 60)?;
    }
    Ok(())
}

pub(super) fn zero_goes_at_once(kind: RigKind) -> Result<(), Violation> {
    // Only the link from the device is faulty.
    let behind_library = (kind.make)(0).traits().behind_library;
    for (name, faults) in every_fault() {
        // Of a library only the faults that let a measurement be missing.
        if name == "unplug" || (behind_library && !["drop", "delay", "stall"].contains(&name)) {
            continue;
        }
        for lead in 1..6 {
            let (mut rig, traits) = new_rig(kind);
            let mut session = Session::homed(&mut *rig, permuted(&traits))?;
            hold_force(&mut session, [0.0, 1.0, 2.0], 10)?;
            session.rig.set_faults(Faults::NONE, faults);
            hold_force(&mut session, [0.0, 1.0, 2.0], lead)?;
            ensure!(
                session.rig.force_record().off_since_us.is_none(),
                "{name}: no force before the zero command"
            );
            let requested_us = session.now_us();
            hold_force(&mut session, vec3::ZERO, 2)?;
            let felt = session.rig.force_record();
            let off_us = felt.off_since_us.map(|us| us.saturating_sub(requested_us));
            ensure!(
                felt.force_n == vec3::ZERO && off_us.is_some_and(|us| us <= 2_000),
                "{name}, {lead} ticks after the fault: {felt:?}"
            );
            hold_force(&mut session, vec3::ZERO, 40)?;
            ensure!(session.rig.force_record().force_n == vec3::ZERO, "{name}: the force returned");
        }
    }
    Ok(())
}

pub(super) fn zero_after_stop(kind: RigKind) -> Result<(), Violation> {
    for case in 0..3 {
        let (mut rig, traits) = new_rig(kind);
        let mut session = Session::homed(&mut *rig, permuted(&traits))?;
        if case == 2 && traits.behind_library {
            continue;
        }
        let fence = Fence::default();
        let path = session.device().guard_path(&fence).map_err(DeviceError::from)?;
        hold_force(&mut session, [2.0, -1.0, 1.0], 10)?;
        ensure!(vec3::norm(session.rig.force_record().force_n) > 2.0, "{:?}", session.rig.force_record());
        let name = match case {
            0 => {
                session.device().stop();
                "stop"
            }
            1 => {
                session.close();
                "drop"
            }
            _ => {
                fence.page().close();
                session.guard_zero(&fence, path.as_ref())?;
                "the guard's message"
            }
        };
        session.pass(2_000);
        let felt = session.rig.force_record();
        ensure!(felt.force_n == vec3::ZERO && felt.off_since_us.is_some(), "after {name}: {felt:?}");
        session.pass(20_000);
        ensure!(session.rig.force_record().force_n == vec3::ZERO, "after {name} the force returned");
    }
    Ok(())
}
