//! The fault matrix: everything that may go wrong, on every device and transport, through the real loop with a controller on an organ that
//! the emulated hand leans on. From one seed, so that a run repeats.
//!
//! A run: open, home, arm, press until the hand is pushed back; then the fault, for some time; then a sound link again, with nobody touching
//! reset or arm; a loop that has latched then feels the hand leave the organ and press anew: what is armed inside renders nothing until it enters.
//! Written down is what the motors did to the hand, not what was sent.

use crate::falcon::{LoaderFault, LoaderOptions};
use crate::fault::Faults;
use crate::hosts::GENEROUS;
use crate::rig::{Cut, FalconRig, Kind, Mishap, OpenError, Rig};
use crate::session::{self, Bench, TICK_US, with_loop};
use core::fmt::{self, Write};
use palpate_core::{Fault, Method, Organ, Phase, vec3};
use palpate_host::TickRecord;
use std::sync::atomic::{AtomicUsize, Ordering};

/// What goes wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Wrong {
    /// Frames are lost, 1 to 40 ms.
    Drop,
    /// Nothing comes or goes for 60 ms.
    Silence,
    /// Replies (on the Falcon requests too) are 2 to 40 ms late, for up to 60 ms.
    Delay,
    /// Frames come twice, 1 to 40 ms.
    Duplicate,
    /// Frames end early, 1 to 40 ms.
    Truncate,
    /// A bit of each reply is flipped, 1 to 10 ms.
    CorruptReply,
    /// A bit of each request is flipped, 1 to 10 ms.
    CorruptRequest,
    /// Frames are overtaken by the next, 1 to 40 ms.
    Reorder,
    /// Nothing comes through for 3 to 60 ms, then all of it at once.
    Stall,
    /// Bytes that nobody asked for before each frame, 1 to 40 ms.
    Babble,
    /// The cable is pulled in the middle of a request, and put in again.
    UnplugMidFrame,
    /// The cable is pulled between two requests, and put in again.
    Replug,
    /// An encoder miscounts, by 0.5 to 40 mm at the handle.
    EncoderJump,
    /// The device forgets its homing.
    HomingLost,
    /// The device loses its power for a moment.
    PowerCycle,
    /// The boot loader echoes a wrong byte, stops, or never starts what it was given.
    WrongEcho,
    /// A transfer of USB is stalled.
    TransferStall,
    /// The cable is pulled, and the device loses its power with it.
    UnplugPower,
    /// A little of everything on the wire.
    Noise,
    /// The host's process is killed.
    HostKilled,
    /// The host's process stands still, and goes on later.
    HostPaused,
}

impl Wrong {
    /// All that happen in step. The others need USB ([`crate::bench`]) or processes ([`crate::hosts`]).
    pub const ALL: [Self; 16] = [
        Self::Drop,
        Self::Silence,
        Self::Delay,
        Self::Duplicate,
        Self::Truncate,
        Self::CorruptReply,
        Self::CorruptRequest,
        Self::Reorder,
        Self::Stall,
        Self::Babble,
        Self::UnplugMidFrame,
        Self::Replug,
        Self::EncoderJump,
        Self::HomingLost,
        Self::PowerCycle,
        Self::WrongEcho,
    ];

