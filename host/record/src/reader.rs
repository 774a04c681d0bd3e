//! Reads a recording from its beginning to its end. No index and no footer are needed.

use crate::error::RecordingError;
use crate::format::{END, JET_TOPIC, MAX_RECORD_LEN, ORGAN, SESSION, TOPIC};
use crate::header::{End, Header};
use crate::{jet_message, message};
use mcap::McapError;
use mcap::records::Record;
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use palpate_host::BlobFile;
use palpate_host::live::{Frame, TakenJet};
use palpate_host::rt::TickRecord;
use std::collections::VecDeque;
use std::io::{ErrorKind, Read};

/// A recording: its header, its ticks as an iterator, then its end.
///
/// A truncated file (the process was killed, the disk was full) yields the ticks up to its end;
/// [`Recording::is_cut`] reports it.
pub struct Recording<R> {
    source: R,
    reader: LinearReader,
    header: Header,
    end: Option<End>,
    channels: Channels,
    /// The organ of a live session.
    organ: Option<BlobFile>,
    /// Jets read before their tick.
    jets: VecDeque<TakenJet>,
    /// Jets of the ticks read so far.
    taken: u32,
    lost_jets: u32,
    state: Reading,
    ticks: u64,
    /// Number of ticks before the next record, if none is missing.
    expected: u64,
    lost: u64,
    t_us: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Reading {
    Ticks,
    Complete,
    Truncated,
    Failed,
}

/// The channels of ticks and jets, once they are known.
#[derive(Debug, Clone, Copy, Default)]
struct Channels {
    ticks: Option<u16>,
    jets: Option<u16>,
}

/// Meaning of a record of the file.
enum Found {
    Metadata(mcap::records::Metadata),
    Organ(BlobFile),
    Channel(u16),
    JetChannel(u16),
    Jet(Option<TakenJet>),
    Tick(TickRecord),
    InvalidTick(String),
    Other,
    DataEnd,
}

impl<R> core::fmt::Debug for Recording<R> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Recording")
            .field("header", &self.header)
            .field("ticks", &self.ticks)
            .finish_non_exhaustive()
    }
}

impl<R: Read> Recording<R> {
    /// Reads up to the header, and the organ of a live session. `source` should be buffered.
    pub fn open(mut source: R) -> Result<Self, RecordingError> {
        let options = LinearReaderOptions::default()
            .with_validate_chunk_crcs(true)
            .with_record_length_limit(MAX_RECORD_LEN);
        let mut reader = LinearReader::new_with_options(options);
        let header = loop {
            match next(&mut reader, &mut source, Channels::default()) {
                Ok(Found::Metadata(metadata)) if metadata.name == SESSION => {
                    break Header::of(&metadata.metadata)?;
                }
                Ok(Found::DataEnd) | Err(RecordingError::Mcap(_)) => {
                    return Err(RecordingError::NotARecording);
                }
                Ok(_) => {}
                Err(error) => return Err(error),
            }
        };
        let organ = if header.is_live() { Some(organ(&mut reader, &mut source)?) } else { None };
        let state = Reading::Ticks;
        Ok(Self {
            source,
            reader,
            header,
            end: None,
            channels: Channels::default(),
            organ,
            jets: VecDeque::new(),
            taken: 0,
            lost_jets: 0,
            state,
            ticks: 0,
            expected: 0,
            lost: 0,
            t_us: 0,
        })
    }

    /// The header.
    pub const fn header(&self) -> &Header {
        &self.header
    }

    /// The end of the session; available after the last tick.
    pub const fn end(&self) -> Option<&End> {
        self.end.as_ref()
    }

    /// Whether the file ends before the recording does; known after the last tick.
    pub fn is_cut(&self) -> bool {
        self.state == Reading::Truncated
    }

    /// Number of missing records before the last tick read.
    pub const fn lost(&self) -> u64 {
        self.lost
    }

    /// The blob of a live session, which no other file keeps.
    pub const fn organ(&self) -> Option<&BlobFile> {
        self.organ.as_ref()
    }

    /// The jet that the last tick read had taken, if it had.
    pub fn take_jet(&mut self, tick: &TickRecord) -> Option<Frame> {
        self.jets.front().filter(|jet| jet.tick == tick.tick)?;
        self.jets.pop_front().map(|jet| jet.frame)
    }

    /// Number of missing jets before the last tick read.
    pub const fn lost_jets(&self) -> u32 {
        self.lost_jets
    }

