//! The faults that the fault matrix, the QEMU bench, the contract and the command line inject. A new fault is
//! a variant here; the compiler then asks for its outcomes ([`crate::matrix`]) and for its effect on a rig.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Kind of fault. Its name is that of the variant in lower case, with hyphens.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FaultKind {
    /// Frames are lost, 1 to 40 ms.
    Drop,
    /// One request is lost.
    DropRequest,
    /// One reply is lost.
    DropReply,
    /// No frame passes in either direction for 60 ms; on the bench no reply until the faults are cleared.
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
    /// The cable is pulled during a request and plugged in again. The board keeps its power.
    UnplugMidFrame,
    /// The cable is pulled between two requests and plugged in again. The board keeps its power.
    Replug,
    /// An encoder miscounts by 0.5 to 40 mm at the handle.
    EncoderJump,
    /// The device loses its homing.
    HomingLost,
    /// The device loses its power for a moment; in half of the runs it is silent for up to 150 ms.
    PowerCycle,
    /// The device of a maker switches its motors off by itself, for one of its causes.
    ForceOff,
    /// The boot loader echoes a wrong byte, stops, or does not start the firmware.
    WrongEcho,
    /// A USB transfer to the host is stalled.
    StallIn,
    /// A USB transfer to the device is stalled, and its data is lost.
    StallOut,
    /// The cable is pulled, and the device loses its power.
    UnplugPower,
    /// A random mix of faults on the UART. Requests are not corrupted.
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

    /// All kinds that run in lockstep. The others need USB ([`Self::BENCH`]) or processes.
    pub const ALL: [Self; 19] = [
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
        Self::ForceOff,
    ];

    /// The kinds of the QEMU bench, in the order of its seeds from 1.
    pub const BENCH: [Self; 20] = [
        Self::WrongEcho,
        Self::DropRequest,
        Self::DropReply,
        Self::UnplugMidFrame,
        Self::UnplugPower,
        Self::StallIn,
        Self::StallOut,
        Self::Silence,
        Self::Noise,
        Self::RandomMix,
        Self::HomingLost,
        Self::Delay,
        Self::Duplicate,
        Self::Truncate,
        Self::Reorder,
        Self::CorruptReply,
        Self::EncoderJump,
        Self::PowerCycle,
        Self::Replug,
        Self::Stall,
    ];
}

impl fmt::Display for FaultKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_has_one_name_in_logs_and_on_the_command_line() {
        for fault in FaultKind::value_variants() {
            let name = fault.to_string();
            assert_eq!(FaultKind::from_str(&name, false), Ok(*fault));
            assert_eq!(serde_json::to_string(fault).expect("a unit variant"), format!("\"{name}\""));
        }
        assert_eq!(FaultKind::UnplugMidFrame.to_string(), "unplug-mid-frame");
    }

    /// Every fault is injected somewhere.
    #[test]
    fn each_fault_is_in_a_list() {
        for fault in FaultKind::value_variants() {
            let lists = [&FaultKind::ALL[..], &FaultKind::BENCH, &FaultKind::PROCESSES];
            assert!(lists.iter().any(|list| list.contains(fault)), "{fault}");
        }
    }
}