    /// Name in tables.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Drop => "drop",
            Self::Silence => "silence",
            Self::Delay => "delay",
            Self::Duplicate => "duplicate",
            Self::Truncate => "truncate",
            Self::CorruptReply => "corrupt reply",
            Self::CorruptRequest => "corrupt request",
            Self::Reorder => "reorder",
            Self::Stall => "stall",
            Self::Babble => "babble",
            Self::UnplugMidFrame => "unplug mid-frame",
            Self::Replug => "unplug, replug",
            Self::EncoderJump => "encoder jump",
            Self::HomingLost => "homing lost",
            Self::PowerCycle => "power cycle",
            Self::WrongEcho => "wrong firmware echo",
            Self::TransferStall => "transfer stalled",
            Self::UnplugPower => "unplug, power too",
            Self::Noise => "noise",
            Self::HostKilled => "host-killed",
            Self::HostPaused => "host-paused",
        }
    }

    /// Whether it can happen to a device: homing and power to one that homes, a boot loader to the Falcon.
    fn can_happen(self, kind: Kind) -> bool {
        match self {
            Self::HomingLost => (kind.make)(0).strike(Mishap::LoseHoming),
            Self::PowerCycle => (kind.make)(0).strike(Mishap::PowerCycle),
            Self::WrongEcho => kind.name == "falcon-memory",
            _ => true,
        }
    }
}

/// What a fault of the link is in one run.
#[derive(Debug, Clone, Copy, Default)]
struct Plan {
    to_device: Faults,
    to_host: Faults,
    ticks: u64,
}

/// A few numbers from a seed, none of which depends on how many were drawn before.
#[derive(Debug, Clone, Copy)]
struct Dice(u64);

impl Dice {
    /// From `low` to `high`, both included.
    fn draw(self, what: u64, low: u64, high: u64) -> u64 {
        low + crate::fault::split_mix(self.0, what) % (high - low + 1)
    }
}

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// The loop rode it out and renders on.
    RodeOn,
    /// A latched fault.
    Latched(Fault),
    /// The device is gone; the loop ended.
    Lost,
    /// The driver was not opened.
    Refused,
    /// It was opened all the same, without a force.
    Opened,
    /// The supervisor took the force away.
    Supervisor,
    /// The device did, and its own watchdog keeps it away.
    Watchdog,
    /// It did not come so far, or no further: what was waited for in vain.
    Missed(&'static str),
}

/// One run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Run {
    /// Name of the rig.
    pub rig: &'static str,
    /// What went wrong.
    pub wrong: Wrong,
    /// Its seed: with the rig's name and the fault it repeats the run.
    pub seed: u64,
    /// How it ended.
    pub ended: Ended,
    /// From the fault to the first tick without a sample, us.
    pub degraded_us: Option<u64>,
    /// From the fault to the tick that latched, or in which the device was said to be gone, us.
    pub detected_us: Option<u64>,
    /// From there to motors without a force, us.
    pub zero_us: Option<u64>,
    /// From the end of the fault to motors without a force, us; 0 if they had none before.
    pub mended_us: Option<u64>,
    /// Largest force at the motors from the fault on, N.
    pub largest_n: f32,
    /// Largest change of it by one command that was not zero, N.
    pub step_n: f32,
    /// Longest time for which it was beyond the profile's limit, us, to a tick.
    pub beyond_us: u64,
    /// The profile's limit and a step of the motors, N.
    pub limit_n: f32,
    /// The motors had a force again, or the loop left the fault it had latched, although nobody had reset and armed.
    pub resumed: bool,
    /// Requests got through to the motors all the time.
    way_is_sound: bool,
    /// Nothing came back for longer than the stale limit.
    silent: bool,
    checked_requests: bool,
}

/// Age at which a sample is a fault, us.
const STALE_US: u64 = 10_000;
/// Two ticks.
const REACTION_US: u64 = 2 * TICK_US;
/// From the end of a fault on the way to the device to the first zero that is understood, us: a pause of 3 ms, a request given up after 2 ms, one
/// that only ends a damaged line, and the ticks between.
const MENDED_US: u64 = 12_000;

impl Run {
    /// A run of which nothing is known yet; limit in N.
    pub(crate) const fn with_nothing(rig: &'static str, wrong: Wrong, seed: u64, limit_n: f32) -> Self {
        Self {
            rig,
            wrong,
            seed,
            ended: Ended::RodeOn,
            degraded_us: None,
            detected_us: None,
            zero_us: None,
            mended_us: None,
            largest_n: 0.0,
            step_n: 0.0,
            beyond_us: 0,
            limit_n,
            resumed: false,
            way_is_sound: true,
            silent: false,
            checked_requests: true,
        }
    }

