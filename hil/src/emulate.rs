//! An emulated device on a pseudo terminal, in real time, in a pressing hand, to try the product with.
//!
//! ```text
//! palpate run (driver, loop, controller) <-> pseudo terminal <-> faults (seeded) <-> device <-> hand
//! ```
//!
//! The emulator is independent of the driver. Sessions may come and go; the device keeps its state between
//! them.

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

/// Period of the strokes, us.
const STROKE_US: u64 = 4_000_000;
/// Interval in which the hand holds the first button, us from the start of a stroke; the hand is above the
/// organ then.
const BUTTON_US: core::ops::Range<u64> = 300_000..600_000;
/// Height and depth of a stroke relative to the surface, m of the model.
const ABOVE_M: f32 = 0.010;
const BELOW_M: f32 = 0.010;
/// Amplitude of a stroke without an organ, m of the device.
const IN_AIR_M: f32 = 0.012;
/// Poll period of the line.
const POLL_PERIOD: Duration = Duration::from_micros(100);

/// End points of a stroke, device frame, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stroke {
    above_m: Vec3,
    below_m: Vec3,
}

/// The organ lies outside the workspace of the handle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OutOfReach {
    /// The unreachable position, device frame, m.
    device_m: Vec3,
    /// Model origin that would put the organ into the middle of the workspace, m.
    model_origin_m: Vec3,
}

impl fmt::Display for OutOfReach {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ([x, y, z], [u, v, w]) = (self.device_m, self.model_origin_m);
        write!(
            f,
            "the organ is at ({x:.3}, {y:.3}, {z:.3}) m in the device frame, outside the workspace; copy the profile, set \
             mapping.model_origin_m = [{u:.4}, {v:.4}, {w:.4}], and give it to both commands with --profile"
        )
    }
}

impl core::error::Error for OutOfReach {}

impl Stroke {
    /// A stroke along z through the middle of the workspace.
    #[must_use]
    pub fn in_air(profile: &Profile) -> Self {
        let at = |z| vec3::add(profile.workspace.device_origin_m, [0.0, 0.0, z]);
        Self { above_m: at(IN_AIR_M), below_m: at(-IN_AIR_M) }
    }

    /// A stroke through the surface of an organ at its first active node, along the normal.
    pub fn on(organ: &Organ<'_>, profile: &Profile) -> Result<Self, OutOfReach> {
        let node = &organ.spaces[0];
        let at = |height_m: f32| {
            let model_m =
                vec3::add(node.active.rest_position_m, vec3::scale(node.active.outward_normal, height_m));
            let device_m = profile.workspace.to_device_m(model_m);
            let from_middle_m = vec3::sub(device_m, profile.workspace.device_origin_m);
            if profile.reach.nearest_m(from_middle_m) == from_middle_m {
                Ok(device_m)
            } else {
                Err(OutOfReach { device_m, model_origin_m: node.active.rest_position_m })
            }
        };
        Ok(Self { above_m: at(ABOVE_M)?, below_m: at(-BELOW_M)? })
    }

    /// Waypoints of one stroke from the present position of the handle.
    fn from(self, place_m: Vec3) -> Vec<Waypoint> {
        let Self { above_m, below_m } = self;
        [(0, place_m), (300_000, above_m), (600_000, above_m), (1_800_000, below_m), (2_600_000, below_m)]
            .into_iter()
            .chain([(3_600_000, above_m), (STROKE_US, above_m)])
            .map(|(t_us, position_m)| Waypoint { t_us, position_m })
            .collect()
    }
}

/// Options of the emulation.
#[derive(Debug, Clone)]
pub struct Options {
    /// Profile of the device.
    pub profile: Profile,
    /// Motion of the hand.
    pub stroke: Stroke,
    /// The hand presses the first button for a moment above each stroke, which arms the loop.
    pub presses_button: bool,
    /// Faults of the line, in both directions.
    pub faults: Faults,
    /// Seed of the faults.
    pub seed: u64,
    /// Duration; without one, until stopped.
    pub time: Option<Duration>,
}

/// Emulates a device until the time is over or `stop` is set. `announce` receives the name of the driver's
/// end; a summary is written to `out`.
pub fn emulate<E: SerialDevice>(
    options: &Options,
    stop: &AtomicBool,
    out: &mut dyn Write,
    announce: impl FnOnce(&mut dyn Write, &str) -> io::Result<()>,
) -> io::Result<()> {
    // Held open to the end, because the terminal would otherwise close between two drivers.
    let (link, driver_end) = PtyTransport::pair()?;
    announce(out, &driver_end.name().unwrap_or_default())?;
    let mut link = Faulty::new(link, options.faults, options.seed);
    let mut device = E::new(&options.profile);
    let (start, mut stroke) = (Instant::now(), None);
    while !stop.load(Ordering::Relaxed) && options.time.is_none_or(|time| start.elapsed() < time) {
        let now_us = start.elapsed().as_micros() as u64;
        if stroke != Some(now_us / STROKE_US) {
            stroke = Some(now_us / STROKE_US);
            let place_m = device.handle().position_m();
            device.handle_mut().follow(options.stroke.from(place_m));
        }
        let holds = options.presses_button && BUTTON_US.contains(&(now_us % STROKE_US));
        device.press(holds.into());
        device.poll(now_us, &mut link)?;
        std::thread::sleep(POLL_PERIOD);
    }
    let (felt, faults) = (device.handle().force_record(), link.counts());
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
    fn a_stroke_crosses_the_surface_or_names_a_reachable_origin() {
        let blob = golden_organ();
        let organ: Organ<'_> = Organ::read(blob.bytes()).expect("golden");
        let mut profile = Profile::bundled("link").expect("bundled");
        let node = &organ.spaces[0];
        profile.workspace.model_origin_m = vec3::add(node.active.rest_position_m, [0.3, 0.0, 0.0]);
        let refused = Stroke::on(&organ, &profile).expect_err("30 cm away");
        assert!(refused.to_string().contains("model_origin_m"), "{refused}");

        profile.workspace.model_origin_m = refused.model_origin_m;
        let stroke = Stroke::on(&organ, &profile).expect("in the middle");
        let height_m = |device_m| {
            let model_m = profile.workspace.to_model_m(device_m);
            vec3::dot(vec3::sub(model_m, node.active.rest_position_m), node.active.outward_normal)
        };
        assert!((height_m(stroke.above_m) - ABOVE_M).abs() < 1e-6);
        assert!((height_m(stroke.below_m) + BELOW_M).abs() < 1e-6);
    }
}
