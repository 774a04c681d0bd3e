//! Seeded faults of a link, shared by all emulated devices.
//!
//! A [`Channel`] is one direction of a link. Frames go in, and the faulty frames come out when they are due.
//! The faults of a frame depend only on the seed and the frame's number, so enabling one fault does not
//! change the others.

mod channel;
mod kind;

pub use channel::Channel;
pub(crate) use channel::REORDER_TIMEOUT_US;
pub use kind::FaultKind;

pub(crate) use palpate_host::device::script::split_mix;

/// Probability of each fault for a frame, 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Faults {
    /// The frame is lost.
    pub drop: f32,
    /// The frame is truncated.
    pub truncate: f32,
    /// One byte has one bit flipped.
    pub corrupt: f32,
    /// The frame is delayed. Frames stay in order.
    pub delay: f32,
    /// Delay, us.
    pub delay_us: u64,
    /// The frame is duplicated.
    pub duplicate: f32,
    /// The frame is swapped with the next one. Without a next one within 5 ms it is released.
    pub reorder: f32,
    /// The link holds this and the following frames, then releases them at once.
    pub stall: f32,
    /// Duration of a stall, us.
    pub stall_us: u64,
    /// The link is cut; this frame and all others until the end of the cut are lost.
    pub unplug: f32,
    /// Duration of a cut, us.
    pub unplug_us: u64,
    /// Up to 24 random bytes precede the frame.
    pub noise: f32,
    /// Period of further noise bursts that are independent of frames, us; 0 for none.
    pub noise_period_us: u64,
    /// The link accepts nothing and returns an error to the sender.
    pub refuse: bool,
}

impl Faults {
    /// No faults.
    pub const NONE: Self = Self {
        drop: 0.0,
        truncate: 0.0,
        corrupt: 0.0,
        delay: 0.0,
        delay_us: 0,
        duplicate: 0.0,
        reorder: 0.0,
        stall: 0.0,
        stall_us: 0,
        unplug: 0.0,
        unplug_us: 0,
        noise: 0.0,
        noise_period_us: 0,
        refuse: false,
    };
}

/// Counts of the injected faults.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FaultCounts {
    /// Frames lost.
    pub dropped: u64,
    /// Frames truncated.
    pub truncated: u64,
    /// Frames corrupted.
    pub corrupted: u64,
    /// Frames delayed.
    pub delayed: u64,
    /// Frames duplicated.
    pub duplicated: u64,
    /// Frames held back for reordering.
    pub reordered: u64,
    /// Stalls.
    pub stalled: u64,
    /// Cuts of the link.
    pub unplugged: u64,
    /// Noise bursts.
    pub noise_bursts: u64,
    /// Times that the link began to refuse frames.
    pub refused: u64,
}

impl FaultCounts {
    /// Sum of all counts.
    #[must_use]
    pub const fn total(&self) -> u64 {
        let Self { dropped, truncated, corrupted, delayed, duplicated, reordered, .. } = *self;
        let Self { stalled, unplugged, noise_bursts, refused, .. } = *self;
        let of_frames = dropped + truncated + corrupted + delayed + duplicated + reordered;
        of_frames + stalled + unplugged + noise_bursts + refused
    }
}

impl core::ops::Add for FaultCounts {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            dropped: self.dropped + other.dropped,
            truncated: self.truncated + other.truncated,
            corrupted: self.corrupted + other.corrupted,
            delayed: self.delayed + other.delayed,
            duplicated: self.duplicated + other.duplicated,
            reordered: self.reordered + other.reordered,
            stalled: self.stalled + other.stalled,
            unplugged: self.unplugged + other.unplugged,
            noise_bursts: self.noise_bursts + other.noise_bursts,
            refused: self.refused + other.refused,
        }
    }
}
