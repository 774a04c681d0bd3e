//! Ticks into MCAP: whole chunks, a second each.

use super::header::{End, Header};
use super::{END, RecordingError, SCHEMA, SCHEMA_NAME, SESSION, TOPIC, message};
use crate::rt::TickRecord;
use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use std::collections::BTreeMap;
use std::io::Write;

/// Time of the loop that one chunk holds at most, us: what a killed process loses.
const CHUNK_US: u64 = 1_000_000;

/// Writes a recording into a stream. Blocks as the stream does: not for the haptic thread.
///
/// A chunk is built in memory and goes out in one piece, so that a file that ends early ends behind a whole chunk or inside the last.
/// Chunks are not compressed: that would take a C library, and the tools of the format can do it later.
pub struct TickWriter<W: Write> {
    writer: mcap::Writer<NoSeek<W>>,
    channel: u16,
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
    /// Begins a recording: the header is written, and the first error is seen here.
    pub fn new(stream: W, header: &Header) -> Result<Self, RecordingError> {
        let options = mcap::WriteOptions::new()
            .compression(None)
            // Chunks end by time, in `write`.
            .chunk_size(None)
            .disable_seeking(true)
            .library(&header.program);
        let mut writer = options.create(NoSeek::new(stream))?;
        writer.write_metadata(&Metadata { name: SESSION.into(), metadata: header.entries() })?;
        let schema = writer.add_schema(SCHEMA_NAME, "jsonschema", SCHEMA.as_bytes())?;
        let channel = writer.add_channel(schema, TOPIC, "json", &BTreeMap::new())?;
        writer.flush()?;
        Ok(Self {
            writer,
            channel,
            start_unix_ns: header.start_unix_ns,
            chunk_begun_us: 0,
            ticks: 0,
            json: Vec::with_capacity(1_024),
        })
    }

    /// Writes one tick, and the chunk it completes.
    pub fn write(&mut self, record: &TickRecord) -> Result<(), RecordingError> {
        self.json.clear();
        message::encode(record, &mut self.json).map_err(std::io::Error::from)?;
        let log_time = self.start_unix_ns.saturating_add(record.t_us.saturating_mul(1_000));
        let header = MessageHeader {
            channel_id: self.channel,
            // Wraps after 49 days; the message has the whole number.
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

    /// Ticks taken.
    pub const fn ticks(&self) -> u64 {
        self.ticks
    }

    /// Ends the recording, with what is known of its end, and gives the stream back.
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
