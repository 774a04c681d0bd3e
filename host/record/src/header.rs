//! The metadata of a recording: the settings that a replay must match, and the end of the session. Text by
//! key, as MCAP defines it.

mod form;

use crate::error::RecordingError;
use crate::format::FORMAT;
use form::{list, method, text, vector};
use palpate_core::{Config, ContactConfig, LimitConfig, Method, Organ, PassivityConfig, Phase, Vec3};
use palpate_host::device::DeviceInfo;
use palpate_host::instructions::Instructions;
use palpate_host::rt::{LoopConfig, LoopEnd};
use palpate_host::session::SessionSummary;
use serde::de::value::{Error, MapDeserializer};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

type Entries = BTreeMap<String, String>;

/// The key of the version, which is read before the other fields.
const FORMAT_KEY: &str = "format";

/// What was recorded, and the settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// The program and its version.
    pub program: String,
    /// BLAKE3 of the blob of each model, hexadecimal. A replay needs exactly these blobs.
    #[serde(with = "list")]
    pub blob_blake3: Vec<String>,
    /// Scene of the blob.
    pub scene: String,
    /// Names of the active nodes; `engaged` of a tick is an index into them.
    #[serde(with = "list")]
    pub active: Vec<String>,
    /// Vector instructions of the interpolation, for information: they do not change the result.
    pub instructions: String,
    /// The device.
    #[serde(flatten, with = "DeviceForm")]
    pub device: DeviceInfo,
    /// Timing of the loop and its arming button.
    #[serde(flatten, with = "LoopForm")]
    pub haptic: LoopConfig,
    /// Method, contact and limits.
    #[serde(flatten, with = "ConfigForm")]
    pub config: Config,
    /// Wall clock when the recording was opened, some milliseconds before the first tick, ns since 1970.
    #[serde(with = "text")]
    pub start_unix_ns: u64,
}

impl Header {
    /// The header of a session that is about to begin.
    pub fn new<const N: usize>(
        organ: &Organ<'_, N>,
        blob_blake3: Vec<String>,
        config: Config,
        haptic: LoopConfig,
        device: DeviceInfo,
        start_unix_ns: u64,
    ) -> Self {
        Self {
            program: concat!("palpate ", env!("CARGO_PKG_VERSION")).into(),
            blob_blake3,
            scene: organ.scene.as_str().into(),
            active: organ.spaces.iter().map(|space| space.active.name.as_str().into()).collect(),
            instructions: Instructions::best().name().into(),
            device,
            haptic,
            config,
            start_unix_ns,
        }
    }

    /// Whether jets of a live solver gave the force.
    #[must_use]
    pub const fn is_live(&self) -> bool {
        self.config.method.is_none()
    }

    pub(crate) fn entries(&self) -> Entries {
        let mut entries = write(self);
        entries.insert(FORMAT_KEY.into(), FORMAT.to_string());
        entries
    }

    pub(crate) fn of(entries: &Entries) -> Result<Self, RecordingError> {
        match entries.get(FORMAT_KEY) {
            Some(format) if *format == FORMAT.to_string() => read(entries),
            Some(format) => Err(RecordingError::Format(format.clone())),
            None => Err(RecordingError::Metadata(format!("missing field `{FORMAT_KEY}`"))),
        }
    }
}

/// End of a recorded session. Absent from a truncated recording.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct End {
    /// Number of ticks.
    #[serde(with = "text")]
    pub ticks: u64,
    /// Records dropped by the queue of the thread that also drew. 0 since the recorder has a queue of its own.
    #[serde(with = "text")]
    pub dropped_by_loop: u64,
    /// Records dropped by the recorder's queue because the disk did not keep up.
    #[serde(with = "text")]
    pub dropped_by_recorder: u64,
    /// Device exchanges that failed with a transient error.
    #[serde(with = "text")]
    pub device_errors: u64,
    /// Reason of the end.
    pub reason: String,
    /// Phase at the end.
    pub phase: String,
}

impl End {
    /// The end of a session.
    #[must_use]
    pub fn of_session(summary: &SessionSummary) -> Self {
        Self {
            ticks: summary.ticks,
            dropped_by_loop: 0,
            dropped_by_recorder: summary.dropped_by_recorder,
            device_errors: summary.device_errors,
            reason: match summary.end {
                LoopEnd::Completed => "completed".into(),
                LoopEnd::Stopped => "stopped".into(),
                LoopEnd::DeviceLost(error) => format!("device lost: {error}"),
            },
            phase: match summary.phase {
                Phase::Disarmed => "disarmed".into(),
                Phase::Active => "active".into(),
                Phase::SafeZero(fault) => format!("safe-zero: {}", fault.name()),
            },
        }
    }

