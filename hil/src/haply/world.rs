//! The device, the version of its service, and the faults of both.

use super::now_ns;
use serde::Deserialize;
use serde_json::json;

/// Readiness of the device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(clippy::struct_excessive_bools, reason = "the flags of the service")]
pub struct Flags {
    /// It is calibrated.
    pub calibrated: bool,
    /// A program uses it.
    pub in_use: bool,
    /// It has power.
    pub power_supply: bool,
    /// It is ready.
    pub ready: bool,
    /// The service has started it.
    pub started: bool,
}

/// How the service replies to a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reply {
    /// Once, at once.
    Once,
    /// Once, after this time, ms.
    Late(u64),
    /// Twice.
    Twice,
    /// Never.
    Never,
    /// By closing the connection.
    Close,
    /// With a ping before the state.
    Ping,
    /// Without the lane of the Inverse3.
    NoLane,
    /// In two frames of one message.
    Fragmented,
    /// In a frame with a length of 64 bits.
    Long,
}

/// The force that acts on the hand, and its record.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Held {
    /// Device frame, N.
    pub force_n: [f64; 3],
    /// Time at which the last force other than zero ended, or now while it acts; 0 before the first, ns.
    pub until_ns: u64,
    /// Largest one, N.
    pub largest_n: f64,
}

impl Held {
    /// Size of the force, N.
    #[must_use]
    pub fn size_n(&self) -> f64 {
        self.force_n.iter().map(|n| n * n).sum::<f64>().sqrt()
    }

    fn set(&mut self, force_n: [f64; 3]) {
        if self.size_n() > 0.0 {
            self.until_ns = now_ns();
        }
        self.force_n = force_n;
        self.largest_n = self.largest_n.max(self.size_n());
    }

    /// As it is now.
    pub(super) fn now(mut self) -> Self {
        if self.size_n() > 0.0 {
            self.until_ns = now_ns();
        }
        self
    }
}

/// Everything that a test may change or look at.
#[derive(Debug, Clone, PartialEq)]
pub struct World {
    /// Version of the service.
    pub version: String,
    /// Whether HTTP answers are within an object with the keys `ok` and `data`.
    pub has_envelope: bool,
    /// Identity of the Inverse3.
    pub device_id: String,
    /// Whether the Inverse3 is there.
    pub is_present: bool,
    /// Whether another device comes before it in the list, once it has been chosen.
    pub other_first: bool,
    /// Its readiness.
    pub flags: Flags,
    /// Place of the handle, m.
    pub position_m: [f64; 3],
    /// How the grip is turned: w, x, y, z.
    pub orientation: [f64; 4],
    /// Whether button `a` of the grip is pressed.
    pub button: bool,
    /// How it replies.
    pub reply: Reply,
    /// Whether replies arrive in two TCP segments.
    pub is_split: bool,
    /// Whether forces of the messages are applied at all.
    pub applies: bool,
    /// The force on the hand as the last message set it; [`World::held`] is as of now.
    pub set: Held,
    /// Messages so far.
    pub messages: u64,
    /// Messages that came before the reply to the one before.
    pub pipelined: u64,
}

impl Default for World {
    fn default() -> Self {
        Self {
            version: "3.5.1".into(),
            has_envelope: true,
            device_id: "049D".into(),
            is_present: true,
            other_first: false,
            flags: Flags { calibrated: true, in_use: false, power_supply: true, ready: true, started: true },
            position_m: [0.0; 3],
            orientation: [1.0, 0.0, 0.0, 0.0],
            button: false,
            reply: Reply::Once,
            is_split: false,
            applies: true,
            set: Held::default(),
            messages: 0,
            pipelined: 0,
        }
    }
}

/// What an inventory has beside a state.
const CONFIG: &str = concat!(
    r#""config":{"type":"inverse3","port":"/dev/ttyACM0","handedness":"right","mount":{},"#,
    r#""device_info":{"major_version":9,"minor_version":1,"id":1181,"device_type":4},"#,
    r#""gravity_compensation":{"enabled":true,"scaling_factor":1.0},"basis":{"permutation":"XYZ"}},"#,
);

