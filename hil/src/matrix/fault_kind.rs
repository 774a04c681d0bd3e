//! The kinds of fault, and their parameters in one run.

use super::ended::Ended;
use crate::fault::{Faults, REORDER_TIMEOUT_US};
use crate::rig::{HardwareFault, RigKind};
use palpate_core::Fault;

/// Kind of fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum FaultKind {
    /// Frames are lost, 1 to 40 ms.
    Drop,
    /// No frame passes in either direction for 60 ms.
    Silence,
    /// Frames are delayed by 2 to 40 ms, for up to 60 ms.
    Delay,
    /// Frames are duplicated, 1 to 40 ms.
    Duplicate,
    /// Frames are truncated, 1 to 40 ms.
    Truncate,
    /// One bit of each reply is flipped, 1 to 10 ms.
    CorruptReply,
    /// One bit of each request is flipped, 1 to 10 ms.
    CorruptRequest,
    /// Frames are reordered, 1 to 40 ms.
    Reorder,
    /// The link holds all frames for 3 to 60 ms, then releases them at once.
    Stall,
    /// The link refuses requests with an error to the driver, 1 to 60 ms.
    Refuse,
    /// Random bytes before each frame or periodically, 1 to 40 ms.
    Noise,
    /// One fault to the device and another to the host, 1 to 60 ms; in half of the runs two others follow.
    Mixed,
    /// The cable is pulled during a request and plugged in again.
    UnplugMidFrame,
    /// The cable is pulled between two requests and plugged in again.
    Replug,
    /// An encoder miscounts by 0.5 to 40 mm at the handle.
    EncoderJump,
    /// The device loses its homing.
    HomingLost,
    /// The device loses its power for a moment; in half of the runs it is silent for up to 150 ms.
    PowerCycle,
    /// The boot loader echoes a wrong byte, stops, or does not start the firmware.
    WrongEcho,
    /// A USB transfer is stalled.
    TransferStall,
    /// The cable is pulled, and the device loses its power.
    UnplugPower,
    /// A random mix of faults on the UART.
    RandomMix,
    /// The host process is killed.
    HostKilled,
    /// The host process is stopped and resumed later.
    HostPaused,
    /// The guard process is killed.
    GuardKilled,
    /// The guard process is stopped and resumed later.
    GuardPaused,
}

impl FaultKind {
    /// The kinds that need processes: each loses one of host and guard.
    pub const PROCESSES: [Self; 4] =
        [Self::HostKilled, Self::HostPaused, Self::GuardKilled, Self::GuardPaused];

    /// All kinds that run in lockstep. The others need USB ([`crate::bench`]) or processes
    /// ([`crate::hosts`]).
    pub const ALL: [Self; 18] = [
        Self::Drop,
        Self::Silence,
        Self::Delay,
        Self::Duplicate,
        Self::Truncate,
        Self::CorruptReply,
        Self::CorruptRequest,
        Self::Reorder,
        Self::Stall,
        Self::Refuse,
        Self::Noise,
        Self::Mixed,
        Self::UnplugMidFrame,
        Self::Replug,
        Self::EncoderJump,
        Self::HomingLost,
        Self::PowerCycle,
        Self::WrongEcho,
    ];

