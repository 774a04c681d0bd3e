//! A minute of palpation through the real driver, the real loop and the emulated mechanism, on virtual time: what the hand felt, held against
//! what the organ says at the place where the grip really was.
//!
//! ```text
//! felt - ideal  =  (felt - stepped)  +  (stepped - capped)  +  (capped - ideal)
//!    error            delay, motors        encoder steps       cap, slew, fade
//! ```
//!
//! A device that the product gives a supervisor has one here: its samples are a tick later ([`crate::handed`]).
//!
//! Ideal is the organ's force at the true position, now, within the force limit; capped the same with the stiffness cap, the slew limit and the fade; stepped the same with
//! the position rounded as the encoders do. Each is a controller of its own with its own touch, so that a difference in when a touch begins
//! counts too. None of it says how good the organ is: its own certificate states the distance to finite elements.

use crate::handed::Holder;
use crate::mechanism::Waypoint;
use crate::rig::{self, Kind, OpenError, Rig};
use crate::session::{self, TICK_US, on_organ, settings, with_loop_held};
use crate::shadow::Shadow;
use core::fmt;
use palpate_core::{Method, Organ, Phase, vec3};
use palpate_host::device::profile::Profile;

/// One press: from above to a depth, drawn sideways, held, and back.
const STROKE_US: u64 = 3_000_000;
/// The part of it in which the hand holds still, us from its beginning; the first tenths are its settling.
const REST_US: core::ops::Range<u64> = 1_800_000..2_400_000;

/// Mean square and largest of some distances.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Spread {
    sum2: f64,
    count: u64,
    /// The largest, N.
    pub most: f32,
}

impl Spread {
    fn take(&mut self, distance: f32) {
        self.sum2 += f64::from(distance * distance);
        self.count += 1;
        self.most = self.most.max(distance);
    }

    /// Root of the mean square, N.
    #[must_use]
    pub fn rms(&self) -> f32 {
        (self.sum2 / self.count.max(1) as f64).sqrt() as f32
    }
}

/// What a minute came to.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    /// Name of the rig.
    pub rig: String,
    /// Presses that were to be made.
    pub strokes: u64,
    /// Touches.
    pub touches: u32,
    /// Time in touch, us.
    pub touching_us: u64,
    /// Largest force felt, N.
    pub peak_n: f32,
    /// What the cap scales every force by.
    pub share: f32,
    /// felt - ideal.
    pub error: Spread,
    /// felt - stepped.
    pub delay: Spread,
    /// stepped - capped.
    pub steps: Spread,
    /// capped - ideal.
    pub cap: Spread,
    /// Largest peak to peak of the grip in a hold, on any axis, m.
    pub rest_m: f32,
    /// A step of the encoders at the grip, m.
    pub count_m: f32,
    /// Energy that the hand got out of motors and mechanism, J.
    pub given_j: f64,
    /// Work of the motors alone, J.
    pub work_j: f64,
    /// Phase at the end.
    pub phase: Phase,
}

/// Largest part of the peak force that delay, motors and encoder steps may be off by, root of the mean square: about what a hand can tell.
const TOLD_BY_A_HAND: f32 = 0.1;

impl Found {
    /// What of a device that may be used it is not: the one judgement of command and test.
    ///
    /// How far the cap takes the force from the organ's own is on purpose, and not held against it.
    #[must_use]
    pub fn broken(&self) -> Option<&'static str> {
        // Of the three seconds of a press it is in touch for about two.
        let least_us = self.strokes * STROKE_US / 3;
        // What a step of the encoders is worth at the largest force, each time it touches.
        let quantum_j = f64::from(self.touches) * f64::from(self.count_m * self.peak_n);
        if self.phase != Phase::Active {
            Some("it does not render at the end")
        } else if self.delay.rms() + self.steps.rms() >= TOLD_BY_A_HAND * self.peak_n {
            Some("the force is not the organ's")
        } else if self.touching_us <= least_us || 4 * u64::from(self.touches) < 3 * self.strokes {
            Some("the organ was not touched each time")
        } else if self.rest_m >= self.count_m {
            Some("it shakes in a hand at rest")
        } else if self.given_j > quantum_j {
            Some("it gives energy to the hand")
        } else {
            None
        }
    }
}

