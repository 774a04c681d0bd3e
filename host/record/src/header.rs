//! The metadata of a recording: the settings that a replay must match, and the end of the session. Text by
//! key, as MCAP defines it.

use crate::error::RecordingError;
use crate::format::FORMAT;
use core::fmt::Display;
use core::str::FromStr;
use palpate_core::{Config, ContactConfig, LimitConfig, Method, Organ, PassivityConfig, Phase};
use palpate_host::device::DeviceInfo;
use palpate_host::instructions::Instructions;
use palpate_host::rt::{LoopConfig, LoopEnd};
use palpate_host::session::SessionSummary;
use std::collections::BTreeMap;

type Entries = BTreeMap<String, String>;

/// What was recorded, and the settings.
#[derive(Debug, Clone, PartialEq)]
pub struct Header {
    /// The program and its version.
    pub program: String,
    /// BLAKE3 of the blob of each model, hexadecimal. A replay needs exactly these blobs.
    pub blob_blake3: Vec<String>,
    /// Scene of the blob.
    pub scene: String,
    /// Names of the active nodes; `engaged` of a tick is an index into them.
    pub active: Vec<String>,
    /// Vector instructions of the interpolation, for information: they do not change the result.
    pub instructions: String,
    /// The device.
    pub device: DeviceInfo,
    /// Timing of the loop and its arming button.
    pub haptic: LoopConfig,
    /// Method, contact and limits.
    pub config: Config,
    /// Wall clock when the recording was opened, some milliseconds before the first tick, ns since 1970.
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

    pub(super) fn entries(&self) -> Entries {
        let Config { method, contact, limits, passivity } = self.config;
        let entry = |key: &str, value: &dyn Display| (key.to_string(), value.to_string());
        // A float is written with enough digits to restore its bits.
        Entries::from([
            entry("format", &FORMAT),
            entry("program", &self.program),
            entry("blob_blake3", &self.blob_blake3.join(",")),
            entry("scene", &self.scene),
            // No name of an active node contains a comma: a scene with such a name is refused.
            entry("active", &self.active.join(",")),
            entry("instructions", &self.instructions),
            entry("device", &self.device.name),
            entry("device_self_arming", &self.device.self_arming),
            entry("device_max_force_n", &self.device.max_force_n),
            entry("device_max_stiffness_n_m", &self.device.max_stiffness_n_m),
            entry("device_resolution_m", &self.device.resolution_m),
            entry("period_us", &self.haptic.period_us),
            entry("spin_us", &self.haptic.spin_us),
            entry("arm_button", &self.haptic.arm_button),
            entry("method", &method.name()),
            entry("capture_radius_m", &contact.capture_radius_m),
            entry("release_tension_n", &contact.release_tension_n),
            entry("release_height_m", &contact.release_height_m),
            entry("friction", &contact.friction),
            entry("grasp_slip", &contact.grasp_slip),
            entry("grasp_distance_m", &contact.grasp_distance_m),
            entry("grasp_button", &contact.grasp_button),
            entry("max_force_n", &limits.max_force_n),
            entry("max_slew_n_per_s", &limits.max_slew_n_per_s),
            entry("ramp_s", &limits.ramp_s),
            entry("fade_s", &limits.fade_s),
            entry("stale_hold_ticks", &limits.stale_hold_ticks),
            entry("stale_fault_us", &limits.stale_fault_us),
            entry("max_position_m", &limits.max_position_m),
            entry("max_speed_m_s", &limits.max_speed_m_s),
            entry("max_stiffness_n_m", &limits.max_stiffness_n_m),
            entry("energy_margin_j", &passivity.margin_j),
            entry("energy_damping_n_s_m", &passivity.max_damping_n_s_m),
            entry("energy_fault_j", &passivity.fault_j),
            entry("workspace_scale", &passivity.workspace_scale),
            entry("position_step_m", &passivity.position_step_m),
            entry("force_delay_us", &passivity.force_delay_us),
            entry("start_unix_ns", &self.start_unix_ns),
        ])
    }

