//! One jet as a message: the frame as it arrived, with its number and its tick.
//!
//! ```text
//! offset  bytes  content
//!  0      8      u64 tick before whose force it was taken, little-endian
//!  8      8      u64 time of that tick, us
//! 16      4      u32 number among the jets taken, from 1
//! 20      4      zero
//! 24      208    the frame (palpate_core::Jet)
//! ```

use palpate_core::Jet;
use palpate_host::live::TakenJet;

/// Bytes before the frame.
const HEAD_LEN: usize = 24;
/// Bytes of a message.
pub(super) const LEN: usize = HEAD_LEN + Jet::FRAME_LEN;

/// The message of a jet.
pub(super) fn encode(jet: &TakenJet) -> [u8; LEN] {
    let mut bytes = [0; LEN];
    bytes[..8].copy_from_slice(&jet.tick.to_le_bytes());
    bytes[8..16].copy_from_slice(&jet.t_us.to_le_bytes());
    bytes[16..20].copy_from_slice(&jet.number.to_le_bytes());
    bytes[HEAD_LEN..].copy_from_slice(&jet.frame);
    bytes
}

/// The jet of a message; `None` for other bytes. The frame is not checked: a replay refuses what the loop has
/// refused.
pub(super) fn decode(bytes: &[u8]) -> Option<TakenJet> {
    let bytes: &[u8; LEN] = bytes.try_into().ok()?;
    let (head, frame) = bytes.split_first_chunk::<HEAD_LEN>()?;
    let (tick, rest) = head.split_first_chunk()?;
    let (t_us, rest) = rest.split_first_chunk()?;
    let (number, rest) = rest.split_first_chunk()?;
    (rest == [0; 4]).then_some(TakenJet {
        tick: u64::from_le_bytes(*tick),
        t_us: u64::from_le_bytes(*t_us),
        number: u32::from_le_bytes(*number),
        frame: frame.try_into().ok()?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_byte_survives_and_other_messages_are_refused() {
        let frame = core::array::from_fn(|index| index as u8);
        let jet = TakenJet { tick: u64::MAX - 5, t_us: 1 << 40, number: 77, frame };
        let bytes = encode(&jet);
        assert_eq!(decode(&bytes), Some(jet));
        assert_eq!(decode(&bytes[..LEN - 1]), None);
        let mut other = bytes;
        other[21] = 1;
        assert_eq!(decode(&other), None);
    }
}
