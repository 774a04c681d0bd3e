//! The FT232R chip between USB and the board's UART: vendor requests, baud rates, two buffers, status bytes
//! and the latency timer.
//!
//! ```text
//! bulk OUT -> 128 bytes -> UART at the set rate -> board
//! board -> UART -> 256 bytes -> (62 bytes | timer | event character) -> bulk IN
//! ```
//!
//! The caller passes the time. Bytes at another rate or format than the receiver's arrive corrupted.

mod requests;

pub use requests::{Setup, Stall};

use super::descriptors;
use super::uart::{OTHER_FORMAT, WireByte, byte_ns};
use std::collections::VecDeque;

/// Status bytes at the start of every packet to the host.
pub const STATUS_LEN: usize = 2;
/// Payload of a full packet.
pub const PAYLOAD_LEN: usize = descriptors::PACKET_LEN - STATUS_LEN;
/// Buffer for bytes from the host to the UART.
const OUT_BUFFER_LEN: usize = 128;
/// Buffer for bytes from the UART to the host; an overflow loses bytes.
const IN_BUFFER_LEN: usize = 256;
/// Latency timer after power-up, ms.
const DEFAULT_LATENCY_MS: u8 = 16;

/// Line status: overrun, framing error, and transmitter empty.
const OVERRUN: u8 = 0x02;
const FRAMING_ERROR: u8 = 0x08;
const TRANSMITTER_EMPTY: u8 = 0x60;
/// Modem status: all inputs low; bit 0 is always set.
const MODEM_STATUS: u8 = 0x01;

/// Modem control lines that reach the board.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ModemLines {
    /// Data terminal ready.
    pub dtr: bool,
    /// Request to send.
    pub rts: bool,
}

/// State of the chip.
#[derive(Debug, Clone)]
pub struct Chip {
    now_ns: u64,
    configuration: u8,
    baud: u32,
    is_8n1: bool,
    lines: ModemLines,
    latency_ms: u8,
    event: Option<u8>,
    /// Bytes from the host and their times.
    to_board: VecDeque<(u64, u8)>,
    out_free_ns: u64,
    /// Bytes on the wire from the board.
    from_board: VecDeque<WireByte>,
    in_free_ns: u64,
    received: VecDeque<u8>,
    line_errors: u8,
    timer_due_ns: u64,
    /// The timer has expired or the event character has arrived: the next packet is sent, full or not.
    flush: bool,
}

impl Default for Chip {
    fn default() -> Self {
        Self::new(0)
    }
}

impl Chip {
    /// A chip that is powered up now.
    #[must_use]
    pub const fn new(now_us: u64) -> Self {
        let now_ns = now_us * 1_000;
        Self {
            now_ns,
            configuration: 0,
            baud: 9_600,
            is_8n1: true,
            lines: ModemLines { dtr: false, rts: false },
            latency_ms: DEFAULT_LATENCY_MS,
            event: None,
            to_board: VecDeque::new(),
            out_free_ns: 0,
            from_board: VecDeque::new(),
            in_free_ns: 0,
            received: VecDeque::new(),
            line_errors: 0,
            timer_due_ns: now_ns + DEFAULT_LATENCY_MS as u64 * 1_000_000,
            flush: false,
        }
    }

    /// The modem lines as set by the host.
    #[must_use]
    pub const fn lines(&self) -> ModemLines {
        self.lines
    }

    /// Baud rate, bits per second.
    #[must_use]
    pub const fn baud(&self) -> u32 {
        self.baud
    }

    /// The request "reset": clears buffers, event character and modem lines; keeps rate, format and latency.
    fn reset(&mut self) {
        self.to_board.clear();
        self.purge_received();
        self.event = None;
        self.lines = ModemLines::default();
    }

    fn purge_received(&mut self) {
        self.received.clear();
        self.flush = false;
        self.restart_timer();
    }

    const fn restart_timer(&mut self) {
        self.timer_due_ns = self.now_ns + self.latency_ms as u64 * 1_000_000;
    }

    /// Takes as many bytes from the host as fit and returns their number. The host sends the rest again.
    pub fn bulk_out(&mut self, bytes: &[u8]) -> usize {
        let count = bytes.len().min(OUT_BUFFER_LEN - self.to_board.len());
        self.to_board.extend(bytes[..count].iter().map(|byte| (self.now_ns, *byte)));
        count
    }

    /// Packets that are ready for the host, at most `max` bytes. A short packet ends a transfer.
    pub fn bulk_in(&mut self, max: usize) -> Option<Vec<u8>> {
        let mut transfer = Vec::new();
        while max - transfer.len() >= descriptors::PACKET_LEN {
            let count = self.received.len().min(PAYLOAD_LEN);
            if count < PAYLOAD_LEN && !self.flush {
                break;
            }
            transfer.extend(self.status());
            transfer.extend(self.received.drain(..count));
            self.line_errors = 0;
            self.restart_timer();
            if count < PAYLOAD_LEN {
                self.flush = false;
                break;
            }
        }
        (!transfer.is_empty()).then_some(transfer)
    }

