//! A minute of palpation through the real driver, the real loop and the emulated mechanism, on virtual time.
//! Compares the force on the hand with the organ's force at the true position of the grip.
//!
//! ```text
//! applied - ideal  =  (applied - stepped)  +  (stepped - capped)  +  (capped - ideal)
//!       error             delay, motors         encoder steps       cap, slew, fade
//! ```
//!
//! `ideal` is the organ's force at the true position and time, within the force limit. `capped` adds the
//! stiffness cap, the slew limit and the fade. `stepped` adds the rounding of the position by the encoders.
//! Each is a controller of its own with its own contact state, so that a difference in the start of contact
//! counts as well. None of them measures the model error of the organ, which its certificate states.

use crate::mechanism::Waypoint;
use crate::rig::{self, OpenError, Rig, RigKind};
use crate::session::{self, with_loop};
use crate::shadow::Shadow;
use crate::tick::TICK_US;
use core::fmt;
use palpate_core::{Method, Organ, Phase, vec3};
use palpate_host::device::profile::Profile;

/// One press: down to a depth, sideways, hold, and up.
const STROKE_US: u64 = 3_000_000;
/// Interval of the press in which the hand holds still, us; it starts after the hand has settled.
const REST_US: core::ops::Range<u64> = 1_800_000..2_400_000;

/// Root mean square and maximum of force errors.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ErrorStats {
    sum2: f64,
    count: u64,
    /// Maximum, N.
    pub max: f32,
}

impl ErrorStats {
    fn take(&mut self, distance: f32) {
        self.sum2 += f64::from(distance * distance);
        self.count += 1;
        self.max = self.max.max(distance);
    }

    /// Root mean square, N.
    #[must_use]
    pub fn rms(&self) -> f32 {
        (self.sum2 / self.count.max(1) as f64).sqrt() as f32
    }
}

/// Result of a palpation.
#[derive(Debug, Clone, PartialEq)]
pub struct ClosedLoopResult {
    /// Name of the rig.
    pub rig: String,
    /// Number of planned presses.
    pub strokes: u64,
    /// Number of contacts.
    pub touches: u32,
    /// Time in contact, us.
    pub touching_us: u64,
    /// Largest force on the hand, N.
    pub peak_n: f32,
    /// Factor of the stiffness cap on every force.
    pub force_scale: f32,
    /// applied - ideal.
    pub error: ErrorStats,
    /// applied - stepped.
    pub delay: ErrorStats,
    /// stepped - capped.
    pub steps: ErrorStats,
    /// capped - ideal.
    pub cap: ErrorStats,
    /// Largest peak-to-peak displacement of the grip during a hold, over all axes, m.
    pub rest_peak_to_peak_m: f32,
    /// Displacement of the grip per encoder step, m.
    pub count_m: f32,
    /// Net energy from motors and mechanism to the hand, J.
    pub energy_out_j: f64,
    /// Work of the motors alone, J.
    pub work_j: f64,
    /// Phase at the end.
    pub phase: Phase,
}

/// Largest error due to delay, motors and encoder steps, root mean square, as a share of the peak force:
/// about the just-noticeable difference of force.
const FORCE_JND: f32 = 0.1;

impl ClosedLoopResult {
    /// The first violated limit; command and test share this judgement.
    ///
    /// The stiffness cap reduces the force on purpose, so its error is not judged.
    #[must_use]
    pub fn violation(&self) -> Option<&'static str> {
        // A press of three seconds is in contact for about two.
        let min_us = self.strokes * STROKE_US / 3;
        // Energy of one encoder step at the largest force, for each contact.
        let quantum_j = f64::from(self.touches) * f64::from(self.count_m * self.peak_n);
        if self.phase != Phase::Active {
            Some("the loop does not render at the end")
        } else if self.delay.rms() + self.steps.rms() >= FORCE_JND * self.peak_n {
            Some("the force is not the organ's")
        } else if self.touching_us <= min_us || 4 * u64::from(self.touches) < 3 * self.strokes {
            Some("some presses made no contact")
        } else if self.rest_peak_to_peak_m >= self.count_m {
            Some("the grip oscillates in a resting hand")
        } else if self.energy_out_j > quantum_j {
            Some("the device adds energy to the hand")
        } else {
            None
        }
    }
}

