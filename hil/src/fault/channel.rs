//! One direction of a link: draws the faults of each frame and determines when it comes out.

use super::{FaultCounts, Faults, split_mix};
use std::collections::VecDeque;

/// The draws for a frame, each at its own position in the sequence.
#[derive(Debug, Clone, Copy)]
enum Draw {
    Drop,
    Truncate,
    Corrupt,
    Index,
    Bit,
    Delay,
    Duplicate,
    Reorder,
    Stall,
    Unplug,
    Noise,
    NoiseLen,
}

/// Length of the sequence for one frame.
const DRAWS: u64 = 16;
/// Longest noise burst, bytes.
const MAX_NOISE_LEN: u64 = 24;
/// Separates the seed of the periodic noise from that of the frames.
const NOISE_SEED: u64 = 0x6261_6262_6c65;
/// Longest time a frame is held for reordering, us.
pub(crate) const REORDER_TIMEOUT_US: u64 = 5_000;

/// A frame in flight.
#[derive(Debug, Clone)]
struct PendingFrame {
    /// When it was sent; `None` for noise.
    sent_us: Option<u64>,
    due_us: u64,
    bytes: Vec<u8>,
}

/// A burst of 1 to [`MAX_NOISE_LEN`] random bytes.
fn bytes_of(seed: u64, len: u64) -> Vec<u8> {
    (0..1 + len % MAX_NOISE_LEN).map(|i| split_mix(seed, i) as u8).collect()
}

/// One direction of a link with its faults.
#[derive(Debug, Clone)]
pub struct Channel {
    seed: u64,
    faults: Faults,
    counts: FaultCounts,
    frames: u64,
    pending: VecDeque<PendingFrame>,
    /// A frame held for reordering, with the time of its release.
    held: Option<PendingFrame>,
    /// Time at which the newest frame that has come out was sent.
    newest_sent_us: Option<u64>,
    stalled_until_us: u64,
    unplugged_until_us: u64,
    /// Time of the next periodic noise burst.
    next_noise_us: Option<u64>,
    noise_count: u64,
    /// A refusal under the present faults was counted.
    refusal_counted: bool,
}