    /// What of the limits it breaks.
    #[must_use]
    pub fn broken(&self) -> Option<&'static str> {
        let latched = matches!(self.ended, Ended::Latched(_) | Ended::Lost);
        if let Ended::Missed(what) = self.ended {
            return Some(what);
        }
        if self.silent && self.detected_us.is_none_or(|us| us > STALE_US) {
            return Some("silence was not detected within 10 ms");
        }
        // A cable that is out carries no zero, and a device without a watchdog keeps its force.
        if latched && self.way_is_sound && self.zero_us.is_none_or(|us| us > REACTION_US) {
            return Some("no zero two ticks after detection");
        }
        if matches!(self.ended, Ended::Latched(_))
            && !self.way_is_sound
            && self.mended_us.is_none_or(|us| us > MENDED_US)
        {
            return Some("no zero after the link was mended");
        }
        let is_late = |us: Option<u64>| us.is_none_or(|us| us > GENEROUS.as_micros() as u64);
        if matches!(self.wrong, Wrong::HostKilled | Wrong::HostPaused) && is_late(self.zero_us) {
            return Some("no zero for a host that is gone");
        }
        if self.ended == Ended::Watchdog && is_late(self.detected_us) {
            return Some("no latch by the device's watchdog");
        }
        let damaged = self.wrong == Wrong::CorruptRequest && !self.checked_requests;
        if self.largest_n > self.limit_n && !damaged {
            return Some("a force beyond the limit");
        }
        if self.beyond_us > MENDED_US {
            return Some("a force beyond the limit for more than 12 ms");
        }
        self.resumed.then_some("force without re-arming")
    }
}

/// What is watched from the fault on.
struct Watch {
    run: Run,
    struck_us: u64,
    /// When the fault was over.
    mended: Option<u64>,
    beyond_us: u64,
}

impl Watch {
    fn look(&mut self, bench: &Bench<'_, '_>, record: Option<&TickRecord>) {
        let (felt, run) = (bench.rig.felt(), &mut self.run);
        let off = felt.force_n == vec3::ZERO && felt.off_since_us.is_some();
        if let Some(record) = record {
            let since_us = record.t_us.saturating_sub(self.struck_us);
            if record.sample.is_none() {
                run.degraded_us.get_or_insert(since_us);
            }
            if let Phase::SafeZero(fault) = record.phase {
                run.ended = Ended::Latched(fault);
                run.detected_us.get_or_insert(since_us);
            } else if matches!(run.ended, Ended::Latched(_)) {
                run.resumed = true;
            }
        }
        self.beyond_us = if vec3::norm(felt.force_n) > run.limit_n { self.beyond_us + TICK_US } else { 0 };
        run.beyond_us = run.beyond_us.max(self.beyond_us);
        let off_us = felt.off_since_us.filter(|_| off);
        if let (Some(detected_us), Some(off_us)) = (run.detected_us, off_us) {
            run.zero_us.get_or_insert(off_us.saturating_sub(self.struck_us + detected_us));
            if let Some(mended_us) = self.mended {
                run.mended_us.get_or_insert(off_us.saturating_sub(mended_us));
            }
        }
        let was_zero = if run.way_is_sound { run.zero_us.is_some() } else { run.mended_us.is_some() };
        run.resumed |= was_zero && !off;
    }

    fn step(&mut self, bench: &mut Bench<'_, '_>) -> bool {
        match bench.step() {
            Ok(record) => self.look(bench, Some(&record)),
            Err(_) => {
                self.run.ended = Ended::Lost;
                let since_us = bench.now_us().saturating_sub(TICK_US + self.struck_us);
                self.run.detected_us.get_or_insert(since_us);
                self.look(bench, None);
                return false;
            }
        }
        true
    }
}

