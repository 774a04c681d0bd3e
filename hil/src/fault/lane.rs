//! One direction of a link: which frames are struck, and when what is left of them comes out.

use super::{FaultCounts, Faults, split_mix};
use std::collections::VecDeque;

/// What is drawn for a frame, each from a place of its own in the sequence.
#[derive(Debug, Clone, Copy)]
enum Draw {
    Drop,
    Truncate,
    Corrupt,
    Place,
    Bit,
    Delay,
    Duplicate,
    Reorder,
    Stall,
    Unplug,
    Babble,
    BabbleLen,
}

/// Places in the sequence that a frame has.
const DRAWS: u64 = 16;
/// Longest babble.
const MOST_BABBLE: u64 = 24;
/// What tells the seed of the chatter from that of the frames.
const CHATTER: u64 = 0x6261_6262_6c65;
/// How long a frame waits to be overtaken, us.
pub(crate) const OVERTAKE_US: u64 = 5_000;

/// A frame on its way.
#[derive(Debug, Clone)]
struct Late {
    /// When it went in; nothing for what nobody has sent.
    put_us: Option<u64>,
    due_us: u64,
    bytes: Vec<u8>,
}

/// Up to [`MOST_BABBLE`] bytes of any value.
fn bytes_of(seed: u64, len: u64) -> Vec<u8> {
    (0..1 + len % MOST_BABBLE).map(|i| split_mix(seed, i) as u8).collect()
}

/// One direction of a link with its faults.
#[derive(Debug, Clone)]
pub struct Lane {
    seed: u64,
    faults: Faults,
    counts: FaultCounts,
    frames: u64,
    late: VecDeque<Late>,
    /// A frame that waits to be overtaken; due when it has waited in vain.
    overtaken: Option<Late>,
    /// When the newest frame that has come out went in.
    newest_us: Option<u64>,
    stalled_until_us: u64,
    cut_until_us: u64,
    /// When the next chatter comes, while there is any.
    chatter_us: Option<u64>,
    chatters: u64,
    /// These faults have refused a frame.
    has_refused: bool,
}

