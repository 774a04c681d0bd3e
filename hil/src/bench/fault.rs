//! The fault of a run, chosen by its seed.

use crate::fault::Faults;

/// A fault on the bus, in the chip or on the board.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum BenchFault {
    /// The boot loader echoes one wrong byte, once.
    WrongEcho,
    /// A request is lost on the board's UART.
    DropRequest,
    /// A reply is lost on the board's UART.
    DropReply,
    /// The cable is pulled during a request and plugged in again. The board keeps its power.
    UnplugMidFrame,
    /// The cable is pulled between two requests and plugged in again. The board keeps its power.
    Replug,
    /// The cable is pulled during a request, and the board loses its power.
    UnplugPower,
    /// The board loses its power for a moment. The cable stays in, and the chip stays on the bus.
    PowerCycle,
    /// A transfer to the host is stalled.
    StallIn,
    /// A transfer to the device is stalled, and its data is lost.
    StallOut,
    /// No reply arrives until the faults are cleared.
    Silence,
    /// Random bytes precede each reply.
    Noise,
    /// The UART passes nothing for a while, then everything at once, in both directions.
    Stall,
    /// Frames on the UART are delayed, in both directions.
    Delay,
    /// Frames on the UART are duplicated.
    Duplicate,
    /// Frames on the UART are truncated.
    Truncate,
    /// Frames on the UART are reordered.
    Reorder,
    /// Bits are flipped in replies, but not in requests: see [`BenchFault::wire_faults`].
    CorruptReply,
    /// A random mix of faults in both directions. Requests are lost, truncated, delayed, duplicated and
    /// reordered, but not corrupted.
    RandomMix,
    /// The firmware loses its homing.
    HomingLost,
    /// An encoder miscounts, and the position of the grip jumps by some millimetres.
    EncoderJump,
}

/// Largest number of requests between the command and the injection.
const MAX_DELAY_REQUESTS: u64 = 60;

impl BenchFault {
    /// All faults, in the order of the seeds from 1.
    pub const ALL: [Self; 20] = [
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

    /// The fault for a seed; `None` for seed 0.
    #[must_use]
    pub const fn of(seed: u64) -> Option<Self> {
        let Some(at) = seed.checked_sub(1) else { return None };
        Some(Self::ALL[(at % Self::ALL.len() as u64) as usize])
    }

    /// Number of requests before the injection.
    #[must_use]
    pub const fn delay_requests(seed: u64) -> u64 {
        (seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32) % MAX_DELAY_REQUESTS
    }

    /// Name in logs.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::WrongEcho => "wrong-echo",
            Self::DropRequest => "drop-request",
            Self::DropReply => "drop-reply",
            Self::UnplugMidFrame => "unplug-mid-frame",
            Self::Replug => "replug",
            Self::UnplugPower => "unplug-power",
            Self::PowerCycle => "power-cycle",
            Self::StallIn => "stall-in",
            Self::StallOut => "stall-out",
            Self::Silence => "silence",
            Self::Noise => "noise",
            Self::Stall => "stall",
            Self::Delay => "delay",
            Self::Duplicate => "duplicate",
            Self::Truncate => "truncate",
            Self::Reorder => "reorder",
            Self::CorruptReply => "corrupt-reply",
            Self::RandomMix => "random-mix",
            Self::HomingLost => "homing-lost",
            Self::EncoderJump => "encoder-jump",
        }
    }

    /// Faults on the UART until they are cleared: to the device, to the host.
    #[must_use]
    pub const fn wire_faults(self) -> (Faults, Faults) {
        // A request has no checksum: a flipped bit may command any force, and no driver can prevent that. USB
        // has its own checksums, so only the UART can corrupt a request.
        const TO_DEVICE: Faults = Faults {
            drop: 0.02,
            truncate: 0.02,
            delay: 0.02,
            delay_us: 3_000,
            duplicate: 0.01,
            reorder: 0.01,
            ..Faults::NONE
        };
        const TO_HOST: Faults = Faults { corrupt: 0.02, noise: 0.01, ..TO_DEVICE };
        const fn both(faults: Faults) -> (Faults, Faults) {
            (faults, faults)
        }
        match self {
            // A stall holds the line for 1 to 25 ms, as the frames arrive; the next one is drawn after it.
            Self::Stall => both(Faults { stall: 0.05, stall_us: 25_000, ..Faults::NONE }),
            Self::Delay => both(Faults { delay: 0.05, delay_us: 3_000, ..Faults::NONE }),
            Self::Duplicate => both(Faults { duplicate: 0.05, ..Faults::NONE }),
            Self::Truncate => both(Faults { truncate: 0.05, ..Faults::NONE }),
            Self::Reorder => both(Faults { reorder: 0.05, ..Faults::NONE }),
            Self::CorruptReply => (Faults::NONE, Faults { corrupt: 0.05, ..Faults::NONE }),
            Self::Silence | Self::DropReply => (Faults::NONE, Faults { drop: 1.0, ..Faults::NONE }),
            Self::Noise => (Faults::NONE, Faults { noise: 1.0, ..Faults::NONE }),
            Self::RandomMix => (TO_DEVICE, TO_HOST),
            _ => (Faults::NONE, Faults::NONE),
        }
    }

    /// Whether the fault acts on single frames of the UART.
    #[must_use]
    pub fn affects_wire(self) -> bool {
        self.wire_faults() != (Faults::NONE, Faults::NONE)
    }

    /// Whether the cable is out for a while and the board keeps its power: nothing removes the force until
    /// the driver is back.
    #[must_use]
    pub const fn keeps_power(self) -> bool {
        matches!(self, Self::UnplugMidFrame | Self::Replug)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn each_seed_has_its_own_fault_and_time() {
        assert_eq!(BenchFault::of(0), None);
        for (at, fault) in BenchFault::ALL.into_iter().enumerate() {
            let seed = at as u64 + 1;
            let again = seed + BenchFault::ALL.len() as u64;
            assert_eq!((BenchFault::of(seed), BenchFault::of(again)), (Some(fault), Some(fault)));
            assert!(BenchFault::delay_requests(seed) < MAX_DELAY_REQUESTS);
        }
        let again = 3 + BenchFault::ALL.len() as u64;
        assert_ne!(
            BenchFault::delay_requests(3),
            BenchFault::delay_requests(again),
            "the same fault at another time"
        );
    }
    /// Each fault has a run of its own and a row of its own name.
    #[test]
    fn fault_names_are_unique() {
        let names: HashSet<&str> = BenchFault::ALL.iter().map(|fault| fault.name()).collect();
        assert_eq!(names.len(), BenchFault::ALL.len());
    }

    /// A request has no checksum, so the bench must not corrupt requests.
    #[test]
    fn requests_are_never_corrupted() {
        for fault in BenchFault::ALL {
            let (to_device, _) = fault.wire_faults();
            assert_eq!((to_device.corrupt, to_device.noise), (0.0, 0.0), "{}", fault.name());
        }
    }
}