fn plan(wrong: Wrong, dice: Dice) -> Plan {
    let none = Faults::NONE;
    let ticks = dice.draw(1, 1, 40);
    let faults = match wrong {
        Wrong::Drop => Faults { drop: 1.0, ..none },
        Wrong::Silence => Faults { drop: 1.0, ..none },
        Wrong::Delay => Faults { delay: 1.0, delay_us: 1_000 * dice.draw(2, 2, 40), ..none },
        Wrong::Duplicate => Faults { duplicate: 1.0, ..none },
        Wrong::Truncate => Faults { truncate: 1.0, ..none },
        Wrong::CorruptReply | Wrong::CorruptRequest => Faults { corrupt: 1.0, ..none },
        Wrong::Reorder => Faults { reorder: 1.0, ..none },
        Wrong::Stall => Faults { stall: 1.0, stall_us: 1_000 * dice.draw(2, 3, 60), ..none },
        Wrong::Babble => Faults { babble: 1.0, ..none },
        _ => none,
    };
    let (to_device, to_host) = match (wrong, dice.draw(3, 0, 2)) {
        (Wrong::Silence, _) => (faults, faults),
        (Wrong::CorruptReply, _) | (_, 0) if wrong != Wrong::CorruptRequest => (none, faults),
        (Wrong::CorruptRequest, _) | (_, 1) => (faults, none),
        _ => (faults, faults),
    };
    let ticks = match wrong {
        Wrong::Silence => 60,
        Wrong::Delay => dice.draw(1, 1, 60),
        Wrong::CorruptReply | Wrong::CorruptRequest => dice.draw(1, 1, 10),
        // One of them is enough.
        Wrong::Stall => 1,
        _ => ticks,
    };
    Plan { to_device, to_host, ticks }
}

/// One run of one fault on one rig.
pub fn run(kind: Kind, wrong: Wrong, seed: u64, organ: &Organ<'_>) -> Result<Run, OpenError> {
    let dice = Dice(seed);
    if wrong == Wrong::WrongEcho {
        return Ok(load(kind, dice));
    }
    let mut rig = (kind.make)(seed);
    let traits = rig.traits();
    let limit_n = rig.profile().max_force_n + traits.motor_step_n;
    let plan = plan(wrong, dice);
    let silences = |faults: &Faults| faults.drop == 1.0 || faults.truncate == 1.0;
    let stalled_ticks = |faults: &Faults| if faults.stall > 0.0 { faults.stall_us / 1_000 } else { 0 };
    let silent_ticks = match (silences(&plan.to_device) || silences(&plan.to_host), wrong) {
        (true, _) => plan.ticks,
        (_, Wrong::Stall) => stalled_ticks(&plan.to_device).max(stalled_ticks(&plan.to_host)),
        // Until a tick finds out, or for good.
        (_, Wrong::UnplugMidFrame | Wrong::Replug | Wrong::PowerCycle) => u64::MAX,
        _ => 0,
    };
    let pulled = matches!(wrong, Wrong::UnplugMidFrame | Wrong::Replug);
    let run = Run {
        rig: kind.name,
        wrong,
        seed,
        ended: Ended::RodeOn,
        degraded_us: None,
        detected_us: None,
        zero_us: None,
        mended_us: None,
        largest_n: 0.0,
        step_n: 0.0,
        beyond_us: 0,
        limit_n,
        resumed: false,
        way_is_sound: plan.to_device == Faults::NONE && !pulled,
        // A tick more: the last sample may have come with the tick of the fault.
        silent: silent_ticks > STALE_US / TICK_US + 1,
        checked_requests: traits.checked_requests,
    };
    let depth_m = 1e-3 * dice.draw(4, 8, 18) as f32;
    let lead = dice.draw(5, 600, 720);
    let mut run = with_loop(&mut *rig, organ, Method::Energy, |bench| {
        let path = session::press(bench.rig, 0.006, depth_m);
        bench.rig.follow(path);
        bench.controls.arm();
        for _ in 0..lead {
            bench.step()?;
        }
        bench.rig.forget();
        let struck_us = bench.now_us();
        let mut watch = Watch { run, struck_us, mended: None, beyond_us: 0 };
        strike(bench, wrong, &plan, dice);
        let ended_early = (0..plan.ticks.max(1)).any(|_| !watch.step(bench));
        if !pulled {
            bench.rig.set_faults(Faults::NONE, Faults::NONE);
        }
        if !ended_early {
            // What is stalled or late comes out with the fault long over.
            let after = stalled_ticks(&plan.to_device) + plan.to_device.delay_us / 1_000;
            let _ = (0..after).any(|_| !watch.step(bench));
            watch.mended = Some(bench.now_us());
            let goes_on = (0..200).all(|_| watch.step(bench));
            if goes_on && matches!(watch.run.ended, Ended::Latched(_)) {
                let path = session::press_anew(bench.rig, 0.006, depth_m);
                bench.rig.follow(path);
                let _ = (0..session::ANEW_TICKS).any(|_| !watch.step(bench));
            }
        }
        bench.end();
        let felt = bench.rig.felt();
        (watch.run.largest_n, watch.run.step_n) = (felt.largest_force_n, felt.largest_step_n);
        Ok::<Run, OpenError>(watch.run)
    })??;
    if run.ended == Ended::Lost {
        let unplugged_ticks = dice.draw(6, 30, 100);
        let now_us = rig.now_us() + unplugged_ticks * TICK_US;
        rig.advance(now_us);
        rig.replug();
        run.resumed |= resumes(&mut *rig, organ)?;
        // What the motors did meanwhile nobody here could change; the driver that is opened next takes it away before it says that it is open.
        run.mended_us = None;
    }
    Ok(run)
}

