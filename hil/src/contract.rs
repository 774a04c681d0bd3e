//! One contract for every device on every transport: what a driver promises the loop, checked on a rig.
//!
//! A check makes its own rig, so that the checks know nothing of each other. It runs in virtual time where the rig can; a rig over a real
//! transport goes in step, so that no check depends on how busy the machine is.

use crate::fault::Faults;
use crate::mechanism::Waypoint;
use crate::rig::{Cut, Kind, Mishap, OpenError, Rig, Traits};
use crate::session::{self, Bench, Session};
use core::fmt;
use palpate_core::{Fault, Method, Organ, Phase, Sample, Vec3, vec3};
use palpate_host::device::DeviceState;
use palpate_host::device::workspace::Workspace;
use palpate_host::{DeviceError, DeviceErrorKind};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

/// What was promised and not kept.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Broken(String);

impl fmt::Display for Broken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl core::error::Error for Broken {}

impl From<OpenError> for Broken {
    fn from(error: OpenError) -> Self {
        Self(format!("cannot be opened: {error}"))
    }
}

impl From<DeviceError> for Broken {
    fn from(error: DeviceError) -> Self {
        Self(format!("exchange: {error}"))
    }
}

/// One point of the contract.
#[derive(Debug, Clone, Copy)]
pub struct Check {
    /// What is promised.
    pub name: &'static str,
    run: fn(Kind) -> Result<(), Broken>,
}

impl Check {
    /// Holds a rig to it.
    pub fn run(&self, kind: Kind) -> Result<(), Broken> {
        (self.run)(kind)
    }
}

/// All of it.
pub const CHECKS: [Check; 16] = [
    Check { name: "it says what it is and never arms itself", run: says_what_it_is },
    Check { name: "forces arrive with their size, axis and sign", run: forces_arrive },
    Check { name: "no force and no sample before it is homed", run: nothing_before_homing },
    Check { name: "no force before it is armed", run: nothing_before_arming },
    Check { name: "no force beyond the profile's limit, whatever is asked", run: never_beyond_the_limit },
    Check { name: "positions are right within a count", run: positions_are_right },
    Check { name: "stamps are never younger than the truth", run: stamps_are_not_too_young },
    Check { name: "a late reply never passes for a fresh one", run: late_is_not_fresh },
    Check { name: "silence is reported and brings no samples", run: silence_is_reported },
    Check { name: "an exchange does not wait, whatever the link does", run: exchanges_do_not_wait },
    Check { name: "zero goes out at once, also while the link is in disorder", run: zero_goes_at_once },
    Check { name: "zero after stop, second handle and drop", run: zero_after_stop },
    Check { name: "zero after disarming, the end of the loop and a panic in it", run: zero_after_the_loop },
    Check { name: "homing that is lost takes force and samples away", run: lost_homing },
    Check { name: "a latched fault stays, on a sound link and pressed anew", run: latched_stays },
    Check { name: "unplugged is gone for good; nothing resumes by itself", run: unplugged_is_gone },
];

macro_rules! ensure {
    ($holds:expr, $($why:tt)+) => {
        let holds: bool = $holds;
        if !holds {
            return Err(Broken(format!($($why)+)));
        }
    };
}

/// Model x is device y, y is z, z is x; the model's origin is the middle of the workspace.
fn turned(traits: &Traits) -> Workspace {
    Workspace {
        axes: [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]],
        scale: 1.0,
        device_origin_m: traits.middle_m,
        model_origin_m: vec3::ZERO,
    }
}

/// The same, written out once more.
const fn in_device([x, y, z]: Vec3) -> Vec3 {
    [z, x, y]
}

fn in_model(traits: &Traits, device_m: Vec3) -> Vec3 {
    let [x, y, z] = vec3::sub(device_m, traits.middle_m);
    [y, z, x]
}

