//! The datagrams between a host and its supervisor: fixed sizes, little-endian, with a checksum.
//!
//! ```text
//! order        magic, version, kind, nonce | number, sent | session, force | CRC-32           48 bytes
//! report       magic, version, kind, nonce | answers, session | state, sample, error | CRC-32 64 bytes
//! open result  magic, version, kind, nonce | device info, or the error line | CRC-32          1024 bytes
//! ```
//!
//! The host draws a nonce for each supervisor. A datagram with another length, kind, version, nonce or
//! checksum is ignored. Both ends are the same program on the same machine, so all times are of one clock
//! (CLOCK_MONOTONIC).

use crate::device::{DeviceError, DeviceErrorKind, DeviceInfo, DeviceState};
use palpate_core::format::CHECKSUM;
use palpate_core::{Vec3, vec3};
use palpate_link::DeviceFault;

/// Length of an order.
pub const ORDER_LEN: usize = 48;
/// Length of a report.
pub const REPORT_LEN: usize = 64;
/// Length of an open result.
pub const OPEN_RESULT_LEN: usize = 1024;
/// Longest text of an open result.
const MAX_TEXT: usize = OPEN_RESULT_LEN - 64;
const MAGIC: [u8; 4] = *b"PSup";
const VERSION: u8 = 1;
const CHECKSUM_LEN: usize = 4;

/// An order of the host.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Order {
    /// The first order: the limit for the time without a tick.
    Hello {
        /// The limit, us.
        limit_us: u32,
    },
    /// A tick of the loop: exchange with the device. From the first tick on, silence zeroes the force.
    Tick {
        /// The session of the tick; in any other session the force is ignored.
        session: u32,
        /// Force for the hand, model frame, N.
        force_n: Vec3,
    },
    /// An exchange with zero force outside the loop. Deactivates the watch until the next tick.
    Poll,
    /// Zero the force, and latch.
    Zero,
    /// The loop has ended: stop the device and deactivate the watch.
    Stop,
    /// The same, and exit the process.
    Leave,
}

/// An order with its header.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OrderMessage {
    /// Nonce of the host.
    pub nonce: u32,
    /// Number, greater than that of every earlier order.
    pub number: u64,
    /// Send time, CLOCK_MONOTONIC, ns.
    pub sent_ns: u64,
    /// The order.
    pub order: Order,
}

/// A measured position of the hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReportedPosition {
    /// Number of the order that sent its request to the device.
    pub order_number: u64,
    /// Position, model frame, m.
    pub position_m: Vec3,
    /// One bit per button.
    pub buttons: u32,
}

/// A report of the supervisor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Report {
    /// Number of the order it answers; 0 for none.
    pub answers: u64,
    /// The session in which forces are executed.
    pub session: u32,
    /// Whether the answered order stopped the device.
    pub stopped: bool,
    /// State of the device.
    pub device: DeviceState,
    /// A sample that was not reported before.
    pub place: Option<ReportedPosition>,
    /// Error of the exchange.
    pub error: Option<DeviceError>,
}

/// The first report: the result of opening the device.
#[derive(Debug, Clone, PartialEq)]
pub enum OpenResult {
    /// The device is open.
    Opened {
        /// Its identity and limits.
        info: DeviceInfo,
        /// Its state.
        state: DeviceState,
        /// SCHED_FIFO priority of the supervisor; 0 for ordinary scheduling.
        fifo_priority: i32,
    },
    /// The device could not be opened.
    Refused {
        /// Reason and fix in one line.
        text: String,
    },
}

const KINDS: [DeviceErrorKind; 11] = [
    DeviceErrorKind::Timeout,
    DeviceErrorKind::BadFrame,
    DeviceErrorKind::Disconnected,
    DeviceErrorKind::Denied,
    DeviceErrorKind::Unsupported,
    DeviceErrorKind::Io,
    DeviceErrorKind::Faulted(DeviceFault::Watchdog),
    DeviceErrorKind::Faulted(DeviceFault::Clock),
    DeviceErrorKind::Faulted(DeviceFault::Overspeed),
    DeviceErrorKind::Faulted(DeviceFault::HomeLost),
    DeviceErrorKind::Faulted(DeviceFault::Hardware),
];