fn strike(bench: &mut Bench<'_, '_>, wrong: Wrong, plan: &Plan, dice: Dice) {
    let sign = if dice.draw(7, 0, 1) == 0 { 1.0 } else { -1.0 };
    match wrong {
        Wrong::UnplugMidFrame => bench.rig.unplug(Cut::MidFrame),
        Wrong::Replug => bench.rig.unplug(Cut::Between),
        Wrong::EncoderJump => {
            let axis = dice.draw(8, 0, 2) as usize;
            let by_m = sign * 0.5e-3 * dice.draw(9, 1, 80) as f32;
            bench.rig.strike(Mishap::EncoderJump { axis, by_m });
        }
        Wrong::HomingLost => {
            bench.rig.strike(Mishap::LoseHoming);
        }
        Wrong::PowerCycle => {
            bench.rig.strike(Mishap::PowerCycle);
        }
        _ => bench.rig.set_faults(plan.to_device, plan.to_host),
    }
}

/// Opened anew and pressed, but neither reset nor armed: whether there is a force all the same.
fn resumes(rig: &mut dyn Rig, organ: &Organ<'_>) -> Result<bool, OpenError> {
    with_loop(rig, organ, Method::Energy, |bench| {
        let path = session::press(bench.rig, 0.006, 0.014);
        bench.rig.follow(path);
        let mut forced = bench.rig.felt().force_n != vec3::ZERO;
        bench.rig.forget();
        for _ in 0..500 {
            forced |= bench.step()?.phase != Phase::Disarmed;
        }
        let felt = bench.rig.felt();
        Ok(forced || felt.largest_force_n > 0.0)
    })?
}

