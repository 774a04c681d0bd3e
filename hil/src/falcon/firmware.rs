//! The firmware at 1.5 Mbaud: 16-byte packets, one reply to each valid packet, homing, and no watchdog.
//!
//! Packet: `<`, 14 bytes of 0x41 + value, `>`. To the device: motors 1 to 3 (i16, four nibbles, low first),
//! then bit 0 homing request and bits 1 to 3 the LEDs green, blue, red, then 0x41. To the host: encoders 1 to
//! 3 in the same coding, then bits 0 to 3 buttons and bits 4 to 6 homed, then 0x41. Other packets are
//! discarded without a reply. The motors keep the last valid command.

/// Baud rate of the firmware.
pub const BAUD: u32 = 1_500_000;
/// Length of a packet in either direction.
pub const PACKET_LEN: usize = 16;

const BEGIN: u8 = 0x3c;
const END: u8 = 0x3e;
/// Code of zero.
const BASE: u8 = 0x41;
const HOMING_REQUEST: u8 = 1;

/// Content of a valid packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Request {
    motors: [i16; 3],
    control: u8,
}

/// The running firmware.
#[derive(Debug, Clone)]
pub struct Firmware {
    packet: Vec<u8>,
    motors: [i16; 3],
    homing: bool,
    leds: u8,
    buttons: u8,
    /// True counts of the encoder wheels from their index.
    counts: [i32; 3],
    /// Offset of the reported counts.
    offset: [i32; 3],
    homed: [bool; 3],
    requests: u64,
    refused: u64,
}

impl Firmware {
    /// Firmware whose encoders start with the offset `raw_offset` from their index.
    #[must_use]
    pub fn new(counts: [i32; 3], raw_offset: [i16; 3]) -> Self {
        Self {
            packet: Vec::with_capacity(PACKET_LEN),
            motors: [0; 3],
            homing: false,
            leds: 0,
            buttons: 0,
            counts,
            offset: raw_offset.map(i32::from),
            homed: [false; 3],
            requests: 0,
            refused: 0,
        }
    }

    /// The last valid motor command.
    #[must_use]
    pub const fn motors(&self) -> [i16; 3] {
        self.motors
    }

    /// LEDs: bit 0 green, 1 blue, 2 red.
    #[must_use]
    pub const fn leds(&self) -> u8 {
        self.leds
    }

    /// Whether the last packet requested homing.
    #[must_use]
    pub const fn is_homing(&self) -> bool {
        self.homing
    }

    /// Which axes have passed their index.
    #[must_use]
    pub const fn homed(&self) -> [bool; 3] {
        self.homed
    }

    /// Valid packets so far.
    #[must_use]
    pub const fn requests(&self) -> u64 {
        self.requests
    }

    /// Discarded packets so far.
    #[must_use]
    pub const fn refused(&self) -> u64 {
        self.refused
    }

    /// Pressed buttons: plus, forward, centre, minus from bit 0.
    pub const fn set_buttons(&mut self, buttons: u8) {
        self.buttons = buttons & 0x0f;
    }

    /// Sets the true counts. An axis that moves in past its index during homing is homed and counts from
    /// there.
    pub fn update(&mut self, counts: [i32; 3]) {
        for axis in 0..3 {
            let passes = self.counts[axis] > 0 && counts[axis] <= 0;
            if self.homing && !self.homed[axis] && passes {
                (self.homed[axis], self.offset[axis]) = (true, 0);
            }
        }
        self.counts = counts;
    }

    /// Adds a miscount to an encoder.
    pub const fn jump(&mut self, axis: usize, counts: i32) {
        self.offset[axis] += counts;
    }

    /// Miscount of each encoder; 0 before its axis is homed.
    #[must_use]
    pub fn miscounted(&self) -> [i32; 3] {
        core::array::from_fn(|axis| if self.homed[axis] { self.offset[axis] } else { 0 })
    }

    /// Loses the index, as after a reset of the board.
    pub fn lose_homing(&mut self, raw_offset: [i16; 3]) {
        (self.homed, self.offset) = ([false; 3], raw_offset.map(i32::from));
    }

    /// Counts reported by the encoders.
    #[must_use]
    pub fn reported(&self) -> [i32; 3] {
        core::array::from_fn(|axis| self.counts[axis] + self.offset[axis])
    }

    /// Sets which axes report that they have passed their index, and leaves their counts.
    pub const fn set_homed(&mut self, homed: [bool; 3]) {
        self.homed = homed;
    }

    /// Takes a received byte. Returns the reply after the last byte of a valid packet.
    pub fn take(&mut self, byte: u8) -> Option<[u8; PACKET_LEN]> {
        if self.packet.is_empty() && byte != BEGIN {
            return None;
        }
        // The begin character cannot occur inside a packet, so the bytes before it are a truncated packet.
        if byte == BEGIN && !self.packet.is_empty() {
            self.refused += 1;
            self.packet.clear();
        }
        self.packet.push(byte);
        if byte != END && self.packet.len() < PACKET_LEN {
            return None;
        }
        let request = parse(&self.packet);
        self.packet.clear();
        let Some(Request { motors, control }) = request else {
            self.refused += 1;
            return None;
        };
        self.requests += 1;
        self.motors = motors;
        self.homing = control & HOMING_REQUEST != 0;
        self.leds = control >> 1;
        Some(self.reply())
    }

