//! The parameters of a fault in one run, drawn from its seed.

use crate::fault::{FaultKind, Faults, REORDER_TIMEOUT_US};
use crate::rig::RigKind;

impl FaultKind {
    /// The faults of each direction and their durations in the run of a seed, for display.
    #[must_use]
    pub fn plan_for_display(self, seed: u64) -> impl core::fmt::Debug {
        plan(self, Draws(seed)).stages
    }

    /// Whether it applies to a rig: loss of homing and power only to a device that homes, a boot loader only
    /// to the Falcon.
    #[must_use]
    pub fn applies_to(self, kind: RigKind) -> bool {
        let behind_library = (kind.make)(0).traits().behind_library;
        match self {
            Self::HomingLost | Self::PowerCycle | Self::ForceOff => (kind.make)(0).inject(self),
            // A library hides what happens to single frames.
            Self::Duplicate
            | Self::Truncate
            | Self::CorruptReply
            | Self::CorruptRequest
            | Self::Reorder
            | Self::Noise
            | Self::Mixed
            | Self::UnplugMidFrame
                if behind_library =>
            {
                false
            }
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