/// A boot loader that does not do as it should, once or always.
fn load(kind: Kind, dice: Dice) -> Run {
    let at = dice.draw(2, 0, 400) as usize;
    let fault = match dice.draw(1, 0, 3) {
        0 | 1 => LoaderFault::WrongEcho { at },
        2 => LoaderFault::FallsSilent { at },
        _ => LoaderFault::NeverStarts,
    };
    let tries = if dice.draw(3, 0, 3) == 0 { 1_000 } else { dice.draw(4, 1, 2) as u32 };
    let mut rig =
        FalconRig::silent(dice.0, LoaderOptions { leading_zero: false, fault: Some((fault, tries)) });
    let opened = {
        let workspace = rig.profile().workspace;
        rig.open(workspace).is_ok()
    };
    let felt = rig.felt();
    Run {
        rig: kind.name,
        wrong: Wrong::WrongEcho,
        seed: dice.0,
        ended: if opened { Ended::Opened } else { Ended::Refused },
        degraded_us: None,
        detected_us: None,
        zero_us: None,
        mended_us: None,
        largest_n: felt.largest_force_n,
        step_n: felt.largest_step_n,
        beyond_us: 0,
        limit_n: 0.0,
        resumed: felt.largest_force_n > 0.0,
        way_is_sound: true,
        silent: false,
        checked_requests: true,
    }
}

/// What to run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Size {
    /// Runs on virtual time, over all rigs and faults in turn.
    pub in_memory: usize,
    /// Runs over a real transport.
    pub real: usize,
    /// Seed of all of them.
    pub seed: u64,
}

/// Runs the matrix on some threads; `progress` is told how many runs are done.
///
/// # Panics
///
/// If a rig cannot be opened where nothing is wrong with it.
#[must_use]
pub fn matrix(kinds: &[Kind], size: Size, progress: &(dyn Fn(usize, usize) + Sync)) -> Vec<Run> {
    let cells = |in_memory: bool| -> Vec<(Kind, Wrong)> {
        let wanted = kinds.iter().filter(|kind| kind.in_memory == in_memory);
        wanted
            .flat_map(|kind| Wrong::ALL.map(|wrong| (*kind, wrong)))
            .filter(|(kind, wrong)| wrong.can_happen(*kind))
            .collect()
    };
    let mut work = Vec::new();
    for (cells, count) in [(cells(true), size.in_memory), (cells(false), size.real)] {
        work.extend(cells.iter().cycle().take(count).copied());
    }
    let (next, done) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let threads = std::thread::available_parallelism().map_or(1, usize::from).min(8);
    let mut runs: Vec<(usize, Run)> = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads)
            .map(|_| {
                scope.spawn(|| {
                    let blob = session::golden_organ();
                    let organ = Organ::read(blob.bytes()).expect("a test of the core reads it");
                    let mut mine = Vec::new();
                    loop {
                        let index = next.fetch_add(1, Ordering::Relaxed);
                        let Some((kind, wrong)) = work.get(index) else { return mine };
                        let seed = crate::fault::split_mix(size.seed, index as u64);
                        let ran = run(*kind, *wrong, seed, &organ);
                        mine.push((index, ran.expect("nothing is wrong with it before the fault")));
                        progress(done.fetch_add(1, Ordering::Relaxed) + 1, work.len());
                    }
                })
            })
            .collect();
        workers.into_iter().flat_map(|worker| worker.join().expect("a run does not panic")).collect()
    });
    runs.sort_by_key(|(index, _)| *index);
    runs.into_iter().map(|(_, run)| run).collect()
}

/// One line of the table: all runs of one fault on one rig.
struct Row<'a> {
    rig: &'static str,
    wrong: Wrong,
    runs: Vec<&'a Run>,
}

