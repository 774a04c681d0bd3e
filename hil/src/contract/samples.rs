//! Contract checks of the samples: their values, their age, and silence.

use super::{Violation, hold_force, in_model, new_rig, permuted};
use crate::fault::Faults;
use crate::mechanism::Waypoint;
use crate::rig::{RigKind, Traits};
use crate::session::Session;
use palpate_core::{Sample, Vec3, vec3};
use palpate_host::DeviceErrorKind;
use std::time::Duration;

/// Moves back and forth along two axes, with a rest at each end.
fn sweep(traits: &Traits, reach_m: f32) -> Vec<Waypoint> {
    let at =
        |t_us, x: f32, y: f32| Waypoint { t_us, position_m: vec3::add(traits.middle_m, [x, y, 0.5 * x]) };
    vec![
        at(0, 0.0, 0.0),
        at(300_000, reach_m, 0.0),
        at(500_000, reach_m, 0.0),
        at(1_300_000, -reach_m, 0.5 * reach_m),
        at(1_500_000, -reach_m, -0.5 * reach_m),
    ]
}

pub(super) fn positions_are_right(kind: RigKind) -> Result<(), Violation> {
    let (mut rig, traits) = new_rig(kind);
    let mut session = Session::homed(&mut *rig, permuted(&traits))?;
    session.rig.follow(sweep(&traits, 0.02));
    let start = session.truth().len();
    let mut samples = Vec::new();
    for _ in 0..1_600 {
        samples.extend(session.tick(vec3::ZERO)?);
    }
    ensure!(samples.len() > 700, "{} samples in 1.6 s of a fault-free link", samples.len());
    for sample in samples.iter().skip(2) {
        let since = session.truth().partition_point(|(t_us, _)| *t_us < sample.t_us).max(start);
        // The encoders were read between the request and two ticks later.
        let then = session.truth()[since..].iter().take(9);
        let off_m = then
            .map(|(_, device_m)| vec3::distance(in_model(&traits, *device_m), sample.position_m))
            .fold(f32::INFINITY, f32::min);
        ensure!(off_m <= traits.count_m, "{} um off at {} us", 1e6 * off_m, sample.t_us);
    }
    Ok(())
}

/// The time at which the grip was nearest to the sampled position, and that distance. The hand moves in one
/// direction, along the model's z.
fn nearest_truth(truth: &[(u64, Vec3)], traits: &Traits, sample: &Sample) -> (u64, f32) {
    let after = truth.partition_point(|(_, device_m)| in_model(traits, *device_m)[2] < sample.position_m[2]);
    let neighbours = truth[after.saturating_sub(1)..].iter().take(2);
    let distance = |device_m: Vec3| vec3::distance(in_model(traits, device_m), sample.position_m);
    let seen = neighbours.map(|(t_us, device_m)| (*t_us, distance(*device_m)));
    seen.fold((0, f32::INFINITY), |best, next| if next.1 < best.1 { next } else { best })
}

/// Moves the hand fast in one direction under faults. No sample may be stamped later than its position was
/// true.
fn check_stamps(kind: RigKind, seed: u64, to_device: Faults, to_host: Faults) -> Result<usize, Violation> {
    let mut rig = (kind.make)(seed);
    let traits = rig.traits();
    let mut session = Session::homed(&mut *rig, permuted(&traits))?;
    let at = |t_us, x: f32| Waypoint { t_us, position_m: vec3::add(traits.middle_m, [x, 0.0, 0.0]) };
    session.rig.follow(vec![at(0, -0.03), at(300_000, -0.03), at(1_000_000, 0.03)]);
    hold_force(&mut session, vec3::ZERO, 300)?;
    session.rig.set_faults(to_device, to_host);
    let from = session.truth().len();
    let mut seen = 0;
    for _ in 0..600 {
        let sample = match session.tick(vec3::ZERO) {
            Err(error) if !error.kind().is_transient() => return Err(error.into()),
            exchanged => exchanged.unwrap_or(None),
        };
        let Some(sample) = sample else { continue };
        ensure!(sample.t_us <= session.now_us(), "a time stamp in the future: {sample:?}");
        // At the ends of the path the hand is too slow to determine the time.
        let place_m = sample.position_m[2];
        if !(-0.022..0.022).contains(&place_m) {
            continue;
        }
        seen += 1;
        let (then_us, off_m) = nearest_truth(&session.truth()[from..], &traits, &sample);
        ensure!(off_m <= 2.0 * traits.count_m, "{} um from every true position: {sample:?}", 1e6 * off_m);
        // The hand moves at 40 mm/s at least, so one count takes up to two milliseconds.
        let tolerance_us = 2_500;
        ensure!(
            sample.t_us <= then_us + tolerance_us,
            "stamped {} us, but true at {then_us} us",
            sample.t_us
        );
    }
    Ok(seen)
}