    fn read(&mut self) -> Result<Option<TickRecord>, RecordingError> {
        while self.state == Reading::Ticks {
            match next(&mut self.reader, &mut self.source, self.channels) {
                Ok(Found::Channel(id)) => self.channels.ticks = Some(id),
                Ok(Found::JetChannel(id)) => self.channels.jets = Some(id),
                Ok(Found::Jet(jet)) => self.keep(jet)?,
                Ok(Found::Metadata(metadata)) if metadata.name == END => {
                    self.end = Some(End::read(&metadata.metadata)?);
                }
                Ok(Found::Tick(record)) => return self.count(record).map(Some),
                Ok(Found::InvalidTick(what)) => {
                    return Err(RecordingError::Message { index: self.ticks, what });
                }
                Ok(Found::DataEnd) => self.state = Reading::Complete,
                Ok(Found::Metadata(_) | Found::Organ(_) | Found::Other) => {}
                Err(RecordingError::Mcap(McapError::UnexpectedEof)) => self.state = Reading::Truncated,
                Err(error) => return Err(error),
            }
        }
        Ok(None)
    }

    /// Keeps a jet for its tick, which follows.
    fn keep(&mut self, jet: Option<TakenJet>) -> Result<(), RecordingError> {
        let jet = jet.ok_or_else(|| RecordingError::Message {
            index: self.ticks,
            what: "it is neither a tick nor a jet".into(),
        })?;
        self.taken = self.taken.saturating_add(1);
        self.jets.push_back(jet);
        Ok(())
    }

    /// The number of ticks before a tick is its number minus the deadlines skipped before it.
    fn count(&mut self, record: TickRecord) -> Result<TickRecord, RecordingError> {
        let before = record.tick.checked_sub(record.skipped_periods);
        let missing = before.and_then(|before| before.checked_sub(self.expected));
        let Some(missing) = missing.filter(|_| record.t_us >= self.t_us) else {
            let what = format!("tick {} is out of order", record.tick);
            return Err(RecordingError::Message { index: self.ticks, what });
        };
        self.lost = self.lost.saturating_add(missing);
        self.expected = self.expected.saturating_add(missing).saturating_add(1);
        self.ticks += 1;
        self.t_us = record.t_us;
        // A jet precedes its tick, so all jets up to this tick are read; those of earlier ticks are taken.
        self.lost_jets = record.live.map_or(0, |live| live.jets.saturating_sub(self.taken));
        while self.jets.front().is_some_and(|jet| jet.tick < record.tick) {
            self.jets.pop_front();
        }
        Ok(record)
    }
}

impl<R: Read> Iterator for Recording<R> {
    type Item = Result<TickRecord, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        let read = self.read();
        if read.is_err() {
            self.state = Reading::Failed;
        }
        read.transpose()
    }
}

/// Reads the organ of a live session, which follows the header.
fn organ(reader: &mut LinearReader, source: &mut impl Read) -> Result<BlobFile, RecordingError> {
    let missing = || RecordingError::Metadata(format!("missing attachment `{ORGAN}`"));
    loop {
        match next(reader, source, Channels::default()) {
            Ok(Found::Organ(organ)) => return Ok(organ),
            Ok(Found::Channel(_) | Found::DataEnd) | Err(RecordingError::Mcap(McapError::UnexpectedEof)) => {
                return Err(missing());
            }
            Ok(_) => {}
            Err(error) => return Err(error),
        }
    }
}

