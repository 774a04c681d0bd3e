//! What goes wrong in a run, by its seed.

use crate::fault::Faults;

/// One kind of fault on the bus, in the chip or in the board.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Strike {
    /// The boot loader echoes one byte wrong, once.
    WrongEcho,
    /// A request is lost on the board's wire.
    DropRequest,
    /// A reply is lost there.
    DropReply,
    /// The cable is pulled in the middle of a request and put in again; the board keeps its power.
    UnplugMidFrame,
    /// The cable is pulled between two requests and put in again; the board keeps its power.
    Replug,
    /// The cable is pulled in the middle of a request, and the board loses its power with it.
    UnplugPower,
    /// The board loses its power for a moment; the cable stays in, and the chip on the bus.
    PowerCycle,
    /// A transfer to the host is stalled.
    StallIn,
    /// A transfer to the device is stalled, and what it carried is lost.
    StallOut,
    /// No reply comes any more, until it is calm again.
    Silence,
    /// Bytes that nobody asked for come before each reply.
    Babble,
    /// Nothing comes through the wire for a while, then all of it at once, both ways.
    Stall,
    /// Frames come late on the wire, both ways.
    Delay,
    /// Frames come twice there.
    Duplicate,
    /// Frames end early there.
    Truncate,
    /// Frames are overtaken by the next there.
    Reorder,
    /// Bits are flipped in replies; not in requests, which no driver can help: see [`Strike::on_the_wire`].
    CorruptReply,
    /// A little of everything on the wire, in both directions; requests are lost, cut, late, doubled and swapped, not changed.
    Noise,
    /// The firmware forgets its homing.
    Homing,
    /// An encoder miscounts, and the grip seems to be some millimetres away.
    EncoderJump,
}

/// How many requests a fault lets pass at most, once it is asked for.
const MOST_PASSED: u64 = 60;

impl Strike {
    /// All of them, in the order of the seeds from 1.
    pub const ALL: [Self; 20] = [
        Self::WrongEcho,
        Self::DropRequest,
        Self::DropReply,
        Self::UnplugMidFrame,
        Self::UnplugPower,
        Self::StallIn,
        Self::StallOut,
        Self::Silence,
        Self::Babble,
        Self::Noise,
        Self::Homing,
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

    /// What the run of a seed meets; nothing with seed 0.
    #[must_use]
    pub const fn of(seed: u64) -> Option<Self> {
        let Some(at) = seed.checked_sub(1) else { return None };
        Some(Self::ALL[(at % Self::ALL.len() as u64) as usize])
    }

    /// After how many requests it strikes.
    #[must_use]
    pub const fn passes(seed: u64) -> u64 {
        (seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32) % MOST_PASSED
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
            Self::Babble => "babble",
            Self::Stall => "stall",
            Self::Delay => "delay",
            Self::Duplicate => "duplicate",
            Self::Truncate => "truncate",
            Self::Reorder => "reorder",
            Self::CorruptReply => "corrupt-reply",
            Self::Noise => "noise",
            Self::Homing => "homing-lost",
            Self::EncoderJump => "encoder-jump",
        }
    }

    /// Faults of the wire that last until it is calm again: to the device, to the host.
    #[must_use]
    pub const fn on_the_wire(self) -> (Faults, Faults) {
        // A request has no check sum: with a bit flipped it may command any force, and no driver can help it. USB's own check sums leave only
        // the board's wire for that.
        const THERE: Faults = Faults {
            drop: 0.02,
            truncate: 0.02,
            delay: 0.02,
            delay_us: 3_000,
            duplicate: 0.01,
            reorder: 0.01,
            ..Faults::NONE
        };
        const BACK: Faults = Faults { corrupt: 0.02, babble: 0.01, ..THERE };
        const fn both(faults: Faults) -> (Faults, Faults) {
            (faults, faults)
        }
        match self {
            // One holds up the way by a tick or by 25 ms, as the frames come: the next is drawn when it is over.
            Self::Stall => both(Faults { stall: 0.05, stall_us: 25_000, ..Faults::NONE }),
            Self::Delay => both(Faults { delay: 0.05, delay_us: 3_000, ..Faults::NONE }),
            Self::Duplicate => both(Faults { duplicate: 0.05, ..Faults::NONE }),
            Self::Truncate => both(Faults { truncate: 0.05, ..Faults::NONE }),
            Self::Reorder => both(Faults { reorder: 0.05, ..Faults::NONE }),
            Self::CorruptReply => (Faults::NONE, Faults { corrupt: 0.05, ..Faults::NONE }),
            Self::Silence | Self::DropReply => (Faults::NONE, Faults { drop: 1.0, ..Faults::NONE }),
            Self::Babble => (Faults::NONE, Faults { babble: 1.0, ..Faults::NONE }),
            Self::Noise => (THERE, BACK),
            _ => (Faults::NONE, Faults::NONE),
        }
    }

    /// Whether it strikes frames on the wire, one by one.
    #[must_use]
    pub fn is_on_the_wire(self) -> bool {
        self.on_the_wire() != (Faults::NONE, Faults::NONE)
    }

    /// Whether the cable is out for a while, and the board keeps its power meanwhile: nothing takes the force away until the driver is back.
    #[must_use]
    pub const fn is_pulled(self) -> bool {
        matches!(self, Self::UnplugMidFrame | Self::Replug)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn each_seed_has_its_fault_and_its_time() {
        assert_eq!(Strike::of(0), None);
        for (at, strike) in Strike::ALL.into_iter().enumerate() {
            let seed = at as u64 + 1;
            let again = seed + Strike::ALL.len() as u64;
            assert_eq!((Strike::of(seed), Strike::of(again)), (Some(strike), Some(strike)));
            assert!(Strike::passes(seed) < MOST_PASSED);
        }
        let again = 3 + Strike::ALL.len() as u64;
        assert_ne!(Strike::passes(3), Strike::passes(again), "the same fault at another time");
    }
    /// Each fault has a run of its own, and a row by its own name.
    #[test]
    fn no_fault_stands_for_another() {
        let names: HashSet<&str> = Strike::ALL.iter().map(|strike| strike.name()).collect();
        assert_eq!(names.len(), Strike::ALL.len());
    }

    /// A request has no check sum, so none may be changed on the wire.
    #[test]
    fn requests_are_never_changed() {
        for strike in Strike::ALL {
            let (there, _) = strike.on_the_wire();
            assert_eq!((there.corrupt, there.babble), (0.0, 0.0), "{}", strike.name());
        }
    }
}
