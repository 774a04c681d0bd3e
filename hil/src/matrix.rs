//! The fault matrix: everything that may go wrong, on every device and transport, through the real loop with a controller on an organ that
//! the emulated hand leans on. From one seed, so that a run repeats.
//!
//! A run: open, home, arm, press until the hand is pushed back, as hard as the organ does it; then the fault, for some time; then a sound link again, with nobody touching
//! reset or arm; a loop that has latched then feels the hand leave the organ and press anew: what is armed inside renders nothing until it enters.
//! Written down is what the motors did to the hand, not what was sent.

mod beside;
mod lead;
mod outcome;
mod table;
mod watch;
mod wrong;

pub use outcome::{Ended, Run};
pub use table::{Table, csv};
pub use wrong::Wrong;

use crate::falcon::{LoaderFault, LoaderOptions};
use crate::fault::Faults;
use crate::rig::{Cut, FalconRig, Kind, Mishap, OpenError, Rig};
use crate::session::{self, Bench, TICK_US, with_loop};
use beside::Beside;
use lead::lead;
use palpate_core::{Method, Organ, Phase, vec3};
use std::sync::atomic::{AtomicUsize, Ordering};
use watch::Watch;
use wrong::{Dice, Stage, plan};

/// Fastest change of the force at the motors, N/s: the controller's limit, and the steps of the motors.
const SLEW_N_PER_S: f32 = 1_050.0;

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
    // Where nothing is numbered, a reply that was held back cannot be told from that to a newer request, if others were lost or doubled: docs/safety.md, section 6.
    let unknown_us = if wrong == Wrong::Mixed && !traits.numbered_replies { plan.reply_held_us() } else { 0 };
    // Late requests come closer together than they were sent; a board that has forgotten its force gets all of it at once; and damage is what it is.
    let has_slew = plan.requests_are_in_time() && !matches!(wrong, Wrong::CorruptRequest | Wrong::PowerCycle);
    let pulled = matches!(wrong, Wrong::UnplugMidFrame | Wrong::Replug);
    let run = Run {
        way_is_sound: plan.way_is_sound() && !pulled,
        checked_requests: traits.checked_requests,
        slew_n_per_s: has_slew.then_some(SLEW_N_PER_S),
        ..Run::with_nothing(kind.name, wrong, seed, limit_n)
    };
    let depth_m = 1e-3 * dice.draw(4, 8, 18) as f32;
    let lead_ticks = dice.draw(5, 600, 720);
    let mut beside = Beside::of(&*rig, organ)?;
    let mut run = with_loop(&mut *rig, organ, Method::Energy, |bench| {
        let path = session::press(bench.rig, 0.006, depth_m);
        bench.rig.follow(path);
        bench.controls.arm();
        let led = lead(bench, &mut beside, lead_ticks)?;
        bench.rig.forget();
        if wrong == Wrong::EncoderJump {
            beside.go_by_encoders();
        }
        let run = Run { flaw: led.flaw, off_n: Some(led.off_n), ..run };
        let mut watch = Watch::new(bench, beside, run, led.newest_us, unknown_us);
        let before = struck(bench.rig);
        let [first, second] = &plan.stages;
        strike(bench, wrong, first, dice);
        let mut ended_early = (0..first.ticks.max(1)).any(|_| !watch.step(bench));
        if !ended_early && second.ticks > 0 {
            bench.rig.set_faults(second.to_device, second.to_host);
            ended_early = (0..second.ticks).any(|_| !watch.step(bench));
        }
        if plan.is_of_frames() {
            let after = struck(bench.rig);
            watch.note_struck([0, 1].map(|way| after[way] - before[way]));
        }
        if !pulled {
            bench.rig.set_faults(Faults::NONE, Faults::NONE);
        }
        if !ended_early {
            // What is stalled or late comes out with the fault long over.
            let _ = (0..plan.after_ticks()).any(|_| !watch.step(bench));
            watch.mend(bench.now_us());
            let goes_on = (0..200).all(|_| watch.step(bench));
            if goes_on && matches!(watch.run().ended, Ended::Latched(_)) {
                let path = session::press_anew(bench.rig, 0.006, depth_m);
                bench.rig.follow(path.clone());
                let stays = (0..session::ANEW_TICKS).all(|_| watch.step(bench));
                watch.note_felt(&bench.rig.felt());
                // A device that has lost its place has to be homed first.
                if stays && watch.is_homed() && !wrong.loses_place() {
                    bench.rig.follow(path);
                    watch.press_again(bench);
                }
                bench.end();
                watch.note_end(&bench.rig.felt());
                return Ok::<Run, OpenError>(*watch.run());
            }
        }
        bench.end();
        if !ended_early && !pulled && watch.run().ended != Ended::Lost {
            watch.note_end(&bench.rig.felt());
        }
        watch.note_felt(&bench.rig.felt());
        Ok(*watch.run())
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

/// Frames that were struck so far, on the way to the device and on the way back.
fn struck(rig: &dyn Rig) -> [u64; 2] {
    rig.counts_each().map_or([rig.counts().total(), 0], |counts| counts.map(|counts| counts.total()))
}

fn strike(bench: &mut Bench<'_, '_>, wrong: Wrong, stage: &Stage, dice: Dice) {
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
            // While it starts anew nobody answers.
            bench.rig.set_faults(stage.to_device, stage.to_host);
        }
        _ => bench.rig.set_faults(stage.to_device, stage.to_host),
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
        steepest_n_per_s: felt.steepest_n_per_s,
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