    fn status(&self) -> [u8; STATUS_LEN] {
        let empty = if self.to_board.is_empty() { TRANSMITTER_EMPTY } else { 0 };
        [MODEM_STATUS, empty | self.line_errors]
    }

    /// The next byte whose last bit has reached the board by `until_ns`.
    pub fn next_for_board(&mut self, until_ns: u64) -> Option<WireByte> {
        let (put_ns, byte) = *self.to_board.front()?;
        let at_ns = put_ns.max(self.out_free_ns) + byte_ns(self.baud);
        if at_ns > until_ns {
            return None;
        }
        self.to_board.pop_front();
        self.out_free_ns = at_ns;
        Some(WireByte { at_ns, byte, baud: if self.is_8n1 { self.baud } else { OTHER_FORMAT } })
    }

    /// Sends bytes from the board, from `at_ns` on or when its transmitter is free.
    pub fn from_board(&mut self, at_ns: u64, bytes: &[u8], baud: u32) {
        for byte in bytes {
            self.in_free_ns = self.in_free_ns.max(at_ns) + byte_ns(baud);
            self.from_board.push_back(WireByte { at_ns: self.in_free_ns, byte: *byte, baud });
        }
    }

    /// Advances to a time: bytes arrive, and the timer runs.
    pub fn advance(&mut self, now_us: u64) {
        self.now_ns = self.now_ns.max(now_us * 1_000);
        let baud = if self.is_8n1 { self.baud } else { OTHER_FORMAT };
        while let Some(wire) = self.from_board.front().copied().filter(|wire| wire.at_ns <= self.now_ns) {
            self.from_board.pop_front();
            let byte = wire.decoded_at(baud);
            if byte != wire.byte {
                self.line_errors |= FRAMING_ERROR;
            }
            if self.received.len() == IN_BUFFER_LEN {
                self.line_errors |= OVERRUN;
                continue;
            }
            self.received.push_back(byte);
            self.flush |= self.event == Some(byte);
        }
        self.flush |= self.now_ns >= self.timer_due_ns;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(chip: &mut Chip, request: u8, value: u16) {
        assert_eq!(chip.control(Setup::vendor(request, value), &[]), Ok(Vec::new()));
    }

    fn fast() -> Chip {
        let mut chip = Chip::new(0);
        set(&mut chip, 3, 0x2);
        set(&mut chip, 9, 1);
        chip
    }

    #[test]
    fn the_output_buffer_holds_128_bytes_sent_at_the_baud_rate() {
        let mut chip = fast();
        assert_eq!(chip.bulk_out(&[7; 200]), 128);
        assert_eq!(chip.next_for_board(6_665), None);
        let first = chip.next_for_board(6_666).expect("after one byte time");
        assert_eq!((first.byte, first.baud, first.decoded_at(9_600) == 7), (7, 1_500_000, false));
        let mut last_ns = 0;
        while let Some(byte) = chip.next_for_board(u64::MAX) {
            last_ns = byte.at_ns;
        }
        assert_eq!(last_ns, 128 * 6_666);
    }

    /// An idle chip sends a packet of two status bytes each time the timer expires, and none before.
    #[test]
    fn an_idle_chip_sends_its_status_each_latency_period() {
        let mut chip = fast();
        for ms in 1..=5 {
            chip.advance(ms * 1_000 - 1);
            assert_eq!(chip.bulk_in(64), None);
            chip.advance(ms * 1_000);
            assert_eq!(chip.bulk_in(64), Some(vec![0x01, 0x60]));
            assert_eq!(chip.bulk_in(64), None);
        }
        set(&mut chip, 9, 16);
        chip.advance(20_999);
        assert_eq!(chip.bulk_in(64), None);
        chip.advance(21_000);
        assert!(chip.bulk_in(64).is_some());
    }

    #[test]
    fn a_packet_is_sent_on_the_timer_at_62_bytes_or_on_the_event_character() {
        let mut chip = fast();
        chip.from_board(0, b"<abc>", 1_500_000);
        chip.advance(999);
        assert_eq!(chip.bulk_in(64), None);
        chip.advance(1_000);
        assert_eq!(chip.bulk_in(64), Some(b"\x01\x60<abc>".to_vec()));

        chip.from_board(1_000_000, &[b'x'; 61], 1_500_000);
        chip.advance(1_500);
        assert_eq!(chip.bulk_in(64), None);
        chip.from_board(1_500_000, b"yz", 1_500_000);
        chip.advance(1_600);
        let full = chip.bulk_in(512).expect("62 bytes");
        assert_eq!((full.len(), full.last()), (64, Some(&b'y')));
        assert_eq!(chip.bulk_in(512), None, "the last byte waits for the timer");

        set(&mut chip, 6, 0x013e);
        chip.from_board(1_700_000, b"<abc>", 1_500_000);
        chip.advance(1_733);
        assert_eq!(chip.bulk_in(64), None);
        chip.advance(1_734);
        assert_eq!(chip.bulk_in(64), Some(b"\x01\x60z<abc>".to_vec()));
    }

    #[test]
    fn each_packet_of_a_transfer_has_its_status_and_a_short_one_ends_it() {
        let mut chip = fast();
        chip.from_board(0, &(0..130).collect::<Vec<u8>>(), 1_500_000);
        chip.advance(1_000);
        let transfer = chip.bulk_in(4_096).expect("three packets");
        assert_eq!(transfer.len(), 130 + 3 * 2);
        for packet in transfer.chunks(64) {
            assert_eq!(packet[..2], [0x01, 0x60]);
        }
        let payload: Vec<u8> = transfer.chunks(64).flat_map(|packet| packet[2..].to_vec()).collect();
        assert_eq!(payload, (0..130).collect::<Vec<u8>>());
    }

    #[test]
    fn unread_bytes_overrun_and_a_purge_clears_the_buffers() {
        let mut chip = fast();
        chip.from_board(0, &[1; 300], 1_500_000);
        chip.advance(10_000);
        let transfer = chip.bulk_in(4_096).expect("full");
        assert_eq!((transfer.len(), transfer[1] & OVERRUN), (256 + 5 * 2, OVERRUN));
        chip.from_board(10_000_000, &[1; 20], 1_500_000);
        chip.bulk_out(&[1; 20]);
        chip.advance(10_200);
        set(&mut chip, 0, 1);
        set(&mut chip, 0, 2);
        chip.advance(20_000);
        assert_eq!(
            (chip.bulk_in(64).map(|bytes| bytes.len()), chip.next_for_board(u64::MAX)),
            (Some(2), None)
        );
    }

    #[test]
    fn a_wrong_rate_or_format_is_noise() {
        let mut chip = fast();
        chip.from_board(0, b"A", 142_857);
        chip.advance(1_000);
        let packet = chip.bulk_in(64).expect("one byte");
        assert!(packet[1] & FRAMING_ERROR != 0 && packet[2] != b'A');
        set(&mut chip, 4, 0x0108);
        chip.from_board(1_000_000, b"A", 1_500_000);
        chip.advance(2_000);
        assert_ne!(chip.bulk_in(64).expect("one byte")[2], b'A');
    }

    #[test]
    fn modem_lines_follow_their_mask_and_unknown_requests_stall() {
        let mut chip = fast();
        set(&mut chip, 1, 0x0101);
        set(&mut chip, 1, 0x0200);
        assert_eq!(chip.lines(), ModemLines { dtr: true, rts: false });
        set(&mut chip, 1, 0x0100);
        assert_eq!(chip.lines(), ModemLines::default());
        set(&mut chip, 2, 0);
        for (request, value) in [(9, 0), (9, 256), (0, 3), (2, 1), (0x77, 0)] {
            assert_eq!(chip.control(Setup::vendor(request, value), &[]), Err(Stall), "{request} {value}");
        }
        let elsewhere = Setup { index: 1, ..Setup::vendor(9, 1) };
        assert_eq!(chip.control(elsewhere, &[]), Err(Stall));
        assert_eq!(chip.control(Setup::vendor(9, 1), &[0]), Err(Stall), "there is no data stage");
    }

    #[test]
    fn standard_requests_enumerate_the_chip() {
        let mut chip = Chip::new(0);
        let get = |value, length| Setup { request_type: 0x80, request: 6, value, index: 0, length };
        assert_eq!(chip.control(get(0x0100, 8), &[]).expect("a descriptor").len(), 8);
        assert_eq!(chip.control(get(0x0100, 64), &[]).expect("a descriptor").len(), 18);
        assert_eq!(chip.control(get(0x0200, 255), &[]).expect("a descriptor").len(), 32);
        assert_eq!(chip.control(get(0x0600, 10), &[]), Err(Stall), "it has one speed only");
        let configure = Setup { request_type: 0, request: 9, value: 1, index: 0, length: 0 };
        assert_eq!(chip.control(configure, &[]), Ok(Vec::new()));
        let which = Setup { request_type: 0x80, request: 8, value: 0, index: 0, length: 1 };
        assert_eq!(chip.control(which, &[]), Ok(vec![1]));
        let latency = Setup { request_type: 0xc0, request: 10, value: 0, index: 0, length: 1 };
        assert_eq!(chip.control(latency, &[]), Ok(vec![16]));
    }
}
