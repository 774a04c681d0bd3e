//! The thread that writes a recording, behind a bounded queue of its own.
//!
//! The haptic loop fills the queue directly. Neither a slow frame nor a disk that stalls for seconds (a busy
//! disk or a network disk) makes it wait: records that do not fit are dropped, and the loop counts them.

use crate::error::RecordingError;
use crate::header::{End, Header};
use crate::writer::TickWriter;
use core::sync::atomic::{AtomicBool, Ordering};
use core::time::Duration;
use palpate_host::live::TakenJet;
use palpate_host::rt::TickRecord;
use std::io::Write;
use std::sync::Arc;
use std::thread::{Builder, JoinHandle};

/// Capacity of the queue in ticks: half a minute at 1 kHz, in about 8 MB.
const QUEUE_TICKS: usize = 32_768;
/// Capacity of the queue of a live session in jets: a solver sends fewer than one a tick.
const QUEUE_JETS: usize = QUEUE_TICKS;
/// Pause of the writer when its queue is empty. The loop cannot wake it: that would be a system call.
const PAUSE: Duration = Duration::from_millis(5);

/// The queues that the loop of a live session fills.
#[derive(Debug)]
pub struct Queues {
    /// For [`Observer::recording`](palpate_host::session::Observer::recording).
    pub ticks: rtrb::Producer<TickRecord>,
    /// For [`Observer::recording_jets`](palpate_host::session::Observer::recording_jets).
    pub jets: rtrb::Producer<TakenJet>,
}

/// Summary of a recording.
#[derive(Debug)]
pub struct RecorderReport {
    /// Ticks written.
    pub ticks: u64,
    /// Records that are missing: the queue was full, or an error had ended the recording.
    pub dropped: u64,
    /// The error that ended the recording early.
    pub error: Option<RecordingError>,
}

/// A thread that writes the records of a queue. Dropping it without [`Self::finish`], for instance in a panic,
/// also completes the file.
#[derive(Debug)]
pub struct Recorder<W: Write> {
    /// `None` after the end of the recording.
    thread: Option<JoinHandle<WriterResult<W>>>,
    /// Set when no more records follow.
    ended: Arc<AtomicBool>,
}

#[derive(Debug)]
struct WriterResult<W: Write> {
    writer: TickWriter<W>,
    /// Records that arrived after the error.
    dropped: u64,
    error: Option<RecordingError>,
}

impl<W: Write + Send + 'static> Recorder<W> {
    /// Writes the header, then starts the thread. The queue is for
    /// [`Observer::recording`](palpate_host::session::Observer::recording).
    ///
    /// # Errors
    ///
    /// The stream cannot be written, or the thread cannot be started.
    pub fn start(stream: W, header: &Header) -> Result<(Self, rtrb::Producer<TickRecord>), RecordingError> {
        Self::with_queue(stream, header, QUEUE_TICKS)
    }

    /// Like [`Self::start`], with a queue of this many ticks.
    ///
    /// # Errors
    ///
    /// Like [`Self::start`].
    pub fn with_queue(
        stream: W,
        header: &Header,
        ticks: usize,
    ) -> Result<(Self, rtrb::Producer<TickRecord>), RecordingError> {
        // Nothing is ever sent through the queue of jets.
        let (_, jets) = rtrb::RingBuffer::new(1);
        Self::spawn(TickWriter::new(stream, header)?, ticks, jets)
    }

    /// Like [`Self::start`], for a live session whose organ is this blob.
    ///
    /// # Errors
    ///
    /// Like [`Self::start`]; the organ is too large.
    pub fn start_live(stream: W, header: &Header, organ: &[u8]) -> Result<(Self, Queues), RecordingError> {
        let (jets, taken) = rtrb::RingBuffer::new(QUEUE_JETS);
        let writer = TickWriter::live(stream, header, organ)?;
        let (recorder, ticks) = Self::spawn(writer, QUEUE_TICKS, taken)?;
        Ok((recorder, Queues { ticks, jets }))
    }

    fn spawn(
        writer: TickWriter<W>,
        ticks: usize,
        jets: rtrb::Consumer<TakenJet>,
    ) -> Result<(Self, rtrb::Producer<TickRecord>), RecordingError> {
        let (queue, records) = rtrb::RingBuffer::new(ticks.max(1));
        let ended = Arc::new(AtomicBool::new(false));
        let ends = Arc::clone(&ended);
        let thread = Builder::new()
            .name("palpate-recorder".into())
            .spawn(move || write_all(writer, records, jets, &ends))?;
        Ok((Self { thread: Some(thread), ended }, queue))
    }

    /// Waits until the queued records are written, then ends the recording. Call it after the loop has ended.
    #[must_use]
    pub fn finish(mut self, end: Option<End>) -> RecorderReport {
        self.end(end)
    }
}

