//! What goes wrong, and for how long in one run.

use super::Ended;
use crate::fault::{Faults, OVERTAKE_US};
use crate::rig::{Kind, Mishap};
use palpate_core::Fault;

/// What goes wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Wrong {
    /// Frames are lost, 1 to 40 ms.
    Drop,
    /// Nothing comes or goes for 60 ms.
    Silence,
    /// Frames are 2 to 40 ms late, for up to 60 ms.
    Delay,
    /// Frames come twice, 1 to 40 ms.
    Duplicate,
    /// Frames end early, 1 to 40 ms.
    Truncate,
    /// A bit of each reply is flipped, 1 to 10 ms.
    CorruptReply,
    /// A bit of each request is flipped, 1 to 10 ms.
    CorruptRequest,
    /// Frames are overtaken by the next, 1 to 40 ms.
    Reorder,
    /// Nothing comes through for 3 to 60 ms, then all of it at once.
    Stall,
    /// Requests are not taken, and the driver is told so, 1 to 60 ms.
    Refuse,
    /// Bytes that nobody asked for, before each frame or all the time, 1 to 40 ms.
    Babble,
    /// One fault on the way there and another on the way back, 1 to 60 ms; in half of the runs two others after them.
    Mixed,
    /// The cable is pulled in the middle of a request, and put in again.
    UnplugMidFrame,
    /// The cable is pulled between two requests, and put in again.
    Replug,
    /// An encoder miscounts, by 0.5 to 40 mm at the handle.
    EncoderJump,
    /// The device forgets its homing.
    HomingLost,
    /// The device loses its power for a moment, and in half of the runs it answers nothing for up to 150 ms.
    PowerCycle,
    /// The boot loader echoes a wrong byte, stops, or never starts what it was given.
    WrongEcho,
    /// A transfer of USB is stalled.
    TransferStall,
    /// The cable is pulled, and the device loses its power with it.
    UnplugPower,
    /// A little of everything on the wire.
    Noise,
    /// The host's process is killed.
    HostKilled,
    /// The host's process stands still, and goes on later.
    HostPaused,
}

impl Wrong {
    /// All that happen in step. The others need USB ([`crate::bench`]) or processes ([`crate::hosts`]).
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
        Self::Babble,
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
            Self::Babble => "babble",
            Self::Mixed => "mixed",
            Self::UnplugMidFrame => "unplug mid-frame",
            Self::Replug => "unplug, replug",
            Self::EncoderJump => "encoder jump",
            Self::HomingLost => "homing lost",
            Self::PowerCycle => "power cycle",
            Self::WrongEcho => "wrong firmware echo",
            Self::TransferStall => "transfer stalled",
            Self::UnplugPower => "unplug, power too",
            Self::Noise => "noise",
            Self::HostKilled => "host-killed",
            Self::HostPaused => "host-paused",
        }
    }

    /// What it is in the run of a seed, for people: faults each way for so many ticks.
    #[must_use]
    pub fn planned(self, seed: u64) -> impl core::fmt::Debug {
        plan(self, Dice(seed)).stages
    }

    /// Whether it can happen to a device: homing and power to one that homes, a boot loader to the Falcon.
    pub(super) fn can_happen(self, kind: Kind) -> bool {
        match self {
            Self::HomingLost => (kind.make)(0).strike(Mishap::LoseHoming),
            Self::PowerCycle => (kind.make)(0).strike(Mishap::PowerCycle),
            Self::WrongEcho => kind.name == "falcon-memory",
            // A serial line takes what is written, or hangs.
            Self::Refuse => kind.name.starts_with("falcon"),
            _ => true,
        }
    }

    /// Whether the device does not know its place afterwards.
    pub(super) const fn loses_place(self) -> bool {
        matches!(self, Self::HomingLost | Self::PowerCycle | Self::EncoderJump)
    }

    /// Whether this is how it may end. A latch for any other reason is another fault than the one that was planted.
    pub(super) const fn may_end(self, ended: Ended) -> bool {
        let is_stale = matches!(ended, Ended::Latched(Fault::Stale));
        let is_ridden_out = matches!(ended, Ended::RodeOn);
        let is_not_ready = matches!(ended, Ended::Latched(Fault::NotReady));
        match self {
            Self::Duplicate | Self::Reorder => is_ridden_out,
            Self::Silence => is_stale,
            // A flag that was damaged may say that it is not homed.
            Self::CorruptReply | Self::Mixed => is_ridden_out || is_stale || is_not_ready,
            Self::EncoderJump => {
                is_ridden_out || is_not_ready || matches!(ended, Ended::Latched(Fault::Watchdog))
            }
            Self::HomingLost => is_not_ready,
            Self::PowerCycle => is_stale || is_not_ready,
            Self::UnplugMidFrame | Self::Replug | Self::UnplugPower => matches!(ended, Ended::Lost),
            Self::WrongEcho => matches!(ended, Ended::Opened | Ended::Refused),
            Self::HostKilled | Self::HostPaused => matches!(ended, Ended::Supervisor | Ended::Watchdog),
            Self::Drop
            | Self::Delay
            | Self::Truncate
            | Self::CorruptRequest
            | Self::Stall
            | Self::Refuse
            | Self::Babble
            | Self::TransferStall
            | Self::Noise => is_ridden_out || is_stale,
        }
    }
}

