//! Wire format of usb-redir 0.7: little-endian, with 16-byte headers {type, length, id} after the hello,
//! whose header has 12 bytes.
//!
//! Covers only a device with bulk pipes. An invalid packet ends the session, because the stream cannot be
//! resynchronised.

use crate::falcon::Setup;
use core::fmt;

/// Capability bits that both ends must have: the device's release in device_connect, packet sizes in ep_info,
/// 64-bit ids, 32-bit lengths of bulk packets. With them every header has a fixed layout.
pub const CAPABILITIES: u32 = 1 << 1 | 1 << 4 | 1 << 5 | 1 << 6;
/// Length of the version string.
const VERSION_LEN: usize = 64;
const VERSION: &[u8] = b"palpate-hil";
/// Header of the hello, which has a 32-bit id.
const HELLO_HEADER_LEN: usize = 12;
const HEADER_LEN: usize = 16;
/// Longest accepted body; guests request less.
const MAX_BODY_LEN: usize = 1 << 20;
/// Endpoints in ep_info: 16 out, 16 in.
pub const ENDPOINTS: usize = 32;

/// Packet types.
pub mod kind {
    #![allow(missing_docs)]
    pub const HELLO: u32 = 0;
    pub const DEVICE_CONNECT: u32 = 1;
    pub const DEVICE_DISCONNECT: u32 = 2;
    pub const RESET: u32 = 3;
    pub const INTERFACE_INFO: u32 = 4;
    pub const EP_INFO: u32 = 5;
    pub const SET_CONFIGURATION: u32 = 6;
    pub const GET_CONFIGURATION: u32 = 7;
    pub const CONFIGURATION_STATUS: u32 = 8;
    pub const SET_ALT_SETTING: u32 = 9;
    pub const GET_ALT_SETTING: u32 = 10;
    pub const ALT_SETTING_STATUS: u32 = 11;
    pub const CANCEL: u32 = 21;
    pub const CONTROL: u32 = 100;
    pub const BULK: u32 = 101;
}

/// Result of a transfer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Status {
    /// Success.
    Success = 0,
    /// The host cancelled it.
    Cancelled = 1,
    /// An invalid request.
    Invalid = 2,
    /// The device stalled it.
    Stall = 4,
}

/// A message of the peer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Message {
    /// The first message, with the peer's capabilities.
    Hello {
        /// Capabilities.
        capabilities: u32,
    },
    /// Bus reset.
    Reset,
    /// SET_CONFIGURATION.
    SetConfiguration(u8),
    /// GET_CONFIGURATION.
    GetConfiguration,
    /// SET_INTERFACE.
    SetAlternate {
        /// Interface.
        interface: u8,
        /// Alternate setting.
        alternate: u8,
    },
    /// GET_INTERFACE.
    GetAlternate {
        /// Interface.
        interface: u8,
    },
    /// Cancels the transfer with this packet's id.
    Cancel,
    /// A control transfer, with data for a request out.
    Control {
        /// Endpoint address.
        endpoint: u8,
        /// Setup packet.
        setup: Setup,
        /// Data for the device.
        data: Vec<u8>,
    },
    /// A bulk transfer.
    Bulk(Bulk),
    /// A type that such a device does not need.
    Other(u32),
}

/// A bulk transfer, with data for a transfer out.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Bulk {
    /// Endpoint address.
    pub endpoint: u8,
    /// Bytes requested, or sent.
    pub len: usize,
    /// Stream id, which is returned unchanged.
    pub stream: u32,
    /// Data for the device.
    pub data: Vec<u8>,
}

/// A protocol error of the peer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ProtocolError {
    /// The first packet is not a hello, or a second hello arrived.
    Hello,
    /// Required capabilities are missing.
    Capabilities(u32),
    /// A packet of this type is too long.
    Long(u32),
    /// A packet of this type is too short for its header.
    Short(u32),
}

impl fmt::Display for ProtocolError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Hello => f.write_str("missing or repeated hello"),
            Self::Capabilities(bits) => write!(f, "capabilities {bits:#x} lack some of {CAPABILITIES:#x}"),
            Self::Long(kind) => write!(f, "a packet of type {kind} is too long"),
            Self::Short(kind) => write!(f, "a packet of type {kind} is too short"),
        }
    }
}

impl core::error::Error for ProtocolError {}

/// Finds packets in a byte stream.
#[derive(Debug, Clone, Default)]
pub struct Reader {
    bytes: Vec<u8>,
    handshake_done: bool,
}

