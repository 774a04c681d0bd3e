//! The 16-byte packet of the Falcon's firmware in both directions, and a decoder that resynchronises after
//! damage.
//!
//! `<`, fourteen bytes, `>`. Each inner byte is 0x41 plus a value. Bytes 1-4, 5-8 and 9-12 are three i16 of
//! four nibbles each, low nibble first. Byte 13 holds bits. Byte 14 is 0x41 to the device and unused from it.
//! To the device byte 13 is a nibble (homing request, lights). From the device it has seven bits (four
//! buttons, three homed flags), so its range is 0x41 to 0xC0.
//! Source: libnifalcon.

/// Length of a packet, both ways.
pub const PACKET_LEN: usize = 16;
/// First byte of a packet. No inner byte has this value, so it always marks the start of a packet.
pub const START: u8 = b'<';
/// Last byte of a packet.
pub const END: u8 = b'>';
/// Code of an inner byte with the value 0.
const ZERO: u8 = 0x41;
/// Largest value of a nibble.
const NIBBLE_MAX: u8 = 0x0F;
/// Largest value of byte 13 from the device: buttons and homed flags.
const REPLY_BITS_MAX: u8 = 0x7F;
/// Index of the bits.
const BITS_AT: usize = 13;
/// Index of the unused byte.
const SPARE_AT: usize = 14;
/// The three homed flags within [`Reply::homed`].
pub const ALL_HOMED: u8 = 0b111;

/// Lights of the base, each on or off.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Lights {
    /// Bit 1 of byte 13.
    pub green: bool,
    /// Bit 2.
    pub blue: bool,
    /// Bit 3.
    pub red: bool,
}

/// A request of the host.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Request {
    /// Motor commands, counts.
    pub motors: [i16; 3],
    /// Requests homing.
    pub homing: bool,
    /// The lights.
    pub lights: Lights,
}

/// A reply of the device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Reply {
    /// Encoders, counts from home.
    pub encoders: [i16; 3],
    /// Buttons, one bit each: plus, forward, centre, minus.
    pub buttons: u8,
    /// Homed axes, one bit each.
    pub homed: u8,
}

impl Reply {
    /// Whether all three axes are homed.
    #[must_use]
    pub const fn is_homed(&self) -> bool {
        self.homed & ALL_HOMED == ALL_HOMED
    }

    /// Encodes the reply, as the device does.
    #[must_use]
    pub fn encode(&self) -> [u8; PACKET_LEN] {
        encode(self.encoders, (self.buttons & NIBBLE_MAX) | (self.homed & ALL_HOMED) << 4)
    }

    /// Decodes a packet; `None` if it is damaged.
    #[must_use]
    pub fn decode(packet: &[u8; PACKET_LEN]) -> Option<Self> {
        is_whole(packet, REPLY_BITS_MAX).then(|| Self::of(packet))
    }

    /// Decodes a packet that is known to be valid.
    fn of(packet: &[u8; PACKET_LEN]) -> Self {
        let bits = packet[BITS_AT].wrapping_sub(ZERO);
        Self { encoders: values(packet), buttons: bits & NIBBLE_MAX, homed: bits >> 4 }
    }
}

impl Request {
    /// Encodes the request.
    #[must_use]
    pub fn encode(&self) -> [u8; PACKET_LEN] {
        let Lights { green, blue, red } = self.lights;
        let bits = u8::from(self.homing) | u8::from(green) << 1 | u8::from(blue) << 2 | u8::from(red) << 3;
        encode(self.motors, bits)
    }

    /// Decodes a packet; `None` if it is damaged.
    #[must_use]
    pub fn decode(packet: &[u8; PACKET_LEN]) -> Option<Self> {
        let is_set = |bit: u8| packet[BITS_AT].wrapping_sub(ZERO) & bit != 0;
        let lights = Lights { green: is_set(2), blue: is_set(4), red: is_set(8) };
        is_whole(packet, NIBBLE_MAX).then(|| Self { motors: values(packet), homing: is_set(1), lights })
    }
}