/// What goes wrong with the link for a while.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Stage {
    pub(super) to_device: Faults,
    pub(super) to_host: Faults,
    pub(super) ticks: u64,
}

/// What a fault of the link is in one run.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Plan {
    /// One after the other; the second for no time, where there is none.
    pub(super) stages: [Stage; 2],
    /// It is meant for frames, and must strike one.
    of_frames: bool,
}

impl Plan {
    fn of(stage: Stage) -> Self {
        let of_frames = stage.to_device != Faults::NONE || stage.to_host != Faults::NONE;
        Self { stages: [stage, Stage::default()], of_frames }
    }

    pub(super) const fn is_of_frames(&self) -> bool {
        self.of_frames
    }

    /// Requests get through to the motors all the time.
    pub(super) fn way_is_sound(&self) -> bool {
        self.stages.iter().all(|stage| stage.to_device == Faults::NONE)
    }

    /// For how long a reply may be held back, us.
    pub(super) fn reply_held_us(&self) -> u64 {
        let held_us = |Stage { to_host, .. }: &Stage| {
            let of = |share: f32, us: u64| if share > 0.0 { us } else { 0 };
            let delay_us = of(to_host.delay, to_host.delay_us);
            delay_us + of(to_host.reorder, OVERTAKE_US) + of(to_host.stall, to_host.stall_us)
        };
        self.stages.iter().map(held_us).max().unwrap_or(0)
    }

    /// Requests come to the motors when they are sent, or not at all.
    pub(super) fn requests_are_in_time(&self) -> bool {
        self.stages.iter().all(|Stage { to_device, .. }| {
            to_device.delay == 0.0 && to_device.reorder == 0.0 && to_device.stall == 0.0
        })
    }

    /// For how long something may still be on its way to the device once the fault is over.
    pub(super) fn after_ticks(&self) -> u64 {
        let held_us = |faults: &Faults| if faults.stall > 0.0 { faults.stall_us } else { 0 };
        let ticks = |stage: &Stage| (held_us(&stage.to_device) + stage.to_device.delay_us) / 1_000;
        self.stages.iter().map(ticks).max().unwrap_or(0)
    }
}

/// A few numbers from a seed, none of which depends on how many were drawn before.
#[derive(Debug, Clone, Copy)]
pub(super) struct Dice(pub(super) u64);

impl Dice {
    /// From `low` to `high`, both included.
    pub(super) fn draw(self, what: u64, low: u64, high: u64) -> u64 {
        low + crate::fault::split_mix(self.0, what) % (high - low + 1)
    }
}