pub(super) fn stamps_are_not_too_young(kind: RigKind) -> Result<(), Violation> {
    let none = Faults::NONE;
    let mut seen = check_stamps(kind, 1, none, none)?;
    ensure!(seen > 200, "{seen} samples of a fault-free link");
    let numbered = (kind.make)(1).traits().numbered_replies;
    // Replies without numbers cannot reveal that two were swapped. No serial line swaps them.
    for (seed, (name, faults)) in
        (2..).zip(rare_faults().into_iter().filter(|(name, _)| numbered || *name != "reorder"))
    {
        for (to_device, to_host) in [(none, faults), (faults, none), (faults, faults)] {
            let stamped = check_stamps(kind, seed, to_device, to_host);
            seen += stamped.map_err(|Violation(why)| Violation(format!("{name}: {why}")))?;
        }
    }
    ensure!(seen > 2_000, "{seen} samples in all");
    Ok(())
}

/// One kind of fault at a time, on few frames.
fn rare_faults() -> [(&'static str, Faults); 7] {
    let none = Faults::NONE;
    [
        ("drop", Faults { drop: 0.05, ..none }),
        ("delay", Faults { delay: 0.03, delay_us: 7_000, ..none }),
        ("duplicate", Faults { duplicate: 0.05, ..none }),
        ("truncate", Faults { truncate: 0.05, ..none }),
        ("reorder", Faults { reorder: 0.03, ..none }),
        ("stall", Faults { stall: 0.02, stall_us: 9_000, ..none }),
        ("noise", Faults { noise: 0.05, ..none }),
    ]
}

pub(super) fn late_is_not_fresh(kind: RigKind) -> Result<(), Violation> {
    for delay_us in [12_000, 25_000, 60_000] {
        let (mut rig, traits) = new_rig(kind);
        // A library gives no late measurement.
        if traits.behind_library {
            return Ok(());
        }
        let mut session = Session::homed(&mut *rig, permuted(&traits))?;
        session.rig.set_faults(Faults::NONE, Faults { delay: 1.0, delay_us, ..Faults::NONE });
        for tick in 0..400 {
            let now_us = session.now_us();
            let Ok(Some(sample)) = session.tick(vec3::ZERO) else { continue };
            let age_us = now_us - sample.t_us;
            // A reply that was in flight before the fault may still be in time.
            ensure!(
                tick < 3 || age_us + 1_000 >= delay_us.min(16_000),
                "{age_us} us old with a delay of {delay_us} us"
            );
        }
        ensure!(session.rig.counts().delayed > 5, "no frame was delayed: {:?}", session.rig.counts());
    }
    Ok(())
}

pub(super) fn silence_is_reported(kind: RigKind) -> Result<(), Violation> {
    let (mut rig, traits) = new_rig(kind);
    let mut session = Session::homed(&mut *rig, permuted(&traits))?;
    hold_force(&mut session, vec3::ZERO, 20)?;
    session.rig.set_faults(Faults::NONE, Faults { drop: 1.0, ..Faults::NONE });
    let (mut samples, mut timeouts) = (0, 0);
    for _ in 0..100 {
        match session.tick(vec3::ZERO) {
            Ok(sample) => samples += u32::from(sample.is_some()),
            Err(error) if error.kind() == DeviceErrorKind::Timeout => timeouts += 1,
            Err(error) => return Err(error.into()),
        }
    }
    ensure!(samples <= 1 && timeouts > 20, "{samples} samples and {timeouts} timeouts in 0.1 s of silence");
    session.rig.set_faults(Faults::NONE, Faults::NONE);
    let mut recovered = 0;
    for _ in 0..100 {
        recovered += u32::from(matches!(session.tick(vec3::ZERO), Ok(Some(_))));
    }
    ensure!(recovered > 30, "{recovered} samples in 0.1 s after the silence");
    Ok(())
}

/// Every kind of link fault, one at a time, on every frame.
pub(super) fn every_fault() -> [(&'static str, Faults); 9] {
    let none = Faults::NONE;
    [
        ("drop", Faults { drop: 1.0, ..none }),
        ("delay", Faults { delay: 1.0, delay_us: 15_000, ..none }),
        ("duplicate", Faults { duplicate: 1.0, ..none }),
        ("truncate", Faults { truncate: 1.0, ..none }),
        ("corrupt", Faults { corrupt: 1.0, ..none }),
        ("reorder", Faults { reorder: 1.0, ..none }),
        ("stall", Faults { stall: 0.1, stall_us: 30_000, ..none }),
        ("noise", Faults { noise: 1.0, ..none }),
        ("unplug", Faults { unplug: 1.0, unplug_us: 20_000, ..none }),
    ]
}

/// Longest virtual time of an exchange, us. Two writes that each wait one tick for room would already be an
/// overrun.
const MAX_EXCHANGE_US: u64 = 2_000;

/// Largest median real time of an exchange on a fault-free link in memory, which has nothing to wait for.
/// Virtual time would not show a driver that sleeps.
const MAX_MEDIAN_EXCHANGE: Duration = Duration::from_millis(1);

/// Median of some hundred exchanges, because a busy machine delays a few.
fn median_exchange(kind: RigKind) -> Result<Duration, Violation> {
    let (mut rig, traits) = new_rig(kind);
    let mut session = Session::homed(&mut *rig, permuted(&traits))?;
    let mut times = Vec::new();
    for tick in 0..400 {
        session.tick(if tick % 7 < 5 { [1.0, 0.0, 0.5] } else { vec3::ZERO })?;
        times.push(session.last_wait());
    }
    times.sort_unstable();
    Ok(times[times.len() / 2])
}

pub(super) fn exchanges_do_not_wait(kind: RigKind) -> Result<(), Violation> {
    if kind.in_memory {
        let median = median_exchange(kind)?;
        ensure!(
            median < MAX_MEDIAN_EXCHANGE,
            "an exchange on a fault-free link takes {median:?} of real time"
        );
    }
    for (name, faults) in every_fault() {
        for (to_device, to_host) in [(faults, Faults::NONE), (Faults::NONE, faults), (faults, faults)] {
            let (mut rig, traits) = new_rig(kind);
            let mut session = Session::homed(&mut *rig, permuted(&traits))?;
            session.rig.set_faults(to_device, to_host);
            for tick in 0..60 {
                let force_n = if tick % 7 < 5 { [1.0, 0.0, 0.5] } else { vec3::ZERO };
                // Errors are expected under these faults.
                let _ = session.tick(force_n);
            }
            let (virtual_us, real) = session.longest_wait();
            ensure!(virtual_us <= MAX_EXCHANGE_US, "{name}: an exchange took {virtual_us} us");
            // This bound is no measurement; it detects a hang.
            ensure!(real < Duration::from_secs(10), "{name}: an exchange took {real:?}");
        }
    }
    Ok(())
}