fn encode(values: [i16; 3], bits: u8) -> [u8; PACKET_LEN] {
    let mut packet = [ZERO; PACKET_LEN];
    (packet[0], packet[PACKET_LEN - 1]) = (START, END);
    for (nibbles, value) in packet[1..BITS_AT].chunks_exact_mut(4).zip(values) {
        for (i, nibble) in nibbles.iter_mut().enumerate() {
            *nibble = ZERO + (value as u16 >> (4 * i)) as u8 % 16;
        }
    }
    packet[BITS_AT] = ZERO + bits;
    packet
}

/// Whether a byte is allowed at this index of a packet.
const fn fits(at: usize, byte: u8, bits_max: u8) -> bool {
    match at {
        0 => byte == START,
        BITS_AT => byte >= ZERO && byte - ZERO <= bits_max,
        // Any value except the start byte.
        SPARE_AT => byte != START,
        _ if at == PACKET_LEN - 1 => byte == END,
        _ => byte >= ZERO && byte - ZERO <= NIBBLE_MAX,
    }
}

fn is_whole(packet: &[u8; PACKET_LEN], bits_max: u8) -> bool {
    packet.iter().enumerate().all(|(at, byte)| fits(at, *byte, bits_max))
}

fn values(packet: &[u8; PACKET_LEN]) -> [i16; 3] {
    core::array::from_fn(|axis| {
        let nibbles = packet[1 + 4 * axis..][..4].iter().rev();
        nibbles.fold(0_u16, |value, nibble| value << 4 | u16::from(nibble.wrapping_sub(ZERO))) as i16
    })
}

/// Result of decoding some bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Decoded {
    /// The last valid packet.
    pub newest: Option<Reply>,
    /// Number of valid packets.
    pub whole: u32,
    /// Number of incomplete or damaged packets.
    pub damaged: u32,
}

/// Finds the device's packets in a byte stream that may be split anywhere.
///
/// A byte that is not allowed at its index ends the packet as damaged; then all bytes are skipped until the
/// next [`START`]. That byte never occurs within a packet, so a damaged packet costs one packet, or two if
/// its end is missing.
/// Cost: one comparison and one store per byte; no allocation.
#[derive(Debug, Clone, Copy)]
pub struct Decoder {
    packet: [u8; PACKET_LEN],
    len: usize,
    /// Whether it skips the rest of a damaged packet, or of one that began before the first byte.
    skipping: bool,
}

impl Default for Decoder {
    fn default() -> Self {
        Self { packet: [0; PACKET_LEN], len: 0, skipping: true }
    }
}

