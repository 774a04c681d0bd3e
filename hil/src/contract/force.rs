//! Of the contract: what is felt at the motors, with the driver alone.

use super::samples::every_fault;
use super::{Broken, ask, in_device, made, turned};
use crate::fault::Faults;
use crate::rig::Kind;
use crate::session::Session;
use palpate_core::vec3;
use palpate_host::device::DeviceState;

pub(super) fn says_what_it_is(kind: Kind) -> Result<(), Broken> {
    let (mut rig, traits) = made(kind);
    let max_force_n = rig.profile().max_force_n;
    let mut session = Session::homed(&mut *rig, turned(&traits))?;
    let info = session.device().info();
    ensure!(!info.name.is_empty(), "it has no name");
    ensure!(!info.self_arming, "a device with motors must not arm itself");
    ensure!(info.max_force_n == max_force_n, "{} N, not {max_force_n} N", info.max_force_n);
    ensure!(info.max_stiffness_n_m > 0.0 && info.resolution_m > 0.0, "{info:?}");
    ensure!(session.device().emergency_stop().is_some(), "the watchdog has no second way to the motors");
    Ok(())
}

pub(super) fn forces_arrive(kind: Kind) -> Result<(), Broken> {
    let (mut rig, traits) = made(kind);
    let mut session = Session::homed(&mut *rig, turned(&traits))?;
    let asked = [
        [1.5, 0.0, 0.0],
        [-1.5, 0.0, 0.0],
        [0.0, 1.5, 0.0],
        [0.0, -1.5, 0.0],
        [0.0, 0.0, 1.5],
        [0.0, 0.0, -1.5],
        [0.7, -1.1, 2.0],
    ];
    for asked_n in asked {
        ask(&mut session, asked_n, 4)?;
        let (felt_n, wanted_n) = (session.rig.felt().force_n, in_device(asked_n));
        // The grip has moved since the sample on which the motors' torques stand.
        let most_n = traits.motor_step_n + 0.01 * vec3::norm(asked_n);
        ensure!(vec3::distance(felt_n, wanted_n) <= most_n, "{felt_n:?} N was felt, not {wanted_n:?} N");
        ask(&mut session, vec3::ZERO, 30)?;
        let felt = session.rig.felt();
        ensure!(
            felt.force_n == vec3::ZERO && felt.off_since_us.is_some(),
            "{felt:?} with no force asked for"
        );
    }
    // A force that is held moves the hand along itself.
    for axis in 0..3 {
        let mut asked_n = vec3::ZERO;
        asked_n[axis] = 2.0;
        let before_m = session.rig.position_m();
        ask(&mut session, asked_n, 200)?;
        let moved_m = vec3::sub(session.rig.position_m(), before_m);
        let along_m = vec3::dot(moved_m, in_device(asked_n)) / 2.0;
        ensure!(
            along_m > 0.9 * vec3::norm(moved_m) && along_m > 1e-3,
            "{asked_n:?} N moved it by {moved_m:?}"
        );
        ask(&mut session, vec3::ZERO, 300)?;
    }
    Ok(())
}

pub(super) fn nothing_before_homing(kind: Kind) -> Result<(), Broken> {
    let (mut rig, traits) = made(kind);
    let mut session = Session::open(&mut *rig, turned(&traits))?;
    ensure!(session.rig.felt().largest_force_n == 0.0, "opening it gave a force");
    if !traits.homes {
        ensure!(session.state() == DeviceState::Homed, "{:?}", session.state());
        return Ok(());
    }
    ensure!(session.state() != DeviceState::Homed, "homed before anything was said");
    let mut unhomed_ticks = 0;
    for _ in 0..5_000 {
        let sample = session.tick([3.0, -2.0, 4.0])?;
        if session.state() == DeviceState::Homed {
            break;
        }
        unhomed_ticks += 1;
        ensure!(sample.is_none(), "{sample:?} before it was homed");
        let felt = session.rig.felt();
        ensure!(felt.largest_force_n == 0.0 && felt.largest_motor == 0, "{felt:?} before it was homed");
    }
    ensure!(session.state() == DeviceState::Homed && unhomed_ticks > 10, "homed after {unhomed_ticks} ticks");
    ask(&mut session, [3.0, -2.0, 4.0], 20)?;
    let felt = session.rig.felt();
    ensure!(felt.largest_unhomed_n == 0.0, "{felt:?}");
    ensure!(felt.force_n != vec3::ZERO, "no force after it was homed");
    Ok(())
}