impl Reader {
    /// Appends bytes.
    pub fn push(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    /// The next complete message, with its id.
    pub fn next_message(&mut self) -> Result<Option<(u64, Message)>, ProtocolError> {
        let header_len = if self.handshake_done { HEADER_LEN } else { HELLO_HEADER_LEN };
        let mut fields = Fields(&self.bytes);
        let (Some(kind), Some(len)) = (fields.u32(), fields.u32()) else { return Ok(None) };
        if (kind == kind::HELLO) == self.handshake_done {
            return Err(ProtocolError::Hello);
        }
        let len = len as usize;
        if len > MAX_BODY_LEN {
            return Err(ProtocolError::Long(kind));
        }
        let id = if self.handshake_done { fields.u64() } else { fields.u32().map(u64::from) };
        let (Some(id), Some(body)) = (id, self.bytes.get(header_len..header_len + len)) else {
            return Ok(None);
        };
        let message = parse(kind, body).ok_or(ProtocolError::Short(kind))?;
        if let Message::Hello { capabilities } = message {
            if capabilities & CAPABILITIES != CAPABILITIES {
                return Err(ProtocolError::Capabilities(capabilities));
            }
            self.handshake_done = true;
        }
        self.bytes.drain(..header_len + len);
        Ok(Some((id, message)))
    }
}

/// Reads numbers from the start of a packet.
struct Fields<'b>(&'b [u8]);

impl Fields<'_> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (first, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*first)
    }

    fn u8(&mut self) -> Option<u8> {
        self.take().map(|[byte]| byte)
    }

    fn u16(&mut self) -> Option<u16> {
        self.take().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Option<u32> {
        self.take().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.take().map(u64::from_le_bytes)
    }
}

fn parse(kind: u32, body: &[u8]) -> Option<Message> {
    let mut fields = Fields(body);
    Some(match kind {
        kind::HELLO => {
            fields.take::<VERSION_LEN>()?;
            // A peer without capabilities omits the field.
            Message::Hello { capabilities: fields.u32().unwrap_or(0) }
        }
        kind::RESET => Message::Reset,
        kind::SET_CONFIGURATION => Message::SetConfiguration(fields.u8()?),
        kind::GET_CONFIGURATION => Message::GetConfiguration,
        kind::SET_ALT_SETTING => Message::SetAlternate { interface: fields.u8()?, alternate: fields.u8()? },
        kind::GET_ALT_SETTING => Message::GetAlternate { interface: fields.u8()? },
        kind::CANCEL => Message::Cancel,
        kind::CONTROL => {
            let [endpoint, request, request_type, _status] = fields.take()?;
            let (value, index, length) = (fields.u16()?, fields.u16()?, fields.u16()?);
            let setup = Setup { request_type, request, value, index, length };
            Message::Control { endpoint, setup, data: fields.0.to_vec() }
        }
        kind::BULK => {
            let [endpoint, _status] = fields.take()?;
            let low = fields.u16()?;
            let stream = fields.u32()?;
            let len = usize::from(low) | usize::from(fields.u16()?) << 16;
            Message::Bulk(Bulk { endpoint, len, stream, data: fields.0.to_vec() })
        }
        other => Message::Other(other),
    })
}

/// A packet after the hello.
#[must_use]
pub fn packet(kind: u32, id: u64, body: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(HEADER_LEN + body.len());
    bytes.extend(kind.to_le_bytes());
    bytes.extend((body.len() as u32).to_le_bytes());
    bytes.extend(id.to_le_bytes());
    bytes.extend(body);
    bytes
}

/// The hello of this end.
#[must_use]
pub fn hello() -> Vec<u8> {
    let mut bytes = Vec::new();
    for word in [kind::HELLO, (VERSION_LEN + 4) as u32, 0] {
        bytes.extend(word.to_le_bytes());
    }
    bytes.extend(VERSION);
    bytes.resize(HELLO_HEADER_LEN + VERSION_LEN, 0);
    bytes.extend(CAPABILITIES.to_le_bytes());
    bytes
}

/// Answer to a control transfer: its header with the status, and the device's data.
#[must_use]
pub fn control(id: u64, endpoint: u8, setup: Setup, status: Status, len: usize, data: &[u8]) -> Vec<u8> {
    let Setup { request_type, request, value, index, .. } = setup;
    let mut body = vec![endpoint, request, request_type, status as u8];
    for word in [value, index, len as u16] {
        body.extend(word.to_le_bytes());
    }
    body.extend(data);
    packet(kind::CONTROL, id, &body)
}