impl Channel {
    /// A channel without faults.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self {
            seed,
            faults: Faults::NONE,
            counts: FaultCounts::default(),
            frames: 0,
            pending: VecDeque::new(),
            held: None,
            newest_sent_us: None,
            stalled_until_us: 0,
            unplugged_until_us: 0,
            next_noise_us: None,
            noise_count: 0,
            refusal_counted: false,
        }
    }

    /// Sets the faults from now on.
    pub const fn set_faults(&mut self, faults: Faults) {
        (self.faults, self.refusal_counted) = (faults, false);
        if faults.noise_period_us == 0 {
            self.next_noise_us = None;
        }
    }

    /// Counts of the faults so far.
    #[must_use]
    pub const fn counts(&self) -> FaultCounts {
        self.counts
    }

    /// End of the present cut of the link.
    #[must_use]
    pub fn unplugged_until_us(&self, now_us: u64) -> Option<u64> {
        (now_us < self.unplugged_until_us).then_some(self.unplugged_until_us)
    }

    /// Time at which the newest frame that has come out was sent: no information at this end is newer.
    #[must_use]
    pub const fn newest_sent_us(&self) -> Option<u64> {
        self.newest_sent_us
    }

    fn draw(&self, what: Draw) -> u64 {
        split_mix(self.seed, self.frames * DRAWS + what as u64)
    }

    fn hits(&self, what: Draw, rate: f32) -> bool {
        let drawn = (self.draw(what) >> 40) as f32 / (1_u64 << 24) as f32;
        drawn < rate
    }

    /// Whether frames are refused; the sender may try again. Counted once, because the number of tries
    /// depends on the scheduler.
    pub fn refuses(&mut self) -> bool {
        let refuses = self.faults.refuse;
        if refuses && !std::mem::replace(&mut self.refusal_counted, true) {
            self.counts.refused += 1;
        }
        refuses
    }

    /// Sends a frame into the channel.
    pub fn put(&mut self, now_us: u64, frame: &[u8]) {
        self.frames += 1;
        let faults = self.faults;
        if self.hits(Draw::Unplug, faults.unplug) && now_us >= self.unplugged_until_us {
            self.counts.unplugged += 1;
            self.unplugged_until_us = now_us.saturating_add(faults.unplug_us);
            // A cut loses the frames in flight.
            self.pending.clear();
            self.held = None;
        }
        if now_us < self.unplugged_until_us {
            return;
        }
        if self.hits(Draw::Stall, faults.stall) && now_us >= self.stalled_until_us {
            self.counts.stalled += 1;
            self.stalled_until_us = now_us.saturating_add(faults.stall_us);
        }
        if self.hits(Draw::Noise, faults.noise) {
            self.counts.noise_bursts += 1;
            self.queue(PendingFrame { sent_us: None, due_us: now_us, bytes: self.noise() });
        }
        if self.hits(Draw::Drop, faults.drop) {
            self.counts.dropped += 1;
            return;
        }
        let bytes = self.damaged(frame);
        let is_delayed = self.hits(Draw::Delay, faults.delay);
        self.counts.delayed += u64::from(is_delayed);
        let due_us = if is_delayed { now_us.saturating_add(faults.delay_us) } else { now_us };
        let frame = PendingFrame { sent_us: Some(now_us), due_us, bytes };
        if self.held.is_none() && self.hits(Draw::Reorder, faults.reorder) {
            self.counts.reordered += 1;
            self.held = Some(PendingFrame { due_us: due_us.saturating_add(REORDER_TIMEOUT_US), ..frame });
            return;
        }
        if self.hits(Draw::Duplicate, faults.duplicate) {
            self.counts.duplicated += 1;
            self.queue(frame.clone());
        }
        self.queue(frame);
        if let Some(held) = self.held.take() {
            self.queue(PendingFrame { due_us, ..held });
        }
    }

    /// A noise burst, drawn from further elements of the frame's sequence.
    fn noise(&self) -> Vec<u8> {
        bytes_of(self.draw(Draw::Noise), self.draw(Draw::NoiseLen))
    }

    /// Emits the periodic noise that is due.
    fn emit_noise(&mut self, now_us: u64) {
        let period_us = self.faults.noise_period_us;
        while period_us > 0 && self.next_noise_us.is_none_or(|due_us| due_us <= now_us) {
            let due_us = self.next_noise_us.unwrap_or(now_us);
            // The seed differs from that of the frames, so the faults of the frames stay unchanged.
            let seed = split_mix(self.seed ^ NOISE_SEED, self.noise_count);
            let bytes = bytes_of(seed, seed >> 32);
            self.queue(PendingFrame { sent_us: None, due_us, bytes });
            self.next_noise_us = Some(due_us + period_us);
            (self.noise_count, self.counts.noise_bursts) =
                (self.noise_count + 1, self.counts.noise_bursts + 1);
        }
    }

    fn damaged(&mut self, frame: &[u8]) -> Vec<u8> {
        let mut frame = frame.to_vec();
        let index = self.draw(Draw::Index) as usize % frame.len().max(1);
        if self.hits(Draw::Corrupt, self.faults.corrupt) {
            self.counts.corrupted += 1;
            let bit = self.draw(Draw::Bit) % 8;
            if let Some(byte) = frame.get_mut(index) {
                *byte ^= 1 << bit;
            }
        }
        if self.hits(Draw::Truncate, self.faults.truncate) {
            self.counts.truncated += 1;
            frame.truncate(index);
        }
        frame
    }

    /// Appends a frame in order.
    fn queue(&mut self, frame: PendingFrame) {
        let due_us = self.pending.back().map_or(frame.due_us, |ahead| frame.due_us.max(ahead.due_us));
        self.pending.push_back(PendingFrame { due_us, ..frame });
    }

    /// The next frame that is due.
    pub fn take(&mut self, now_us: u64) -> Option<Vec<u8>> {
        if now_us < self.stalled_until_us || now_us < self.unplugged_until_us {
            return None;
        }
        self.emit_noise(now_us);
        if self.held.as_ref().is_some_and(|frame| frame.due_us <= now_us)
            && let Some(frame) = self.held.take()
        {
            self.queue(PendingFrame { due_us: now_us, ..frame });
        }
        if self.pending.front().is_none_or(|frame| frame.due_us > now_us) {
            return None;
        }
        let frame = self.pending.pop_front()?;
        self.newest_sent_us = self.newest_sent_us.max(frame.sent_us);
        Some(frame.bytes)
    }

    /// Discards the frames in flight.
    pub fn purge(&mut self) {
        self.pending.clear();
        self.held = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sends frames of 16 equal bytes, one per millisecond. Returns the output with its times.
    fn through(faults: Faults, seed: u64) -> (Vec<(u64, Vec<u8>)>, FaultCounts) {
        let mut channel = Channel::new(seed);
        channel.set_faults(faults);
        let mut got = Vec::new();
        for i in 0..2_000_u64 {
            channel.put(i * 1_000, &[(i % 251) as u8; 16]);
            while let Some(frame) = channel.take(i * 1_000) {
                got.push((i * 1_000, frame));
            }
        }
        while let Some(frame) = channel.take(u64::MAX) {
            got.push((u64::MAX, frame));
        }
        (got, channel.counts())
    }

    fn numbers(got: &[(u64, Vec<u8>)]) -> Vec<u8> {
        got.iter().map(|(_, frame)| frame[0]).collect()
    }

    #[test]
    fn without_faults_frames_pass_at_once() {
        let (got, counts) = through(Faults::default(), 7);
        assert_eq!((got.len(), counts), (2_000, FaultCounts::default()));
        assert!(
            got.iter().enumerate().all(|(i, (t_us, frame))| *t_us == i as u64 * 1_000 && frame.len() == 16)
        );
    }

    #[test]
    fn each_fault_has_its_probability_and_repeats_with_its_seed() {
        let faults = Faults {
            drop: 0.1,
            truncate: 0.05,
            corrupt: 0.2,
            delay: 0.02,
            delay_us: 5_000,
            duplicate: 0.05,
            reorder: 0.05,
            stall: 0.01,
            stall_us: 3_000,
            noise: 0.1,
            ..Faults::default()
        };
        let (got, counts) = through(faults, 7);
        assert_eq!((got.clone(), counts), through(faults, 7));
        assert_ne!(got, through(faults, 8).0);
        for (injected, low, high) in [
            (counts.dropped, 150, 250),
            (counts.truncated, 60, 130),
            (counts.corrupted, 300, 440),
            (counts.delayed, 20, 60),
            (counts.duplicated, 60, 130),
            (counts.reordered, 60, 130),
            (counts.stalled, 8, 35),
            (counts.noise_bursts, 150, 250),
        ] {
            assert!((low..=high).contains(&injected), "{injected} is not from {low} to {high}: {counts:?}");
        }
    }

    #[test]
    fn enabling_one_fault_does_not_change_the_others() {
        let few = Faults { drop: 0.1, ..Faults::default() };
        let more = Faults { corrupt: 0.3, ..few };
        let (one, other) = (through(few, 5).0, through(more, 5).0);
        assert_eq!(one.len(), other.len());
        assert!(
            one.iter().zip(&other).all(|(a, b)| a.1.iter().zip(&b.1).filter(|(x, y)| x != y).count() <= 1)
        );
    }

    /// Periodic noise needs no frames, stops with the fault, and leaves frames unchanged.
    #[test]
    fn periodic_noise_needs_no_frames() {
        let mut channel = Channel::new(5);
        channel.set_faults(Faults { noise_period_us: 500, ..Faults::default() });
        let mut bytes = 0;
        for ms in 0..100 {
            while let Some(got) = channel.take(1_000 * ms) {
                bytes += got.len();
            }
        }
        assert_eq!(channel.counts(), FaultCounts { noise_bursts: 199, ..FaultCounts::default() });
        assert!((199..=199 * 24).contains(&bytes), "{bytes}");
        channel.put(99_000, b"a frame");
        assert_eq!(channel.take(99_000).as_deref(), Some(&b"a frame"[..]));
        channel.set_faults(Faults::default());
        assert_eq!(channel.take(500_000), None);
    }

    #[test]
    fn delayed_frames_arrive_late_and_in_order() {
        let (got, counts) = through(Faults { delay: 0.1, delay_us: 7_000, ..Faults::default() }, 3);
        assert!(counts.delayed > 150);
        let mut channel = Channel::new(3);
        channel.set_faults(Faults { delay: 1.0, delay_us: 7_000, ..Faults::default() });
        channel.put(1_000, b"late");
        assert_eq!((channel.take(7_999), channel.newest_sent_us()), (None, None));
        assert_eq!(
            (channel.take(8_000).is_some(), channel.newest_sent_us()),
            (true, Some(1_000)),
            "its time is that of sending"
        );
        assert_eq!(numbers(&got), (0..2_000).map(|i| (i % 251) as u8).collect::<Vec<u8>>());
        assert!(
            got.iter()
                .enumerate()
                .all(|(i, (t_us, _))| *t_us <= i as u64 * 1_000 + 7_000 || *t_us == u64::MAX)
        );
    }

    #[test]
    fn reordering_swaps_frames_and_loses_none() {
        let (got, counts) = through(Faults { reorder: 0.1, ..Faults::default() }, 3);
        let swapped =
            numbers(&got).windows(2).filter(|pair| pair[1] == pair[0].wrapping_sub(1)).count() as u64;
        assert_eq!(got.len(), 2_000);
        assert!(swapped > 100 && swapped <= counts.reordered, "{swapped} of {counts:?}");
        let mut channel = Channel::new(3);
        channel.set_faults(Faults { reorder: 1.0, ..Faults::default() });
        channel.put(0, b"unsupervised");
        assert_eq!((channel.take(4_999), channel.take(5_000)), (None, Some(b"unsupervised".to_vec())));
    }

    #[test]
    fn a_stall_holds_all_frames_and_releases_them_at_once() {
        let mut channel = Channel::new(1);
        channel.set_faults(Faults { stall: 1.0, stall_us: 30_000, ..Faults::default() });
        channel.put(0, b"a");
        channel.set_faults(Faults::default());
        channel.put(10_000, b"b");
        assert_eq!(channel.take(29_999), None);
        assert_eq!((channel.take(30_000), channel.take(30_000)), (Some(b"a".to_vec()), Some(b"b".to_vec())));
    }

    #[test]
    fn a_cut_link_loses_all_frames_until_its_end() {
        let mut channel = Channel::new(1);
        channel.set_faults(Faults { delay: 1.0, delay_us: 500, ..Faults::default() });
        channel.put(0, b"in flight");
        channel.set_faults(Faults { unplug: 1.0, unplug_us: 30_000, ..Faults::default() });
        channel.put(100, b"a");
        channel.set_faults(Faults::default());
        channel.put(30_099, b"b");
        assert_eq!((channel.unplugged_until_us(30_099), channel.take(30_099)), (Some(30_100), None));
        channel.put(30_100, b"c");
        assert_eq!((channel.unplugged_until_us(30_100), channel.take(30_100)), (None, Some(b"c".to_vec())));
        assert_eq!(channel.take(u64::MAX), None);
    }

    #[test]
    fn a_refusal_is_counted_once_and_changes_no_frame() {
        let (mut channel, mut other) = (Channel::new(1), Channel::new(1));
        assert!(!channel.refuses());
        channel.set_faults(Faults { refuse: true, ..Faults::default() });
        assert!(channel.refuses() && channel.refuses());
        assert_eq!(channel.counts(), FaultCounts { refused: 1, ..FaultCounts::default() });
        for channel in [&mut channel, &mut other] {
            channel.set_faults(Faults { drop: 0.5, ..Faults::default() });
            (0..100).for_each(|_| channel.put(0, b"x"));
        }
        assert!(!channel.refuses() && channel.counts().dropped == other.counts().dropped);
    }

    #[test]
    fn noise_precedes_the_frame_and_is_bounded() {
        let (got, counts) = through(Faults { noise: 1.0, ..Faults::default() }, 9);
        assert_eq!((got.len(), counts.noise_bursts), (4_000, 2_000));
        assert!(got.iter().step_by(2).all(|(_, bytes)| (1..=24).contains(&bytes.len())));
        assert!(got.iter().skip(1).step_by(2).all(|(_, frame)| frame.len() == 16));
    }
}
