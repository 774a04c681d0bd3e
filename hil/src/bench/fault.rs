//! The fault of a run on the bench, chosen by its seed.

use crate::fault::{FaultKind, Faults};

/// Largest number of requests between the command and the injection.
const MAX_DELAY_REQUESTS: u64 = 60;

impl FaultKind {
    /// The fault of the bench for a seed; `None` for seed 0.
    #[must_use]
    pub const fn of_seed(seed: u64) -> Option<Self> {
        let Some(at) = seed.checked_sub(1) else { return None };
        Some(Self::BENCH[(at % Self::BENCH.len() as u64) as usize])
    }

    /// Number of requests before the injection.
    #[must_use]
    pub const fn delay_requests(seed: u64) -> u64 {
        (seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32) % MAX_DELAY_REQUESTS
    }

    /// Faults of the bench on the UART until they are cleared: to the device, to the host.
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

    #[test]
    fn each_seed_has_its_own_fault_and_time() {
        assert_eq!(FaultKind::of_seed(0), None);
        for (at, fault) in FaultKind::BENCH.into_iter().enumerate() {
            let seed = at as u64 + 1;
            let again = seed + FaultKind::BENCH.len() as u64;
            assert_eq!((FaultKind::of_seed(seed), FaultKind::of_seed(again)), (Some(fault), Some(fault)));
            assert!(FaultKind::delay_requests(seed) < MAX_DELAY_REQUESTS);
        }
        let again = 3 + FaultKind::BENCH.len() as u64;
        assert_ne!(
            FaultKind::delay_requests(3),
            FaultKind::delay_requests(again),
            "the same fault at another time"
        );
    }
}
