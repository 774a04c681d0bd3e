//! Messages as frames on a serial line.
//!
//! ```text
//! frame = COBS( message in postcard, CRC-32 of it, little-endian )  00
//! ```
//!
//! COBS leaves no 00 in a frame except the last byte, so a reader is synchronised after one 00. An additional
//! 00 between two frames has no meaning; a host sends one before it repeats a request, so that a truncated
//! frame does not corrupt the next one.
//!
//! The implementation of COBS is the crate `cobs`, which postcard uses too. The framing of postcard is not
//! used: its encoder writes through `IndexMut`, which may panic, and its decoder needs the whole frame at
//! once.

use core::marker::PhantomData;

use cobs::{DecodeResult, DecoderState};
use crc::{CRC_32_ISO_HDLC, Crc};
use heapless::Vec;
use serde::Serialize;

use super::message::{MAX_MESSAGE, Message};

/// The checksum of a message.
const CHECKSUM: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);
/// Its length in bytes.
const CHECKSUM_LEN: usize = 4;
/// Length of the longest message and its checksum.
const MAX_BODY: usize = MAX_MESSAGE + CHECKSUM_LEN;
/// Length of the longest frame in bytes, final 00 included: it fits in a USB packet of 64 bytes.
pub const MAX_FRAME: usize = cobs::max_encoding_length(MAX_BODY) + 1;

/// A message exceeds the longest of the link; [`super::HostMessage`] and [`super::DeviceMessage`] never do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the message is longer than {} bytes", MAX_MESSAGE)]
pub struct EncodeError;

/// Writes one message as a frame; returns the part of `frame` that it occupies, final 00 included.
pub fn encode<'f, T: Serialize>(
    message: &T,
    frame: &'f mut [u8; MAX_FRAME],
) -> Result<&'f [u8], EncodeError> {
    let mut body = [0; MAX_BODY];
    let bytes = postcard::to_slice(message, &mut body).map_err(|_| EncodeError)?;
    let (len, checksum) = (bytes.len(), CHECKSUM.checksum(bytes));
    let rest = body.get_mut(len..).and_then(<[u8]>::first_chunk_mut);
    *rest.ok_or(EncodeError)? = checksum.to_le_bytes();
    let body = body.get(..len.saturating_add(CHECKSUM_LEN)).ok_or(EncodeError)?;
    let end = cobs::try_encode(body, frame).map_err(|_| EncodeError)?;
    *frame.get_mut(end).ok_or(EncodeError)? = 0;
    frame.get(..=end).ok_or(EncodeError)
}

/// Why a frame was discarded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, thiserror::Error)]
pub enum FrameError {
    /// Longer than any message.
    #[error("the frame is longer than any message")]
    TooLong,
    /// It ends inside a COBS block.
    #[error("the frame ends inside a COBS block")]
    Cobs,
    /// It is too short for a checksum and a message.
    #[error("the frame is too short for a checksum and a message")]
    TooShort,
    /// The bytes are not those that were sent.
    #[error("the frame's checksum is wrong")]
    Checksum,
    /// The checksum is correct, but the bytes are not the encoding of a message of this direction.
    #[error("the frame contains no message of this protocol")]
    Message,
    /// Bytes follow the message.
    #[error("bytes follow the message in the frame")]
    Trailing,
}

/// Decodes the frames of a byte stream. It never waits and stores at most one message.
#[derive(Debug)]
pub struct FrameReader<T> {
    cobs: DecoderState,
    body: Vec<u8, MAX_BODY>,
    too_long: bool,
    reads: PhantomData<fn() -> T>,
}

impl<T> Default for FrameReader<T> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T> FrameReader<T> {
    /// A reader at the start of a frame.
    pub const fn new() -> Self {
        Self { cobs: DecoderState::Idle, body: Vec::new(), too_long: false, reads: PhantomData }
    }
}

impl<T: Message> FrameReader<T> {
    /// Processes one byte. At the last byte of a frame returns its message, or the reason why there is none.
    ///
    /// Cost: a few instructions; at the end of a frame the checksum and the decoding of at most 50 bytes.
    pub fn push(&mut self, byte: u8) -> Option<Result<T, FrameError>> {
        let whole = match self.cobs.feed(byte) {
            Ok(DecodeResult::NoData) => return None,
            Ok(DecodeResult::DataContinue(data)) => {
                self.too_long |= self.body.push(data).is_err();
                return None;
            }
            Ok(DecodeResult::DataComplete) => Ok(()),
            Err(_) => Err(FrameError::Cobs),
        };
        // A frame that is too long is reported as such, whatever follows.
        let whole = if self.too_long { Err(FrameError::TooLong) } else { whole };
        let outcome = whole.and_then(|()| decode(&self.body));
        self.body.clear();
        self.too_long = false;
        Some(outcome)
    }

    /// Processes bytes up to the end of the next frame and leaves the others; `None` if all bytes are
    /// consumed.
    pub fn read(&mut self, bytes: &mut &[u8]) -> Option<Result<T, FrameError>> {
        while let Some((&byte, rest)) = bytes.split_first() {
            *bytes = rest;
            let outcome = self.push(byte);
            if outcome.is_some() {
                return outcome;
            }
        }
        None
    }
}

/// The message of a decoded frame.
fn decode<T: Message>(body: &[u8]) -> Result<T, FrameError> {
    let (message, stored) = body.split_last_chunk::<CHECKSUM_LEN>().ok_or(FrameError::TooShort)?;
    if message.is_empty() {
        return Err(FrameError::TooShort);
    }
    if CHECKSUM.checksum(message) != u32::from_le_bytes(*stored) {
        return Err(FrameError::Checksum);
    }
    match postcard::take_from_bytes::<T>(message) {
        Ok((found, [])) if found.encoded_len() == message.len() => Ok(found),
        Ok((_, [_, ..])) => Err(FrameError::Trailing),
        Ok(_) | Err(_) => Err(FrameError::Message),
    }
}
