//! An emulated device to try the product with: on a pseudo terminal, in real time, in a hand that presses.
//!
//! ```text
//! palpate run (the real driver, loop and controller) <-> pseudo terminal <-> faults (seeded) <-> emulated device <-> hand: one stroke after the other
//! ```
//!
//! It knows nothing of the driver at the other end: sessions come and go, and what a device keeps between them it keeps.

use crate::fault::Faults;
use crate::faulty::Faulty;
use crate::mechanism::Waypoint;
use crate::rig::SerialDevice;
use crate::transport::PtyTransport;
use core::fmt;
use palpate_core::{Organ, Vec3, vec3};
use palpate_host::device::profile::Profile;
use serialport::SerialPort;
use std::io::{self, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// From one stroke to the next, us.
const STROKE_US: u64 = 4_000_000;
/// While the hand holds the first button, us from the beginning of a stroke: it is above then.
const BUTTON_US: core::ops::Range<u64> = 300_000..600_000;
/// How far above and below the surface a stroke goes, m of the model.
const ABOVE_M: f32 = 0.010;
const BELOW_M: f32 = 0.010;
/// The same where there is no organ, m of the device.
const IN_AIR_M: f32 = 0.012;
/// Between two looks at the line.
const LOOK: Duration = Duration::from_micros(100);

/// Where the hand goes, device frame, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stroke {
    above_m: Vec3,
    below_m: Vec3,
}

/// The organ is where the handle cannot go.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OutOfReach {
    /// The place in the device's frame, m.
    device_m: Vec3,
    /// Where it would have to be in the model for the handle's middle, m.
    model_origin_m: Vec3,
}

impl fmt::Display for OutOfReach {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ([x, y, z], [u, v, w]) = (self.device_m, self.model_origin_m);
        write!(
            f,
            "the organ is at ({x:.3}, {y:.3}, {z:.3}) m of the device, beyond its workspace; copy the profile, set \
             mapping.model_origin_m = [{u:.4}, {v:.4}, {w:.4}], and give it to both commands with --profile"
        )
    }
}

impl core::error::Error for OutOfReach {}

impl Stroke {
    /// Up and down along z through the middle of the workspace.
    #[must_use]
    pub fn in_air(profile: &Profile) -> Self {
        let at = |z| vec3::add(profile.workspace.device_origin_m, [0.0, 0.0, z]);
        Self { above_m: at(IN_AIR_M), below_m: at(-IN_AIR_M) }
    }

    /// Through the surface of an organ at its first active node, along the normal, and out again.
    pub fn on(organ: &Organ<'_>, profile: &Profile) -> Result<Self, OutOfReach> {
        let node = &organ.spaces[0];
        let at = |height_m: f32| {
            let model_m = vec3::add(node.rest_position_m, vec3::scale(node.outward_normal, height_m));
            let device_m = profile.workspace.to_device_m(model_m);
            let from_middle_m = vec3::sub(device_m, profile.workspace.device_origin_m);
            if profile.reach.nearest_m(from_middle_m) == from_middle_m {
                Ok(device_m)
            } else {
                Err(OutOfReach { device_m, model_origin_m: node.rest_position_m })
            }
        };
        Ok(Self { above_m: at(ABOVE_M)?, below_m: at(-BELOW_M)? })
    }

    /// One stroke, from where the handle is.
    fn from(self, place_m: Vec3) -> Vec<Waypoint> {
        let Self { above_m, below_m } = self;
        [(0, place_m), (300_000, above_m), (600_000, above_m), (1_800_000, below_m), (2_600_000, below_m)]
            .into_iter()
            .chain([(3_600_000, above_m), (STROKE_US, above_m)])
            .map(|(t_us, position_m)| Waypoint { t_us, position_m })
            .collect()
    }
}

/// What is emulated, and for how long.
#[derive(Debug, Clone)]
pub struct Options {
    /// Of the device.
    pub profile: Profile,
    /// What the hand does.
    pub stroke: Stroke,
    /// The hand holds the first button for a moment above each stroke: that arms.
    pub presses_button: bool,
    /// What goes wrong on the line, both ways.
    pub faults: Faults,
    /// Seed of the faults.
    pub seed: u64,
    /// How long to run; until it is stopped if not given.
    pub time: Option<Duration>,
}

/// Emulates a device until the time is over or `stop` is set. `greet` is told the name of the driver's end; what it came to goes to `out`.
pub fn emulate<E: SerialDevice>(
    options: &Options,
    stop: &AtomicBool,
    out: &mut dyn Write,
    greet: impl FnOnce(&mut dyn Write, &str) -> io::Result<()>,
) -> io::Result<()> {
    // Held open to the end: between two drivers the terminal would otherwise be gone.
    let (link, driver_end) = PtyTransport::pair()?;
    greet(out, &driver_end.name().unwrap_or_default())?;
    let mut link = Faulty::new(link, options.faults, options.seed);
    let mut device = E::new(&options.profile);
    let (begun, mut stroke) = (Instant::now(), None);
    while !stop.load(Ordering::Relaxed) && options.time.is_none_or(|time| begun.elapsed() < time) {
        let now_us = begun.elapsed().as_micros() as u64;
        if stroke != Some(now_us / STROKE_US) {
            stroke = Some(now_us / STROKE_US);
            let place_m = device.handle().position_m();
            device.handle_mut().follow(options.stroke.from(place_m));
        }
        let holds = options.presses_button && BUTTON_US.contains(&(now_us % STROKE_US));
        device.press(holds.into());
        device.poll(now_us, &mut link)?;
        std::thread::sleep(LOOK);
    }
    let (felt, faults) = (device.handle().felt(), link.counts());
    writeln!(
        out,
        "{} commands, largest force {:.2} N; frames lost {}, cut {}, damaged {}, late {}",
        felt.commands,
        felt.largest_force_n,
        faults.dropped,
        faults.truncated,
        faults.corrupted,
        faults.delayed
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::golden_organ;

    #[test]
    fn a_stroke_goes_through_the_surface_or_says_where_the_organ_would_have_to_be() {
        let blob = golden_organ();
        let organ: Organ<'_> = Organ::read(blob.bytes()).expect("golden");
        let mut profile = Profile::bundled("link").expect("bundled");
        let node = &organ.spaces[0];
        profile.workspace.model_origin_m = vec3::add(node.rest_position_m, [0.3, 0.0, 0.0]);
        let refused = Stroke::on(&organ, &profile).expect_err("30 cm away");
        assert!(refused.to_string().contains("model_origin_m"), "{refused}");

        profile.workspace.model_origin_m = refused.model_origin_m;
        let stroke = Stroke::on(&organ, &profile).expect("in the middle");
        let height_m = |device_m| {
            let model_m = profile.workspace.to_model_m(device_m);
            vec3::dot(vec3::sub(model_m, node.rest_position_m), node.outward_normal)
        };
        assert!((height_m(stroke.above_m) - ABOVE_M).abs() < 1e-6);
        assert!((height_m(stroke.below_m) + BELOW_M).abs() < 1e-6);
    }
}
