//! The messages of the service, as far as they are used. Keys and lanes (lists of devices of one kind) may be absent.

use core::fmt;
use palpate_core::{Orientation, Vec3, vec3};
use serde::{Deserialize, Serialize};

/// A vector as the service writes it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Xyz {
    x: f32,
    y: f32,
    z: f32,
}

impl From<Vec3> for Xyz {
    fn from([x, y, z]: Vec3) -> Self {
        Self { x, y, z }
    }
}

impl Xyz {
    /// The vector, if it is finite.
    pub(super) fn finite(self) -> Option<Vec3> {
        Some([self.x, self.y, self.z]).filter(|vector| vec3::is_finite(*vector))
    }
}

/// A unit quaternion as the service writes it.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub(super) struct Wxyz {
    w: f32,
    x: f32,
    y: f32,
    z: f32,
}

impl Wxyz {
    /// The rotation; `None` if the length is far from one, as that of a grip without data.
    pub(super) fn orientation(self) -> Option<Orientation> {
        let Self { w, x, y, z } = self;
        let length = (w * w + x * x + y * y + z * z).sqrt();
        (0.9..1.1)
            .contains(&length)
            .then(|| Orientation { w: w / length, xyz: [x / length, y / length, z / length] })
    }
}

/// The inventory after connecting, or a state: the lanes of which it says something.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Message {
    pub(super) inverse3: Option<Vec<Inverse>>,
    pub(super) verse_grip: Option<Vec<Grip>>,
    pub(super) wireless_verse_grip: Option<Vec<Grip>>,
}

/// An Inverse3.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Inverse {
    pub(super) device_id: Option<String>,
    config: Option<Config>,
    state: Option<State>,
    status: Option<Status>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Config {
    #[serde(rename = "type")]
    kind: Option<String>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct State {
    cursor_position: Option<Xyz>,
    /// Its name in some versions.
    current_cursor_position: Option<Xyz>,
    current_cursor_force: Option<Xyz>,
}

/// A grip with a wire (one button) or without (several).
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Grip {
    pub(super) state: Option<GripState>,
}

/// What a grip measures.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct GripState {
    pub(super) orientation: Option<Wxyz>,
    pub(super) button: Option<bool>,
    pub(super) buttons: Option<Buttons>,
}

/// The buttons of the wireless grips.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Buttons {
    a: bool,
    b: bool,
    c: bool,
    d: bool,
    e: bool,
    f: bool,
    up: bool,
    down: bool,
    left: bool,
    right: bool,
}

impl Buttons {
    /// Bit 0 is `a`.
    pub(super) fn bits(&self) -> u32 {
        let Self { a, b, c, d, e, f, up, down, left, right } = *self;
        let all = [a, b, c, d, e, f, up, down, left, right];
        all.into_iter().rev().fold(0, |bits, is_pressed| bits << 1 | u32::from(is_pressed))
    }
}

/// Readiness of an Inverse3; `None` of what no message has stated.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(default)]
pub(super) struct Status {
    calibrated: Option<bool>,
    in_use: Option<bool>,
    power_supply: Option<bool>,
    ready: Option<bool>,
    started: Option<bool>,
}

/// What prevents a force.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Obstacle {
    /// Another program uses the device.
    InUse,
    /// Its power supply is off.
    NoPower,
    /// The service has not started it.
    NotStarted,
    /// It is not calibrated.
    NotCalibrated,
    /// Something else.
    NotReady,
    /// The service lists it no longer.
    Vanished,
}

impl fmt::Display for Obstacle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::InUse => "is in use; end the other program that uses it",
            Self::NoPower => "has no power; connect and switch on its power supply",
            Self::NotStarted => "is not started; start it in the Haply Hub, or plug it out and in",
            Self::NotCalibrated => "is not calibrated; calibrate it in the Haply Hub",
            Self::NotReady => "is not ready; look at it in the Haply Hub, or plug it out and in",
            Self::Vanished => "is gone; check its cable",
        })
    }
}

impl Status {
    /// Takes over what a newer message states.
    pub(super) fn update(&mut self, newer: Self) {
        self.calibrated = newer.calibrated.or(self.calibrated);
        self.in_use = newer.in_use.or(self.in_use);
        self.power_supply = newer.power_supply.or(self.power_supply);
        self.ready = newer.ready.or(self.ready);
        self.started = newer.started.or(self.started);
    }

    /// What prevents a force. What was never stated does, too.
    ///
    /// `in_use` counts only before our own first command, which may set it.
    pub(super) fn obstacle(self, at_opening: bool) -> Option<Obstacle> {
        let is_missing = |flag: Option<bool>| flag != Some(true);
        match self {
            _ if at_opening && self.in_use == Some(true) => Some(Obstacle::InUse),
            _ if is_missing(self.power_supply) => Some(Obstacle::NoPower),
            _ if is_missing(self.started) => Some(Obstacle::NotStarted),
            _ if is_missing(self.calibrated) => Some(Obstacle::NotCalibrated),
            _ if is_missing(self.ready) => Some(Obstacle::NotReady),
            _ => None,
        }
    }
}

impl Inverse {
    /// Place of the handle, m; `None` if the message does not state it.
    pub(super) fn position_m(&self) -> Option<Vec3> {
        let state = self.state.as_ref()?;
        state.cursor_position.or(state.current_cursor_position)?.finite()
    }

    /// The force that the service says it renders, N.
    pub(super) fn rendered_n(&self) -> Option<Vec3> {
        self.state.as_ref()?.current_cursor_force?.finite()
    }

    /// The flags that the message states.
    pub(super) fn status(&self) -> Status {
        self.status.unwrap_or_default()
    }

    /// Its model, as far as the message has it.
    pub(super) fn model(&self) -> &str {
        self.config.as_ref().and_then(|config| config.kind.as_deref()).unwrap_or("inverse3")
    }
}

/// How a version of the service names the vector of a force. A name that it does not know is ignored in silence.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ForceKey {
    /// From 3.5 on.
    Vector,
    /// Before.
    Values,
}

/// The command of a force, N, for a device.
pub(super) fn force_command(device_id: &str, key: ForceKey, force_n: Vec3) -> String {
    #[derive(Serialize)]
    struct Command<'a> {
        inverse3: [Device<'a>; 1],
    }
    #[derive(Serialize)]
    struct Device<'a> {
        device_id: &'a str,
        commands: Commands,
    }
    #[derive(Serialize)]
    struct Commands {
        set_cursor_force: Force,
    }
    #[derive(Serialize)]
    #[serde(rename_all = "lowercase")]
    enum Force {
        Vector(Xyz),
        Values(Xyz),
    }
    let set_cursor_force = match key {
        ForceKey::Vector => Force::Vector(force_n.into()),
        ForceKey::Values => Force::Values(force_n.into()),
    };
    let device = Device { device_id, commands: Commands { set_cursor_force } };
    serde_json::to_string(&Command { inverse3: [device] }).unwrap_or_default()
}
