//! The frame of a jet, byte by byte.

use palpate_core::format::CHECKSUM;
use palpate_core::{Jet, JetCoupling, JetError, JetFlags};
use proptest::prelude::*;

/// A jet in which no number occurs twice.
fn numbered() -> Jet {
    let third: [f32; 10] = core::array::from_fn(|i| 1e4 + i as f32);
    Jet {
        contact: 0x0102,
        sequence: 0x0304_0506,
        flags: JetFlags {
            joined: true,
            fresh: false,
            unstable: true,
            flush_before: false,
            root: false,
            fixed: true,
        },
        control_m: [0.001, -0.002, 0.003],
        energy_j: 0.25,
        force_n: [1.5, -2.5, 3.5],
        stiffness_n_m: [100.0, 200.0, 300.0, 400.0, 500.0, 600.0],
        third_n_m2: third,
        trust_m: 0.0125,
        coupling: Some(JetCoupling {
            control_m: [0.004, -0.005, 0.006],
            slope_n: [0.5, -0.75, 1.25],
            mixed_n_m: [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]],
            own_n_m: [1.5, 2.5, 3.5, 4.5, 5.5, 6.5],
        }),
        model: 0,
    }
}

/// The bytes with their checksum corrected.
fn sealed(mut frame: [u8; Jet::FRAME_LEN]) -> [u8; Jet::FRAME_LEN] {
    let checksum = CHECKSUM.checksum(&frame[..204]);
    frame[204..].copy_from_slice(&checksum.to_le_bytes());
    frame
}

/// The first 204 bytes.
const GOLDEN: &str = concat!(
    "504a45540300d00006050403020165006f12833a6f1203bba69b443b0000803e0000c03f000020c0000060400000c842",
    "00004843000096430000c8430000fa430000164400401c4600441c4600481c46004c1c4600501c4600541c4600581c46",
    "005c1c4600601c4600641c46cdcc4c3c6f12833b0ad7a3bba69bc43b0000003f000040bf0000a03f0000803f00000040",
    "00004040000080400000a0400000c0400000e04000000041000010410000c03f0000204000006040000090400000b040",
    "0000d0400000000000000000",
);
/// CRC-32 of them, computed by another program.
const CRC: &str = "8e353135";

#[test]
fn the_bytes_are_kept() {
    let frame = numbered().encode();
    let hex: String = frame.iter().map(|byte| format!("{byte:02x}")).collect();
    assert_eq!(hex[..408], *GOLDEN, "{hex}");
    assert_eq!(hex[408..], *CRC, "{hex}");
    assert_eq!(Jet::decode(&frame), Ok(numbered()));
    let root = Jet { flags: JetFlags { root: true, ..numbered().flags }, ..numbered() };
    assert_eq!(
        (root.encode()[14], Jet::decode(&root.encode())),
        (5 | 16 | 32 | 64, Ok(root)),
        "the fifth flag"
    );
    assert_eq!(Jet::FRAME_LEN % 8, 0, "a ring of 64-bit words holds frames");
}

#[test]
fn every_changed_bit_is_refused() {
    let frame = numbered().encode();
    for bit in 0..8 * Jet::FRAME_LEN {
        let mut changed = frame;
        changed[bit / 8] ^= 1 << (bit % 8);
        assert!(Jet::decode(&changed).is_err(), "bit {bit}");
    }
}