/// Shortest palpation that can be judged: a press with its rest, s.
pub const LEAST_SECONDS: u64 = STROKE_US / 1_000_000;

/// Strokes over the first active node: depth, place and the way sideways are another one each time.
fn strokes(rig: &dyn Rig, seconds: u64) -> Vec<Waypoint> {
    let (middle_m, scale) = (rig.traits().middle_m, rig.profile().workspace.scale);
    let mut path = Vec::new();
    for stroke in 0..(seconds * 1_000_000 / STROKE_US) {
        let turn = 2.4 * stroke as f32;
        let depth_m = 0.006 + 0.002 * (stroke % 7) as f32;
        let off_m = 0.004 * (stroke % 3) as f32;
        let place = |away_m: f32, height_m: f32| {
            let model_m = [away_m * turn.cos(), away_m * turn.sin(), height_m];
            vec3::add(middle_m, vec3::scale(model_m, scale.recip()))
        };
        let begun_us = stroke * STROKE_US;
        for (after_us, position_m) in [
            (0, place(off_m, 0.008)),
            (300_000, place(off_m, 0.008)),
            (900_000, place(off_m, -depth_m)),
            (1_400_000, place(off_m + 0.003, -depth_m)),
            (2_400_000, place(off_m + 0.003, -depth_m)),
            (2_900_000, place(off_m, 0.008)),
        ] {
            path.push(Waypoint { t_us: begun_us + after_us, position_m });
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
) -> Result<Found, OpenError> {
    let holder = rig.traits().holder();
    let profile = holder.seen_from_here(rig.profile());
    let workspace = on_organ(organ, &profile);
    let capped = settings(organ, &profile, workspace, method);
    let mut ideal = capped;
    ideal.limits.max_stiffness_n_m = f32::MAX;
    // The force of the organ at a place, whatever was felt before.
    ideal.limits.max_slew_n_per_s = 1e9;
    ideal.limits.fade_s = 0.0;
    let mut shadows = [Shadow::new(organ, ideal)?, Shadow::new(organ, capped)?, Shadow::new(organ, capped)?];
    with_loop_held(rig, organ, method, holder, |bench| {
        let mut found = Found {
            rig: if holder == Holder::Supervisor { format!("{name}, supervised") } else { name.into() },
            strokes: seconds * 1_000_000 / STROKE_US,
            touches: 0,
            touching_us: 0,
            peak_n: 0.0,
            share: shadows[1].share(),
            error: Spread::default(),
            delay: Spread::default(),
            steps: Spread::default(),
            cap: Spread::default(),
            rest_m: 0.0,
            count_m: profile.mechanism.encoder_quantum_m.unwrap_or(0.0),
            given_j: 0.0,
            work_j: 0.0,
            phase: Phase::Disarmed,
        };
        bench.rig.follow(strokes(bench.rig, seconds));
        bench.rig.forget();
        bench.controls.arm();
        let begun_us = bench.now_us();
        let (mut rest, mut touching) = ([(f32::MAX, f32::MIN); 3], false);
        while bench.now_us() < begun_us + seconds * 1_000_000 {
            let (device_m, reported_m) = (bench.rig.position_m(), bench.rig.reported_m());
            let (felt, t_us) = (bench.rig.felt(), bench.now_us());
            let places = [device_m, device_m, reported_m];
            let mut forces_n = [vec3::ZERO; 3];
            let mut touches = false;
            for ((shadow, place_m), force_n) in shadows.iter_mut().zip(places).zip(&mut forces_n) {
                let (at_n, at_touch) = shadow.at(t_us, &workspace, place_m);
                (*force_n, touches) = (at_n, touches || at_touch);
            }
            let [ideal_n, capped_n, stepped_n] = forces_n;
            let since_us = t_us - begun_us;
            // After the ramp of arming.
            if (touches || felt.force_n != vec3::ZERO) && since_us > 600_000 {
                found.touching_us += TICK_US;
                found.error.take(vec3::distance(felt.force_n, ideal_n));
                found.delay.take(vec3::distance(felt.force_n, stepped_n));
                found.steps.take(vec3::distance(stepped_n, capped_n));
                found.cap.take(vec3::distance(capped_n, ideal_n));
            }
            found.touches += u32::from(touches && !touching);
            touching = touches;
            let in_stroke_us = since_us % STROKE_US;
            if REST_US.contains(&in_stroke_us) {
                for (range, at_m) in rest.iter_mut().zip(device_m) {
                    *range = (range.0.min(at_m), range.1.max(at_m));
                }
            } else if in_stroke_us == REST_US.end {
                found.rest_m = rest.iter().fold(found.rest_m, |most, (low, high)| most.max(high - low));
                rest = [(f32::MAX, f32::MIN); 3];
            }
            found.phase = bench.step()?.phase;
        }
        let felt = bench.rig.felt();
        (found.peak_n, found.given_j, found.work_j) = (felt.largest_force_n, felt.given_j(), felt.work_j);
        Ok(found)
    })?
}

/// The same with the golden organ for every device profile that is bundled: on its own rig in memory where there is one, and for the others with their
/// figures on the gantry of the device link.
pub fn palpate_all(kinds: &[Kind], method: Method, seconds: u64) -> Result<Vec<Found>, OpenError> {
    let blob = session::golden_organ();
    let organ: Organ<'_> = Organ::read(blob.bytes())?;
    let mut rigs: Vec<(String, Box<dyn Rig>)> = kinds
        .iter()
        .filter(|kind| kind.in_memory)
        .map(|kind| (kind.name.to_owned(), (kind.make)(1)))
        .collect();
    let own: Vec<String> = rigs.iter().map(|(_, rig)| rig.profile().name.clone()).collect();
    for name in Profile::names() {
        let profile = Profile::bundled(name).ok_or("a bundled profile is there")?;
        if !own.contains(&profile.name) {
            rigs.push((format!("{name}, on a gantry"), Box::new(rig::on_a_gantry(profile))));
        }
    }
    rigs.iter_mut().map(|(name, rig)| palpate(name, &mut **rig, &organ, method, seconds)).collect()
}

/// For people; Markdown.
#[derive(Debug)]
pub struct Table<'a>(pub &'a [Found]);

impl fmt::Display for Table<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(
            "| device, link | touches, s in touch | largest force, N | forces scaled by the cap | error at the hand, N: rms (largest) | \
             of it delay and motors | encoder steps | cap, slew limit, fade | peak to peak at rest, um (a step) | energy for the hand, mJ (motors alone) |\n\
             |---|---|---|---|---|---|---|---|---|---|\n",
        )?;
        for found in self.0 {
            let spread = |spread: &Spread| format!("{:.4} ({:.3})", spread.rms(), spread.most);
            writeln!(
                f,
                "| {} | {}, {:.0} | {:.2} | x {:.2} | {} | {} | {} | {} | {:.1} ({:.0}) | {:+.1} ({:+.1}) |",
                found.rig,
                found.touches,
                found.touching_us as f32 * 1e-6,
                found.peak_n,
                found.share,
                spread(&found.error),
                spread(&found.delay),
                spread(&found.steps),
                spread(&found.cap),
                1e6 * found.rest_m,
                1e6 * found.count_m,
                1e3 * found.given_j,
                1e3 * found.work_j,
            )?;
        }
        Ok(())
    }
}