/// Shortest palpation that can be judged: one press with its hold, s.
pub const MIN_SECONDS: u64 = STROKE_US / 1_000_000;

/// Strokes over the first active node. Depth, position and direction vary from stroke to stroke.
fn strokes(rig: &dyn Rig, seconds: u64) -> Vec<Waypoint> {
    let (middle_m, scale) = (rig.traits().middle_m, rig.profile().workspace.scale);
    let mut path = Vec::new();
    for stroke in 0..(seconds * 1_000_000 / STROKE_US) {
        let turn = 2.4 * stroke as f32;
        let depth_m = 0.006 + 0.002 * (stroke % 7) as f32;
        let off_m = 0.004 * (stroke % 3) as f32;
        let position = |away_m: f32, height_m: f32| {
            let model_m = [away_m * turn.cos(), away_m * turn.sin(), height_m];
            vec3::add(middle_m, vec3::scale(model_m, scale.recip()))
        };
        let start_us = stroke * STROKE_US;
        for (after_us, position_m) in [
            (0, position(off_m, 0.008)),
            (300_000, position(off_m, 0.008)),
            (900_000, position(off_m, -depth_m)),
            (1_400_000, position(off_m + 0.003, -depth_m)),
            (2_400_000, position(off_m + 0.003, -depth_m)),
            (2_900_000, position(off_m, 0.008)),
        ] {
            path.push(Waypoint { t_us: start_us + after_us, position_m });
        }
    }
    path
}

/// Palpates for some seconds of virtual time.
pub fn palpate(
    name: &str,
    rig: &mut dyn Rig,
    organ: &Organ<'_>,
    method: Method,
    seconds: u64,
) -> Result<ClosedLoopResult, OpenError> {
    let profile = rig.profile().clone();
    with_loop(rig, organ, method, |bench| {
        let (capped, workspace) = (bench.config(), bench.workspace());
        let mut ideal = capped;
        ideal.limits.max_stiffness_n_m = f32::INFINITY;
        // The force of the organ without a history.
        ideal.limits.max_slew_n_per_s = 1e9;
        ideal.limits.fade_s = 0.0;
        let mut shadows =
            [Shadow::new(organ, ideal)?, Shadow::new(organ, capped)?, Shadow::new(organ, capped)?];
        let mut result = ClosedLoopResult {
            rig: name.into(),
            strokes: seconds * 1_000_000 / STROKE_US,
            touches: 0,
            touching_us: 0,
            peak_n: 0.0,
            force_scale: shadows[1].force_scale(),
            error: ErrorStats::default(),
            delay: ErrorStats::default(),
            steps: ErrorStats::default(),
            cap: ErrorStats::default(),
            rest_peak_to_peak_m: 0.0,
            count_m: profile.mechanism.encoder_quantum_m.unwrap_or(0.0),
            energy_out_j: 0.0,
            work_j: 0.0,
            phase: Phase::Disarmed,
        };
        bench.rig.follow(strokes(bench.rig, seconds));
        bench.rig.reset_record();
        bench.controls.arm();
        let start_us = bench.now_us();
        let (mut rest, mut touching) = ([(f32::MAX, f32::MIN); 3], false);
        while bench.now_us() < start_us + seconds * 1_000_000 {
            let (device_m, reported_m) = (bench.rig.position_m(), bench.rig.reported_m());
            let (felt, t_us) = (bench.rig.force_record(), bench.now_us());
            let positions = [device_m, device_m, reported_m];
            let mut forces_n = [vec3::ZERO; 3];
            let mut touches = false;
            for ((shadow, place_m), force_n) in shadows.iter_mut().zip(positions).zip(&mut forces_n) {
                let (at_n, at_touch) = shadow.at(t_us, &workspace, place_m);
                (*force_n, touches) = (at_n, touches || at_touch);
            }
            let [ideal_n, capped_n, stepped_n] = forces_n;
            let since_us = t_us - start_us;
            // After the ramp that follows arming.
            if (touches || felt.force_n != vec3::ZERO) && since_us > 600_000 {
                result.touching_us += TICK_US;
                result.error.take(vec3::distance(felt.force_n, ideal_n));
                result.delay.take(vec3::distance(felt.force_n, stepped_n));
                result.steps.take(vec3::distance(stepped_n, capped_n));
                result.cap.take(vec3::distance(capped_n, ideal_n));
            }
            result.touches += u32::from(touches && !touching);
            touching = touches;
            let in_stroke_us = since_us % STROKE_US;
            if REST_US.contains(&in_stroke_us) {
                for (range, at_m) in rest.iter_mut().zip(device_m) {
                    *range = (range.0.min(at_m), range.1.max(at_m));
                }
            } else if in_stroke_us == REST_US.end {
                result.rest_peak_to_peak_m =
                    rest.iter().fold(result.rest_peak_to_peak_m, |max, (low, high)| max.max(high - low));
                rest = [(f32::MAX, f32::MIN); 3];
            }
            result.phase = bench.step()?.phase;
        }
        let felt = bench.rig.force_record();
        (result.peak_n, result.energy_out_j, result.work_j) =
            (felt.largest_force_n, felt.energy_out_j(), felt.work_j);
        Ok(result)
    })?
}

