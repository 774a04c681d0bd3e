//! What may go wrong on a link, drawn from a seed: the vocabulary that all emulated devices share.
//!
//! A [`Lane`] is one direction. Frames go in, and what is left of them comes out when it is due. What strikes a frame depends on the seed and
//! the frame's number alone, so that switching one fault on leaves the others where they were.

mod lane;

pub use lane::Lane;
pub(crate) use lane::OVERTAKE_US;

/// How often each fault strikes a frame, 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Faults {
    /// The frame is lost.
    pub drop: f32,
    /// The frame ends early.
    pub truncate: f32,
    /// One byte has one bit flipped.
    pub corrupt: f32,
    /// The frame comes late. Frames stay in order.
    pub delay: f32,
    /// By how much, us.
    pub delay_us: u64,
    /// The frame comes twice.
    pub duplicate: f32,
    /// The next frame overtakes it; without one within 5 ms it comes all the same.
    pub reorder: f32,
    /// Nothing comes for a while, this frame included, then all of it at once.
    pub stall: f32,
    /// For how long, us.
    pub stall_us: u64,
    /// The link is cut; this frame and all until it is mended are lost.
    pub unplug: f32,
    /// For how long, us.
    pub unplug_us: u64,
    /// Up to 24 bytes that nobody asked for come before the frame.
    pub babble: f32,
    /// As many come each so many us, whether there are frames or not; 0 for never.
    pub chatter_us: u64,
    /// Nothing is taken: whoever sends is told so at once.
    pub refuse: bool,
}

impl Faults {
    /// Nothing goes wrong.
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
        babble: 0.0,
        chatter_us: 0,
        refuse: false,
    };
}

/// What was done so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FaultCounts {
    /// Frames lost.
    pub dropped: u64,
    /// Frames cut.
    pub truncated: u64,
    /// Frames damaged.
    pub corrupted: u64,
    /// Frames delayed.
    pub delayed: u64,
    /// Frames doubled.
    pub duplicated: u64,
    /// Frames held back for another to overtake.
    pub reordered: u64,
    /// Times that nothing came.
    pub stalled: u64,
    /// Times that the link was cut.
    pub unplugged: u64,
    /// Times that bytes came unasked.
    pub babbled: u64,
    /// Times that it began to take nothing.
    pub refused: u64,
}

impl FaultCounts {
    /// Everything that was done, of whatever kind.
    #[must_use]
    pub const fn total(&self) -> u64 {
        let Self { dropped, truncated, corrupted, delayed, duplicated, reordered, .. } = *self;
        let Self { stalled, unplugged, babbled, refused, .. } = *self;
        let of_frames = dropped + truncated + corrupted + delayed + duplicated + reordered;
        of_frames + stalled + unplugged + babbled + refused
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
            babbled: self.babbled + other.babbled,
            refused: self.refused + other.refused,
        }
    }
}

/// Number `index` of the sequence SplitMix64 (Steele, Lea and Flood 2014).
pub(crate) const fn split_mix(seed: u64, index: u64) -> u64 {
    let mut z = seed.wrapping_add(index.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}
