//! The fault matrix: every fault on every device and transport, through the real loop and controller, with
//! the emulated hand pressing on an organ. All runs follow from one seed.
//!
//! A run: open, home, arm, and press until the organ pushes the hand back. Then the fault is injected for
//! some time. Then the link is fault-free again without a reset or arming. If the loop has latched, the hand
//! leaves the organ and presses again, because a controller that is armed inside renders nothing until the
//! hand enters. The record holds the forces of the motors on the hand, not the commands sent.

mod approach;
mod ended;
mod monitor;
mod outcome;
mod plan;
mod reference;
mod table;

pub use ended::Ended;
pub use outcome::{MAX_TIME_TO_ZERO, Run};
pub use table::{Table, csv};

use crate::falcon::{LoaderFault, LoaderOptions};
use crate::fault::{FaultKind, Faults};
use crate::rig::{FalconRig, OpenError, Rig, RigKind};
use crate::session::{self, Bench, with_loop};
use crate::tick::TICK_US;
use approach::approach;
use monitor::RunMonitor;
use palpate_core::{Method, Organ, Phase, vec3};
use plan::{Draws, Stage, plan};
use reference::ReferenceController;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Largest rate of change of the force at the motors, N/s: the controller's slew limit and the steps of the
/// motors.
const SLEW_N_PER_S: f32 = 1_050.0;

/// One run of one fault on one rig.
pub fn run(kind: RigKind, fault: FaultKind, seed: u64, organ: &Organ<'_>) -> Result<Run, OpenError> {
    let draws = Draws(seed);
    if fault == FaultKind::WrongEcho {
        return Ok(load(kind, draws));
    }
    let mut rig = (kind.make)(seed);
    let traits = rig.traits();
    let limit_n = rig.profile().max_force_n + traits.motor_step_n;
    let plan = plan(fault, draws);
    // Without numbered replies a delayed reply looks like one to a newer request if others were lost or
    // duplicated: docs/safety.md, section 6.
    let unknown_age_us =
        if fault == FaultKind::Mixed && !traits.numbered_replies { plan.max_reply_delay_us() } else { 0 };
    // Delayed requests arrive closer together than they were sent. After a power cycle the whole force
    // returns in one step. Corrupted requests are arbitrary. None of these is judged by the slew limit.
    let has_slew =
        plan.requests_undelayed() && !matches!(fault, FaultKind::CorruptRequest | FaultKind::PowerCycle);
    let pulled = matches!(fault, FaultKind::UnplugMidFrame | FaultKind::Replug);
    let run = Run {
        request_path_ok: plan.request_path_ok() && !pulled,
        checked_requests: traits.checked_requests,
        behind_library: traits.behind_library,
        slew_n_per_s: has_slew.then_some(SLEW_N_PER_S),
        ..Run::empty(kind.name, fault, seed, limit_n)
    };
    let depth_m = 1e-3 * draws.draw(4, 8, 18) as f32;
    let approach_ticks = draws.draw(5, 600, 720);
    let mut run = with_loop(&mut *rig, organ, Method::Energy, |bench| {
        let mut reference = ReferenceController::of(bench, organ)?;
        let path = session::press(bench.rig, 0.006, depth_m);
        bench.rig.follow(path);
        bench.controls.arm();
        let approach = approach(bench, &mut reference, approach_ticks)?;
        bench.rig.reset_record();
        if fault == FaultKind::EncoderJump {
            reference.use_encoders();
        }
        let run =
            Run { observed_violation: approach.violation, error_before_n: Some(approach.error_n), ..run };
        let mut monitor = RunMonitor::new(bench, reference, run, approach.newest_us, unknown_age_us);
        let before = injected_frames(bench.rig);
        let [first, second] = &plan.stages;
        inject(bench, fault, first, draws);
        let mut ended_early = (0..first.ticks.max(1)).any(|_| !monitor.step(bench));
        if !ended_early && second.ticks > 0 {
            bench.rig.set_faults(second.to_device, second.to_host);
            ended_early = (0..second.ticks).any(|_| !monitor.step(bench));
        }
        if plan.targets_frames() {
            let after = injected_frames(bench.rig);
            monitor.record_injected([0, 1].map(|way| after[way] - before[way]));
        }
        if !pulled {
            bench.rig.set_faults(Faults::NONE, Faults::NONE);
        }
        if !ended_early {
            // Stalled and delayed frames arrive after the end of the fault.
            let _ = (0..plan.drain_ticks()).any(|_| !monitor.step(bench));
            monitor.end_fault(bench.now_us());
            let goes_on = (0..200).all(|_| monitor.step(bench));
            if goes_on && matches!(monitor.run().ended, Ended::Latched(_)) {
                let path = session::press_again(bench.rig, 0.006, depth_m);
                bench.rig.follow(path.clone());
                let stays = (0..session::PRESS_AGAIN_TICKS).all(|_| monitor.step(bench));
                monitor.record_forces(&bench.rig.force_record());
                // A device that has lost its homing has to be homed first.
                if stays && monitor.is_homed() && !fault.loses_homing() {
                    bench.rig.follow(path);
                    monitor.reset_and_press(bench);
                }
                bench.end();
                monitor.record_end(&bench.rig.force_record());
                return Ok::<Run, OpenError>(*monitor.run());
            }
        }
        bench.end();
        if !ended_early && !pulled && monitor.run().ended != Ended::Lost {
            monitor.record_end(&bench.rig.force_record());
        }
        monitor.record_forces(&bench.rig.force_record());
        Ok(*monitor.run())
    })??;
    if run.ended == Ended::Lost {
        let unplugged_ticks = draws.draw(6, 30, 100);
        let now_us = rig.now_us() + unplugged_ticks * TICK_US;
        rig.advance(now_us);
        rig.replug();
        run.resumed |= resumes(&mut *rig, organ)?;
        // The host cannot influence the motors while the cable is out. The next driver removes the force
        // while it opens.
        run.zero_after_fault_us = None;
    }
    Ok(run)
}