    pub(super) fn of(entries: &Entries) -> Result<Self, RecordingError> {
        let format: String = get(entries, "format")?;
        if format != FORMAT.to_string() {
            return Err(RecordingError::Format(format));
        }
        let method: String = get(entries, "method")?;
        let list = |key| -> Result<Vec<String>, RecordingError> {
            let joined: String = get(entries, key)?;
            Ok(joined.split(',').filter(|name| !name.is_empty()).map(Into::into).collect())
        };
        Ok(Self {
            program: get(entries, "program")?,
            blob_blake3: list("blob_blake3")?,
            scene: get(entries, "scene")?,
            active: list("active")?,
            instructions: get(entries, "instructions")?,
            device: DeviceInfo {
                name: get(entries, "device")?,
                self_arming: get(entries, "device_self_arming")?,
                max_force_n: get(entries, "device_max_force_n")?,
                max_stiffness_n_m: get(entries, "device_max_stiffness_n_m")?,
                resolution_m: get(entries, "device_resolution_m")?,
            },
            haptic: LoopConfig {
                period_us: get(entries, "period_us")?,
                spin_us: get(entries, "spin_us")?,
                arm_button: get(entries, "arm_button")?,
            },
            config: Config {
                method: Method::from_name(&method).ok_or(RecordingError::Entry("method"))?,
                contact: ContactConfig {
                    capture_radius_m: get(entries, "capture_radius_m")?,
                    release_tension_n: get(entries, "release_tension_n")?,
                    release_height_m: get(entries, "release_height_m")?,
                    friction: get(entries, "friction")?,
                    grasp_slip: get(entries, "grasp_slip")?,
                    grasp_distance_m: get(entries, "grasp_distance_m")?,
                    grasp_button: get(entries, "grasp_button")?,
                },
                limits: LimitConfig {
                    max_force_n: get(entries, "max_force_n")?,
                    max_slew_n_per_s: get(entries, "max_slew_n_per_s")?,
                    ramp_s: get(entries, "ramp_s")?,
                    fade_s: get(entries, "fade_s")?,
                    stale_hold_ticks: get(entries, "stale_hold_ticks")?,
                    stale_fault_us: get(entries, "stale_fault_us")?,
                    max_position_m: get(entries, "max_position_m")?,
                    max_speed_m_s: get(entries, "max_speed_m_s")?,
                    max_stiffness_n_m: get(entries, "max_stiffness_n_m")?,
                },
                passivity: PassivityConfig {
                    margin_j: get(entries, "energy_margin_j")?,
                    max_damping_n_s_m: get(entries, "energy_damping_n_s_m")?,
                    fault_j: get(entries, "energy_fault_j")?,
                    workspace_scale: get(entries, "workspace_scale")?,
                    position_step_m: get(entries, "position_step_m")?,
                    force_delay_us: get(entries, "force_delay_us")?,
                },
            },
            start_unix_ns: get(entries, "start_unix_ns")?,
        })
    }
}

/// End of a recorded session. Absent from a truncated recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct End {
    /// Number of ticks.
    pub ticks: u64,
    /// Records dropped by the queue of the thread that also drew. 0 since the recorder has a queue of its own.
    pub dropped_by_loop: u64,
    /// Records dropped by the recorder's queue because the disk did not keep up.
    pub dropped_by_recorder: u64,
    /// Device exchanges that failed with a transient error.
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

    pub(super) fn entries(&self) -> Entries {
        Entries::from([
            ("ticks".into(), self.ticks.to_string()),
            ("dropped_by_loop".into(), self.dropped_by_loop.to_string()),
            ("dropped_by_recorder".into(), self.dropped_by_recorder.to_string()),
            ("device_errors".into(), self.device_errors.to_string()),
            ("reason".into(), self.reason.clone()),
            ("phase".into(), self.phase.clone()),
        ])
    }

    pub(super) fn read(entries: &Entries) -> Result<Self, RecordingError> {
        Ok(Self {
            ticks: get(entries, "ticks")?,
            dropped_by_loop: get(entries, "dropped_by_loop")?,
            dropped_by_recorder: get(entries, "dropped_by_recorder")?,
            device_errors: get(entries, "device_errors")?,
            reason: get(entries, "reason")?,
            phase: get(entries, "phase")?,
        })
    }
}

fn get<T: FromStr>(entries: &Entries, key: &'static str) -> Result<T, RecordingError> {
    let value = entries.get(key).ok_or(RecordingError::Entry(key))?;
    value.parse().map_err(|_| RecordingError::Entry(key))
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
                method: Method::RbfCubic,
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
    fn a_missing_entry_is_named() {
        let entries = header().entries();
        for key in entries.keys() {
            let mut fewer = entries.clone();
            fewer.remove(key);
            let refused = Header::of(&fewer).expect_err("incomplete").to_string();
            assert!(refused.contains(key.as_str()), "{key}: {refused}");
        }
        let mut newer = entries;
        newer.insert("format".into(), "4".into());
        assert!(matches!(Header::of(&newer), Err(RecordingError::Format(version)) if version == "4"));
    }
}