pub(super) fn never_beyond_the_limit(kind: Kind) -> Result<(), Broken> {
    let (mut rig, traits) = made(kind);
    let limit_n = rig.profile().max_force_n;
    let mut session = Session::homed(&mut *rig, turned(&traits))?;
    let (inf, nan, max) = (f32::INFINITY, f32::NAN, f32::MAX);
    let asked = [
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
    for asked_n in asked {
        session.rig.forget();
        ask(&mut session, asked_n, 4)?;
        let felt = session.rig.felt();
        let most_n = limit_n + traits.motor_step_n;
        ensure!(felt.largest_force_n <= most_n, "{} N with {asked_n:?} N asked for", felt.largest_force_n);
        ensure!(felt.force_n.iter().all(|component| component.is_finite()), "{felt:?}");
        if !vec3::is_finite(asked_n) {
            ensure!(felt.force_n == vec3::ZERO, "{asked_n:?} is no force, and {:?} N was felt", felt.force_n);
        } else {
            // Shortened, not turned.
            let asked_n =
                asked_n.map(|component| component / asked_n.iter().fold(0.0, |m: f32, c| m.max(c.abs())));
            let along_n = vec3::dot(vec3::normalize_or_zero(in_device(asked_n)), felt.force_n);
            ensure!(along_n > 0.99 * limit_n.min(1.0), "{:?} N with {asked_n:?} asked for", felt.force_n);
        }
        ask(&mut session, vec3::ZERO, 60)?;
    }
    Ok(())
}

pub(super) fn zero_goes_at_once(kind: Kind) -> Result<(), Broken> {
    // The way to the device is sound; what comes back is not.
    for (name, faults) in every_fault() {
        if name == "unplug" {
            continue;
        }
        for lead in 1..6 {
            let (mut rig, traits) = made(kind);
            let mut session = Session::homed(&mut *rig, turned(&traits))?;
            ask(&mut session, [0.0, 1.0, 2.0], 10)?;
            session.rig.set_faults(Faults::NONE, faults);
            ask(&mut session, [0.0, 1.0, 2.0], lead)?;
            ensure!(session.rig.felt().off_since_us.is_none(), "{name}: no force to take away");
            let asked_us = session.now_us();
            ask(&mut session, vec3::ZERO, 2)?;
            let felt = session.rig.felt();
            let off_us = felt.off_since_us.map(|us| us.saturating_sub(asked_us));
            ensure!(
                felt.force_n == vec3::ZERO && off_us.is_some_and(|us| us <= 2_000),
                "{name}, {lead} ticks in: {felt:?}"
            );
            ask(&mut session, vec3::ZERO, 40)?;
            ensure!(session.rig.felt().force_n == vec3::ZERO, "{name}: the force came back");
        }
    }
    Ok(())
}

pub(super) fn zero_after_stop(kind: Kind) -> Result<(), Broken> {
    for way in 0..3 {
        let (mut rig, traits) = made(kind);
        let mut session = Session::homed(&mut *rig, turned(&traits))?;
        let mut second = session.device().emergency_stop();
        ask(&mut session, [2.0, -1.0, 1.0], 10)?;
        ensure!(vec3::norm(session.rig.felt().force_n) > 2.0, "{:?}", session.rig.felt());
        let name = match way {
            0 => {
                session.device().stop();
                "stop"
            }
            1 => {
                session.close();
                "drop"
            }
            _ => {
                let second = second.as_mut().ok_or_else(|| Broken("no second handle".into()))?;
                second.zero()?;
                "second handle"
            }
        };
        session.pass(2_000);
        let felt = session.rig.felt();
        ensure!(felt.force_n == vec3::ZERO && felt.off_since_us.is_some(), "after {name}: {felt:?}");
        session.pass(20_000);
        ensure!(session.rig.felt().force_n == vec3::ZERO, "after {name} the force came back");
    }
    Ok(())
}
