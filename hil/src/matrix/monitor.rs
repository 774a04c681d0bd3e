//! Observes a run from the fault on, tick by tick.

use super::ended::Ended;
use super::outcome::{Run, STALE_US};
use super::reference::{ForcePair, ReferenceController};
use crate::fault::FaultKind;
use crate::force_record::ForceRecord;
use crate::session::{self, Bench};
use crate::tick::TICK_US;
use palpate_core::{Phase, vec3};
use palpate_host::TickRecord;
use palpate_host::device::DeviceState;

/// Time within which a reply from before a loss of homing may still arrive, us.
const IN_FLIGHT_US: u64 = 4 * TICK_US;

/// Time from the end of a fault until the force is the organ's again, us: links with 40 ms of delay have
/// drained, and the slew limit has let the force rise.
const SETTLING_US: u64 = 60_000;

/// Tick of arming after the reset at [`session::LIFTED_TICKS`]: the time that a new session of the device
/// link takes, and far less than that of a person.
const ARM_TICK: u64 = session::LIFTED_TICKS + 30;

/// State of the run.
pub(super) struct RunMonitor<'o> {
    run: Run,
    organ: ReferenceController<'o>,
    fault_us: u64,
    /// End of the fault.
    fault_end_us: Option<u64>,
    over_limit_us: u64,
    /// Time of the newest sample of the loop: the driver's stamp, but no later than the rig's time of
    /// reception.
    newest_us: u64,
    /// Age from which a sample is stale, us.
    stale_us: u64,
    device: DeviceState,
}

impl<'o> RunMonitor<'o> {
    /// Starts to observe. `newest_us` is the time of the newest sample so far, `unknown_age_us` the
    /// uncertainty of the age of a sample.
    pub(super) fn new(
        bench: &Bench<'_, '_>,
        organ: ReferenceController<'o>,
        run: Run,
        newest_us: Option<u64>,
        unknown_age_us: u64,
    ) -> Self {
        Self {
            run,
            organ,
            fault_us: bench.now_us(),
            fault_end_us: None,
            over_limit_us: 0,
            newest_us: newest_us.unwrap_or(0),
            stale_us: STALE_US + unknown_age_us,
            device: DeviceState::Homed,
        }
    }

    /// Whether the device was homed in the last tick.
    pub(super) fn is_homed(&self) -> bool {
        self.device == DeviceState::Homed
    }

    pub(super) const fn run(&self) -> &Run {
        &self.run
    }

    /// Marks the end of the fault.
    pub(super) const fn end_fault(&mut self, now_us: u64) {
        self.fault_end_us = Some(now_us);
    }

    /// Records the faulty frames. A frame fault without any is a violation.
    pub(super) fn record_injected(&mut self, frames: [u64; 2]) {
        self.run.injected = Some(frames);
        if frames == [0; 2] {
            self.set_violation("the fault affected no frame");
        }
    }

    /// Judges the record after the end of the loop on a fault-free link.
    pub(super) fn record_end(&mut self, felt: &ForceRecord) {
        if felt.force_n != vec3::ZERO || felt.off_since_us.is_none() {
            self.set_violation("a force after the end of the loop");
        }
    }

    /// Copies the extrema of the force on the hand.
    pub(super) const fn record_forces(&mut self, felt: &ForceRecord) {
        self.run.largest_n = felt.largest_force_n;
        self.run.step_n = felt.largest_step_n;
        self.run.steepest_n_per_s = felt.steepest_n_per_s;
    }

    /// Resets and arms above the organ and presses again as [`session::press_again`] does. The force must be
    /// the organ's as before the fault.
    pub(super) fn reset_and_press(&mut self, bench: &mut Bench<'_, '_>) {
        let mut last = None;
        for tick in 0..session::PRESS_AGAIN_TICKS {
            let forces = self.organ.compare(bench);
            match tick {
                session::LIFTED_TICKS => bench.controls.reset(),
                ARM_TICK => {
                    bench.controls.arm();
                    self.organ.arm();
                }
                tick if tick > ARM_TICK => {
                    self.compare(&forces, "the force is not the organ's after reset and arming")
                }
                _ => {}
            }
            let Ok(record) = bench.step() else {
                return self.set_violation("the device is lost after the reset");
            };
            let is_reset = (session::LIFTED_TICKS + 2..ARM_TICK).contains(&tick);
            if is_reset && record.phase != Phase::Disarmed {
                self.set_violation("not disarmed after the reset");
            }
            last = Some(record.phase);
        }
        if last != Some(Phase::Active) {
            self.set_violation("arming failed after the reset");
        }
    }