impl Row<'_> {
    fn count(&self, is: impl Fn(&Run) -> bool) -> usize {
        self.runs.iter().filter(|run| is(run)).count()
    }

    /// The largest of some times, ms; a dash if there is none.
    fn most_ms(&self, of: impl Fn(&Run) -> Option<u64>) -> String {
        let most = self.runs.iter().filter_map(|run| of(run)).max();
        most.map_or_else(|| "-".into(), |us| format!("{:.1}", us as f32 / 1e3))
    }

    fn most(&self, of: impl Fn(&Run) -> f32) -> f32 {
        self.runs.iter().fold(0.0, |most, run| most.max(of(run)))
    }

    /// How they ended, and how often.
    fn ends(&self) -> String {
        let mut ends: Vec<(String, usize)> = Vec::new();
        for run in &self.runs {
            let name = match run.ended {
                Ended::RodeOn => "rode on".into(),
                Ended::Latched(fault) => fault.name().into(),
                Ended::Lost => "loop ended".into(),
                Ended::Refused => "not opened".into(),
                Ended::Opened => "opened".into(),
                Ended::Supervisor => "supervisor".into(),
                Ended::Watchdog => "device's watchdog".into(),
                Ended::Missed(what) => what.into(),
            };
            match ends.iter_mut().find(|(known, _)| *known == name) {
                Some((_, count)) => *count += 1,
                None => ends.push((name, 1)),
            }
        }
        ends.sort_by_key(|(_, count)| core::cmp::Reverse(*count));
        let parts: Vec<String> = ends.iter().map(|(name, count)| format!("{name} {count}")).collect();
        parts.join(", ")
    }
}

/// The runs as a table for people; Markdown.
#[derive(Debug)]
pub struct Table<'a>(pub &'a [Run]);

impl fmt::Display for Table<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut rows: Vec<Row<'_>> = Vec::new();
        for run in self.0 {
            match rows.iter_mut().find(|row| row.rig == run.rig && row.wrong == run.wrong) {
                Some(row) => row.runs.push(run),
                None => rows.push(Row { rig: run.rig, wrong: run.wrong, runs: vec![run] }),
            }
        }
        rows.sort_by_key(|row| (row.rig, row.wrong));
        f.write_str(
            "| device, link | fault | runs | no sample after, ms | detected after, ms | then zero after, ms | zero after the link is back, ms | \
             largest force, N | beyond the limit for, ms | largest step, N | ended | again without arming |\n\
             |---|---|---|---|---|---|---|---|---|---|---|---|\n",
        )?;
        for row in &rows {
            writeln!(
                f,
                "| {} | {} | {} | {} | {} | {} | {} | {:.2} | {} | {:.2} | {} | {} |",
                row.rig,
                row.wrong.name(),
                row.runs.len(),
                row.most_ms(|run| run.degraded_us),
                row.most_ms(|run| run.detected_us),
                row.most_ms(|run| run.zero_us.filter(|_| run.way_is_sound)),
                row.most_ms(|run| run.mended_us.filter(|_| !run.way_is_sound)),
                row.most(|run| run.largest_n),
                row.most_ms(|run| Some(run.beyond_us).filter(|us| *us > 0)),
                row.most(|run| run.step_n),
                row.ends(),
                row.count(|run| run.resumed),
            )?;
        }
        Ok(())
    }
}

/// The runs one by one, for a machine: comma-separated values.
#[must_use]
pub fn csv(runs: &[Run]) -> String {
    let mut text = String::from(
        "rig,fault,seed,ended,degraded_us,detected_us,zero_us,mended_us,largest_n,step_n,beyond_us,resumed,broken\n",
    );
    // Names have commas.
    let quoted = |text: &str| format!("\"{}\"", text.replace('"', "\"\""));
    let number = |us: Option<u64>| us.map_or_else(String::new, |us| us.to_string());
    for run in runs {
        // Writing to a String does not fail.
        let _ = writeln!(
            text,
            "{},{},{},{},{},{},{},{},{},{},{},{},{}",
            run.rig,
            quoted(run.wrong.name()),
            run.seed,
            quoted(&format!("{:?}", run.ended)),
            number(run.degraded_us),
            number(run.detected_us),
            number(run.zero_us),
            number(run.mended_us),
            run.largest_n,
            run.step_n,
            run.beyond_us,
            run.resumed,
            quoted(run.broken().unwrap_or(""))
        );
    }
    text
}