impl Lane {
    /// A lane without faults.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self {
            seed,
            faults: Faults::NONE,
            counts: FaultCounts::default(),
            frames: 0,
            late: VecDeque::new(),
            overtaken: None,
            newest_us: None,
            stalled_until_us: 0,
            cut_until_us: 0,
            chatter_us: None,
            chatters: 0,
            has_refused: false,
        }
    }

    /// Changes the faults from here on.
    pub const fn set_faults(&mut self, faults: Faults) {
        (self.faults, self.has_refused) = (faults, false);
        if faults.chatter_us == 0 {
            self.chatter_us = None;
        }
    }

    /// What was done so far.
    #[must_use]
    pub const fn counts(&self) -> FaultCounts {
        self.counts
    }

    /// When the link is mended, if it is cut.
    #[must_use]
    pub fn cut_until_us(&self, now_us: u64) -> Option<u64> {
        (now_us < self.cut_until_us).then_some(self.cut_until_us)
    }

    /// When the newest frame that has come out by now went in: what is known at this end is no younger.
    #[must_use]
    pub const fn newest_us(&self) -> Option<u64> {
        self.newest_us
    }

    fn draw(&self, what: Draw) -> u64 {
        split_mix(self.seed, self.frames * DRAWS + what as u64)
    }

    fn strikes(&self, what: Draw, rate: f32) -> bool {
        let drawn = (self.draw(what) >> 40) as f32 / (1_u64 << 24) as f32;
        drawn < rate
    }

    /// Whether a frame is not taken: it does not go in, and its sender may try again. Counted once, for how often one tries is the scheduler's affair.
    pub fn refuses(&mut self) -> bool {
        let refuses = self.faults.refuse;
        if refuses && !std::mem::replace(&mut self.has_refused, true) {
            self.counts.refused += 1;
        }
        refuses
    }

    /// A frame goes in.
    pub fn put(&mut self, now_us: u64, frame: &[u8]) {
        self.frames += 1;
        let faults = self.faults;
        if self.strikes(Draw::Unplug, faults.unplug) && now_us >= self.cut_until_us {
            self.counts.unplugged += 1;
            self.cut_until_us = now_us.saturating_add(faults.unplug_us);
            // What was on its way is lost with it.
            self.late.clear();
            self.overtaken = None;
        }
        if now_us < self.cut_until_us {
            return;
        }
        if self.strikes(Draw::Stall, faults.stall) && now_us >= self.stalled_until_us {
            self.counts.stalled += 1;
            self.stalled_until_us = now_us.saturating_add(faults.stall_us);
        }
        if self.strikes(Draw::Babble, faults.babble) {
            self.counts.babbled += 1;
            self.queue(Late { put_us: None, due_us: now_us, bytes: self.babble() });
        }
        if self.strikes(Draw::Drop, faults.drop) {
            self.counts.dropped += 1;
            return;
        }
        let bytes = self.spoiled(frame);
        let late = self.strikes(Draw::Delay, faults.delay);
        self.counts.delayed += u64::from(late);
        let due_us = if late { now_us.saturating_add(faults.delay_us) } else { now_us };
        let frame = Late { put_us: Some(now_us), due_us, bytes };
        if self.overtaken.is_none() && self.strikes(Draw::Reorder, faults.reorder) {
            self.counts.reordered += 1;
            self.overtaken = Some(Late { due_us: due_us.saturating_add(OVERTAKE_US), ..frame });
            return;
        }
        if self.strikes(Draw::Duplicate, faults.duplicate) {
            self.counts.duplicated += 1;
            self.queue(frame.clone());
        }
        self.queue(frame);
        if let Some(overtaken) = self.overtaken.take() {
            self.queue(Late { due_us, ..overtaken });
        }
    }

    /// Bytes of any value: other draws of the same sequence, from a seed of their own.
    fn babble(&self) -> Vec<u8> {
        bytes_of(self.draw(Draw::Babble), self.draw(Draw::BabbleLen))
    }

    /// What has come by itself since the last look.
    fn chatter(&mut self, now_us: u64) {
        let period_us = self.faults.chatter_us;
        while period_us > 0 && self.chatter_us.is_none_or(|due_us| due_us <= now_us) {
            let due_us = self.chatter_us.unwrap_or(now_us);
            // Of another seed than the frames: they stay as they are.
            let seed = split_mix(self.seed ^ CHATTER, self.chatters);
            let bytes = bytes_of(seed, seed >> 32);
            self.queue(Late { put_us: None, due_us, bytes });
            self.chatter_us = Some(due_us + period_us);
            (self.chatters, self.counts.babbled) = (self.chatters + 1, self.counts.babbled + 1);
        }
    }

    fn spoiled(&mut self, frame: &[u8]) -> Vec<u8> {
        let mut frame = frame.to_vec();
        let place = self.draw(Draw::Place) as usize % frame.len().max(1);
        if self.strikes(Draw::Corrupt, self.faults.corrupt) {
            self.counts.corrupted += 1;
            let bit = self.draw(Draw::Bit) % 8;
            if let Some(byte) = frame.get_mut(place) {
                *byte ^= 1 << bit;
            }
        }
        if self.strikes(Draw::Truncate, self.faults.truncate) {
            self.counts.truncated += 1;
            frame.truncate(place);
        }
        frame
    }

    /// Not before the frame ahead of it.
    fn queue(&mut self, frame: Late) {
        let due_us = self.late.back().map_or(frame.due_us, |ahead| frame.due_us.max(ahead.due_us));
        self.late.push_back(Late { due_us, ..frame });
    }

    /// The next frame that comes out by now.
    pub fn take(&mut self, now_us: u64) -> Option<Vec<u8>> {
        if now_us < self.stalled_until_us || now_us < self.cut_until_us {
            return None;
        }
        self.chatter(now_us);
        if self.overtaken.as_ref().is_some_and(|frame| frame.due_us <= now_us)
            && let Some(frame) = self.overtaken.take()
        {
            self.queue(Late { due_us: now_us, ..frame });
        }
        if self.late.front().is_none_or(|frame| frame.due_us > now_us) {
            return None;
        }
        let frame = self.late.pop_front()?;
        self.newest_us = self.newest_us.max(frame.put_us);
        Some(frame.bytes)
    }

    /// Throws away what is on its way.
    pub fn purge(&mut self) {
        self.late.clear();
        self.overtaken = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames of 16 equal bytes, one a millisecond; what came out and when.
    fn through(faults: Faults, seed: u64) -> (Vec<(u64, Vec<u8>)>, FaultCounts) {
        let mut lane = Lane::new(seed);
        lane.set_faults(faults);
        let mut got = Vec::new();
        for i in 0..2_000_u64 {
            lane.put(i * 1_000, &[(i % 251) as u8; 16]);
            while let Some(frame) = lane.take(i * 1_000) {
                got.push((i * 1_000, frame));
            }
        }
        while let Some(frame) = lane.take(u64::MAX) {
            got.push((u64::MAX, frame));
        }
        (got, lane.counts())
    }

    fn numbers(got: &[(u64, Vec<u8>)]) -> Vec<u8> {
        got.iter().map(|(_, frame)| frame[0]).collect()
    }

    #[test]
    fn without_faults_everything_passes_at_once() {
        let (got, counts) = through(Faults::default(), 7);
        assert_eq!((got.len(), counts), (2_000, FaultCounts::default()));
        assert!(
            got.iter().enumerate().all(|(i, (t_us, frame))| *t_us == i as u64 * 1_000 && frame.len() == 16)
        );
    }

    #[test]
    fn each_fault_strikes_as_often_as_asked_and_repeats_with_its_seed() {
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
            babble: 0.1,
            ..Faults::default()
        };
        let (got, counts) = through(faults, 7);
        assert_eq!((got.clone(), counts), through(faults, 7));
        assert_ne!(got, through(faults, 8).0);
        for (struck, low, high) in [
            (counts.dropped, 150, 250),
            (counts.truncated, 60, 130),
            (counts.corrupted, 300, 440),
            (counts.delayed, 20, 60),
            (counts.duplicated, 60, 130),
            (counts.reordered, 60, 130),
            (counts.stalled, 8, 35),
            (counts.babbled, 150, 250),
        ] {
            assert!((low..=high).contains(&struck), "{struck} is not from {low} to {high}: {counts:?}");
        }
    }

    #[test]
    fn switching_one_fault_on_leaves_the_others_where_they_were() {
        let few = Faults { drop: 0.1, ..Faults::default() };
        let more = Faults { corrupt: 0.3, ..few };
        let (one, other) = (through(few, 5).0, through(more, 5).0);
        assert_eq!(one.len(), other.len());
        assert!(
            one.iter().zip(&other).all(|(a, b)| a.1.iter().zip(&b.1).filter(|(x, y)| x != y).count() <= 1)
        );
    }

    /// A talking line needs nobody to ask, and stops when it is told to; what was sent stays as it is.
    #[test]
    fn chatter_comes_by_itself() {
        let mut lane = Lane::new(5);
        lane.set_faults(Faults { chatter_us: 500, ..Faults::default() });
        let mut bytes = 0;
        for ms in 0..100 {
            while let Some(got) = lane.take(1_000 * ms) {
                bytes += got.len();
            }
        }
        assert_eq!(lane.counts(), FaultCounts { babbled: 199, ..FaultCounts::default() });
        assert!((199..=199 * 24).contains(&bytes), "{bytes}");
        lane.put(99_000, b"asked for");
        assert_eq!(lane.take(99_000).as_deref(), Some(&b"asked for"[..]));
        lane.set_faults(Faults::default());
        assert_eq!(lane.take(500_000), None);
    }

    #[test]
    fn delayed_frames_arrive_late_and_in_order() {
        let (got, counts) = through(Faults { delay: 0.1, delay_us: 7_000, ..Faults::default() }, 3);
        assert!(counts.delayed > 150);
        let mut lane = Lane::new(3);
        lane.set_faults(Faults { delay: 1.0, delay_us: 7_000, ..Faults::default() });
        lane.put(1_000, b"late");
        assert_eq!((lane.take(7_999), lane.newest_us()), (None, None));
        assert_eq!(
            (lane.take(8_000).is_some(), lane.newest_us()),
            (true, Some(1_000)),
            "and as old as it is"
        );
        assert_eq!(numbers(&got), (0..2_000).map(|i| (i % 251) as u8).collect::<Vec<u8>>());
        assert!(
            got.iter()
                .enumerate()
                .all(|(i, (t_us, _))| *t_us <= i as u64 * 1_000 + 7_000 || *t_us == u64::MAX)
        );
    }

    #[test]
    fn a_frame_is_overtaken_by_the_next_and_none_is_lost() {
        let (got, counts) = through(Faults { reorder: 0.1, ..Faults::default() }, 3);
        let swapped =
            numbers(&got).windows(2).filter(|pair| pair[1] == pair[0].wrapping_sub(1)).count() as u64;
        assert_eq!(got.len(), 2_000);
        assert!(swapped > 100 && swapped <= counts.reordered, "{swapped} of {counts:?}");
        let mut lane = Lane::new(3);
        lane.set_faults(Faults { reorder: 1.0, ..Faults::default() });
        lane.put(0, b"alone");
        assert_eq!((lane.take(4_999), lane.take(5_000)), (None, Some(b"alone".to_vec())));
    }

    #[test]
    fn a_stall_holds_everything_and_lets_it_out_at_once() {
        let mut lane = Lane::new(1);
        lane.set_faults(Faults { stall: 1.0, stall_us: 30_000, ..Faults::default() });
        lane.put(0, b"a");
        lane.set_faults(Faults::default());
        lane.put(10_000, b"b");
        assert_eq!(lane.take(29_999), None);
        assert_eq!((lane.take(30_000), lane.take(30_000)), (Some(b"a".to_vec()), Some(b"b".to_vec())));
    }

    #[test]
    fn a_cut_link_loses_everything_until_it_is_mended() {
        let mut lane = Lane::new(1);
        lane.set_faults(Faults { delay: 1.0, delay_us: 500, ..Faults::default() });
        lane.put(0, b"on its way");
        lane.set_faults(Faults { unplug: 1.0, unplug_us: 30_000, ..Faults::default() });
        lane.put(100, b"a");
        lane.set_faults(Faults::default());
        lane.put(30_099, b"b");
        assert_eq!((lane.cut_until_us(30_099), lane.take(30_099)), (Some(30_100), None));
        lane.put(30_100, b"c");
        assert_eq!((lane.cut_until_us(30_100), lane.take(30_100)), (None, Some(b"c".to_vec())));
        assert_eq!(lane.take(u64::MAX), None);
    }

    #[test]
    fn what_is_refused_is_counted_once_and_strikes_no_frame() {
        let (mut lane, mut other) = (Lane::new(1), Lane::new(1));
        assert!(!lane.refuses());
        lane.set_faults(Faults { refuse: true, ..Faults::default() });
        assert!(lane.refuses() && lane.refuses());
        assert_eq!(lane.counts(), FaultCounts { refused: 1, ..FaultCounts::default() });
        for lane in [&mut lane, &mut other] {
            lane.set_faults(Faults { drop: 0.5, ..Faults::default() });
            (0..100).for_each(|_| lane.put(0, b"x"));
        }
        assert!(!lane.refuses() && lane.counts().dropped == other.counts().dropped);
    }

    #[test]
    fn babble_comes_before_the_frame_and_is_bounded() {
        let (got, counts) = through(Faults { babble: 1.0, ..Faults::default() }, 9);
        assert_eq!((got.len(), counts.babbled), (4_000, 2_000));
        assert!(got.iter().step_by(2).all(|(_, bytes)| (1..=24).contains(&bytes.len())));
        assert!(got.iter().skip(1).step_by(2).all(|(_, frame)| frame.len() == 16));
    }
}