fn made(kind: Kind) -> (Box<dyn Rig>, Traits) {
    let rig = (kind.make)(7);
    let traits = rig.traits();
    (rig, traits)
}

fn kind_of(exchanged: Result<Option<Sample>, DeviceError>) -> Option<DeviceErrorKind> {
    exchanged.err().map(|error| error.kind())
}

/// Asks for a force for some ticks; what breaks in passing is the link's affair.
fn ask(session: &mut Session<'_>, force_n: Vec3, ticks: u32) -> Result<(), Broken> {
    for _ in 0..ticks {
        match session.tick(force_n) {
            Err(error) if !error.kind().is_passing() => return Err(error.into()),
            _ => {}
        }
    }
    Ok(())
}

fn says_what_it_is(kind: Kind) -> Result<(), Broken> {
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

fn forces_arrive(kind: Kind) -> Result<(), Broken> {
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

fn nothing_before_homing(kind: Kind) -> Result<(), Broken> {
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

fn never_beyond_the_limit(kind: Kind) -> Result<(), Broken> {
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

/// There and back along two axes, with a rest at each end.
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

fn positions_are_right(kind: Kind) -> Result<(), Broken> {
    let (mut rig, traits) = made(kind);
    let mut session = Session::homed(&mut *rig, turned(&traits))?;
    session.rig.follow(sweep(&traits, 0.02));
    let begun = session.truth().len();
    let mut samples = Vec::new();
    for _ in 0..1_600 {
        samples.extend(session.tick(vec3::ZERO)?);
    }
    ensure!(samples.len() > 700, "{} samples in 1.6 s of a sound link", samples.len());
    for sample in samples.iter().skip(2) {
        let since = session.truth().partition_point(|(t_us, _)| *t_us < sample.t_us).max(begun);
        // The encoders were read some time between the request and two ticks later.
        let then = session.truth()[since..].iter().take(9);
        let off_m = then
            .map(|(_, device_m)| vec3::distance(in_model(&traits, *device_m), sample.position_m))
            .fold(f32::INFINITY, f32::min);
        ensure!(off_m <= traits.count_m, "{} um off at {} us", 1e6 * off_m, sample.t_us);
    }
    Ok(())
}

/// The time when the grip was nearest to where a sample says it was, and how far that is.
fn seen_at(session: &Session<'_>, traits: &Traits, sample: &Sample, from: usize) -> (u64, f32) {
    let distance = |device_m: Vec3| vec3::distance(in_model(traits, device_m), sample.position_m);
    let places = session.truth()[from..].iter().map(|(t_us, device_m)| (*t_us, distance(*device_m)));
    places.fold((0, f32::INFINITY), |best, next| if next.1 < best.1 { next } else { best })
}

/// Moves the hand one way, fast, under faults; every sample must have been true when it is stamped, or later.
fn stamps_under(kind: Kind, seed: u64, to_device: Faults, to_host: Faults) -> Result<usize, Broken> {
    let mut rig = (kind.make)(seed);
    let traits = rig.traits();
    let mut session = Session::homed(&mut *rig, turned(&traits))?;
    let at = |t_us, x: f32| Waypoint { t_us, position_m: vec3::add(traits.middle_m, [x, 0.0, 0.0]) };
    session.rig.follow(vec![at(0, -0.03), at(300_000, -0.03), at(1_000_000, 0.03)]);
    ask(&mut session, vec3::ZERO, 300)?;
    session.rig.set_faults(to_device, to_host);
    let from = session.truth().len();
    let mut seen = 0;
    for _ in 0..600 {
        let sample = match session.tick(vec3::ZERO) {
            Err(error) if !error.kind().is_passing() => return Err(error.into()),
            exchanged => exchanged.unwrap_or(None),
        };
        let Some(sample) = sample else { continue };
        ensure!(sample.t_us <= session.now_us(), "a stamp of the future: {sample:?}");
        // At the ends of its way the hand is too slow to tell the time by.
        let place_m = sample.position_m[2];
        if !(-0.022..0.022).contains(&place_m) {
            continue;
        }
        seen += 1;
        let (then_us, off_m) = seen_at(&session, &traits, &sample, from);
        ensure!(off_m <= 2.0 * traits.count_m, "{} um from every truth: {sample:?}", 1e6 * off_m);
        // 40 mm/s at the slowest part that counts: a count is two milliseconds there.
        let tolerance_us = 2_500;
        ensure!(
            sample.t_us <= then_us + tolerance_us,
            "stamped {} us, and true at {then_us} us",
            sample.t_us
        );
    }
    Ok(seen)
}

fn stamps_are_not_too_young(kind: Kind) -> Result<(), Broken> {
    let none = Faults::NONE;
    let mut seen = stamps_under(kind, 1, none, none)?;
    ensure!(seen > 200, "{seen} samples of a sound link");
    let numbered = (kind.make)(1).traits().numbered_replies;
    // A link whose replies have no numbers cannot tell two that were swapped; no serial line swaps any.
    for (seed, (name, faults)) in
        (2..).zip(seldom().into_iter().filter(|(name, _)| numbered || *name != "reorder"))
    {
        for (to_device, to_host) in [(none, faults), (faults, none), (faults, faults)] {
            let stamped = stamps_under(kind, seed, to_device, to_host);
            seen += stamped.map_err(|Broken(why)| Broken(format!("{name}: {why}")))?;
        }
    }
    ensure!(seen > 2_000, "{seen} samples in all");
    Ok(())
}

/// One thing at a time, to a frame now and then.
fn seldom() -> [(&'static str, Faults); 7] {
    let none = Faults::NONE;
    [
        ("drop", Faults { drop: 0.05, ..none }),
        ("delay", Faults { delay: 0.03, delay_us: 7_000, ..none }),
        ("duplicate", Faults { duplicate: 0.05, ..none }),
        ("truncate", Faults { truncate: 0.05, ..none }),
        ("reorder", Faults { reorder: 0.03, ..none }),
        ("stall", Faults { stall: 0.02, stall_us: 9_000, ..none }),
        ("babble", Faults { babble: 0.05, ..none }),
    ]
}

fn late_is_not_fresh(kind: Kind) -> Result<(), Broken> {
    for delay_us in [12_000, 25_000, 60_000] {
        let (mut rig, traits) = made(kind);
        let mut session = Session::homed(&mut *rig, turned(&traits))?;
        session.rig.set_faults(Faults::NONE, Faults { delay: 1.0, delay_us, ..Faults::NONE });
        for tick in 0..400 {
            let now_us = session.now_us();
            let Ok(Some(sample)) = session.tick(vec3::ZERO) else { continue };
            let age_us = now_us - sample.t_us;
            // What was on its way before the fault began may still come in time.
            ensure!(
                tick < 3 || age_us + 1_000 >= delay_us.min(16_000),
                "{age_us} us old after {delay_us} us"
            );
        }
        ensure!(session.rig.counts().delayed > 5, "nothing was late: {:?}", session.rig.counts());
    }
    Ok(())
}

fn silence_is_reported(kind: Kind) -> Result<(), Broken> {
    let (mut rig, traits) = made(kind);
    let mut session = Session::homed(&mut *rig, turned(&traits))?;
    ask(&mut session, vec3::ZERO, 20)?;
    session.rig.set_faults(Faults::NONE, Faults { drop: 1.0, ..Faults::NONE });
    let (mut samples, mut timeouts) = (0, 0);
    for _ in 0..100 {
        match session.tick(vec3::ZERO) {
            Ok(sample) => samples += u32::from(sample.is_some()),
            Err(error) if error.kind() == DeviceErrorKind::Timeout => timeouts += 1,
            Err(error) => return Err(error.into()),
        }
    }
    ensure!(samples <= 1 && timeouts > 20, "{samples} samples and {timeouts} timeouts in a tenth of silence");
    session.rig.set_faults(Faults::NONE, Faults::NONE);
    let mut back = 0;
    for _ in 0..100 {
        back += u32::from(matches!(session.tick(vec3::ZERO), Ok(Some(_))));
    }
    ensure!(back > 30, "{back} samples in a tenth of a second after the silence");
    Ok(())
}

/// Everything that a link may do, one thing at a time, to every frame.
fn every_fault() -> [(&'static str, Faults); 9] {
    let none = Faults::NONE;
    [
        ("drop", Faults { drop: 1.0, ..none }),
        ("delay", Faults { delay: 1.0, delay_us: 15_000, ..none }),
        ("duplicate", Faults { duplicate: 1.0, ..none }),
        ("truncate", Faults { truncate: 1.0, ..none }),
        ("corrupt", Faults { corrupt: 1.0, ..none }),
        ("reorder", Faults { reorder: 1.0, ..none }),
        ("stall", Faults { stall: 0.1, stall_us: 30_000, ..none }),
        ("babble", Faults { babble: 1.0, ..none }),
        ("unplug", Faults { unplug: 1.0, unplug_us: 20_000, ..none }),
    ]
}

/// Longest that an exchange may keep the loop in virtual time, us: two writes that find no room, at a tick each, would be an overrun already.
const LONGEST_EXCHANGE_US: u64 = 2_000;

/// Longest median of an exchange on a sound link in memory: there is nothing to wait for, and a driver that sleeps is not seen in virtual time.
const MEDIAN_EXCHANGE: Duration = Duration::from_millis(1);

/// The median of some hundreds: a busy machine delays a few.
fn median_exchange(kind: Kind) -> Result<Duration, Broken> {
    let (mut rig, traits) = made(kind);
    let mut session = Session::homed(&mut *rig, turned(&traits))?;
    let mut times = Vec::new();
    for tick in 0..400 {
        session.tick(if tick % 7 < 5 { [1.0, 0.0, 0.5] } else { vec3::ZERO })?;
        times.push(session.last_wait());
    }
    times.sort_unstable();
    Ok(times[times.len() / 2])
}

fn exchanges_do_not_wait(kind: Kind) -> Result<(), Broken> {
    if kind.in_memory {
        let median = median_exchange(kind)?;
        ensure!(median < MEDIAN_EXCHANGE, "an exchange on a sound link takes {median:?} of real time");
    }
    for (name, faults) in every_fault() {
        for (to_device, to_host) in [(faults, Faults::NONE), (Faults::NONE, faults), (faults, faults)] {
            let (mut rig, traits) = made(kind);
            let mut session = Session::homed(&mut *rig, turned(&traits))?;
            session.rig.set_faults(to_device, to_host);
            for tick in 0..60 {
                let force_n = if tick % 7 < 5 { [1.0, 0.0, 0.5] } else { vec3::ZERO };
                // Errors are what the link deserves.
                let _ = session.tick(force_n);
            }
            let (virtual_us, real) = session.longest_wait();
            ensure!(virtual_us <= LONGEST_EXCHANGE_US, "{name}: an exchange took {virtual_us} us");
            // Not a measurement: what hangs is what is meant.
            ensure!(real < Duration::from_secs(10), "{name}: an exchange took {real:?}");
        }
    }
    Ok(())
}

fn zero_goes_at_once(kind: Kind) -> Result<(), Broken> {
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

fn zero_after_stop(kind: Kind) -> Result<(), Broken> {
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

fn nothing_before_arming(kind: Kind) -> Result<(), Broken> {
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

fn zero_after_the_loop(kind: Kind) -> Result<(), Broken> {
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

fn lost_homing(kind: Kind) -> Result<(), Broken> {
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
fn latched_stays(kind: Kind) -> Result<(), Broken> {
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

fn unplugged_is_gone(kind: Kind) -> Result<(), Broken> {
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