    pub(crate) fn entries(&self) -> Entries {
        write(self)
    }

    pub(crate) fn read(entries: &Entries) -> Result<Self, RecordingError> {
        read(entries)
    }
}

/// Declares how the fields of a type of another crate are written: each as text, under the name of the field
/// or of its `rename`.
macro_rules! form {
    ($form:ident of $type:literal { $($(#[$at:meta])* $field:ident: $kind:ty,)* }) => {
        #[derive(Serialize, Deserialize)]
        #[serde(remote = $type)]
        struct $form {
            $($(#[$at])* #[serde(with = "text")] $field: $kind,)*
        }
    };
}

form!(DeviceForm of "DeviceInfo" {
    #[serde(rename = "device")]
    name: String,
    #[serde(rename = "device_self_arming")]
    self_arming: bool,
    #[serde(rename = "device_max_force_n")]
    max_force_n: f32,
    #[serde(rename = "device_max_stiffness_n_m")]
    max_stiffness_n_m: f32,
    #[serde(rename = "device_resolution_m")]
    resolution_m: f32,
});

form!(LoopForm of "LoopConfig" {
    period_us: u32,
    spin_us: u32,
    arm_button: u32,
});

form!(ContactForm of "ContactConfig" {
    capture_radius_m: f32,
    release_tension_n: f32,
    release_height_m: f32,
    friction: f32,
    grasp_slip: f32,
    grasp_distance_m: f32,
    grasp_button: u32,
});

form!(LimitForm of "LimitConfig" {
    max_force_n: f32,
    max_slew_n_per_s: f32,
    ramp_s: f32,
    fade_s: f32,
    stale_hold_ticks: u32,
    stale_fault_us: u64,
    max_position_m: f32,
    max_speed_m_s: f32,
    max_stiffness_n_m: f32,
});

form!(PassivityForm of "PassivityConfig" {
    #[serde(rename = "energy_margin_j")]
    margin_j: f32,
    #[serde(rename = "energy_damping_n_s_m")]
    max_damping_n_s_m: f32,
    #[serde(rename = "energy_fault_j")]
    fault_j: f32,
    workspace_scale: f32,
    position_step_m: f32,
    force_delay_us: u32,
});

#[derive(Serialize, Deserialize)]
#[serde(remote = "Config")]
struct ConfigForm {
    #[serde(with = "method")]
    method: Option<Method>,
    #[serde(flatten, with = "ContactForm")]
    contact: ContactConfig,
    #[serde(flatten, with = "LimitForm")]
    limits: LimitConfig,
    #[serde(flatten, with = "PassivityForm")]
    passivity: PassivityConfig,
    /// Absent from recordings of programs that added it after the controller.
    #[serde(default, with = "vector")]
    gravity_compensation_n: Vec3,
}

fn write(fields: &impl Serialize) -> Entries {
    let written = serde_json::to_value(fields).and_then(serde_json::from_value);
    written.expect("every field is text under a name")
}

fn read<T: for<'de> Deserialize<'de>>(entries: &Entries) -> Result<T, RecordingError> {
    let entries = entries.iter().map(|(key, value)| (key.as_str(), value.as_str()));
    T::deserialize(MapDeserializer::new(entries))
        .map_err(|error: Error| RecordingError::Metadata(error.to_string()))
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A header in which no number has its default value.
    pub(crate) fn header() -> Header {
        Header {
            program: "palpate 0.0.1".into(),
            blob_blake3: vec!["ab".repeat(32), "cd".repeat(32)],
            scene: "a liver, \"fresh\"".into(),
            active: vec!["A1".into(), "A2".into()],
            instructions: "avx2".into(),
            device: DeviceInfo {
                name: "a hand".into(),
                self_arming: true,
                max_force_n: f32::INFINITY,
                max_stiffness_n_m: 1e3,
                resolution_m: 30.0e-6,
            },
            haptic: LoopConfig { period_us: 999, spin_us: 7, arm_button: 4 },
            config: Config {
                method: Some(Method::RbfCubic),
                contact: ContactConfig {
                    capture_radius_m: 0.1 + 0.2,
                    release_tension_n: f32::MIN_POSITIVE,
                    release_height_m: 1.0e-45,
                    friction: f32::INFINITY,
                    grasp_slip: 1.07,
                    grasp_distance_m: 2.5e-3,
                    grasp_button: u32::MAX,
                },
                limits: LimitConfig {
                    max_force_n: 1.0 / 3.0,
                    max_slew_n_per_s: f32::MAX,
                    ramp_s: 0.0,
                    fade_s: 0.017,
                    stale_hold_ticks: 5,
                    stale_fault_us: u64::MAX,
                    max_position_m: 0.7,
                    max_speed_m_s: 16_777_217.0,
                    max_stiffness_n_m: 2_999.9,
                },
                passivity: PassivityConfig {
                    margin_j: 0.011,
                    max_damping_n_s_m: 0.3,
                    fault_j: f32::INFINITY,
                    workspace_scale: 1.7,
                    position_step_m: 0.0,
                    force_delay_us: 107,
                },
                gravity_compensation_n: [0.1 + 0.2, -0.7, f32::MIN_POSITIVE],
            },
            start_unix_ns: 1_795_000_000_123_456_789,
        }
    }

    #[test]
    fn the_header_survives_a_round_trip() {
        let header = header();
        assert_eq!(Header::of(&header.entries()).expect("complete"), header);
    }

    #[test]
    fn a_live_session_has_jets_in_place_of_a_method() {
        let mut header = header();
        header.config.method = None;
        let mut entries = header.entries();
        assert_eq!(entries["method"], "jets");
        assert_eq!(Header::of(&entries).expect("complete"), header);
        entries.insert("method".into(), "jet".into());
        let refused = Header::of(&entries).expect_err("no such method").to_string();
        assert!(refused.contains("jet"), "{refused}");
    }

    /// Recordings are read by these keys.
    #[test]
    fn the_text_of_the_entries_is_kept() {
        let text: Vec<String> =
            header().entries().iter().map(|(key, value)| format!("{key}={value}")).collect();
        assert_eq!(text, TEXT);
    }

    const TEXT: [&str; 39] = [
        "active=A1,A2",
        "arm_button=4",
        concat!(
            "blob_blake3=abababababababababababababababababababababababababababababababab,",
            "cdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcd"
        ),
        "capture_radius_m=0.3",
        "device=a hand",
        "device_max_force_n=inf",
        "device_max_stiffness_n_m=1000",
        "device_resolution_m=0.00003",
        "device_self_arming=true",
        "energy_damping_n_s_m=0.3",
        "energy_fault_j=inf",
        "energy_margin_j=0.011",
        "fade_s=0.017",
        "force_delay_us=107",
        "format=3",
        "friction=inf",
        "grasp_button=4294967295",
        "grasp_distance_m=0.0025",
        "grasp_slip=1.07",
        "gravity_compensation_n=0.3,-0.7,0.000000000000000000000000000000000000011754944",
        "instructions=avx2",
        "max_force_n=0.33333334",
        "max_position_m=0.7",
        "max_slew_n_per_s=340282350000000000000000000000000000000",
        "max_speed_m_s=16777216",
        "max_stiffness_n_m=2999.9",
        "method=rbf-cubic",
        "period_us=999",
        "position_step_m=0",
        "program=palpate 0.0.1",
        "ramp_s=0",
        "release_height_m=0.000000000000000000000000000000000000000000001",
        "release_tension_n=0.000000000000000000000000000000000000011754944",
        "scene=a liver, \"fresh\"",
        "spin_us=7",
        "stale_fault_us=18446744073709551615",
        "stale_hold_ticks=5",
        "start_unix_ns=1795000000123456789",
        "workspace_scale=1.7",
    ];

    #[test]
    fn a_missing_entry_is_named() {
        let entries = header().entries();
        for key in entries.keys().filter(|key| *key != "gravity_compensation_n") {
            let mut fewer = entries.clone();
            fewer.remove(key);
            let refused = Header::of(&fewer).expect_err("incomplete").to_string();
            assert!(refused.contains(key.as_str()), "{key}: {refused}");
        }
        let mut unread = entries.clone();
        unread.insert("spin_us".into(), "soon".into());
        let refused = Header::of(&unread).expect_err("no number").to_string();
        assert!(refused.contains("soon"), "{refused}");
        let mut newer = entries;
        newer.insert("format".into(), "4".into());
        assert!(matches!(Header::of(&newer), Err(RecordingError::Format(version)) if version == "4"));
    }
}