impl<W: Write> Recorder<W> {
    fn end(&mut self, end: Option<End>) -> RecorderReport {
        let by_loop = end.as_ref().map_or(0, |end| end.dropped_by_recorder);
        let Some(thread) = self.thread.take() else {
            return RecorderReport { ticks: 0, dropped: by_loop, error: None };
        };
        self.ended.store(true, Ordering::Release);
        let Ok(WriterResult { writer, dropped, error }) = thread.join() else {
            return RecorderReport { ticks: 0, dropped: by_loop, error: Some(RecordingError::Panicked) };
        };
        let ticks = writer.ticks();
        let error = error.or_else(|| writer.finish(end.as_ref()).err());
        RecorderReport { ticks, dropped: by_loop.saturating_add(dropped), error }
    }
}

impl<W: Write> Drop for Recorder<W> {
    /// After a panic of the caller the queued records are still written and the file is completed.
    fn drop(&mut self) {
        // A full disk cannot be reported here.
        let _ = self.end(None);
    }
}

fn write_all<W: Write>(
    writer: TickWriter<W>,
    mut records: rtrb::Consumer<TickRecord>,
    mut jets: rtrb::Consumer<TakenJet>,
    ended: &AtomicBool,
) -> WriterResult<W> {
    let mut result = WriterResult { writer, dropped: 0, error: None };
    loop {
        // Read before the queue: what was queued before the end is written.
        let is_end = ended.load(Ordering::Acquire);
        while let Ok(record) = records.pop() {
            if result.error.is_none() {
                // The loop queues a jet before the record of its tick, so it is here; the file keeps this order.
                let before = |jet: &TakenJet| jet.tick <= record.tick;
                let written = write_jets(&mut result.writer, &mut jets, before);
                result.error = written.and_then(|()| result.writer.write(&record)).err();
            } else {
                result.dropped += 1;
            }
        }
        if is_end {
            return result;
        }
        std::thread::sleep(PAUSE);
    }
}