/// Writer into a buffer of fixed length. Bytes that do not fit are dropped; no caller exceeds the length.
struct Writer<const N: usize> {
    bytes: [u8; N],
    at: usize,
}

impl<const N: usize> Writer<N> {
    fn new(kind: u8, nonce: u32) -> Self {
        let mut writer = Self { bytes: [0; N], at: 0 };
        writer.put(&MAGIC);
        writer.put(&[VERSION, kind, 0, 0]);
        writer.put(&nonce.to_le_bytes());
        writer
    }

    fn put(&mut self, bytes: &[u8]) {
        if let Some(place) = self.bytes.get_mut(self.at..self.at + bytes.len()) {
            place.copy_from_slice(bytes);
            self.at += bytes.len();
        }
    }

    fn put_vec(&mut self, vector: Vec3) {
        vector.iter().for_each(|value| self.put(&value.to_le_bytes()));
    }

    fn finish(mut self) -> [u8; N] {
        let checksum = CHECKSUM.checksum(&self.bytes[..N - CHECKSUM_LEN]);
        self.bytes[N - CHECKSUM_LEN..].copy_from_slice(&checksum.to_le_bytes());
        self.bytes
    }
}

/// Reader of a checked buffer.
struct Reader<'b>(&'b [u8]);

impl<'b> Reader<'b> {
    /// Checks a datagram; returns kind, nonce and the remaining bytes.
    fn new(bytes: &'b [u8], len: usize) -> Option<(u8, u32, Self)> {
        let (body, checksum) = bytes.split_last_chunk::<CHECKSUM_LEN>()?;
        if bytes.len() != len || CHECKSUM.checksum(body) != u32::from_le_bytes(*checksum) {
            return None;
        }
        let mut reader = Self(body);
        let [version, kind, 0, 0] = (reader.take::<4>()? == MAGIC).then(|| reader.take())?? else {
            return None;
        };
        let nonce = reader.u32()?;
        (version == VERSION).then_some((kind, nonce, reader))
    }

    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (taken, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*taken)
    }

    fn u32(&mut self) -> Option<u32> {
        self.take().map(u32::from_le_bytes)
    }

    fn i32(&mut self) -> Option<i32> {
        self.take().map(i32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.take().map(u64::from_le_bytes)
    }

    fn f32(&mut self) -> Option<f32> {
        self.take().map(f32::from_le_bytes)
    }

    fn vec(&mut self) -> Option<Vec3> {
        Some([self.f32()?, self.f32()?, self.f32()?]).filter(|vector| vec3::is_finite(*vector))
    }

    fn text(&mut self) -> Option<String> {
        let len = self.u32()? as usize;
        let (text, rest) = self.0.split_at_checked(len)?;
        self.0 = rest;
        String::from_utf8(text.to_vec()).ok()
    }
}

impl OrderMessage {
    /// Encodes the order.
    #[must_use]
    pub fn encode(&self) -> [u8; ORDER_LEN] {
        let (kind, session, force_n) = match self.order {
            Order::Hello { limit_us } => (1, limit_us, vec3::ZERO),
            Order::Tick { session, force_n } => (2, session, force_n),
            Order::Poll => (3, 0, vec3::ZERO),
            Order::Zero => (4, 0, vec3::ZERO),
            Order::Stop => (5, 0, vec3::ZERO),
            Order::Leave => (6, 0, vec3::ZERO),
        };
        let mut writer = Writer::new(kind, self.nonce);
        writer.put(&self.number.to_le_bytes());
        writer.put(&self.sent_ns.to_le_bytes());
        writer.put(&session.to_le_bytes());
        writer.put_vec(force_n);
        writer.finish()
    }