/// Counts of faulty frames so far, to the device and to the host.
fn injected_frames(rig: &dyn Rig) -> [u64; 2] {
    rig.counts_each().map_or([rig.counts().total(), 0], |counts| counts.map(|counts| counts.total()))
}

fn inject(bench: &mut Bench<'_, '_>, fault: FaultKind, stage: &Stage, draws: Draws) {
    if fault == FaultKind::EncoderJump {
        let sign = if draws.draw(7, 0, 1) == 0 { 1.0 } else { -1.0 };
        let axis = draws.draw(8, 0, 2) as usize;
        bench.rig.jump_encoder(axis, sign * 0.5e-3 * draws.draw(9, 1, 80) as f32);
        return;
    }
    bench.rig.inject(fault);
    // A device that restarts does not answer meanwhile.
    if stage.to_device != Faults::NONE || stage.to_host != Faults::NONE {
        bench.rig.set_faults(stage.to_device, stage.to_host);
    }
}

/// Opens the device and presses without a reset or arming. Returns whether there is a force.
fn resumes(rig: &mut dyn Rig, organ: &Organ<'_>) -> Result<bool, OpenError> {
    with_loop(rig, organ, Method::Energy, |bench| {
        let path = session::press(bench.rig, 0.006, 0.014);
        bench.rig.follow(path);
        let mut forced = bench.rig.force_record().force_n != vec3::ZERO;
        bench.rig.reset_record();
        for _ in 0..500 {
            forced |= bench.step()?.phase != Phase::Disarmed;
        }
        let felt = bench.rig.force_record();
        Ok(forced || felt.largest_force_n > 0.0)
    })?
}

/// A faulty boot loader, for some loads or for all.
fn load(kind: RigKind, draws: Draws) -> Run {
    let at = draws.draw(2, 0, 400) as usize;
    let fault = match draws.draw(1, 0, 3) {
        0 | 1 => LoaderFault::WrongEcho { at },
        2 => LoaderFault::FallsSilent { at },
        _ => LoaderFault::NeverStarts,
    };
    let tries = if draws.draw(3, 0, 3) == 0 { 1_000 } else { draws.draw(4, 1, 2) as u32 };
    let mut rig = FalconRig::without_firmware(
        draws.0,
        LoaderOptions { leading_zero: false, fault: Some((fault, tries)) },
    );
    let opened = {
        let workspace = rig.profile().workspace;
        rig.open(workspace).is_ok()
    };
    let felt = rig.force_record();
    Run {
        ended: if opened { Ended::Opened } else { Ended::Refused },
        largest_n: felt.largest_force_n,
        step_n: felt.largest_step_n,
        steepest_n_per_s: felt.steepest_n_per_s,
        resumed: felt.largest_force_n > 0.0,
        ..Run::empty(kind.name, FaultKind::WrongEcho, draws.0, 0.0)
    }
}

/// Size of the matrix.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Size {
    /// Number of runs on virtual time, over all rigs and faults in turn.
    pub in_memory: usize,
    /// Number of runs over a real transport.
    pub real: usize,
    /// Seed of all runs.
    pub seed: u64,
}

/// Runs the matrix on several threads; `progress` receives the number of finished runs and the total.
///
/// # Panics
///
/// If a rig cannot be opened before the fault.
#[must_use]
pub fn matrix(kinds: &[RigKind], size: Size, progress: &(dyn Fn(usize, usize) + Sync)) -> Vec<Run> {
    let cells = |in_memory: bool| -> Vec<(RigKind, FaultKind)> {
        let selected = kinds.iter().filter(|kind| kind.in_memory == in_memory);
        selected
            .flat_map(|kind| FaultKind::ALL.map(|fault| (*kind, fault)))
            .filter(|(kind, fault)| fault.applies_to(*kind))
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
                    let organ = Organ::read(blob.bytes()).expect("the golden blob is valid");
                    let mut own_runs = Vec::new();
                    loop {
                        let index = next.fetch_add(1, Ordering::Relaxed);
                        let Some((kind, fault)) = work.get(index) else { return own_runs };
                        let seed = crate::fault::split_mix(size.seed, index as u64);
                        let ran = run(*kind, *fault, seed, &organ);
                        own_runs.push((index, ran.expect("the rig opens before the fault")));
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
