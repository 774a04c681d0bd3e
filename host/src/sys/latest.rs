//! The newest value of a writer, in shared words.
//!
//! There are three buffers: the writer owns one, the reader one, and the third is exchanged. A write fills the
//! writer's buffer and exchanges it for the third one, so a reader never sees half a value, neither side waits,
//! and a writer that dies in the middle of a write leaves its last complete value.

use super::SharedWords;
use core::sync::atomic::{AtomicU64, Ordering};
use std::sync::Arc;

/// Set in the state while the third buffer holds a value that the reader has not seen.
const FRESH: u64 = 4;
/// Number of the buffer in the state.
const BUFFER: u64 = 3;

/// Buffers that the ends own at first, and the one between them.
const WRITERS: u64 = 0;
const BETWEEN: u64 = 1;
const READERS: u64 = 2;

/// Place of a value in the shared words.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Place {
    /// Index of the state.
    pub state: usize,
    /// Index of the first buffer; the others follow.
    pub buffers: usize,
    /// Words of a value.
    pub len: usize,
}

impl Place {
    /// Sets the state before either end uses it.
    pub(crate) fn prepare(&self, memory: &SharedWords) {
        memory.words()[self.state].store(BETWEEN, Ordering::Release);
    }

    fn buffer<'m>(&self, memory: &'m SharedWords, number: u64) -> &'m [AtomicU64] {
        let begin = self.buffers + number as usize * self.len;
        &memory.words()[begin..begin + self.len]
    }

    /// Exchanges a buffer for the third one; the number of the buffer received. A damaged number is one of the
    /// three again.
    fn exchange(&self, memory: &SharedWords, given: u64) -> u64 {
        (memory.words()[self.state].swap(given, Ordering::AcqRel) & BUFFER).min(READERS)
    }
}

/// The writing end.
#[derive(Debug)]
pub(crate) struct Writer {
    memory: Arc<SharedWords>,
    place: Place,
    own: u64,
}

impl Writer {
    pub(crate) const fn new(memory: Arc<SharedWords>, place: Place) -> Self {
        Self { memory, place, own: WRITERS }
    }

    /// Publishes a value; missing words keep what an earlier value had there. Wait-free.
    pub(crate) fn write(&mut self, value: impl Iterator<Item = u64>) {
        for (word, value) in self.place.buffer(&self.memory, self.own).iter().zip(value) {
            word.store(value, Ordering::Relaxed);
        }
        self.own = self.place.exchange(&self.memory, self.own | FRESH);
    }
}

/// The reading end.
#[derive(Debug)]
pub(crate) struct Reader {
    memory: Arc<SharedWords>,
    place: Place,
    own: u64,
}

impl Reader {
    pub(crate) const fn new(memory: Arc<SharedWords>, place: Place) -> Self {
        Self { memory, place, own: READERS }
    }

    /// The newest value: zeros before the first. It stays the same until the next call. Wait-free.
    pub(crate) fn read(&mut self) -> impl ExactSizeIterator<Item = u64> {
        if self.memory.words()[self.place.state].load(Ordering::Relaxed) & FRESH != 0 {
            self.own = self.place.exchange(&self.memory, self.own);
        }
        self.place.buffer(&self.memory, self.own).iter().map(|word| word.load(Ordering::Relaxed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLACE: Place = Place { state: 0, buffers: 1, len: 5 };

    fn ends() -> (Writer, Reader, Arc<SharedWords>) {
        let memory = Arc::new(SharedWords::local(16));
        PLACE.prepare(&memory);
        (Writer::new(memory.clone(), PLACE), Reader::new(memory.clone(), PLACE), memory)
    }

    #[test]
    fn the_newest_value_is_read_as_often_as_wanted() {
        let (mut writer, mut reader, _) = ends();
        assert_eq!(reader.read().collect::<Vec<_>>(), [0; 5]);
        for value in 1..10 {
            writer.write([value; 5].into_iter());
            writer.write([10 * value; 5].into_iter());
            for _ in 0..3 {
                assert_eq!(reader.read().collect::<Vec<_>>(), [10 * value; 5]);
            }
        }
    }

    /// A writer that is killed between two words leaves its last complete value, and the reader never waits.
    #[test]
    fn half_a_write_is_never_seen() {
        let (mut writer, mut reader, memory) = ends();
        writer.write([7; 5].into_iter());
        for word in &PLACE.buffer(&memory, writer.own)[..3] {
            word.store(8, Ordering::Relaxed);
        }
        assert_eq!(reader.read().collect::<Vec<_>>(), [7; 5]);
    }

    #[test]
    fn no_value_is_torn_and_none_is_older_than_one_before() {
        let (mut writer, mut reader, _) = ends();
        const LAST: u64 = 50_000;
        std::thread::scope(|scope| {
            let writes =
                scope.spawn(move || (1..=LAST).for_each(|value| writer.write([value; 5].into_iter())));
            let (mut before, mut is_last) = (0, false);
            while !is_last {
                // Read before the value: the read after the last write gets it.
                is_last = writes.is_finished();
                let value: Vec<u64> = reader.read().collect();
                assert!(value.iter().all(|word| *word == value[0]) && value[0] >= before, "{value:?}");
                before = value[0];
            }
            assert_eq!(before, LAST);
        });
    }

    #[test]
    fn a_damaged_state_is_no_panic() {
        let (mut writer, mut reader, memory) = ends();
        for state in [3, 7, u64::MAX, 0] {
            memory.words()[0].store(state, Ordering::Relaxed);
            writer.write([1; 5].into_iter());
            memory.words()[0].store(state, Ordering::Relaxed);
            assert_eq!(reader.read().len(), 5);
        }
    }
}