    /// Decodes a datagram; `None` if it is invalid.
    #[must_use]
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let (kind, nonce, mut reader) = Reader::new(bytes, ORDER_LEN)?;
        let (number, sent_ns, session, force_n) =
            (reader.u64()?, reader.u64()?, reader.u32()?, reader.vec()?);
        let order = match kind {
            1 => Order::Hello { limit_us: session },
            2 => Order::Tick { session, force_n },
            3 => Order::Poll,
            4 => Order::Zero,
            5 => Order::Stop,
            6 => Order::Leave,
            _ => return None,
        };
        Some(Self { nonce, number, sent_ns, order })
    }
}

const REPORT: u8 = 16;
const OPENED: u8 = 17;
const REFUSED: u8 = 18;

/// Index of a state or a kind in the list of all; there are fewer than 255.
fn index_of<T: PartialEq>(all: &[T], one: &T) -> u8 {
    all.iter().position(|other| other == one).map_or(u8::MAX, |index| index as u8)
}

impl Report {
    /// Encodes the report.
    #[must_use]
    pub fn encode(&self, nonce: u32) -> [u8; REPORT_LEN] {
        let mut writer = Writer::new(REPORT, nonce);
        writer.put(&self.answers.to_le_bytes());
        writer.put(&self.session.to_le_bytes());
        let error = self.error.map_or(u8::MAX, |error| index_of(&KINDS, &error.kind()));
        let has_place = u8::from(self.place.is_some());
        writer.put(&[u8::from(self.stopped), index_of(&DeviceState::ALL, &self.device), has_place, error]);
        writer.put(&self.error.and_then(|error| error.os_code()).unwrap_or(0).to_le_bytes());
        if let Some(ReportedPosition { order_number, position_m, buttons }) = self.place {
            writer.put(&order_number.to_le_bytes());
            writer.put_vec(position_m);
            writer.put(&buttons.to_le_bytes());
        }
        writer.finish()
    }

    /// Decodes a datagram; `None` if it is invalid.
    #[must_use]
    pub fn decode(bytes: &[u8], nonce: u32) -> Option<Self> {
        let (REPORT, sender, mut reader) = Reader::new(bytes, REPORT_LEN)? else { return None };
        let (answers, session) = (reader.u64()?, reader.u32()?);
        let [stopped, device, has_place, error] = reader.take()?;
        let os_code = Some(reader.i32()?).filter(|code| *code != 0);
        // The controller checks whether the position is finite.
        let place = ReportedPosition {
            order_number: reader.u64()?,
            position_m: [reader.f32()?, reader.f32()?, reader.f32()?],
            buttons: reader.u32()?,
        };
        let error = match error {
            u8::MAX => None,
            index => Some(DeviceError::with_os_code(*KINDS.get(usize::from(index))?, os_code)),
        };
        let report = Self {
            answers,
            session,
            stopped: stopped != 0,
            device: *DeviceState::ALL.get(usize::from(device))?,
            place: (has_place != 0).then_some(place),
            error,
        };
        (sender == nonce).then_some(report)
    }
}

/// Writes the text, truncated to the available length.
fn put_text<const N: usize>(writer: &mut Writer<N>, text: &str) {
    let end = (0..=text.len().min(MAX_TEXT)).rev().find(|end| text.is_char_boundary(*end)).unwrap_or(0);
    writer.put(&(end as u32).to_le_bytes());
    writer.put(&text.as_bytes()[..end]);
}

impl OpenResult {
    /// Encodes the result.
    #[must_use]
    pub fn encode(&self, nonce: u32) -> [u8; OPEN_RESULT_LEN] {
        let mut writer;
        match self {
            Self::Opened { info, state, fifo_priority } => {
                writer = Writer::new(OPENED, nonce);
                for figure in [info.max_force_n, info.max_stiffness_n_m, info.resolution_m] {
                    writer.put(&figure.to_le_bytes());
                }
                writer.put(&[u8::from(info.self_arming), index_of(&DeviceState::ALL, state)]);
                writer.put(&fifo_priority.to_le_bytes());
                put_text(&mut writer, &info.name);
            }
            Self::Refused { text } => {
                writer = Writer::new(REFUSED, nonce);
                put_text(&mut writer, text);
            }
        }
        writer.finish()
    }

