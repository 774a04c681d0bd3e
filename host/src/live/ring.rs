//! A queue of jet frames from the solver to the loop, in shared words: one sender, one receiver.
//!
//! The sender fills a slot, then raises `sent`; the receiver copies it, then raises `taken`. A sender that dies
//! in the middle of a frame has not raised `sent`, so the receiver never sees half a frame.

use super::Frame;
use crate::sys::SharedWords;
use core::sync::atomic::{AtomicU64, Ordering};
use palpate_core::Jet;
use std::sync::Arc;

/// Frames that the queue holds.
pub const RING_FRAMES: usize = 64;
/// Words of a frame.
pub(super) const FRAME_WORDS: usize = Jet::FRAME_LEN / 8;
const _: () = assert!(Jet::FRAME_LEN.is_multiple_of(8), "a frame is whole words");

/// Place of the queue in the shared words.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Place {
    /// Number of frames sent so far; the sender writes it.
    pub sent: usize,
    /// Number of frames taken so far; the receiver writes it.
    pub taken: usize,
    /// Index of the first slot.
    pub slots: usize,
}

impl Place {
    /// Words of all slots.
    pub(super) const SLOT_WORDS: usize = RING_FRAMES * FRAME_WORDS;

    fn slot<'m>(&self, memory: &'m SharedWords, number: u64) -> &'m [AtomicU64] {
        let begin = self.slots + (number % RING_FRAMES as u64) as usize * FRAME_WORDS;
        &memory.words()[begin..begin + FRAME_WORDS]
    }
}

/// The sending end.
#[derive(Debug)]
pub(super) struct Sender {
    memory: Arc<SharedWords>,
    place: Place,
    sent: u64,
}

impl Sender {
    pub(super) const fn new(memory: Arc<SharedWords>, place: Place) -> Self {
        Self { memory, place, sent: 0 }
    }

    /// Sends a frame; `false` if the queue is full.
    pub(super) fn try_send(&mut self, frame: &Frame) -> bool {
        let taken = self.memory.words()[self.place.taken].load(Ordering::Acquire);
        if self.sent.wrapping_sub(taken) >= RING_FRAMES as u64 {
            return false;
        }
        let slot = self.place.slot(&self.memory, self.sent);
        for (word, bytes) in slot.iter().zip(frame.as_chunks::<8>().0) {
            word.store(u64::from_le_bytes(*bytes), Ordering::Relaxed);
        }
        self.sent = self.sent.wrapping_add(1);
        self.memory.words()[self.place.sent].store(self.sent, Ordering::Release);
        true
    }
}

/// The receiving end. Every method is wait-free.
#[derive(Debug)]
pub(super) struct Receiver {
    memory: Arc<SharedWords>,
    place: Place,
    taken: u64,
}

impl Receiver {
    pub(super) const fn new(memory: Arc<SharedWords>, place: Place) -> Self {
        Self { memory, place, taken: 0 }
    }

    /// Copies the next frame; `false` if there is none. A sender that claims more frames than the queue holds
    /// is damaged: what it has sent so far is discarded.
    pub(super) fn take(&mut self, frame: &mut Frame) -> bool {
        let sent = self.memory.words()[self.place.sent].load(Ordering::Acquire);
        let waiting = sent.wrapping_sub(self.taken);
        let is_damaged = waiting > RING_FRAMES as u64;
        if waiting == 0 {
            return false;
        }
        if !is_damaged {
            let slot = self.place.slot(&self.memory, self.taken);
            for (word, bytes) in slot.iter().zip(frame.as_chunks_mut::<8>().0) {
                *bytes = word.load(Ordering::Relaxed).to_le_bytes();
            }
        }
        self.taken = if is_damaged { sent } else { self.taken.wrapping_add(1) };
        self.memory.words()[self.place.taken].store(self.taken, Ordering::Release);
        !is_damaged
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLACE: Place = Place { sent: 0, taken: 1, slots: 2 };

    fn ends() -> (Sender, Receiver, Arc<SharedWords>) {
        let memory = Arc::new(SharedWords::local(2 + Place::SLOT_WORDS));
        (Sender::new(memory.clone(), PLACE), Receiver::new(memory.clone(), PLACE), memory)
    }

    /// A frame with a number in every word.
    fn frame(number: u64) -> Frame {
        let mut frame = [0; Jet::FRAME_LEN];
        frame.as_chunks_mut::<8>().0.fill(number.to_le_bytes());
        frame
    }

    #[test]
    fn a_full_queue_refuses_and_loses_nothing() {
        let (mut sender, mut receiver, _) = ends();
        let mut taken = frame(0);
        assert!(!receiver.take(&mut taken));
        let sent = (0..100).take_while(|number| sender.try_send(&frame(*number))).count();
        assert_eq!(sent, RING_FRAMES);
        assert!(receiver.take(&mut taken) && taken == frame(0) && sender.try_send(&frame(64)));
        for number in 1..=64 {
            assert!(receiver.take(&mut taken) && taken == frame(number));
        }
        assert!(!receiver.take(&mut taken));
    }

    #[test]
    fn no_frame_is_torn_lost_or_reordered() {
        let (mut sender, mut receiver, _) = ends();
        const LAST: u64 = 50_000;
        std::thread::scope(|scope| {
            let sends = scope.spawn(move || {
                for number in 0..LAST {
                    while !sender.try_send(&frame(number)) {
                        std::thread::yield_now();
                    }
                }
            });
            let (mut expected, mut taken) = (0, frame(0));
            while expected < LAST {
                // Read before the queue: what was sent before the end is in it.
                let is_end = sends.is_finished();
                if receiver.take(&mut taken) {
                    assert!(taken == frame(expected), "frame {expected}");
                    expected += 1;
                } else {
                    assert!(!is_end, "{expected} of {LAST} frames");
                }
            }
        });
    }

    #[test]
    fn a_damaged_count_is_skipped() {
        let (mut sender, mut receiver, memory) = ends();
        assert!(sender.try_send(&frame(1)));
        memory.words()[0].store(1 << 40, Ordering::Relaxed);
        let mut taken = frame(0);
        assert!(!receiver.take(&mut taken) && !receiver.take(&mut taken), "no endless old frames");
    }
}
