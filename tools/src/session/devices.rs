//! The device of a session.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use palpate_core::{Organ, vec3};
use palpate_host::Device;
use palpate_host::device::motors_off::MotorsOff;
use palpate_host::device::mouse::{Mouse, MouseConfig, MouseHandle, mouse};
use palpate_host::device::palpation::{Palpation, RandomConfig};
use palpate_host::device::profile::Profile;
use palpate_host::device::simulated::{SimulatedConfig, SimulatedHand};
use palpate_host::device::way::{Way, Waypoint};
use palpate_host::first_place::first_place;

use super::SessionArgs;
use crate::device_spec::{DeviceSpec, Motion};
use crate::failure::Failure;
use crate::points::table_with;
use crate::{hardware, touch};

/// Initial height of the mouse's tool above its first place, m.
const MOUSE_HEIGHT_M: f32 = 0.03;

/// The mouse device, and the handle of the window.
fn open_mouse<const N: usize>(
    args: &SessionArgs,
    organ: &Organ<'_, N>,
) -> Result<(MouseHandle, Mouse), Failure> {
    if args.headless {
        return Err(Failure::input(touch::MOUSE_NEEDS_WINDOW));
    }
    let start_m = organ.spaces.get(first_place(organ)).map_or(vec3::ZERO, |space| {
        vec3::add(space.active.rest_position_m, vec3::scale(space.active.outward_normal, MOUSE_HEIGHT_M))
    });
    Ok(mouse(start_m, MouseConfig::default()))
}

/// The named profile, or that of the device, at the period of this session.
pub(crate) fn profile(args: &SessionArgs) -> Result<Option<Profile>, Failure> {
    let profile = hardware::profile(&args.device, args.profile.as_deref())?;
    // The stiffness cap depends on the actual period.
    Ok(profile.map(|profile| match args.timing.period_us {
        Some(period_us) => profile.at_period(period_us),
        None => profile,
    }))
}

/// The way of a table with the columns t_s, x_m, y_m and z_m, and those of a grip that turns.
fn way(path: &Path) -> Result<Way, Failure> {
    let (placed, turned) = (["t_s", "x_m", "y_m", "z_m"], ["rx_rad", "ry_rad", "rz_rad"]);
    let places: Vec<_> = table_with(path, "--device sim:", placed, turned)?
        .into_iter()
        .map(|(row, turn)| (row.map(|number| number as f32), turn.map(|angle| angle as f32)))
        .map(|([t_s, x, y, z], turn_rad)| Waypoint { t_s, place_m: [x, y, z], turn_rad })
        .collect();
    Way::new(places).ok_or_else(|| {
        let what = "a way needs rows in the order of time, at most 0.8 m/s apart";
        Failure::input(format!("{}: {what}", path.display()))
    })
}

/// Opens the simulated hand or the hardware. Mouse and replay are opened elsewhere.
fn open_device<const N: usize>(
    args: &SessionArgs,
    organ: &Organ<'_, N>,
    profile: Option<&Profile>,
    stop: &AtomicBool,
) -> Result<hardware::Held, Failure> {
    if let (Some(hardware), Some(profile)) = (args.device.hardware(), profile) {
        return hardware::open(hardware, profile, args.guard(), stop);
    }
    let mut config = profile.map_or_else(SimulatedConfig::default, SimulatedConfig::for_profile);
    let hand = match &args.device {
        DeviceSpec::Simulated(Motion::Way(path)) => {
            SimulatedHand::with_palpation(Palpation::Way(way(path)?), config)
        }
        DeviceSpec::Simulated(Motion::Random(seed)) => {
            config.random = Some(RandomConfig::new(*seed));
            SimulatedHand::new(organ, config)
        }
        _ => SimulatedHand::new(organ, config),
    };
    Ok((Box::new(hand), None))
}

/// A device that is opened when the session is ready for it.
#[derive(Debug)]
pub(crate) struct Opener<'a> {
    args: &'a SessionArgs,
    profile: Option<&'a Profile>,
    stop: &'a AtomicBool,
    /// The handle of the window of the mouse device.
    pub(crate) mouse: Option<MouseHandle>,
    tool: Option<Mouse>,
}

impl<'a> Opener<'a> {
    /// Prepares the device of these arguments for an organ.
    pub(crate) fn new<const N: usize>(
        args: &'a SessionArgs,
        organ: &Organ<'_, N>,
        profile: Option<&'a Profile>,
        stop: &'a AtomicBool,
    ) -> Result<Self, Failure> {
        let (mouse, tool) = match args.device {
            DeviceSpec::Mouse => open_mouse(args, organ).map(|(handle, tool)| (Some(handle), Some(tool)))?,
            _ => (None, None),
        };
        Ok(Self { args, profile, stop, mouse, tool })
    }

    /// Opens it, with its guard if it has motors. Without --motors-off it may move them from now on.
    pub(crate) fn open<const N: usize>(mut self, organ: &Organ<'_, N>) -> Result<hardware::Held, Failure> {
        if let Some(tool) = self.tool.take() {
            return Ok((Box::new(tool) as Box<dyn Device>, None));
        }
        let (device, guard) = open_device(self.args, organ, self.profile, self.stop)?;
        Ok((if self.args.motors_off { Box::new(MotorsOff::new(device)) } else { device }, guard))
    }
}