    /// Decodes a datagram; `None` if it is invalid.
    #[must_use]
    pub fn decode(bytes: &[u8], nonce: u32) -> Option<Self> {
        let (kind, sender, mut reader) = Reader::new(bytes, OPEN_RESULT_LEN)?;
        let opening = match kind {
            OPENED => {
                let (max_force_n, max_stiffness_n_m, resolution_m) =
                    (reader.f32()?, reader.f32()?, reader.f32()?);
                let [self_arming, state] = reader.take()?;
                let state = *DeviceState::ALL.get(usize::from(state))?;
                let fifo_priority = reader.i32()?;
                let (name, self_arming) = (reader.text()?, self_arming != 0);
                let info = DeviceInfo { name, self_arming, max_force_n, max_stiffness_n_m, resolution_m };
                Self::Opened { info, state, fifo_priority }
            }
            REFUSED => Self::Refused { text: reader.text()? },
            _ => return None,
        };
        (sender == nonce).then_some(opening)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TICK: OrderMessage = OrderMessage {
        nonce: 7,
        number: 41,
        sent_ns: 123_456_789,
        order: Order::Tick { session: 3, force_n: [1.0, -2.5, 0.25] },
    };

    fn report() -> Report {
        let place = ReportedPosition { order_number: 40, position_m: [0.1, -0.2, 0.3], buttons: 5 };
        let error = DeviceError::with_os_code(DeviceErrorKind::Io, Some(5));
        let device = DeviceState::Homed;
        Report { answers: 41, session: 3, stopped: false, device, place: Some(place), error: Some(error) }
    }

    #[test]
    fn datagrams_survive_a_round_trip() {
        for order in [
            Order::Hello { limit_us: 10_000 },
            TICK.order,
            Order::Poll,
            Order::Zero,
            Order::Stop,
            Order::Leave,
        ] {
            let order = OrderMessage { order, ..TICK };
            assert_eq!(OrderMessage::decode(&order.encode()), Some(order));
        }
        let bare = Report { place: None, error: None, stopped: true, ..report() };
        for report in [report(), bare] {
            assert_eq!(Report::decode(&report.encode(7), 7), Some(report));
            assert_eq!(Report::decode(&report.encode(7), 8), None, "another host's nonce");
        }
        let info = DeviceInfo {
            name: "Polhem on /dev/pts/7".into(),
            self_arming: false,
            max_force_n: 5.0,
            max_stiffness_n_m: 1e3,
            resolution_m: 1e-6,
        };
        let long = OpenResult::Refused { text: "ä".repeat(2_000) };
        let Some(OpenResult::Refused { text }) = OpenResult::decode(&long.encode(7), 7) else {
            panic!("it must decode")
        };
        assert!(text.len() == MAX_TEXT && text.chars().all(|c| c == 'ä'));
        let opened = OpenResult::Opened { info, state: DeviceState::Unhomed, fifo_priority: 51 };
        assert_eq!(OpenResult::decode(&opened.encode(7), 7), Some(opened));
    }

    #[test]
    fn every_damaged_datagram_is_refused() {
        let good = TICK.encode();
        for bit in 0..8 * good.len() {
            let mut bad = good;
            bad[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(OrderMessage::decode(&bad), None, "bit {bit}");
        }
        for len in 0..good.len() {
            assert_eq!(OrderMessage::decode(&good[..len]), None);
        }
        assert_eq!(OrderMessage::decode(&report().encode(7)), None);
        assert_eq!(Report::decode(&good, 7), None);
        for force_n in [[f32::NAN, 0.0, 0.0], [0.0, f32::INFINITY, 0.0]] {
            let order = OrderMessage { order: Order::Tick { session: 3, force_n }, ..TICK };
            assert_eq!(OrderMessage::decode(&order.encode()), None);
        }
    }
}
