//! What is watched from the fault on, tick by tick.

use super::Wrong;
use super::beside::{Beside, Both};
use super::outcome::{Ended, Run, STALE_US};
use crate::felt::Felt;
use crate::session::{self, Bench, TICK_US};
use palpate_core::{Phase, vec3};
use palpate_host::TickRecord;
use palpate_host::device::DeviceState;

/// In which a reply from before a device lost its place may still come, us.
const ON_ITS_WAY_US: u64 = 4 * TICK_US;

/// From the end of a fault that was ridden out until the force is the organ's again, us: the links that are late by 40 ms are empty, and the slew has
/// let the force rise.
const SETTLED_US: u64 = 60_000;

/// When a user arms who has reset at [`session::OUT_TICKS`]: as long after it as a new session of the device link takes, and many times that to a person.
const ARM_TICK: u64 = session::OUT_TICKS + 30;

/// The run so far.
pub(super) struct Watch<'o> {
    run: Run,
    organ: Beside<'o>,
    struck_us: u64,
    /// When the fault was over.
    mended_us: Option<u64>,
    beyond_us: u64,
    /// When the newest sample that the loop has was taken: as the driver says, but no later than the rig knows.
    newest_us: u64,
    /// At which age a sample is a fault, us.
    stale_us: u64,
    device: DeviceState,
}

impl<'o> Watch<'o> {
    /// From now on; `newest_us` is when the newest sample so far was taken, and `unknown_us` by how much nobody can know how old one is.
    pub(super) fn new(
        bench: &Bench<'_, '_>,
        organ: Beside<'o>,
        run: Run,
        newest_us: Option<u64>,
        unknown_us: u64,
    ) -> Self {
        Self {
            run,
            organ,
            struck_us: bench.now_us(),
            mended_us: None,
            beyond_us: 0,
            newest_us: newest_us.unwrap_or(0),
            stale_us: STALE_US + unknown_us,
            device: DeviceState::Homed,
        }
    }

    /// Whether the device knew its place in the last tick.
    pub(super) fn is_homed(&self) -> bool {
        self.device == DeviceState::Homed
    }

    pub(super) const fn run(&self) -> &Run {
        &self.run
    }

    /// The fault is over.
    pub(super) const fn mend(&mut self, now_us: u64) {
        self.mended_us = Some(now_us);
    }

    /// A fault of frames that has struck none has shown nothing.
    pub(super) fn note_struck(&mut self, frames: [u64; 2]) {
        self.run.struck = Some(frames);
        if frames == [0; 2] {
            self.flaw("the fault struck no frame");
        }
    }

    /// The loop has ended on a sound link.
    pub(super) fn note_end(&mut self, felt: &Felt) {
        if felt.force_n != vec3::ZERO || felt.off_since_us.is_none() {
            self.flaw("a force after the end of the loop");
        }
    }

    /// What the hand felt so far is what it felt of the fault.
    pub(super) const fn note_felt(&mut self, felt: &Felt) {
        self.run.largest_n = felt.largest_force_n;
        self.run.step_n = felt.largest_step_n;
        self.run.steepest_n_per_s = felt.steepest_n_per_s;
    }

    /// A user resets and arms in front of the organ, and presses anew, as [`session::press_anew`] does: the hand feels the organ as before the fault.
    pub(super) fn press_again(&mut self, bench: &mut Bench<'_, '_>) {
        let mut last = None;
        for tick in 0..session::ANEW_TICKS {
            let both = self.organ.look(bench);
            match tick {
                session::OUT_TICKS => bench.controls.reset(),
                ARM_TICK => {
                    bench.controls.arm();
                    self.organ.arm();
                }
                tick if tick > ARM_TICK => {
                    self.compare(&both, "reset, armed, and the force is not the organ's")
                }
                _ => {}
            }
            let Ok(record) = bench.step() else { return self.flaw("gone after it was reset") };
            let is_reset = (session::OUT_TICKS + 2..ARM_TICK).contains(&tick);
            if is_reset && record.phase != Phase::Disarmed {
                self.flaw("reset, and not disarmed");
            }
            last = Some(record.phase);
        }
        if last != Some(Phase::Active) {
            self.flaw("not to be armed after it was reset");
        }
    }

    fn flaw(&mut self, what: &'static str) {
        self.run.flaw.get_or_insert(what);
    }

    /// Whether the loop knows how old its samples are, and acts upon it.
    fn look_at_age(&mut self, record: &TickRecord, heard_us: Option<u64>) {
        if let Some(sample) = &record.sample {
            let age_us = |taken_us: u64| record.t_us.saturating_sub(taken_us);
            let taken_us = heard_us.map_or(sample.t_us, |us| sample.t_us.min(us));
            let stale_us = self.stale_us;
            let is_fresh = |taken_us| age_us(taken_us) < stale_us;
            if age_us(sample.t_us) < STALE_US && !is_fresh(taken_us) {
                self.flaw("a late reply passed for a fresh one");
            }
            // One that came too late is no sample to the loop.
            if is_fresh(taken_us) {
                self.newest_us = self.newest_us.max(taken_us);
            }
        }
        let is_stale = record.t_us.saturating_sub(self.newest_us) >= self.stale_us;
        if is_stale && !matches!(record.phase, Phase::SafeZero(_)) {
            self.flaw("the newest sample was stale and nothing was latched");
        }
    }

    /// A device that has lost its place has none to tell before it was homed or opened anew.
    fn look_at_place(&mut self, record: &TickRecord) {
        let lost = matches!(self.run.wrong, Wrong::HomingLost | Wrong::PowerCycle);
        if lost && record.sample.is_some() && record.t_us >= self.struck_us + ON_ITS_WAY_US {
            self.flaw("samples of a device that knows no place");
        }
    }

    /// What was ridden out has left nothing behind: the hand feels the organ, where it is and as hard as it is.
    fn look_at_force(&mut self, bench: &Bench<'_, '_>) {
        let both = self.organ.look(bench);
        let is_over = self.mended_us.is_some_and(|us| bench.now_us() >= us + SETTLED_US);
        if is_over && self.run.ended == Ended::RodeOn {
            self.compare(&both, "ridden out, and the force is not the organ's");
        }
    }

    fn compare(&mut self, both: &Both, flaw: &'static str) {
        self.run.after_n = Some(self.run.after_n.unwrap_or(0.0).max(both.off_n()));
        if both.flaw().is_some() {
            self.flaw(flaw);
        }
    }

    fn look(&mut self, bench: &Bench<'_, '_>, record: Option<&TickRecord>) {
        if let Some(record) = record {
            self.device = record.device;
            self.look_at_age(record, bench.heard_us());
            self.look_at_place(record);
        }
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
            if let Some(mended_us) = self.mended_us {
                run.mended_us.get_or_insert(off_us.saturating_sub(mended_us));
            }
        }
        let was_zero = if run.way_is_sound { run.zero_us.is_some() } else { run.mended_us.is_some() };
        run.resumed |= was_zero && !off;
    }

    /// One tick; false if the device is gone.
    pub(super) fn step(&mut self, bench: &mut Bench<'_, '_>) -> bool {
        self.look_at_force(bench);
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