#[test]
fn every_number_is_checked() {
    let in_range = |_: usize, value: f32| value == 0.0;
    for word in 0..45 {
        for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1.001e9, -1.001e9, 0.0] {
            let mut frame = numbered().encode();
            frame[16 + 4 * word..][..4].copy_from_slice(&value.to_le_bytes());
            let decoded = Jet::decode(&sealed(frame));
            // The trust radius is positive.
            if in_range(word, value) && word != 23 {
                assert!(decoded.is_ok(), "word {word}, {value}");
            } else {
                assert!(matches!(decoded, Err(JetError::Value { .. })), "word {word}, {value}: {decoded:?}");
            }
        }
    }
    for (trust_m, is_sound) in [(0.025, true), (0.025_f32.next_up(), false), (-1e-3, false), (1e-30, true)] {
        assert_eq!(Jet::decode(&Jet { trust_m, ..numbered() }.encode()).is_ok(), is_sound, "{trust_m}");
    }
    for (x, is_sound) in [(1.0, true), (1.000_001, false), (-1.1, false)] {
        let jet = Jet { control_m: [x, 0.0, 0.0], ..numbered() };
        assert_eq!(Jet::decode(&jet.encode()).is_ok(), is_sound, "{x}");
    }
    let beyond = Jet { control_m: [0.6; 3], ..numbered() };
    assert_eq!(Jet::decode(&beyond.encode()), Err(JetError::Value { what: "control" }), "|d| is 1.04 m");
}

#[test]
fn another_version_is_named() {
    let mut frame = numbered().encode();
    frame[4] = 4;
    assert_eq!(Jet::decode(&sealed(frame)), Err(JetError::Version { found: 4 }));
    // A longer frame of a newer version is one too.
    let mut longer = frame.to_vec();
    longer.extend([0; 40]);
    let error = Jet::decode(&longer).expect_err("newer");
    assert_eq!(error, JetError::Version { found: 4 });
    assert!(error.to_string().contains("version 4"), "{error}");
}

#[test]
fn other_lengths_and_unknown_bits_are_refused() {
    let frame = numbered().encode();
    for have in 0..Jet::FRAME_LEN {
        assert_eq!(Jet::decode(&frame[..have]), Err(JetError::Length { have }));
    }
    assert_eq!(Jet::decode(&[&frame[..], &[0]].concat()), Err(JetError::Length { have: 209 }));
    assert_eq!(Jet::decode(b"PALPATE\0"), Err(JetError::Magic));
    let with = |at: usize, value: u8| {
        let mut changed = frame;
        changed[at] = value;
        Jet::decode(&sealed(changed))
    };
    assert_eq!(with(6, 128), Err(JetError::Length { have: 128 }), "the stated length");
    assert_eq!(with(14, 64), Err(JetError::Reserved), "a seventh flag");
    assert_eq!(with(14, 5), Err(JetError::Reserved), "numbers of a partner without the flag");
    assert_eq!(with(200, 1), Err(JetError::Reserved));
    assert_eq!(with(15, 1), Err(JetError::Reserved));
    for at in 196..200 {
        let model = with(at, 1).expect("any model").model;
        assert_eq!(model, 1 << (8 * (at - 196)), "byte {at}");
    }
    for bits in 0..16 {
        let flags = with(14, bits | 32).expect("four flags").flags;
        let read = [flags.joined, flags.fresh, flags.unstable, flags.flush_before];
        assert_eq!(read, [1, 2, 4, 8].map(|bit| bits & bit != 0));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 4000, failure_persistence: None, ..ProptestConfig::default() })]

    /// What is accepted has the bytes that its jet has.
    #[test]
    fn what_is_accepted_is_written_back(bytes in prop::collection::vec(any::<u8>(), Jet::FRAME_LEN)) {
        let mut frame: [u8; Jet::FRAME_LEN] = bytes.try_into().expect("the length");
        frame[..8].copy_from_slice(&numbered().encode()[..8]);
        frame[14] &= 63;
        frame[15] = 0;
        frame[196..204].fill(0);
        // Exponents in range, so that some are accepted.
        for word in 0..45 {
            frame[16 + 4 * word + 3] = frame[16 + 4 * word + 3] % 2 * 128 + 59;
        }
        frame[16 + 4 * 23 + 3] = 59;
        frame[16 + 4 * 23 + 2] |= 128;
        if frame[14] & 32 == 0 {
            frame[112..196].fill(0);
        }
        let frame = sealed(frame);
        let decoded = Jet::decode(&frame);
        prop_assert!(decoded.is_ok(), "{decoded:?}");
        prop_assert_eq!(decoded.expect("accepted").encode(), frame);
    }
}
