//! The UART between chip and board: baud rates, byte times, and reception at a wrong rate.

/// Start bit, eight data bits, stop bit.
const BITS_PER_BYTE: u64 = 10;
/// Largest relative difference of the baud rates at which reception works.
const BAUD_TOLERANCE: f64 = 0.03;
const NS_PER_S: u64 = 1_000_000_000;
/// Stands for a frame format other than 8N1, which no receiver decodes.
pub const OTHER_FORMAT: u32 = 0;

/// A byte at the end of the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WireByte {
    /// End of its stop bit, ns.
    pub at_ns: u64,
    /// The byte sent.
    pub byte: u8,
    /// Baud rate in bits per second, or [`OTHER_FORMAT`].
    pub baud: u32,
}

impl WireByte {
    /// The byte that a receiver set to `baud` decodes: noise if the rates differ.
    #[must_use]
    pub fn decoded_at(&self, baud: u32) -> u8 {
        if same_rate(self.baud, baud) { self.byte } else { noise(self.byte) }
    }
}

fn same_rate(one: u32, other: u32) -> bool {
    if one == OTHER_FORMAT || other == OTHER_FORMAT {
        return false;
    }
    (f64::from(one) - f64::from(other)).abs() <= BAUD_TOLERANCE * f64::from(other)
}

/// Stands for the bytes received at a wrong rate: never the byte itself, and never ASCII.
const fn noise(byte: u8) -> u8 {
    !byte | 0x80
}

/// Transmission time of a byte, ns.
#[must_use]
pub const fn byte_ns(baud: u32) -> u64 {
    BITS_PER_BYTE * NS_PER_S / baud as u64
}

/// Baud rate of a divisor of 3 MHz: 14 bits, and eighths coded in three bits, the highest of which is in the
/// index.
///
/// Divisors 0 and 1 stand for 3 and 2 Mbaud.
#[must_use]
pub const fn baud_of(value: u16, index: u16) -> u32 {
    const EIGHTHS: [u32; 8] = [0, 4, 2, 1, 3, 5, 6, 7];
    let code = (value >> 14) as usize | ((index as usize & 1) << 2);
    match (value & 0x3fff, code) {
        (0, 0) => 3_000_000,
        (1, 0) => 2_000_000,
        // The divisor is not zero here.
        (whole, _) => 24_000_000 / (whole as u32 * 8 + EIGHTHS[code]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn divisors_give_the_documented_rates() {
        assert_eq!((baud_of(0x4138, 0), baud_of(0x15, 0), baud_of(0x2, 0)), (9_600, 142_857, 1_500_000));
        // 115,200 baud: the divisor 26 0/8 is within an eighth.
        assert_eq!((baud_of(0x001a, 0), baud_of(0, 0), baud_of(1, 0)), (115_384, 3_000_000, 2_000_000));
        assert_eq!(byte_ns(1_500_000) * 16, 106_656);
    }

    #[test]
    fn a_byte_is_decoded_at_its_own_rate_only() {
        let wire = |byte, baud| WireByte { at_ns: 0, byte, baud };
        for byte in 0..=255 {
            assert_eq!(wire(byte, 142_857).decoded_at(143_000), byte);
            for (sent, received) in
                [(9_600, 1_500_000), (1_500_000, 142_857), (OTHER_FORMAT, 9_600), (9_600, OTHER_FORMAT)]
            {
                let noise = wire(byte, sent).decoded_at(received);
                assert!(noise != byte && noise >= 0x80);
            }
        }
    }
}
