//! The fault matrix: everything that may go wrong, on every device and transport, through the real loop with a controller on an organ that
//! the emulated hand leans on. From one seed, so that a run repeats.
//!
//! A run: open, home, arm, press until the hand is pushed back; then the fault, for some time; then a sound link again, with nobody touching
//! reset or arm; a loop that has latched then feels the hand leave the organ and press anew: what is armed inside renders nothing until it enters.
//! Written down is what the motors did to the hand, not what was sent.

mod outcome;
mod table;
mod wrong;

pub use outcome::{Ended, Run};
pub use table::{Table, csv};
pub use wrong::Wrong;

use crate::falcon::{LoaderFault, LoaderOptions};
use crate::fault::Faults;
use crate::rig::{Cut, FalconRig, Kind, Mishap, OpenError, Rig};
use crate::session::{self, Bench, TICK_US, with_loop};
use outcome::STALE_US;
use palpate_core::{Method, Organ, Phase, vec3};
use palpate_host::TickRecord;
use std::sync::atomic::{AtomicUsize, Ordering};
use wrong::{Dice, Plan, plan};

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
        way_is_sound: plan.to_device == Faults::NONE && !pulled,
        // A tick more: the last sample may have come with the tick of the fault.
        silent: silent_ticks > STALE_US / TICK_US + 1,
        checked_requests: traits.checked_requests,
        ..Run::with_nothing(kind.name, wrong, seed, limit_n)
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
        ended: if opened { Ended::Opened } else { Ended::Refused },
        largest_n: felt.largest_force_n,
        step_n: felt.largest_step_n,
        resumed: felt.largest_force_n > 0.0,
        ..Run::with_nothing(kind.name, Wrong::WrongEcho, dice.0, 0.0)
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
