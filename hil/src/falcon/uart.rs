//! The wire between chip and board: rates, the time that a byte takes, and what is heard at a wrong rate.

/// Start bit, eight data bits, stop bit.
const BITS_PER_BYTE: u64 = 10;
/// Largest share by which two ends of a UART may differ and still understand each other.
const BAUD_TOLERANCE: f64 = 0.03;
const NS_PER_S: u64 = 1_000_000_000;
/// In the place of a rate: bytes that are not framed as 8N1, which nobody understands.
pub const OTHER_FORMAT: u32 = 0;

/// A byte at the end of the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WireByte {
    /// When its stop bit was over, ns.
    pub at_ns: u64,
    /// What was sent.
    pub byte: u8,
    /// At which rate, bits a second, or [`OTHER_FORMAT`].
    pub baud: u32,
}

impl WireByte {
    /// What a receiver set to `baud` makes of it: noise if the rates differ.
    #[must_use]
    pub fn heard_at(&self, baud: u32) -> u8 {
        if same_rate(self.baud, baud) { self.byte } else { noise(self.byte) }
    }
}

fn same_rate(one: u32, other: u32) -> bool {
    if one == OTHER_FORMAT || other == OTHER_FORMAT {
        return false;
    }
    (f64::from(one) - f64::from(other)).abs() <= BAUD_TOLERANCE * f64::from(other)
}

/// Whatever a UART reads at a wrong rate: never the byte itself, and no ASCII.
const fn noise(byte: u8) -> u8 {
    !byte | 0x80
}

/// Time of a byte on the wire, ns.
#[must_use]
pub const fn byte_ns(baud: u32) -> u64 {
    BITS_PER_BYTE * NS_PER_S / baud as u64
}

/// Rate for a divisor of 3 MHz: 14 bits, eighths by a code whose third bit comes in the index.
///
/// 0 and 1 are exceptions for 3 and 2 Mbaud.
#[must_use]
pub const fn baud_of(value: u16, index: u16) -> u32 {
    const EIGHTHS: [u32; 8] = [0, 4, 2, 1, 3, 5, 6, 7];
    let code = (value >> 14) as usize | ((index as usize & 1) << 2);
    match (value & 0x3fff, code) {
        (0, 0) => 3_000_000,
        (1, 0) => 2_000_000,
        // Not both are zero here.
        (whole, _) => 24_000_000 / (whole as u32 * 8 + EIGHTHS[code]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn divisors_give_the_known_rates() {
        assert_eq!((baud_of(0x4138, 0), baud_of(0x15, 0), baud_of(0x2, 0)), (9_600, 142_857, 1_500_000));
        // 115,200: 26 and an eighth at most beside it, 26 0/8.
        assert_eq!((baud_of(0x001a, 0), baud_of(0, 0), baud_of(1, 0)), (115_384, 3_000_000, 2_000_000));
        assert_eq!(byte_ns(1_500_000) * 16, 106_656);
    }

    #[test]
    fn a_byte_is_heard_at_its_own_rate_and_is_noise_at_another() {
        let wire = |byte, baud| WireByte { at_ns: 0, byte, baud };
        for byte in 0..=255 {
            assert_eq!(wire(byte, 142_857).heard_at(143_000), byte);
            for (sent, heard) in
                [(9_600, 1_500_000), (1_500_000, 142_857), (OTHER_FORMAT, 9_600), (9_600, OTHER_FORMAT)]
            {
                let noise = wire(byte, sent).heard_at(heard);
                assert!(noise != byte && noise >= 0x80);
            }
        }
    }
}
