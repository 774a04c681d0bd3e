//! Writes ticks to MCAP in complete chunks of one second.

use crate::error::RecordingError;
use crate::format::{END, JET_TOPIC, MAX_RECORD_LEN, ORGAN, SCHEMA, SCHEMA_NAME, SESSION, TOPIC};
use crate::header::{End, Header};
use crate::{jet_message, message};
use mcap::Attachment;
use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use palpate_host::live::TakenJet;
use palpate_host::rt::TickRecord;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Write;

/// Longest loop time in one chunk, us: the data that a killed process loses.
const CHUNK_US: u64 = 1_000_000;

/// Writes a recording into a stream. It blocks when the stream blocks, so the haptic thread must not call it.
///
/// A chunk is built in memory and written in one piece: a truncated file ends after a complete chunk or
/// inside the last one. Chunks are not compressed: compression needs a C library, and MCAP tools can compress
/// later.
pub struct TickWriter<W: Write> {
    writer: mcap::Writer<NoSeek<W>>,
    channel: u16,
    /// The channel of the jets of a live session.
    jets: Option<u16>,
    start_unix_ns: u64,
    chunk_begun_us: u64,
    ticks: u64,
    json: Vec<u8>,
}

impl<W: Write> core::fmt::Debug for TickWriter<W> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("TickWriter").field("ticks", &self.ticks).finish_non_exhaustive()
    }
}

impl<W: Write> TickWriter<W> {
    /// Begins a recording and writes the header, so an unwritable stream fails here.
    pub fn new(stream: W, header: &Header) -> Result<Self, RecordingError> {
        Self::begin(stream, header, None)
    }

    /// As [`TickWriter::new`], for a live session: the recording also holds the blob of the organ.
    pub fn live(stream: W, header: &Header, organ: &[u8]) -> Result<Self, RecordingError> {
        Self::begin(stream, header, Some(organ))
    }

    fn begin(stream: W, header: &Header, organ: Option<&[u8]>) -> Result<Self, RecordingError> {
        let options = mcap::WriteOptions::new()
            .compression(None)
            // Chunks end by time, in `write`.
            .chunk_size(None)
            .disable_seeking(true)
            .library(&header.program);
        let mut writer = options.create(NoSeek::new(stream))?;
        writer.write_metadata(&Metadata { name: SESSION.into(), metadata: header.entries() })?;
        if let Some(organ) = organ {
            // What surrounds it is shorter than the second half of the limit.
            if organ.len() > MAX_RECORD_LEN / 2 {
                return Err(RecordingError::Organ(organ.len()));
            }
            writer.attach(&Attachment {
                log_time: header.start_unix_ns,
                create_time: header.start_unix_ns,
                name: ORGAN.into(),
                media_type: "application/octet-stream".into(),
                data: Cow::Borrowed(organ),
            })?;
        }
        let schema = writer.add_schema(SCHEMA_NAME, "jsonschema", SCHEMA.as_bytes())?;
        let channel = writer.add_channel(schema, TOPIC, "json", &BTreeMap::new())?;
        let binary = |_| writer.add_channel(0, JET_TOPIC, "palpate-jet", &BTreeMap::new());
        let jets = organ.map(binary).transpose()?;
        writer.flush()?;
        Ok(Self {
            writer,
            channel,
            jets,
            start_unix_ns: header.start_unix_ns,
            chunk_begun_us: 0,
            ticks: 0,
            json: Vec::with_capacity(1_024),
        })
    }

    /// Writes one tick, and the chunk that it completes.
    pub fn write(&mut self, record: &TickRecord) -> Result<(), RecordingError> {
        self.json.clear();
        message::encode(record, &mut self.json).map_err(std::io::Error::from)?;
        let log_time = self.start_unix_ns.saturating_add(record.t_us.saturating_mul(1_000));
        let header = MessageHeader {
            channel_id: self.channel,
            // Wraps after 49 days; the message has the full number.
            sequence: record.tick as u32,
            log_time,
            publish_time: log_time,
        };
        self.writer.write_to_known_channel(&header, &self.json)?;
        self.ticks += 1;
        if record.t_us.saturating_sub(self.chunk_begun_us) >= CHUNK_US {
            self.chunk_begun_us = record.t_us;
            self.writer.flush()?;
        }
        Ok(())
    }

    /// Writes a jet. It must come before the record of its tick. A session that is not live has none.
    pub fn write_jet(&mut self, jet: &TakenJet) -> Result<(), RecordingError> {
        let Some(channel_id) = self.jets else { return Ok(()) };
        let log_time = self.start_unix_ns.saturating_add(jet.t_us.saturating_mul(1_000));
        let header = MessageHeader { channel_id, sequence: jet.number, log_time, publish_time: log_time };
        Ok(self.writer.write_to_known_channel(&header, &jet_message::encode(jet))?)
    }

    /// Number of ticks written.
    pub const fn ticks(&self) -> u64 {
        self.ticks
    }

    /// Ends the recording with the given end, and returns the stream.
    pub fn finish(mut self, end: Option<&End>) -> Result<W, RecordingError> {
        if let Some(end) = end {
            self.writer.write_metadata(&Metadata { name: END.into(), metadata: end.entries() })?;
        }
        self.writer.finish()?;
        let mut stream = self.writer.into_inner().into_inner();
        stream.flush()?;
        Ok(stream)
    }
}