fn xyz([x, y, z]: [f64; 3]) -> String {
    format!(r#"{{"x":{x},"y":{y},"z":{z}}}"#)
}

/// The force of a message. Keys that are unknown are ignored.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Commands<'a> {
    #[serde(borrow)]
    inverse3: Vec<Commanded<'a>>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Commanded<'a> {
    device_id: &'a str,
    commands: Command,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Command {
    set_cursor_force: Force,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Force {
    vector: Option<Xyz>,
    values: Option<Xyz>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Xyz {
    x: f64,
    y: f64,
    z: f64,
}

impl World {
    /// The force on the hand.
    #[must_use]
    pub fn held(&self) -> Held {
        self.set.now()
    }

    /// Whether this version knows `vector`.
    fn knows_vector(&self) -> bool {
        let mut numbers = self.version.split('.').map(|part| part.parse::<u32>().unwrap_or(0));
        (numbers.next(), numbers.next()) >= (Some(3), Some(5))
    }

    /// Applies the force of a message. A key of another version is ignored in silence.
    pub(super) fn take(&mut self, text: &str) {
        self.messages += 1;
        let message: Commands<'_> = serde_json::from_str(text).unwrap_or_default();
        let force = message.inverse3.into_iter().find(|device| device.device_id == self.device_id);
        let force = force.map(|device| device.commands.set_cursor_force).unwrap_or_default();
        let vector = if self.knows_vector() { force.vector } else { force.values };
        let force_n = vector.map_or([0.0; 3], |Xyz { x, y, z }| [x, y, z]);
        self.set.set(if self.applies { force_n } else { [0.0; 3] });
    }

    /// The session of the force has ended.
    pub(super) fn release(&mut self) {
        self.set.set([0.0; 3]);
    }

    /// A state, or the inventory with the configuration.
    pub(super) fn state(&self, is_inventory: bool) -> String {
        let Flags { calibrated, in_use, power_supply, ready, started } = self.flags;
        let (id, place, force) = (&self.device_id, xyz(self.position_m), xyz(self.set.force_n));
        let config = if is_inventory { CONFIG } else { "" };
        let device = format!(
            r#"{{"device_id":"{id}",{config}"state":{{"cursor_position":{place},"cursor_velocity":{{"x":0,"y":0,"z":0}},"current_cursor_force":{force},"current_cursor_position":{place},"angular_position":{{"a0":10.0,"a1":45.5,"a2":98.0}},"control_domain":"cartesian","control_mode":"force"}},"status":{{"calibrated":{calibrated},"in_use":{in_use},"power_supply":{power_supply},"ready":{ready},"started":{started}}}}}"#
        );
        let other = format!(r#"{{"device_id":"0001","state":{{"cursor_position":{}}}}}"#, xyz([9.0; 3]));
        let all = [(self.other_first, &other), (self.is_present, &device)];
        let all: Vec<&str> =
            all.into_iter().filter(|(is, _)| *is).map(|(_, device)| device.as_str()).collect();
        let lane = match self.reply {
            Reply::NoLane if !is_inventory => String::new(),
            _ => format!(r#""inverse3":[{}],"#, all.join(",")),
        };
        let ([w, x, y, z], button) = (self.orientation, self.button);
        // An unknown key, for a long message.
        let is_long = self.reply == Reply::Long && !is_inventory;
        let note = if is_long { " ".repeat(usize::from(u16::MAX)) } else { String::new() };
        format!(
            r#"{{"session_id":7,{lane}"verse_grip":[],"wireless_verse_grip":[{{"device_id":"61CF","state":{{"orientation":{{"w":{w},"x":{x},"y":{y},"z":{z}}},"buttons":{{"a":{button},"b":false,"c":false}},"hall":0,"battery_level":0.9}},"status":{{"connected":true,"awake":true,"ready":true}}}}],"custom_verse_grip":[],"note":"{note}"}}"#
        )
    }

    /// The answer to a question for the version.
    pub(super) fn version_answer(&self) -> String {
        let version = json!({ "project_version": self.version, "git_tag": "" });
        let body = if self.has_envelope { json!({ "ok": true, "data": version }) } else { version };
        let body = body.to_string();
        format!(
            "HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: {}\r\n\r\n{body}",
            body.len()
        )
    }
}
