//! The real-time side: clock, 1 kHz loop, its thread and its timing figures.

pub mod clock;
pub mod controls;
pub mod haptic_loop;
pub mod histogram;
pub mod latency;
pub mod pace;
pub mod state;
pub mod thread;
pub mod watchdog;

pub use clock::{Clock, MonotonicClock, VirtualClock};
pub use controls::Controls;
pub use haptic_loop::{HapticLoop, LoopConfig, LoopEnd, LoopOutcome, Outputs};
pub use histogram::{HistogramRow, Histograms, Quantity};
pub use latency::{LatencyRecorder, LatencyReport, Miss, Percentiles, TickTimes};
pub use pace::{Paced, Paces, pace};
pub use state::SessionState;
pub use watchdog::{Heartbeat, Watchdog};

use crate::device::DeviceState;
use palpate_core::{Command, Coverage, Phase, Sample, Share, Vec3, vec3};

/// What was asked of the controller from other threads before a tick, in the order in which it was done.
///
/// A press of the arming button is not in it: it follows from the samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Applied {
    /// The watchdog had zeroed the device since the last tick.
    pub zeroed: bool,
    /// A latched fault was cleared.
    pub reset: bool,
    /// Rendering was asked for.
    pub arm: bool,
    /// Rendering was ended.
    pub disarm: bool,
}

/// Everything one tick has to tell, what went into it and what came out, small enough to be copied through a queue.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TickRecord {
    /// Number of the deadline this tick ran for; a gap means skipped deadlines.
    pub tick: u64,
    /// Time of the tick since the loop began, us.
    pub t_us: u64,
    /// What the device said, if it said anything.
    pub sample: Option<Sample>,
    /// How far the device is.
    pub device: DeviceState,
    /// What was asked of the controller before the tick.
    pub applied: Applied,
    /// Index of the model it ran with.
    pub model: u8,
    /// HIP, model frame, m.
    pub hip_m: Vec3,
    /// Displacement of the engaged node, m; zero when free.
    pub displacement_m: Vec3,
    /// Index of the engaged space; of the heaviest where several answer.
    pub engaged: Option<u16>,
    /// The spaces that answered, with their weights.
    pub shares: [Share; 3],
    /// h of the model, force by the tool on the body, N; zero when free.
    pub reaction_n: Vec3,
    /// Force for the hand after every limit, N.
    pub hand_force_n: Vec3,
    /// Data behind the reaction.
    pub coverage: Option<Coverage>,
    /// What the controller is doing.
    pub phase: Phase,
    /// Share of the force since arming, 1 after the ramp.
    pub ramp: f32,
    /// Whether the reaction was beyond the force limit.
    pub clamped: bool,
    /// Work done on the hand since it touched, J, in device metres.
    pub hand_work_j: f32,
    /// Whether the guard on energy added damping.
    pub damped: bool,
    /// Device exchange and controller together, ns.
    pub compute_ns: u64,
    /// The device's part of it, ns; not known of a tick recorded before this was kept.
    pub device_ns: Option<u64>,
    /// Start of the tick after its deadline, ns.
    pub lateness_ns: u64,
    /// Deadlines skipped so far.
    pub skipped_periods: u64,
}

impl TickRecord {
    /// What the controller decided, and nothing of what led to it.
    #[must_use]
    pub const fn of(command: &Command) -> Self {
        Self {
            hip_m: command.hip_m,
            displacement_m: command.displacement_m,
            engaged: command.engaged,
            shares: command.shares,
            reaction_n: command.reaction_n,
            hand_force_n: command.hand_force_n,
            coverage: command.coverage,
            phase: command.phase,
            ramp: command.ramp,
            clamped: command.clamped,
            hand_work_j: command.hand_work_j,
            damped: command.damped,
            ..Self::NOTHING
        }
    }

    /// Before the first tick.
    pub const NOTHING: Self = Self {
        tick: 0,
        t_us: 0,
        sample: None,
        device: DeviceState::Disconnected,
        applied: Applied { zeroed: false, reset: false, arm: false, disarm: false },
        model: 0,
        hip_m: vec3::ZERO,
        displacement_m: vec3::ZERO,
        engaged: None,
        shares: [Share { space: 0, weight: 0.0 }; 3],
        reaction_n: vec3::ZERO,
        hand_force_n: vec3::ZERO,
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
    };
}