/// Writes the queued jets up to the first that is not wanted yet.
fn write_jets<W: Write>(
    writer: &mut TickWriter<W>,
    jets: &mut rtrb::Consumer<TakenJet>,
    is_wanted: impl Fn(&TakenJet) -> bool,
) -> Result<(), RecordingError> {
    while jets.peek().is_ok_and(&is_wanted) {
        let Ok(jet) = jets.pop() else { break };
        writer.write_jet(&jet)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::header::tests::header;
    use crate::message::tests::full;
    use crate::reader::Recording;
    use std::io;
    use std::sync::{Arc, Condvar, Mutex};

    /// A disk that stalls on request and reports when a writer waits for it.
    #[derive(Default)]
    struct Gate {
        state: Mutex<(bool, bool)>,
        changed: Condvar,
    }

    impl Gate {
        fn set(&self, closed: bool) {
            self.state.lock().expect("no panic").0 = closed;
            self.changed.notify_all();
        }

        fn pass(&self) {
            let mut state = self.state.lock().expect("no panic");
            while state.0 {
                state.1 = true;
                self.changed.notify_all();
                state = self.changed.wait(state).expect("no panic");
            }
        }

        fn wait_until_blocked(&self) {
            let state = self.state.lock().expect("no panic");
            drop(self.changed.wait_while(state, |state| !state.1).expect("no panic"));
        }
    }

    struct Disk {
        bytes: Arc<Mutex<Vec<u8>>>,
        gate: Arc<Gate>,
        /// Writes beyond this number of bytes fail.
        capacity: usize,
    }

    impl Write for Disk {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.gate.pass();
            let mut disk = self.bytes.lock().expect("no panic");
            if disk.len() + bytes.len() > self.capacity {
                return Err(io::ErrorKind::StorageFull.into());
            }
            disk.extend_from_slice(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    fn record(tick: u64) -> TickRecord {
        TickRecord { tick, t_us: tick * 1_000, skipped_periods: 0, ..full() }
    }

    fn end() -> End {
        End {
            ticks: 0,
            dropped_by_loop: 0,
            dropped_by_recorder: 0,
            device_errors: 2,
            reason: "completed".into(),
            phase: "active".into(),
        }
    }

    #[test]
    fn a_stalled_disk_drops_records_and_does_not_block() {
        let (bytes, gate) = (Arc::new(Mutex::new(Vec::new())), Arc::new(Gate::default()));
        let disk = Disk { bytes: bytes.clone(), gate: gate.clone(), capacity: usize::MAX };
        let (recorder, mut queue) = Recorder::with_queue(disk, &header(), 1_500).expect("the header fits");
        gate.set(true);
        // Tick 1000 completes a chunk, whose write stalls while the queue is empty.
        assert!((0..=1_000).all(|tick| queue.push(record(tick)).is_ok()));
        gate.wait_until_blocked();
        let dropped = (1_001..1_001 + 1_500 + 7).filter(|tick| queue.push(record(*tick)).is_err()).count();
        assert_eq!(dropped, 7);
        gate.set(false);
        let report = recorder.finish(Some(End { dropped_by_recorder: 7, ..end() }));
        assert!(report.error.is_none(), "{report:?}");
        assert_eq!((report.ticks, report.dropped), (2_501, 7));

        let bytes = bytes.lock().expect("no panic").clone();
        let mut recording = Recording::open(bytes.as_slice()).expect("valid");
        let ticks: Vec<u64> = recording.by_ref().map(|tick| tick.expect("valid").tick).collect();
        assert_eq!(ticks, (0..2_501).collect::<Vec<_>>());
        assert_eq!(recording.end(), Some(&End { dropped_by_recorder: 7, ..end() }));
    }

    /// The drawing thread panics while the disk is slow: the queued records are written and the file is
    /// completed.
    #[test]
    fn a_panic_of_the_caller_leaves_a_complete_file() {
        let (bytes, gate) = (Arc::new(Mutex::new(Vec::new())), Arc::new(Gate::default()));
        let disk = Disk { bytes: bytes.clone(), gate: gate.clone(), capacity: usize::MAX };
        let (recorder, mut queue) = Recorder::start(disk, &header()).expect("the header fits");
        gate.set(true);
        let opener = gate.clone();
        let opens = std::thread::spawn(move || {
            opener.wait_until_blocked();
            std::thread::sleep(std::time::Duration::from_millis(20));
            opener.set(false);
        });
        let panicked = std::panic::catch_unwind(std::panic::AssertUnwindSafe(move || {
            let _recorder = recorder;
            assert!((0..1_500).all(|tick| queue.push(record(tick)).is_ok()));
            panic!("injected panic");
        }));
        // Immediately, as if the process exited now.
        let bytes = bytes.lock().expect("no panic").clone();
        assert!(panicked.is_err());
        let mut recording = Recording::open(bytes.as_slice()).expect("valid");
        let ticks: Vec<u64> = recording.by_ref().map(|tick| tick.expect("valid").tick).collect();
        assert_eq!(ticks, (0..1_500).collect::<Vec<_>>());
        assert!(!recording.is_cut() && recording.end().is_none());
        opens.join().expect("no panic");
    }

    #[test]
    fn missing_ticks_are_counted_and_skipped_deadlines_are_not() {
        let (bytes, gate) = (Arc::new(Mutex::new(Vec::new())), Arc::new(Gate::default()));
        let disk = Disk { bytes: bytes.clone(), gate, capacity: usize::MAX };
        let (recorder, mut queue) = Recorder::start(disk, &header()).expect("the header fits");
        // Deadlines 10 and 11 were skipped; the records of 21, 22 and 23 are lost.
        for tick in (0..30).filter(|tick| ![10, 11, 21, 22, 23].contains(tick)) {
            let skipped_periods = if tick > 11 { 2 } else { 0 };
            assert!(queue.push(TickRecord { skipped_periods, ..record(tick) }).is_ok());
        }
        assert_eq!(recorder.finish(None).dropped, 0);
        let bytes = bytes.lock().expect("no panic").clone();
        let mut recording = Recording::open(bytes.as_slice()).expect("valid");
        while let Some(tick) = recording.next() {
            let tick = tick.expect("valid").tick;
            assert_eq!(recording.lost(), if tick > 23 { 3 } else { 0 }, "{tick}");
        }
        assert!(!recording.is_cut() && recording.end().is_none());
    }

    #[test]
    fn a_full_disk_is_an_error_that_keeps_what_was_written() {
        let (bytes, gate) = (Arc::new(Mutex::new(Vec::new())), Arc::new(Gate::default()));
        let disk = Disk { bytes: bytes.clone(), gate, capacity: 1_500_000 };
        let (recorder, mut queue) = Recorder::with_queue(disk, &header(), 20_000).expect("the header fits");
        assert!((0..10_000).all(|tick| queue.push(record(tick)).is_ok()));
        let report = recorder.finish(Some(end()));
        assert_eq!(report.ticks + report.dropped, 10_000, "{report:?}");
        assert!(
            matches!(&report.error, Some(RecordingError::Io(error)) if error.kind() == io::ErrorKind::StorageFull)
        );
        let bytes = bytes.lock().expect("no panic").clone();
        let mut recording = Recording::open(bytes.as_slice()).expect("a beginning");
        let read: Result<Vec<_>, _> = recording.by_ref().collect();
        let read = read.expect("valid up to its end").len();
        assert!(read > 1_000 && recording.is_cut(), "{read}");
    }
}