/// Palpates the golden organ with every bundled device profile. A device with an emulator uses its own rig in
/// memory. Any other uses the gantry of the device link with the figures of its profile.
pub fn palpate_all(
    kinds: &[RigKind],
    method: Method,
    seconds: u64,
) -> Result<Vec<ClosedLoopResult>, OpenError> {
    let blob = session::golden_organ();
    let organ: Organ<'_> = Organ::read(blob.bytes())?;
    let mut rigs: Vec<(String, Box<dyn Rig>)> = kinds
        .iter()
        .filter(|kind| kind.in_memory)
        .map(|kind| (kind.name.to_owned(), (kind.make)(1)))
        .collect();
    let own: Vec<String> = rigs.iter().map(|(_, rig)| rig.profile().name.clone()).collect();
    for name in Profile::names() {
        let profile = Profile::bundled(name).ok_or("a bundled profile is missing")?;
        if !own.contains(&profile.name) {
            rigs.push((format!("{name}, on a gantry"), Box::new(rig::on_gantry(profile))));
        }
    }
    rigs.iter_mut().map(|(name, rig)| palpate(name, &mut **rig, &organ, method, seconds)).collect()
}

/// The results as a Markdown table.
#[derive(Debug)]
pub struct Table<'a>(pub &'a [ClosedLoopResult]);

impl fmt::Display for Table<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(
            "| device, link | touches, s in touch | largest force, N | forces scaled by the cap | error at the hand, N: rms (largest) | \
             of it delay and motors | encoder steps | cap, slew limit, fade | peak to peak at rest, um (a step) | energy for the hand, mJ (motors alone) |\n\
             |---|---|---|---|---|---|---|---|---|---|\n",
        )?;
        for result in self.0 {
            let spread = |spread: &ErrorStats| format!("{:.4} ({:.3})", spread.rms(), spread.max);
            writeln!(
                f,
                "| {} | {}, {:.0} | {:.2} | x {:.2} | {} | {} | {} | {} | {:.1} ({:.0}) | {:+.1} ({:+.1}) |",
                result.rig,
                result.touches,
                result.touching_us as f32 * 1e-6,
                result.peak_n,
                result.force_scale,
                spread(&result.error),
                spread(&result.delay),
                spread(&result.steps),
                spread(&result.cap),
                1e6 * result.rest_peak_to_peak_m,
                1e6 * result.count_m,
                1e3 * result.energy_out_j,
                1e3 * result.work_j,
            )?;
        }
        Ok(())
    }
}