    /// Name in tables.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Drop => "drop",
            Self::Silence => "silence",
            Self::Delay => "delay",
            Self::Duplicate => "duplicate",
            Self::Truncate => "truncate",
            Self::CorruptReply => "corrupt reply",
            Self::CorruptRequest => "corrupt request",
            Self::Reorder => "reorder",
            Self::Stall => "stall",
            Self::Refuse => "refused",
            Self::Noise => "noise",
            Self::Mixed => "mixed",
            Self::UnplugMidFrame => "unplug mid-frame",
            Self::Replug => "unplug, replug",
            Self::EncoderJump => "encoder jump",
            Self::HomingLost => "homing lost",
            Self::PowerCycle => "power cycle",
            Self::WrongEcho => "wrong firmware echo",
            Self::TransferStall => "transfer stalled",
            Self::UnplugPower => "unplug, power too",
            Self::RandomMix => "random mix",
            Self::HostKilled => "host-killed",
            Self::HostPaused => "host-paused",
            Self::GuardKilled => "guard-killed",
            Self::GuardPaused => "guard-paused",
        }
    }

    /// The faults of each direction and their durations in the run of a seed, for display.
    #[must_use]
    pub fn plan_for_display(self, seed: u64) -> impl core::fmt::Debug {
        plan(self, Draws(seed)).stages
    }

    /// Whether it applies to a rig: loss of homing and power only to a device that homes, a boot loader only
    /// to the Falcon.
    pub(super) fn applies_to(self, kind: RigKind) -> bool {
        match self {
            Self::HomingLost => (kind.make)(0).inject(HardwareFault::HomingLost),
            Self::PowerCycle => (kind.make)(0).inject(HardwareFault::PowerCycle),
            Self::WrongEcho => kind.name == "falcon-memory",
            // A serial line accepts all writes or blocks.
            Self::Refuse => kind.name.starts_with("falcon"),
            _ => true,
        }
    }

    /// Whether the device has lost its homing afterwards.
    pub(super) const fn loses_homing(self) -> bool {
        matches!(self, Self::HomingLost | Self::PowerCycle | Self::EncoderJump)
    }

    /// Whether this outcome is allowed. A latch with another reason is a different fault.
    pub(super) const fn allows(self, ended: Ended) -> bool {
        let is_stale = matches!(ended, Ended::Latched(Fault::Stale));
        let is_recovered = matches!(ended, Ended::Recovered);
        let is_not_ready = matches!(ended, Ended::Latched(Fault::NotReady));
        match self {
            Self::Duplicate | Self::Reorder => is_recovered,
            Self::Silence => is_stale,
            // A corrupted homing flag may report that the device is not homed.
            Self::CorruptReply | Self::Mixed => is_recovered || is_stale || is_not_ready,
            Self::EncoderJump => {
                is_recovered || is_not_ready || matches!(ended, Ended::Latched(Fault::Watchdog))
            }
            Self::HomingLost => is_not_ready,
            Self::PowerCycle => is_stale || is_not_ready,
            Self::UnplugMidFrame | Self::Replug | Self::UnplugPower => matches!(ended, Ended::Lost),
            Self::WrongEcho => matches!(ended, Ended::Opened | Ended::Refused),
            Self::HostKilled | Self::HostPaused => matches!(ended, Ended::Guard | Ended::Watchdog),
            Self::GuardKilled | Self::GuardPaused => matches!(ended, Ended::Host),
            Self::Drop
            | Self::Delay
            | Self::Truncate
            | Self::CorruptRequest
            | Self::Stall
            | Self::Refuse
            | Self::Noise
            | Self::TransferStall
            | Self::RandomMix => is_recovered || is_stale,
        }
    }
}

/// Faults of the link for some time.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Stage {
    pub(super) to_device: Faults,
    pub(super) to_host: Faults,
    pub(super) ticks: u64,
}

/// The faults of one run.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Plan {
    /// The stages in order; the second has no duration where there is none.
    pub(super) stages: [Stage; 2],
    /// The fault acts on frames, and must act on at least one.
    targets_frames: bool,
}

impl Plan {
    fn of(stage: Stage) -> Self {
        let targets_frames = stage.to_device != Faults::NONE || stage.to_host != Faults::NONE;
        Self { stages: [stage, Stage::default()], targets_frames }
    }

    pub(super) const fn targets_frames(&self) -> bool {
        self.targets_frames
    }

    /// Whether all requests reach the motors.
    pub(super) fn request_path_ok(&self) -> bool {
        self.stages.iter().all(|stage| stage.to_device == Faults::NONE)
    }

    /// Longest delay of a reply, us.
    pub(super) fn max_reply_delay_us(&self) -> u64 {
        let held_us = |Stage { to_host, .. }: &Stage| {
            let of = |share: f32, us: u64| if share > 0.0 { us } else { 0 };
            let delay_us = of(to_host.delay, to_host.delay_us);
            delay_us + of(to_host.reorder, REORDER_TIMEOUT_US) + of(to_host.stall, to_host.stall_us)
        };
        self.stages.iter().map(held_us).max().unwrap_or(0)
    }

    /// Whether requests reach the motors without delay, or not at all.
    pub(super) fn requests_undelayed(&self) -> bool {
        self.stages.iter().all(|Stage { to_device, .. }| {
            to_device.delay == 0.0 && to_device.reorder == 0.0 && to_device.stall == 0.0
        })
    }

    /// Ticks for frames in flight to reach the device after the fault.
    pub(super) fn drain_ticks(&self) -> u64 {
        let held_us = |faults: &Faults| if faults.stall > 0.0 { faults.stall_us } else { 0 };
        let ticks = |stage: &Stage| (held_us(&stage.to_device) + stage.to_device.delay_us) / 1_000;
        self.stages.iter().map(ticks).max().unwrap_or(0)
    }
}