/// Answer to a bulk transfer.
#[must_use]
pub fn bulk(id: u64, endpoint: u8, stream: u32, status: Status, len: usize, data: &[u8]) -> Vec<u8> {
    let mut body = vec![endpoint, status as u8];
    body.extend((len as u16).to_le_bytes());
    body.extend(stream.to_le_bytes());
    body.extend(((len >> 16) as u16).to_le_bytes());
    body.extend(data);
    packet(kind::BULK, id, &body)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(bytes: &[u8]) -> Result<Vec<(u64, Message)>, ProtocolError> {
        let (mut reader, mut messages) = (Reader::default(), Vec::new());
        // One byte at a time, as a stream may arrive.
        for byte in bytes {
            reader.push(&[*byte]);
            while let Some(message) = reader.next_message()? {
                messages.push(message);
            }
        }
        Ok(messages)
    }

    fn after_hello(bytes: &[u8]) -> Result<Vec<(u64, Message)>, ProtocolError> {
        let mut messages = read(&[&hello(), bytes].concat())?;
        assert_eq!(messages.remove(0), (0, Message::Hello { capabilities: CAPABILITIES }));
        Ok(messages)
    }

    #[test]
    fn the_hello_is_80_bytes_with_its_capabilities_at_the_end() {
        let bytes = hello();
        assert_eq!((bytes.len(), &bytes[..8]), (80, &[0, 0, 0, 0, 68, 0, 0, 0][..]));
        assert_eq!(&bytes[12..24], b"palpate-hil\0");
        assert_eq!(bytes[76..], [0x72, 0, 0, 0]);
    }

    #[test]
    fn transfers_are_read_from_their_bytes() {
        #[rustfmt::skip]
        let bytes = [
            // GET_DESCRIPTOR(device), 18 bytes, id 0x0102030405060708.
            100, 0, 0, 0,  10, 0, 0, 0,  8, 7, 6, 5, 4, 3, 2, 1,
            0x80, 6, 0x80, 0,  0, 1,  0, 0,  18, 0,
            // A bulk transfer in of 0x10040 bytes.
            101, 0, 0, 0,  10, 0, 0, 0,  9, 0, 0, 0, 0, 0, 0, 0,
            0x81, 0,  0x40, 0,  0, 0, 0, 0,  1, 0,
            // A bulk transfer out of 3 bytes.
            101, 0, 0, 0,  13, 0, 0, 0,  10, 0, 0, 0, 0, 0, 0, 0,
            0x02, 0,  3, 0,  0, 0, 0, 0,  0, 0,  b'a', b'b', b'c',
            21, 0, 0, 0,  0, 0, 0, 0,  9, 0, 0, 0, 0, 0, 0, 0,
            6, 0, 0, 0,  1, 0, 0, 0,  11, 0, 0, 0, 0, 0, 0, 0,  1,
            9, 0, 0, 0,  2, 0, 0, 0,  12, 0, 0, 0, 0, 0, 0, 0,  0, 1,
            3, 0, 0, 0,  0, 0, 0, 0,  0, 0, 0, 0, 0, 0, 0, 0,
            23, 0, 0, 0,  0, 0, 0, 0,  0, 0, 0, 0, 0, 0, 0, 0,
        ];
        let setup = Setup { request_type: 0x80, request: 6, value: 0x100, index: 0, length: 18 };
        let bulk =
            |endpoint, len, data: &[u8]| Message::Bulk(Bulk { endpoint, len, stream: 0, data: data.into() });
        assert_eq!(
            after_hello(&bytes),
            Ok(vec![
                (0x0102_0304_0506_0708, Message::Control { endpoint: 0x80, setup, data: Vec::new() }),
                (9, bulk(0x81, 0x10040, b"")),
                (10, bulk(0x02, 3, b"abc")),
                (9, Message::Cancel),
                (11, Message::SetConfiguration(1)),
                (12, Message::SetAlternate { interface: 0, alternate: 1 }),
                (0, Message::Reset),
                (0, Message::Other(23)),
            ])
        );
    }

    #[test]
    fn answers_match_the_wire_format() {
        let setup = Setup { request_type: 0xc0, request: 5, value: 0, index: 0x0102, length: 2 };
        #[rustfmt::skip]
        assert_eq!(control(7, 0x80, setup, Status::Success, 2, &[1, 0x60]), [
            100, 0, 0, 0,  12, 0, 0, 0,  7, 0, 0, 0, 0, 0, 0, 0,
            0x80, 5, 0xc0, 0,  0, 0,  2, 1,  2, 0,  1, 0x60,
        ]);
        #[rustfmt::skip]
        assert_eq!(bulk(1 << 32, 0x81, 5, Status::Stall, 0x20003, &[]), [
            101, 0, 0, 0,  10, 0, 0, 0,  0, 0, 0, 0, 1, 0, 0, 0,
            0x81, 4,  3, 0,  5, 0, 0, 0,  2, 0,
        ]);
    }

    #[test]
    fn invalid_packets_end_the_session() {
        assert_eq!(read(&packet(kind::RESET, 0, &[])), Err(ProtocolError::Hello));
        assert_eq!(after_hello(&packet(kind::HELLO, 0, &[0; 68])), Err(ProtocolError::Hello));
        let mut weak = hello();
        weak[76] = 0x52;
        assert_eq!(read(&weak), Err(ProtocolError::Capabilities(0x52)));
        assert_eq!(read(&[0, 0, 0, 0, 63, 0, 0, 0, 0, 0, 0, 0].map(|b| b)), Ok(Vec::new()), "incomplete");
        assert_eq!(after_hello(&packet(kind::BULK, 0, &[0; 9])), Err(ProtocolError::Short(kind::BULK)));
        assert_eq!(after_hello(&[101, 0, 0, 0, 0, 0, 0, 0x7f]), Err(ProtocolError::Long(kind::BULK)));
    }
}