    fn reply(&self) -> [u8; PACKET_LEN] {
        let mut packet = [BASE; PACKET_LEN];
        packet[0] = BEGIN;
        for axis in 0..3 {
            // An i16 wraps, like its register.
            let reported = self.reported()[axis] as u16;
            for nibble in 0..4 {
                packet[1 + 4 * axis + nibble] += (reported >> (4 * nibble) & 0x0f) as u8;
            }
        }
        let homed: u8 = (0..3).map(|axis| u8::from(self.homed[axis]) << (4 + axis)).sum();
        packet[13] += self.buttons | homed;
        packet[15] = END;
        packet
    }
}

/// Whether the bytes contain a packet with valid delimiters.
#[must_use]
pub fn is_whole(bytes: &[u8]) -> bool {
    bytes.windows(PACKET_LEN).any(|packet| (packet[0], packet[PACKET_LEN - 1]) == (BEGIN, END))
}

fn parse(packet: &[u8]) -> Option<Request> {
    let [BEGIN, inner @ .., END] = packet else { return None };
    let values: Vec<u8> = inner.iter().map(|byte| byte.wrapping_sub(BASE)).collect();
    let values = <&[u8; PACKET_LEN - 2]>::try_from(values.as_slice()).ok()?;
    if values.iter().any(|value| *value > 0x0f) {
        return None;
    }
    let word =
        |from: usize| (0..4).map(|nibble| u16::from(values[from + nibble]) << (4 * nibble)).sum::<u16>();
    Some(Request { motors: [0, 4, 8].map(|from| word(from) as i16), control: values[12] })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Coded by hand: motors 1, -2 and 0x1234, homing and the blue LED.
    const REQUEST: &[u8; 16] = b"<BAAAOPPPEDCBFA>";

    fn send(firmware: &mut Firmware, bytes: &[u8]) -> Vec<u8> {
        bytes.iter().filter_map(|byte| firmware.take(*byte)).flatten().collect()
    }

    #[test]
    fn a_valid_packet_is_decoded_and_answered() {
        let mut firmware = Firmware::new([-516, 0, 300], [0; 3]);
        firmware.set_buttons(0b1001);
        // -516 is 0xFDFC, 300 is 0x012C; buttons plus and minus.
        assert_eq!(send(&mut firmware, REQUEST), b"<MPNPAAAAMCBAJA>");
        assert_eq!(firmware.motors(), [1, -2, 0x1234]);
        assert_eq!((firmware.leds(), firmware.is_homing(), firmware.requests()), (0b010, true, 1));
    }

    #[test]
    fn a_whole_packet_is_found_among_other_bytes() {
        let mut bytes = b"x>".to_vec();
        bytes.extend(REQUEST);
        assert!(is_whole(&bytes) && is_whole(REQUEST));
        assert!(!is_whole(&bytes[..17]) && !is_whole(&REQUEST[1..]) && !is_whole(&[]));
    }

    #[test]
    fn invalid_packets_are_discarded_and_the_motors_keep_their_command() {
        let mut firmware = Firmware::new([0; 3], [0; 3]);
        send(&mut firmware, REQUEST);
        for bad in [
            &b"<BAAAOPPPEDCBFA"[..], // truncated: detected at the next begin character
            b"<BAAAOPPPEDCB>",
            b"<BAAAOPPPEDCBFAA",
            b"<BAAAQPPPEDCBFA>",
            b"<BAAA@PPPEDCBFA>",
            b"BAAAOPPPEDCBFA>",
            b"\xff\x00>>>",
        ] {
            assert_eq!(send(&mut firmware, bad), b"", "{bad:?}");
        }
        assert_eq!((firmware.refused(), firmware.requests()), (5, 1));
        assert_eq!(firmware.motors(), [1, -2, 0x1234]);
        // It resynchronises at once, also inside a truncated packet.
        assert_eq!(send(&mut firmware, b"<BAA<AAAAAAAAAAAAAA>").len(), 16);
        assert_eq!((firmware.motors(), firmware.is_homing()), ([0; 3], false));
    }

    #[test]
    fn each_axis_is_homed_when_it_moves_in_past_its_index() {
        let mut firmware = Firmware::new([40, 40, 40], [1_000, -2_000, 32_767]);
        firmware.update([-5, 40, 40]);
        assert_eq!(firmware.homed(), [false; 3], "homing was not requested");
        firmware.update([40, 40, 40]);
        send(&mut firmware, REQUEST);
        firmware.update([-1, 40, 0]);
        assert_eq!(firmware.homed(), [true, false, true]);
        firmware.update([-1, -3, 0]);
        let reply = send(&mut firmware, REQUEST);
        assert_eq!((reply[13], &reply[1..9]), (BASE + 0x70, &b"PPPPNPPP"[..]));
        // Moving out past the index homes nothing.
        let mut firmware = Firmware::new([-10; 3], [0; 3]);
        send(&mut firmware, REQUEST);
        firmware.update([10; 3]);
        assert_eq!(firmware.homed(), [false; 3]);
    }

    #[test]
    fn before_homing_counts_are_offset_and_wrap() {
        let mut firmware = Firmware::new([10, 0, 0], [32_767, 0, 0]);
        let reply = send(&mut firmware, REQUEST);
        // 32777 is 0x8009: -32759 as an i16.
        assert_eq!(&reply[1..5], b"JAAI");
        firmware.jump(1, 3);
        firmware.lose_homing([0, 0, 5]);
        assert_eq!(&send(&mut firmware, REQUEST)[1..13], b"KAAAAAAAFAAA");
    }
}