/// Independent random numbers from a seed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Draws(pub(super) u64);

impl Draws {
    /// A number from `low` to `high`, both inclusive.
    pub(super) fn draw(self, what: u64, low: u64, high: u64) -> u64 {
        low + crate::fault::split_mix(self.0, what) % (high - low + 1)
    }
}

/// Random bytes before each frame, or periodically.
fn noise(draws: Draws, what: u64) -> Faults {
    match draws.draw(what, 0, 1) {
        0 => Faults { noise: 1.0, ..Faults::NONE },
        _ => Faults { noise_period_us: 250 * draws.draw(what + 1, 1, 8), ..Faults::NONE },
    }
}

/// One fault of one direction. It never changes a byte of a request: [`FaultKind::CorruptRequest`] does, with
/// limits of its own.
fn any(draws: Draws, what: u64, to_device: bool) -> Faults {
    let none = Faults::NONE;
    match draws.draw(what, 0, if to_device { 5 } else { 7 }) {
        0 => Faults { drop: 1.0, ..none },
        1 => Faults { delay: 1.0, delay_us: 1_000 * draws.draw(what + 1, 2, 40), ..none },
        2 => Faults { duplicate: 1.0, ..none },
        3 => Faults { truncate: 1.0, ..none },
        4 => Faults { reorder: 1.0, ..none },
        5 => Faults { drop: 0.5, delay: 0.5, delay_us: 1_000 * draws.draw(what + 1, 2, 30), ..none },
        6 => Faults { corrupt: 1.0, ..none },
        _ => noise(draws, what + 1),
    }
}

fn mixed(draws: Draws) -> Plan {
    let stage = |what: u64| Stage {
        to_device: any(draws, what, true),
        to_host: any(draws, what + 10, false),
        ticks: draws.draw(what + 20, 1, 60),
    };
    let second = if draws.draw(40, 0, 1) == 0 { Stage::default() } else { stage(70) };
    Plan { stages: [stage(41), second], targets_frames: true }
}

pub(super) fn plan(fault: FaultKind, draws: Draws) -> Plan {
    let none = Faults::NONE;
    let ticks = draws.draw(1, 1, 40);
    let faults = match fault {
        FaultKind::Drop => Faults { drop: 1.0, ..none },
        FaultKind::Silence => Faults { drop: 1.0, ..none },
        FaultKind::Delay => Faults { delay: 1.0, delay_us: 1_000 * draws.draw(2, 2, 40), ..none },
        FaultKind::Duplicate => Faults { duplicate: 1.0, ..none },
        FaultKind::Truncate => Faults { truncate: 1.0, ..none },
        FaultKind::CorruptReply | FaultKind::CorruptRequest => Faults { corrupt: 1.0, ..none },
        FaultKind::Reorder => Faults { reorder: 1.0, ..none },
        FaultKind::Stall => Faults { stall: 1.0, stall_us: 1_000 * draws.draw(2, 3, 60), ..none },
        FaultKind::Refuse => Faults { refuse: true, ..none },
        FaultKind::Noise => noise(draws, 30),
        FaultKind::Mixed => return mixed(draws),
        FaultKind::PowerCycle if draws.draw(2, 0, 1) == 1 => Faults { drop: 1.0, ..none },
        _ => none,
    };
    let (to_device, to_host) = match (fault, draws.draw(3, 0, 2)) {
        (FaultKind::Silence | FaultKind::PowerCycle, _) => (faults, faults),
        (FaultKind::CorruptRequest | FaultKind::Refuse, _) => (faults, none),
        (FaultKind::CorruptReply, _) | (_, 0) => (none, faults),
        (_, 1) => (faults, none),
        _ => (faults, faults),
    };
    let ticks = match fault {
        FaultKind::Silence => 60,
        FaultKind::Delay | FaultKind::Refuse => draws.draw(1, 1, 60),
        FaultKind::CorruptReply | FaultKind::CorruptRequest => draws.draw(1, 1, 10),
        // One stall is enough.
        FaultKind::Stall => 1,
        FaultKind::PowerCycle if faults == none => 1,
        FaultKind::PowerCycle => draws.draw(1, 1, 150),
        _ => ticks,
    };
    Plan::of(Stage { to_device, to_host, ticks })
}