/// Bytes of nobody: before each frame, or all the time, however few frames there are.
fn babble(dice: Dice, what: u64) -> Faults {
    match dice.draw(what, 0, 1) {
        0 => Faults { babble: 1.0, ..Faults::NONE },
        _ => Faults { chatter_us: 250 * dice.draw(what + 1, 1, 8), ..Faults::NONE },
    }
}

/// One of the faults that a way may have. None that changes a byte of a request: [`Wrong::CorruptRequest`] is that, with limits of its own.
fn any(dice: Dice, what: u64, to_device: bool) -> Faults {
    let none = Faults::NONE;
    match dice.draw(what, 0, if to_device { 5 } else { 7 }) {
        0 => Faults { drop: 1.0, ..none },
        1 => Faults { delay: 1.0, delay_us: 1_000 * dice.draw(what + 1, 2, 40), ..none },
        2 => Faults { duplicate: 1.0, ..none },
        3 => Faults { truncate: 1.0, ..none },
        4 => Faults { reorder: 1.0, ..none },
        5 => Faults { drop: 0.5, delay: 0.5, delay_us: 1_000 * dice.draw(what + 1, 2, 30), ..none },
        6 => Faults { corrupt: 1.0, ..none },
        _ => babble(dice, what + 1),
    }
}

fn mixed(dice: Dice) -> Plan {
    let stage = |what: u64| Stage {
        to_device: any(dice, what, true),
        to_host: any(dice, what + 10, false),
        ticks: dice.draw(what + 20, 1, 60),
    };
    let second = if dice.draw(40, 0, 1) == 0 { Stage::default() } else { stage(70) };
    Plan { stages: [stage(41), second], of_frames: true }
}

pub(super) fn plan(wrong: Wrong, dice: Dice) -> Plan {
    let none = Faults::NONE;
    let ticks = dice.draw(1, 1, 40);
    let faults = match wrong {
        Wrong::Drop => Faults { drop: 1.0, ..none },
        Wrong::Silence => Faults { drop: 1.0, ..none },
        Wrong::Delay => Faults { delay: 1.0, delay_us: 1_000 * dice.draw(2, 2, 40), ..none },
        Wrong::Duplicate => Faults { duplicate: 1.0, ..none },
        Wrong::Truncate => Faults { truncate: 1.0, ..none },
        Wrong::CorruptReply | Wrong::CorruptRequest => Faults { corrupt: 1.0, ..none },
        Wrong::Reorder => Faults { reorder: 1.0, ..none },
        Wrong::Stall => Faults { stall: 1.0, stall_us: 1_000 * dice.draw(2, 3, 60), ..none },
        Wrong::Refuse => Faults { refuse: true, ..none },
        Wrong::Babble => babble(dice, 30),
        Wrong::Mixed => return mixed(dice),
        Wrong::PowerCycle if dice.draw(2, 0, 1) == 1 => Faults { drop: 1.0, ..none },
        _ => none,
    };
    let (to_device, to_host) = match (wrong, dice.draw(3, 0, 2)) {
        (Wrong::Silence | Wrong::PowerCycle, _) => (faults, faults),
        (Wrong::CorruptRequest | Wrong::Refuse, _) => (faults, none),
        (Wrong::CorruptReply, _) | (_, 0) => (none, faults),
        (_, 1) => (faults, none),
        _ => (faults, faults),
    };
    let ticks = match wrong {
        Wrong::Silence => 60,
        Wrong::Delay | Wrong::Refuse => dice.draw(1, 1, 60),
        Wrong::CorruptReply | Wrong::CorruptRequest => dice.draw(1, 1, 10),
        // One of them is enough.
        Wrong::Stall => 1,
        Wrong::PowerCycle if faults == none => 1,
        Wrong::PowerCycle => dice.draw(1, 1, 150),
        _ => ticks,
    };
    Plan::of(Stage { to_device, to_host, ticks })
}