/// The next record, from unpacked chunks.
fn next(
    reader: &mut LinearReader,
    source: &mut impl Read,
    channels: Channels,
) -> Result<Found, RecordingError> {
    loop {
        match reader.next_event() {
            // After the end of the data there is only the index.
            None => return Ok(Found::DataEnd),
            Some(Err(error)) => return Err(error.into()),
            Some(Ok(LinearReadEvent::ReadRequest(need))) => {
                let read = loop {
                    match source.read(reader.insert(need)) {
                        Err(error) if error.kind() == ErrorKind::Interrupted => {}
                        read => break read?,
                    }
                };
                reader.notify_read(read);
            }
            Some(Ok(LinearReadEvent::Record { opcode, data })) => {
                return Ok(match mcap::parse_record(opcode, data)? {
                    Record::Metadata(metadata) => Found::Metadata(metadata),
                    Record::Channel(channel) if channel.topic == TOPIC => Found::Channel(channel.id),
                    Record::Channel(channel) if channel.topic == JET_TOPIC => Found::JetChannel(channel.id),
                    Record::Attachment { header, data, .. } if header.name == ORGAN => {
                        Found::Organ(BlobFile::of(&data))
                    }
                    Record::Message { header, data } if Some(header.channel_id) == channels.jets => {
                        Found::Jet(jet_message::decode(&data))
                    }
                    Record::Message { header, data } if Some(header.channel_id) == channels.ticks => {
                        message::decode(&data).map_or_else(Found::InvalidTick, Found::Tick)
                    }
                    Record::DataEnd(_) => Found::DataEnd,
                    _ => Found::Other,
                });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::header::tests::header;
    use crate::message::tests::full;
    use crate::{SCHEMA, TickWriter};

    const TICKS: u64 = 3_300;

    fn record(tick: u64) -> TickRecord {
        TickRecord { tick, t_us: tick * 1_000, skipped_periods: 0, ..full() }
    }

    fn file() -> Vec<u8> {
        let mut writer = TickWriter::new(Vec::new(), &header()).expect("memory");
        (0..TICKS).for_each(|tick| writer.write(&record(tick)).expect("memory"));
        writer.finish(None).expect("memory")
    }

    #[test]
    fn a_truncated_file_is_read_up_to_its_end() {
        let bytes = file();
        let complete = |bytes: &[u8]| {
            let mut recording = Recording::open(bytes)?;
            let mut ticks = 0;
            for (tick, read) in (0..).zip(recording.by_ref()) {
                assert_eq!(read?, record(tick));
                ticks += 1;
            }
            Ok::<_, RecordingError>((ticks, recording.is_cut()))
        };
        assert_eq!(complete(&bytes).expect("valid"), (TICKS, false));
        let mut before = 0;
        for len in (2_000..bytes.len()).step_by(49_999).chain((bytes.len() - 200..bytes.len()).step_by(7)) {
            let (ticks, _) = complete(&bytes[..len]).expect("truncation is not an error");
            assert!(ticks >= before, "{ticks} of {len} bytes, {before} of fewer");
            before = ticks;
        }
        assert_eq!(before, TICKS);
        let cut = complete(&bytes[..bytes.len() / 2]).expect("truncation is not an error");
        assert!(cut.1 && cut.0 > TICKS / 3, "{cut:?}");
        for len in [0, 5, 8, 40, 300] {
            assert!(matches!(complete(&bytes[..len]), Err(RecordingError::NotARecording)), "{len}");
        }
    }

    #[test]
    fn damage_is_detected_and_other_files_are_refused() {
        let bytes = file();
        let mut flipped = bytes.clone();
        let middle = bytes.len() / 2;
        // One digit replaced by another: valid JSON, but not the value that was written.
        let digit = middle + bytes[middle..].iter().position(u8::is_ascii_digit).expect("numbers");
        flipped[digit] ^= 1;
        let errors = Recording::open(flipped.as_slice()).expect("its header is valid").filter(Result::is_err);
        assert_eq!(errors.count(), 1, "iteration ends at the damage");
        for other in [&b"solid text"[..], b"\x89PNG\r\n\x1a\n", b""] {
            assert!(matches!(Recording::open(other), Err(RecordingError::NotARecording)));
        }
        let mut empty = Vec::new();
        let mut writer = mcap::Writer::new(std::io::Cursor::new(&mut empty)).expect("memory");
        writer.finish().expect("memory");
        drop(writer);
        assert!(matches!(Recording::open(empty.as_slice()), Err(RecordingError::NotARecording)));
    }

    /// What viewers rely on, read with the library's reader of whole files.
    #[test]
    fn viewers_find_channel_schema_index_and_times() {
        let bytes = file();
        let summary = mcap::Summary::read(&bytes).expect("valid").expect("there is one");
        let channel = summary.channels.values().next().expect("one channel");
        assert_eq!((channel.topic.as_str(), channel.message_encoding.as_str()), (TOPIC, "json"));
        let schema = channel.schema.as_ref().expect("a schema");
        assert_eq!((schema.encoding.as_str(), schema.data.as_ref()), ("jsonschema", SCHEMA.as_bytes()));
        assert_eq!(summary.chunk_indexes.len(), 1 + 4, "the channel, then four chunks of a second");
        let stats = summary.stats.expect("there are some");
        let start = header().start_unix_ns;
        assert_eq!((stats.message_count, stats.message_start_time), (TICKS, start));
        assert_eq!(stats.message_end_time, start + (TICKS - 1) * 1_000_000);
    }
}
