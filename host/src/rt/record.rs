//! The record of a tick: its inputs, its outputs and its times.
//!
//! The names of the fields are those of the messages in a recording, which serde writes and reads.

mod form;

use crate::device::DeviceState;
use crate::live::LiveTick;
use palpate_core::{Command, Coverage, NodeWeight, Phase, Sample, Vec3, vec3};
use serde::{Deserialize, Serialize};

/// Requests of other threads that were applied before a tick, in the order of application.
///
/// A press of the arming button is not included: it follows from the samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Applied {
    /// The guard or the device zeroed the force since the last tick.
    pub zeroed: bool,
    /// A latched fault was cleared.
    pub reset: bool,
    /// Arming was requested.
    pub arm: bool,
    /// Disarming was requested.
    pub disarm: bool,
}

/// Inputs and outputs of one tick, small enough to be copied through a queue.
///
/// Absent values (`sample`, `coverage`, `fault`) are omitted in a message, because viewers support no null in a
/// schema.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TickRecord {
    /// Number of the deadline of this tick. A gap means skipped deadlines.
    pub tick: u64,
    /// Time of the tick since the start of the loop, us.
    pub t_us: u64,
    /// The sample from the device, if there was one.
    #[serde(default, skip_serializing_if = "Option::is_none", with = "form::sample")]
    pub sample: Option<Sample>,
    /// State of the device.
    #[serde(with = "form::device")]
    pub device: DeviceState,
    /// Requests applied before the tick.
    #[serde(flatten)]
    pub applied: Applied,
    /// Index of the rendered model.
    pub model: u8,
    /// HIP, model frame, m.
    #[serde(with = "form::vector")]
    pub hip_m: Vec3,
    /// Displacement of the engaged node, m; zero when free.
    #[serde(with = "form::vector")]
    pub displacement_m: Vec3,
    /// Index of the engaged space; with several engaged spaces the one with the largest weight.
    #[serde(with = "form::engaged")]
    pub engaged: Option<u16>,
    /// The engaged spaces with their weights.
    #[serde(with = "form::shares")]
    pub shares: [NodeWeight; 3],
    /// h of the model, force by the tool on the body, N; zero when free.
    #[serde(with = "form::vector")]
    pub reaction_n: Vec3,
    /// Moment of h about the HIP, N m; zero when free, and of a tool without an axis.
    #[serde(default, skip_serializing_if = "is_zero", with = "form::vector")]
    pub reaction_n_m: Vec3,
    /// Force for the hand after every limit, N.
    #[serde(with = "form::vector")]
    pub hand_force_n: Vec3,
    /// The force that the device reported with the sample, model frame, N; absent if it reports none.
    #[serde(default, skip_serializing_if = "Option::is_none", with = "form::reported")]
    pub reported_n: Option<Vec3>,
    /// Coverage of the reaction.
    #[serde(default, skip_serializing_if = "Option::is_none", with = "form::coverage")]
    pub coverage: Option<Coverage>,
    /// Phase of the controller.
    #[serde(flatten, with = "form::phase")]
    pub phase: Phase,
    /// Share of the force after arming; 1 after the ramp.
    pub ramp: f32,
    /// Whether the reaction exceeded the force limit.
    pub clamped: bool,
    /// Work done on the hand since the start of the contact, J, in device metres.
    pub hand_work_j: f32,
    /// Whether the energy guard added damping.
    pub damped: bool,
    /// Device exchange and controller together, ns.
    pub compute_ns: u64,
    /// Time of the device exchange, ns; `None` in old recordings without this field.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub device_ns: Option<u64>,
    /// Start of the tick minus its deadline, ns.
    pub lateness_ns: u64,
    /// Deadlines skipped so far.
    pub skipped_periods: u64,
    /// What the tick got from a live solver; `None` where tables give the force.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub live: Option<LiveTick>,
}

impl TickRecord {
    /// The controller's outputs, with empty inputs.
    #[must_use]
    pub const fn of(command: &Command) -> Self {
        Self {
            hip_m: command.hip_m,
            displacement_m: command.displacement_m,
            engaged: command.engaged,
            shares: command.weights,
            reaction_n: command.reaction_n,
            reaction_n_m: command.reaction_n_m,
            hand_force_n: command.hand_force_n,
            coverage: command.coverage,
            phase: command.phase,
            ramp: command.ramp,
            clamped: command.clamped,
            hand_work_j: command.hand_work_j,
            damped: command.damped,
            ..Self::EMPTY
        }
    }

    /// The record before the first tick.
    pub const EMPTY: Self = Self {
        tick: 0,
        t_us: 0,
        sample: None,
        device: DeviceState::Disconnected,
        applied: Applied { zeroed: false, reset: false, arm: false, disarm: false },
        model: 0,
        hip_m: vec3::ZERO,
        displacement_m: vec3::ZERO,
        engaged: None,
        shares: [NodeWeight { space: 0, weight: 0.0 }; 3],
        reaction_n: vec3::ZERO,
        reaction_n_m: vec3::ZERO,
        hand_force_n: vec3::ZERO,
        reported_n: None,
        coverage: None,
        phase: Phase::Disarmed,
        ramp: 0.0,
        clamped: false,
        hand_work_j: 0.0,
        damped: false,
        compute_ns: 0,
        device_ns: None,
        lateness_ns: 0,
        skipped_periods: 0,
        live: None,
    };
}

fn is_zero(vector: &Vec3) -> bool {
    *vector == vec3::ZERO
}