    fn set_violation(&mut self, what: &'static str) {
        self.run.observed_violation.get_or_insert(what);
    }

    /// Checks that the loop has the right age of its samples and latches stale ones.
    fn check_age(&mut self, record: &TickRecord, last_received_us: Option<u64>) {
        if let Some(sample) = &record.sample {
            let age_us = |taken_us: u64| record.t_us.saturating_sub(taken_us);
            let taken_us = last_received_us.map_or(sample.t_us, |us| sample.t_us.min(us));
            let stale_us = self.stale_us;
            let is_fresh = |taken_us| age_us(taken_us) < stale_us;
            if age_us(sample.t_us) < STALE_US && !is_fresh(taken_us) {
                self.set_violation("a late reply was taken for a fresh one");
            }
            // The loop treats a stale sample as no sample.
            if is_fresh(taken_us) {
                self.newest_us = self.newest_us.max(taken_us);
            }
        }
        let is_stale = record.t_us.saturating_sub(self.newest_us) >= self.stale_us;
        if is_stale && !matches!(record.phase, Phase::SafeZero(_)) {
            self.set_violation("the newest sample was stale and nothing was latched");
        }
    }

    /// Checks that a device without homing gives no samples before it is homed or opened again.
    fn check_homing(&mut self, record: &TickRecord) {
        let lost = matches!(self.run.fault, FaultKind::HomingLost | FaultKind::PowerCycle);
        if lost && record.sample.is_some() && record.t_us >= self.fault_us + IN_FLIGHT_US {
            self.set_violation("samples of a device that is not homed");
        }
    }

    /// Checks that after a recovered fault the force is the organ's again.
    fn check_force(&mut self, bench: &Bench<'_, '_>) {
        let forces = self.organ.compare(bench);
        let is_over = self.fault_end_us.is_some_and(|us| bench.now_us() >= us + SETTLING_US);
        if is_over && self.run.ended == Ended::Recovered {
            self.compare(&forces, "the force is not the organ's after recovery");
        }
    }

    fn compare(&mut self, forces: &ForcePair, violation: &'static str) {
        self.run.error_after_n = Some(self.run.error_after_n.unwrap_or(0.0).max(forces.error_n()));
        if forces.violation().is_some() {
            self.set_violation(violation);
        }
    }

    fn update(&mut self, bench: &Bench<'_, '_>, record: Option<&TickRecord>) {
        if let Some(record) = record {
            self.device = record.device;
            self.check_age(record, bench.last_received_us());
            self.check_homing(record);
        }
        let (felt, run) = (bench.rig.force_record(), &mut self.run);
        let off = felt.force_n == vec3::ZERO && felt.off_since_us.is_some();
        if let Some(record) = record {
            let since_us = record.t_us.saturating_sub(self.fault_us);
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
        self.over_limit_us =
            if vec3::norm(felt.force_n) > run.limit_n { self.over_limit_us + TICK_US } else { 0 };
        run.over_limit_us = run.over_limit_us.max(self.over_limit_us);
        let off_us = felt.off_since_us.filter(|_| off);
        if let (Some(detected_us), Some(off_us)) = (run.detected_us, off_us) {
            run.zero_us.get_or_insert(off_us.saturating_sub(self.fault_us + detected_us));
            if let Some(fault_end_us) = self.fault_end_us {
                run.zero_after_fault_us.get_or_insert(off_us.saturating_sub(fault_end_us));
            }
        }
        let was_zero =
            if run.request_path_ok { run.zero_us.is_some() } else { run.zero_after_fault_us.is_some() };
        run.resumed |= was_zero && !off;
    }

    /// One tick. Returns false if the device is lost.
    pub(super) fn step(&mut self, bench: &mut Bench<'_, '_>) -> bool {
        self.check_force(bench);
        match bench.step() {
            Ok(record) => self.update(bench, Some(&record)),
            Err(_) => {
                self.run.ended = Ended::Lost;
                let since_us = bench.now_us().saturating_sub(TICK_US + self.fault_us);
                self.run.detected_us.get_or_insert(since_us);
                self.update(bench, None);
                return false;
            }
        }
        true
    }
}