impl Decoder {
    /// Takes the next bytes of the stream, without the status bytes of the USB chip.
    #[inline]
    pub fn push(&mut self, bytes: &[u8]) -> Decoded {
        let mut decoded = Decoded::default();
        for &byte in bytes {
            if fits(self.len, byte, REPLY_BITS_MAX) {
                self.packet[self.len] = byte;
                self.len += 1;
                self.skipping = false;
                if self.len == PACKET_LEN {
                    self.len = 0;
                    decoded.whole += 1;
                    decoded.newest = Some(Reply::of(&self.packet));
                }
                continue;
            }
            decoded.damaged += u32::from(!self.skipping);
            self.skipping = byte != START;
            self.len = usize::from(byte == START);
            self.packet[0] = START;
        }
        decoded
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Written by hand from the description, not by the encoder.
    const ONE_TWO_MINUS_TWO: &[u8; PACKET_LEN] = b"<BAAACBAAOPPPFAA";

    fn reply(seed: i16) -> Reply {
        Reply { encoders: [seed, -seed, 7 * seed], buttons: seed as u8 & 15, homed: ALL_HOMED }
    }

    #[test]
    fn nibbles_are_low_first() {
        // 1, 0x12, -2; blue and homing: bits 0 and 2.
        let mut expected = *ONE_TWO_MINUS_TWO;
        expected[14] = b'A';
        expected[15] = b'>';
        let lights = Lights { blue: true, ..Lights::default() };
        let request = Request { motors: [1, 0x12, -2], homing: true, lights };
        assert_eq!(core::str::from_utf8(&request.encode()), core::str::from_utf8(&expected));
        assert_eq!(Request::decode(&expected), Some(request));
        // From the device the same bits are the buttons plus and centre.
        let reply = Reply { encoders: [1, 0x12, -2], buttons: 0b0101, homed: 0 };
        assert_eq!(Reply::decode(&expected), Some(reply));
        expected[BITS_AT] = 0x41 + 0x75;
        assert_eq!(Reply::decode(&expected), Some(Reply { homed: ALL_HOMED, ..reply }));
        assert_eq!(Request::decode(&expected), None, "bits that no host sends");
    }

    #[test]
    fn every_value_and_every_bit_survives_a_round_trip() {
        for value in i16::MIN..=i16::MAX {
            let motors = [value, value.wrapping_mul(3), !value];
            let bit = |i: u16| value as u16 >> i & 1 == 1;
            let lights = Lights { green: bit(1), blue: bit(2), red: bit(3) };
            let request = Request { motors, homing: bit(0), lights };
            assert_eq!(Request::decode(&request.encode()), Some(request));
            let reply = Reply { encoders: motors, buttons: value as u8 & 15, homed: (value >> 4) as u8 & 7 };
            assert_eq!(Reply::decode(&reply.encode()), Some(reply));
        }
    }

    #[test]
    fn a_byte_out_of_range_damages_the_packet_at_any_index() {
        let good = reply(1234).encode();
        for at in 0..PACKET_LEN {
            for byte in 0..=u8::MAX {
                let mut packet = good;
                packet[at] = byte;
                let allowed = match at {
                    0 => byte == b'<',
                    13 => (0x41..=0xC0).contains(&byte),
                    14 => byte != b'<',
                    15 => byte == b'>',
                    _ => (0x41..=0x50).contains(&byte),
                };
                assert_eq!(Reply::decode(&packet).is_some(), allowed, "{byte:#x} at {at}");
                let decoded = Decoder::default().push(&packet);
                assert_eq!(decoded.whole == 1, allowed, "{byte:#x} at {at}");
            }
        }
    }

    #[test]
    fn packets_split_anywhere_are_assembled() {
        let stream: Vec<u8> = (0..20).flat_map(|i| reply(i).encode()).collect();
        for step in 1..=40 {
            let mut decoder = Decoder::default();
            let mut whole = 0;
            let mut newest = None;
            for piece in stream.chunks(step) {
                let decoded = decoder.push(piece);
                assert_eq!(decoded.damaged, 0);
                whole += decoded.whole;
                newest = decoded.newest.or(newest);
            }
            assert_eq!((whole, newest), (20, Some(reply(19))), "in steps of {step}");
        }
    }

    #[test]
    fn the_next_packet_after_damage_is_found() {
        let good = reply(-300).encode();
        for cut in 1..PACKET_LEN {
            let stream = [&good[..cut], &good[..]].concat();
            let decoded = Decoder::default().push(&stream);
            assert_eq!((decoded.whole, decoded.damaged), (1, 1), "the end is missing from {cut}");
            let mut decoder = Decoder::default();
            assert_eq!(decoder.push(&good).whole, 1);
            let decoded = decoder.push(&[&good[cut..], &good[..]].concat());
            assert_eq!((decoded.whole, decoded.damaged), (1, 1), "the beginning is missing up to {cut}");
            let mut hit = good;
            if cut == SPARE_AT {
                continue;
            }
            hit[cut] = 0xFF;
            let decoded = Decoder::default().push(&[&hit[..], &good[..], &good[..]].concat());
            assert_eq!((decoded.whole, decoded.damaged), (2, 1), "byte {cut} is damaged");
            assert_eq!(decoded.newest, Some(reply(-300)));
        }
        // A partial packet from before the first byte does not count as damage.
        let decoded = Decoder::default().push(&[&good[7..], &good[..]].concat());
        assert_eq!((decoded.whole, decoded.damaged), (1, 0));
    }

    /// The decoder accepts no bytes that a device did not send as one packet.
    #[test]
    fn noise_does_not_stop_the_decoder() {
        let mut decoder = Decoder::default();
        let mut state = 1_u32;
        let mut whole = 0;
        for _ in 0..100_000 {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            whole += decoder.push(&[(state >> 24) as u8]).whole;
        }
        assert_eq!(whole, 0);
        assert_eq!(decoder.push(&[reply(1).encode(), reply(2).encode()].concat()).newest, Some(reply(2)));
    }
}
